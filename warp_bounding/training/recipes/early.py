"""Training a network with exits, ``mlp-early``: together with the network first, then each exit by itself.

Of an *exit* this is the linear output that may deny (``bounders.mlp_early``); the one that may grant is fitted to
the finished network (``granted``). ``EarlyTrainer`` is the default recipe (``recipes.default``) with every exit's loss
added at the weight ``JOINT`` in the layers that it shares, because layers that were trained for the final output alone
are a poor basis for an exit. Measured for 3D points of the bunny: an exit lets 9 % of all points pass wrongly instead
of 22 to 42 %, the whole network 4.7 instead of 4.4 %, and a step takes a third longer. ``train_exits`` then finishes
the exits by Newton steps while the layers stay as they are. The exits of a plane's network are supports, trained by
``recipes.plane`` behind finished layers.

Limits: exits cost the network some of its own tightness, and time. Exits of planes are only as good as the layers
behind which they are trained.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly, grant_of
from warp_bounding.kernels.source import GRANTED
from warp_bounding.queries import oracle
from warp_bounding.training.engine import Clock, Evaluator, Soap, TrainableNetwork
from warp_bounding.training.lazy_torch import torch
from warp_bounding.training.recipes.default import (
    NEGATIVES,
    Batches,
    NetworkTrainer,
    accumulate,
    plan,
    schedule,
    summed,
    weights_of,
)
from warp_bounding.training.recipes.plane import SupportTrainer
from warp_bounding.training.samples import Problem

EXIT_SHARE = 0.05  # share of a budget for each exit behind the finished network
JOINT = 0.3  # weight of an exit's gradient in the layers that it shares
JOINT_BATCH = 0.5  # an exit's batch in joint training, as a share of the recipe's
# In joint training an exit keeps so many hard positives of its own, the worst of these and of so many fresh ones that
# have walked down its output so many steps.
JOINT_HARD, JOINT_EXPLORE, JOINT_MOVES = 2048, 8192, 3
FINISH = 0.8  # used fraction at which an exit that joint training has begun enters its schedules again
REFRESH = 4  # Newton steps between two refreshes of the samples
# What differs from the network's recipe. A Newton step takes all samples, so no batch is needed, and the least number
# is planned: ``refresh`` is the number of batches.
EXIT_RECIPE = {"refresh": 1, "vertices": 32768, "explore": 8192}
DAMPING = 1e-4  # added to the Hessian's diagonal, relative to its mean entry
HALVINGS = 6  # tries of a Newton step, each half as long, until one lowers the loss


def train_exits(
    trainer: NetworkTrainer | SupportTrainer, tensors: dict[str, np.ndarray], seconds: float, steps: int | None = None
) -> tuple[dict[str, np.ndarray], list[NetworkTrainer] | list[SupportTrainer]]:
    """Train one exit behind each hidden layer but the last, in seconds for all together or in steps for each.

    Call it under ``single_threaded_torch``, after the network's trainer, whose samples, hard positives and generator
    are used. Returns ``exits.i.weight`` and ``exits.i.bias`` as ``MlpEarly`` stores them, and each exit's trainer: that
    of a network that ends there, with the worst positives known.
    """
    exits, trainers = {}, []
    depth = sum(name.startswith("layers.") and name.endswith(".weight") for name in tensors) - 2
    layers = [
        torch.from_numpy(np.column_stack([tensors[f"layers.{k}.weight"], tensors[f"layers.{k}.bias"]]))
        for k in range(depth)
    ]
    for index in range(depth):
        if isinstance(trainer, SupportTrainer):
            own = trainer.behind(layers[: index + 1])
        else:
            known = trainer.outputs[index] if isinstance(trainer, EarlyTrainer) else None
            own = _ExitTrainer(trainer, layers[: index + 1], known)
        own.run(Clock(seconds / depth, steps))
        *_, exits[f"exits.{index}.weight"], exits[f"exits.{index}.bias"] = own.finish().values()
        trainers.append(own)
    return exits, trainers


class _JointExit:
    """An exit in joint training: the layers are the network's, the output and the hard positives are its own."""

    def __init__(self, trainer: NetworkTrainer, depth: int):
        full = trainer.network
        self.network = TrainableNetwork(full.ndim, full.hidden[:depth], full.activation)
        self.output = self.network.layers[-1]
        uniform = torch.rand(self.output.shape, generator=trainer.generator) * 2 - 1
        self.output.copy_(uniform).div_(math.sqrt(self.output.shape[1]))
        # The hidden layers are the full network's own tensors, whose steps are so seen here. Of ``self.network.flat``
        # only the output is in use from now on.
        self.network.layers[:-1] = full.layers[:depth]
        self.workers = [Evaluator(self.network) for _ in trainer.workers]
        self.optimiser = Soap([self.output], trainer.recipe.beta1, trainer.recipe.beta2)
        self.hard = trainer.samples.positives(0)
        self.batches: tuple[Batches, Batches] | None = None


