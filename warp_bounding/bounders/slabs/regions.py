"""Points, rays, planes and boxes against an intersection of slabs ``P = {y: low_k <= d_k . y <= high_k}``.

* Point: the least distance to a face.
* Ray: the segment is clipped by every slab (Kay and Kajiya 1986). The slabs are widened by all that the rounding of
  ``d . a`` and ``d . w`` can do; a quotient then has a relative error of a few roundings, and parameters lie in [0, 1].
* Plane: against P's support. Where there are n slabs, P is a parallelepiped and its support a sum over its edges; with more
  slabs the support is the largest value at P's vertices. Exact.
* Box: the intervals of the box and of P on the slabs' directions. Where P is a box that is turned, also on the coordinate axes
  and, in 3D, on the products of the edges (Gottschalk et al. 1996): exact in 2D and 3D. Conservative where edges of two
  dimensions and more would be needed: for turned boxes in 4D and above, and for k-DOPs, whose classic test these are.

Every test of a region decides between *meets P* (f >= 0 up to rounding) and *misses P*: nothing is claimed of points outside P. What
a test reads (edges, vertices, widened faces) follows from the slabs alone, so a file holds nothing that could contradict them.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT64, gamma, round_down, round_up
from warp_bounding.bounders.volume import VolumeTest
from warp_bounding.coordinates.region_domain import AnyDomain, RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.checked_inverse import checked_inverse, polytope_vertices
from warp_bounding.networks.box_bounds import BoxBounds

__all__ = ["ROOM", "TESTS", "SlabBox", "SlabPlane", "SlabPoint", "SlabRay", "Slabs"]

ROOM = 2.0**-60  # a face is at least this far from P where a ray may run along it: far more than PARALLEL


class Slabs(NamedTuple):
    """The numbers of P, as float64: directions ``(k, n)``, low and high ``(k,)``; diagonal: the directions are the axes.

    Half-spaces are slabs whose low is minus infinity.
    """

    directions: np.ndarray
    low: np.ndarray
    high: np.ndarray
    diagonal: bool

    def numbers(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """float32, as bodies read slabs with these faces: the directions follow them unless they are the axes."""
        return np.concatenate([low, high, () if self.diagonal else self.directions.reshape(-1)]).astype(np.float32)

    @property
    def largest(self) -> np.ndarray:
        """``(k,)``, the larger size of each slab's faces."""
        return np.maximum(np.abs(self.low), np.abs(self.high))


class SlabPoint(VolumeTest):
    """The least distance to a face; numbers: low, high, directions unless diagonal."""

    def __init__(self, slabs: Slabs, domain: AnyDomain):
        self.slabs, self.weights = slabs, slabs.numbers(slabs.low, slabs.high)
        self.sizes = np.abs(slabs.low) + np.abs(slabs.high)
        # |d . v| is at most ``reach``. Its n products and sums (none if diagonal) round by gamma(n + 1) reach, the
        # subtraction of a face by gamma(2) of all that enters. Each of 2 n + 2 results may be set to zero, which takes
        # up to TINY; so may a factor, which takes up to TINY times the other factor, an entry of d or of the limit.
        n, limit, size = domain.ndim, domain.limit.astype(np.float64), np.abs(slabs.directions)
        reach = size @ limit
        product = 0.0 if slabs.diagonal else gamma(n + 1) * reach
        flushed = (2 * n + 2 + size.sum(axis=1) + domain.limit.sum()) * TINY
        self.error = float((product + gamma(2) * (reach + product + slabs.largest) + flushed).max())

    def reference(self, v: np.ndarray) -> np.ndarray:
        y = v @ self.slabs.directions.T
        return np.minimum(y - self.slabs.low, self.slabs.high - y).min(axis=1)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """``Bounder.bound`` of boxes of points."""
        d, low, high, _ = self.slabs
        center, half = (lower + upper) / 2, (upper - lower) / 2
        y, reach = center @ d.T, half @ np.abs(d).T
        slack = np.concatenate([y - reach - low, high - y - reach], axis=1)
        size = np.abs(lower).max(axis=0) + np.abs(upper).max(axis=0)
        rounding = gamma(2 * d.shape[1] + 8, UNIT64) * float((size @ np.abs(d).T + self.sizes).max())
        normal = np.concatenate([d, -d])[np.argmin(slack, axis=1)]
        point = np.where(normal > 0, lower, upper)
        return BoxBounds(slack.min(axis=1) - rounding, np.argmax(half, axis=1), point, self.reference(point))


