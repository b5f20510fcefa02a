"""The examples run and write pictures."""

import os
import subprocess
import sys

import pytest

import terse
from conftest import ROOT

EXAMPLES = ROOT / "examples" / "python"


def run(*arguments, code=0):
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, env=environment)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_compact_slam():
    output = run(EXAMPLES / "compact_slam.py")
    assert "loop_closed" in output and "of 200 poses" in output


@pytest.mark.parametrize("strategy, kind", [("fpfl", "png"), ("apal", "svg")])
def test_analyse_compact(command, ellipse, tmp_path, strategy, kind):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    terse.write_graph(ellipse, tmp_path / "ellipse.g2o")
    folder = tmp_path / "run"
    command("compact", tmp_path / "ellipse.g2o", "--strategy", strategy, "--output", folder, "--quiet")
    picture = tmp_path / f"picture.{kind}" if kind == "svg" else folder / "analysis.png"
    output = run(EXAMPLES / "analyse_compact.py", folder, *(["--output", picture] if kind == "svg" else []))
    assert f"wrote {picture}" in output and "poses kept" in output
    head = picture.read_bytes()[:200]
    assert head.startswith(b"\x89PNG") if kind == "png" else b"<svg" in picture.read_bytes()[:2000]
    assert picture.stat().st_size > 20_000


def test_analyse_compact_says_what_is_missing(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    output = run(EXAMPLES / "analyse_compact.py", tmp_path, code=1)
    assert "compact.g2o" in output and "Traceback" not in output
