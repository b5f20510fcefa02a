"""What pip calls to build the package terse (PEP 517): CMake compiles it, this packs the wheel.

The standard library and CMake are enough, so that `pip install .` works without a network. From the environment:

TERSE_BUILD_DIR  a build folder that has the package already (-D TERSE_BUILD_PYTHON=ON): its target is brought up to
                 date and nothing else is compiled. By default build-pip/ is configured, and kept for the next time.
                 The same as --config-settings build-dir=...
CMAKE_ARGS       more arguments for the configuration of build-pip/.
"""

import base64
import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUFFIX = sysconfig.get_config_var("EXT_SUFFIX")  # of a compiled module


def version():
    """CMake's, which is the only place that has it."""
    return re.search(r"^project\(terse VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text(), re.MULTILINE).group(1)


def metadata():
    return (
        f"Metadata-Version: 2.1\nName: terse\nVersion: {version()}\n"
        "Summary: Compact pose SLAM: graphs, solvers, covariances and maps of few poses\n"
        "License-File: LICENSE\nRequires-Python: >=3.8\nRequires-Dist: numpy\n"
        "Description-Content-Type: text/markdown\n\n" + (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    )


def run(*arguments):
    # pip hides the packages of the interpreter from what it starts, by PYTHONPATH.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    try:
        subprocess.run([str(argument) for argument in arguments], check=True, env=environment)
    except FileNotFoundError:
        raise SystemExit(f"{arguments[0]} is missing; on Debian: apt-get install cmake ninja-build g++ pybind11-dev")
    except subprocess.CalledProcessError as error:
        raise SystemExit(f"{' '.join(error.cmd)} failed, see above")


def configure(build):
    """A build folder of the package alone, for this interpreter."""
    generator = ["-G", "Ninja"] if shutil.which("ninja") and not (build / "CMakeCache.txt").exists() else []
    parts = [f"-DTERSE_BUILD_{part}=OFF" for part in ("COMMAND", "TESTS", "FRONTEND", "BENCHMARKS")]
    run("cmake", "-S", ROOT, "-B", build, *generator, "-DCMAKE_BUILD_TYPE=Release", *parts, "-DTERSE_BUILD_PYTHON=ON",
        "-DTERSE_PYTHON_WHEEL=ON", f"-DTERSE_PYTHON={sys.executable}", *shlex.split(os.environ.get("CMAKE_ARGS", "")))


def stage(folder, settings):
    """Compiles the package and puts it into a folder, with the libraries of the project beside its module."""
    given = (settings or {}).get("build-dir") or os.environ.get("TERSE_BUILD_DIR")
    build = Path(given).resolve() if given else ROOT / "build-pip"
    if given:
        cache = build / "CMakeCache.txt"
        if not cache.exists() or "TERSE_BUILD_PYTHON:BOOL=ON" not in cache.read_text():
            raise SystemExit(f"{build} is no build folder with -D TERSE_BUILD_PYTHON=ON")
    else:
        configure(build)
    jobs = [] if "CMAKE_BUILD_PARALLEL_LEVEL" in os.environ else ["--parallel", os.cpu_count() or 1]
    run("cmake", "--build", build, "--target", "terse_python", *jobs)
    run("cmake", "--install", build, "--component", "wheel", "--prefix", folder)
    if not (folder / "terse" / f"_terse{SUFFIX}").exists():
        raise SystemExit(f"{build} has a package for another interpreter than {sys.executable}")
    # A wheel has no links: a library has the name by which it is looked for.
    for link in [path for path in (folder / "terse").iterdir() if path.is_symlink()]:
        os.replace(link.resolve(), link)


def write_metadata(folder):
    info = Path(folder) / f"terse-{version()}.dist-info"
    info.mkdir(parents=True)
    interpreter = {"cpython": "cp", "pypy": "pp"}.get(sys.implementation.name, sys.implementation.name)
    python = interpreter + "".join(map(str, sys.version_info[:2]))
    abi = python if interpreter == "cp" else SUFFIX.split(".")[1].replace("-", "_")
    tag = f"{python}-{abi}-{re.sub('[-.]', '_', sysconfig.get_platform())}"
    (info / "METADATA").write_text(metadata(), encoding="utf-8")
    (info / "WHEEL").write_text(f"Wheel-Version: 1.0\nGenerator: terse\nRoot-Is-Purelib: false\nTag: {tag}\n")
    shutil.copyfile(ROOT / "LICENSE", info / "LICENSE")
    return info, tag


def record_of(files, info):
    lines = []
    for name, content in files:
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(content)}\n")
    return "".join(lines) + f"{info.name}/RECORD,,\n"


# --- What pip calls.


def get_requires_for_build_wheel(config_settings=None):
    return []


def get_requires_for_build_sdist(config_settings=None):
    return []


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    return write_metadata(metadata_directory)[0].name


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        stage(folder, config_settings)
        info, tag = write_metadata(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        files = [(path.relative_to(folder).as_posix(), path.read_bytes()) for path in paths]
        name = f"terse-{version()}-{tag}.whl"
        with zipfile.ZipFile(Path(wheel_directory) / name, "w", zipfile.ZIP_DEFLATED) as wheel:
            for path, content in files + [(f"{info.name}/RECORD", record_of(files, info).encode())]:
                entry = zipfile.ZipInfo(path)  # of a fixed date: the same content is the same file
                entry.external_attr = (0o755 if ".so" in path else 0o644) << 16
                entry.compress_type = zipfile.ZIP_DEFLATED
                wheel.writestr(entry, content)
        return name


def build_sdist(sdist_directory, config_settings=None):
    name = f"terse-{version()}"
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], check=True, capture_output=True, text=True)
    with tarfile.open(Path(sdist_directory) / f"{name}.tar.gz", "w:gz") as archive:
        for path in filter(None, listed.stdout.split("\0")):
            archive.add(ROOT / path, f"{name}/{path}")
        with tempfile.TemporaryDirectory() as scratch:
            info = Path(scratch) / "PKG-INFO"
            info.write_text(metadata(), encoding="utf-8")
            archive.add(info, f"{name}/PKG-INFO")
    return f"{name}.tar.gz"
