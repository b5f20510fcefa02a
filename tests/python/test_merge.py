import csv
import json

import numpy as np
import pytest

import terse


@pytest.fixture
def team(command, tmp_path):
    """Two robots, a fifth of the links between them wrong."""
    command("generate", "manhattan", "--robots", 2, "--poses", 300, "--seed", 7, "--outliers", 20, "--outliers-list",
            tmp_path / "wrong.csv", "--output", tmp_path)
    return tmp_path


def robots(team):
    return [terse.read_graph(team / f"robot_{k}.g2o") for k in (1, 2)]


def links_of(path):
    """The file of links as objects, maps counted from 0."""
    links = []
    for line in path.read_text().splitlines():
        _, a, b, *numbers = line.split()
        x, y, theta, *upper = map(float, numbers)
        information = np.zeros((3, 3))
        information[np.triu_indices(3)] = upper
        information = information + np.triu(information, 1).T
        (from_map, from_id), (to_map, to_id) = [map(int, end.split(":")) for end in (a, b)]
        links.append(terse.MapLink(from_map - 1, from_id, to_map - 1, to_id, [x, y, theta], information=information))
    return links


def test_joins_graphs_and_says_which_links_are_wrong(team):
    joint = terse.merge(robots(team), links_of(team / "links.txt"), retire_share=0)
    with open(team / "wrong.csv") as file:
        wrong = {tuple(map(int, row)) for row in list(csv.reader(file))[1:]}
    assert wrong
    for link in joint.links:
        is_wrong = (link.from_map + 1, link.from_id, link.to_map + 1, link.to_id) in wrong
        assert link.verdict == ("inconsistent" if is_wrong else "accepted")
        assert link.agreeing is not None and link.innovation is not None
    first, second = joint.maps
    assert (first.placement, first.id_offset) == ("reference", 0)
    assert (second.placement, second.id_offset) == ("links", 1000)
    assert second.T_joint_map.shape == (3,) and np.linalg.eigvalsh(second.covariance)[0] > 0
    assert not first.covariance.any()
    assert first.kept == first.poses == 300 and joint.poses_before == len(joint.graph.ids) == 600
    assert joint.retired == [] and joint.chi2 == pytest.approx(joint.chi2_before)
    assert "2 of 2 maps" in repr(joint) and "links" in repr(second) and "0:" in repr(joint.links[0])


def test_is_what_the_command_does(team, command):
    for k in (1, 2):
        command("compact", team / f"robot_{k}.g2o", "--output", team / f"map_{k}", "--quiet")
    folders = [team / "map_1", str(team / "map_2")]
    command("merge", *folders, "--links", team / "links.txt", "--output", team / "joint", "--quiet")
    stats = json.loads((team / "joint" / "stats.json").read_text())
    joint = terse.merge(folders, team / "links.txt", threads=2)
    assert joint.chi2 == stats["chi2"] and len(joint.retired) == stats["retired"] > 0
    np.testing.assert_array_equal(joint.graph.ids, terse.read_graph(team / "joint" / "compact.g2o").ids)
    np.testing.assert_array_equal(joint.maps[1].T_joint_map, stats["maps"][1]["T_joint_map"])
    accepted = sum(link.verdict == "accepted" for link in joint.links)
    assert accepted == stats["links_accepted"] < len(joint.links)
    maps = [terse.read_compact_map(folder + "/graph.json") for folder in map(str, folders)]
    again = terse.merge(maps, links_of(team / "links.txt"), options=terse.read_thresholds(team / "map_1" / "thresholds.json"))
    assert again.chi2 == pytest.approx(joint.chi2, rel=1e-9)


def test_a_robot_goes_on(team):
    joint = terse.merge(robots(team), team / "links.txt")
    assert joint.dimension == joint.map.dimension == 2 and joint.map.strategy == "bounded"
    slam = terse.CompactPoseSlam.restore(joint.map, joint.options)
    slam.add_pose(300, terse.RelativePose(299, 300, [1, 0, 0], covariance=np.full(3, 1e-3)))
    assert slam.poses_seen == 601
    assert np.isfinite(slam.relative_covariance(300, 1007)).all()


def test_links_are_scaled_as_their_maps_are(team):
    """Of both maps a half: sensors of both robots make a link."""
    maps = [terse.sparsify(graph, links=1.0).map for graph in robots(team)]

    def across():
        joint = terse.merge(maps, team / "links.txt", retire_share=0)
        return {(e.from_id, e.to_id): e.information for e in joint.graph.edges() if (e.from_id < 1000) != (e.to_id < 1000)}

    plain = across()
    for scales in [(1, 7), (7, 1)]:
        for compact, scale in zip(maps, scales):
            compact.loop_scale = (scale, scale)
        scaled = across()
        assert len(set(scaled) & set(plain)) > 5
        for ends in set(scaled) & set(plain):
            np.testing.assert_allclose(scaled[ends], plain[ends] / 25)


def test_says_what_is_wrong(team):
    a, b = robots(team)
    right = terse.MapLink(0, 3, 1, 4, [0, 0, 0], covariance=np.ones(3))
    for maps, links, words in [
        ([a], [right], "two maps or more"),
        ([a, b], [terse.MapLink(0, 3, 2, 4, [0, 0, 0], covariance=np.ones(3))], "there is no map 2"),
        ([a, b], [terse.MapLink(0, 3, 1, 400, [0, 0, 0], covariance=np.ones(3))], "no pose 400"),
        ([a, b], [terse.MapLink(0, 3, 1, 4, [0, 0, 0, 0, 0, 0, 1], covariance=np.ones(6))], "expected 2D, got 3D"),
        ([a, terse.PoseGraph(3)], [right], ""),
    ]:
        with pytest.raises(ValueError, match=words):
            terse.merge(maps, links)
    with pytest.raises(terse.NumericalError, match="nothing holds the maps together"):
        terse.merge([a, b])
    with pytest.raises(terse.FileError, match="folder of a run"):
        terse.merge([team / "robot_1.g2o", b])
    with pytest.raises(terse.FileError, match="missing"):
        terse.merge([a, b], team / "missing.txt")
    with pytest.raises(TypeError):
        terse.merge([a, b], [terse.RelativePose(3, 4, [0, 0, 0], covariance=np.ones(3))])
    with pytest.raises(TypeError):
        terse.merge([a, 3], [right])
    for keywords in ({"threads": 0}, {"pair_quantile": 1}, {"most_compared": 1}, {"retire_share": -1}):
        with pytest.raises(ValueError):
            terse.merge([a, b], [right], **keywords)
    with pytest.raises(ValueError):
        terse.MapLink(0, 3, 1, 4, [0, 0, 0])
    assert repr(right) == "<terse.MapLink 0:3 -> 1:4>"
