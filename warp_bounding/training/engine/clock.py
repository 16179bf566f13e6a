"""A training budget, in seconds or in steps, as a fraction that schedules are written in."""

from warp_bounding.runtime.launch import working_seconds

__all__ = ["Clock"]

FASTER = 2.0  # times as fast the used fraction may go on when more time is reserved


class Clock:
    """How much of a budget is used up.

    Args:
        seconds: Wall time, from now on.
        steps: Number of steps; if given, time plays no role and runs are repeatable.
    """

    def __init__(self, seconds: float, steps: int | None = None):
        self.started, self.total, self.steps, self.count = working_seconds(), seconds, steps, 0
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
        return self.steps is None

    def fraction(self) -> float:
        """Share of the training budget that is used; 1 at its end."""
        if self.steps is not None:
            return self.count / self.steps
        (begin, used), now, end = self._from, self.seconds, self.total - self.reserved
        return used + (1 - used) * (now - begin) / (end - begin) if now < end else 1.0
