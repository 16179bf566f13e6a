"""Thresholds of the parts of a domain of points: the certified least f of the positives in each, found in one search."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.mlp import EVERYWHERE, Lattice, Local, Mlp
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.prove import settle
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.search.vacancy import ShapePositives

__all__ = ["at_least", "needless", "prove_local", "worthwhile"]

STEPS = 8  # sizes of steps that are tried, each half of the one before; the first one reaches the highest threshold
COST = 0.1  # negatives, in the mean: what a part's gap may make a false positive
FINEST = 2.0**-10  # of the thresholds: a largest step that is not worth less


def prove_local(
    member: Mlp,
    lattice: Lattice,
    shape: Shape,
    negatives: np.ndarray,
    *,
    points: np.ndarray,
    eps: float,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    progress: Callable[[int, float, float], None] | None = None,
) -> tuple[Local, Search]:
    """A network at proven thresholds of the parts of its domain, with its certificate.

    Args:
        member: The network, of points; its own threshold is not used.
        lattice: The parts.
        shape: The object.
        negatives: ``(N, n)`` coordinates v that are no positives: they tell which step between levels denies most.
        points: As of ``prove``.
        eps: Largest gap, in f, of a part where a larger one would deny fewer of the negatives.
        seconds: As of ``prove``; parts whose search has not ended are looser, the others are not.
        boxes: As of ``prove``.
        progress: As of ``prove``.

    Raises:
        BounderError: If the thresholds are beyond what levels can tell.
    """
    values, place = member.reference(negatives), lattice.place(negatives)
    found = np.full(lattice.count, np.inf)
    np.minimum.at(found, lattice.place(points), member.reference(points))
    limits = {
        "eps": worthwhile(lattice, found, values, place, eps),
        "seconds": seconds,
        "boxes": boxes,
        "progress": progress,
    }
    if isinstance(shape, IndicatorGrid):
        f, *corners = COVERS[member.query_kind].best_first(member, shape)
        positives = None
    else:
        f = positives = ShapePositives(member, shape)
        corners = positives.boxes()
    lower, upper, _ = lattice.cut(*corners)
    kinds = {"groups": lattice.place(lower), "group_of": lattice.place, "group_count": lattice.count}
    lost = Lost(values, place, found)
    search = minimum(f, lower, upper, points=points, positives=positives, price=lost, **kinds, **limits)
    least = search.by_group
    bounder, proven = at_least(member, lattice, needless(least, values, place), values, place)
    settle(bounder, shape, replace(search, lower_bound=proven))
    return bounder, search


class Lost:
    """What it costs that the least f in a part is known to be no less than a bound: how many negatives are let through that need not be.

    Args:
        values: f of negatives ``(N,)``.
        place: Their parts.
        least: ``(parts,)``, the least f of positives that is known in each.
    """

    def __init__(self, values: np.ndarray, place: np.ndarray, least: np.ndarray):
        self._span = max(float(np.ptp(values)), 1e-30) * 4
        self._first, self._least = float(values.min()), least
        self._sorted = np.sort(self._key(values, place))
        self._denied = np.searchsorted(self._sorted, self._key(least, np.arange(len(least))))

    def _key(self, f: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Grows with the part, and in a part with f."""
        return place + np.clip((f - self._first) / self._span, -0.25, 0.5) + 0.25

    def __call__(self, bound: np.ndarray, place: np.ndarray) -> np.ndarray:
        """``(K,)``; of bounds that cost no negative, those farther from the least f cost more."""
        with np.errstate(invalid="ignore"):
            gap = np.nan_to_num((self._least[place] - bound) / self._span, nan=1.0, posinf=1.0)
        denied = np.searchsorted(self._sorted, self._key(bound, place))
        return np.maximum(self._denied[place] - denied, 0) + np.clip(gap, 0.0, 0.5)


def at_least(
    member: Mlp, lattice: Lattice, least: np.ndarray, values: np.ndarray, place: np.ndarray
) -> tuple[Local, float]:
    """A network at thresholds under the least f ``(parts,)`` of the parts' positives, and the least f of the whole.

    Args:
        member: The network.
        lattice: The parts.
        least: Infinity where no positive lies, minus infinity where nothing is to be denied.
        values: Of the network at negatives ``(N,)``, by which the step between levels is chosen.
        place: Their parts.

    Raises:
        BounderError: If the thresholds are beyond what levels can tell.
    """
    bounder, some = _finest(member, lattice, least, values, place), np.isfinite(least)
    # Where nothing is denied, f is ``CERTAIN``; it may be so wherever there are positives, as after a training of no time.
    return bounder, float(np.nextafter((least[some] - bounder.thresholds[some]).min(initial=1.0), -np.inf))


def needless(least: np.ndarray, values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The least f ``(parts,)``, but minus infinity where no negative lies below; arguments as of ``at_least``."""
    denied = np.bincount(place[values < least[place]], minlength=len(least))
    return np.where((denied == 0) & (least < np.inf), -np.inf, least)


def worthwhile(lattice: Lattice, least: np.ndarray, values: np.ndarray, place: np.ndarray, eps: float) -> np.ndarray:
    """``(parts,)``, the gap in each part that would make about ``COST`` more negatives a false positive, at least ``eps``.

    Arguments as of ``at_least``; ``eps`` where no positive is known.
    """
    below = values < least[place]
    nearest = np.full(lattice.count, -np.inf)
    np.maximum.at(nearest, place[below], values[below])
    gap = np.where(np.isfinite(least), COST * (least - nearest), eps)  # infinite where nothing is there to be denied
    return np.maximum(np.minimum(gap, np.ptp(values)), eps)


def _finest(member: Mlp, lattice: Lattice, least: np.ndarray, values: np.ndarray, place: np.ndarray) -> Local:
    """The bounder with the step that denies most of some negatives, given by f and their parts."""
    some = least[np.isfinite(least)]
    reach = float(np.ptp(some) if len(some) else 0.0) / (EVERYWHERE - 2)
    largest = 2.0 ** np.ceil(np.log2(max(reach, FINEST * float(np.abs(some).max(initial=0.0)), FINEST)))
    tried = [Local.of(member, lattice, least, largest * 0.5**halved) for halved in range(STEPS)]
    return max(tried, key=lambda bounder: int((values < bounder.thresholds[place]).sum()))
