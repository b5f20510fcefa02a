#!/usr/bin/env python3
"""Runs every command of terse over strategies, gates, kernels and formats, and keeps what it wrote, without times.

    tests/bench/keep_outputs.py build/bin/terse FOLDER [--data ../shared/data] [--journals OTHER_FOLDER]

Two such folders, of two versions of the program, are compared with `diff -r`: a change of structure leaves them equal.
With --journals the journals of OTHER_FOLDER, written by another version, are taken up by this one.
"""

import argparse
import concurrent.futures
import csv
import os
import pathlib
import re
import shutil
import subprocess
import sys

NUMBER = r"-?(?:\d+\.?\d*(?:e[-+]?\d+)?|nan|null)"
TIMES = re.compile(r'"(\w*seconds\w*|peak_rss_mb)":\s*(?:\{[^}]*\}|\[[^\]]*\]|' + NUMBER + ")")
WORDS = re.compile(NUMBER + r" (s|ms|MB|poses/s|frames/s|edges/s)\b")
GATES = ["newton_decrement", "mutual_information", "log_determinant", "loop_closure", "always", "never"]
POLICIES = ["gn1", "gni", "gni-lcg", "gni-igg", "gni-spo", "gni-spo-lcg", "gni-spo-igg"]
KERNELS = ["huber", "cauchy", "tukey", "dcs", "gnc"]


def scrub(path, folder):
    """Blanks the times in a file that a command wrote, and where it was."""
    if path.suffix in (".npz", ".png", ".journal"):
        return
    if path.name == "stdout" and path.parent.name.startswith("sweep"):  # its table has times; it is in sweep.csv too
        path.unlink()
        return
    text = path.read_text().replace(str(folder), "FOLDER")
    if path.suffix == ".csv" and "seconds" in text.split("\n", 1)[0]:
        rows = list(csv.reader(text.splitlines()))
        keep = [i for i, name in enumerate(rows[0]) if "seconds" not in name]
        text = "\n".join(",".join(row[i] for i in keep if i < len(row)) for row in rows) + "\n"
    else:
        text = WORDS.sub(r"T \1", TIMES.sub(r'"\1":T', text))
    path.write_text(text)


def runs(graphs, others):
    """(name, arguments, graph for standard input), where FOLDER/ stands before what a run writes."""
    for scene, graph in graphs.items():
        yield f"info_{scene}", ["info", graph], None
        for start in ("compose", "file", "tree", "chordal"):
            yield f"start_{start}_{scene}", ["solve", graph, "--initial", start, "--output", "out.g2o"], None
        yield f"solve_{scene}", ["solve", graph, "--stats", "s.json", "--trajectory", "t", "--covariances",
                                 "diagonal", "--covariance-output", "c.csv"], None
        steps = ["solve", graph, "--mode", "incremental", "--steps", "steps.csv", "--stats", "s.json", "--trajectory", "t"]
        yield f"steps_{scene}", steps, None
        yield f"edges_{scene}", steps + ["--every", "edge"], None
        for gate in GATES:
            yield f"gate_{gate}_{scene}", steps + ["--gate", gate], None
        for policy in POLICIES:
            yield f"policy_{policy}_{scene}", steps + ["--policy", policy, "--paper-flops"], None
        for kernel in KERNELS:
            yield f"batch_{kernel}_{scene}", ["solve", graph, "--robust", kernel, "--stats", "s.json", "--trajectory",
                                              "t"], None
            yield f"steps_{kernel}_{scene}", steps + ["--robust", kernel], None
            yield f"compact_{kernel}_{scene}", ["compact", graph, "--robust", kernel, "--output", "."], None
        for strategy in ("apal", "apfl", "fpfl", "rfpfl", "bounded"):
            yield f"compact_{strategy}_{scene}", ["compact", graph, "--strategy", strategy, "--output", "."], None
        for name, options in (("bounded_gnc", ["--strategy", "bounded", "--robust", "gnc"]),
                              ("bounded_budget", ["--strategy", "bounded", "--keep-poses", "0.1", "--keep-links", "0.3"]),
                              ("fpfl_budget", ["--keep-poses", "0.2", "--keep-links", "0.2"])):
            yield f"compact_{name}_{scene}", ["compact", graph, *options, "-vv", "--output", "."], None
        for recover in ("v0", "v1"):
            yield f"recover_{recover}_{scene}", ["compact", graph, "--recover", recover, "--composition", "fourth",
                                                 "--record", "decisions", "--output", "."], None
        yield f"convert_{scene}", ["convert", graph, "out.graph"], None
        yield f"covariance_{scene}", ["covariance", graph, "--solve", "--frame", "world", "--output", "c.csv"], None
    for name, graph in others.items():
        yield f"info_{name}", ["info", graph], None
        yield f"solve_{name}", ["solve", graph, "--stats", "s.json", "--trajectory", "t"], None
        yield f"steps_{name}", ["solve", graph, "--mode", "incremental", "--steps", "steps.csv", "--trajectory", "t"], None
        yield f"compact_{name}", ["compact", graph, "--output", "."], None


