"""What can be printed, copied, pickled and iterated over."""

import copy
import os
import pickle
import re

import numpy as np
import pytest

import terse
from conftest import square

PRIOR = {2: [1, 2, 0.5], 3: [1, 2, 3, 0, 0, 0, 1]}


def graph_in(dimension, ellipse):
    """With a gap in the factor ids, priors, a fixed pose and one without a value."""
    graph = ellipse.copy() if dimension == 3 else square()[0]
    n = 3 * dimension - 3
    graph.add_factor(terse.PosePrior(5, PRIOR[dimension], covariance=np.full(n, 0.1)))
    removed = graph.add_factor(terse.PositionPrior(6, np.ones(dimension), information=np.ones(dimension)))
    graph.add_factor(terse.PositionPrior(7, np.ones(dimension), information=np.ones(dimension), p_body=np.ones(dimension)))
    graph.remove_factor(removed)
    graph.remove_factor(3)
    graph.add_pose(7000, PRIOR[dimension], fixed=True)
    graph.add_pose(7001)
    return graph


def state(value):
    return value.__getstate__()


def made(ellipse):
    """An object of every public class that is a value, or can be saved."""
    graph = square()[0]
    solution = terse.solve(graph)
    solver = terse.IncrementalSolver(2)
    terse.replay(graph, solver)
    solver.update(poses=[90], factors=[terse.RelativePose(79, 90, [1, 0, 0], covariance=np.full(3, 0.01))])
    run = terse.compact(graph)
    growing = terse.IncrementalMarginals(solver)
    loose = terse.PoseGraph(2)
    loose.add_poses([0, 1], np.zeros((2, 3)))
    loose.add_factor(terse.PositionPrior(1, [0, 0], information=[1, 1]))
    (motion, *_) = terse.solve(loose, initial=np.zeros((2, 3))).free_motions
    decision = next(d for d in run.decisions if d.candidates)
    bounded = terse.compact(square(6, offsets=(37, 40, 43, 80), every=1)[0], strategy="bounded")
    evaluation = terse.evaluate(terse.solve(ellipse).poses, ellipse.poses, kitti=True)
    graph_file = terse.read_graph_file(os.path.join(os.path.dirname(__file__), "..", "..", "data", "ellipse.g2o"))
    replay = terse.GraphReplay(graph)
    return [
        next(d.edges[0] for d in bounded.decisions if d.edges), bounded.slam.export(),
        next(iter([pose for d in bounded.decisions for pose in d.retired] + bounded.retired)),
        graph, solution, solver, run, motion, decision, decision.candidates[0], evaluation, evaluation.ate, graph_file,
        graph.edges(), graph.factor(0), graph_in(2, ellipse), ellipse, run.slam, run.slam.export(), run.trajectory(), growing.update(),
        *graph_in(3, ellipse).priors().values(), *graph_in(2, ellipse).priors().values(),
        terse.CompactInput(3, graph.factor(2), loops=[graph.factor(4)], T_world_body=[1, 2, 3]), replay[40],
        terse.CompactOptions(3, min_loop_gain=7, range=[1, 2, 3, 4], strategy="apfl"),
        terse.IncrementalOptions("gni-spo", threads=3, robust="dcs"), terse.select_thresholds(ellipse),
        terse.calibrate_information(graph)[1], terse.Trajectory(np.arange(3), np.zeros((3, 3))),
        run.slam.add_link(terse.RelativePose(0, 79, [0, 1, 0], covariance=np.full(3, 1e-3))),
        solver.update(poses=[91], factors=[terse.RelativePose(90, 91, [1, 0, 0], covariance=np.full(3, 0.01))]),
        long_evaluation().kitti, terse.MapLink(0, 3, 1, 4, [0, 0, 0], covariance=np.full(3, 1e-3)),
    ]


