"""What float64 queries of a distance lose when they are rounded to float32, and lengths that are never too short.

g knows the float32 point alone. The float64 one is farther from it by what is told here, which is added to its radius or taken off its bound.
"""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warp_bounding.arithmetic import TINY, UNIT32, UNIT64, round_up
from warp_bounding.errors import QueryError

if TYPE_CHECKING:
    from warp_bounding.bounders.distances.asking import AskingDistance

__all__ = ["lengths_of", "longer", "moved", "outwards", "turned"]

GROWTH = 1.0 + 1e-12  # covers the float64 evaluation of a few sums and products


def moved(bounder: "AskingDistance", queries: wp.array, count: int, columns: int | None = None) -> np.ndarray:
    """How far from a float64 point its float32 one is at most, what g may fall by meanwhile included.

    Args:
        bounder: Of the distance.
        queries: float32, flat.
        count: N, how many there are.
        columns: Numbers of each, of which the point is the first ones; those of a point if ``None``.

    Returns:
        ``(N,)`` float64, object units.
    """
    x = np.abs(_rows(queries, count, columns or bounder.ndim)[:, : bounder.ndim])
    by, first = (UNIT32 * x + TINY) * GROWTH, int(bounder.domain.time)
    if bounder.frame is not None:  # taking off its origin rounds as well, and its blur counts with it
        by += 2 * UNIT64 * x + bounder.frame.blur
    return (np.linalg.norm(by[:, first:], axis=1) + bounder.pace * by[:, :first].sum(axis=1)) * GROWTH


def turned(rays: wp.array, count: int, lengths: np.ndarray) -> np.ndarray:
    """How far the end of a ray is at most from where its float64 direction leads.

    Args:
        rays: ``N`` origins and directions, float32, flat.
        count: N.
        lengths: One, or ``(N,)``.

    Returns:
        ``(N,)`` float64, object units.
    """
    ndim = len(rays) // (2 * count) if count else 1
    largest = np.abs(_rows(rays, count, 2 * ndim)[:, ndim:]).max(axis=1)
    with np.errstate(divide="ignore"):
        turn = UNIT32 + np.sqrt(ndim) * TINY / largest  # twice as much between directions of length 1
    return 2 * turn * lengths.astype(np.float64) * GROWTH


def outwards(flat: wp.array, side: float) -> wp.array:
    """Corners that were float64, each at the next float32 number towards ``side``."""
    return wp.array(np.nextafter(flat.numpy(), np.float32(side)), dtype=wp.float32, device=flat.device)


def longer(lengths: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Lengths, one or ``(N,)``, longer by ``(N,)``, as float32, rounded up; what is not finite is infinite."""
    with np.errstate(invalid="ignore"):
        found = (lengths.astype(np.float64) + by) * GROWTH
    found = np.where(np.isnan(found), np.inf, found)
    return round_up(found).astype(np.float32) if len(found) else lengths


def lengths_of(name: str, given, count: int) -> np.ndarray:
    """A length, or one per query, as float32, rounded up; raises ``QueryError`` for others."""
    if isinstance(given, wp.array):
        given = given.numpy()
    given = given.detach().cpu() if hasattr(given, "detach") else given
    try:
        values = np.asarray(given)
        values = values.astype(np.float64) if values.dtype.kind in "iuf" else None
    except (TypeError, ValueError):
        values = None
    if values is None or values.shape not in ((), (count,)):
        got = repr(given) if values is None else f"shape {values.shape}"
        raise QueryError(f"{name} must be a number of at least 0, or {count} of them, one per query; got {got}")
    values = values.reshape(-1)
    bad = ~(np.isfinite(values) & (values >= 0))
    if bad.any():
        raise QueryError(f"{name} must be finite and at least 0, got {values[bad][0]:g}")
    rounded = round_up(values).astype(np.float32)
    return rounded if len(rounded) else np.zeros(1, np.float32)


def _rows(flat: wp.array, count: int, columns: int) -> np.ndarray:
    """Queries ``(N, columns)`` float64 on the host."""
    return flat.numpy()[: count * columns].reshape(count, columns).astype(np.float64)