def after(folder, scenes):
    """Runs on what the ones before them wrote."""
    for scene, graph in scenes.items():
        yield f"online_{scene}", ["online", "--thresholds", f"{folder}/compact_fpfl_{scene}/thresholds.json", "--journal",
                                  "j.journal", "--output", ".", "--covariances"], graph
        yield f"continue_{scene}", ["compact", f"{folder}/graphs/{scene}_more.g2o", "--continue",
                                    f"{folder}/compact_fpfl_{scene}", "--output", "."], None
        yield f"continue_bounded_{scene}", ["compact", f"{folder}/graphs/{scene}_more.g2o", "--continue",
                                            f"{folder}/compact_bounded_{scene}", "--output", "."], None
        pair = [f"{folder}/compact_fpfl_{scene}", f"{folder}/compact_apal_{scene}"]
        yield f"plot_{scene}", ["plot", *pair, "--what", "trajectory", "gains", "--output", "."], None
        yield f"report_{scene}", ["report", *pair, "--output", "report.html"], None
        yield f"evaluate_{scene}", ["evaluate", f"{folder}/compact_fpfl_{scene}/trajectory.tum",
                                    f"{folder}/compact_apal_{scene}/trajectory.tum"], None
        yield f"sweep_{scene}", ["sweep", f"{folder}/graphs/{scene}.g2o", "--threshold", "loop", "--steps", "3", "--csv",
                                 "sweep.csv"], None


def taken_up(folder, journals, scenes):
    for scene in scenes:
        copy = folder / "graphs" / f"{scene}.journal"
        shutil.copyfile(journals / f"online_{scene}" / "j.journal", copy)
        yield f"again_{scene}", ["online", "--thresholds", f"{folder}/compact_fpfl_{scene}/thresholds.json", "--journal",
                                 copy, "--output", "."], f"{folder}/graphs/{scene}_more.g2o"


def run(binary, folder, name, arguments, source):
    place = folder / name
    place.mkdir()
    with open(source or "/dev/null") as stdin:
        done = subprocess.run([binary, *arguments], cwd=place, stdin=stdin, capture_output=True, text=True)
    (place / "stdout").write_text(done.stdout)
    (place / "stderr").write_text(done.stderr)
    (place / "code").write_text(f"{done.returncode}\n")


def make_graphs(binary, folder):
    """Small graphs with what the product meets: loops, wrong loops, two dimensions and three."""
    graphs = {}
    (folder / "graphs").mkdir()
    for scene, poses, outliers in (("ellipse", 170, 0), ("manhattan", 700, 0), ("sphere", 400, 10), ("manhattan", 500, 20)):
        name = f"{scene}_{outliers}" if outliers else scene
        graph = folder / "graphs" / f"{name}.g2o"
        options = ["--outliers", str(outliers)] if outliers else []
        subprocess.run([binary, "generate", scene, "--poses", str(poses), *options, "--output", graph, "--quiet"], check=True)
        graphs[name] = str(graph)
        lines = graph.read_text().splitlines()  # a second part, to continue the map with
        last = max(int(line.split()[1]) for line in lines if line.startswith("VERTEX"))
        shifted = []
        for line in lines:
            words = line.split()
            if words[0].startswith("EDGE") and int(words[2]) == int(words[1]) + 1 and int(words[2]) <= 40:
                words[1:3] = [str(int(words[1]) + last), str(int(words[2]) + last)]
                shifted.append(" ".join(words))
        (folder / "graphs" / f"{name}_more.g2o").write_text("\n".join(shifted) + "\n")
    return graphs


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--data", type=pathlib.Path, help="public graphs, each by default options")
    parser.add_argument("--journals", type=pathlib.Path, help="a folder of another version, whose journals are taken up")
    options = parser.parse_args()
    binary, folder = options.binary.resolve(), options.folder.resolve()
    folder.mkdir(parents=True)
    others = {}
    if options.data:
        for path in sorted((options.data / "graphs").rglob("*")):
            if path.suffix in (".g2o", ".graph", ".txt") and path.stat().st_size < 2_000_000:
                others[path.stem] = str(path.resolve())
    graphs = make_graphs(binary, folder)
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for job in [pool.submit(run, binary, folder, *what) for what in runs(graphs, others)]:
            job.result()
        for job in [pool.submit(run, binary, folder, *what) for what in after(folder, graphs)]:
            job.result()
        # The journal of this run is taken up, or that of another version.
        journals = (options.journals or folder).resolve()
        for job in [pool.submit(run, binary, folder, *what) for what in taken_up(folder, journals, graphs)]:
            job.result()
    for place in folder.iterdir():
        for path in place.iterdir():
            scrub(path, folder)
    codes = [int((place / "code").read_text()) for place in sorted(folder.iterdir()) if (place / "code").exists()]
    print(f"{len(codes)} runs, {sum(code != 0 for code in codes)} of them with an error, are kept in {folder}")


if __name__ == "__main__":
    sys.exit(main())
