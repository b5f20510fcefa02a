"""What docstrings say about views and owners."""

import gc

import numpy as np
import pytest

import terse
from conftest import square


def churn():
    """What was freed is likely to be written over."""
    gc.collect()
    return [np.full(1000, np.nan) for _ in range(200)]


def test_poses_of_a_solution_are_a_view_that_keeps_it_alive():
    solution = terse.solve(square()[0])
    poses = solution.poses
    assert np.shares_memory(poses, solution.poses) and np.shares_memory(poses[:, :2], solution.poses)
    assert poses.base is solution and not poses.flags.writeable and not poses.flags.owndata
    with pytest.raises(ValueError):
        poses[0, 0] = 1
    before = poses.copy()
    del solution
    churn()
    np.testing.assert_array_equal(poses, before)


def test_trajectory():
    trajectory = terse.Trajectory(np.arange(50), np.random.default_rng(1).standard_normal((50, 3)))
    stamps, poses = trajectory.stamps, trajectory.poses
    assert np.shares_memory(stamps, trajectory.stamps) and np.shares_memory(poses, trajectory.poses)
    before = poses.copy()
    del trajectory
    churn()
    np.testing.assert_array_equal(poses, before)
    np.testing.assert_array_equal(stamps, np.arange(50))


def test_covariances_own_what_was_computed():
    solution = terse.solve(square()[0])
    marginals = solution.marginals()
    arrays = [marginals.marginals(), marginals.joint([1, 2, 3]), marginals.column(5, [1, 2])]
    arrays.append(square()[0].edges().information)
    before = [array.copy() for array in arrays]
    for array in arrays:
        assert array.base is not None and array.flags.writeable  # memory of the library, held by a capsule
    assert np.shares_memory(arrays[0], arrays[0][3])
    del marginals, solution
    churn()
    for array, copied in zip(arrays, before):
        np.testing.assert_array_equal(array, copied)


def test_arrays_of_any_layout_are_read():
    graph, truth = square(1)
    graph.set_poses(np.asfortranarray(truth))
    np.testing.assert_allclose(graph.poses[:, :2], truth[:, :2])
    wide = np.zeros((40, 6))
    wide[:, ::2] = truth
    graph.set_poses(wide[:, ::2])
    np.testing.assert_allclose(graph.poses[:, :2], truth[:, :2])
    graph.set_poses(np.zeros((40, 3), dtype=np.float32))
    assert not graph.poses.any()
    graph.set_poses(truth.tolist())
