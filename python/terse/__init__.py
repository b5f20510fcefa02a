"""Compact pose SLAM in 2D and 3D: graphs, solvers, covariances and maps of few poses, on numpy arrays.

Poses are T_world_body, metres and radians: rows [x, y, theta] in the plane, [x, y, z, qx, qy, qz, qw] in space; where a
pose is asked for, a homogeneous matrix will do. Covariances and information matrices are those of d in T Exp(d),
d = [translation, rotation], in the body frame. docs/python.md is a guide with examples.
"""

from . import _terse
from ._terse import (
    Candidate,
    CompactInput,
    CompactOptions,
    CompactPoseSlam,
    CompactTrajectory,
    CovarianceReport,
    Decision,
    Edges,
    Evaluation,
    FileError,
    FreeMotion,
    GraphFile,
    GraphReplay,
    IncrementalMarginals,
    IncrementalOptions,
    IncrementalSolver,
    KittiError,
    LinkDecision,
    Marginals,
    NumericalError,
    PoseError,
    PoseGraph,
    PosePrior,
    PositionPrior,
    RelativePose,
    Solution,
    StepReport,
    Thresholds,
    Trajectory,
    UnobservableError,
    __version__,
    evaluate,
    initial_values,
    read_graph,
    read_graph_file,
    read_trajectory,
    replay,
    select_thresholds,
    solve,
    write_graph,
    write_trajectory,
)
from .poses import ellipse, position_covariances, to_matrices
from .run import Run, RunCandidate, RunDecision, read_run

__all__ = [name for name in dir() if not name.startswith("_") and name not in ("poses", "run")]
