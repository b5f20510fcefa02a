import json
import pickle

import numpy as np
import pytest

import terse
from conftest import square


def residuals(graph, poses):
    """Whitened residuals of the edges of a graph in the plane, in plain numpy."""
    edges = graph.edges()
    T = terse.to_matrices(poses)
    a, b = T[edges.from_ids], T[edges.to_ids]
    E = np.linalg.inv(terse.to_matrices(edges.T_from_to)) @ np.linalg.inv(a) @ b
    r = np.stack([E[:, 0, 2], E[:, 1, 2], np.arctan2(E[:, 1, 0], E[:, 0, 0])], axis=1)
    return np.einsum("nji,nj->ni", np.linalg.cholesky(edges.information), r)


def test_against_the_command(command, ellipse, tmp_path):
    path = tmp_path / "ellipse.g2o"
    terse.write_graph(ellipse, path)
    command("solve", path, "--quiet", "--stats", tmp_path / "s.json", "--output", tmp_path / "solved.g2o")
    stats = json.loads((tmp_path / "s.json").read_text())
    solution = terse.solve(ellipse)
    assert solution.converged and solution.termination == stats["termination"] == "converged"
    assert solution.chi2 == stats["chi2"] and solution.iterations == stats["iterations"]
    assert solution.log_determinant == stats["log_determinant"]
    np.testing.assert_array_equal(solution.poses, terse.read_graph(tmp_path / "solved.g2o").poses)


def test_minimum_in_the_plane():
    graph, truth = square()
    solution = terse.solve(graph)
    assert solution.converged and solution.dimension == 2
    assert solution.chi2 == pytest.approx(np.sum(residuals(graph, solution.poses) ** 2), rel=1e-12)
    assert solution.graph().chi2() == pytest.approx(solution.chi2, rel=1e-12)
    # No small step lowers it.
    random = np.random.default_rng(3)
    for _ in range(20):
        step = 1e-4 * random.standard_normal(solution.poses.shape)
        step[0] = 0
        assert np.sum(residuals(graph, solution.poses + step) ** 2) > solution.chi2
    assert terse.evaluate(solution.poses, truth).ate.translation_m < 0.3
    np.testing.assert_array_equal(solution.pose(7), solution.poses[7])


def test_initial_values():
    graph, truth = square()
    solution = terse.solve(graph)
    for method in ("compose", "tree", "chordal"):
        start = terse.initial_values(graph, method)
        assert start.shape == truth.shape
        assert terse.solve(graph, initial=method).chi2 == pytest.approx(solution.chi2, rel=1e-8)
        assert terse.solve(graph, initial=start).chi2 == pytest.approx(solution.chi2, rel=1e-8)
    with pytest.raises(ValueError):  # there are no values in the graph
        terse.solve(graph, initial="file")
    with pytest.raises(ValueError, match="initial: expected one of auto, compose, file, tree, chordal, got 'best'"):
        terse.solve(graph, initial="best")


def test_progress_stops_and_raises(ellipse):
    seen = []
    stopped = terse.solve(ellipse, progress=lambda iteration, chi2: seen.append(chi2) or False)
    assert stopped.termination == "stopped" and len(seen) == 1

    def fail(iteration, chi2):
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        terse.solve(ellipse, progress=fail)


def test_graph_may_change_while_it_is_solved():
    graph, _ = square()
    solution = terse.solve(graph, progress=lambda iteration, chi2: graph.add_pose(10_000 + iteration))
    assert len(solution.poses) == 80 and len(graph) > 80


def test_robust():
    graph, _ = square()
    wrong = graph.add_factor(terse.RelativePose(5, 60, [30, 30, 2], information=[400, 400, 1e4]))
    solution = terse.solve(graph, robust="gnc")
    assert solution.weights[wrong] == 0 and solution.weights.sum() == graph.num_factors - 1
    assert solution.robust_cost < solution.chi2


