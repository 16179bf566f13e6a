"""What the demos that plan share: how many states and problems, what is counted, and what must not be missed."""

from dataclasses import dataclass
from typing import ClassVar

import warp_bounding as wb
from sims import base

__all__ = ["PlanningDemo"]


@dataclass
class PlanningDemo(base.Demo):
    """A demo of planners; see ``sims.base.Demo``.

    Attributes:
        states: Random states of a roadmap; ``SIZES`` if ``None``.
        problems: Problems a place; ``SIZES`` if ``None``.
    """

    states: int | None = None
    problems: int | None = None
    device: str = "cpu"

    SIZES: ClassVar[dict[str, tuple[int, int]]]  # of states and problems: full, quick
    SAMPLES = (200_000, 20_000)
    CALLS = "checks"
    MISSED = "colliding states and edges"
    COLUMNS: ClassVar[dict[str, str]] = {"fewer": "fewer", "solved": "solved", "collisions": "collide"}

    def choose_sizes(self) -> None:
        """Settle states and problems.

        Raises:
            BoundingError: For too few.
        """
        self.choose(**self.SIZES)
        if self.states < 2 or self.problems < 1:
            raise wb.BoundingError(f"expected at least 2 states and 1 problem, got {self.states} and {self.problems}")
