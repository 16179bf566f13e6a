"""``learned-kdop``: a k-DOP whose k half-spaces are free and learned by gradient descent (the paper's OurkDOP).

As many half-spaces as ``kdop`` has, but each with a normal of its own instead of pairs on given axes. Learned are the
normals only (``training.learned_kdop``): every face is set to a certified upper bound of the support of what is
bounded, so any normals make a conservative volume, and any step of training can be the last. f is ``min_k (offset_k -
normal_k . v)``. Rays, planes and boxes are tested against the polytope.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.bounder import STEPS, Option
from warp_bounding.bounders.distance import FacesDistance
from warp_bounding.bounders.volumes import (
    BY_VERTICES,
    CLEARANCE,
    FaceBounder,
    SlabBox,
    SlabPlane,
    SlabPoint,
    SlabRay,
    Slabs,
    VolumeSource,
    kdop_directions,
    text,
)
from warp_bounding.errors import BounderError
from warp_bounding.geometry import MOST_VERTEX_DIMENSIONS
from warp_bounding.queries.boundary import ObjectSupport
from warp_bounding.queries.region_domain import AnyDomain, RegionDomain
from warp_bounding.rounding import TINY, gamma, round_up
from warp_bounding.shapes.grid import Grid

# --- native ----------------------------------------------------------------------------------------------------------

# Planes are tested as against slabs.
TEXTS = {"point": text.HALF_SPACES_POINT, "ray": text.HALF_SPACES_RAY}
TEXTS |= {"plane": text.CORNERS, "box": text.HALF_SPACES_BOX}


# --- half spaces -----------------------------------------------------------------------------------------------------
#
# Intersections of free half-spaces ``P = {y: a_k . y <= b_k}``, tested against points, rays, planes and boxes.
#
# They are slabs without a low face, so that their exact f is that of slabs; what they read and round is their own.
#
# * Point: ``f = min_k (b_k - a_k . v)``, concave.
# * Ray: the segment is clipped by every half-space; faces are moved out by all that rounding can do.
# * Plane: against P's vertices (``SlabPlane``).
# * Box: on every normal, its nearest corner; conservative, as is the classic test of k-DOPs.

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
        face = np.nextafter(round_up(slabs.high + (rounding + 2 * CLEARANCE) * (1 + 1e-9)), np.float32(np.inf))
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


def classic_normals(domain: AnyDomain, k: int | None = None) -> np.ndarray:
    """``kdop``'s half-spaces, where training starts from: ``(k, n)`` float64 normals in local space."""
    scale = domain.scale.astype(np.float64)
    directions = kdop_directions(len(scale), k) / scale  # because v = (x - center) scale
    return np.concatenate([directions, -directions])


class LearnedKdop(FaceBounder):
    """k free half-spaces; see module.

    Tensors: ``normals`` ``(k, n)`` and ``offsets`` ``(k,)``, in the coordinates of points.
    """

    method = "learned-kdop"
    tests = TESTS
    options = (
        Option(
            "k", None, "half-spaces, 128 at most; by default as many as kdop's, or 40 in front of a network", parse=int
        ),
        STEPS,
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and (query not in BY_VERTICES or ndim <= MOST_VERTEX_DIMENSIONS)

    @classmethod
    def fit(cls, grid: Grid, domain: AnyDomain, *, k: int | None = None, device: str | None = None) -> "LearnedKdop":
        """Where training starts: the half-spaces of ``kdop``, each on its own; ``k`` as ``kdop`` offers it."""
        return cls.of_normals(grid, domain, classic_normals(domain, k), device=device)

    @classmethod
    def of_normals(
        cls,
        grid: Grid,
        domain: AnyDomain,
        normals: np.ndarray,
        *,
        support: ObjectSupport | None = None,
        device: str | None = None,
    ) -> "LearnedKdop":
        """The tightest half-spaces with these normals ``(k, n)`` of any length; ``support`` is the object's."""
        normals = np.asarray(normals, dtype=np.float64)
        largest = np.abs(normals).max(axis=1, keepdims=True)
        normals = (normals / np.where(largest > 0, largest, 1)).astype(np.float32)
        if not (np.isfinite(normals).all() and (largest > 0).all()):
            raise BounderError("learned-kdop: a normal is zero or not finite")
        reach = (support or ObjectSupport(grid, domain.base))(normals.astype(np.float64))
        tight = cls(domain.base, {"normals": normals, "offsets": round_up(reach)}, {}, device)
        # The least f is about 2 E then, and the threshold, which lies E below it, at zero or a little above.
        offsets = round_up(reach + 2 * tight.rounding_bound())
        return cls(domain, {"normals": normals, "offsets": offsets}, {}, device)

    def check_tensors(self) -> None:
        columns, count = self.domain.base.ndim, max(len(self.tensors.get("offsets", ())), 1)
        self.expect_shapes({"normals": (count, columns), "offsets": (count,)})
        self.check_range()

    @property
    def shape(self) -> Slabs:
        normals, offsets = (self.tensors[name].astype(np.float64) for name in ("normals", "offsets"))
        return Slabs(normals, np.full(len(offsets), -np.inf), offsets, False)

    @property
    def source(self) -> HalfSpacesSource:
        return self.source_of(HalfSpacesSource, len(self.tensors["offsets"]))


class LearnedKdopDistance(FacesDistance):
    """A lower bound of the distance to the polytope: that to its farthest face."""

    method, bounds = LearnedKdop.method, LearnedKdop
    two_sided = False
