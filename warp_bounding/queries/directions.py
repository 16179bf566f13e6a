"""Directions: random ones, as the paper draws them and as bounders may miss them; C text; what a placement rounds.

The paper's have spherical angles that are each uniform, so they are *not* uniform on the sphere. In n dimensions there
are n - 1 angles, all in [0, pi] but the last, which is in [0, 2 pi]; coordinate k is the cosine of angle k times the
sines of the angles before it. One dimension has the two directions +1 and -1.
"""

import numpy as np

from warp_bounding.queries.base import DIRECTION_LARGEST, DIRECTION_SMALLEST, FAR, WorldMap
from warp_bounding.queries.domain import GROWTH, Domain, input_rounding
from warp_bounding.rounding import TINY, UNIT64, gamma
from warp_bounding.runtime.native import literal

NARROW = 1e-3  # the largest size that "barely" means: of the domain, or of an entry of a direction of length 1
PARALLEL, NEARLY = 0.1, 0.1  # shares of the entries of hard directions that are 0, and that are scaled by NARROW
SCALED = 0.2  # share of hard directions whose length is not 1


def sample_directions(ndim: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, n)`` float32 directions of length 1 (up to rounding), by uniform spherical angles."""
    if ndim == 1:
        return np.where(rng.random((count, 1), dtype=np.float32) < 0.5, np.float32(-1), np.float32(1))
    angles = rng.random((count, ndim - 1), dtype=np.float32) * np.float32(np.pi)
    angles[:, -1] *= 2
    cosines, sines = np.cos(angles), np.sin(angles)
    direction = np.empty((count, ndim), dtype=np.float32)
    direction[:, :-1], direction[:, -1] = cosines, 1
    for k in range(ndim - 1):
        direction[:, k + 1 :] *= sines[:, k, None]
    return direction


def hard_directions(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """``(N, n)`` float64 directions of length 1; some entries are 0 or nearly so: parallel to faces."""
    d = rng.normal(size=shape)
    chosen = rng.random(shape)
    d = np.where(chosen < PARALLEL, 0.0, np.where(chosen < PARALLEL + NEARLY, d * NARROW, d))
    d[np.abs(d).max(axis=1) == 0, 0] = 1.0
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def hard_lengths(count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, 1)`` factors of unit directions, most of them 1: bounders take directions of any length."""
    return np.where(rng.random((count, 1)) < SCALED, np.exp2(rng.uniform(-12, 12, (count, 1))), 1.0)


