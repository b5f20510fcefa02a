import copy
import warnings

import numpy as np
import pytest

import terse
from conftest import square

LINK = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])


def test_dimensions():
    for dimension in (2, 3):
        assert terse.PoseGraph(dimension).dimension == dimension
    with pytest.raises(ValueError, match="2 or 3"):
        terse.PoseGraph(4)


def test_poses_as_rows_and_as_matrices():
    random = np.random.default_rng(2)
    rows = random.standard_normal((5, 7))
    rows[:, 3:] /= np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    graph = terse.PoseGraph(3)
    graph.add_poses([4, 1, 9, 7, 5], rows)
    assert graph.ids.tolist() == [4, 1, 9, 7, 5] and graph.index_of(9) == 2 and 7 in graph and 2 not in graph
    np.testing.assert_array_equal(graph.poses[:, :3], rows[:, :3])
    np.testing.assert_allclose(graph.poses, rows, atol=1e-15)
    graph.set_poses(terse.to_matrices(rows))
    np.testing.assert_allclose(terse.to_matrices(graph.poses), terse.to_matrices(rows), atol=1e-14)

    plane = terse.PoseGraph(2)
    plane.add_poses(np.arange(3), random.standard_normal((3, 3)))
    again = terse.PoseGraph(2)
    again.add_poses(np.arange(3), terse.to_matrices(plane.poses))
    np.testing.assert_allclose(again.poses, plane.poses, atol=1e-15)


def test_poses_without_value_and_fixed_ones():
    graph = terse.PoseGraph(2)
    graph.add_pose(0, [1, 2, 0.5], fixed=True)
    graph.add_pose(1)
    assert graph.fixed.tolist() == [True, False]
    assert np.isnan(graph.poses[1]).all() and graph.poses[0].tolist() == [1, 2, 0.5]
    with pytest.raises(ValueError):
        graph.add_pose(2, fixed=True)
    assert len(graph) == 2


def test_edges_come_back():
    graph, _ = square()
    edges = graph.edges()
    assert len(edges) == graph.num_factors == len(edges.factor_ids)
    again = terse.PoseGraph(2)
    again.add_poses(graph.ids)
    ids = again.add_edges(edges.from_ids, edges.to_ids, edges.T_from_to, information=edges.information)
    np.testing.assert_array_equal(ids, edges.factor_ids)
    np.testing.assert_array_equal(again.edges().information, edges.information)
    np.testing.assert_allclose(edges.information[0], np.diag([400, 400, 1e4]), rtol=1e-12)
    factor = graph.factor(int(ids[3]))
    assert (factor.from_id, factor.to_id) == (3, 4)
    np.testing.assert_array_equal(factor.T_from_to, edges.T_from_to[3])


def test_information_or_covariance():
    covariance = np.array([[2.0, 0.5, 0], [0.5, 1, 0], [0, 0, 3]])
    link = terse.RelativePose(1, 2, [1, 0, 0], covariance=covariance)
    np.testing.assert_allclose(link.information, np.linalg.inv(covariance), rtol=1e-14)
    for wrong in ({}, {"information": covariance, "covariance": covariance}):
        with pytest.raises(ValueError, match="either information or covariance"):
            terse.RelativePose(1, 2, [1, 0, 0], **wrong)
    with pytest.raises(ValueError, match="positive definite"):
        terse.RelativePose(1, 2, [1, 0, 0], covariance=-covariance)
    with pytest.raises(ValueError, match=r"expected shape \(3, 3\) or \(3,\), got \(6,\)"):
        terse.RelativePose(1, 2, [1, 0, 0], covariance=np.ones(6))


def test_priors():
    graph = terse.PoseGraph(3)
    graph.add_pose(0)
    first = graph.add_factor(terse.PosePrior(0, LINK, covariance=np.full(6, 0.1)))
    second = graph.add_factor(terse.PositionPrior(0, [1, 2, 3], information=np.eye(3)))
    priors = graph.priors()
    assert list(priors) == [first, second]
    np.testing.assert_array_equal(priors[first].T_world_body, LINK)
    np.testing.assert_array_equal(priors[second].p_world, [1, 2, 3])
    np.testing.assert_array_equal(priors[second].p_body, [0, 0, 0])
    antenna = terse.PositionPrior(0, [1, 2], information=[1, 1], p_body=[0.5, 0])
    np.testing.assert_array_equal(antenna.p_body, [0.5, 0])
    with pytest.raises(ValueError, match="p_body"):
        terse.PositionPrior(0, [1, 2], information=[1, 1], p_body=[0.5, 0, 1])
    assert graph.remove_factor(first) and not graph.remove_factor(first)
    with pytest.raises(ValueError):
        graph.factor(first)


