"""Compact maps as files: what the command exported is continued here, and the other way round."""

import numpy as np
import pytest

import terse
from conftest import square


def part_of(graph, poses):
    """The first so many poses of a graph, by id, with the edges among them."""
    edges, kept = graph.edges(), np.sort(graph.ids)[:poses]
    inside = np.isin(edges.from_ids, kept) & np.isin(edges.to_ids, kept)
    out = terse.PoseGraph(graph.dimension)
    out.add_poses(kept)
    out.add_edges(
        edges.from_ids[inside], edges.to_ids[inside], edges.T_from_to[inside], information=edges.information[inside]
    )
    return out


@pytest.fixture(params=[2, 3])
def files(request, ellipse, tmp_path):
    """Three graphs on disk, each with more poses of the same run than the one before."""
    graph = ellipse if request.param == 3 else square(4)[0]
    paths = []
    for poses in (len(graph) // 2, 3 * len(graph) // 4, len(graph)):
        paths.append(tmp_path / f"{poses}.g2o")
        terse.write_graph(part_of(graph, poses), paths[-1])
    return paths


def continued(folder, path):
    """What the command would do with `--continue`: the run, and its map with the scales that it began with."""
    before = terse.read_compact_map(folder / "graph.json")
    slam = terse.CompactPoseSlam.restore(
        before, terse.read_thresholds(folder / "thresholds.json", strategy=before.strategy)
    )
    decisions = slam.run(terse.GraphReplay(before.scaled(terse.read_graph(path)), before.ids))
    slam.retire()
    slam.finish()
    after = slam.export()
    after.odometry_scale, after.loop_scale = before.odometry_scale, before.loop_scale
    return slam, decisions, before, after


def write_folder(folder, slam, exported):
    folder.mkdir()
    terse.write_compact_map(exported, folder / "graph.json")
    terse.write_thresholds(slam.options, folder / "thresholds.json")


def test_continues_what_the_command_exported_and_the_command_goes_on(command, files, tmp_path):
    options = ("--quiet", "--calibrate-information", "off", "--robust", "none")
    command("compact", files[0], "--output", tmp_path / "first", *options)
    slam, decisions, before, after = continued(tmp_path / "first", files[1])
    assert 0 < len(decisions) == slam.poses_seen - len(before)
    assert any(d.links_accepted > 0 for d in decisions)
    write_folder(tmp_path / "here", slam, after)

    # The same by the command, to the last bit.
    command("compact", files[1], "--continue", tmp_path / "first", "--output", tmp_path / "second", *options)
    for name in ("graph.json", "thresholds.json"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "second" / name).read_bytes()

    # And the command takes up what was written here.
    for folder in ("here", "second"):
        command("compact", files[2], "--continue", tmp_path / folder, "--output", tmp_path / (folder + "_more"), *options)
    more = [tmp_path / (folder + "_more") / "graph.json" for folder in ("here", "second")]
    assert more[0].read_bytes() == more[1].read_bytes()
    last = terse.read_compact_map(more[0])
    assert len(last) == len(terse.read_graph(files[2])) > len(after) and last.poses_kept > after.poses_kept
    np.testing.assert_array_equal(last.ids[: len(after)], after.ids)


def test_a_map_says_what_the_run_was(ellipse, thresholds, tmp_path):
    slam = terse.CompactPoseSlam(thresholds.options(strategy="apfl"))
    slam.run(terse.GraphReplay(ellipse))
    slam.finish()
    exported, trajectory = slam.export(), slam.trajectory()
    assert exported.dimension == 3 and exported.strategy == "apfl" and len(exported) == slam.poses_seen
    assert (exported.poses_kept, exported.links_kept) == (slam.poses_kept, slam.links_kept)
    for name in ("ids", "kept", "poses"):
        np.testing.assert_array_equal(getattr(exported, name), getattr(trajectory, name))
    assert repr(exported) == (
        f"<terse.CompactMap: 3D, {slam.poses_kept} of {slam.poses_seen} poses kept, {slam.links_kept} links>"
    )
    # A dropped pose is where the way of recovery puts it.
    few = terse.CompactPoseSlam(thresholds.options())
    few.run(terse.GraphReplay(ellipse))
    for recovery in ("v0", "v1", "v2"):
        np.testing.assert_array_equal(few.export(recovery).poses, few.trajectory(recovery).poses)
    assert not np.array_equal(few.export("v0").poses, few.export("v2").poses)


def test_restored_is_as_it_was(ellipse, thresholds, tmp_path):
    slam = terse.CompactPoseSlam(thresholds.options())
    slam.run(terse.GraphReplay(ellipse))
    slam.finish()
    terse.write_compact_map(slam.export(), tmp_path / "map.json")
    again = terse.CompactPoseSlam.restore(terse.read_compact_map(tmp_path / "map.json"), slam.options)
    assert (again.poses_seen, again.poses_kept, again.links_kept) == (slam.poses_seen, slam.poses_kept, slam.links_kept)
    assert again.chi2() == pytest.approx(slam.chi2(), rel=1e-9)
    np.testing.assert_allclose(again.trajectory().poses, slam.trajectory().poses, atol=1e-7)
    with pytest.raises(ValueError, match="expected 3D, got 2D"):
        terse.CompactPoseSlam.restore(slam.export(), terse.CompactOptions(2))


def test_scales_go_with_the_map(tmp_path):
    graph = square(2)[0]
    slam = terse.CompactPoseSlam(terse.select_thresholds(graph).options())
    slam.run(terse.GraphReplay(graph))
    exported = slam.export()
    assert exported.odometry_scale == exported.loop_scale == (1, 1)
    exported.odometry_scale, exported.loop_scale = (2, 0.5), (3, 4)
    terse.write_compact_map(exported, tmp_path / "map.json")
    read = terse.read_compact_map(tmp_path / "map.json")
    assert read.odometry_scale == (2, 0.5) and read.loop_scale == (3, 4)

    plain, scaled = graph.edges(), read.scaled(graph).edges()
    diagonals = [np.diagonal(edges.information, axis1=1, axis2=2) for edges in (plain, scaled)]
    ratio = np.sqrt(diagonals[0] / diagonals[1])
    is_odometry = plain.to_ids - plain.from_ids == 1
    np.testing.assert_allclose(ratio[is_odometry], np.tile([2, 2, 0.5], (is_odometry.sum(), 1)), rtol=1e-12)
    np.testing.assert_allclose(ratio[~is_odometry], np.tile([3, 3, 4], ((~is_odometry).sum(), 1)), rtol=1e-12)
    for wrong in ((0, 1), (1, -1), (np.nan, 1), (1, np.inf)):
        with pytest.raises(ValueError, match="two factors above zero"):
            exported.loop_scale = wrong
    assert exported.loop_scale == (3, 4)


def test_thresholds_read_back_to_the_last_bit(thresholds, tmp_path):
    options = thresholds.options(probability=1 / 3)
    terse.write_thresholds(options, tmp_path / "thresholds.json")
    read = terse.read_thresholds(tmp_path / "thresholds.json", strategy="apfl", min_loop_gain=7)
    assert read.dimension == 3 and read.strategy == "apfl" and read.min_loop_gain == 7
    assert (read.probability, read.min_pose_gain) == (options.probability, options.min_pose_gain)
    for name in ("range", "link_covariance"):
        np.testing.assert_array_equal(getattr(read, name), getattr(options, name))


def test_what_is_wrong_is_said_and_changes_nothing(ellipse, thresholds, tmp_path):
    slam = terse.CompactPoseSlam(thresholds.options())
    slam.run(terse.GraphReplay(ellipse))
    path = tmp_path / "map.json"
    terse.write_compact_map(slam.export(), path)
    text = path.read_text()
    (tmp_path / "no_strategy.json").write_text(text.replace('"strategy":"bounded"', '"strategy":null', 1))
    unknown = terse.read_compact_map(tmp_path / "no_strategy.json")
    assert unknown.strategy is None
    with pytest.raises(ValueError, match="strategy: None, expected that of the run"):
        terse.write_compact_map(unknown, path)
    with pytest.raises(ValueError, match="expected one of apal, apfl, fpfl, rfpfl, bounded, got 'best'"):
        unknown.strategy = "best"
    assert path.read_text() == text

    for wrong, cause in (
        (text.replace('"dimension":3', '"dimension":4', 1), "dimension: 4, expected 2 or 3"),
        (text.replace('"edges"', '"links"', 1), "edges: missing, expected a list"),
        (text.replace('"kept":true', '"kept":1', 1), r"poses\[0\].kept: 1, expected true or false"),
        (text[:-20], "the JSON ends too early"),
    ):
        path.write_text(wrong)
        with pytest.raises(terse.FileError, match=cause) as raised:
            terse.read_compact_map(path)
        assert raised.value.path == str(path)
    with pytest.raises(terse.FileError, match="key \"range\" is missing"):
        (tmp_path / "thresholds.json").write_text('{"dimension": 2}')
        terse.read_thresholds(tmp_path / "thresholds.json")

    alone = terse.PoseGraph(3)
    alone.add_poses([1000, 1001])
    alone.add_edges([1000], [1001], np.array([[1, 0, 0, 0, 0, 0, 1.0]]), covariance=np.ones(6))
    with pytest.raises(ValueError):
        terse.GraphReplay(alone, slam.export().ids)
