"""What the paper compares with: networks with the symmetric loss and their errors, and a plain field."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, grid_sample

from warp_bounding.queries.point import POINT
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.engine import Clock, single_threaded_torch
from warp_bounding.training.recipes.paper import PaperRecipe, PaperTrainer
from warp_bounding.training.samples import samples_of

# The paper's recipe and the common loss, with a record of both errors while they train.
#
# The only difference between the two runs is the weights of the loss: network, first weights, samples, optimiser and
# learning rate are the same. Errors are those at the paper's threshold, an output of one half, on the same fresh
# points.

POINTS = 100_000  # that errors are measured on
RATE = 5e-3  # of Adam, for both losses: the paper's 1e-3 takes tens of thousands of steps


@dataclass(frozen=True)
class _Common(PaperRecipe):
    """Both kinds of error weigh the same, always, and nothing is regularised."""

    regularisation: float = 0.0

    @staticmethod
    def negative_weight(ndim: int, stage: int) -> float:
        return 1.0

    def positive_weight(self, stage: int) -> float:
        return 1.0


class _Recorded(PaperTrainer):
    """A network in training that writes down its errors every so many steps."""

    def __init__(self, samples, hidden, activation, paper: PaperRecipe, every: int, note):
        super().__init__(samples, hidden, activation)
        self.paper, self.every, self.note, self.step = paper, every, note, 0
        self.held_out = samples.uniform(POINTS)
        self.steps, self.fp, self.fn = [], [], []

    def _iterate(self, optimiser, stage):
        if self.step % self.every == 0:
            v, truth = self.held_out
            f = self._evaluate(self.workers, self.network.encode(v))
            self.steps.append(self.step)
            self.fp.append(round(100 * float(((f >= 0) & ~truth).float().mean()), 4))
            self.fn.append(round(100 * float(((f < 0) & truth).float().mean()), 4))
            self.note(f"step {self.step}, FP {self.fp[-1]:.2f} %, FN {self.fn[-1]:.3f} %")
        self.step += 1
        return super()._iterate(optimiser, stage)


def record(
    grid, hidden, activation: str, *, common: bool, steps: int, stage: int, batch: int, every: int, seed: int, note
):
    """Train a network of points and record its errors.

    Args:
        grid: The object.
        hidden: Hidden widths.
        activation: A name in ``ACTIVATIONS``.
        common: Whether with the common, symmetric loss.
        steps: Training steps.
        stage: Steps between two changes of the weights.
        batch: Points of a step.
        every: Steps between two records.
        seed: Of first weights and samples.
        note: Called with what is going on.

    Returns:
        ``step``, ``fp`` and ``fn``: lists, rates in per cent of points.
    """
    paper = (_Common if common else PaperRecipe)(batch=batch, stage=stage, stable=steps, rate=RATE)
    samples = samples_of(grid, domain_of(grid, POINT.name), seed)
    with single_threaded_torch(), torch.no_grad():
        trainer = _Recorded(samples, hidden, activation, paper, every, note)
        trainer.run(Clock(np.inf, steps))
    return {"step": trainer.steps, "fp": trainer.fp, "fn": trainer.fn}


# A field of numbers on a grid, interpolated, trained as a classifier: what ``relu-field`` would be with a symmetric
# loss.
#
# It is no bounder, and only shows what the asymmetric loss and the repair are for.


def plain_field(grid, nodes: int, seed: int, steps: int, batch: int, rate: float) -> Callable[[np.ndarray], np.ndarray]:
    """Train it on uniform points of a 2D object.

    Returns:
        What answers points ``(N, 2)`` with ``(N,)`` bool: whether the field finds the object likelier than not there.
    """
    lower, upper = grid.sample_lower, grid.sample_upper
    rng, values = np.random.default_rng(seed), torch.zeros(1, 1, nodes, nodes, requires_grad=True)

    def at(x: np.ndarray) -> torch.Tensor:
        place = np.clip(2 * (x - lower) / (upper - lower) - 1, -1, 1)[:, ::-1].astype(np.float32)
        return grid_sample(values, torch.from_numpy(place.copy())[None, None], align_corners=True)[0, 0, 0]

    with single_threaded_torch(), torch.enable_grad():
        optimiser = torch.optim.Adam([values], lr=rate)
        for _ in range(steps):
            x = rng.uniform(lower, upper, (batch, 2))
            loss = binary_cross_entropy_with_logits(10 * at(x), torch.from_numpy(grid.contains(x).astype(np.float32)))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()

    def ask(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return (at(np.asarray(x, dtype=np.float64)) >= 0).numpy()

    return ask
