"""How far segments are said to be clear, against the truth at many points of them."""

from collections.abc import Callable

import numpy as np

import warp_bounding as wb
from warp_bounding.bounders.bounder import Bounder

SIZES = range(1, 21)  # segments of a call: lanes share fewer than 8 of them
COUNT = sum(SIZES)
POINTS = 500  # of a segment


def met(bounder: Bounder, v: np.ndarray) -> np.ndarray:
    """Whether f is so high at coordinates that a proven object may be there: what segments must stay out of."""
    if len(bounder.parts) > 1:
        return np.all([met(part, v) for part in bounder.parts], axis=0)
    within = (np.abs(v) <= bounder.domain.limit).all(axis=1)
    return within & (bounder.reference(v) >= float(bounder.threshold) + bounder.rounding_bound())


def check_until(bounder: Bounder, contains: Callable, starts: np.ndarray, ends: np.ndarray) -> None:
    """No point of the object lies before the place up to which a segment is clear, however many are asked together."""
    t, way = np.linspace(0, 1, POINTS), np.asarray(ends, np.float64) - starts
    along = np.asarray(starts, np.float64)[:, None] + t[:, None] * way[:, None]
    held = contains(along.reshape(-1, along.shape[2])).reshape(len(starts), POINTS)
    enters = np.where(held.any(axis=1), t[held.argmax(axis=1)], np.inf)
    assert 0 < held.any(axis=1).mean() < 1, held.any(axis=1).mean()
    assert len(starts) == COUNT
    for first in (True, False):
        edge, last, found = wb.proof.Segments(bounder, first=first), np.cumsum(SIZES), []
        for begin, end in zip(last - SIZES, last, strict=True):
            found.append(edge(starts[begin:end], ends[begin:end]))
        cleared, until = (np.concatenate(each) for each in zip(*found, strict=True))
        assert not (cleared & held.any(axis=1)).any()
        assert (until <= enters).all()
        assert (until[cleared] == 1).all()
        assert cleared.any()
        assert ((until > 0) & ~cleared).any() or not first
