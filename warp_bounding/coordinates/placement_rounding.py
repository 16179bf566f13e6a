"""What a placement rounds: on every axis, how far a moved query may be from where it should be, at most (float64).

With D = q - translation, exact, the kernels compute ``M D`` for points of queries, ``M d`` for directions and ``N n``
for normals, N = M^-T. The moved float32 numbers *are* a query in object space, and everything behind them counts as
for any such query, so this file only asks how far its exact region R' passes a point x of the exact region R of the
numbers given. Directions are free in the proofs (P holds rays and planes of every direction), so what turns one only
matters by what it moves.

* *Distances.* ``|error of M D| <= alpha + beta |a|_1``, a the point in local space: relative errors, of n + 3 roundings
  at most, and the translation's.
* *Rays.* The moved direction is off by e, ``|e| <= epsilon |M d|``, since ``|M d| >= |d| / |M^-1|``: off by an angle of
  sine epsilon, and the unit vectors by ``epsilon (1 + epsilon)``. After t, at most ``length`` and the way to the
  domain, x is passed by t times that.
* *Planes*, ``e . (y - a) = 0`` in local space, the largest entry of e scaled to 1: ``|error of e_k| <= tau_k``. At a
  point y of the domain the plane is off by ``sum tau_k (|y_k| + |a_k|) + sum |error of a_k|`` in the offset, and so at
  most by this along that entry's axis.
* *Boxes* are the box around what they become; without a rotation (a signed permutation of the axes) that is the region
  itself. A corner with products ``|M_kj D_j|`` larger than those of x lies farther out than x by their difference, and
  rounds by a share of them; so for boxes of any size x is passed by no more than what a point rounds, which is x
  itself.

All of this holds for any invertible matrix M, with the norms of M and M^-1 themselves; nothing counts on a rotation.
Rays and planes with ``|a|_1 <= FAR`` are tested; those from farther away are denied, or are *maybe*, and the kernel
widens the domain by ``drift |a|_1`` before it denies one.
"""

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT64, gamma
from warp_bounding.coordinates.base import DIRECTION_SMALLEST, FAR, WorldMap
from warp_bounding.coordinates.domain import GROWTH, Domain

__all__ = ["SLOPE", "STEEPEST", "alpha_beta", "at_points", "far_point_error", "tilt", "turn"]

HOST = 64 * UNIT64  # relative to a row's largest entry: above what the host rounds in M and N in float64
SLOPE = 1.05  # factor of drift, for the exact |a|_1 and a few roundings: errors under STEEPEST each change it by less
STEEPEST = 0.01  # relative errors of a moved point or direction beyond which a placement is refused


def far_point_error(base: Domain, world: WorldMap, input_unit: float) -> tuple[np.ndarray, float]:
    """``(n,)``, local units: error of a moved point with ``|a|_1 <= FAR``; and the largest exact ``|a|_1`` of one.

    Both are infinite without a bound.
    """
    scale = base.scale.astype(np.float64)
    alpha, beta = alpha_beta(base, world, input_unit)
    slope = float((scale * beta).sum())
    if not slope < STEEPEST:
        return np.full(base.ndim, np.inf), np.inf
    farthest = (FAR * (1 + gamma(base.ndim + 4)) + float((scale * alpha).sum())) / (1 - slope)
    return scale * (alpha + beta * farthest), farthest


def at_points(base: Domain, world: WorldMap, input_unit: float) -> np.ndarray:
    """``(n,)``, object units: error of a moved point of the domain."""
    n, farthest = base.ndim, np.abs(world.forward) @ base.reach  # the largest |q - translation|
    rounded = world.translation_error + input_unit * (np.abs(world.translation) + farthest)
    size = np.abs(world.matrix)
    moved = size @ (gamma(n + 3) * (farthest + rounded) + rounded)
    moved += _host(size) * (farthest + rounded).sum()
    return moved + (n + 2) * TINY * (1 + size.sum(axis=1))  # results that are subnormal


def _host(size: np.ndarray) -> np.ndarray:
    """``(n,)``: error of an entry of a row, from the host, or because it is subnormal."""
    return HOST * size.max(axis=1) + 2 * TINY


def alpha_beta(base: Domain, world: WorldMap, input_unit: float) -> tuple[np.ndarray, np.ndarray]:
    """``alpha`` ``(n,)`` and ``beta`` ``(n,)`` of *Distances*, object units.

    What rounds are the input, the difference, the entries of M, n products and their n - 1 sums.
    """
    n, scale = base.ndim, base.scale.astype(np.float64)
    size, forward = np.abs(world.matrix), np.abs(world.forward)
    relative = size * (gamma(n + 3) + input_unit * (1 + gamma(n + 3))) + _host(size)[:, None]
    fixed = world.translation_error + input_unit * np.abs(world.translation) + 2 * TINY
    alpha = relative @ (forward @ np.abs(base.center.astype(np.float64))) + (size * (1 + gamma(n + 4))) @ fixed
    alpha += _host(size) * fixed.sum() + (n + 3) * TINY * (1 + size.sum(axis=1))
    return alpha, (relative @ forward / scale).max(axis=1)


def _flushed(n: int) -> float:
    """Relative to a direction's largest entry: the error of entries that are set to zero before or after the move."""
    return (n + 1) * TINY / DIRECTION_SMALLEST


def turn(world: WorldMap, n: int, input_unit: float) -> float:
    """``epsilon`` of *Rays*: the relative error of a moved direction."""
    size = np.linalg.norm(world.matrix, axis=1)
    entries = size * (gamma(n + 3) + input_unit + _flushed(n)) + _host(np.abs(world.matrix)) * np.sqrt(n)
    return float(np.linalg.norm(entries) * np.linalg.norm(world.forward, 2) + n * _flushed(n)) * GROWTH


def tilt(base: Domain, world: WorldMap, input_unit: float) -> np.ndarray:
    """``tau`` of a normal: ``e = N n / scale``, and ``|n| <= |N^-1 scale| |e| <= |N^-1 scale| sqrt(n) max |e|``."""
    n, scale, normals = base.ndim, base.scale.astype(np.float64), world.forward.T
    size = np.linalg.norm(normals, axis=1)
    entries = size * (gamma(n + 3) + input_unit + _flushed(n)) + _host(np.abs(normals)) * np.sqrt(n)
    back = np.linalg.norm(world.matrix.T * scale, 2) * np.sqrt(n)  # N^-1 = M^T
    return (entries / scale * back + _flushed(n) * scale.max() / scale) * GROWTH