def test_misuse_changes_nothing():
    graph, _ = square(1)
    before = graph.num_factors
    with pytest.raises(ValueError, match="edge 1: "):
        graph.add_edges([0, 0], [1, 77], np.zeros((2, 3)), information=np.ones(3))
    with pytest.raises(ValueError, match="expected 2D, got 3D"):
        graph.add_factor(terse.RelativePose(0, 1, LINK, information=np.ones(6)))
    with pytest.raises(TypeError):
        graph.add_factor("edge")
    with pytest.raises(ValueError):
        graph.add_poses([100, 101, 100])
    with pytest.raises(ValueError, match="unit quaternion"):
        terse.RelativePose(0, 1, np.zeros(7), information=np.ones(6))
    with pytest.raises(ValueError, match="no rotation"):
        terse.RelativePose(0, 1, np.zeros((4, 4)), information=np.ones(6))
    with pytest.raises(ValueError, match="whole numbers"):
        graph.add_poses([0.5])
    assert graph.num_factors == before and len(graph) == 40


def test_copies_are_independent():
    graph, _ = square(1)
    for twin in (graph.copy(), copy.copy(graph), copy.deepcopy(graph)):
        twin.add_pose(1000)
        assert 1000 not in graph and len(twin) == len(graph) + 1


def test_components():
    graph, _ = square(1)
    graph.add_poses([500, 501])
    parts = graph.components()
    assert [len(part) for part in parts] == [40, 1, 1] and parts[1].tolist() == [500]


def test_skipped_tags_are_told(tmp_path):
    graph, truth = square()
    graph.set_poses(truth)
    path = tmp_path / "landmarks.g2o"
    terse.write_graph(graph, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        terse.read_graph(path)
        with path.open("a") as file:
            file.write("PARAMS_CAMERA 1 2 3\n")
        terse.read_graph(path)
    with path.open("a") as file:
        file.write("VERTEX_XY 900 1 1\nFIX 900\n")
    for read in (terse.read_graph, terse.read_graph_file):
        with pytest.warns(UserWarning, match="landmarks.g2o: .*skipped: FIX of such vertices 1, VERTEX_XY 1") as told:
            read(path)
        assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning):
            terse.read_graph(path)
        trajectory = terse.read_trajectory(path)
    assert len(trajectory) == len(graph)


def test_files(tmp_path):
    graph, truth = square()
    graph.set_poses(truth)
    for format in ("g2o", "toro"):
        path = tmp_path / f"square.{format}"
        terse.write_graph(graph, path, format=format)
        file = terse.read_graph_file(str(path))
        assert file.format.lower() == format and file.skipped_tags == {} and file.repaired_informations == 0
        np.testing.assert_array_equal(file.graph.poses, graph.poses)
        np.testing.assert_array_equal(file.graph.edges().T_from_to, graph.edges().T_from_to)
    terse.write_graph(graph, tmp_path / "square.packed", format="packed")
    file = terse.read_graph_file(tmp_path / "square.packed")
    assert file.format == "packed" and np.isnan(file.graph.poses).all()
    np.testing.assert_allclose(file.graph.edges().T_from_to, graph.edges().T_from_to, atol=0.01)
    with pytest.raises(ValueError, match="g2o, toro or packed"):
        terse.write_graph(graph, tmp_path / "x", format="png")


def test_rotation_information(tmp_path, ellipse):
    path = tmp_path / "ellipse.g2o"
    terse.write_graph(ellipse, path)
    radians = terse.read_graph(path, rotation_information="radians").edges().information
    np.testing.assert_allclose(radians[:, 3:, 3:], 4 * ellipse.edges().information[:, 3:, 3:], rtol=1e-12)


def test_trajectories(tmp_path, ellipse):
    trajectory = terse.Trajectory(ellipse.ids, ellipse.poses)
    for format in ("tum", "kitti"):
        terse.write_trajectory(trajectory, tmp_path / format, format=format)
        again = terse.read_trajectory(tmp_path / format)
        assert again.format == format and len(again) == 170
        np.testing.assert_allclose(terse.to_matrices(again.poses), terse.to_matrices(trajectory.poses), atol=1e-12)
    with pytest.raises(ValueError, match="ascending"):
        terse.Trajectory([1, 1], np.zeros((2, 3)))


def test_evaluate(ellipse):
    poses = ellipse.poses
    moved = poses.copy()
    moved[:, :3] += [3, 4, 0]
    same = terse.evaluate(moved, poses)
    assert same.ate.translation_m < 1e-9 and same.poses == 170 and same.kitti is None
    apart = terse.evaluate(terse.Trajectory(ellipse.ids, moved), terse.Trajectory(ellipse.ids, poses), alignment="none")
    assert apart.ate.translation_m == pytest.approx(5) and apart.rpe.translation_m < 1e-9
    with pytest.raises(TypeError):
        terse.evaluate(terse.Trajectory(ellipse.ids, moved), poses)
