#!/usr/bin/env python3
"""Draws what `make demo` leaves behind: APAL and FPFL from above, as one SVG.

    make demo && docs/images/make_demo_picture.py demo_output docs/images/demo.svg

Python's standard library only. The plane is that of the two largest extents of the ground truth. Each estimate is laid
over the ground truth as for its ATE.
"""

import json
import math
import sys

WIDTH, MARGIN, GAP, TITLE, LEGEND = 900, 24, 44, 44, 34
TRUTH, ESTIMATE, LINK, TEXT = "#8b949e", "#2f81f7", "#e8710a", "#768390"  # legible on white and on black
PANELS = (("apal", "all poses, all links"), ("fpfl", "few poses, few links"))


def read_tum(path):
    """Positions by stamp."""
    with open(path) as file:
        rows = [[float(x) for x in line.split()] for line in file if line.strip() and not line.startswith("#")]
    return {int(row[0]): row[1:4] for row in rows}


def read_graph(path):
    """Ids of the poses in order, and the edges that join poses which do not follow each other."""
    poses, edges = [], []
    with open(path) as file:
        for line in file:
            words = line.split()
            if words and words[0].startswith("VERTEX"):
                poses.append(int(words[1]))
            elif words and words[0].startswith("EDGE"):
                edges.append((int(words[1]), int(words[2])))
    rank = {pose: k for k, pose in enumerate(sorted(poses))}
    return poses, [(a, b) for a, b in edges if abs(rank[a] - rank[b]) > 1]


def mean(points):
    return [sum(p[k] for p in points) / len(points) for k in range(3)]


def align(estimate, truth):
    """The estimate moved rigidly onto the truth by least squares (Horn's quaternion)."""
    ids = sorted(estimate.keys() & truth.keys())
    c_e, c_t = mean([estimate[i] for i in ids]), mean([truth[i] for i in ids])
    S = [[sum((estimate[i][r] - c_e[r]) * (truth[i][c] - c_t[c]) for i in ids) for c in range(3)] for r in range(3)]
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = S
    N = [[xx + yy + zz, yz - zy, zx - xz, xy - yx], [yz - zy, xx - yy - zz, xy + yx, zx + xz],
         [zx - xz, xy + yx, yy - xx - zz, yz + zy], [xy - yx, zx + xz, yz + zy, zz - xx - yy]]
    # The largest eigenvalue's vector by power iteration; the shift makes it the largest in magnitude too.
    shift = sum(abs(x) for row in N for x in row)
    q = [1.0, 0.1, 0.1, 0.1]
    for _ in range(5000):
        q = [shift * q[r] + sum(N[r][c] * q[c] for c in range(4)) for r in range(4)]
        length = math.sqrt(sum(x * x for x in q))
        q = [x / length for x in q]
    w, x, y, z = q
    R = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    move = lambda p: [c_t[r] + sum(R[r][c] * (p[c] - c_e[c]) for c in range(3)) for r in range(3)]
    return {i: move(p) for i, p in estimate.items()}


def arc(a, b, centre):
    """From a to b, bent away from the centre: most links join neighbours and would lie on the trajectory."""
    middle, across = [(a[k] + b[k]) / 2 for k in (0, 1)], (a[1] - b[1], b[0] - a[0])
    out = sum(across[k] * (middle[k] - centre[k]) for k in (0, 1)) > 0
    bend = [middle[k] + (0.9 if out else -0.9) * across[k] for k in (0, 1)]
    return "M{:.1f},{:.1f}Q{:.1f},{:.1f} {:.1f},{:.1f}".format(*a, *bend, *b)


def panel(out, folder, strategy, caption, truth, project, left, width, bottom):
    poses, links = read_graph(f"{folder}/{strategy}/compact.g2o")
    centre = mean(list(truth.values()))
    estimate = align(read_tum(f"{folder}/{strategy}/trajectory.tum"), truth)
    with open(f"{folder}/{strategy}/evaluation.json") as file:
        ate = json.load(file)["ate"]["translation_m"]
    with open(f"{folder}/{strategy}/stats.json") as file:
        link_count = json.load(file)["links_kept"]
    place = lambda p: "{:.1f},{:.1f}".format(*project(p, left))
    line = lambda points: " ".join(place(points[i]) for i in sorted(points))
    out.append(f'<text x="{left}" y="{MARGIN + 6}" font-size="15"><tspan font-weight="600">{strategy.upper()}</tspan>'
               f'<tspan dx="8">{caption}</tspan></text>')
    out.append(f'<text x="{left + width}" y="{MARGIN + 6}" text-anchor="end">ATE {ate:.3f} m</text>')
    out.append(f'<polyline points="{line(truth)}" fill="none" stroke="{TRUTH}" stroke-width="1"/>')
    out.append(f'<polyline points="{line(estimate)}" fill="none" stroke="{ESTIMATE}" stroke-width="1.4"/>')
    arcs = "".join(arc(project(estimate[a], left), project(estimate[b], left), project(centre, left)) for a, b in links)
    opacity = 1 if len(links) < 50 else 0.55
    out.append(f'<path d="{arcs}" fill="none" stroke="{LINK}" stroke-width="1" opacity="{opacity}"/>')
    radius = 2.0 if len(poses) > 60 else 3.4
    for pose in poses:
        x, y = project(estimate[pose], left)
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{ESTIMATE}"/>')
    legend = [(f"{len(poses)} poses", f'<circle cx="7" cy="-4" r="{radius}" fill="{ESTIMATE}"/>', 104),
              (f"{link_count} links", f'<path d="M0,-4h14" stroke="{LINK}" stroke-width="1.4"/>', 94),
              ("estimate", f'<path d="M0,-4h14" stroke="{ESTIMATE}" stroke-width="1.4"/>', 98),
              ("ground truth", f'<path d="M0,-4h14" stroke="{TRUTH}" stroke-width="1.4"/>', 0)]
    x = left
    for text, symbol, advance in legend:
        out.append(f'<g transform="translate({x},{bottom})">{symbol}<text x="20">{text}</text></g>')
        x += advance


def main(folder, path):
    truth = read_tum(f"{folder}/ground_truth.tum")
    low = [min(p[k] for p in truth.values()) for k in range(3)]
    high = [max(p[k] for p in truth.values()) for k in range(3)]
    across, up = sorted(range(3), key=lambda k: low[k] - high[k])[:2]
    # Room for what lies beside the truth.
    room = 0.04 * (high[across] - low[across])
    width = (WIDTH - 2 * MARGIN - GAP) / 2
    scale = width / (high[across] - low[across] + 2 * room)
    drawing = scale * (high[up] - low[up] + 2 * room)
    height = round(MARGIN + TITLE + drawing + LEGEND)
    project = lambda p, left: (left + scale * (p[across] - low[across] + room),
                               TITLE + drawing - scale * (p[up] - low[up] + room))
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
           f'font-family="system-ui,-apple-system,Segoe UI,Helvetica,Arial,sans-serif" font-size="13" fill="{TEXT}">',
           "<title>The demonstration's trajectory with all poses and links, and with few</title>"]
    for k, (strategy, caption) in enumerate(PANELS):
        panel(out, folder, strategy, caption, truth, project, MARGIN + k * (width + GAP), width, height - MARGIN + 4)
    with open(path, "w") as file:
        file.write("\n".join(out) + "\n</svg>\n")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
