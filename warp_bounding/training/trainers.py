"""How the bounders of a class are made of a shape: closed forms by the class itself, learned ones by what ``TRAINERS`` says.

``fit`` treats all methods alike. A learned method from outside the package adds an entry to ``TRAINERS``; its subclasses have it too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.bounders import Bounder
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.bounders.parametric_fit import fit_parametric
from warp_bounding.bounders.polytopes.learned_kdop import LearnedKdop
from warp_bounding.bounders.relu_field.relu_field import ReluField
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.positives import draw_positives
from warp_bounding.runtime.progress import Progress
from warp_bounding.training.fit_network import NetworkOptions, fit_network
from warp_bounding.training.learned_kdop.train import train_learned_kdop
from warp_bounding.training.problem import Problem
from warp_bounding.training.relu_field import train_relu_field

__all__ = ["TRAINERS", "Trainer", "trainer_of"]

PARAMETRIC_SAMPLES = 20_000  # as in the paper's code
KDOP_SECONDS = 10.0  # more does not make learned half-spaces tighter
FRONT_FACES = 40  # of a learned-kdop before a network; twice as many are hardly nearer to the convex hull

Made = tuple[Bounder, dict[str, Any]]  # and a record of how it went


@dataclass(frozen=True)
class Trainer:
    """How the bounders of a class are made.

    Attributes:
        train: Called with the class, the problem, the values of all of its options, the seconds that it may take, and whom to tell
            how far it is.
        proves: It sets threshold and certificate too, which takes as long as it takes: it shares what is left of the budget with the
            others that do. What another one makes is proven by ``fit``, and before a network it gets a smaller share.
        most_seconds: More make nothing tighter.
    """

    train: Callable[[type[Bounder], Problem, dict[str, Any], float, Progress | None], Made]
    proves: bool = False
    most_seconds: float = math.inf


def _closed_form(kind: type[Bounder], problem: Problem, options: dict[str, Any], seconds: float, _) -> Made:
    """What the class itself finds; in parametric space around sampled positives, as in the paper, and then around all of them."""
    grid, domain, device = problem.grid, problem.domain, problem.device
    if domain.parametric:
        x = sample(problem.query, grid, PARAMETRIC_SAMPLES, np.random.default_rng(problem.seed))
        length = domain.oracle_length
        positive = x[oracle(problem.query, grid, device, length)(x)]
        if len(positive) < 2:
            drawn = draw_positives(problem.query, grid, PARAMETRIC_SAMPLES, problem.seed, device, length, outside=False)
            positive = next(drawn)
        return fit_parametric(kind, grid, domain, domain.to_local(positive), device=device, **options), {}
    if kind.takes_seconds:
        options = options | {"seconds": math.inf if problem.repeatable else seconds}
    return kind.fit(grid, domain, device=device, **options), {}


def _learned_kdop(_, problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None) -> Made:
    if problem.in_front and problem.query != PLANE.name and options["k"] is None:
        options = options | {"k": FRONT_FACES}
    return train_learned_kdop(problem.grid, problem.domain, **_learned(problem, seconds, progress), **options)


def _relu_field(_, problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None) -> Made:
    return train_relu_field(problem.grid, problem.domain, **_learned(problem, seconds, progress), **options)


def _learned(problem: Problem, seconds: float, progress: Progress | None) -> dict[str, Any]:
    shown = (lambda used, note: progress(min(used, 1.0), 1.0, note)) if progress else None
    return {"seed": problem.seed, "device": problem.device, "progress": shown, "budget": seconds}


def _network(
    kind: type[Mlp], problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None
) -> Made:
    return fit_network(kind, problem, NetworkOptions(budget=seconds, **options), progress)


TRAINERS: dict[type[Bounder], Trainer] = {
    Bounder: Trainer(_closed_form),
    LearnedKdop: Trainer(_learned_kdop, most_seconds=KDOP_SECONDS),
    ReluField: Trainer(_relu_field),
    Mlp: Trainer(_network, proves=True),
}


def trainer_of(kind: type[Bounder]) -> Trainer:
    """How bounders of a class are made: its own entry of ``TRAINERS``, or the nearest base's."""
    return next(TRAINERS[base] for base in kind.__mro__ if base in TRAINERS)
