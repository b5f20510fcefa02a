import pytest

import terse


def test_file_error_has_path_and_line(tmp_path):
    path = tmp_path / "broken.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 zero\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(terse.FileError) as caught:
        terse.read_graph(path)
    error = caught.value
    assert error.path == str(path) and error.line == 2 and error.cause
    assert str(error) == f"{path}:2: {error.cause}"
    assert isinstance(error, RuntimeError) and terse.FileError.__module__ == "terse"


def test_missing_files_and_folders(tmp_path):
    missing = tmp_path / "missing"
    for fails in (
        lambda: terse.read_graph(missing),
        lambda: terse.read_trajectory(missing),
        lambda: terse.read_run(missing),
        lambda: terse.IncrementalSolver.load(missing),
        lambda: terse.CompactPoseSlam.load(missing),
        lambda: terse.write_graph(terse.PoseGraph(2), missing / "out.g2o"),
    ):
        with pytest.raises(terse.FileError) as caught:
            fails()
        assert caught.value.path.startswith(str(missing)) and caught.value.line == 0


def test_misuse_is_a_value_error():
    for fails in (
        lambda: terse.solve(terse.PoseGraph(2)),
        lambda: terse.select_thresholds(terse.PoseGraph(3)),
        lambda: terse.GraphReplay(terse.PoseGraph(3)),
        lambda: terse.IncrementalSolver(5),
        lambda: terse.IncrementalSolver(2).estimate(0),
        lambda: terse.to_matrices([1, 2]),
    ):
        with pytest.raises(ValueError):
            fails()
