"""What `make install` puts below a prefix works without the build folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


def test_installed_package_finds_its_libraries(tmp_path):
    build = os.environ.get("TERSE_BUILD", "")
    cmake = shutil.which("cmake")
    if not build or cmake is None:
        pytest.skip("not run by ctest (TERSE_BUILD)")
    prefix = tmp_path / "prefix"
    done = subprocess.run([cmake, "--install", build, "--prefix", prefix], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (package,) = prefix.rglob("terse/__init__.py")
    assert {path.suffix for path in package.parent.iterdir()} >= {".so", ".pyi", ".py", ".typed"}
    program = (
        "import terse; print(terse.__file__); print(open('/proc/self/maps').read())"
        if Path("/proc/self/maps").exists()
        else "import terse; print(terse.__file__)"
    )
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(package.parent.parent), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(package)) and str(Path(build) / "lib") not in done.stdout
