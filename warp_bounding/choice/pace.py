"""What a choice has taken of its budget, and what networks need on this very shape to be judged: by what was measured on it.

How long a network must be trained does not depend on the seconds but on its steps: with few of them it is no tighter than a box. What a step takes depends on
the shape (its samples are labelled), the size of the network and the machine, so the first rounds of each training tell it (``Watch``).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from warp_bounding.choice.candidates import Candidate
from warp_bounding.runtime.working_time import working_seconds

__all__ = ["LEAST_SECONDS", "ROUNDS", "ROUND_STEPS", "Pace", "Spending", "TooSlowError", "Watch"]

LEAST_SECONDS = 3.0  # of a network's fit
ROUND_STEPS = 100  # steps between two refreshes of the samples, of all recipes: a round
# Rounds after which a network can be judged. Networks 24-24 of points had 7.5 % false positives after 5 rounds and 2.6 % after 15 on the bunny, and on a mesh
# of 29,572 triangles as many as a box after 2, and 3.0 % after 11.
ROUNDS = 8
RESERVED, REGION_RESERVED = (
    0.25,
    0.5,
)  # of a fit's seconds, for the searches of its prover, of points and of regions: about what trainers keep
GROWTH = 0.3  # a round takes so long as a network has numbers, to about this power: 24-24 and 50-50 on the bunny, on a busy machine
EARLY_ROUNDS = (1, 2)  # after which it is told whether a training will come to enough rounds, ...
PATIENCE = 1.6  # ... and what it needs to be stopped then, times the seconds it was given
OVERTIME, LEAST_EXTRA = (
    0.1,
    0.5,
)  # of a fit: a share of the seconds that it was given, and seconds at least, for what comes before and behind training


class TooSlowError(Exception):
    """A training that would end before the network can be judged."""


@dataclass
class Spending:
    """What a choice has taken of its budget, compiling kernels not counted.

    Attributes:
        budget: Seconds.
        charged: What fits took that are kept from before.
        started: When it began, ``working_seconds``.
    """

    budget: float
    charged: float = 0.0
    started: float = field(default_factory=working_seconds)

    @property
    def now(self) -> float:
        """Seconds since it began."""
        return working_seconds() - self.started

    @property
    def spent(self) -> float:
        """Seconds, those of fits from before included."""
        return self.charged + self.now

    @property
    def left(self) -> float:
        """Seconds; less than 0 where the budget is overdrawn."""
        return self.budget - self.spent


class Watch:
    """The progress of a network's fit, which tells the user's, and stops a training that is too slow for its seconds.

    Args:
        given: Seconds of the fit; infinity where it is not to be stopped.
        reserved: Share of them that is not for training.
        tell: The user's progress: called with a note.
    """

    def __init__(self, given: float, reserved: float, tell: Callable[[str], None]):
        self._given, self._reserved, self._tell = given, reserved, tell
        self._started, self._marks = working_seconds(), []

    def __call__(self, done: float, total: float, note: str) -> None:
        """See ``Progress``.

        Raises:
            TooSlowError: Where too few rounds fit into what is left.
        """
        self._marks.append(working_seconds())
        self._tell(note)
        if (
            len(self._marks) - 1 in EARLY_ROUNDS
            and needed(self.setup, self.round, self._reserved) > PATIENCE * self._given
        ):
            raise TooSlowError

    @property
    def setup(self) -> float:
        """Seconds before the first step; 0 where none was made."""
        return self._marks[0] - self._started if self._marks else 0.0

    @property
    def round(self) -> float:
        """Seconds of a round; 0 where there was none."""
        return float(np.median(np.diff(self._marks))) if len(self._marks) > 1 else 0.0


def needed(setup: float, round_: float, reserved: float) -> float:
    """Seconds of a fit that a network can be judged by."""
    return max((setup + ROUNDS * round_) / (1 - reserved), LEAST_SECONDS)


class Pace:
    """What networks need on this shape.

    Args:
        region: Whether queries are regions.
    """

    def __init__(self, region: bool):
        self.reserved = REGION_RESERVED if region else RESERVED
        self._known: dict[str, tuple[Candidate, float, float]] = {}
        self._extra = LEAST_EXTRA

    def learn(self, candidate: Candidate, setup: float, round_: float) -> None:
        """Take note of what a training took."""
        if setup > 0 and round_ > 0:
            self._known[candidate.label] = candidate, setup, round_

    def took(self, given: float, taken: float) -> None:
        """Take note of what a whole fit took that was given so many seconds."""
        self._extra = max(self._extra, taken - (1 + OVERTIME) * given)

    def needed(self, candidate: Candidate, front: float = 0.0) -> float | None:
        """Seconds of a fit after which it can be judged, by its own rounds or those of the network that is most like it; ``None`` where nothing is known.

        Args:
            candidate: A network.
            front: What is fitted before it takes so many seconds.
        """
        alike = [
            (
                candidate.label != label,
                candidate.method != each.method,
                abs(math.log(candidate.numbers / each.numbers)),
                label,
            )
            for label, (each, _, _) in self._known.items()
            if candidate.distance == each.distance
        ]
        if not alike:
            return None
        own, setup, round_ = self._known[min(alike)[-1]]
        return front + needed(setup, round_ * (candidate.numbers / own.numbers) ** GROWTH, self.reserved)

    def whole(self, seconds: float) -> float:
        """What a fit takes that is given so many seconds."""
        return (1 + OVERTIME) * seconds + self._extra

    def given(self, whole: float) -> float:
        """What a fit may be given that is to take no longer than that."""
        return (whole - self._extra) / (1 + OVERTIME)
