"""A training budget, in seconds or in steps, as a fraction that schedules are written in."""

import time

__all__ = ["Clock"]

STRIDE = 0.05  # of the training budget


class Clock:
    """How much of a budget is used up.

    Args:
        seconds: Wall time, from now on.
        steps: Number of steps; if given, time plays no role and runs are repeatable.
    """

    def __init__(self, seconds: float, steps: int | None = None):
        self.started, self.total, self.steps, self.count = time.perf_counter(), seconds, steps, 0
        self.reserved = 0.0  # seconds at the end that belong to the proof

    def reserve(self, seconds: float) -> None:
        """Keep time for the proof, as far as the used fraction then goes forward by no more than ``STRIDE``: schedules must not jump."""
        most = self.total - self.seconds / (self.fraction() + STRIDE)
        self.reserved = min(seconds, max(most, self.reserved))

    @property
    def seconds(self) -> float:
        """Wall time since the start."""
        return time.perf_counter() - self.started

    @property
    def timed(self) -> bool:
        """Whether the budget is in seconds."""
        return self.steps is None

    def fraction(self) -> float:
        """Share of the training budget that is used, 1 or more at its end."""
        if self.steps is not None:
            return self.count / self.steps
        return self.seconds / max(self.total - self.reserved, 1e-9)
