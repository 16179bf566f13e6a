"""How the bounders of a class are made from a shape: in closed form by the class itself, or as ``TRAINERS`` says.

``fit`` treats all methods alike. A learned method from outside the package adds an entry to ``TRAINERS``, which holds
for its subclasses too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from warp_bounding.bounders import Bounder
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.relu_field import ReluField
from warp_bounding.runtime.progress import Progress
from warp_bounding.training.fit_network import fit_network
from warp_bounding.training.learned_kdop.train import train_learned_kdop
from warp_bounding.training.problem import Problem, Trained
from warp_bounding.training.relu_field import train_relu_field

__all__ = ["TRAINERS", "Trainer", "trainer_of"]

KDOP_SECONDS = 10.0  # training longer does not make learned half-spaces tighter


@dataclass(frozen=True)
class Trainer:
    """How the bounders of a class are made.

    Attributes:
        train: Called with the class, the problem, the values of all of the class's options, the seconds that training
            may take, and a function for progress or ``None``.
        proves: ``train`` sets threshold and certificate itself. In a cascade such trainers share the rest of the budget
            equally. Where ``train`` does not, ``fit`` calls ``prove`` afterwards, and before a trainer that proves it
            gets the share ``fit.FRONT_SHARE`` only.
        most_seconds: ``fit`` gives no more seconds, because they would make nothing tighter.
    """

    train: Callable[[type[Bounder], Problem, dict[str, Any], float, Progress | None], Trained]
    proves: bool = False
    most_seconds: float = math.inf


def _closed_form(cls: type[Bounder], problem: Problem, options: dict[str, Any], seconds: float, _) -> Trained:
    """The volume that the class computes."""
    if cls.takes_seconds:
        options = options | {"seconds": math.inf if problem.repeatable else seconds}
    return cls.fit(problem.grid, problem.domain, device=problem.device, **options), {}


TRAINERS: dict[type[Bounder], Trainer] = {
    Bounder: Trainer(_closed_form),
    LearnedKdop: Trainer(train_learned_kdop, most_seconds=KDOP_SECONDS),
    ReluField: Trainer(train_relu_field),
    Mlp: Trainer(fit_network, proves=True),
}


def trainer_of(cls: type[Bounder]) -> Trainer:
    """How bounders of a class are made: its own entry of ``TRAINERS``, or the nearest base's."""
    return next(TRAINERS[base] for base in cls.__mro__ if base in TRAINERS)
