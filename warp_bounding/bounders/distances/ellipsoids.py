"""Distances to ellipsoids: ``sphere``, ``ellipsoid`` and ``oriented-ellipsoid``.

The ball: ``|y - c| - r``. An ellipsoid ``sum z_k^2 / s_k^2 <= 1``, in coordinates in which its axes lie along the axes: by duality, for *any* multiplier t >= 0,

    d(z)^2 >= min_x |z - x|^2 + t (sum x_k^2 / s_k^2 - 1) = t (sum z_k^2 / (s_k^2 + t) - 1),

with equality for the best one, which is the root of ``q(t) = sum (s_k z_k)^2 / (s_k^2 + t)^2 = 1``. It is found by a few steps of Newton's method for
``1 / root(q) = 1``, which is nearly linear, from the largest of ``s_k |z_k| - s_k^2``, that is under the root. However well they find it, what they find is a bound, so
that their rounding does not matter; the rounding of the last expression is taken off in the kernel, where its size is known.

*The axes.* The volume is ``|A v + b|^2 <= r^2`` in its own coordinates. With M that map in the coordinates y of the domain, ``|M (y - c)| <= 1``, and R a float32 matrix of norm
at most 1 whose rows are about M's right singular vectors (R = 1 where A is diagonal), ``K = M R^-1`` has ``K^T K`` about diagonal, and at least ``(1 - o) D``, where D is its diagonal
and ``o`` the largest row sum of ``|D^-1/2 (K^T K - D) D^-1/2|``. So the volume lies in the ellipsoid of ``R (y - c)`` with ``s_k^2 = 1 / ((1 - o) D_k)``, and
distances do not grow under R.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.arithmetic import UNIT32, round_up
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.faces import SHORTENED, frame_norm
from warp_bounding.bounders.distances.volume import NOISE, Form, VolumeDistance
from warp_bounding.bounders.ellipsoids import Ellipsoid, OrientedEllipsoid, Sphere
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.source import Lanes, fill, literal

__all__ = ["BallSource", "EllipsoidDistance", "EllipsoidSource", "OrientedEllipsoidDistance", "SphereDistance"]

NEWTON_STEPS = 4  # of an ellipsoid with axes of 1 : 10 the bound is then 0.03 % under the distance at worst (tests/bounders/distances)
ROUNDED = 2.0**-20  # relative, of the dual expression: more than its n + 12 roundings, n <= 4 ...
ROUNDED_EACH = 2.0**-23  # ... and more for each further dimension
LEAST_SQUARE = 2.0**-60  # local units, of a squared half-axis: quotients by it keep their precision
MOST_NOISE = 1e-8  # of a matrix's condition: float64 cannot tell more about the ellipsoid

_BALL = """
{
    V square = zero;
#pragma unroll
    for (int k = 0; k < N; ++k) { const V z = v[k] - w[k]; square = square + z * z; }
    f = root(square) - w[N];
}
"""


@dataclass(frozen=True)
class BallSource(DistanceSource):
    """Native code of a ball. Numbers: centre and radius."""

    def body(self, lanes: Lanes) -> str:
        return _BALL


_ELLIPSOID = """
{
    const float* c = w;
    const float* s2 = w + N;  // squared half-axes
    const float* r = w + 2 * N;
    V z[N], z2[N], t = zero, inside = zero;
#pragma unroll
    for (int k = 0; k < N; ++k) {
        if ($rotated) {
            z[k] = (v[0] - c[0]) * r[k * N];
#pragma unroll
            for (int j = 1; j < N; ++j) z[k] = z[k] + (v[j] - c[j]) * r[k * N + j];
        } else {
            z[k] = v[k] - c[k];
        }
        z2[k] = z[k] * z[k];
        t = most(t, root(z2[k] * s2[k]) - s2[k]);
    }
    for (int step = 0; step < $steps; ++step) {
        V q = zero, slope = zero;
#pragma unroll
        for (int k = 0; k < N; ++k) {
            const V one = over(zero + 1.0f, t + s2[k]), part = z2[k] * s2[k] * one * one;
            q = q + part;
            slope = slope + part * one;
        }
        t = most(t + over((root(q) - 1.0f) * q, slope), zero);
    }
    V sum = zero;
#pragma unroll
    for (int k = 0; k < N; ++k) sum = sum + over(z2[k], t + s2[k]);
    const V square = t * (sum - 1.0f) - t * (sum + 1.0f) * $rounded;
    f = square > zero ? root(square) : zero;
}
"""


@dataclass(frozen=True)
class EllipsoidSource(DistanceSource):
    """Native code of an ellipsoid. Numbers: centre, squared half-axes, and R ``(n, n)`` where rotated."""

    rotated: bool

    @property
    def rounded(self) -> float:
        """What is taken off the dual expression, relative to its terms."""
        return ROUNDED + max(0, self.ndim - 4) * ROUNDED_EACH

    def body(self, lanes: Lanes) -> str:
        return fill(_ELLIPSOID, rotated=str(self.rotated).lower(), steps=NEWTON_STEPS, rounded=literal(self.rounded))


class EllipsoidDistance(VolumeDistance):
    """The distance to the axis-aligned ellipsoid, from below by less than a thousandth."""

    method, bounds = Ellipsoid.method, Ellipsoid

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        shape, n = volume.shape, domain.ndim
        square = -float(volume.threshold)
        if not square > 0:
            raise BounderError(f"{cls.method}: the threshold leaves nothing of the ellipsoid")
        per_unit, to_unit = volume.domain.scale.astype(np.float64), domain.scale.astype(np.float64)
        radius = np.sqrt(square) * (1 + NOISE)
        m = shape.matrix * (per_unit / to_unit) / radius  # |m (y - middle)| <= 1
        if not np.linalg.cond(m) * NOISE <= MOST_NOISE:
            raise BounderError(f"{cls.method}: the ellipsoid is too flat")
        # A v + b = m' (y - middle), where v = (x - own centre) scale and y = (x - centre) scale
        own = np.linalg.solve(shape.matrix, -shape.offset) / per_unit + volume.domain.center.astype(np.float64)
        middle = (own - domain.center.astype(np.float64)) * to_unit
        center = middle.astype(np.float32)
        away = float(np.linalg.norm(center - middle)) + NOISE * (np.abs(middle).sum() + 1) * np.linalg.cond(m)
        ball = cls is SphereDistance
        if ball:
            reach = (1 + NOISE) / np.linalg.svd(m, compute_uv=False).min() + away
            radius = round_up(reach * (1 + NOISE))
            numbers = np.concatenate([center, [radius]]).astype(np.float32)

            def of_ball(v: np.ndarray) -> np.ndarray:
                return np.linalg.norm(v - center.astype(np.float64), axis=1) - float(radius)

            error = UNIT32 * (n + 6) * (float(np.abs(center).sum()) + float(radius))
            return Form(BallSource(n, False), numbers, error, n + 8.0, of_ball)
        rotation = np.eye(n) if shape.diagonal else _rotation(m, cls.method)
        k = m @ np.linalg.inv(rotation)
        gram = k.T @ k
        scales = 1 / np.sqrt(np.diag(gram))
        off = np.abs(gram * scales[:, None] * scales - np.eye(n)).sum(axis=1).max() + NOISE * np.linalg.cond(m)
        if not off < 0.5:
            raise BounderError(f"{cls.method}: the ellipsoid's axes could not be found")
        half = scales / np.sqrt(1 - off) * (1 + NOISE)
        half *= (
            1 + away / half.min()
        )  # every point of the ellipsoid, moved by ``away``, lies in the one of these half-axes
        squares = round_up(half**2 * (1 + NOISE))
        if not LEAST_SQUARE <= squares.min() <= squares.max() <= 1 / LEAST_SQUARE:
            raise BounderError(f"{cls.method}: the ellipsoid is too flat")
        numbers = np.concatenate([center, squares, [] if shape.diagonal else rotation.reshape(-1)]).astype(np.float32)
        source = EllipsoidSource(n, False, not shape.diagonal)
        s2 = squares.astype(np.float64)

        def reference(v: np.ndarray) -> np.ndarray:
            return _dual((v - center.astype(np.float64)) @ rotation.T, s2)

        root = float(np.sqrt(n)) if source.rotated else 1.0
        error = UNIT32 * root * (n + 4) * float(np.abs(center).sum())
        return Form(source, numbers, error, root * (n + 4) + n + 8, reference)


def _rotation(m: np.ndarray, method: str) -> np.ndarray:
    """R of the module's docstring; float64 values of float32 numbers."""
    rows = np.linalg.svd(m)[2]
    rotation = (rows * SHORTENED).astype(np.float32).astype(np.float64)
    if not frame_norm(rotation) <= 1:
        raise BounderError(f"{method}: the ellipsoid's axes could not be found")
    return rotation


def _dual(z: np.ndarray, s2: np.ndarray) -> np.ndarray:
    """The distance from ``(N, n)`` points to the ellipsoid of squared half-axes, by bisection, from below."""
    z2 = z * z
    low, high = np.zeros(len(z)), np.maximum((np.sqrt(z2) * np.sqrt(s2)).sum(axis=1), 1e-300)
    for _ in range(100):
        t = (low + high) / 2
        outside = (z2 * s2 / (s2 + t[:, None]) ** 2).sum(axis=1) > 1
        low, high = np.where(outside, t, low), np.where(outside, high, t)
    return np.sqrt(np.maximum(low * ((z2 / (s2 + low[:, None])).sum(axis=1) - 1), 0.0))


class SphereDistance(EllipsoidDistance):
    """The distance to the ball, exact but for rounding."""

    method, bounds = Sphere.method, Sphere


class OrientedEllipsoidDistance(EllipsoidDistance):
    """The distance to the ellipsoid of any orientation, from below by less than a thousandth."""

    method, bounds = OrientedEllipsoid.method, OrientedEllipsoid