def test_unobservable():
    graph, _ = square(1)
    graph.add_pose(100)
    graph.add_factor(terse.PositionPrior(100, [0, 0], information=np.eye(2)))
    poses = np.vstack([terse.initial_values(square(1)[0]), np.zeros(3)])
    solution = terse.solve(graph, initial=poses)
    assert solution.termination == "not_positive_definite" and not solution.converged
    assert len(solution.free_motions) > 0
    for fails in (solution.marginals, lambda: terse.Marginals(graph, poses)):
        with pytest.raises(terse.UnobservableError) as caught:
            fails()
        motions = caught.value.motions
        assert 100 in [motion.pose for motion in motions] and motions[0].directions.shape[0] == 3
        again = pickle.loads(pickle.dumps(caught.value))
        assert str(again) == str(caught.value) and str(again.motions[0]) == str(motions[0])
        assert str(motions[0]) and motions[0].freedom in ("floating", "loosely_held", "unmeasured")
    assert issubclass(terse.UnobservableError, terse.NumericalError)


def test_incremental_equals_batch():
    graph, _ = square()
    solver = terse.IncrementalSolver(2)
    edges = graph.edges()
    solver.update(poses={0: [0, 0, 0]})
    for k in range(1, len(graph)):
        factors = [graph.factor(int(i)) for i in edges.factor_ids[edges.to_ids == k]]
        report = solver.update(poses=[k], factors=factors)
        assert len(report.factor_ids) == len(factors) and report.seconds > 0
    batch = terse.solve(graph)
    assert solver.chi2() == pytest.approx(batch.chi2, rel=1e-3)
    finished = solver.finish()
    np.testing.assert_allclose(finished.poses, batch.poses, atol=1e-5)
    np.testing.assert_array_equal(solver.estimates(), finished.poses)
    np.testing.assert_array_equal(solver.estimate(7), finished.pose(7))
    assert solver.graph().num_factors == graph.num_factors and solver.ids.tolist() == graph.ids.tolist()

    replayed = terse.IncrementalSolver(2)
    steps = []
    terse.replay(graph, replayed, after_step=lambda index, count, report: steps.append((index, len(replayed))))
    assert len(steps) == 80 and len(replayed) == 80
    np.testing.assert_allclose(replayed.finish().poses, batch.poses, atol=1e-5)


def test_incremental_misuse_and_options():
    graph, _ = square(1)
    solver = terse.IncrementalSolver(2, terse.IncrementalOptions(gate="always", threads=2))
    terse.replay(graph, solver)
    before = solver.estimates()
    with pytest.raises(ValueError):
        solver.update(factors=[terse.RelativePose(0, 777, [0, 0, 0], information=np.ones(3))])
    with pytest.raises(ValueError, match="expected 2D, got 3D"):
        solver.update(factors=[terse.RelativePose(0, 1, [0, 0, 0, 0, 0, 0, 1], information=np.ones(6))])
    with pytest.raises(terse.UnobservableError):
        solver.update(removed=[0])
    np.testing.assert_array_equal(solver.estimates(), before)
    with pytest.raises(TypeError, match="has no option 'gat'"):
        terse.IncrementalOptions(gat="always")
    with pytest.raises(ValueError, match="gate: expected one of"):
        terse.IncrementalOptions(gate="sometimes")
    assert terse.IncrementalOptions("gni-spo").partial


def test_saved_solver_continues(tmp_path):
    graph, _ = square(1)
    solver = terse.IncrementalSolver(2)
    terse.replay(graph, solver)
    solver.save(tmp_path / "state")
    again = terse.IncrementalSolver.load(tmp_path / "state")
    assert again.dimension == 2
    for one in (solver, again):
        one.update(poses=[100], factors=[terse.RelativePose(39, 100, [1, 0, 0.1], covariance=np.full(3, 0.01))])
    np.testing.assert_array_equal(solver.estimates(), again.estimates())
    (tmp_path / "wrong").write_text("nothing of the kind")
    with pytest.raises(terse.FileError, match="not a saved state"):
        terse.IncrementalSolver.load(tmp_path / "wrong")
