"""The least f over the part of a box in a half-space, and the part of the box that matters, from linear bounds of both."""

from typing import NamedTuple

import numpy as np

from warp_bounding.arithmetic import UNIT64
from warp_bounding.indicators.shape import HalfSpaces
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.queries.domain import GROWTH, Domain

__all__ = ["HeldBounds", "bound_in_half_spaces"]

# float64 roundings, at most, through which any term of a sum below goes: the map to local space and back takes 8, a
# term of a sum over the axes one for each axis (fewer than 64).
ROUNDINGS = 128.0


class HeldBounds(NamedTuple):
    """What is known about f over those v of N boxes that come from points of the object.

    Attributes:
        lower: ``(N,)`` certified lower bounds of f there; infinity where a box holds no such v.
        axis: ``(N,)`` the axis along which halving the box should help most.
        corners: ``(N, n)`` lower and upper corners of the parts of the boxes that matter: every other such v has f of
            at least the target.
        cut: ``(N,)`` bool, which boxes lost something by that.
    """

    lower: np.ndarray
    axis: np.ndarray
    corners: tuple[np.ndarray, np.ndarray]
    cut: np.ndarray


def bound_in_half_spaces(
    domain: Domain, lower: np.ndarray, upper: np.ndarray, bounds: BoxBounds, known: HalfSpaces, target: np.ndarray
) -> HeldBounds:
    """Bounds of f over the v of boxes that come from points of half-spaces.

    With ``f >= a + b . zeta``, ``|zeta| <= 1``, on the box, and ``c + d . zeta >= 0`` for every v of such a point, f is
    at least ``a - s c + (b - s d) . zeta`` there for any ``s >= 0``. That is concave in s and bends where an entry of
    ``b - s d`` changes its sign; the best of these is taken. What matters of a box is where none of these three linear
    functions tells that a point is not in the half-space, or that f is no less than the target.

    Args:
        domain: Maps points to v; its ``delta`` is counted in.
        lower: ``(N, n)`` float64 corners of boxes, coordinates v.
        upper: ``(N, n)`` float64.
        bounds: Of f over these boxes, with ``level`` and ``slope``.
        known: Half-spaces, object space, over the boxes' ``Domain.origins``.
        target: ``(N,)``, f that is of no interest any more.
    """
    center, radius, scale = (lower + upper) / 2, (upper - lower) / 2 * GROWTH, domain.scale.astype(np.float64)
    at, rate = domain.to_local(known.center), known.slope / scale
    away = 1 + np.abs(center) + np.abs(at) + np.abs(domain.center) * scale
    reach = domain.delta * GROWTH + ROUNDINGS * UNIT64 * away
    c = known.level + (rate * (center - at)).sum(axis=1) + (np.abs(rate) * reach).sum(axis=1)
    c += ROUNDINGS * UNIT64 * np.abs(known.level)
    a = bounds.level - ROUNDINGS * UNIT64 * (np.abs(bounds.slope) * away).sum(axis=1)
    b, d = bounds.slope * radius, rate * radius
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = b / d
    shares = np.where((shares > 0) & np.isfinite(shares), shares, 0.0)
    best, share = np.full(len(b), -np.inf), np.zeros(len(b))
    for each in shares.T:
        value = a - each * c - np.abs(b - each[:, None] * d).sum(axis=1)
        better = value > best
        best, share = np.where(better, value, best), np.where(better, each, share)
    # The best of them once more, with what its float64 arithmetic may round.
    size = np.abs(a) + share * np.abs(c) + (np.abs(b) + share[:, None] * np.abs(d)).sum(axis=1)
    best = best - ROUNDINGS * UNIT64 * size
    low, high = np.full_like(b, -1.0), np.ones_like(b)
    joint = a - share * c - ROUNDINGS * UNIT64 * size, b - share[:, None] * d
    for rest, line in ((c, -d), (target - a, b), (target - joint[0], joint[1])):
        _cut(low, high, rest, line)
    least, gone = np.fmax(best, bounds.lower), known.empty | (low > high).any(axis=1)
    least = np.where(known.empty, np.inf, np.where(gone, np.fmax(least, target), least))
    low[gone], high[gone] = -1.0, 1.0
    by_shape = share * known.loss > bounds.value - bounds.lower
    room = ROUNDINGS * UNIT64 * away
    low, high = np.maximum(lower, center + radius * low - room), np.minimum(upper, center + radius * high + room)
    cut = ((low > lower) | (high < upper)).any(axis=1)
    return HeldBounds(least, np.where(by_shape, known.axis, bounds.axis), (low, high), cut)


def _cut(low: np.ndarray, high: np.ndarray, rest: np.ndarray, line: np.ndarray) -> None:
    """Narrow the ranges of zeta in place to where ``line . zeta <= rest`` can hold for some zeta with ``|zeta| <= 1``."""
    size = np.abs(line)
    whole = size.sum(axis=1)
    rest = rest + whole + ROUNDINGS * UNIT64 * (np.abs(rest) + whole)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        end = (rest[:, None] - size) / size
    end = np.where(np.isfinite(end), end * (1 + np.sign(end) * 1e-12) + 1e-12, np.inf)
    np.copyto(high, np.minimum(high, end), where=line > 0)
    np.copyto(low, np.maximum(low, -end), where=line < 0)
