#!/usr/bin/env python3
"""Counts the instructions of some runs under valgrind and compares them with those in expected.json.

check.py RUNNER [--update] [--expected FILE]

Counts repeat where times do not. More than 3 % above what is expected is a failure; `--update` writes the counts as they
are now. valgrind's processor is the same on every machine with AVX2; what is expected is stored for the kernels that ran.
"""

import argparse
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

RUNS = ["incremental-2d", "incremental-3d", "batch", "covariances", "compact"]
TOLERANCE = 0.03


def count(runner, run, kernels):
    """Instructions in millions, and the kernels that ran."""
    environment = dict(os.environ, TERSE_KERNELS=kernels)
    command = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null", str(runner), run]
    result = subprocess.run(command, env=environment, capture_output=True, text=True)
    found = re.search(r"I\s+refs:\s*([\d,]+)", result.stderr)
    if result.returncode != 0 or not found:
        sys.exit(f"{' '.join(command)} failed with status {result.returncode}:\n{result.stdout}{result.stderr}")
    return int(found.group(1).replace(",", "")) / 1e6, result.stdout.split()[-1]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runner", type=pathlib.Path)
    parser.add_argument("--update", action="store_true")
    parser.add_argument("--expected", type=pathlib.Path, default=pathlib.Path(__file__).with_name("expected.json"))
    arguments = parser.parse_args()
    expected = json.loads(arguments.expected.read_text()) if arguments.expected.exists() else {}
    failed = False
    if shutil.which("valgrind") is None:
        sys.exit("valgrind is not installed; on Debian: apt-get install valgrind")
    for kernels in ["avx2", "baseline"] if arguments.update else ["avx2"]:
        for run in RUNS:
            now, used = count(arguments.runner, run, kernels)
            before = expected.get(used, {}).get(run)
            change = f", {100 * (now / before - 1):+.1f} %" if before else ""
            print(f"{run}: {now:.1f} million instructions ({used}){change}", flush=True)
            if arguments.update:
                expected.setdefault(used, {})[run] = round(now, 1)
            elif before is None:
                failed = True
                print(f"  {arguments.expected} has no count for this run with these kernels")
            elif now > before * (1 + TOLERANCE):
                failed = True
                print(f"  more than {100 * TOLERANCE:.0f} % above the {before:.1f} of {arguments.expected}. "
                      "Where that is meant: make instructions-update")
            elif now < before * (1 - TOLERANCE):
                print("  a gain: make instructions-update keeps it")
    if arguments.update:
        arguments.expected.write_text(json.dumps(expected, indent=2) + "\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
