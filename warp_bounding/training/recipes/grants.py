"""Training grants: where an exit of ``mlp-early`` may say *maybe* at once (``bounders.mlp_early``).

*Maybe* is never wrong, so a grant needs no proof. It is fitted to the answers of the finished bounder, whatever the
truth is: a query that is answered with *maybe* in the end may as well be told so early. What it costs are false
positives, where it grants what would be denied later; so each *no* counts ``NO_WEIGHT`` times as much as a *maybe*,
and its threshold is the least one at which, on fresh queries, ``COST`` more false positives are there than before.

A grant is linear in activations that are finished: a logistic regression, convex, whose minimum is found in a second.
Of planes each of the two outputs is one (``networks.heads``): which offsets are answered with *maybe* on this side, by
a function of the normal alone; the regression has the offset as one more input, by whose weight it is divided.

Limits: rates are those of queries as they are sampled (``queries.sample``). Elsewhere grants are as sound, but may
cost more false positives.
"""

import numpy as np
import torch
from scipy.optimize import minimize
from torch.nn.functional import softplus

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly, grant_of
from warp_bounding.kernels.source import GRANTED
from warp_bounding.queries import oracle
from warp_bounding.training.problem import Problem

__all__ = ["COST", "granted"]

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
    """The same bounder with grants, with its thresholds and its certificate.

    Call it under ``single_threaded_torch``.

    Args:
        bounder: With all thresholds.
        problem: What it bounds.
    """
    if len(bounder.hidden) < 2:
        return bounder
    rng = np.random.default_rng(problem.seed + SEED)
    x, answer = _asked(bounder, problem, FITTED, rng)
    v = bounder.domain.to_local(x)
    grants = [_fit(part, bounder.parts[-1], v, answer) for part in bounder.parts[:-1]]
    x, answer = _asked(bounder, problem, CHOSEN, rng)
    truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.oracle_length)(x)
    allowed = int(COST / len(grants) * (answer & ~truth).sum())
    bounder, open_, thresholds = bounder.granting(grants, [GRANTED] * len(grants)), ~answer, []
    for index, part in enumerate(bounder.parts[:-1]):
        grant = Mlp(bounder.domain, *grant_of(bounder.tensors, bounder.sizes, index), bounder._device)
        open_ &= ~(part.values(x).numpy() < part.threshold)  # it comes to the grant, and is denied later
        lost = np.sort(grant.values(x).numpy()[open_])[::-1]
        thresholds.append(float(lost[allowed]) if len(lost) > allowed else -GRANTED)
    return bounder.granting(grants, thresholds)


def _asked(bounder: MlpEarly, problem: Problem, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Random queries ``(N, columns)`` that reach the network, and whether each is answered with *maybe*."""
    x = np.asarray(problem.sample(count, rng), dtype=np.float32)
    x = x[problem.asked(x) & np.isfinite(bounder.parts[-1].values(x).numpy())]
    return x, bounder.query(x).numpy() != 0


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
        value = float((weight * (softplus(z) - y * z)).sum()) + RIDGE * at @ at
        return value, (x.T @ (weight * (torch.sigmoid(z) - y))).double().numpy() + 2 * RIDGE * at

    def hessian(at: np.ndarray) -> np.ndarray:
        p = torch.sigmoid(z_of(at))
        own = (x * (weight * p * (1 - p))[:, None]).T @ x
        return own.double().numpy() + 2 * RIDGE * np.eye(len(own))

    options = {"maxiter": ITERATIONS, "initial_trust_radius": RADIUS, "max_trust_radius": 1000 * RADIUS, "gtol": ENOUGH}
    start = np.zeros(inputs.shape[1])
    return minimize(loss, start, jac=True, hess=hessian, method="trust-exact", options=options).x
