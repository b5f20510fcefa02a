"""The typed stubs say what the module holds."""

import ast
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import terse
from terse import _terse

PACKAGE = Path(terse.__file__).parent
HERE = Path(__file__).parent


def require_mypy():
    return pytest.importorskip("mypy", reason="mypy is not installed")


def check(folder, *arguments):
    """Runs a checker of mypy in a folder for what it leaves behind."""
    environment = {**os.environ, "MYPYPATH": str(PACKAGE.parent), "PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run(
        [sys.executable, "-m", *map(str, arguments)], capture_output=True, text=True, cwd=folder, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_stubtest(tmp_path):
    require_mypy()
    allowed = HERE / "stubtest_allowlist.txt"
    check(tmp_path, "mypy.stubtest", "terse", "--allowlist", allowed, "--ignore-unused-allowlist")


def signature_of(text):
    """Names of the arguments in the first line of a docstring of pybind11, `*` included."""
    arguments = re.match(r"\w+\((.*)\) -> ", text.splitlines()[0]).group(1)
    names, depth = [], 0
    for part in re.split(r"([\[\](),])", arguments):
        depth += part in ("[", "(")
        depth -= part in ("]", ")")
        name = part.split(":")[0].strip()
        if depth == 0 and (re.fullmatch(r"\w+|\*", name) and (":" in part or name in ("*", "self"))):
            names.append(name)
    return names


def arguments_of(node):
    names = [argument.arg for argument in node.args.args]
    only = [argument.arg for argument in node.args.kwonlyargs]
    return names + (["*"] + only if only else [])


def functions_of_stub():
    for node in ast.parse((PACKAGE / "_terse.pyi").read_text()).body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, getattr(_terse, node.name), node
        elif isinstance(node, ast.ClassDef):
            cls = getattr(_terse, node.name)
            for child in node.body:
                if isinstance(child, ast.FunctionDef) and not child.decorator_list:
                    yield f"{node.name}.{child.name}", getattr(cls, child.name), child


def test_arguments_are_those_of_the_module():
    """What stubtest cannot see: signatures of compiled functions are in their docstrings only."""
    compared = 0
    for name, function, node in functions_of_stub():
        runtime = signature_of(function.__doc__)
        if "**kwargs" in function.__doc__.splitlines()[0]:
            continue
        stub = [argument.lstrip("_") for argument in arguments_of(node)]
        if "arg0" not in runtime:  # a special method
            assert stub == runtime, name
        compared += 1
    assert compared > 80


def test_options_by_keyword_are_the_attributes():
    for name, node in [(n, node) for n, _, node in functions_of_stub() if n.endswith(("Options.__init__", ".options"))]:
        cls = getattr(_terse, name.split(".")[0] if name.endswith("__init__") else "CompactOptions")
        settable = {key for key, value in vars(cls).items() if isinstance(value, property) and value.fset}
        assert {argument.arg for argument in node.args.kwonlyargs} == settable


def test_public_names():
    public = {name for name in vars(_terse) if not name.startswith("_")}
    assert public <= set(terse.__all__)
    for name in terse.__all__:
        assert hasattr(terse, name)
        if inspect.isclass(getattr(terse, name)):
            assert getattr(terse, name).__module__ == "terse"
    assert (PACKAGE / "py.typed").exists()


def test_typed_use(tmp_path):
    """A program that uses the package type-checks strictly; wrong uses are found, else their `ignore` is an error."""
    require_mypy()
    program = tmp_path / "program.py"
    program.write_text(
        "import terse\n"
        "from typing import Optional\n"
        "def register(a: int, b: int) -> Optional[terse.RelativePose]: return None\n"
        "graph = terse.read_graph('a.g2o')\n"
        "slam = terse.CompactPoseSlam(terse.select_thresholds(graph).options(strategy='fpfl'))\n"
        "verdict: str = slam.add_pose(0, None, register).verdict\n"
        "sigma: float = float(terse.solve(graph, robust='gnc').marginals().marginal(3)[0, 0])\n"
        "kept: int = terse.compact(graph, strategy='fpfl').poses_kept\n"
        "edges: int = sum(edge.to_id for edge in graph.edges()) + sum(graph)\n"
        "try: terse.read_graph('b.g2o')\n"
        "except OSError as error: where = error.filename\n"
        "terse.compact(graph, strategy='rfpfl')  # type: ignore[arg-type]\n"
        "terse.solve(graph, robust='best')  # type: ignore[arg-type]\n"
        "slam.add_pose(0, None, terse.evaluate)  # type: ignore[arg-type]\n"
    )
    check(tmp_path, "mypy", "--strict", program)
