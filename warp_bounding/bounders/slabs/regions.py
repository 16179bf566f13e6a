"""Rays, planes and boxes against an intersection of slabs ``P = {y: low_k <= d_k . y <= high_k}``.

* Ray: the segment is clipped by every slab (Kay and Kajiya 1986). The slabs are widened by all that the rounding of
  ``d . a`` and ``d . w`` can do; a quotient then has a relative error of a few roundings, and parameters lie in [0, 1].
* Plane: against P's support. Where there are n slabs, P is a parallelepiped and its support a sum over its edges; with more
  slabs the support is the largest value at P's vertices. Exact.
* Box: the intervals of the box and of P on the slabs' directions. Where P is a box that is turned, also on the coordinate axes
  and, in 3D, on the products of the edges (Gottschalk et al. 1996): exact in 2D and 3D. Conservative where edges of two
  dimensions and more would be needed: for turned boxes in 4D and above, and for k-DOPs, whose classic test these are.

Every test decides between *meets P* (f >= 0 up to rounding) and *misses P*: nothing is claimed of points outside P. What
a test reads (edges, vertices, widened faces) follows from the slabs alone, so a file holds nothing that could contradict them.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT64, gamma, round_down, round_up
from warp_bounding.coordinates.base import GUARD, PARALLEL
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.checked_inverse import checked_inverse, polytope_vertices
from warp_bounding.kernels.source import Source

__all__ = ["CLIP", "CORNERS", "REGIONS", "ROOM", "TEXTS", "SlabBox", "SlabPlane", "SlabRay", "Slabs"]

ROOM = 2.0**-60  # a face is at least this far from P where a ray may run along it: far more than PARALLEL


class Slabs(NamedTuple):
    """The numbers of P, as float64: directions ``(k, n)``, low and high ``(k,)``; diagonal: the directions are the axes."""

    directions: np.ndarray
    low: np.ndarray
    high: np.ndarray
    diagonal: bool


# --- C text of f, for points and for each kind of region ---------------------------------------------------------------


def _row(y: str, at: str) -> str:
    """C text of ``y``, the product of direction i (numbers at ``d``) with the point at ``v[at]``."""
    return f"""
        V {y} = DIAGONAL ? v[{at} + i % N] : v[{at}] * d[0];
#pragma unroll
        for (int j = 1; j < N && !DIAGONAL; ++j) {y} = {y} + v[{at} + j] * d[j];
"""


# Slab clipping without a division by zero: a face that may be met is at least ``ROOM / 2`` away from a ray that runs along it, so the
# parameters at which a speed of ``PARALLEL`` meets the faces lie outside [0, 1] as they should.
CLIP = f"""
auto slow_of = [&](V s) {{  // one over the speed
    const V none = {{}};
    const V speed = s < none ? -s : s;
    const V cross = speed > {PARALLEL.hex()}f ? s : none + {PARALLEL.hex()}f;
    return over(none + 1.0f, cross);
}};
V enter = {{}}, leave = enter + 1.0f;
auto clip = [&](float low, float high, V y, V slow) {{  // y + t s lies in [low, high] between two parameters
    const V one = (low - y) * slow, two = (high - y) * slow;
    const V near = one < two ? one : two, away = one < two ? two : one;
    enter = near > enter ? near : enter;
    leave = away < leave ? away : leave;
}};
"""

_CONSTANTS = """
    constexpr int N = $n, K = $slabs;
    constexpr bool DIAGONAL = $diagonal;
    const V none = {};
