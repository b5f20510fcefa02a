"""What a compact run kept, and why: reads its folder, prints a table and draws.

    build/bin/terse compact GRAPH.g2o --output DIR
    PYTHONPATH=build/python python3 examples/python/analyse_compact.py DIR [--output PICTURE.png]

Editors that know cells (# %%) run it piece by piece. Without a display the picture goes to DIR/analysis.png.
"""

# %% What to read
import argparse
import os
import sys
from pathlib import Path

import matplotlib
import numpy as np

parser = argparse.ArgumentParser(description="Analyses the folder of a compact run.")
parser.add_argument("folder", type=Path, help="written by terse compact or terse kitti")
parser.add_argument("--output", type=Path, help="picture to write, .png or .svg")
arguments = parser.parse_args()

has_display = sys.platform in ("win32", "darwin") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
if arguments.output or not has_display:
    matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (after the choice of where it draws)
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402

import terse  # noqa: E402

# %% The run: map, all poses, decisions, covariances
try:
    run = terse.read_run(arguments.folder)
except terse.FileError as error:
    sys.exit(f"{error}")
row_of = {pose_id: row for row, pose_id in enumerate(run.ids.tolist())}
positions = run.poses[:, :3]
# Two of the axes are drawn: those along which the path is widest, x and y or, for a camera's frame, x and z.
seen = np.sort(np.argsort(np.ptp(positions, axis=0))[1:])
names = ["xyz"[axis] + " [m]" for axis in seen]

# %% Links: edges of the map that are not odometry, with the gain that they were accepted for
edges = run.graph.edges()
rows = np.sort([[row_of[a], row_of[b]] for a, b in zip(edges.from_ids.tolist(), edges.to_ids.tolist())], axis=1)
rows = rows.reshape(-1, 2)
kept_rows = np.flatnonzero(run.kept)
following = dict(zip(kept_rows[:-1].tolist(), kept_rows[1:].tolist()))
is_chain = np.array([following.get(a) == b for a, b in rows.tolist()], dtype=bool)
gain_of = {}
for pose_id, candidate in run.accepted():
    pair = tuple(sorted((row_of[pose_id], row_of[candidate.pose_id])))
    gain_of[pair] = candidate.gain if candidate.measured_gain is None else candidate.measured_gain
links = [pair for pair in map(tuple, rows[~is_chain].tolist())]
link_gains = np.array([gain_of.get(pair) or np.nan for pair in links], dtype=float)

# %% How well the kept poses are known: covariances of positions, in world axes
sigmas = np.empty((0, 3, 3))
covariance_rows = np.empty(0, dtype=int)
if run.covariances is not None and len(run.covariances) > 0:
    covariance_rows = np.array([row_of[pose_id] for pose_id in run.covariance_ids.tolist()])
    kept_poses = run.graph.poses[[run.graph.index_of(int(pose_id)) for pose_id in run.covariance_ids]]
    flat = terse.position_covariances(kept_poses, run.covariances)
    sigmas = np.zeros((len(flat), 3, 3))
    sigmas[:, : flat.shape[-1], : flat.shape[-1]] = flat
deviations = np.sqrt(np.trace(sigmas, axis1=1, axis2=2))
path = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])

# %% The table
candidates = [candidate for decision in run.decisions for candidate in decision.candidates]
registered = [candidate for candidate in candidates if candidate.measured_gain is not None]
table = [
    ("poses kept", f"{run.kept.sum()} of {len(run.ids)} ({100 * run.kept.mean():.0f} %)"),
    ("odometry edges, links", f"{is_chain.sum()}, {len(links)}"),
    ("path", f"{path[-1]:.1f} m"),
]
if run.decisions:
    table.append(("candidates, matched, accepted", f"{len(candidates)}, {len(registered)}, {len(gain_of)}"))
if np.isfinite(link_gains).any():
    table.append(("gain of a link, median", f"{np.nanmedian(link_gains):.2f} nats"))
if len(deviations) > 0:
    table.append(("position known to, median", f"{np.median(deviations):.3f} m"))
    table.append(("position known to, worst", f"{deviations.max():.3f} m"))
for name, key in [("chi2", "chi2"), ("seconds", "seconds")]:
    value = (run.stats or {}).get(key)
    value = value.get("total") if isinstance(value, dict) else value
    if isinstance(value, (int, float)):
        table.append((name, f"{value:.4g}"))
for name, value in table:
    print(f"{name:<30} {value}")

