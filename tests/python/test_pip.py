"""`pip install .` with nothing but what is on the machine."""

import base64
import hashlib
import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from conftest import ROOT

PROGRAM = """
import numpy as np, terse
graph = terse.PoseGraph(2)
graph.add_poses(np.arange(4))
graph.add_edges([0, 1, 2, 3], [1, 2, 3, 0], [[1, 0, np.pi / 2]] * 4, covariance=[0.1, 0.1, 0.1])
assert terse.solve(graph).converged and terse.compact(graph, strategy="apal").poses_kept == 4
print(terse.__file__)
print(open("/proc/self/maps").read())
"""


@pytest.fixture
def build():
    folder = os.environ.get("TERSE_BUILD", "")
    if not folder:
        pytest.skip("not run by ctest (TERSE_BUILD)")
    return Path(folder)


@pytest.fixture
def backend():
    spec = importlib.util.spec_from_file_location("terse_backend", ROOT / "python" / "pip" / "terse_backend.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def environment(**more):
    """Without what finds the package in the build folder."""
    return {**{key: value for key, value in os.environ.items() if key != "PYTHONPATH"}, **more}


@pytest.mark.parametrize("isolated", [False, True])
def test_pip_installs_into_a_virtual_environment(build, tmp_path, isolated):
    pytest.importorskip("ensurepip", reason="python3-venv is not installed")
    before = sorted(path.name for path in ROOT.iterdir())
    place = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--system-site-packages", place], check=True)
    python = place / "bin" / "python"
    # Of the build folder that is there: nothing is compiled again.
    done = subprocess.run(
        [python, "-m", "pip", "install", *([] if isolated else ["--no-build-isolation"]), "--no-index", "--no-deps", ROOT],
        capture_output=True, text=True, env=environment(TERSE_BUILD_DIR=str(build)), cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    done = subprocess.run([python, "-c", PROGRAM], capture_output=True, text=True, env=environment(), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(place)) and f"{place}/lib" in done.stdout
    loaded = {line.split()[-1] for line in done.stdout.splitlines() if "terse" in line.split("/")[-1]}
    assert len(loaded) >= 5 and all(path.startswith(str(place)) for path in loaded if path.startswith("/")), loaded
    shown = subprocess.run([python, "-m", "pip", "show", "terse"], capture_output=True, text=True, env=environment())
    assert "Name: terse" in shown.stdout and "Requires: numpy" in shown.stdout
    assert sorted(path.name for path in ROOT.iterdir()) == before


def test_the_wheel_is_what_its_record_says(build, backend, tmp_path):
    name = backend.build_wheel(tmp_path, {"build-dir": str(build)})
    with zipfile.ZipFile(tmp_path / name) as wheel:
        names = wheel.namelist()
        (record,) = [entry for entry in names if entry.endswith("RECORD")]
        listed = [line.rsplit(",", 2) for line in wheel.read(record).decode().splitlines()]
        assert [path for path, _, _ in listed] == names
        for path, digest, size in listed[:-1]:
            content = wheel.read(path)
            sha = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            assert digest == f"sha256={sha}" and int(size) == len(content)
        assert f"terse/_terse{backend.SUFFIX}" in names and "terse/py.typed" in names
        libraries = [path for path in names if path.startswith("terse/libterse_")]
        assert sorted(path.split("_")[1].split(".")[0] for path in libraries) == ["compact", "core", "covariance", "lie"]
        assert "LICENSE" in " ".join(names)
    assert backend.build_wheel(tmp_path, {"build-dir": str(build)}) == name


def test_without_a_build_folder_one_is_configured(backend, tmp_path, monkeypatch):
    """All but the minutes of compiling."""
    monkeypatch.setenv("CMAKE_ARGS", "-D CMAKE_CXX_FLAGS=-DTERSE_OF_CMAKE_ARGS")
    backend.configure(tmp_path / "build")
    cache = (tmp_path / "build" / "CMakeCache.txt").read_text()
    for line in ("TERSE_BUILD_PYTHON:BOOL=ON", "TERSE_BUILD_TESTS:BOOL=OFF", "TERSE_BUILD_COMMAND:BOOL=OFF",
                 "-DTERSE_OF_CMAKE_ARGS", f"={sys.executable}\n"):
        assert line in cache
    plan = subprocess.run(["cmake", "--build", tmp_path / "build", "--target", "help"], capture_output=True, text=True)
    assert "terse_python" in plan.stdout


def test_a_build_folder_of_no_use_is_refused(backend, tmp_path):
    with pytest.raises(SystemExit, match="is no build folder with -D TERSE_BUILD_PYTHON=ON"):
        backend.build_wheel(tmp_path, {"build-dir": str(tmp_path)})
