"""Intersections of free half-spaces ``P = {y: a_k . y <= b_k}``: native code for points, rays, planes and boxes.

* Point: ``f = min_k (b_k - a_k . v)``, concave.
* Ray: the segment is clipped by every half-space, as by a slab (``slab_regions``): faces are moved out by all that rounding can do.
* Plane: against P's vertices, as for slabs (``SlabPlane``).
* Box: on every normal, its nearest corner; conservative, as is the classic test of k-DOPs.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_bounding.arithmetic import TINY, gamma, round_up
from warp_bounding.bounders.polytopes.native import TEXTS
from warp_bounding.bounders.polytopes.plain import PLAIN
from warp_bounding.bounders.slabs.regions import ROOM, SlabPlane, Slabs
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import Lanes, Source, fill

__all__ = ["REGIONS", "HalfSpaceBox", "HalfSpaceRay", "HalfSpacesSource"]

UNBOUNDED = (
    2.0**20
)  # where half-spaces have no second face, or beyond the domain: vertices there are kept, and do no harm


@dataclass(frozen=True)
class HalfSpacesSource(Source):
    """Native code of the test. Numbers: ``b[k]``, then ``a`` ``(k, n)``; of planes, see ``SlabPlane``."""

    half_spaces: int

    def body(self, lanes: Lanes) -> str:
        """See ``Source.body``."""
        return fill(TEXTS[self.tested_kind], n=self.tested_ndim, half_spaces=self.half_spaces)

    def plain(self) -> wp.Function:
        """See ``Source.plain``."""
        return PLAIN[self.tested_kind](self)


def _plane(normals: np.ndarray, offsets: np.ndarray, domain: RegionDomain) -> SlabPlane:
    if len(offsets) <= domain.space_ndim:
        raise BounderError(f"expected more than {domain.space_ndim} half-spaces, got {len(offsets)}")
    return SlabPlane(Slabs(normals, second_faces(normals, domain), offsets, False), domain)


def second_faces(normals: np.ndarray, domain: RegionDomain) -> np.ndarray:
    """``(k,)``, where half-spaces end that have no other side: beyond the domain, however long the normals are."""
    return -np.maximum(np.abs(normals) @ domain.base.limit.astype(np.float64) * (1 + 1e-9), UNBOUNDED)


class HalfSpaceRay:
    """Clipping; numbers: b moved out, a. f is 0 or -1, without an error."""

    error = 0.0

    def __init__(self, normals: np.ndarray, offsets: np.ndarray, domain: RegionDomain):
        n = domain.space_ndim
        limit, size = domain.limit.astype(np.float64), np.abs(normals)
        largest = size @ limit[:n] + size @ limit[n:] + np.abs(offsets)
        if not (largest < 2.0**40).all():
            raise BounderError("numbers are so large that float32 quotients may overflow")
        rounding = gamma(n + 2) * largest + 4 * (n + 1) * (1 + largest) * TINY
        face = np.nextafter(round_up(offsets + (rounding + 2 * ROOM) * (1 + 1e-9)), np.float32(np.inf))
        self.weights = np.concatenate([face, normals.reshape(-1)]).astype(np.float32)
        self.normals, self.offsets = normals, offsets

    def reference(self, v: np.ndarray) -> np.ndarray:
        """The same without any room."""
        n = self.normals.shape[1]
        y, s = self.offsets - v[:, :n] @ self.normals.T, v[:, n:] @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = y / s
        enter = np.where(s < 0, at, np.where((s == 0) & (y < 0), np.inf, 0)).max(axis=1)
        leave = np.where(s > 0, at, 1).min(axis=1)
        return np.where(np.maximum(enter, 0) <= np.minimum(leave, 1), 0.0, -1.0)


class HalfSpaceBox:
    """Nearest corners; numbers: b, a. f is the least distance inwards, over half-spaces."""

    def __init__(self, normals: np.ndarray, offsets: np.ndarray, domain: RegionDomain):
        n = domain.space_ndim
        reach = np.abs(normals) @ domain.limit[:n].astype(np.float64)
        product = gamma(n + 3) * reach + 8 * (n + 1) * (1 + reach) * TINY
        self.error = float((product + gamma(3) * (reach + product + np.abs(offsets)) + 4 * TINY).max() * (1 + 1e-9))
        self.weights = np.concatenate([offsets, normals.reshape(-1)]).astype(np.float32)
        self.normals, self.offsets = normals, offsets

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``HalfSpaceBox``."""
        n = self.normals.shape[1]
        rise, fall = np.maximum(self.normals, 0), np.minimum(self.normals, 0)
        return (self.offsets - v[:, :n] @ rise.T - v[:, n:] @ fall.T).min(axis=1)


REGIONS = {"ray": HalfSpaceRay, "plane": _plane, "box": HalfSpaceBox}  # by the name of the kind of query