def long_evaluation():
    """Of a straight drive of 900 m, enough for KITTI's segments."""
    poses = np.zeros((901, 7))
    poses[:, 0], poses[:, 6] = np.arange(901), 1
    return terse.evaluate(poses, poses, kitti=True)


def not_values(ellipse):
    solver = terse.IncrementalSolver(2)
    terse.replay(square()[0], solver)
    small = terse.sparsify(ellipse, poses=0.5)
    joint = terse.merge([square()[0], square()[0]], [terse.MapLink(0, 3, 1, 3, [0, 0, 0], covariance=np.full(3, 1e-3))])
    return [terse.GraphReplay(ellipse), terse.solve(ellipse).marginals(), terse.IncrementalMarginals(solver), small, joint,
            joint.maps[1], joint.links[0]]


def test_every_class_says_what_it_holds(ellipse):
    objects = made(ellipse) + not_values(ellipse)
    seen = {type(value).__name__ for value in objects}
    compiled = {name for name in terse.__all__ if isinstance(getattr(terse, name), type(terse.PoseGraph))}
    assert compiled <= seen, compiled - seen
    for value in objects:
        text = repr(value)
        assert re.match(rf"<?terse\.{type(value).__name__}\b.*[>)]$", text) and "object at" not in text, text
        assert re.search(r"\d", text) or isinstance(value, (terse.FreeMotion, terse.InformationCalibration)), text


def test_reprs():
    graph, _ = square(1)
    assert repr(graph) == "<terse.PoseGraph: 2D, 40 poses, 39 factors>"
    assert repr(graph.edges()) == "<terse.Edges: 2D, 39 relative poses>"
    assert repr(terse.RelativePose(3, 4, [1, 0, 0.5], information=np.ones(3))) == "<terse.RelativePose 3 -> 4: [1 0 0.5]>"
    assert repr(terse.PositionPrior(3, [1, 2.25], information=[1, 1])) == "<terse.PositionPrior on 3: [1 2.25]>"
    assert repr(terse.CompactPoseSlam(terse.CompactOptions(3))) == (
        "<terse.CompactPoseSlam: 3D bounded, 0 of 0 poses kept, 0 links>"
    )
    assert repr(terse.IncrementalOptions()) == "terse.IncrementalOptions()"
    options = terse.CompactOptions(3, range=[1, 2, 3, 0.5], record="none", solver=terse.IncrementalOptions(threads=2))
    text = repr(options)
    for part in ("terse.CompactOptions(3, ", "range=[1.0, 2.0, 3.0, 0.5]", "record='none'",
                 "solver=terse.IncrementalOptions(threads=2)"):
        assert part in text
    # They read back.
    again = eval(text)
    assert state(again) == state(options)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_graph_comes_back_to_the_last_bit(dimension, ellipse):
    graph = graph_in(dimension, ellipse)
    for again in (pickle.loads(pickle.dumps(graph)), copy.copy(graph), copy.deepcopy(graph)):
        assert state(again) == state(graph)
        assert again.ids.tolist() == graph.ids.tolist() and again.fixed.tolist() == graph.fixed.tolist()
        np.testing.assert_array_equal(again.poses, graph.poses)
        assert list(again.factors()) == list(graph.factors())
        # It is a graph like the other: the next factor has the same id, and the other does not change.
        link = terse.RelativePose(0, 2, PRIOR[dimension], information=np.ones(3 * dimension - 3))
        before = graph.num_factors
        assert again.add_factor(link) == graph.copy().add_factor(link)
        assert graph.num_factors == before


def test_values_come_back_from_pickles_and_copies(ellipse):
    for value in made(ellipse):
        for again in (pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)):
            assert type(again) is type(value) and repr(again) == repr(value)
            if isinstance(state(value), bytes):
                assert state(again) == state(value)
    for value in not_values(ellipse):
        with pytest.raises(TypeError, match="pickle"):
            pickle.dumps(value)