def nudged_directions(d: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Directions of length 1 near others ``(N, n)``, after a step ``(N, n)`` on the sphere."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True) + move
    return d / np.linalg.norm(d, axis=1, keepdims=True)


# What rays and planes share: a point given from any distance, and a direction that has no length of its own.
#
# Where a shape is placed, the point and the direction are both moved from the world into object space. What that
# rounds grows with the distance ``|a|_1`` of the point from the domain's centre. Up to ``FAR`` the proof's delta
# covers it; for a point from farther away the test against the domain is widened by ``drift |a|_1``, ``drift`` being
# numbers of the placement.
#
# The texts below read three constants of the kind (``_PLACES``): where the point and the direction begin in q
# (``POINT_AT``, ``DIRECTION_AT``), and where the direction's matrix begins in ``place`` (``MATRIX_AT``; see
# ``Placement.values``).

# The largest entry of a direction ``e``, and whether it has a size that directions may have.
POSSIBLE = f"""
V longest = zero;
for (int k = 0; k < AXES; ++k) {{
    const V entry = e[k] < zero ? -e[k] : e[k];
    longest = entry > longest ? entry : longest;
}}
testable = testable & (longest >= zero + {literal(DIRECTION_SMALLEST)}) & (longest <= zero + {literal(DIRECTION_LARGEST)});
"""  # noqa: E501

# The point in local space: a, |a| by axis, and its distance |a|_1 from the domain's centre. ``beyond`` is that
# distance where it is more than FAR, else 0.
FAR_POINT = f"""
V a[AXES], size[AXES], distance = zero;
for (int k = 0; k < AXES; ++k) {{
    a[k] = (q[POINT_AT + k] - center[k]) * scale[k];
    size[k] = a[k] < zero ? -a[k] : a[k];
    distance = distance + size[k];
}}
const V beyond = distance > {literal(FAR)} ? distance : zero;
"""

# u, the direction with Euclidean length 1. It is divided by its largest entry first, so that squares neither overflow
# nor vanish.
UNIT = f"""
const V* e = q + DIRECTION_AT;
{POSSIBLE}
V u[AXES];
longest = longest > zero ? longest : zero + 1.0f;  // no division by zero in lanes that are maybe
for (int k = 0; k < AXES; ++k) u[k] = wb_over(e[k], longest);
V squares = u[0] * u[0];
for (int k = 1; k < AXES; ++k) squares = squares + u[k] * u[k];
const V norm = wb_root(squares);
for (int k = 0; k < AXES; ++k) u[k] = wb_over(u[k], norm);
"""

# Move the point by the matrix M, the direction by its own matrix. A direction whose entries are as small as the
# rounding of subnormal numbers, before or after the move, is *maybe*.
MOVING = f"""
V d[AXES], e[AXES];
for (int k = 0; k < AXES; ++k) d[k] = q[POINT_AT + k] - place[k], e[k] = q[DIRECTION_AT + k];
{{ {POSSIBLE} }}
for (int k = 0; k < AXES; ++k) {{
    V moved = d[0] * place[AXES + AXES * k], turned = e[0] * place[MATRIX_AT + AXES * k];
    for (int j = 1; j < AXES; ++j) {{
        moved = moved + d[j] * place[AXES + AXES * k + j];
        turned = turned + e[j] * place[MATRIX_AT + AXES * k + j];
    }}
    q[POINT_AT + k] = moved, q[DIRECTION_AT + k] = turned;
}}
{{ const V* e = q + DIRECTION_AT; {POSSIBLE} }}
for (int k = 0; k < 2 * AXES; ++k) testable = testable & ((q[k] - q[k]) == zero);  // an overflow
"""


def origin_rounding(base: Domain) -> np.ndarray:
    """``(n,)``, local units: error of the map to local space for a float64 point with ``|a|_1 <= FAR``."""
    extent = np.full(base.ndim, FAR * (1 + gamma(4)))
    around = extent / base.scale.astype(np.float64)
    return input_rounding(base.center, base.scale, extent, base.center - around, base.center + around)


# What a placement rounds: on every axis, how far a moved query may be from where it should be, at most (float64).
#
# With D = q - translation, exact, the kernels compute ``M D`` for points of queries, ``M d`` for directions and ``N n``
# for normals, N = M^-T. The moved float32 numbers *are* a query in object space, and everything behind them counts as
# for any such query, so this file only asks how far its exact region R' passes a point x of the exact region R of the
# numbers given. Directions are free in the proofs (P holds rays and planes of every direction), so what turns one only
# matters by what it moves.
#
# * *Distances.* ``|error of M D| <= alpha + beta |a|_1``, a the point in local space: relative errors, of n + 3
#   roundings at most, and the translation's.
# * *Rays.* The moved direction is off by e, ``|e| <= epsilon |M d|``, since ``|M d| >= |d| / |M^-1|``: off by an angle
#   of sine epsilon, and the unit vectors by ``epsilon (1 + epsilon)``. After t, at most ``length`` and the way to the
#   domain, x is passed by t times that.
# * *Planes*, ``e . (y - a) = 0`` in local space, the largest entry of e scaled to 1: ``|error of e_k| <= tau_k``. At a
#   point y of the domain the plane is off by ``sum tau_k (|y_k| + |a_k|) + sum |error of a_k|`` in the offset, and so
#   at most by this along that entry's axis.
# * *Boxes* are the box around what they become; without a rotation (a signed permutation of the axes) that is the
#   region itself. A corner with products ``|M_kj D_j|`` larger than those of x lies farther out than x by their
#   difference, and rounds by a share of them; so for boxes of any size x is passed by no more than what a point
#   rounds, which is x itself.
#
# All of this holds for any invertible matrix M, with the norms of M and M^-1 themselves; nothing counts on a rotation.
# Rays and planes with ``|a|_1 <= FAR`` are tested; those from farther away are denied, or are *maybe*, and the kernel
# widens the domain by ``drift |a|_1`` before it denies one.

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
