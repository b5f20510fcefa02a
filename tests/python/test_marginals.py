import numpy as np
import pytest

import terse
from conftest import square

ANCHOR = 1e8


def dense_covariance(graph, poses):
    """H^-1 of a graph in the plane by numpy: Jacobians by central differences, the first pose anchored."""
    n, edges = len(poses), graph.edges()
    H = np.zeros((3 * n, 3 * n))
    H[:3, :3] = ANCHOR * np.eye(3)

    def residual(k, a, b):
        E = np.linalg.inv(terse.to_matrices(edges.T_from_to[k])) @ np.linalg.inv(a) @ b
        return np.array([E[0, 2], E[1, 2], np.arctan2(E[1, 0], E[0, 0])])

    step = 1e-6
    moves = [terse.to_matrices(step * sign * axis) for axis in np.eye(3) for sign in (1, -1)]
    T = terse.to_matrices(poses)
    for k, (i, j) in enumerate(zip(edges.from_ids, edges.to_ids)):
        A = np.zeros((3, 3 * n))
        for axis in range(3):
            plus, minus = moves[2 * axis], moves[2 * axis + 1]
            A[:, 3 * i + axis] = (residual(k, T[i] @ plus, T[j]) - residual(k, T[i] @ minus, T[j])) / (2 * step)
            A[:, 3 * j + axis] = (residual(k, T[i], T[j] @ plus) - residual(k, T[i], T[j] @ minus)) / (2 * step)
        H += A.T @ edges.information[k] @ A
    return np.linalg.inv(H)


@pytest.fixture(scope="module")
def solved():
    graph, _ = square()
    solution = terse.solve(graph)
    return graph, solution, dense_covariance(graph, solution.poses)


def close(actual, expected):
    np.testing.assert_allclose(actual, expected, atol=1e-6 * np.abs(expected).max())


def test_blocks_against_the_dense_inverse(solved):
    graph, solution, dense = solved
    for marginals in (solution.marginals(), terse.Marginals(graph, solution.poses), terse.Marginals(solution.graph())):
        blocks = marginals.marginals()
        assert blocks.shape == (80, 3, 3) and marginals.ids.tolist() == graph.ids.tolist()
        for k in range(80):
            close(blocks[k], dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3])
        np.testing.assert_allclose(marginals.marginal(33), blocks[33], rtol=1e-9, atol=1e-16)
        np.testing.assert_allclose(marginals.marginals([50, 3]), blocks[[50, 3]], rtol=1e-9, atol=1e-16)
        close(marginals.cross(10, 70), dense[30:33, 210:213])
        close(marginals.column(70, [10, 71])[1], dense[213:216, 210:213])
        rows = np.r_[60:63, 15:18, 9:12]
        close(marginals.joint([20, 5, 3]), dense[np.ix_(rows, rows)])
        with pytest.raises(ValueError):
            marginals.marginal(1000)


def test_relative_and_conventions(solved):
    _, solution, dense = solved
    marginals = solution.marginals()
    T = np.linalg.inv(terse.to_matrices(solution.pose(20))) @ terse.to_matrices(solution.pose(45))

    def adjoint(T):
        return np.array([[T[0, 0], T[0, 1], T[1, 2]], [T[1, 0], T[1, 1], -T[0, 2]], [0, 0, 1]])

    J = np.hstack([-adjoint(np.linalg.inv(T)), np.eye(3)])
    rows = np.r_[60:63, 135:138]
    expected = J @ dense[np.ix_(rows, rows)] @ J.T
    close(marginals.relative(20, 45), expected)
    close(marginals.relative(20, 45, frame="world"), adjoint(T) @ expected @ adjoint(T).T)
    order = [2, 0, 1]
    close(marginals.marginal(9, order="rotation_first"), marginals.marginal(9)[np.ix_(order, order)])
    R = np.eye(3)
    R[:2, :2] = T[:2, :2]
    close(marginals.relative(20, 45, frame="world_axes"), R @ expected @ R.T)
    with pytest.raises(ValueError, match="frame: expected one of body, world, world_axes"):
        marginals.marginal(9, frame="sky")


def test_position_covariances(solved):
    _, solution, _ = solved
    blocks = solution.marginals().marginals()
    world = terse.position_covariances(solution.poses, blocks)
    for k in (0, 17, 79):
        R = terse.to_matrices(solution.poses[k])[:2, :2]
        np.testing.assert_allclose(world[k], R @ blocks[k, :2, :2] @ R.T, rtol=1e-12)
    outline = terse.ellipse([1, 2], world[17])
    offset = outline - [1, 2]
    distance = np.einsum("ni,ij,nj->n", offset, np.linalg.inv(world[17]), offset)
    np.testing.assert_allclose(distance, -2 * np.log(0.05), rtol=1e-9)
    with pytest.raises(ValueError, match="expected shape"):
        terse.position_covariances(solution.poses, blocks[:5])


def test_incremental_marginals_follow_the_solver():
    graph, _ = square()
    solver = terse.IncrementalSolver(2)
    marginals = terse.IncrementalMarginals(solver)
    paths = set()

    def compare(index, count, report):
        if index % 9 != 0 and index < 60:
            return
        now = terse.Marginals(solver.graph(), solver.linearization_points())
        np.testing.assert_allclose(marginals.marginals(), now.marginals(), rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(marginals.newest(), now.marginal(int(solver.ids[-1])), rtol=1e-6, atol=1e-12)

    steps = len(graph)
    edges = graph.edges()
    solver.update(poses={0: [0, 0, 0]})
    for k in range(1, steps):
        report = solver.update(poses=[k], factors=[graph.factor(int(i)) for i in edges.factor_ids[edges.to_ids == k]])
        paths.add(marginals.update().path)
        compare(k, steps, report)
    assert "propagated" in paths and paths <= {"none", "propagated", "downdated", "recursion"}
    assert marginals.newest_column().shape == (80, 3, 3)
    del solver  # the marginals keep it
    assert marginals.marginal(40).shape == (3, 3)


def test_space(ellipse):
    marginals = terse.solve(ellipse).marginals()
    blocks = marginals.marginals()
    joint = marginals.joint(ellipse.ids[:4])
    assert blocks.shape == (170, 6, 6) and joint.shape == (24, 24)
    for k in range(4):
        np.testing.assert_allclose(joint[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], blocks[k], rtol=1e-8, atol=1e-15)
