"""How near the least value a search may aim so that it ends in time."""

import numpy as np

__all__ = ["GROWTH", "Pace"]

GROWTH = 0.2  # exponent with which the work grows in 1 / gap, before two gaps have told
FLATTEST, STEEPEST = 0.15, 0.7  # and what two may tell
END = 0.93  # used share at which a search should be done: the last boxes take longer than their share
HEADROOM, LATE = 1.15, 1.03  # of the time left: a gap is chosen to take less by so much, and given up if it takes more
SURE = 4096  # first boxes, or
PATIENCE = 0.25  # share of the time left, after which a gap is judged: some 512 boxes are in work at any time
WIDEST = 3.0  # times as wide a gap becomes at most, at once
OVERTIME, WIDER = 0.01, 3.0  # behind the end a gap becomes so many times wider, at every such share


class Pace:
    """The gap between the least value known and the target of a search, as time goes on.

    Args:
        gap: To begin with: the best one that is asked for.
        used: Share of the limits (time, boxes) that preparations have used.

    Attributes:
        gap: Now.
        whole: Share of the limits that the first gap was expected to take when it was given up; 0 if it was not.
    """

    def __init__(self, gap: float, used: float = 0.0):
        self.gap, self.whole = gap, 0.0
        self._growth, self._judged, self._start = GROWTH, None, used
        self._from = (used, 0.0, 0)

    def update(self, used: float, share: float, boxes: int, count: int) -> None:
        """Widen the gap if the search is late.

        What the present gap takes is measured in boxes, and in time by the speed of the whole search so far: machines
        have slow moments.

        Args:
            used: Share of the limits that is used.
            share: Of the first boxes, that are done.
            boxes: That were bounded.
            count: Of first boxes.
        """
        time, done, work = (now - then for now, then in zip((used, share, boxes), self._from, strict=True))
        left, here = END - used, (used, share, boxes)
        if left <= 0:
            if time >= OVERTIME:
                self.gap, self._from = self.gap * WIDER, here
            return
        if not work or (done * count < SURE and time < PATIENCE * (left + time)):
            return
        whole = work / max(done, 1 / count) * (used - self._start) / boxes
        expected = whole * (1 - share)
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
