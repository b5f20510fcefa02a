"""The folder of a compact run, as `terse compact` and `terse kitti` write it."""

from __future__ import annotations

import csv
import json
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple, Union

import numpy as np
from numpy.typing import NDArray

from . import _terse

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class RunCandidate:
    """A kept pose that a new one could be linked to. Gains in nats, innovation a squared Mahalanobis distance."""

    pose_id: int
    probability: Optional[float]
    gain: Optional[float]
    measured_gain: Optional[float]
    innovation: Optional[float]
    accepted: bool


@dataclass(frozen=True)
class RunDecision:
    """What was decided on a pose."""

    pose_id: int
    kept: bool
    verdict: str
    pose_gain: Optional[float]
    candidates: Tuple[RunCandidate, ...] = ()


@dataclass(frozen=True, repr=False)
class Run:
    """What the folder of a compact run holds; what is missing there is None or empty."""

    #: The map: kept poses and links.
    graph: _terse.PoseGraph
    #: Ids of all poses in order of arrival, (n,), and whether each is in the map, (n,) bool.
    ids: Ints
    kept: NDArray[np.bool_]
    #: T_world_body of all poses, (n, 7), metres; poses in the plane are lifted to z = 0.
    poses: Floats
    #: One per pose in order of arrival; empty if there is no decisions.csv.
    decisions: List[RunDecision] = field(default_factory=list)
    #: Ids and covariances of kept poses: (k,) and (k, d, d), body frame, translation first.
    covariance_ids: Optional[Ints] = None
    covariances: Optional[Floats] = None
    #: thresholds.json and stats.json.
    thresholds: Optional[Dict[str, Any]] = None
    stats: Optional[Dict[str, Any]] = None

    def __repr__(self) -> str:
        return f"<terse.Run: {len(self.graph)} of {len(self.ids)} poses kept, {len(self.decisions)} decisions>"

    def accepted(self) -> Iterator[Tuple[int, RunCandidate]]:
        """Accepted links: the id of the pose at whose step a link was accepted, and the candidate."""
        for decision in self.decisions:
            for candidate in decision.candidates:
                if candidate.accepted:
                    yield decision.pose_id, candidate


def _number(text: str) -> Optional[float]:
    return None if text in ("", "-") else float(text)


def _rows(path: Path, columns: List[str]) -> Iterator[Tuple[int, Dict[str, str]]]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        missing = [c for c in columns if c not in (reader.fieldnames or [])]
        if missing:
            raise _file_error(path, 1, f"expected the columns {', '.join(missing)}")
        for row in reader:
            if None in row.values() or None in row:
                raise _file_error(path, reader.line_num, "not as many fields as columns")
            yield reader.line_num, row


def _file_error(path: Path, line: int, cause: str) -> _terse.FileError:
    where = f"{path}:{line}" if line > 0 else f"{path}"
    error = _terse.FileError(f"{where}: {cause}")
    error.path, error.line, error.cause = str(path), line, cause
    return error


# What json, csv, numpy and zipfile find wrong with a file is many kinds of exception; callers handle one.
@contextmanager
def _as_file_error(path: Path, expected: str) -> Iterator[None]:
    if path.exists() and not path.is_file():
        raise _file_error(path, 0, f"not a regular file, expected {expected}")
    try:
        yield
    except _terse.FileError:
        raise
    except json.JSONDecodeError as error:
        raise _file_error(path, error.lineno, error.msg) from None
    except RecursionError:
        raise _file_error(path, 0, f"nested too deeply, expected {expected}") from None
    except Exception as error:
        raise _file_error(path, 0, f"expected {expected}: {type(error).__name__}: {error}") from None


def _read_decisions(path: Path) -> List[RunDecision]:
    lists = ["candidates", "probabilities", "gains_nats", "measured_gains_nats", "innovations", "accepted"]
    decisions = []
    for line, row in _rows(path, ["pose", "kept", "verdict", "pose_gain_nats"] + lists):
        try:
            columns = [row[name].split() for name in lists]
            if len({len(column) for column in columns}) != 1:
                raise ValueError("the lists of candidates are not of the same length")
            candidates = tuple(
                RunCandidate(int(pose), _number(p), _number(gain), _number(measured), _number(innovation), yes == "1")
                for pose, p, gain, measured, innovation, yes in zip(*columns)
            )
            pose_gain = _number(row["pose_gain_nats"])
            decisions.append(RunDecision(int(row["pose"]), row["kept"] == "1", row["verdict"], pose_gain, candidates))
        except ValueError as error:
            raise _file_error(path, line, str(error)) from None
    return decisions


