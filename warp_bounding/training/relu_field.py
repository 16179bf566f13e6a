"""Training a ``relu-field``: the asymmetric loss on the nodes' values, and a repair at the end.

f can only be least at certain points of the positives (``break_points``), so these are all that training has to see
of them: the lowest are looked for again and again. Negatives are fresh samples of the protocol. What is still too low
at the end is repaired: every value has a non-negative share in f, so raising the nodes around a point by what it
lacks never lowers f anywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_bounding.bounders.relu_field import FieldMap, ReluField, break_points, corners_of, field_breaks
from warp_bounding.errors import BounderError
from warp_bounding.queries import oracle
from warp_bounding.runtime.progress import Progress
from warp_bounding.training.engine import Clock, adam, geometric, interrupts, single_threaded_torch, torch
from warp_bounding.training.samples import Problem, Trained

__all__ = ["train_relu_field"]

# Values of nodes are such that the answer is *maybe* from 0 on (the line); f = 0.5 + SCALE * value, so that the line is
# in the middle of f's range.
SCALE = 0.25
BATCH = 8192  # negatives, and positives, a step
POOL = 50_000  # samples of the protocol, renewed every REFRESH steps
REFRESH = 50  # steps
CANDIDATES = 60_000  # points of the positives, drawn at each refresh, of which the lowest HARD are kept
HARD = 20_000
# T of the loss, the weight of positives against negatives, and the learning rate, from the first step to the last.
SOFTNESS, WEIGHT, RATE = (0.3, 0.03), (20.0, 1000.0), (0.1, 0.01)
MARGIN = 0.1  # value above the line to which positives are pushed, times T relative to its start
# First values of nodes that no positive needs, and of the others: all positives are then above the line.
START = (-1.0, 0.05)
ROUNDED = 1e-4  # value by which the interpolation between values of START[1] may round
STEPS = 1500  # steps after which training ends: more gain little
REPAIR_SHARE = 0.2  # share of the budget that is kept for the repair
# Passes of the repair that add no more than a point lacks, before the last one, after which no point lacks anything.
GENTLE = 3


def train_relu_field(
    _, problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None
) -> Trained:
    """Learn a ``relu-field`` (``fit.Trainer``) of points of 1D to 4D objects.

    Ctrl-C ends training; the field as it is is then repaired.
    """
    clock = Clock(seconds, options["steps"], progress)
    trainer = _Trainer(problem, options.get("nodes"))
    clock.reserved = min(REPAIR_SHARE * seconds + clock.seconds, 0.8 * seconds)
    with single_threaded_torch():
        interrupted = interrupts(lambda: trainer.run(clock))
        values = trainer.better()
    bounder = ReluField.of_values(problem.domain, trainer.field, 0.5 + SCALE * values, problem.device)
    return bounder, {"steps": clock.count, "interrupted": interrupted, "nodes": list(trainer.field.nodes)}


class _Trainer:
    def __init__(self, problem: Problem, nodes: int | None):
        grid, domain, seed = problem.grid, problem.domain, problem.seed
        self.problem, self.domain, self.field = problem, domain, FieldMap.of(grid, domain, nodes)
        self.rng, self.generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
        self.oracle = oracle(domain.query, grid, "cpu", domain.oracle_length)
        self.low, self.high = self.field.cells(grid, domain)
        self.breaks = field_breaks(self.low, self.high).max(axis=1)
        if (field_breaks(self.low, self.high) < 0).any():
            raise BounderError("relu-field: the field is too fine for the object's cells")
        marked = self.field.touched(self.low, self.high)
        self.values = torch.from_numpy(np.where(marked.reshape(-1), START[1], START[0]).astype(np.float32))
        self.start, self.hard = self.values.clone(), np.zeros((0, len(self.field.nodes)))

    def run(self, clock: Clock) -> None:
        """Descend until the clock is at its end, or ``STEPS`` are over."""
        values = self.values.requires_grad_(True)
        optimiser = adam([values], lr=RATE[0], betas=(0.9, 0.99))
        try:
            for step in range(STEPS):
                used = max(clock.fraction(), step / STEPS)
                if used >= 1:
                    break
                if step % REFRESH == 0:
                    self._refresh()
                    clock.tell(used, f"lowest positive {self.lowest:.2f}")
                softness, weight, rate = (geometric(*ends, used) for ends in (SOFTNESS, WEIGHT, RATE))
                with torch.enable_grad():
                    inside = self._field(values, *self._pick(self.negative))
                    low = self._field(values, *self._pick(self.positive))
                    short = (MARGIN * softness / SOFTNESS[0] - low).clamp(min=0)
                    loss = torch.sigmoid(inside / softness).mean() * self.share + weight * (short * short).mean()
                    optimiser.param_groups[0]["lr"] = rate
                    optimiser.zero_grad()
                    loss.backward()
                    optimiser.step()
                clock.count += 1
        finally:
            self.values = values.detach()

    def _pick(self, pool: tuple[torch.Tensor, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
        chosen = torch.randint(len(pool[0]), (BATCH,), generator=self.generator)
        return pool[0][chosen], pool[1][chosen]

    @staticmethod
    def _field(values: torch.Tensor, index: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
        c = values.index_select(0, index.reshape(-1)).reshape(index.shape)
        for k in range(share.shape[1] - 1, -1, -1):
            c = c[:, 0::2] + (c[:, 1::2] - c[:, 0::2]) * share[:, k, None]
        return c[:, 0]

    def _at(self, t: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        index, share = corners_of(self.field.nodes, t)
        return torch.from_numpy(index), torch.from_numpy(share.astype(np.float32))

    def _refresh(self) -> None:
        """Fresh negatives, and positives: the lowest of many, and of those before."""
        x = self.problem.sample(POOL, self.rng)
        truth = self.oracle(x)
        t = self.field.coordinates(self.domain.to_local(x[~truth] if not truth.all() else x[:64]))
        self.negative, self.share = self._at(t), max(float((~truth).mean()), 1e-3)
        index = self.rng.integers(len(self.low), size=CANDIDATES)
        low, high, count = self.low[index], self.high[index], self.breaks[index]
        pick = self.rng.integers(count[:, None] + 2, size=low.shape)
        inner = np.minimum(np.floor(low) + pick, high)
        t = np.concatenate([np.where(pick == 0, low, np.where(pick == count[:, None] + 1, high, inner)), self.hard])
        at = self._at(t)
        height = self._field(self.values.detach(), *at)
        lowest = torch.argsort(height)[:HARD]
        rest = torch.randint(len(t), (HARD // 4,), generator=self.generator)
        chosen = torch.cat([lowest, rest])
        self.hard, self.positive, self.lowest = t[lowest.numpy()], (at[0][chosen], at[1][chosen]), float(height.min())

    def better(self) -> np.ndarray:
        """The repaired values, or those at the start (line at ``START[1]``) if these let fewer negatives through."""
        self._refresh()
        values = self.repaired()
        flat = torch.from_numpy(values.reshape(-1).astype(np.float32))
        inside = int((self._field(flat, *self.negative) >= 0).sum())
        before = int((self._field(self.start, *self.negative) >= START[1] - ROUNDED).sum())
        return values if inside < before else self.start.numpy().reshape(values.shape)

    def repaired(self) -> np.ndarray:
        """The values, raised so that f is not under zero at any break point of the positives."""
        values = self.values.detach().numpy().astype(np.float64)
        for gentle in (*[True] * GENTLE, False):
            raised = values.copy()
            for index, share in self._suspects(values):
                weight = _weights(share)
                lack = -(values[index] * weight).sum(axis=1)
                index, weight, lack = index[lack > 0], weight[lack > 0], lack[lack > 0]
                size = (weight * weight).sum(axis=1) if gentle else np.ones(len(lack))
                step = lack[:, None] * (weight / size[:, None] if gentle else weight > 0)
                np.maximum.at(raised, index.reshape(-1), (values[index] + step).reshape(-1))
            values = raised
        return values.reshape(self.field.nodes)

    def _suspects(self, values: np.ndarray):
        """Break points of the boxes where a node around is under zero."""
        least = values.reshape(self.field.nodes)
        for k in range(least.ndim):
            least = np.minimum(*(np.take(least, range(s, least.shape[k] - 1 + s), axis=k) for s in (0, 1)))
        most = np.array(self.field.nodes) - 2
        for start in range(0, len(self.low), BATCH * 4):
            low, high = self.low[start : start + BATCH * 4], self.high[start : start + BATCH * 4]
            first, last = np.minimum(np.floor(low).astype(np.int64), most), np.ceil(high).astype(np.int64) - 1
            last = np.maximum(first, np.clip(last, 0, most))
            quick = np.full(len(low), np.inf)
            for step in np.ndindex(tuple(int(s) + 1 for s in (last - first).max(axis=0))):
                quick = np.minimum(quick, least[tuple(np.minimum(first + step, last).T)])
            part, count = quick < 0, self.breaks[start : start + BATCH * 4]
            for breaks in np.unique(count[part]):
                chosen = part & (count == breaks)
                for t in break_points(low[chosen], high[chosen], int(breaks)):
                    yield corners_of(self.field.nodes, t)


def _weights(share: np.ndarray) -> np.ndarray:
    """``(N, 2^m)`` weights of the nodes around points, in the order of ``corners_of``."""
    weights = np.ones((len(share), 1))
    for k in range(share.shape[1]):
        pair = np.stack([1 - share[:, k], share[:, k]], axis=1)
        weights = (weights[:, :, None] * pair[:, None, :]).reshape(len(share), -1)
    return weights
