import pickle

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
    slam = terse.CompactPoseSlam(terse.select_thresholds(graph, strategy="fpfl").options(strategy="fpfl"))
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


@pytest.mark.parametrize("strategy", ["fpfl", "apfl", "apal", "bounded"])
def test_one_call_against_the_command(command, ellipse, tmp_path, strategy):
    path = tmp_path / "ellipse.g2o"
    terse.write_graph(ellipse, path)
    command("compact", path, "--strategy", strategy, "--output", tmp_path / "run", "--quiet")
    told = []
    graph = terse.read_graph(path)
    run = terse.compact(graph, strategy=strategy, progress=lambda done, total: told.append((done, total)))
    written = terse.read_run(tmp_path / "run")
    assert told == [(k + 1, len(graph)) for k in range(len(graph))]
    assert run.solution.chi2 == written.stats["chi2"]
    assert run.poses_seen == len(graph)
    for name in ("poses_kept", "links_kept", "links_offered", "registrations_tried", "links_refused"):
        assert getattr(run, name) == written.stats[name]
    assert [(d.pose_id, d.kept, d.verdict) for d in run.decisions] == [
        (d.pose_id, d.kept, d.verdict) for d in written.decisions
    ]
    assert run.registrations_tried == sum(d.registrations_tried for d in run.decisions)
    np.testing.assert_array_equal(run.graph().poses, written.graph.poses)
    assert run.graph().chi2() == pytest.approx(run.solution.chi2, rel=1e-9)
    np.testing.assert_array_equal(run.trajectory().ids, written.ids)
    assert len(run.step_seconds) == len(graph) and (run.step_seconds >= 0).all()
    assert run.odometry_scale == run.loop_scale == (1, 1)


def laps():
    return square(6, offsets=(37, 40, 43, 80), every=1)[0]


def bounded_options(graph, **options):
    return terse.select_thresholds(graph).options(strategy="bounded", **options)


def test_a_bounded_map_says_what_it_made_of_the_links():
    graph = laps()
    run = terse.compact(graph, bounded_options(graph, retire_share=0))
    assert not run.retired and not any(d.retired for d in run.decisions)
    kept = set(run.slam.graph().ids.tolist())
    anchored = [d for d in run.decisions if d.verdict == "anchored"]
    edges = [edge for d in run.decisions for edge in d.edges]
    assert len(anchored) > 20 and edges
    for decision in run.decisions:
        assert (decision.anchored_to is not None) == (decision.verdict == "anchored")
        assert sum(c.anchors for c in decision.candidates) == (decision.anchored_to is not None)
        if decision.edges:
            assert any(c.composed for c in decision.candidates)
    assert {d.anchored_to for d in anchored} <= kept
    assert all(edge.id < -1 and edge.gain > 0 and {edge.from_id, edge.to_id} <= kept for edge in edges)
    assert len({edge.id for edge in edges}) == len(edges) and any(edge.fused for edge in edges)
    assert "fused" in repr(next(edge for edge in edges if edge.fused))
    again = pickle.loads(pickle.dumps(run.decisions))
    assert [(d.anchored_to, [(e.id, e.gain) for e in d.edges]) for d in again] == [
        (d.anchored_to, [(e.id, e.gain) for e in d.edges]) for d in run.decisions
    ]
    # The map goes on from what it was exported as.
    exported = pickle.loads(pickle.dumps(run.slam.export()))
    slam = terse.CompactPoseSlam.restore(exported, run.slam.options)
    assert slam.poses_kept == run.poses_kept and slam.links_kept == run.links_kept
    links = slam.links_kept
    slam.remove_link(edges[-1].id)
    with pytest.raises(ValueError, match="is not a link"):
        slam.remove_link(edges[-1].id)
    assert slam.links_kept <= links


def test_poses_retire_as_a_bounded_map_grows():
    graph = laps()
    options = bounded_options(graph)
    assert options.retire_share > 0
    run = terse.compact(graph, options)
    there, retired = set(), []
    for decision in run.decisions:
        if decision.kept:
            there.add(decision.pose_id)
        there |= set(decision.revived)
        assert decision.anchored_to is None or decision.anchored_to in there
        retired += decision.retired
        there -= {pose.pose_id for pose in decision.retired}
    retired += run.retired
    there -= {pose.pose_id for pose in run.retired}
    assert retired and there == set(run.slam.graph().ids.tolist())
    for pose in retired:
        assert 0 <= pose.loss <= options.retire_share * options.min_loop_gain
        assert pose.neighbours >= 1 and pose.factors_removed >= pose.factors_recovered == pose.neighbours - 1
    assert repr(retired[0]).startswith(f"<terse.RetiredPose {retired[0].pose_id}: ") and "nats lost" in repr(retired[0])
    again = pickle.loads(pickle.dumps(run))
    assert fates(again.retired) == fates(run.retired)
    assert [fates(d.retired) for d in again.decisions] == [fates(d.retired) for d in run.decisions]
    # Everything is asked for as before; what is kept by default keeps all.
    assert len(run.trajectory()) == len(graph)
    assert run.poses_kept < terse.compact(graph, bounded_options(graph, retire_share=0)).poses_kept


