"""Poses and covariances as numpy arrays: matrices, world axes, ellipses."""

from __future__ import annotations


import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def to_matrices(poses: ArrayLike) -> Floats:
    """Homogeneous matrices of poses.

    poses: (..., 3) [x, y, theta] or (..., 7) [x, y, z, qx, qy, qz, qw], metres and radians.
    Returns (..., 3, 3) or (..., 4, 4): p_world = T p_body. A new array.
    """
    rows = np.asarray(poses, dtype=np.float64)
    if rows.ndim == 0 or rows.shape[-1] not in (3, 7):
        raise ValueError(f"poses: expected shape (..., 3) or (..., 7), got {rows.shape}")
    if rows.shape[-1] == 3:
        dim = 2
        rotations = np.empty(rows.shape[:-1] + (2, 2))
        cos, sin = np.cos(rows[..., 2]), np.sin(rows[..., 2])
        rotations[..., 0, 0], rotations[..., 0, 1] = cos, -sin
        rotations[..., 1, 0], rotations[..., 1, 1] = sin, cos
    else:
        dim = 3
        rotations = _rotations_of_quaternions(rows[..., 3:])
    out = np.zeros(rows.shape[:-1] + (dim + 1, dim + 1))
    out[..., :dim, :dim] = rotations
    out[..., :dim, dim] = rows[..., :dim]
    out[..., dim, dim] = 1
    return out


def _rotations_of_quaternions(quaternions: Floats) -> Floats:
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    out = np.empty(quaternions.shape[:-1] + (3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 0, 1] = 2 * (x * y - z * w)
    out[..., 0, 2] = 2 * (x * z + y * w)
    out[..., 1, 0] = 2 * (x * y + z * w)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 1, 2] = 2 * (y * z - x * w)
    out[..., 2, 0] = 2 * (x * z - y * w)
    out[..., 2, 1] = 2 * (y * z + x * w)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return out


def position_covariances(poses: ArrayLike, covariances: ArrayLike) -> Floats:
    """Covariances of positions in world axes, R Sigma_rho R'.

    poses: (n, 3) or (n, 7). covariances: (n, d, d), d = 3 or 6, body frame, translation first, as Marginals gives them.
    Returns (n, 2, 2) or (n, 3, 3), square metres. A new array.
    """
    T = to_matrices(poses)
    dim = T.shape[-1] - 1
    sigma = np.asarray(covariances, dtype=np.float64)
    if sigma.shape != T.shape[:-2] + (3 * dim - 3,) * 2:
        raise ValueError(f"covariances: expected shape {T.shape[:-2] + (3 * dim - 3,) * 2}, got {sigma.shape}")
    R = T[..., :dim, :dim]
    return np.einsum("...ij,...jk,...lk->...il", R, sigma[..., :dim, :dim], R)  # type: ignore[no-any-return]


# Squared radius that a plane normal distribution keeps within at 95 %.
_CHI2_95 = -2 * np.log(0.05)


def ellipse(center: ArrayLike, covariance: ArrayLike, points: int = 49) -> Floats:
    """The outline within which 95 % of a normal distribution in the plane lie.

    center: (2,), covariance: (2, 2). Returns (points, 2), closed; for plt.plot(*ellipse(...).T).
    """
    values, axes = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    angles = np.linspace(0, 2 * np.pi, points)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    radii = np.sqrt(_CHI2_95 * np.maximum(values, 0))
    out: Floats = np.add(center, ((axes * radii) @ circle).T, dtype=np.float64)
    return out
