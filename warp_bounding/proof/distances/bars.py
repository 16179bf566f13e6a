"""Up to what excess a box is good enough, in each part of the domain: a little above the greatest that was ever met there.

Samples miss the greatest excess of a part, and a search that asks for less than there is halves boxes around it for nothing. So where a search gets stuck, F
and the distance themselves are asked in the middles of its boxes, and the part's bar rises.
"""

import numpy as np

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.indicators.shape import Shape

__all__ = ["Bars", "excesses_at"]

ASKED = 1024  # boxes of a chunk in whose middles F is asked, at most: those whose bounds are farthest above their bars


def excesses_at(bounder: DistanceBounder, shape: Shape, v: np.ndarray) -> np.ndarray | None:
    """By how much F exceeds the distance at points ``(N, n)``, local coordinates and units; ``None`` where no distance is known."""
    known = shape.distances(bounder.domain.sample_at(v))
    return None if known is None else bounder.reference(v) - known[:, 0] / bounder.domain.unit


class Bars:
    """Bars of the parts of a domain.

    Args:
        met: ``(parts,)``, the greatest excess that was met in each part, local units; raised in place.
        above: By how much a bar is above that.
        parts: ``(N,)`` int, the parts in which a search's first boxes lie.
        fixed: Never raise them.

    Attributes:
        raised: Where F exceeds the distance by more than what had been met in the part, ``(K, n)`` arrays, local coordinates.
    """

    def __init__(self, met: np.ndarray, above: float, parts: np.ndarray, *, fixed: bool = False):
        self.met, self.above, self.parts, self.fixed = met, above, parts, fixed
        self.raised: list[np.ndarray] = []

    @classmethod
    def of_boxes(cls, tolerance: np.ndarray | float, count: int) -> "Bars":
        """Bars that do not rise, one for each of ``count`` first boxes, or one for all."""
        return cls(np.broadcast_to(tolerance, count), 0.0, np.arange(count), fixed=True)

    def of(self, owner: np.ndarray) -> np.ndarray:
        """``(K,)``, the bars of boxes that came from the first boxes of these numbers."""
        return self.met[self.parts[owner]] + self.above

    def rise(
        self,
        bounder: DistanceBounder,
        shape: Shape,
        low: np.ndarray,
        high: np.ndarray,
        owner: np.ndarray,
        excess: np.ndarray,
    ) -> None:
        """Ask F where bounds ``excess`` of boxes are farthest above their bars, and raise these where it is greater than what was met."""
        if self.fixed or not len(low):
            return
        over = excess - self.of(owner)
        asked = np.argpartition(-over, ASKED)[:ASKED] if len(over) > ASKED else np.arange(len(over))
        v, parts = low[asked] / 2 + high[asked] / 2, self.parts[owner[asked]]
        met = excesses_at(bounder, shape, v)
        if met is not None:
            self.raised.append(v[met > self.met[parts]])
            np.maximum.at(self.met, parts, met)
