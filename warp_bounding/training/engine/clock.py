"""A training budget, in seconds or in steps, as a fraction that schedules are written in, and the schedules."""

import math
from collections.abc import Callable, Iterator

from warp_bounding.runtime.launch import working_seconds

__all__ = ["Clock", "Progress", "cosine", "geometric", "interrupts"]

FASTER = 2.0  # times as fast the used fraction may go on when more time is reserved

Progress = Callable[[float, str], None]  # called with the used fraction and a note


class Clock:
    """How much of a budget is used up.

    Args:
        seconds: Wall time, from now on.
        steps: Number of steps; if given, time plays no role and runs are repeatable.
    """

    def __init__(self, seconds: float, steps: int | None = None):
        self.started, self.total, self.limit, self.count = working_seconds(), seconds, steps, 0
        self.reserved = 0.0  # seconds at the end that belong to the proof
        self._from = (0.0, 0.0)  # seconds and used fraction, from which it goes on evenly

    def reserve(self, seconds: float, used: float | None = None) -> None:
        """Change what is kept for the proof. The used fraction goes on evenly, at most ``FASTER``: schedules do not jump.

        Args:
            seconds: At the end of the budget.
            used: Fraction from which it goes on, where the time since then was not training; the present one if ``None``.
        """
        now, used = self.seconds, min(self.fraction() if used is None else used, 1.0)
        left = max(self.total - self.reserved - now, 0.0)
        self._from = (now, used)
        self.reserved = min(seconds, self.total - now - left / FASTER)

    @property
    def seconds(self) -> float:
        """Wall time since the start."""
        return working_seconds() - self.started

    @property
    def timed(self) -> bool:
        """Whether the budget is in seconds."""
        return self.limit is None

    def fraction(self) -> float:
        """Share of the training budget that is used; 1 at its end."""
        if self.limit is not None:
            return self.count / self.limit
        (begin, used), now, end = self._from, self.seconds, self.total - self.reserved
        return used + (1 - used) * (now - begin) / (end - begin) if now < end else 1.0

    def steps(self) -> Iterator[tuple[int, float]]:
        """Steps from 0 on, each with the used fraction at its begin, until the budget is used up; they are counted."""
        step = 0
        while (used := self.fraction()) < 1:
            yield step, used
            step += 1
            self.count += 1


def geometric(begin: float, end: float, used: float) -> float:
    """Geometric from ``begin`` to ``end`` while ``used`` goes from 0 to 1."""
    return begin * (end / begin) ** used


def cosine(rate: float, end: float, warm_up: float, used: float) -> float:
    """A learning rate: linear up to ``rate`` during the fraction ``warm_up``, and by half a cosine down to ``end`` of it.

    Args:
        rate: The highest.
        end: Of it, at the end.
        warm_up: Fraction.
        used: Fraction so far.
    """
    warm = min(1.0, (used + 1e-3) / warm_up)
    return rate * warm * (end + (1 - end) * 0.5 * (1 + math.cos(math.pi * min(used, 1.0))))


def interrupts(job: Callable[[], None]) -> bool:
    """Do a job; whether Ctrl-C ended it, after which what has been learned so far is taken."""
    try:
        job()
    except KeyboardInterrupt:
        return True
    return False
