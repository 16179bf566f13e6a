"""What a threshold costs in false positives, and the best one for a network of rays or boxes in some time.

An adversary looks for the least f of a positive. The prover then tries to show that no positive lies below that value
by more than a gap that costs next to nothing. If it does not get there in its time, and the gap that it has proven
costs too much, the adversary's value sets the threshold, and fresh positives attest it.
"""

from dataclasses import replace

import numpy as np

from warp_bounding.bounders.mlp import Lattice, Local, Mlp
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof import attest, charted, least_value, settle
from warp_bounding.proof.covers.monotone_box import of_points
from warp_bounding.proof.local import at_least, needless, worthwhile
from warp_bounding.proof.parts import least_by_part
from warp_bounding.proof.search.pace import GROWTH
from warp_bounding.queries import oracle
from warp_bounding.queries.positives import draw_positives
from warp_bounding.training.problem import Problem

__all__ = ["PROOF_COST", "Costs", "decide", "decide_parts", "lattice_of", "negatives_of", "tolerance"]

# Share of all queries that may become false positives by the gap that a complete search leaves.
PROOF_COST = {"point": 1e-4, "ray": 1e-3, "plane": 1e-4, "box": 1e-3}
LARGEST_COST = 2e-2  # the same share where the search of rays or boxes ran out of time; above it the proof is not used
SAMPLES = 200_000  # random queries by which costs are estimated
FINEST = 1e-6  # least gap that is asked for, in f
POSITIVES = 300_000  # random positives from which the parts' least f is first taken
USUAL = 1e-3  # gap in f that is asked for where too few negatives lie below to measure its cost


class Costs:
    """Values of f at negatives, as a device computes them, which tell what a threshold costs."""

    def __init__(self, bounder: Mlp, problem: Problem):
        x = problem.sample(SAMPLES, np.random.default_rng(0))
        truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.oracle_length)(x)
        values = bounder.values(x).numpy()[~truth & problem.asked(x)]
        self.values, self.query = np.sort(values[np.isfinite(values)]), problem.query

    def cheap_gap(self, least: float) -> float:
        """How far below a value a threshold may lie before it costs ``PROOF_COST`` of all queries."""
        place, count = np.searchsorted(self.values, least), int(PROOF_COST[self.query] * SAMPLES)
        return max(least - float(self.values[place - count - 1]), FINEST) if place > count else USUAL

    def between(self, lower: float, upper: float) -> float:
        """Share of all queries whose f lies between two values."""
        return float(np.diff(np.searchsorted(self.values, [lower, upper]))[0]) / SAMPLES

    def of_proof(self, least: float, eps: float, needed: float, seconds: float) -> float:
        """Share of queries that a proof in ``seconds`` should cost, where a gap ``eps`` takes ``needed`` seconds."""
        return self.between(least - eps * max(needed / seconds, 1.0) ** (1 / GROWTH), least)


def lattice_of(problem: Problem, count: int) -> Lattice:
    """About so many parts, no more, of the domain.

    Of points they are cubes, as nearly as whole counts along each axis allow; of rays and boxes each axis of v is cut
    as often, or once more than others.
    """
    shape, domain = problem.grid, problem.domain
    if not domain.tested_as_point:
        limit = domain.limit.astype(np.float64)
        counts = np.ones(len(limit), dtype=int)
        while counts.prod() // counts.min() * (counts.min() + 1) <= count:
            counts[np.argmin(counts)] += 1
        return Lattice.of(-limit, limit, tuple(int(c) for c in counts))
    lower, upper = shape.lower, shape.upper
    if isinstance(shape, IndicatorGrid):
        cells = shape.occupied
        lower, upper = shape.position(cells.min(axis=0) - 0.5), shape.position(cells.max(axis=0) + 0.5)
    low, high = domain.to_local(lower), domain.to_local(upper)
    counts = np.ones(len(low), dtype=int)
    while True:  # one more along the axis with the longest parts, as long as there are no more than ``count``
        longest = np.argsort(-(high - low) / counts)
        grown = [counts + (np.arange(len(counts)) == axis) for axis in longest]
        fitting = next((g for g in grown if g.prod() <= count), None)
        if fitting is None:
            return Lattice.of(low, high, tuple(int(c) for c in counts))
        counts = fitting