class EarlyTrainer(NetworkTrainer):
    """``NetworkTrainer`` of a network with an exit behind each hidden layer but the last; same arguments."""

    def __init__(self, samples, hidden, activation):
        super().__init__(samples, hidden, activation)
        self.exits = [_JointExit(self, depth) for depth in range(1, len(hidden))]
        self.outputs = [each.output.clone() for each in self.exits]  # as they were with the best network

    def _refresh(self, used: float) -> None:
        best = self._best
        super()._refresh(used)
        if self._best is not best:
            self.outputs = [each.output.clone() for each in self.exits]
        negative, positive = (batches.x for batches in self._batches)
        recipe = replace(self.recipe, batch=int(self.recipe.batch * JOINT_BATCH))
        for each in self.exits:
            state = torch.cat([each.hard, self.samples.positives(JOINT_EXPLORE)], 1)
            state = self._descend(each.workers, state, JOINT_MOVES)
            encoded = self.network.encode(self.samples.coordinates(state))
            worst = self._evaluate(each.workers, encoded).topk(min(JOINT_HARD, state.shape[1]), largest=False)[1]
            each.hard = state[:, worst]
            positives = torch.cat([encoded[:, worst], positive], 1)
            below, above = (self._evaluate(each.workers, x) for x in (negative, positives))
            each.batches = plan(recipe, used, self.generator, (negative, below), (positives, above))

    def _gradients(self, row: int, used: float, rate: float) -> list[torch.Tensor]:
        """The exits make their own steps here, and their losses count in the layers that they share."""
        accumulate(self._batches, self.recipe, self.team, self.workers, row, used)
        for each in self.exits:
            accumulate(each.batches, self.recipe, self.team, each.workers, row, used)
            *shared, output = summed(each.workers)
            for total, part in zip(self.workers[0].gradients, shared, strict=False):
                total.add_(part, alpha=JOINT)
            each.optimiser.step([output], rate)
        return summed(self.workers)


