"""A training budget, in seconds or in steps, as a fraction that schedules are written in, and the schedules.

Whoever trains tells the clock how it goes, and the clock tells the user.
"""

import math
from collections.abc import Callable, Iterator

from warp_bounding.runtime.progress import Progress
from warp_bounding.runtime.working_time import working_seconds

__all__ = ["Clock", "cosine", "geometric", "interrupts"]

FASTER = 2.0  # largest factor by which the used fraction may go on faster when more time is reserved


class Clock:
    """How much of a budget is used up.

    Args:
        seconds: From now on; compiling kernels takes none (``working_seconds``).
        steps: Number of steps; if given, time plays no role and runs are repeatable.
        progress: Called with done, total and a note, or ``None``.
        share: The part of the user's progress that is training; proofs come behind it.
    """

    def __init__(self, seconds: float, steps: int | None = None, progress: Progress | None = None, share: float = 1.0):
        self.progress, self.share = progress, share
        self.started, self.total, self.limit, self.count = working_seconds(), seconds, steps, 0
        self.reserved = 0.0  # seconds at the end that belong to the proof
        self._from = (0.0, 0.0)  # seconds since the start and used fraction, from which the fraction grows evenly

    def tell(self, used: float, note: str) -> None:
        """Say how training goes at a used fraction."""
        if self.progress:
            self.progress(min(used, 1.0) * self.share, 1.0, note)

    def reserve(self, seconds: float, used: float | None = None) -> None:
        """Keep other seconds at the end for the proof; the used fraction goes on evenly, so that schedules do not jump.

        It goes on from ``used``, where the time since then was not training; from the present one if ``None``.
        """
        now, used = self.seconds, min(self.fraction() if used is None else used, 1.0)
        left = max(self.total - self.reserved - now, 0.0)
        self._from = (now, used)
        self.reserved = min(seconds, self.total - now - left / FASTER)

    @property
    def seconds(self) -> float:
        """Since the start, without those for compiling kernels."""
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
    """A learning rate that rises linearly during the warm-up, and falls by half a cosine.

    Args:
        rate: The highest rate.
        end: The rate at the end, as a share of the highest.
        warm_up: Used fraction at which the rate is highest.
        used: Used fraction of the budget.
    """
    warm = min(1.0, (used + 1e-3) / warm_up)
    return rate * warm * (end + (1 - end) * 0.5 * (1 + math.cos(math.pi * min(used, 1.0))))


def interrupts(job: Callable[[], None]) -> bool:
    """Do a job; returns whether Ctrl-C ended it, in which case the caller takes what has been learned so far."""
    try:
        job()
    except KeyboardInterrupt:
        return True
    return False