"""

_POINT = f"""
{{
    {_CONSTANTS}
    f = none + 3.0e38f;
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        const float* d = w + 2 * K + i * N;
        {_row("y", "0")}
        const V a = y - w[i], b = w[K + i] - y, c = a < b ? a : b;
        f = c < f ? c : f;
    }}
}}
"""

_RAY = f"""
{{
    {_CONSTANTS}
    {CLIP}
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        const float* d = w + 2 * K + i * N;
        {_row("y", "0")}
        {_row("s", "N")}
        clip(w[i], w[K + i], y, slow_of(s));
    }}
    f = enter <= leave + {GUARD.hex()}f ? none : none - 1.0f;
}}
"""

_EDGES = f"""
{{
    {_CONSTANTS}
    V foot = v[0] * w[0];
#pragma unroll
    for (int j = 1; j < N; ++j) foot = foot + v[j] * w[j];
    V off = v[N] - foot;
    off = off < none ? -off : off;
    V reach = none;
#pragma unroll
    for (int i = 0; i < N; ++i) {{
        const float* d = w + N + i * N;
        V y = DIAGONAL ? v[i] * w[N + i] : v[0] * d[0];
#pragma unroll
        for (int j = 1; j < N && !DIAGONAL; ++j) y = y + v[j] * d[j];
        reach = reach + (y < none ? -y : y);
    }}
    f = reach - off;
}}
"""

CORNERS = """
{
    constexpr int N = $n;
    const V none = {};
    const int corners = (int)w[0];
    V most = none - 3.0e38f, least = none + 3.0e38f;
    for (int i = 0; i < corners; ++i) {
        const float* at = w + 1 + i * N;
        V y = v[0] * at[0];
#pragma unroll
        for (int j = 1; j < N; ++j) y = y + v[j] * at[j];
        most = y > most ? y : most;
        least = y < least ? y : least;
    }
    most = most - v[N];
    least = v[N] - least;
    f = most < least ? most : least;
}
"""

_BOX = f"""
{{
    {_CONSTANTS}
    f = none + 3.0e38f;
    V middle[N], half[N];
#pragma unroll
    for (int j = 0; j < N; ++j) {{
        middle[j] = (v[j] + v[N + j]) * 0.5f;
        half[j] = (v[N + j] - v[j]) * 0.5f;
    }}
#pragma unroll
    for (int i = 0; i < K; ++i) {{
        V a = v[i % N], b = v[N + i % N];
        if (!DIAGONAL) {{
            const float* d = w + 2 * K + i * N;
            V y = middle[0] * d[0], r = half[0] * (d[0] < 0.0f ? -d[0] : d[0]);
#pragma unroll
            for (int j = 1; j < N; ++j) {{
                y = y + middle[j] * d[j];
                r = r + half[j] * (d[j] < 0.0f ? -d[j] : d[j]);
            }}
            a = y - r;
            b = y + r;
        }}
        const V c = b - w[i], e = w[K + i] - a, overlap = c < e ? c : e;
        f = overlap < f ? overlap : f;
    }}
}}
"""


def _plane(source: Source) -> str:
    """Of a parallelepiped by its edges, of other polytopes by their vertices."""
    return CORNERS if source.slabs > source.ndim else _EDGES


TEXTS = {"point": lambda _: _POINT, "ray": lambda _: _RAY, "plane": _plane, "box": lambda _: _BOX}


# --- what a test reads, and what it rounds --------------------------------------------------------------------------


class SlabRay:
    """Slab clipping; numbers: widened low, widened high, directions unless diagonal; f is 0 or -1, without an error."""

    error = 0.0

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        limit, size = domain.limit.astype(np.float64), np.abs(slabs.directions)
        largest = size @ limit[:n] + size @ limit[n:] + np.maximum(np.abs(slabs.low), np.abs(slabs.high))
        if not (largest < 2.0**40).all():
            raise BounderError("numbers are so large that float32 quotients may overflow")
        # At a point a + t w of P in the domain, |a| and t |w| are at most the limit and twice that, however long the ray is.
        flushed = 8 * (n + 1) * (1 + largest) * TINY
        rounding = 0.0 if slabs.diagonal else gamma(n + 2) * 3 * (size @ limit[:n]) + flushed
        room = (rounding + 2 * ROOM) * (1 + 1e-9)
        # The next float32 besides: where low is so large that float64 loses ROOM, float32 numbers are farther apart than ROOM.
        low = np.nextafter(round_down(slabs.low - room), np.float32(-np.inf))
        high = np.nextafter(round_up(slabs.high + room), np.float32(np.inf))
        parts = [low, high, slabs.directions.reshape(-1)]
        self.weights = np.concatenate(parts[:2] if slabs.diagonal else parts).astype(np.float32)
        self.count, self.slabs = len(slabs.low), slabs

    def reference(self, v: np.ndarray) -> np.ndarray:
        """The same without any room."""
        n = self.slabs.directions.shape[1]
        y, s = v[:, :n] @ self.slabs.directions.T, v[:, n:] @ self.slabs.directions.T
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort(np.stack([(self.slabs.low - y) / s, (self.slabs.high - y) / s]), axis=0)
        within = (y >= self.slabs.low) & (y <= self.slabs.high)
        near = np.where(s != 0, ends[0], np.where(within, -np.inf, np.inf)).max(axis=1)
        away = np.where(s != 0, ends[1], np.inf).min(axis=1)
        return np.where(np.maximum(near, 0) <= np.minimum(away, 1), 0.0, -1.0)


class SlabPlane:
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
        self.numbers, self.count = numbers.astype(np.float64), len(slabs.low)
        # Entries of m are at most 1. Products and sums of up to n + 1 rows, in any order, and two subtractions.
        self.error = float((moved + gamma(2 * n + 5) * size) * (1 + 1e-9) + 8 * (n + 1) ** 2 * (1 + size) * TINY)

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``SlabBounder``."""
        at, offset = v[:, :-1] @ self.numbers.T, v[:, -1]
        if self.corners:
            return np.minimum(at.max(axis=1) - offset, offset - at.min(axis=1))
        return np.abs(at[:, 1:]).sum(axis=1) - np.abs(offset - at[:, 0])


