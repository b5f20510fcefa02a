"""Everything public is documented; what the guide shows runs."""

import inspect
import re
import subprocess
import sys

import pytest

import terse
from conftest import ROOT


def members(cls):
    own = [(name, value) for name, value in vars(cls).items() if not name.startswith("_")]
    return own + ([("__init__", cls.__init__)] if "__init__" in vars(cls) else [])


def text_of(value):
    """The docstring without the signatures that pybind11 puts in front."""
    lines = (inspect.getdoc(value) or "").splitlines()
    return "\n".join(line for line in lines if not re.match(r"\w+\(.*\) -> ", line)).strip()


def test_everything_public_has_a_docstring():
    missing = []
    for name in terse.__all__:
        value = getattr(terse, name)
        if name == "__version__":
            continue
        if not text_of(value):
            missing.append(name)
        if inspect.isclass(value) and not issubclass(value, Exception) and not hasattr(value, "__dataclass_fields__"):
            missing += [f"{name}.{member}" for member, held in members(value) if not text_of(held)]
    assert missing == []
    assert text_of(terse) and terse.__version__


@pytest.mark.parametrize("name", ["poses", "T_world_body", "information", "covariance", "range"])
def test_arrays_say_their_shapes(name):
    for cls in (terse.PoseGraph, terse.RelativePose, terse.PosePrior, terse.Solution, terse.CompactOptions):
        value = vars(cls).get(name)
        if value is not None:
            assert re.search(r"\[x, y|\(n, |\(d, d\)|\(3,\)", value.__doc__), f"{cls.__name__}.{name}"


def test_the_guide_runs(tmp_path):
    guide = ROOT / "docs" / "python.md"
    blocks = re.findall(r"```python\n(.*?)```", guide.read_text(), re.DOTALL)
    assert len(blocks) >= 3
    script = tmp_path / "guide.py"
    script.write_text("\n".join(blocks))
    (tmp_path / "data").symlink_to(ROOT / "data")
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, env=environment())
    assert done.returncode == 0, done.stderr


def environment():
    import os

    return {**os.environ, "MPLBACKEND": "Agg"}