def negatives_of(problem: Problem) -> np.ndarray:
    """``(N, ndim)`` coordinates v of random queries that are certainly no positives, and that reach the bounder."""
    x = problem.sample(SAMPLES, np.random.default_rng(0))
    truth = oracle(problem.query, problem.grid, "cpu", problem.domain.oracle_length)(x)
    v = problem.domain.to_local(x[~truth & problem.asked(x)])
    return v[(np.abs(v) <= problem.domain.limit).all(axis=1)]


def tolerance(bounder: Mlp, problem: Problem, worst: np.ndarray) -> float:
    """How far below the least f of some positives ``(N, ndim)`` a threshold may lie; see ``Costs.cheap_gap``."""
    return Costs(bounder, problem).cheap_gap(float(of_points(bounder).reference(worst).min()))


def decide_parts(
    member: Mlp,
    lattice: Lattice,
    problem: Problem,
    found: np.ndarray,
    limits: dict[str, float],
    report=lambda note: None,
) -> tuple[Local, dict]:
    """A network of rays or boxes with a threshold for each part of its domain, and its certificate.

    Where the proof leaves thresholds that cost too much, those of the lowest positives that it has found are taken, and
    fresh positives attest them all together.

    Args:
        member: The network; its own threshold is not used.
        lattice: The parts.
        problem: What it bounds.
        found: ``(N, ndim)``, the lowest positives known, coordinates ``v``.
        limits: ``seconds`` or ``boxes`` for the prover.
        report: Called with a note on what begins.

    Returns:
        The bounder; and a record: ``gap``, ``proof_cost``, ``proof_seconds``, ``complete`` and ``thresholds``.
    """
    domain, grid, length = problem.domain, problem.grid, problem.domain.oracle_length
    drawn = draw_positives(problem.query, grid, POSITIVES, problem.seed, "cpu", length, outside=False)
    points = np.concatenate([found, *(domain.to_local(x) for x in drawn)])
    points, negatives = points[(np.abs(points) <= domain.limit).all(axis=1)], negatives_of(problem)
    report("proof of every part")
    eps = Costs(member, problem).cheap_gap(float(member.reference(points).min()))
    cover = charted(member, grid)
    least, known, search = least_by_part(member, cover, lattice, negatives, points, eps=eps, **limits)
    values, place = member.reference(negatives), lattice.place(negatives)
    cost = float(((values >= least[place]) & (values < known[place])).sum()) / SAMPLES
    record = {
        "gap": eps,
        "proof_cost": cost,
        "proof_seconds": round(search.seconds, 3),
        "complete": search.complete,
        "thresholds": lattice.count,
    }
    if search.complete or cost <= LARGEST_COST:
        bounder, proven = at_least(member, lattice, needless(least, values, place), values, place)
        settle(bounder, grid, replace(search, lower_bound=proven))
        return bounder, record
    report("fresh positives")
    room = worthwhile(lattice, known, values, place, eps)
    known = np.maximum(known - room, known.min() - eps)  # no lower than one threshold would be
    bounder, lowest = at_least(member, lattice, needless(known, values, place), values, place)
    attest(bounder, grid, least=lowest, room=0.0, seed=problem.seed, search=search)
    return bounder, record


def decide(
    part: Mlp,
    problem: Problem,
    found: np.ndarray,
    limits: dict[str, float] | None,
    report=lambda note: None,
) -> dict:
    """Set the threshold of a network of rays or boxes, by proof if there is time for one, and give it its certificate.

    Args:
        part: The network; changed in place.
        problem: What it bounds.
        found: ``(N, ndim)``, the lowest positives known, coordinates ``v``.
        limits: ``seconds`` or ``boxes`` for the prover; ``None`` if it is not to try.
        report: Called with a note on what begins.

    Returns:
        A record: ``gap``, and where the prover has tried ``proof_cost`` and ``proof_seconds``.
    """
    costs, least = Costs(part, problem), float(part.reference(found).min())
    record, left = {}, None
    if limits is not None and part.provable:
        report("proof")
        search = least_value(part, problem.grid, eps=costs.cheap_gap(least), points=found, **limits)
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
    gap = costs.cheap_gap(least)
    attest(part, problem.grid, least=least, room=gap, seed=problem.seed, search=left)
    return {"gap": gap} | {k: v for k, v in record.items() if k != "gap"}