def fates(retired):
    return [(p.pose_id, p.loss, p.neighbours, p.factors_removed, p.factors_recovered) for p in retired]


def test_poses_retire_when_asked():
    graph = laps()
    slam = terse.CompactPoseSlam(bounded_options(graph, retire_share=0))
    slam.run(terse.GraphReplay(graph))
    slam.finish()
    assert slam.retire() == []  # as the options have it
    state, kept, chi2 = slam.__getstate__(), slam.poses_kept, slam.chi2()
    for bad in (-1, float("nan")):
        with pytest.raises(ValueError, match="0 nats or more"):
            slam.retire(bad)
    with pytest.raises(TypeError):
        slam.retire("all")
    assert slam.__getstate__() == state
    before = dict(slam.graph().items())
    ids = set(slam.graph().ids.tolist())
    few = slam.retire(most_loss=0.5)
    assert few and all(0 <= pose.loss <= 0.5 for pose in few)
    assert slam.poses_kept == kept - len(few)
    assert set(slam.graph().ids.tolist()) == ids - {pose.pose_id for pose in few}
    assert slam.retire(0.5) == []  # as many as may have gone
    assert slam.poses_seen == len(graph) and slam.finish().converged
    # Retiring moves nothing, to first order.
    for pose_id, pose in slam.graph().items():
        assert np.linalg.norm(pose - before[pose_id]) < 0.01
    for pose in few:
        assert slam.kept_base(pose.pose_id) in ids - {pose.pose_id for pose in few}
    assert slam.chi2() <= chi2 * (1 + 1e-9)
    more = slam.retire(5)
    assert more and max(pose.loss for pose in more) > 0.5
    # The map goes on, also from a pickle, to the last bit.
    link = terse.RelativePose(int(graph.ids[-1]), 900, [1, 0, 0], covariance=np.full(3, 1e-3))
    again = pickle.loads(pickle.dumps(slam))
    assert reasons([again.add_pose(900, link)]) == reasons([slam.add_pose(900, link)])
    assert again.chi2() == slam.chi2() and again.poses_kept == slam.poses_kept


def test_poses_retire_by_the_share_of_the_options():
    graph = laps()
    options = bounded_options(graph, retire_share=0)
    slam = terse.CompactPoseSlam(options)
    slam.run(terse.GraphReplay(graph))
    shared = bounded_options(graph, retire_share=0.3)
    by_share = terse.CompactPoseSlam.restore(slam.export(), shared)
    by_loss = terse.CompactPoseSlam.restore(slam.export(), options)
    retired = by_share.retire()
    assert retired and fates(retired) == fates(by_loss.retire(0.3 * shared.min_loop_gain))
    for share in (-0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="retiring"):
            terse.CompactPoseSlam(bounded_options(graph, retire_share=share))
    # With another strategy only what may be lost is said.
    slam = terse.compact(graph, terse.select_thresholds(graph).options(strategy="apfl")).slam
    assert slam.retire() == [] and slam.retire(3)


def test_one_call_with_options_is_the_run_by_hand(ellipse, thresholds):
    options = thresholds.options(strategy="apfl")
    run = terse.compact(ellipse, options)
    slam = terse.CompactPoseSlam(options)
    decisions = slam.run(terse.GraphReplay(ellipse))
    assert run.solution.chi2 == slam.finish().chi2 and reasons(run.decisions) == reasons(decisions)
    # The map can go on.
    link = terse.RelativePose(int(ellipse.ids[-1]), 7000, [1, 0, 0, 0, 0, 0, 1], covariance=np.full(6, 1e-4))
    assert run.slam.add_pose(7000, link).kept and run.slam.poses_seen == len(ellipse) + 1


def test_one_call_scales_information_that_nobody_estimated():
    graph, _ = square(3)
    edges = graph.edges()
    unit = terse.PoseGraph(2)
    unit.add_poses(graph.ids)
    unit.add_edges(edges.from_ids, edges.to_ids, edges.T_from_to, information=np.ones(3))
    calibrated, report = terse.calibrate_information(unit)
    run = terse.compact(unit)
    assert report.verdict == "contradicted"
    assert run.odometry_scale == report.odometry_scale and run.loop_scale == report.loop_scale != (1, 1)


