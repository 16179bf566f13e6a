"""What the paper compares with: networks with the symmetric loss and their errors, and a plain field."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, grid_sample

from warp_bounding.queries.point import POINT
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.engine import Clock, single_threaded_torch
from warp_bounding.training.recipe import NetworkTrainer
from warp_bounding.training.samples import samples_of


@dataclass(frozen=True)
class PaperRecipe:
    """Uniform samples, and asymmetric cross-entropy of two weights (paper, Sec. 3.4; supplement, Sec. 2).

    Every ``stage`` iterations that of negatives shrinks and that of positives grows, until no false negative was seen
    for six stages.
    """

    batch: int = 200_000
    stage: int = 10_000  # iterations between two changes of the weights
    stable: int = 6  # stages without a false negative after which training ends
    rate: float = 1e-3  # learning rate of Adam
    positive_step: float = 0.2  # growth of the weight of positives from stage to stage
    regularisation: float = 5e-7  # weight of the L1 and of the L2 norm, reached linearly over ``stable`` stages
    note_every: int = 10  # iterations between two reports
    symmetric: bool = False  # whether negatives always weigh 1

    def negative_weight(self, ndim: int, stage: int) -> float:
        """1, then 1/d, 1/(2 d), ... with d = 20 in 2D, 100 in 3D, 200 beyond."""
        return 1.0 / ({1: 20, 2: 20, 3: 100}.get(ndim, 200) * stage) if stage and not self.symmetric else 1.0

    def positive_weight(self, stage: int) -> float:
        """1, 1.2, 1.4, ..."""
        return 1.0 + self.positive_step * stage


class PaperTrainer(NetworkTrainer):
    """A network in training by the paper's recipe, ``paper``; arguments are those of ``NetworkTrainer``."""

    paper = PaperRecipe()

    def run(self, clock: Clock, on_refresh=None) -> None:
        """Train until the schedule is through, the budget is used up, or an interrupt; ``on_refresh`` is not called."""
        paper = self.paper
        self.network.initialise(1.0, 1.0, self.generator)  # torch's standard initialisation, near enough
        optimiser, clean = torch.optim.Adam([self.network.flat], lr=paper.rate), 0
        try:
            for step, _ in clock.steps():
                if clean == paper.stable:
                    break
                stage = step // paper.stage
                missed = self._iterate(optimiser, stage)
                if (step + 1) % paper.stage == 0:
                    clean = clean + 1 if missed == 0 else 0
                if (step + 1) % paper.note_every == 0:
                    clock.tell(clock.fraction(), f"stage {stage}, FN {missed} in a batch")
        finally:
            self._best = (float("inf"), self.network.flat.clone())  # the last, after an interrupt too

    def _iterate(self, optimiser: torch.optim.Optimizer, stage: int) -> int:
        """One step; returns the number of false negatives of its batch at the paper's threshold."""
        paper, network = self.paper, self.network
        v, truth = self.samples.uniform(paper.batch)
        x = network.encode(v)
        positive, negative = paper.positive_weight(stage), paper.negative_weight(network.ndim, stage)
        weights, target = torch.where(truth, positive, negative) / paper.batch, truth.float()
        missed = [0] * self.team.size
        for worker in self.workers:
            worker.gradient.zero_()

        def job(index: int, part: slice) -> None:
            worker, columns = self.workers[index], x[:, part].contiguous()
            f = worker.forward(columns, keep=True)
            missed[index] += int(((f < 0) & truth[part]).sum())
            worker.backward(columns, (torch.sigmoid(f) - target[part]).mul_(weights[part]))

        self.team.over(paper.batch, job)
        flat, decay = network.flat, paper.regularisation * min(1.0, stage / paper.stable)
        flat.grad = sum((worker.gradient for worker in self.workers), torch.zeros_like(flat))
        flat.grad += decay * (torch.sign(flat) + 2 * flat)
        optimiser.step()
        return sum(missed)


POINTS = 100_000  # that errors are measured on
RATE = 5e-3  # of Adam, for both losses: the paper's 1e-3 takes tens of thousands of steps


class _Recorded(PaperTrainer):
    """A network in training that writes down its errors at an output of one half, every so many steps."""

    def __init__(self, samples, hidden, activation, paper: PaperRecipe, every: int, note):
        super().__init__(samples, hidden, activation)
        self.paper, self.every, self.note, self.step = paper, every, note, 0
        self.held_out = samples.uniform(POINTS)
        self.steps, self.fp, self.fn = [], [], []

    def _iterate(self, optimiser, stage):
        if self.step % self.every == 0:
            v, truth = self.held_out
            f = self._evaluate(self.network.encode(v))
            self.steps.append(self.step)
            self.fp.append(round(100 * float(((f >= 0) & ~truth).float().mean()), 4))
            self.fn.append(round(100 * float(((f < 0) & truth).float().mean()), 4))
            self.note(f"step {self.step}, FP {self.fp[-1]:.2f} %, FN {self.fn[-1]:.3f} %")
        self.step += 1
        return super()._iterate(optimiser, stage)


def record(
    grid, hidden, activation: str, *, common: bool, steps: int, stage: int, batch: int, every: int, seed: int, note
):
    """Train a network of points, with the ``common``, symmetric loss or the paper's, and record its errors.

    ``stage`` and ``every`` are steps between two changes of the weights, and two records. Returns lists ``step``,
    ``fp`` and ``fn``; rates are in per cent of points.
    """
    paper = PaperRecipe(batch=batch, stage=stage, stable=steps, rate=RATE)
    paper = replace(paper, symmetric=True, positive_step=0.0, regularisation=0.0) if common else paper
    samples = samples_of(grid, domain_of(grid, POINT.name), seed)
    with single_threaded_torch(), torch.no_grad():
        trainer = _Recorded(samples, hidden, activation, paper, every, note)
        trainer.run(Clock(np.inf, steps))
    return {"step": trainer.steps, "fp": trainer.fp, "fn": trainer.fn}


def plain_field(grid, nodes: int, seed: int, steps: int, batch: int, rate: float) -> Callable[[np.ndarray], np.ndarray]:
    """Train ``relu-field`` with a symmetric loss; the answer tells which points ``(N, 2)`` are likely in the object."""
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
