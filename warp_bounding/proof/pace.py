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
        self._growth, self._judged = GROWTH, None
        self._from = (used, 0.0)

    def update(self, used: float, share: float, count: int) -> None:
        """Widen the gap if the search is late.

        Args:
            used: Share of the limits that is used.
            share: Of the first boxes, that are done.
            count: Of first boxes.
        """
        time, done, left = used - self._from[0], share - self._from[1], END - used
        if left <= 0:
            if time >= OVERTIME:
                self._change(self.gap * WIDER, used, share)
            return
        if done * count < SURE and time < PATIENCE * (left + time):
            return
        rate = time / max(done, 1 / count)
        expected = rate * (1 - share)
        if expected <= LATE * left:
            return
        if self._judged:
            gap, before = self._judged
            self._growth = float(np.clip(np.log(before / rate) / np.log(self.gap / gap), FLATTEST, STEEPEST))
        else:
            self.whole = rate
        self._judged = (self.gap, rate)
        factor = (HEADROOM * expected / left) ** (1 / self._growth)
        self._change(self.gap * min(factor, WIDEST), used, share)

    def widen(self) -> None:
        """Widen the gap whatever the time."""
        self.gap *= 10.0

    def _change(self, gap: float, used: float, share: float) -> None:
        self.gap, self._from = gap, (used, share)