# Of a stereo run: a row per candidate that was compared.
def _read_loops(path: Path, ids: Ints, kept: NDArray[np.bool_]) -> List[RunDecision]:
    found: Dict[int, List[RunCandidate]] = {}
    for line, row in _rows(path, ["current", "candidate", "gain_nats", "measured_gain_nats", "innovation", "accepted"]):
        try:
            found.setdefault(int(row["current"]), []).append(
                RunCandidate(
                    int(row["candidate"]), None, _number(row["gain_nats"]), _number(row["measured_gain_nats"]),
                    _number(row["innovation"]), row["accepted"] == "1",
                )
            )
        except ValueError as error:
            raise _file_error(path, line, str(error)) from None
    poses = zip(ids.tolist(), kept.tolist())
    return [RunDecision(pose, is_kept, "", None, tuple(found.get(pose, ()))) for pose, is_kept in poses]


def _read_covariances(folder: Path) -> Tuple[Optional[Ints], Optional[Floats]]:
    archive, table = folder / "covariances.npz", folder / "covariances.csv"
    if archive.exists():
        with np.load(archive) as arrays:
            ids, covariances = arrays["ids"].astype(np.int64), arrays["covariances"].astype(np.float64)
        if ids.ndim != 1 or covariances.ndim != 3 or covariances.shape != (len(ids),) + 2 * covariances.shape[2:]:
            raise _file_error(archive, 0, f"expected (k,) ids and (k, d, d) covariances, found {ids.shape} and "
                              f"{covariances.shape}")
        return ids, covariances
    if not table.exists():
        return None, None
    rows, blocks = [], []
    for line, row in _rows(table, ["id"]):
        numbers = list(row.values())
        size = round((len(numbers) - 1) ** 0.5)
        try:
            rows.append(int(numbers[0]))
            blocks.append(np.array(numbers[1:], dtype=np.float64).reshape(size, size))
        except ValueError as error:
            raise _file_error(table, line, str(error)) from None
    return np.array(rows, dtype=np.int64), np.array(blocks)


def _read_json(path: Path) -> Optional[Dict[str, Any]]:
    if not path.exists():
        return None
    with _as_file_error(path, "a JSON object"):
        value = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(value, dict):
        raise _file_error(path, 1, "expected a JSON object")
    return value


def read_run(folder: Union[str, "os.PathLike[str]"]) -> Run:
    """Reads the folder of a compact run: compact.g2o and trajectory.tum, and what else is there.

    covariances.npz is taken before covariances.csv, decisions.csv before loops.csv. FileError with path, line, cause.
    """
    path = Path(folder)
    graph = _terse.read_graph(path / "compact.g2o")
    trajectory = _terse.read_trajectory(path / "trajectory.tum")
    # A stereo run has seconds for stamps; its ids are the frames' numbers.
    with np.errstate(invalid="ignore"):  # a stamp beyond 64 bits is no id
        ids = trajectory.stamps.astype(np.int64)
    if not np.array_equal(ids, trajectory.stamps) or not np.isin(graph.ids, ids).all():
        ids = np.arange(len(trajectory), dtype=np.int64)
    if not np.isin(graph.ids, ids).all():
        raise _file_error(path / "trajectory.tum", 0, "not all poses of compact.g2o are in it")
    kept = np.isin(ids, graph.ids)
    decisions: List[RunDecision] = []
    if (path / "decisions.csv").exists():
        with _as_file_error(path / "decisions.csv", "decisions as compact writes them"):
            decisions = _read_decisions(path / "decisions.csv")
    elif (path / "loops.csv").exists():
        with _as_file_error(path / "loops.csv", "loops as kitti writes them"):
            decisions = _read_loops(path / "loops.csv", ids, kept)
    has_archive = (path / "covariances.npz").exists()
    with _as_file_error(path / ("covariances.npz" if has_archive else "covariances.csv"), "ids and covariances"):
        covariance_ids, covariances = _read_covariances(path)
    return Run(
        graph=graph, ids=ids, kept=kept, poses=trajectory.poses, decisions=decisions, covariance_ids=covariance_ids,
        covariances=covariances, thresholds=_read_json(path / "thresholds.json"), stats=_read_json(path / "stats.json"),
    )
