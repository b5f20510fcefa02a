"""What the tests of the Python package share. ctest sets PYTHONPATH, TERSE_BUILD and TERSE_COMMAND."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import terse

ROOT = Path(__file__).parents[2]


@pytest.fixture
def ellipse():
    return terse.read_graph(ROOT / "data" / "ellipse.g2o")


@pytest.fixture
def thresholds(ellipse):
    return terse.select_thresholds(ellipse)


@pytest.fixture
def command():
    """Runs the command terse and returns what it printed."""
    path = os.environ.get("TERSE_COMMAND", "")
    if not path or not Path(path).exists():
        pytest.skip("the command terse is not built (TERSE_COMMAND)")

    def run(*arguments):
        done = subprocess.run([path, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def square(laps=2, seed=1, offsets=(40,), every=3):
    """A noisy drive round a square in the plane as a graph, with links to the lap before; and its true poses.

    offsets, every: each such pose has links to those so many poses before it."""
    random = np.random.default_rng(seed)
    sigma = np.array([0.05, 0.05, 0.01])
    truth = [np.zeros(3)]
    for step in range(1, 40 * laps):
        x, y, theta = truth[-1]
        truth.append(np.array([x + np.cos(theta), y + np.sin(theta), theta + (np.pi / 2 if step % 10 == 9 else 0)]))

    def measure(a, b):
        T = np.linalg.inv(terse.to_matrices(truth[a])) @ terse.to_matrices(truth[b])
        return np.array([T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])]) + sigma * random.standard_normal(3)

    pairs = [(k - 1, k) for k in range(1, len(truth))] + [
        (k - offset, k) for k in range(min(offsets), len(truth), every) for offset in offsets if k >= offset
    ]
    graph = terse.PoseGraph(2)
    graph.add_poses(np.arange(len(truth)))
    graph.add_edges(*np.array(pairs).T, np.array([measure(a, b) for a, b in pairs]), covariance=sigma**2)
    return graph, np.array(truth)