class SlabBox:
    """Intervals on directions; numbers: low, high, directions unless diagonal. f is the least overlap."""

    def __init__(self, slabs: Slabs, domain: RegionDomain):
        n = domain.space_ndim
        tested = slabs if slabs.diagonal or len(slabs.low) != n else _separating(slabs)
        limit, size = domain.limit[:n].astype(np.float64), np.abs(tested.directions)
        reach, largest = size @ limit, np.maximum(np.abs(tested.low), np.abs(tested.high))
        # The middle and the half of the box round once, products and sums as ever; |middle| + half <= limit.
        product = 0.0 if slabs.diagonal else gamma(n + 3) * reach + 8 * (n + 1) * (1 + reach) * TINY
        self.error = float((product + gamma(3) * (reach + product + largest) + 4 * TINY).max() * (1 + 1e-9))
        parts = (
            [tested.low, tested.high] if slabs.diagonal else [tested.low, tested.high, tested.directions.reshape(-1)]
        )
        self.weights = np.concatenate(parts).astype(np.float32)
        self.count, self.slabs = len(tested.low), tested

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``SlabBounder``."""
        n, d = self.slabs.directions.shape[1], self.slabs.directions
        y, r = (v[:, :n] + v[:, n:]) / 2 @ d.T, (v[:, n:] - v[:, :n]) / 2 @ np.abs(d).T
        return np.minimum(y + r - self.slabs.low, self.slabs.high - (y - r)).min(axis=1)


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
    room = (away + gamma(n + 2, UNIT64) * np.abs(share)) @ np.maximum(np.abs(slabs.low), np.abs(slabs.high))
    low = round_down(np.minimum(first, last).sum(axis=1) - room).astype(np.float64)
    high = round_up(np.maximum(first, last).sum(axis=1) + room).astype(np.float64)
    return Slabs(
        np.concatenate([slabs.directions, more]),
        np.concatenate([slabs.low, low]),
        np.concatenate([slabs.high, high]),
        False,
    )


REGIONS = {"ray": SlabRay, "plane": SlabPlane, "box": SlabBox}  # by the name of the kind of query
