"""Intersections of free half-spaces ``P = {y: a_k . y <= b_k}``, tested against points, rays, planes and boxes.

They are slabs without a low face, so that their exact f is that of slabs; what they read and round is their own.

* Point: ``f = min_k (b_k - a_k . v)``, concave.
* Ray: the segment is clipped by every half-space; faces are moved out by all that rounding can do.
* Plane: against P's vertices (``SlabPlane``).
* Box: on every normal, its nearest corner; conservative, as is the classic test of k-DOPs.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.arithmetic import TINY, gamma, round_up
from warp_bounding.bounders.polytopes.native import TEXTS
from warp_bounding.bounders.slabs.regions import ROOM, SlabBox, SlabPlane, SlabPoint, SlabRay, Slabs
from warp_bounding.bounders.volume import VolumeSource
from warp_bounding.coordinates.region_domain import AnyDomain, RegionDomain
from warp_bounding.errors import BounderError

__all__ = ["TESTS", "HalfSpacesSource"]

UNBOUNDED = 2.0**20  # where half-spaces have no second face, or beyond the domain: vertices there do no harm


@dataclass(frozen=True)
class HalfSpacesSource(VolumeSource):
    """Native code of the test. Numbers: ``b[k]``, then ``a`` ``(k, n)``; of planes, see ``SlabPlane``."""

    half_spaces: int

    texts = TEXTS


def _numbers(slabs: Slabs, offsets: np.ndarray) -> np.ndarray:
    return np.concatenate([offsets, slabs.directions.reshape(-1)]).astype(np.float32)


class _Point(SlabPoint):
    def __init__(self, slabs: Slabs, domain: AnyDomain):
        self.slabs, self.weights, self.sizes = slabs, _numbers(slabs, slabs.high), np.abs(slabs.high)
        # A sum of products, then one subtraction; a factor or a result may be set to zero.
        n, limit, size = domain.ndim, domain.limit.astype(np.float64), np.abs(slabs.directions)
        flushed = (2 * n + 2 + size.sum(axis=1) + limit.sum()) * TINY
        self.error = float((gamma(n + 3) * (size @ limit + self.sizes) + flushed).max() * (1 + 1e-9))


class _Ray(SlabRay):
    """Clipping; numbers: b moved out, a. f is 0 or -1, without an error."""

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        limit, size = domain.limit.astype(np.float64), np.abs(slabs.directions)
        largest = size @ limit[:n] + size @ limit[n:] + np.abs(slabs.high)
        if not (largest < 2.0**40).all():
            raise BounderError("numbers are so large that float32 quotients may overflow")
        rounding = gamma(n + 2) * largest + 4 * (n + 1) * (1 + largest) * TINY
        face = np.nextafter(round_up(slabs.high + (rounding + 2 * ROOM) * (1 + 1e-9)), np.float32(np.inf))
        self.slabs, self.weights = slabs, _numbers(slabs, face)


def second_faces(normals: np.ndarray, domain: RegionDomain) -> np.ndarray:
    """``(k,)``, where half-spaces end that have no other side: beyond the domain, however long the normals are."""
    return -np.maximum(np.abs(normals) @ domain.base.limit.astype(np.float64) * (1 + 1e-9), UNBOUNDED)


def _plane(slabs: Slabs, domain: RegionDomain) -> SlabPlane:
    if len(slabs.high) <= domain.space_ndim:
        raise BounderError(f"expected more than {domain.space_ndim} half-spaces, got {len(slabs.high)}")
    return SlabPlane(slabs._replace(low=second_faces(slabs.directions, domain)), domain)


class _Box(SlabBox):
    """Nearest corners; numbers: b, a. f is the least distance inwards, over half-spaces."""

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n, size = domain.space_ndim, np.abs(slabs.directions)
        reach = size @ domain.limit[:n].astype(np.float64)
        product = gamma(n + 3) * reach + 8 * (n + 1) * (1 + reach) * TINY
        self.error = float((product + gamma(3) * (reach + product + np.abs(slabs.high)) + 4 * TINY).max() * (1 + 1e-9))
        self.slabs, self.weights = slabs, _numbers(slabs, slabs.high)

    def reference(self, v: np.ndarray) -> np.ndarray:
        low, high = np.split(v, 2, axis=1)
        rise, fall = np.maximum(self.slabs.directions, 0), np.minimum(self.slabs.directions, 0)
        return (self.slabs.high - low @ rise.T - high @ fall.T).min(axis=1)


TESTS = {"point": _Point, "ray": _Ray, "plane": _plane, "box": _Box}  # by the name of the kind of query
