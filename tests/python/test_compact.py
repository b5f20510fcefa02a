import numpy as np
import pytest

import terse
from conftest import square


def reasons(decisions):
    return [
        (d.pose_id, d.verdict, d.pose_gain, [(c.pose_id, c.gain, c.factor_id) for c in d.candidates]) for d in decisions
    ]


def test_against_the_command(command, ellipse, tmp_path):
    path = tmp_path / "ellipse.g2o"
    terse.write_graph(ellipse, path)
    command("compact", path, "--strategy", "fpfl", "--output", tmp_path / "run", "--quiet")
    # From the file, as the command: writing rounds the information.
    graph = terse.read_graph(path)
    slam = terse.CompactPoseSlam(terse.select_thresholds(graph).options())
    decisions = slam.run(terse.GraphReplay(graph))
    solution = slam.finish()
    run = terse.read_run(tmp_path / "run")

    assert solution.chi2 == run.stats["chi2"] and slam.poses_kept == run.stats["poses_kept"]
    assert slam.links_kept == run.stats["links_kept"]
    assert slam.options.range.tolist() == run.thresholds["range"]
    assert [(d.pose_id, d.kept, d.verdict, d.pose_gain) for d in decisions] == [
        (d.pose_id, d.kept, d.verdict, d.pose_gain) for d in run.decisions
    ]
    gains, written = ([[c.gain for c in d.candidates] for d in source] for source in (decisions, run.decisions))
    assert gains == written
    assert len(list(run.accepted())) == slam.links_kept
    trajectory = slam.trajectory()
    np.testing.assert_array_equal(trajectory.ids, run.ids)
    np.testing.assert_array_equal(trajectory.kept, run.kept)
    np.testing.assert_allclose(trajectory.poses, run.poses, atol=1e-12)
    covariances = slam.marginals().marginals(run.covariance_ids)
    np.testing.assert_allclose(covariances, run.covariances, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_callback_equals_the_replay(dimension, ellipse, thresholds):
    graph = ellipse if dimension == 3 else square(3)[0]
    options = (thresholds if dimension == 3 else terse.select_thresholds(graph)).options()
    by_replay = terse.CompactPoseSlam(options)
    expected = by_replay.run(terse.GraphReplay(graph))

    replay = terse.GraphReplay(graph)
    asked = []

    def register(candidate, current):
        asked.append((candidate, current))
        return replay(candidate, current)

    by_callback = terse.CompactPoseSlam(options)
    decisions = [by_callback.add(pose, register) for pose in replay]
    assert reasons(decisions) == reasons(expected)
    assert len(asked) == sum(d.registrations_tried for d in expected) > 0
    assert by_callback.finish().chi2 == by_replay.finish().chi2
    np.testing.assert_array_equal(by_callback.trajectory("v1").poses, by_replay.trajectory("v1").poses)


def drive(slam, graph, register, first=0):
    """Adds the poses of square() one by one, as a user would."""
    for k in range(first, len(graph)):
        slam.add_pose(k, graph.factor(k - 1) if k > 0 else None, register)


def options_of_square(**keywords):
    return terse.CompactOptions(2, range=[3, 3, 0.5], link_covariance=[0.0025, 0.0025, 1e-4], **keywords)


def test_an_exception_of_the_callback_passes_through(ellipse, thresholds):
    class Lost(Exception):
        pass

    replay, calls = terse.GraphReplay(ellipse), []

    def fail_once(candidate, current):
        calls.append(current)
        if len(calls) == 5:
            raise Lost("no match", current)
        return replay(candidate, current)

    slam = terse.CompactPoseSlam(thresholds.options())
    inputs = list(replay)
    failed_at = None
    for pose in inputs:
        try:
            slam.add(pose, fail_once)
        except Lost as error:
            failed_at = pose.pose_id
            assert error.args == ("no match", pose.pose_id) and slam.poses_seen == pose.pose_id
            slam.add(pose, fail_once)
    assert failed_at is not None and slam.poses_seen == 170 and slam.finish().converged


def test_a_callback_that_returns_nonsense():
    graph, _ = square()
    for value, error, message in [
        ("link", TypeError, "RelativePose or None"),
        (terse.RelativePose(70, 71, [0, 0, 0], information=np.ones(3)), ValueError, "between other poses"),
        (terse.RelativePose(0, 1, [0, 0, 0, 0, 0, 0, 1], information=np.ones(6)), ValueError, "expected 2D, got 3D"),
    ]:
        slam = terse.CompactPoseSlam(options_of_square())
        with pytest.raises(error, match=message):
            drive(slam, graph, lambda candidate, current: value)
        seen = slam.poses_seen
        drive(slam, graph, None, seen)
        assert slam.poses_seen == 80


def test_a_callback_may_read_but_not_change():
    graph, _ = square()
    slam = terse.CompactPoseSlam(options_of_square())
    read = []

    def register(candidate, current):
        read.append(slam.estimate(candidate))
        for change in (slam.finish, lambda: slam.add_pose(1000), lambda: slam.remove_link(0)):
            with pytest.raises(RuntimeError, match="callback"):
                change()

    drive(slam, graph, register)
    assert len(read) > 0 and slam.poses_seen == 80


def test_links_and_priors_that_come_late():
    graph, _ = square()
    slam = terse.CompactPoseSlam(options_of_square(strategy="apfl"))
    drive(slam, graph, None)
    loop = graph.factor(79)
    decision = slam.add_link(loop)
    assert decision.accepted and (decision.from_id, decision.to_id) == (loop.from_id, loop.to_id)
    assert slam.links_kept == 1 and decision.gain > 0 and decision.innovation < 30
    slam.remove_link(decision.factor_id)
    assert slam.links_kept == 0
    with pytest.raises(ValueError):
        slam.remove_link(decision.factor_id)
    slam.add_prior(terse.PositionPrior(30, [0, 0], information=[1, 1]))
    assert slam.kept_base(30) == 30 and slam.graph().num_factors == 80
    assert slam.undetermined().startswith("heading is not determined")


def test_a_position_prior_on_a_dropped_pose():
    graph, _ = square()
    slam = terse.CompactPoseSlam(options_of_square())
    drive(slam, graph, None)
    dropped = next(k for k in range(80) if slam.kept_base(k) != k)
    before = slam.estimate(dropped)
    factor = slam.add_prior(terse.PositionPrior(dropped, before[:2] + [100, 50], covariance=[1e-4, 1e-4]))
    np.testing.assert_allclose(slam.estimate(dropped)[:2], before[:2] + [100, 50], atol=1e-3)
    carried = slam.graph().factor(factor)
    assert carried.pose_id == slam.kept_base(dropped) and np.linalg.norm(carried.p_body) > 0
    assert slam.undetermined().startswith("heading is not determined")


def test_covariances_of_any_pose():
    """Beside the graph in which the dropped poses are poses like all others, with the links that were kept."""
    graph, _ = square(3)
    slam = terse.CompactPoseSlam(options_of_square(min_pose_gain=4))
    decisions = slam.run(terse.GraphReplay(graph))
    slam.finish()
    trajectory = slam.trajectory()
    links = {frozenset((d.pose_id, c.pose_id)) for d in decisions for c in d.candidates if c.accepted}
    everything = terse.PoseGraph(2)
    everything.add_poses(trajectory.ids, trajectory.poses)
    edges = graph.edges()
    for k, pair in enumerate(zip(edges.from_ids, edges.to_ids)):
        if abs(pair[0] - pair[1]) == 1 or frozenset(pair) in links:
            everything.add_factor(graph.factor(k))
    marginals = terse.Marginals(everything)
    assert slam.poses_kept < 100 and slam.links_kept > 3
    for k in range(1, 120):
        np.testing.assert_array_equal(slam.estimate(k, "v2"), trajectory.poses[k])
        # To first order: residuals of some standard deviations are left out.
        expected = marginals.marginal(k)
        np.testing.assert_allclose(slam.covariance(k), expected, atol=0.02 * np.abs(expected).max())
        expected = marginals.relative(k // 2, k)
        np.testing.assert_allclose(slam.relative_covariance(k // 2, k), expected, atol=0.05 * np.abs(expected).max())
        R = terse.to_matrices(slam.estimate(k, "v2")) * [[1, 1, 0], [1, 1, 0], [0, 0, 1]]
        axes = slam.covariance(k, frame="world_axes", order="rotation_first")[np.ix_([1, 2, 0], [1, 2, 0])]
        np.testing.assert_allclose(axes, R @ slam.covariance(k) @ R.T, rtol=1e-9, atol=1e-15)
    kept = int(trajectory.ids[trajectory.kept][-1])
    np.testing.assert_allclose(slam.covariance(kept), slam.marginals().marginal(kept), rtol=1e-9, atol=1e-15)
    for call in (lambda: slam.covariance(1000), lambda: slam.relative_covariance(3, 3), lambda: slam.estimate(3, "v4")):
        with pytest.raises(ValueError):
            call()
    with pytest.raises(ValueError, match="frame: expected one of body, world, world_axes"):
        slam.covariance(3, frame="world-axes")


def test_save_and_load(tmp_path, ellipse, thresholds):
    def run(part, slam, replay):
        return [slam.add(pose, replay) for pose in list(replay)[part]]

    replay, slam = terse.GraphReplay(ellipse), terse.CompactPoseSlam(thresholds.options())
    run(slice(0, 90), slam, replay)
    slam.save(tmp_path / "state")
    again = terse.CompactPoseSlam.load(tmp_path / "state")
    assert again.dimension == 3 and again.poses_seen == 90
    twin = terse.GraphReplay(ellipse)
    assert reasons(run(slice(90, None), slam, replay)) == reasons(run(slice(90, None), again, twin))
    np.testing.assert_array_equal(slam.trajectory().poses, again.trajectory().poses)


def test_compact_map_reloads_and_continues(tmp_path, ellipse, thresholds):
    slam = terse.CompactPoseSlam(thresholds.options())
    slam.run(terse.GraphReplay(ellipse))
    solution = slam.finish()
    terse.write_graph(slam.graph(), tmp_path / "compact.g2o")
    again = terse.solve(terse.read_graph(tmp_path / "compact.g2o"), initial="file")
    assert again.chi2 == pytest.approx(solution.chi2, rel=1e-9)


def test_thresholds_and_options(ellipse, thresholds):
    options = thresholds.options(strategy="apfl", solver=terse.IncrementalOptions(threads=2))
    assert options.strategy == "apfl" and options.solver.threads == 2 and options.dimension == 3
    np.testing.assert_array_equal(options.range, thresholds.range)
    np.testing.assert_array_equal(options.link_covariance, thresholds.link_covariance)
    assert thresholds.sample_poses == 102 and thresholds.min_loop_gain > 0
    progress = []
    terse.select_thresholds(ellipse, share=0.3, progress=lambda done, total: progress.append((done, total)))
    assert progress
    options.innovation_quantile = None
    assert options.innovation_quantile is None
    with pytest.raises(ValueError, match=r"range: expected shape \(4,\), got \(3,\)"):
        options.range = [1, 1, 1]
    with pytest.raises(ValueError, match="strategy: expected one of fpfl|apal"):
        options.strategy = "all"
    with pytest.raises(TypeError, match="no option 'rnage'"):
        terse.CompactOptions(3, rnage=[1, 1, 1, 1])
    with pytest.raises(ValueError):
        terse.CompactPoseSlam(terse.CompactOptions(2, probability=2))
    replay = terse.GraphReplay(ellipse)
    assert len(replay) == 170 and replay.links_offered == 354 and replay[-1].pose_id == 169
    assert replay.link_range().shape == (4,) and replay.link_covariance().shape == (6, 6)
    with pytest.raises(IndexError):
        replay[170]


def test_random_baseline(ellipse, thresholds):
    replay = terse.GraphReplay(ellipse)
    replay.draw_at_random(20, 5, seed=3)
    slam = terse.CompactPoseSlam(thresholds.options(strategy="rfpfl"))
    decisions = slam.run(replay)
    assert slam.poses_kept == 20 and 0 < slam.links_kept <= 5
    assert {d.verdict for d in decisions} <= {"first", "drawn", "redundant", "loop_closed"}


def test_run_can_be_stopped(ellipse, thresholds):
    slam = terse.CompactPoseSlam(thresholds.options())
    assert len(slam.run(terse.GraphReplay(ellipse), progress=lambda done, total: done < 30)) == 30


def write_run(folder, graph):
    folder.mkdir()
    terse.write_graph(graph, folder / "compact.g2o")
    terse.write_trajectory(terse.Trajectory(graph.ids, graph.poses), folder / "trajectory.tum")


def test_run_folder_with_an_archive(tmp_path, ellipse):
    write_run(tmp_path / "run", ellipse)
    assert terse.read_run(tmp_path / "run").covariances is None
    blocks = np.arange(72.0).reshape(2, 6, 6)
    np.savez(tmp_path / "run" / "covariances.npz", ids=np.array([0, 5]), covariances=blocks)
    run = terse.read_run(str(tmp_path / "run"))
    np.testing.assert_array_equal(run.covariances, blocks)
    assert run.covariance_ids.tolist() == [0, 5] and run.decisions == [] and run.kept.all()


def test_run_folder_errors(tmp_path, ellipse):
    write_run(tmp_path / "run", ellipse)
    header = "pose,kept,verdict,pose_gain_nats,candidates,probabilities,gains_nats,measured_gains_nats,innovations,accepted"
    for text, line, cause in [
        ("pose,kept\n", 1, "expected the columns"),
        (header + "\n0,1,first,,,,,,,\n1,x\n", 3, "not as many fields"),
        (header + "\n0,1,first,,1 2,0.1,1,-,-,0\n", 2, "not of the same length"),
        (header + "\n0,1,first,much,,,,,,\n", 2, "much"),
    ]:
        (tmp_path / "run" / "decisions.csv").write_text(text)
        with pytest.raises(terse.FileError, match=cause) as caught:
            terse.read_run(tmp_path / "run")
        assert caught.value.path.endswith("decisions.csv") and caught.value.line == line
    (tmp_path / "run" / "decisions.csv").unlink()
    (tmp_path / "run" / "stats.json").write_text('{\n"a": }')
    with pytest.raises(terse.FileError) as caught:
        terse.read_run(tmp_path / "run")
    assert caught.value.line == 2
