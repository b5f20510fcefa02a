#!/usr/bin/env python3
"""Merge against what one would do without it, with wrong links between the maps: the tables of docs/algorithms.md.

    tests/bench/merge_against.py build/bin/terse generated [--robots 4] [--poses 1500] [--seeds 3]
    tests/bench/merge_against.py build/bin/terse cut GRAPH.g2o ... [--seeds 1]

generated: robots of `terse generate manhattan --robots`. cut: a graph in three runs of poses, each a map in a frame of
its own; edges between these are the links, and wrong ones are true measurements between other poses. Absolute
trajectory errors in metres, to the truth or to the optimum of the whole graph, with all poses as one:

    merge      terse merge, all poses kept
    believed   the graphs as one with all links, placed by the first of each; terse solve
    gnc        the same with terse solve --robust gnc
"""

import argparse
import json
import math
import pathlib
import random
import statistics
import subprocess
import tempfile

MOVED = 1000000  # ids of the k-th map in the graph of all


def run(terse, *arguments, fail=False):
    done = subprocess.run([terse, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0 and not fail:
        raise RuntimeError(f"{arguments}: {done.stderr}")
    return done.stdout if done.returncode == 0 else None


def numbers(words):
    return [float(word) for word in words]


def matrix(x):
    """Of a vertex or an edge: (x y theta) or (x y z qx qy qz qw), as rows."""
    if len(x) == 3:
        c, s = math.cos(x[2]), math.sin(x[2])
        return [[c, -s, x[0]], [s, c, x[1]], [0, 0, 1]]
    n = math.sqrt(sum(q * q for q in x[3:]))
    a, b, c, d = (q / n for q in x[3:])
    return [
        [1 - 2 * (b * b + c * c), 2 * (a * b - c * d), 2 * (a * c + b * d), x[0]],
        [2 * (a * b + c * d), 1 - 2 * (a * a + c * c), 2 * (b * c - a * d), x[1]],
        [2 * (a * c - b * d), 2 * (b * c + a * d), 1 - 2 * (a * a + b * b), x[2]],
        [0, 0, 0, 1],
    ]


def product(a, b):
    return [[sum(x * y for x, y in zip(row, column)) for column in zip(*b)] for row in a]


def inverse(T):
    n = len(T) - 1
    R = [[T[c][r] for c in range(n)] for r in range(n)]
    return [R[r] + [-sum(R[r][c] * T[c][n] for c in range(n))] for r in range(n)] + [[0] * n + [1]]


def row(T):
    if len(T) == 3:
        return [T[0][2], T[1][2], math.atan2(T[1][0], T[0][0])]
    w2 = (1 + T[0][0] + T[1][1] + T[2][2]) / 4
    squares = [(1 + T[0][0] - T[1][1] - T[2][2]) / 4, (1 - T[0][0] + T[1][1] - T[2][2]) / 4,
               (1 - T[0][0] - T[1][1] + T[2][2]) / 4, w2]
    k = max(range(4), key=lambda i: squares[i])
    q = [0.0] * 4
    q[k] = math.sqrt(squares[k])
    off = {(0, 1): T[0][1] + T[1][0], (0, 2): T[0][2] + T[2][0], (1, 2): T[1][2] + T[2][1],
           (0, 3): T[2][1] - T[1][2], (1, 3): T[0][2] - T[2][0], (2, 3): T[1][0] - T[0][1]}
    for i in range(4):
        if i != k:
            q[i] = off[(min(i, k), max(i, k))] / (4 * q[k])
    return [T[0][3], T[1][3], T[2][3]] + q


def read(path):
    """Vertices by id, edges as (tag, from, to, fields)."""
    vertices, edges = {}, []
    for line in pathlib.Path(path).read_text().splitlines():
        words = line.split()
        if words and words[0].startswith("VERTEX_SE"):
            vertices[int(words[1])] = numbers(words[2:])
        elif words and words[0] in ("EDGE_SE2", "EDGE_SE3:QUAT"):
            edges.append((words[0], int(words[1]), int(words[2]), words[3:]))
    return vertices, edges


def write(path, vertices, edges):
    tag = "VERTEX_SE2" if len(next(iter(vertices.values()))) == 3 else "VERTEX_SE3:QUAT"
    with open(path, "w") as file:
        for pose, x in vertices.items():
            print(tag, pose, *(repr(v) for v in x), file=file)
        for of, a, b, fields in edges:
            print(of, a, b, *fields, file=file)


def all_as_one(terse, folder, maps, links):
    """The graphs, each at its optimum, and all links; a map is placed by the first link to one that is placed."""
    solved = []
    for k, path in enumerate(maps):
        run(terse, "solve", path, "--output", folder / "alone.g2o", "--quiet")
        solved.append(read(folder / "alone.g2o"))
    size = 3 if len(next(iter(solved[0][0].values()))) == 3 else 7
    frames = {0: matrix([0.0] * 3 if size == 3 else [0.0] * 6 + [1.0])}
    while len(frames) < len(maps):
        for _, (a, i), (b, j), fields in links:
            if (a in frames) == (b in frames):
                continue
            T_i_j = matrix(numbers(fields[:size]))
            if a in frames:
                T = product(product(frames[a], matrix(solved[a][0][i])), T_i_j)
                frames[b] = product(T, inverse(matrix(solved[b][0][j])))
            else:
                T = product(product(frames[b], matrix(solved[b][0][j])), inverse(T_i_j))
                frames[a] = product(T, inverse(matrix(solved[a][0][i])))
            break
    vertices, edges = {}, []
    for k, (poses, of_map) in enumerate(solved):
        vertices.update({k * MOVED + i: row(product(frames[k], matrix(x))) for i, x in poses.items()})
        edges += [(tag, k * MOVED + a, k * MOVED + b, fields) for tag, a, b, fields in of_map]
    edges += [(tag, a * MOVED + i, b * MOVED + j, fields) for tag, (a, i), (b, j), fields in links]
    write(folder / "one.g2o", vertices, edges)


def error(terse, trajectory, truth):
    return json.loads(run(terse, "evaluate", trajectory, truth, "--json"))["ate"]["translation_m"]


def compare(terse, folder, maps, links, truth):
    """`truth`: a file whose stamps are ids of the graph of all."""
    with open(folder / "links.txt", "w") as file:
        for tag, (a, i), (b, j), fields in links:
            print(tag, f"{a + 1}:{i}", f"{b + 1}:{j}", *fields, file=file)
    out = {"merge": None, "links": len(links)}
    joined = run(terse, "merge", *maps, "--links", folder / "links.txt", "--no-retire", "--output", folder / "joint",
                 "--json", "--quiet", fail=True)
    if joined:
        stats = json.loads(joined)
        out["accepted"] = stats["links_accepted"]
        if all(of_map["placement"] != "apart" for of_map in stats["maps"]):
            offsets = [of_map["id_offset"] for of_map in stats["maps"]]
            ids = [read(path)[0] for path in maps]
            moved = {i + offset: k * MOVED + i for k, offset in enumerate(offsets) for i in ids[k]}
            with open(folder / "joint.tum", "w") as file:
                for line in (folder / "joint" / "trajectory.tum").read_text().splitlines():
                    if line and line[0] != "#":
                        stamp, rest = line.split(" ", 1)
                        print(moved[int(float(stamp))], rest, file=file)
            out["merge"] = error(terse, folder / "joint.tum", truth)
    all_as_one(terse, folder, maps, links)
    for name, options in [("believed", ["--initial", "file"]), ("gnc", ["--robust", "gnc"])]:
        done = run(terse, "solve", folder / "one.g2o", *options, "--trajectory", folder / "one.tum", "--quiet", fail=True)
        out[name] = None if done is None else error(terse, folder / "one.tum", truth)
    return out


def parse_links(path):
    links = []
    for line in path.read_text().splitlines():
        words = line.split()
        ends = [tuple(int(x) for x in word.split(":")) for word in words[1:3]]
        links.append((words[0], *[(k - 1, i) for k, i in ends], words[3:]))
    return links


def generated(arguments, percent, kind, seed, folder):
    run(arguments.terse, "generate", "manhattan", "--robots", arguments.robots, "--poses", arguments.poses, "--seed", seed,
        "--outliers", percent, "--outlier-kind", kind, "--output", folder / "team", "--quiet")
    team = folder / "team"
    maps = [team / f"robot_{k + 1}.g2o" for k in range(arguments.robots)]
    with open(folder / "truth.tum", "w") as file:
        for k in range(arguments.robots):
            for line in (team / f"robot_{k + 1}.tum").read_text().splitlines():
                if line and line[0] != "#":
                    stamp, rest = line.split(" ", 1)
                    print(k * MOVED + int(float(stamp)), rest, file=file)
    return compare(arguments.terse, folder, maps, parse_links(team / "links.txt"), folder / "truth.tum")


def cut(arguments, graph, percent, seed, folder):
    run(arguments.terse, "convert", graph, folder / "whole.g2o")
    run(arguments.terse, "solve", folder / "whole.g2o", "--output", folder / "solved.g2o", "--trajectory",
        folder / "whole.tum", "--quiet")
    vertices, edges = read(folder / "solved.g2o")
    order = sorted(vertices)
    part_of = {pose: min(3 * k // len(order), 2) for k, pose in enumerate(order)}
    links = [(tag, (part_of[a], a), (part_of[b], b), fields) for tag, a, b, fields in edges if part_of[a] != part_of[b]]
    chance = random.Random(seed)
    by_part = [[pose for pose in order if part_of[pose] == k] for k in range(3)]
    for _ in range(round(percent / 100 * len(links))):
        tag, (a, _i), (b, _j), fields = chance.choice(links)
        links.append((tag, (a, chance.choice(by_part[a])), (b, chance.choice(by_part[b])), fields))
    chance.shuffle(links)
    maps = []
    for k in range(3):
        maps.append(folder / f"part_{k + 1}.g2o")
        write(maps[k], {pose: vertices[pose] for pose in by_part[k]},
              [edge for edge in edges if part_of[edge[1]] == k and part_of[edge[2]] == k])
    with open(folder / "truth.tum", "w") as file:
        for line in (folder / "whole.tum").read_text().splitlines():
            if line and line[0] != "#":
                stamp, rest = line.split(" ", 1)
                print(part_of[int(float(stamp))] * MOVED + int(float(stamp)), rest, file=file)
    return compare(arguments.terse, folder, maps, links, folder / "truth.tum")


def text(values):
    """The median, and the largest behind it where there are several."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    out = f"{statistics.median(known):.3g}"
    if len(known) > 1:
        out += f" ({max(known):.3g})"
    return out + (f", {len(values) - len(known)} fail" if len(known) < len(values) else "")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("terse", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("what", choices=["generated", "cut"])
    parser.add_argument("graphs", nargs="*")
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--poses", type=int, default=1500)
    parser.add_argument("--seeds", type=int, default=None)
    parser.add_argument("--percents", type=int, nargs="+", default=[20, 50])
    arguments = parser.parse_args()
    seeds = range(1, 1 + (arguments.seeds or (3 if arguments.what == "generated" else 1)))
    print("| | wrong | merge | believed | gnc |\n| --- | --- | ---: | ---: | ---: |")
    cases = [(kind, kind) for kind in ("random", "grouped")] if arguments.what == "generated" else \
        [(pathlib.Path(graph).stem, graph) for graph in arguments.graphs]
    for name, case in cases:
        for percent in arguments.percents:
            results = []
            for seed in seeds:
                with tempfile.TemporaryDirectory() as folder:
                    make = generated if arguments.what == "generated" else cut
                    order = (percent, case) if arguments.what == "generated" else (case, percent)
                    results.append(make(arguments, *order, seed, pathlib.Path(folder)))
            columns = " | ".join(text([result[key] for result in results]) for key in ("merge", "believed", "gnc"))
            print(f"| {name} | {percent} % | {columns} |", flush=True)


if __name__ == "__main__":
    main()