def test_attributes_come_back(ellipse):
    plain = (int, float, str, bool, type(None))
    for value in made(ellipse):
        again = pickle.loads(pickle.dumps(value))
        for name in (n for n, member in vars(type(value)).items() if isinstance(member, property)):
            a, b = getattr(value, name), getattr(again, name)
            if isinstance(a, plain):
                assert a == b, (value, name)
            elif isinstance(a, np.ndarray):
                np.testing.assert_array_equal(a, b)


def test_a_solver_and_a_map_go_on_from_pickles():
    graph, _ = square()
    solver = terse.IncrementalSolver(2)
    terse.replay(graph, solver)
    slam = terse.compact(graph).slam
    link = terse.RelativePose(79, 100, [1, 0, 0.1], covariance=np.full(3, 0.01))
    for value, grow in (
        (solver, lambda s: (s.update(poses=[100], factors=[link]), s.estimates())[1]),
        (slam, lambda s: (s.add_pose(100, link), s.trajectory().poses)[1]),
    ):
        again = pickle.loads(pickle.dumps(value))
        np.testing.assert_array_equal(grow(value), grow(again))


@pytest.mark.parametrize("robust", ["none", "cauchy", "gnc"])
def test_a_solution_makes_its_covariances_again(robust):
    graph, _ = square()
    graph.add_factor(terse.RelativePose(5, 60, [30, 30, 2], information=[400, 400, 1e4]))
    solution = terse.solve(graph, robust=robust)
    again = pickle.loads(pickle.dumps(solution))
    np.testing.assert_array_equal(again.poses, solution.poses)
    assert again.graph().chi2() == solution.graph().chi2()
    np.testing.assert_allclose(again.marginals().marginals(), solution.marginals().marginals(), rtol=1e-6, atol=1e-12)
    # And one whose factor was given away before it was pickled.
    late = copy.copy(solution)
    np.testing.assert_allclose(late.marginals().marginal(70), solution.marginals().marginal(70), rtol=1e-6)


def test_pickles_of_no_use_are_refused():
    graph, _ = square(1)
    whole = state(graph)
    for wrong in (b"", b"no state", whole[:-1], whole[:-1] + bytes([whole[-1] ^ 1]), state(graph.factor(0))):
        with pytest.raises(ValueError, match="the pickle is of no use here"):
            terse.PoseGraph.__new__(terse.PoseGraph).__setstate__(wrong)


@pytest.mark.parametrize("dimension", [2, 3])
def test_iteration_over_poses_and_edges(dimension, ellipse):
    graph = graph_in(dimension, ellipse)
    assert list(graph) == graph.ids.tolist()
    assert [pose_id for pose_id, _ in graph.items()] == graph.ids.tolist()
    for (pose_id, pose), row in zip(graph.items(), graph.poses):
        if pose is None:
            assert np.isnan(row).all() and graph[pose_id] is None
        else:
            np.testing.assert_array_equal(pose, row)
            np.testing.assert_array_equal(graph[pose_id], row)
    assert dict(graph.items())[7001] is None
    with pytest.raises(KeyError, match="pose 123456 is not in the graph"):
        graph[123456]

    edges = graph.edges()
    assert len(list(edges)) == len(edges)
    for k, edge in enumerate(edges):
        assert (edge.from_id, edge.to_id) == (edges.from_ids[k], edges.to_ids[k])
        np.testing.assert_array_equal(edge.T_from_to, edges.T_from_to[k])
        np.testing.assert_array_equal(edge.information, edges.information[k])
    assert edges[-1].to_id == edges.to_ids[-1]
    with pytest.raises(IndexError):
        edges[len(edges)]
    # What was asked for stays as it was.
    graph.remove_factor(int(edges.factor_ids[0]))
    assert edges[0].from_id == edges.from_ids[0]

    factors = graph.factors()
    assert len(factors) == graph.num_factors and list(factors) == sorted(factors)
    assert {key: repr(value) for key, value in factors.items() if key in graph.priors()} == {
        key: repr(value) for key, value in graph.priors().items()
    }
