"""How near the least value a search may aim so that it ends in time."""

import numpy as np

__all__ = ["GROWTH", "Pace"]

# The work is taken to grow like (1 / gap)^GROWTH until two gaps have been measured, whose exponent is then used, within
# these bounds.
GROWTH = 0.2
FLATTEST, STEEPEST = 0.15, 0.7
END = 0.93  # used fraction of the limits at which a search should be done: the last boxes take longer than the others
HEADROOM = 1.15  # a new gap is chosen so that its expected time, times this, is what is left
LATE = 1.03  # a gap is given up where its expected time exceeds what is left by this factor
SURE = 4096  # initial boxes that must be done before a gap is judged, or
PATIENCE = 0.25  # this fraction of the time left must have passed: some 512 boxes are in work at any time
WIDEST = 3.0  # largest factor by which a gap is widened at once
OVERTIME, WIDER = 0.01, 3.0  # past END, a gap is widened by the factor WIDER after every OVERTIME of the limits


class Pace:
    """The gap between the least value known and the target of a search, as time goes on.

    Args:
        gap: The first gap, which is the best one that is asked for.
        used: Fraction of the limits (time, boxes) that preparations have used.

    Attributes:
        gap: The present gap.
        whole: Fraction of the limits that the first gap was expected to take when it was given up; 0 if it was not.
    """

    def __init__(self, gap: float, used: float = 0.0):
        self.gap, self.whole = gap, 0.0
        self._growth, self._judged, self._start = GROWTH, None, used
        self._from = (used, 0.0, 0)

    def update(self, used: float, begun: float, boxes: int, count: int) -> None:
        """Widen the gap if the search is late.

        What the present gap takes is measured in boxes, and converted to time by the speed of the whole search so far,
        because machines have slow moments.

        Args:
            used: Fraction of the limits that is used.
            begun: Fraction of the initial boxes that are done or begun.
            boxes: Number of boxes that were bounded.
            count: Number of initial boxes.
        """
        time, done, work = (now - then for now, then in zip((used, begun, boxes), self._from, strict=True))
        left, here = END - used, (used, begun, boxes)
        if left <= 0:
            if time >= OVERTIME:
                self.gap, self._from = self.gap * WIDER, here
            return
        if not work or (done * count < SURE and time < PATIENCE * (left + time)):
            return
        whole = work / max(done, 1 / count) * (used - self._start) / boxes
        expected = whole * (1 - begun)
        if expected <= LATE * left:
            return
        if self._judged:
            gap, before = self._judged
            self._growth = float(np.clip(np.log(before / whole) / np.log(self.gap / gap), FLATTEST, STEEPEST))
        else:
            self.whole = whole
        self._judged = (self.gap, whole)
        self.gap *= min((HEADROOM * expected / left) ** (1 / self._growth), WIDEST)
        self._from = here

    def reach(self, gap: float) -> None:
        """Aim no nearer than a gap that the search cannot come under any more."""
        self.gap = max(self.gap, gap)

    def widen(self) -> None:
        """Widen the gap whatever the time."""
        self.gap *= 10.0
