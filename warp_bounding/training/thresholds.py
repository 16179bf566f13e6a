"""What a threshold costs in false positives, and how a trained network of rays or boxes gets the best one that can be had in time.

An adversary finds the least value that training has left over; the prover then has to show that there is nothing below,
but for a gap that costs next to nothing. If it cannot in its time, and the gap that it did prove costs too much, the
adversary's value stands, and fresh positives tell what is known of it.
"""

import numpy as np

from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.proof import attest, least_value, settle
from warp_bounding.proof.covers.monotone_box import of_points
from warp_bounding.proof.search.pace import GROWTH
from warp_bounding.queries import oracle, sample
from warp_bounding.training.problem import Problem

__all__ = ["PROOF_COST", "Costs", "decide"]

PROOF_COST = {
    "point": 1e-4,
    "ray": 1e-3,
    "plane": 1e-4,
    "box": 1e-3,
}  # share of all queries that a search may cost at its end,
LARGEST_COST = 2e-2  # or, of rays and boxes, where it has to end early
SAMPLES = 200_000
FINEST, USUAL = 1e-6, 1e-3  # least gap; gap where no negative tells


class Costs:
    """F of negatives, as a device computes it.

    Args:
        bounder: Whose f.
        problem: What it bounds.
    """

    def __init__(self, bounder: Mlp, problem: Problem):
        x = sample(problem.query, problem.grid, SAMPLES, np.random.default_rng(0))
        truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.oracle_length)(x)
        values = bounder.values(x).numpy()[~truth & problem.asked(x)]
        self.values, self.query = np.sort(values[np.isfinite(values)]), problem.query

    def room(self, least: float) -> float:
        """How far below a value a threshold may lie before it costs ``PROOF_COST`` of all queries."""
        place, count = np.searchsorted(self.values, least), int(PROOF_COST[self.query] * SAMPLES)
        return max(least - float(self.values[place - count - 1]), FINEST) if place > count else USUAL

    def between(self, lower: float, upper: float) -> float:
        """Share of all queries whose f lies between two values."""
        return float(np.diff(np.searchsorted(self.values, [lower, upper]))[0]) / SAMPLES

    def of_proof(self, least: float, eps: float, needed: float, seconds: float) -> float:
        """Share of all queries that a proof is expected to cost that has some seconds, where it needs others to come as near as ``eps``."""
        return self.between(least - eps * max(needed / seconds, 1.0) ** (1 / GROWTH), least)


def tolerance(bounder: Mlp, problem: Problem, worst: np.ndarray) -> float:
    """How far below the least f of some positives ``(N, ndim)`` a threshold may lie; see ``Costs.room``."""
    return Costs(bounder, problem).room(float(of_points(bounder).reference(worst).min()))


def decide(
    part: Mlp,
    problem: Problem,
    found: np.ndarray,
    limits: dict[str, float] | None,
    report=lambda note: None,
) -> dict:
    """Set the threshold of a network of rays or boxes, by proof if there is time for one, and give it its certificate.

    Args:
        part: Changed in place.
        problem: What it bounds.
        found: ``(N, ndim)``, the lowest positives known.
        limits: ``seconds`` or ``boxes`` for the prover; ``None`` if it need not try.
        report: Called with what is being done.

    Returns:
        A record of it: ``gap``, and what the prover did.
    """
    costs, least = Costs(part, problem), float(part.reference(found).min())
    record, left = {}, None
    if limits is not None and part.provable:
        report("proof")
        search = least_value(part, problem.grid, eps=costs.room(least), points=found, **limits)
        error = part.rounding_bound()
        cost = costs.between(search.lower_bound - error, min(least, search.upper_bound))
        record = {
            "gap": search.upper_bound - search.lower_bound,
            "proof_cost": cost,
            "proof_seconds": round(search.seconds, 3),
        }
        if search.complete or cost <= LARGEST_COST:
            settle(part, problem.grid, search)
            return record
        least, left = min(least, search.upper_bound), search
    report("fresh positives")
    room = costs.room(least)
    attest(part, problem.grid, least=least, room=room, seed=problem.seed, search=left)
    return {"gap": room} | {k: v for k, v in record.items() if k != "gap"}