def test_one_call_that_is_misused(ellipse, thresholds):
    for fails in (
        lambda: terse.compact(terse.PoseGraph(2)),
        lambda: terse.compact(ellipse, strategy="all"),
        lambda: terse.compact(ellipse, strategy="rfpfl"),
        lambda: terse.compact(ellipse, terse.CompactOptions(2)),
        lambda: terse.compact(ellipse, thresholds.options(), strategy="fpfl"),
    ):
        with pytest.raises(ValueError):
            fails()

    def fail(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        terse.compact(ellipse, progress=fail)


def without_loops(replay):
    """The inputs of a replay for a registration: with loops nothing else is registered."""
    inputs = list(replay)
    for pose in inputs:
        pose.loops = None
    return inputs


@pytest.mark.parametrize("strategy", ["fpfl", "bounded"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_callback_equals_the_replay_as_registration(dimension, strategy, ellipse, thresholds):
    graph = ellipse if dimension == 3 else square(3)[0]
    options = (thresholds if dimension == 3 else terse.select_thresholds(graph)).options(strategy=strategy)
    by_replay = terse.CompactPoseSlam(options)
    replay = terse.GraphReplay(graph)
    expected = [by_replay.add(pose, replay) for pose in without_loops(replay)]

    replay = terse.GraphReplay(graph)
    asked = []

    def register(candidate, current):
        asked.append((candidate, current))
        return replay(candidate, current)

    by_callback = terse.CompactPoseSlam(options)
    decisions = [by_callback.add(pose, register) for pose in without_loops(replay)]
    assert reasons(decisions) == reasons(expected)
    assert len(asked) == sum(d.registrations_tried for d in expected) > 0
    assert by_replay.links_kept > 0 and not any(c.measured for d in expected for c in d.candidates)
    assert by_callback.finish().chi2 == by_replay.finish().chi2
    np.testing.assert_array_equal(by_callback.trajectory("v1").poses, by_replay.trajectory("v1").poses)


def test_loops_take_the_place_of_the_registration(ellipse, thresholds):
    replay, expected = terse.GraphReplay(ellipse), terse.CompactPoseSlam(thresholds.options())
    assert sum(len(pose.loops) for pose in replay) == replay.links_offered

    def register(candidate, current):
        raise AssertionError("asked, though the loops are given")

    slam = terse.CompactPoseSlam(thresholds.options())
    decisions = [slam.add(pose, register) for pose in replay]
    assert reasons(decisions) == reasons(expected.run(replay)) and slam.links_kept > 0
    by_hand = terse.CompactPoseSlam(thresholds.options())
    for pose in replay:
        by_hand.add_pose(pose.pose_id, pose.odometry, T_world_body=pose.T_world_body, loops=pose.loops)
    np.testing.assert_array_equal(by_hand.trajectory().poses, slam.trajectory().poses)
    tried = [c for d in decisions for c in d.candidates if c.tried]
    assert all(c.measured and c.measured_gain is not None for c in tried)
    with pytest.raises(ValueError):
        by_hand.add_pose(170, terse.RelativePose(169, 170, [0, 0, 1, 0, 0, 0, 1], information=np.ones(6)),
                         loops=[terse.RelativePose(3, 4, [0, 0, 1, 0, 0, 0, 1], information=np.ones(6))])
    assert by_hand.poses_seen == 170


def corridor(loop_to, sigma=0.01):
    """A straight drive of which poses 0 and 12 are kept, and then a loop to one of the others."""
    slam = terse.CompactPoseSlam(terse.CompactOptions(
        2, range=[100, 100, 3], link_covariance=[sigma**2] * 3, min_pose_gain=1e6, min_loop_gain=0.1))
    slam.add_pose(0)
    for k in range(1, 20):
        step = terse.RelativePose(k - 1, k, [1, 0, 0], covariance=[0.01, 0.01, 1e-5])
        loops = [terse.RelativePose(loop_to, k, [k - loop_to, 0, 0], covariance=[sigma**2] * 3)] if k == 19 else []
        priors = [terse.PosePrior(k, [k, 0, 0], covariance=[10, 10, 1])] if k == 12 else []
        decision = slam.add_pose(k, step, loops=loops, priors=priors)
    return slam, decision, next(c for c in decision.candidates if c.tried)


def test_a_loop_to_a_dropped_pose_is_carried_or_brings_it_back():
    slam, decision, link = corridor(0)
    assert (link.accepted, link.pose_id, link.carried_from) == (True, 0, None)
    assert decision.revived == [] and slam.poses_kept == 3
    # The chain of two steps costs a rough loop nothing, and a precise one nearly all.
    slam, decision, link = corridor(2, sigma=0.6)
    assert (link.measured, link.pose_id, link.carried_from) == (True, 0, 2)
    assert decision.revived == [] and slam.poses_kept == 2 + link.accepted
    slam, decision, link = corridor(6)
    assert (link.accepted, link.pose_id, link.carried_from) == (True, 6, None)
    assert decision.verdict == "loop_closed" and decision.revived == [6] and slam.kept_base(6) == 6
    assert slam.poses_kept == 4


def test_what_is_recorded_and_how_many_are_registered(ellipse, thresholds):
    def run(loops=True, **options):
        replay = terse.GraphReplay(ellipse)
        slam = terse.CompactPoseSlam(thresholds.options(strategy="fpfl", **options))
        return slam, [slam.add(pose, replay) for pose in (replay if loops else without_loops(replay))]

    slam, everything = run()
    assert any(not c.tried for d in everything for c in d.candidates)
    for record in ("none", "decisions"):
        twin, decisions = run(record=record)
        assert [d.candidates_found for d in decisions] == [d.candidates_found for d in everything]
        np.testing.assert_array_equal(twin.trajectory().poses, slam.trajectory().poses)
        assert all(c.tried for d in decisions for c in d.candidates)
        assert any(d.candidates for d in decisions) == (record == "decisions")
    wide = run(range=[100, 100, 100, 4])[1]
    assert max(sum(not c.tried for c in d.candidates) for d in wide) == 16 < max(d.candidates_found for d in wide)
    for loops in (True, False):
        for most in (1, 3):
            tried = [d.registrations_tried for d in run(loops, max_registrations=most, min_loop_gain=0.01)[1]]
            assert max(tried) == most
    with pytest.raises(ValueError):
        terse.CompactPoseSlam(thresholds.options(max_registrations=0))


@pytest.mark.parametrize("factor", [1, 30])
def test_calibrating_information(factor):
    """Measurements that are 30 times better than one constant says; and such as it says."""
    graph = square(9)[0]
    stated = terse.PoseGraph(2)
    stated.add_poses(graph.ids)
    edges = graph.edges()
    stated.add_edges(edges.from_ids, edges.to_ids, edges.T_from_to, covariance=np.array([0.05, 0.05, 0.01]) ** 2 * factor**2)
    calibrated, report = terse.calibrate_information(stated)
    after, before = calibrated.edges().information, stated.edges().information
    assert calibrated.num_factors == stated.num_factors and report.loops_left_out == 0
    if factor == 1:
        assert report.verdict == "consistent" and report.odometry_scale == report.loop_scale == (1, 1)
        np.testing.assert_array_equal(after, before)
    else:
        assert report.verdict == "contradicted" and "instead of the stated" in report.message
        loops = np.abs(edges.from_ids - edges.to_ids) > 1
        for scale, of in ((report.odometry_scale, ~loops), (report.loop_scale, loops)):
            # A hundred loops do not tell well what comes of odometry and what of loops.
            assert np.all(np.array(scale) * factor > 0.5) and np.all(np.array(scale) * factor < 2)
            np.testing.assert_allclose(after[of][:, 0, 0] * scale[0] ** 2, before[of][:, 0, 0], rtol=1e-9)
            np.testing.assert_allclose(after[of][:, 2, 2] * scale[1] ** 2, before[of][:, 2, 2], rtol=1e-9)
    assert (report.odometry_estimate == report.odometry_scale) == (factor != 1)
    with pytest.raises(ValueError):
        terse.calibrate_information(terse.PoseGraph(2))


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
    inputs = without_loops(replay)
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


def test_budgets(ellipse):
    options = terse.select_thresholds(ellipse).options(strategy="bounded", poses_per_area=2.0, keep_links=0.1)
    assert options.poses_per_area == 2 and options.keep_links == 0.1 and options.error is None
    sparse = terse.CompactPoseSlam(options)
    sparse.run(terse.GraphReplay(ellipse))
    options.poses_per_area = 8
    options.keep_links = None
    dense = terse.CompactPoseSlam(options)
    dense.run(terse.GraphReplay(ellipse))
    assert sparse.poses_kept < dense.poses_kept
    options.error = 1.2
    with pytest.raises(ValueError, match="contradict"):
        terse.CompactPoseSlam(options)
    options.poses_per_area = None
    assert terse.CompactPoseSlam(options).options.error == 1.2