class _ExitTrainer(NetworkTrainer):
    """A network of which only the output is trained, some fifty weights, by damped Newton steps on all samples.

    The hidden layers stay as they are; ``output`` ``(1, H + 1)`` is what joint training has begun, or random.
    """

    def __init__(self, trainer: NetworkTrainer, layers: list[torch.Tensor], output: torch.Tensor | None = None):
        full, recipe = trainer.network, replace(trainer.recipe, **EXIT_RECIPE)
        super().__init__(trainer.samples, full.hidden[: len(layers)], full.activation, recipe)
        for own, layer in zip(self.network.layers, [*layers, *([] if output is None else [output])], strict=False):
            own.copy_(layer)
        self._begin = 0.0 if output is None else FINISH
        self.add_states(trainer.hard)

    def run(self, clock: Clock) -> None:
        for step, share in clock.steps():
            used = self._begin + (1 - self._begin) * share
            if step % REFRESH == 0:
                self._refresh(used)
                activations = [self._activations(batches.x) for batches in self._batches]
            self._newton(*activations, used)
        self._refresh(1.0)

    def _activations(self, x: torch.Tensor) -> torch.Tensor:
        """``(N, H + 1)`` activations of the last layer, and ones, for encoded columns."""
        rows = torch.ones(x.shape[1], self.network.hidden[-1] + 1)

        def job(_, part: slice) -> None:
            h = x[:, part]
            for layer in self.network.layers[:-1]:
                z = layer @ h
                h = torch.cat([self.network.act.torch_value(z), torch.ones(1, z.shape[1])])
            rows[part] = h.T

        self.team.over(x.shape[1], job)
        return rows

    def _newton(self, negative: torch.Tensor, positive: torch.Tensor, used: float) -> None:
        """One damped Newton step of the output's weights.

        The loss is ``accumulate``'s over all samples, from their activations ``(N, H + 1)``: the mean over negatives
        of ``softplus(f) - torch.nn.functional.softplus(f - ramp)``, and over positives of ``width
        torch.nn.functional.softplus(-f / width) boost``. The ramp's concave part is left out of the Hessian, which is
        then positive definite.
        """
        recipe, output = self.recipe, self.network.layers[-1][0]
        weight, width, ramp = weights_of(recipe, used)
        w_negative, w_positive = weight**-0.5 * NEGATIVES / len(negative), weight**0.5 / len(positive)
        level = (positive @ output).kthvalue(min(recipe.boosted, len(positive)))[0]
        boost = 1 + (schedule(recipe.boost, used, 0.6, 0.95) - 1) * (positive @ output <= level).float()

        def loss(at: torch.Tensor) -> float:
            f_negative, f_positive = negative @ at, positive @ at
            below = (
                torch.nn.functional.softplus(f_negative) - torch.nn.functional.softplus(f_negative - ramp)
            ).sum() * w_negative
            return float(
                below + (torch.nn.functional.softplus(-f_positive / width) * boost).sum() * (w_positive * width)
            )

        s_negative = torch.sigmoid(negative @ output)
        s_positive = torch.sigmoid((positive @ output).div_(-width))
        pull_down, push_up = s_negative - torch.sigmoid(negative @ output - ramp), s_positive * boost
        gradient = (pull_down @ negative) * w_negative - (push_up @ positive) * w_positive
        curvature = [
            (s_negative * (1 - s_negative)).mul_(w_negative),
            (push_up * (1 - s_positive)).mul_(w_positive / width),
        ]
        hessians: list = [
            None
        ] * self.team.size  # one a thread, added in order: the sum does not depend on who is first

        def job(index: int) -> None:
            parts = []
            for h, c in zip((negative, positive), curvature, strict=True):
                part = self.team.share(index, len(h))
                parts.append((h[part] * c[part, None]).T @ h[part])
            hessians[index] = parts[0] + parts[1]

        self.team.run(job)
        hessian = torch.stack(hessians).sum(0).double()
        damping = DAMPING * float(hessian.diagonal().mean()) + 1e-12
        hessian.diagonal().add_(damping)
        change = torch.linalg.solve(hessian, gradient.double()).float()
        now = loss(output)
        for halving in range(HALVINGS):
            step = 0.5**halving * change
            if loss(output - step) < now:
                output -= step
                return


# Training grants: where an exit of ``mlp-early`` may say *maybe* at once (``bounders.mlp_early``).
#
# *Maybe* is never wrong, so a grant needs no proof. It is fitted to the answers of the finished bounder, whatever the
# truth is: a query that is answered with *maybe* in the end may as well be told so early. What it costs are false
# positives, where it grants what would be denied later; so each *no* counts ``NO_WEIGHT`` times as much as a *maybe*,
# and its threshold is the least one at which, on fresh queries, ``COST`` more false positives are there than before.
#
# A grant is linear in activations that are finished: a logistic regression, convex, whose minimum is found in a
# second. Of planes each of the two outputs is one (``Head``): which offsets are answered with *maybe* on
# this side, by a function of the normal alone; the regression has the offset as one more input, by whose weight it is
# divided.
#
# Limits: rates are those of queries as they are sampled (``queries.sample``). Elsewhere grants are as sound, but may
# cost more false positives.

COST = 0.05  # false positives of all grants together, as a share of those that the bounder has without them
# Queries that a grant is fitted to, and those that its threshold is chosen by.
FITTED, CHOSEN = 20_000, 200_000
NO_WEIGHT = 30.0  # weight of a query that is denied; between 10 and 50 it hardly matters for what can be granted
RIDGE = 1e-6  # weight of the squares of the coefficients: activations of trained networks may be nearly dependent
# Of Newton's method in a trust region: most steps, of which some ten are taken; the region's first radius; the gradient
# at which it ends, which is about what float32 can tell.
ITERATIONS, RADIUS, ENOUGH = 25, 10.0, 1e-5
SEED = 30_011  # added to the problem's: no sample of the training