# %% The picture
plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
plt.rcParams["axes.titlelocation"] = "left"
width, height = np.ptp(positions[:, seen], axis=0)
figure = plt.figure(figsize=(12, np.clip(7 * height / max(width, 1e-9) + 1.5, 5, 8)), constrained_layout=True)
left, right = figure.subfigures(1, 2, width_ratios=[1.5, 1])
figure.suptitle(f"{arguments.folder.resolve().name}: {run.kept.sum()} of {len(run.ids)} poses kept, {len(links)} links")

# %% Trajectory, kept and dropped poses, links by gain, 95 % ellipses
axes = left.subplots()
xy = positions[:, seen]
axes.plot(*xy.T, "-", color="0.8", linewidth=0.8, zorder=1)
axes.plot(*xy[~run.kept].T, ".", color="0.65", markersize=2.5, zorder=2, label="dropped")
size = 4 if run.kept.sum() < 200 else 2.5
axes.plot(*xy[run.kept].T, "o", color="tab:blue", markersize=size, zorder=3, label="kept")
if links:
    shades = LineCollection([xy[list(pair)] for pair in links], linewidths=2.2 if len(links) < 50 else 1.2, zorder=4)
    if np.isfinite(link_gains).any():
        shades.set(array=link_gains, cmap=ListedColormap(plt.get_cmap("plasma_r")(np.linspace(0.15, 1, 256))))
        left.colorbar(shades, ax=axes, label="gain of a link [nats]", location="bottom", shrink=0.5, pad=0.01)
    else:
        shades.set(color="tab:orange", zorder=2)
        axes.plot([], [], "-", color="tab:orange", label="link")
    axes.add_collection(shades)
drawn = np.linspace(0, len(sigmas) - 1, min(len(sigmas), 80)).astype(int)
ellipses = [terse.ellipse(xy[covariance_rows[k]], sigmas[k][np.ix_(seen, seen)]) for k in drawn]
axes.add_collection(LineCollection(ellipses, colors="tab:green", linewidths=0.8, alpha=0.7, zorder=3))
if ellipses:
    axes.plot([], [], "-", color="tab:green", label="95 % of a kept pose's position")
axes.set(xlabel=names[0], ylabel=names[1], title="Trajectory and links")
axes.set_aspect("equal")
axes.autoscale_view()
axes.legend(loc="best")

# %% Gains, and the thresholds that they are compared with
upper, lower = right.subplots(2, 1)
axes = upper
gains = {
    "of a link, expected": ([c.gain for c in candidates], "min_loop_gain", "tab:orange"),
    "of a pose": ([decision.pose_gain for decision in run.decisions], "min_pose_gain", "tab:blue"),
}
gains = {name: (np.array([g for g in values if g], dtype=float), *rest) for name, (values, *rest) in gains.items()}
every = np.concatenate([values for values, *_ in gains.values()])
axes.set(title="Gains and thresholds", xlabel="nats", ylabel="count")
if len(every) > 0:
    bins = np.linspace(0, every.max() * 1.01, 50)
    for name, (values, threshold, colour) in gains.items():
        if len(values) == 0:
            continue
        axes.hist(values, bins, histtype="step", linewidth=1.4, color=colour, label=name)
        limit = (run.thresholds or {}).get(threshold)
        if limit:
            axes.axvline(limit, color=colour, linestyle="--", label=f"{threshold} {limit:.2g}")
    axes.legend(frameon=False)
else:
    axes.set(xticks=[], yticks=[])
    axes.text(0.5, 0.5, "this run compared no gains", ha="center", transform=axes.transAxes)

# %% Standard deviation of the position along the path
axes = lower
axes.set(title="How well positions are known", xlabel="path [m]", ylabel="standard deviation [m]")
if len(deviations) > 0:
    order = np.argsort(covariance_rows)
    style = "o-" if len(deviations) < 200 else "-"
    axes.plot(path[covariance_rows[order]], deviations[order], style, color="tab:green", markersize=3, linewidth=1)
    axes.set_ylim(bottom=0)
    closing = path[sorted({max(pair) for pair in links})]
    if len(closing) > 0:
        heights = np.full(len(closing), 0.02)  # of the axes
        style = {"color": "tab:purple", "transform": axes.get_xaxis_transform()}
        axes.plot(closing, heights, "|", label="a loop closes", **style)
        axes.legend(frameon=False)
else:
    axes.set(xticks=[], yticks=[])
    axes.text(0.5, 0.5, "this run has no covariances", ha="center", transform=axes.transAxes)

# %% Written, or shown
if arguments.output or not has_display:
    picture = arguments.output or arguments.folder / "analysis.png"
    figure.savefig(picture, dpi=150)
    print(f"wrote {picture}")
else:
    plt.show()