class SlabRay(VolumeTest):
    """Slab clipping; numbers: widened low, widened high, directions unless diagonal; f is 0 or -1, without an error."""

    error = 0.0

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        limit, size = domain.limit.astype(np.float64), np.abs(slabs.directions)
        largest = size @ limit[:n] + size @ limit[n:] + slabs.largest
        if not (largest < 2.0**40).all():
            raise BounderError("numbers are so large that float32 quotients may overflow")
        # At a point a + t w of P in the domain, |a| and t |w| are at most the limit and twice that, however long the ray is.
        flushed = 8 * (n + 1) * (1 + largest) * TINY
        rounding = 0.0 if slabs.diagonal else gamma(n + 2) * 3 * (size @ limit[:n]) + flushed
        room = (rounding + 2 * ROOM) * (1 + 1e-9)
        # The next float32 besides: where low is so large that float64 loses ROOM, float32 numbers are farther apart than ROOM.
        low = np.nextafter(round_down(slabs.low - room), np.float32(-np.inf))
        high = np.nextafter(round_up(slabs.high + room), np.float32(np.inf))
        self.slabs, self.weights = slabs, slabs.numbers(low, high)

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``VolumeTest``; without any room."""
        d, low, high, _ = self.slabs
        n = d.shape[1]
        y, s = v[:, :n] @ d.T, v[:, n:] @ d.T
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort(np.stack([(low - y) / s, (high - y) / s]), axis=0)
        within = (y >= low) & (y <= high)
        near = np.where(s != 0, ends[0], np.where(within, -np.inf, np.inf)).max(axis=1)
        away = np.where(s != 0, ends[1], np.inf).min(axis=1)
        return np.where(np.maximum(near, 0) <= np.minimum(away, 1), 0.0, -1.0)


class SlabPlane(VolumeTest):
    """Support of P; numbers: middle and edges' halves (the halves alone if diagonal), or the number of vertices and those. f is a distance."""

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n, reach = domain.space_ndim, float(domain.limit[-1])
        if len(slabs.low) == n:
            inverse, error = (np.eye(n), np.zeros((n, n))) if slabs.diagonal else _inverse(slabs.directions)
            error = error + gamma(n + 3, UNIT64) * np.abs(inverse)
            middle, half = (slabs.low + slabs.high) / 2, (slabs.high - slabs.low) / 2
            exact = np.concatenate([(inverse @ middle)[None], (inverse * half).T])  # (1 + n, n)
            away = np.concatenate([(error @ np.abs(middle))[None], (error * np.abs(half)).T])
            numbers = exact.astype(np.float32)
            size = np.abs(numbers.astype(np.float64)).sum() + reach
            moved = (np.abs(numbers - exact) + away).sum()
            self.weights = np.concatenate([numbers[0], np.diag(numbers[1:])]) if slabs.diagonal else numbers.reshape(-1)
            self.corners = False
        else:
            numbers, away = polytope_vertices(slabs.directions, slabs.low, slabs.high)
            size, moved = np.abs(numbers.astype(np.float64)).sum(axis=1).max() + reach, away.sum(axis=1).max()
            self.weights, self.corners = np.concatenate([[np.float32(len(numbers))], numbers.reshape(-1)]), True
        self.numbers, self.slabs = numbers.astype(np.float64), slabs
        # Entries of m are at most 1. Products and sums of up to n + 1 rows, in any order, and two subtractions.
        self.error = float((moved + gamma(2 * n + 5) * size) * (1 + 1e-9) + 8 * (n + 1) ** 2 * (1 + size) * TINY)

    def reference(self, v: np.ndarray) -> np.ndarray:
        at, offset = v[:, :-1] @ self.numbers.T, v[:, -1]
        if self.corners:
            return np.minimum(at.max(axis=1) - offset, offset - at.min(axis=1))
        return np.abs(at[:, 1:]).sum(axis=1) - np.abs(offset - at[:, 0])


class SlabBox(VolumeTest):
    """Intervals on directions; numbers: low, high, directions unless diagonal. f is the least overlap."""

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        tested = slabs if slabs.diagonal or len(slabs.low) != n else _separating(slabs)
        limit, size = domain.limit[:n].astype(np.float64), np.abs(tested.directions)
        reach = size @ limit
        # The middle and the half of the box round once, products and sums as ever; |middle| + half <= limit.
        product = 0.0 if slabs.diagonal else gamma(n + 3) * reach + 8 * (n + 1) * (1 + reach) * TINY
        self.error = float((product + gamma(3) * (reach + product + tested.largest) + 4 * TINY).max() * (1 + 1e-9))
        self.slabs, self.weights = tested, tested.numbers(tested.low, tested.high)

    def reference(self, v: np.ndarray) -> np.ndarray:
        d, low, high, _ = self.slabs
        n = d.shape[1]
        y, r = (v[:, :n] + v[:, n:]) / 2 @ d.T, (v[:, n:] - v[:, :n]) / 2 @ np.abs(d).T
        return np.minimum(y + r - low, high - (y - r)).min(axis=1)


def _inverse(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = checked_inverse(directions)
    if found is None:
        raise BounderError("the slabs' directions are not independent")
    return found


def _separating(slabs: Slabs) -> Slabs:
    """The slabs of a parallelepiped and those around it, along the axes and, in 3D, along the products of axes and edges."""
    n = slabs.directions.shape[1]
    inverse, error = _inverse(slabs.directions)
    more = list(np.eye(n))
    if n == 3:
        for axis, edge in product(np.eye(3), inverse.T):
            normal = np.cross(axis, edge / np.abs(edge).max())
            if np.abs(normal).max() > 1e-3:
                more.append(normal / np.abs(normal).max())
    more = np.array(more).astype(np.float32).astype(np.float64)
    share = more @ inverse  # each direction as a sum of the slabs' directions
    away = np.abs(more) @ (error + gamma(n + 2, UNIT64) * np.abs(inverse))
    first, last = share * slabs.low, share * slabs.high
    room = (away + gamma(n + 2, UNIT64) * np.abs(share)) @ slabs.largest
    low = round_down(np.minimum(first, last).sum(axis=1) - room).astype(np.float64)
    high = round_up(np.maximum(first, last).sum(axis=1) + room).astype(np.float64)
    sides = zip(slabs[:3], (more, low, high), strict=True)
    return Slabs(*(np.concatenate(pair) for pair in sides), False)


TESTS = {"point": SlabPoint, "ray": SlabRay, "plane": SlabPlane, "box": SlabBox}  # by the name of the kind of query