def granted(bounder: MlpEarly, problem: Problem) -> MlpEarly:
    """The same bounder with grants, its thresholds and its certificate; call it under ``single_threaded_torch``."""
    if len(bounder.hidden) < 2:
        return bounder
    rng = np.random.default_rng(problem.seed + SEED)
    x, answer = _queried(bounder, problem, FITTED, rng)
    v = bounder.domain.to_local(x)
    grants = [_fit(part, bounder.parts[-1], v, answer) for part in bounder.parts[:-1]]
    x, answer = _queried(bounder, problem, CHOSEN, rng)
    truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.oracle_length)(x)
    allowed = int(COST / len(grants) * (answer & ~truth).sum())
    bounder, open_, thresholds = bounder.granting(grants, [GRANTED] * len(grants)), ~answer, []
    for index, part in enumerate(bounder.parts[:-1]):
        grant = Mlp(bounder.domain, *grant_of(bounder.tensors, bounder.sizes, index), bounder._device)
        open_ &= ~(part.values(x).numpy() < part.threshold)  # it comes to the grant, and is denied later
        lost = np.sort(grant.values(x).numpy()[open_])[::-1]
        thresholds.append(float(lost[allowed]) if len(lost) > allowed else -GRANTED)
    return bounder.granting(grants, thresholds)


def _queried(
    bounder: MlpEarly, problem: Problem, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random queries ``(N, columns)`` that reach the network, and whether each is answered with *maybe*."""
    x = np.asarray(problem.sample(count, rng), dtype=np.float32)
    x = x[problem.reaching(x) & np.isfinite(bounder.parts[-1].values(x).numpy())]
    return x, bounder.query(x).numpy()


def _fit(part: Mlp, whole: Mlp, v: np.ndarray, answer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight and bias of the grant behind the last layer of ``part``, an exit."""
    offsets, outputs = part.head.offsets, part.head.outputs
    activations = part.network.activations(v[:, : v.shape[1] - offsets])
    inputs = np.column_stack([activations, np.ones(len(v))])
    if outputs == 1:
        own = _regression(inputs, answer)
        return own[None, :-1], own[-1:]
    rows, offset, bar = [], v[:, -1], float(whole.threshold)
    sides = [network(v[:, :-1]) + sign * offset >= bar for network, sign in zip(whole.networks, (-1, 1), strict=True)]
    for side, other, sign in zip(sides, reversed(sides), (-1, 1), strict=True):
        own = _regression(np.column_stack([inputs, sign * offset])[other], side[other])
        rows.append(own[:-1] / own[-1] if own[-1] > 0 else np.zeros(inputs.shape[1]))
    return np.array(rows)[:, :-1], np.array(rows)[:, -1]


def _regression(inputs: np.ndarray, answer: np.ndarray) -> np.ndarray:
    """``(K,)``, coefficients of the logistic regression of ``answer`` on ``inputs`` ``(N, K)``."""
    x, y = torch.from_numpy(inputs.astype(np.float32)), torch.from_numpy(answer.astype(np.float32))
    weight = torch.where(y > 0, 1.0, NO_WEIGHT)
    weight /= weight.sum().clamp(min=1.0)

    def z_of(at: np.ndarray) -> torch.Tensor:
        return x @ torch.from_numpy(at.astype(np.float32))

    def loss(at: np.ndarray) -> tuple[float, np.ndarray]:
        z = z_of(at)
        value = float((weight * (torch.nn.functional.softplus(z) - y * z)).sum()) + RIDGE * at @ at
        return value, (x.T @ (weight * (torch.sigmoid(z) - y))).double().numpy() + 2 * RIDGE * at

    def hessian(at: np.ndarray) -> np.ndarray:
        p = torch.sigmoid(z_of(at))
        own = (x * (weight * p * (1 - p))[:, None]).T @ x
        return own.double().numpy() + 2 * RIDGE * np.eye(len(own))

    options = {"maxiter": ITERATIONS, "initial_trust_radius": RADIUS, "max_trust_radius": 1000 * RADIUS, "gtol": ENOUGH}
    start = np.zeros(inputs.shape[1])
    return minimize(loss, start, jac=True, hess=hessian, method="trust-exact", options=options).x
