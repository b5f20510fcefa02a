import json

import numpy as np
import pytest

import terse


@pytest.fixture
def walk(command, tmp_path):
    command("generate", "manhattan", "--poses", 150, "--seed", 12, "--output", tmp_path / "walk.g2o")
    return terse.read_graph(tmp_path / "walk.g2o")


def test_keeps_as_much_as_is_asked_for(walk):
    before = walk.poses.copy()
    small = terse.sparsify(walk, links=0.2, poses=60)
    assert small.dimension == 2
    assert small.link_kept.sum() == round(0.2 * len(small.link_ids))
    assert len(small.graph.ids) == 60 and len(small.dropped_ids) == 90
    assert set(small.graph.ids) | set(small.dropped_ids) == set(walk.ids)
    assert set(small.link_from_ids) | set(small.link_to_ids) <= set(walk.ids)
    assert small.poses.shape == small.poses_whole.shape == (150, 3)
    assert small.expected_error > small.expected_error_whole > 0
    assert small.divergence >= 0 and small.dropped_losses.min() >= 0
    assert small.course_links[0] == 0 and small.course_links[-1] == small.link_kept.sum()
    assert small.course_errors[-1] == pytest.approx(small.expected_error)
    assert small.link_worth[small.link_kept].min() > 0
    assert "60 of 150 poses" in repr(small)
    np.testing.assert_array_equal(walk.poses, before)


def test_is_what_the_command_does(walk, command, tmp_path):
    command("sparsify", tmp_path / "walk.g2o", "--links", 30, "--poses", "50%", "--output", tmp_path / "small", "--quiet")
    stats = json.loads((tmp_path / "small" / "stats.json").read_text())
    small = terse.sparsify(walk, links=30, poses=0.5, threads=2)
    assert small.expected_error == stats["expected_error_m"]
    assert small.log_det_lost == stats["log_det_lost_nats"]
    assert small.chi2 == stats["chi2"] and small.chi2_whole == stats["chi2_whole"]
    assert small.exchanges == stats["exchanges"]
    np.testing.assert_array_equal(small.graph.ids, terse.read_graph(tmp_path / "small" / "compact.g2o").ids)


def test_graph_and_map_are_values(walk, tmp_path):
    small = terse.sparsify(walk, links=0.3, poses=0.4)
    terse.write_graph(small.graph, tmp_path / "small.g2o")
    again = terse.solve(terse.read_graph(tmp_path / "small.g2o"), initial="file")
    assert again.chi2 == pytest.approx(small.chi2, rel=1e-6)
    terse.write_compact_map(small.map, tmp_path / "graph.json")
    read = terse.read_compact_map(tmp_path / "graph.json")
    assert read.poses_kept == 60 and len(read) == 150


def test_position_beats_chance(walk):
    position = terse.sparsify(walk, links=0.15).expected_error
    for seed in range(1, 6):
        assert terse.sparsify(walk, links=0.15, criterion="random", seed=seed).expected_error > position
    within = terse.sparsify(walk, budget_error=1.1)
    assert within.expected_error <= 1.1 * within.expected_error_whole
    assert within.link_kept.sum() < len(within.link_kept)


def test_says_what_is_wrong(walk):
    for keywords, words in [
        ({}, "links, poses or budget_error"),
        ({"links": 1.5}, "links: expected a share"),
        ({"links": True}, "links: expected a share"),
        ({"poses": -1}, "poses: expected a share"),
        ({"poses": "half"}, "poses: expected a share"),
        ({"links": 5, "budget_error": 1.1}, "budget_error"),
        ({"links": 5, "criterion": "postion"}, "expected one of position"),
        ({"links": 5, "threads": 0}, "threads"),
    ]:
        with pytest.raises(ValueError, match=words):
            terse.sparsify(walk, **keywords)


def test_progress_can_stop_it(walk):
    told = []
    terse.sparsify(walk, links=0.2, poses=0.5, progress=lambda task, share: told.append((task, share)))
    assert {"optimum", "links", "poses"} == {task for task, _ in told}
    assert all(0 <= share <= 1 for _, share in told)
    with pytest.raises(RuntimeError, match="stopped"):
        terse.sparsify(walk, links=0.2, progress=lambda task, share: task != "links")

    def fail(task, share):
        raise KeyError(task)

    with pytest.raises(KeyError, match="optimum"):
        terse.sparsify(walk, links=0.2, progress=fail)
