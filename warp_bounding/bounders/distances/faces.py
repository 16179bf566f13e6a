"""Distances to volumes between flat faces: ``aabb``, ``obb``, ``kdop`` and ``learned-kdop``.

A face ``a . y <= h`` with ``|a| <= 1`` is ``a . y - h`` away from y, or farther, so the largest of these numbers is a lower bound of the
distance to the volume. That is the distance itself where the nearest point lies within a face, and less beside edges and corners.
Where the first n pairs of faces are at right angles to each other (a box, whose axes a k-DOP has, too), the n distances together are a vector
``m`` whose length is the distance to that box: exact for ``aabb`` and ``obb``; the others take the larger one of both numbers.

Of free half-spaces (``learned-kdop``) there is no such box, and at a sharp edge the bound may be much under the distance.

*Directions.* Those of the bounder of points belong to its own coordinates; here they are turned into unit normals, shortened by ``SHORTENED`` so that
after rounding to float32 none is longer than 1, and a frame of n of them, as a matrix, has a norm of at most 1 (``_norm``). What the rounding of a normal moves a face by
is at most ``|rounding| . limit``, since the object lies in the domain, and is added to the face.

*Rounding*, u = 2^-24: a product of a normal with v is off by ``gamma(n + 1) |v|_1``, the difference to a face by ``u (|v|_1 + |h|)``; n of them at right
angles by ``root(n)`` times as much, their squares, sum and root by ``(n + 4) u`` of what they give.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from warp_bounding.arithmetic import UNIT32, round_down, round_up
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.volume import NOISE, Form, VolumeDistance
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.slabs import Aabb, Kdop, Obb
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.source import Lanes, fill

__all__ = ["AabbDistance", "FacesSource", "KdopDistance", "LearnedKdopDistance", "ObbDistance", "frame_norm"]

SHORTENED = 1.0 - 2.0**-21  # of a normal: more than rounding to float32 makes it longer, n <= 64
UPRIGHT = (
    1e-5  # entries of a frame's products beyond the identity's: rounding of directions to float32 makes no larger ones
)

_BODY = """
{
    constexpr int K = $faces;
    const float* high = w;
    const float* low = w + K;
    const float* a = w + ($two_sided ? 2 : 1) * K;
    V square = zero, farthest = zero - 3e38f;
#pragma unroll $unrolled
    for (int k = 0; k < K; ++k) {
        V z;
        if ($diagonal) {
            z = v[k];
        } else {
            z = v[0] * a[k * N];
#pragma unroll
            for (int j = 1; j < N; ++j) z = z + v[j] * a[k * N + j];
        }
        V m = z - high[k];
        if ($two_sided) m = most(m, low[k] - z);
        farthest = most(farthest, m);
        if (k < $frame) {
            const V out = most(m, zero);
            square = square + out * out;
        }
    }
    f = farthest;
    if ($frame > 0) f = most(f, root(square));
}
"""
_MOST_UNROLLED = 16


@dataclass(frozen=True)
class FacesSource(DistanceSource):
    """Native code. Numbers: ``high[k]``, ``low[k]`` where two-sided, and ``a`` ``(k, n)`` unless diagonal."""

    faces: int
    frame: int  # the first so many are at right angles to each other: n, or 0
    two_sided: bool
    diagonal: bool

    def body(self, lanes: Lanes) -> str:
        own = {name: str(value).lower() for name, value in vars(self).items()}
        return fill(_BODY, **own, unrolled=min(self.faces, _MOST_UNROLLED))


def frame_norm(frame: np.ndarray) -> float:
    """An upper bound of the norm of a matrix, as it acts on vectors; infinite unless its rows are about at right angles, and of one length."""
    products = frame @ frame.T
    if not (np.abs(products - np.eye(len(frame))) <= UPRIGHT).all():
        return np.inf
    return float(np.sqrt(np.abs(products).sum(axis=1).max() + NOISE))


class FacesDistance(VolumeDistance):
    """Between flat faces; see module."""

    two_sided: ClassVar[bool] = True

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        shape, tau, n = volume.shape, float(volume.threshold), domain.ndim
        limit, per_unit = domain.limit.astype(np.float64), volume.domain.scale.astype(np.float64)
        slopes = shape.directions * per_unit / domain.scale.astype(np.float64)  # of y; a . v = slopes . y + moved
        apart = domain.center.astype(np.float64) - volume.domain.center.astype(np.float64)
        moved = (shape.directions * per_unit) @ apart
        size = np.abs(shape.directions * per_unit) @ np.abs(apart) + np.abs(slopes) @ limit + abs(tau)
        length = np.linalg.norm(slopes, axis=1)
        if not (length > 0).all():
            raise BounderError(f"{cls.method}: a face has no direction")
        diagonal = bool(shape.diagonal) and cls.two_sided
        unit = slopes / length[:, None]
        normals = unit if diagonal else (unit * SHORTENED).astype(np.float32).astype(np.float64)
        upright = diagonal or (cls.two_sided and len(normals) >= n and frame_norm(normals[:n]) <= 1.0)
        if not diagonal and not (np.linalg.norm(normals, axis=1) <= 1 - NOISE).all():
            raise BounderError(f"{cls.method}: a face's normal is longer than 1")
        turned = np.abs(normals - unit) @ limit
        high = (shape.high - tau - moved) / length
        room = turned + NOISE * (np.abs(shape.high) + size) / length + NOISE
        numbers = [round_up(high + room)]
        if cls.two_sided:
            low = (shape.low + tau - moved) / length
            numbers.append(round_down(low - turned - NOISE * (np.abs(shape.low) + size) / length - NOISE))
        largest = max(float(np.abs(part).max()) for part in numbers)
        if not diagonal:
            numbers.append(normals.astype(np.float32).reshape(-1))
        faces = [np.asarray(part, dtype=np.float64) for part in numbers[: 1 + cls.two_sided]]
        frame, root = (n, float(np.sqrt(n))) if upright else (0, 1.0)

        def reference(v: np.ndarray) -> np.ndarray:
            m = (z := v @ normals.T) - faces[0]
            if cls.two_sided:
                m = np.maximum(m, faces[1] - z)
            far = m.max(axis=1)
            return np.maximum(far, np.linalg.norm(np.maximum(m[:, :n], 0.0), axis=1)) if upright else far

        source = FacesSource(n, False, len(normals), frame, cls.two_sided, diagonal)
        error, growth = root * 2 * UNIT32 * largest, root * (n + 3) + n + 8
        return Form(source, np.concatenate(numbers).astype(np.float32), error, growth, reference)


class AabbDistance(FacesDistance):
    """The distance to the axis-aligned box, exact but for rounding."""

    method, bounds = Aabb.method, Aabb


class ObbDistance(FacesDistance):
    """The distance to the oriented box, exact but for rounding where its axes are at right angles in object space."""

    method, bounds = Obb.method, Obb


class KdopDistance(FacesDistance):
    """A lower bound of the distance to the k-DOP: that to its farthest face, or to the box among its faces."""

    method, bounds = Kdop.method, Kdop


class LearnedKdopDistance(FacesDistance):
    """A lower bound of the distance to the polytope: that to its farthest face."""

    method, bounds = LearnedKdop.method, LearnedKdop
    two_sided = False
