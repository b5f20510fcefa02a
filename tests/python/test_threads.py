"""The GIL is released in long calls; objects can be used from several threads; Ctrl-C works."""

import signal
import sys
import threading
import time

import numpy as np
import pytest

import terse
from conftest import square


def lets_others_run(call, times=500):
    """Whether another Python thread runs while this one is in `call`. No thread is made to give the GIL away meanwhile,
    so that only `call` itself can let it go. Tried often: the other one may be late."""
    inside, seen, finished = threading.Event(), threading.Event(), threading.Event()

    def watch():
        while not finished.is_set():
            if inside.is_set():
                seen.set()
            time.sleep(1e-4)

    watcher = threading.Thread(target=watch)
    interval = sys.getswitchinterval()
    try:
        sys.setswitchinterval(1000)
        watcher.start()
        for _ in range(times):
            inside.set()
            call()
            inside.clear()
            if seen.is_set():
                return True
        return False
    finally:
        sys.setswitchinterval(interval)
        finished.set()
        watcher.join()


def test_long_calls_let_others_run():
    graph, _ = square(10)
    options = terse.CompactOptions(2, range=[3, 3, 0.5], strategy="apfl")
    poses = terse.solve(graph).poses
    replay = terse.GraphReplay(graph)
    for call in (
        lambda: terse.solve(graph),
        lambda: terse.Marginals(graph, poses),
        lambda: terse.CompactPoseSlam(options).run(replay),
        lambda: terse.select_thresholds(graph, share=0.3),
        lambda: terse.replay(graph, terse.IncrementalSolver(2)),
    ):
        assert lets_others_run(call)


def test_what_holds_the_gil_is_found():
    assert not lets_others_run(lambda: sum(range(100_000)), times=50)


def test_add_pose_lets_others_run():
    graph, _ = square(10)
    slam = terse.CompactPoseSlam(terse.CompactOptions(2, range=[3, 3, 0.5], strategy="apfl"))
    poses = iter(list(terse.GraphReplay(graph)))
    assert lets_others_run(lambda: slam.add(next(poses)))


def test_queries_from_several_threads(ellipse):
    marginals = terse.solve(ellipse).marginals()
    expected = marginals.marginals()
    wrong = []

    def query(first):
        for k in range(first, 170, 4):
            if not np.allclose(marginals.marginal(k), expected[k], rtol=1e-9, atol=1e-16):
                wrong.append(k)

    threads = [threading.Thread(target=query, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_a_map_is_read_while_it_grows():
    graph, _ = square(6)
    alone = terse.CompactPoseSlam(terse.CompactOptions(2, range=[3, 3, 0.5]))
    alone.run(terse.GraphReplay(graph))
    slam = terse.CompactPoseSlam(terse.CompactOptions(2, range=[3, 3, 0.5]))
    slam.add_pose(0)
    replay, done, counts = terse.GraphReplay(graph), threading.Event(), []

    def grow():
        try:
            for k in range(1, len(graph)):
                # Through Python, so that readers wait for one that needs the GIL.
                slam.add(replay[k], lambda candidate, current: replay(candidate, current))
        finally:
            done.set()

    grower = threading.Thread(target=grow)
    grower.start()
    while not done.is_set():
        trajectory = slam.trajectory()
        counts.append(len(trajectory))
        assert np.isfinite(trajectory.poses).all()
        kept_before = slam.poses_kept
        assert kept_before <= len(slam.graph()) <= slam.poses_kept  # kept poses only become more
    grower.join()
    assert counts == sorted(counts) and slam.poses_seen == 240
    np.testing.assert_array_equal(slam.trajectory().poses, alone.trajectory().poses)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")
def test_signals_end_a_long_call():
    class Alarm(Exception):
        pass

    def ring(number, frame):
        raise Alarm

    graph, _ = square(40)
    slam = terse.CompactPoseSlam(terse.CompactOptions(2, range=[3, 3, 0.5], strategy="apfl"))
    replay = terse.GraphReplay(graph)
    before = signal.signal(signal.SIGALRM, ring)
    try:
        with pytest.raises(Alarm):
            signal.setitimer(signal.ITIMER_REAL, 0.01)
            slam.run(replay)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert 0 < slam.poses_seen < len(graph)
