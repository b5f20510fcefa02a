import pickle

import numpy as np
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
    assert terse.FileError.__module__ == "terse"
    # As others of the operating system's.
    assert isinstance(error, OSError) and error.filename == str(path) and error.strerror == error.cause
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) and (again.path, again.line, again.cause) == (error.path, 2, error.cause)


def test_a_bare_file_error_has_no_file():
    error = terse.FileError("something")
    assert str(error) == "something" and error.filename is None and error.strerror is None and error.errno is None


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


def test_messages_hold_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "bytes.txt"
    for field in (b"\xe01", b"\xff" * 100, "\u00e9".encode() * 40, b"\xf0\x9f\x98", b"\xed\xa0\x80", b"\xc0\x80x"):
        path.write_bytes(b"0 1 2 3 0 0 0 " + field + b"\n")
        with pytest.raises(terse.FileError):
            terse.read_trajectory(str(path))
        path.write_bytes(b"EDGE_SE2 0 1 " + field + b" 0 0 1 0 0 1 0 1\n" + field + b" 1\n")
        with pytest.raises(terse.FileError):
            terse.read_graph(str(path))


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


# Whatever json, csv, numpy and zipfile make of a damaged file.
def test_damaged_run_folders(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    (run / "compact.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    (run / "trajectory.tum").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    assert terse.read_run(run).stats is None

    def refused(name, content):
        path = run / name
        path.write_bytes(content)
        with pytest.raises(terse.FileError) as caught:
            terse.read_run(run)
        assert caught.value.path == str(path) and caught.value.cause
        path.unlink()

    for name in ("stats.json", "thresholds.json"):
        for content in (b"[" * 100000, b'{"a":' * 100000, b'{"a": "\xff\xfe"}', b"", b"{", b"[1]", b"\0" * 100,
                        b'{"a": ' + b"1" * 5000 + b"}"):
            refused(name, content)
    decisions = (b"pose,kept,verdict,pose_gain_nats,candidates,probabilities,gains_nats,measured_gains_nats,innovations,"
                 b"accepted\n")
    for row in (b"\xff,1,kept,,,,,,,", b"0,1,kept,x,,,,,,", b"0,1", b"0,1,kept,,1,,,,,", b"0,1," + b"v" * 200000 + b",,,,,,,",
                b"0\0,1,kept,,,,,,,"):
        refused("decisions.csv", decisions + row + b"\n")
    refused("decisions.csv", b"")
    refused("decisions.csv", b"pose,kept\n")
    refused("loops.csv", b"current,candidate\n0,1\n")
    refused("loops.csv", b"current,candidate,gain_nats,measured_gain_nats,innovation,accepted\n0,x,,,,1\n")
    refused("covariances.csv", b"id,a,b,c\n0,1,2,3\n")
    refused("covariances.csv", b"id,a\n99999999999999999999,1\n")
    for content in (b"", b"PK\3\4", b"\x93NUMPY\1\0\xff\xff", b"PK\3\4" + b"\xff" * 200, b"not an archive"):
        refused("covariances.npz", content)
    np.savez(run / "whole.npz", ids=np.arange(2), covariances=np.zeros((2, 3, 3)))
    whole = (run / "whole.npz").read_bytes()
    for end in range(0, len(whole), 7):
        refused("covariances.npz", whole[:end])
    for arrays in ({"ids": np.arange(2)}, {"ids": np.arange(2), "covariances": np.zeros((3, 3))},
                   {"ids": np.arange(3), "covariances": np.zeros((2, 3, 3))},
                   {"ids": np.array([{}]), "covariances": np.zeros((1, 3, 3))}):
        np.savez(run / "part.npz", **arrays)
        refused("covariances.npz", (run / "part.npz").read_bytes())
    (run / "stats.json").mkdir()
    with pytest.raises(terse.FileError, match="not a regular file"):
        terse.read_run(run)
