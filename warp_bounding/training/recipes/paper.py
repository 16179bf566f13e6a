"""The paper's recipe, as an option: uniform samples, asymmetric cross-entropy, a linear schedule of its two weights.

Every ``stage`` iterations the weight of negatives shrinks (1/20, 1/40, ... in 2D, in steps of 1/100 and 1/200 in 3D
and 4D) and that of positives grows by 0.2, until no false negative was seen for six stages (paper, Sec. 3.4;
supplement, Sec. 2). At its batch of 200,000 and 10,000 iterations a stage this takes hours on a CPU; a budget ends it
earlier. Unlike in the paper, the threshold is then set by the proof.
"""

from __future__ import annotations

from dataclasses import dataclass

from warp_bounding.training.engine import Clock
from warp_bounding.training.lazy_torch import torch
from warp_bounding.training.recipes.default import NetworkTrainer

__all__ = ["PaperRecipe", "PaperTrainer"]


@dataclass(frozen=True)
class PaperRecipe:
    """Constants of the paper and its supplement."""

    batch: int = 200_000
    stage: int = 10_000  # iterations between two changes of the weights
    stable: int = 6  # stages without a false negative after which training ends
    rate: float = 1e-3  # learning rate of Adam
    positive_step: float = 0.2  # growth of the weight of positives from stage to stage
    regularisation: float = 5e-7  # weight of the L1 and of the L2 norm, reached linearly over ``stable`` stages
    note_every: int = 10  # iterations between two reports

    @staticmethod
    def negative_weight(ndim: int, stage: int) -> float:
        """1, then 1/d, 1/(2 d), ... with d = 20 in 2D, 100 in 3D, 200 beyond."""
        return 1.0 / ({1: 20, 2: 20, 3: 100}.get(ndim, 200) * stage) if stage else 1.0

    def positive_weight(self, stage: int) -> float:
        """1, 1.2, 1.4, ..."""
        return 1.0 + self.positive_step * stage


class PaperTrainer(NetworkTrainer):
    """A network in training by the paper's recipe; arguments are those of ``NetworkTrainer``.

    ``paper`` holds the constants of this recipe; of ``recipe`` only those of sampling for the proof are used.
    """

    paper = PaperRecipe()
    takes_positives = False

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
            self._refresh(1.0)
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
