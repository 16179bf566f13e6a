"""From a statistical threshold to a proven one: lower it as little as a proof in time needs.

A lower threshold has a shorter proof and more false positives. Before a proof begins, an unbiased estimate says how
long it takes.
"""

import os
from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates.claim import as_fitted, in_local, mismatch, target, uncovered
from warp_bounding.errors import BounderError, FileFormatError, ProofError
from warp_bounding.proof.check import check_budget
from warp_bounding.proof.covering import ReachesTarget, check_covering, cover_domain
from warp_bounding.proof.halving import Boxes, Checkpoint, unfinished
from warp_bounding.proof.prove import settle
from warp_bounding.proof.search import Search
from warp_bounding.proof.taylor import TaylorBounds
from warp_bounding.runtime.launch import cpu_threads, working_seconds
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.runtime.workers import Workers
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import Shape

# The shares of queries that lower thresholds answer with maybe, where the bounder's own threshold answers no.
LOWER = [[0, 1 / 64, 1 / 32, 1 / 16], np.arange(1 / 8, 2, 1 / 8), np.arange(2, 4, 1 / 4), np.arange(4, 8)]
LOWER = np.concatenate([*LOWER, np.arange(8, 96, 4)]) / 100
DRAWN = 1 << 16  # random queries that these shares are measured on
USEFUL = 0.1  # of the free queries: a threshold that denies fewer is not tried
FOLLOWED = 8192  # boxes of each generation that an estimate follows at most
ESTIMATE_SHARE = 0.02  # of the time that is left, for an estimate; about GENERATIONS an axis share it
FEWEST, GENERATIONS = 512, 10
PLANNED = 0.8  # of the budget: what a proof may be expected to take


def make_proven(
    bounder: Bounder,
    shape,
    *,
    budget: float = 3600.0,
    scheduler: str | int | None = None,
    checkpoint: str | os.PathLike | None = None,
    progress: Progress | bool | None = None,
) -> Bounder:
    """A copy of a bounder with a statistical threshold, at a lower threshold that is proven.

    A lower threshold has a shorter proof and more false positives. Before a proof begins, an unbiased estimate says how
    long it takes. The threshold is lowered as little as that estimate allows within the budget.

    Args:
        bounder: One network that bounds points of a shape without cells, such as an arm's configurations; not changed.
        shape: As ``certify`` takes it.
        budget: Seconds for estimates and proof.
        scheduler: As ``certify`` takes it; the estimate counts on the workers that an address has now.
        checkpoint: As ``certify`` takes it: the same call goes on from there, with the threshold that was chosen.
        progress: As ``fit`` takes it.

    Returns:
        A new bounder with its certificate.

    Raises:
        ProofError: If no proof that denies a tenth of the free queries is expected to end in time, time runs out, or a
            proof fails at every threshold.
        BounderError: If the bounder is no such network.
        FileFormatError: For a checkpoint of another proof, or one that cannot be read or written.
        ShapeError: For a checkpoint of the proof for a function.

    Example:
        >>> ball = wb.shapes.Function(None, [-1, -1], [1, 1], distance=lambda x: np.linalg.norm(x, axis=1) - 0.9)
        >>> network = wb.fit(ball, hidden=(8, 8), steps=100, statistical=True, device="cpu", progress=False)
        >>> wb.proof.make_proven(network, ball, budget=60.0).certificate.kind
        'proven'
    """
    check_budget(budget)
    bounder = bounder_of(bounder)
    frame = bounder.frame
    bounder, shape = in_local(bounder, shape)
    grid = as_fitted(bounder, shape)
    if reason := mismatch(bounder, grid) or uncovered(bounder):
        raise BounderError(f"{bounder.method}: {reason}")
    if isinstance(grid, Grid) or bounder.query_kind != "point" or len(bounder.parts) > 1:
        raise BounderError(f"{bounder.method}: expected a bounder of points of a shape without cells, in one part")
    if not (bounder.conservative and grid.certified):
        raise BounderError(f"{bounder.method}: {grid.name} or the method has no proof")
    if checkpoint is not None:
        grid.expect_identified("a checkpoint")
    grid.check()
    with reported(progress, f"prove {bounder.method}") as update:
        limits = {"budget": budget, "scheduler": scheduler, "checkpoint": checkpoint, "progress": update}
        try:
            return prove_lower(bounder, grid, **limits).in_frame(frame)
        except ProofError as error:
            error.bounder = bounder.in_frame(frame)
            raise


def prove_lower(
    bounder: Bounder,
    grid: Shape,
    *,
    budget: float = float("inf"),
    boxes: float = float("inf"),
    scheduler: str | int | None = None,
    checkpoint: str | os.PathLike | None = None,
    progress: Callable[..., None] | None = None,
) -> Bounder:
    """``make_proven`` of a bounder in its shape's frame; ``boxes`` limit the proof where no clock may."""
    end, lowered = working_seconds() + budget, TaylorBounds().given_to(_lowered(bounder, grid))
    grid = TaylorBounds().given_to(grid)
    if checkpoint is not None and os.path.exists(checkpoint):
        index = _begun(lowered, grid, checkpoint)
    else:
        try:
            index = _planned(lowered, grid, end, boxes, scheduler)
        except ProofError as error:
            error.bounder = bounder
            raise
    lowest = np.inf  # f of a positive
    for lower in lowered[index:]:
        if target(lower) > lowest:
            continue
        saved = None if checkpoint is None else Checkpoint(checkpoint, lower, grid)
        options = {"progress": progress, "scheduler": scheduler, "most": boxes, "checkpoint": saved}
        started, seconds = working_seconds(), max(end - working_seconds(), 0.0)
        checked = check_covering(cover_domain(lower, grid), target(lower), seconds, **options)
        if not checked.complete:
            within = f"{budget:.3g} s" if budget < np.inf else f"{boxes:,.0f} boxes"
            raise ProofError(f"{bounder.method}: {unfinished(within, saved)}", bounder)
        if checked.suspects is None:
            spent, none = working_seconds() - started, np.empty((0, grid.ndim))
            proven = bounder.to()
            settle(proven, grid, Search(checked.least, checked.least, none, checked.boxes, spent, True))
            proven.info = bounder.info | {"rates": None}
            return proven
        positive = checked.suspects[grid.contains(checked.suspects)]
        values = bounder.reference(bounder.domain.to_local(positive))
        lowest = min(lowest, float(values.min(initial=np.inf)))
    raise ProofError(f"{bounder.method}: the proof fails at each threshold that was tried; train it longer", bounder)


def _lowered(bounder: Bounder, shape: Shape) -> list[Bounder]:
    """The bounder, and others at lower thresholds that answer more queries with maybe, by the shares in ``LOWER``.

    Each of them denies the share ``USEFUL`` of the free queries; or half of what the bounder does, where that is less.
    """
    x = np.random.default_rng(0).uniform(shape.lower, shape.upper, (DRAWN, shape.ndim)).astype(np.float32)
    values, now = bounder.values(x).numpy(), float(bounder.threshold)
    denied = np.sort(values[values < now])[::-1]
    most = len(denied) - min(USEFUL * np.count_nonzero(~shape.contains(x)), len(denied) / 2)
    lower = (float(denied[place]) for place in (LOWER[1:] * DRAWN).astype(int) if place < most)
    return [bounder.to().freeze(threshold, None) for threshold in (now, *lower)]


def _begun(lowered: list[Bounder], shape: Shape, checkpoint: str | os.PathLike) -> int:
    """The index of the bounder that the checkpoint is about; raises ``FileFormatError`` if it is about none."""
    for index, bounder in enumerate(lowered):
        try:
            Checkpoint(checkpoint, bounder, shape)
        except FileFormatError as error:
            reason = error
        else:
            return index
    raise reason


def _planned(lowered: list[Bounder], shape: Shape, end: float, boxes: float, scheduler: str | int | None) -> int:
    """The index of the first bounder (highest threshold) whose proof is expected to end in time, by bisection.

    ``end`` is by ``working_seconds``. Raises ``ProofError`` if there is none.
    """
    cores = cpu_threads() if scheduler is None else scheduler
    if not isinstance(cores, int) or isinstance(cores, bool) or cores < 1:  # an address, or what is refused
        with Workers(cores) as workers:
            cores = workers.count
    first, last = 0, len(lowered)
    while first < last:
        middle, left = (first + last) // 2, max(end - working_seconds(), 0.0)
        count, pace = _expected(lowered[middle], shape, ESTIMATE_SHARE * left)
        pace *= cpu_threads() / cores
        fits = count <= PLANNED * boxes and count * pace <= PLANNED * (end - working_seconds())
        first, last = (first, middle) if fits else (middle + 1, last)
    method = lowered[0].method
    if first == len(lowered) and count == np.inf:
        raise ProofError(f"{method}: the proof fails at each threshold that was tried; is {shape.name} its shape?")
    if first == len(lowered):
        time = f"{left:.3g} s" if left < np.inf else f"{boxes:,.0f} boxes"
        expected = f"about {count * pace:.3g} s, {count:.3g} boxes, on {cores} cores"
        raise ProofError(
            f"{method}: thresholds whose proofs are expected to end in {PLANNED:.0%} of {time} deny less than "
            f"{USEFUL:.0%} of what is free of {shape.name}; the proof of the lowest that denies more takes {expected}. "
            "Give a larger budget= or more workers (scheduler=); hold joints of an arm (held=), or split it: a bounder "
            "of arm.self_collision(), and one of the cell, with self_collision=False; or take a threshold from samples "
            "(statistical=True)",
            seconds=count * pace,
        )
    return first


def _expected(bounder: Bounder, shape: Shape, seconds: float) -> tuple[float, float]:
    """How many boxes a proof looks at, an unbiased estimate, and seconds of each on this machine.

    Infinitely many if the proof is seen to fail. The estimate follows a random part of each generation of boxes, and
    takes about some ``seconds``. Source: D. E. Knuth, "Estimating the Efficiency of Backtrack Programs" (1975).
    """
    covering, rng = cover_domain(bounder, shape), np.random.default_rng(0)
    look = ReachesTarget(covering.positives, target(bounder))
    lower, upper, _ = covering.starts[0]
    counts = np.arange(len(lower)), np.zeros(len(lower), np.int64)
    boxes, weight, expected, looked, started = Boxes(lower, upper, *counts, 0.0), 1.0, 0.0, 0, working_seconds()
    while boxes.count:
        halves, _, _, failed = look(boxes)
        expected, looked = expected + weight * boxes.count, looked + boxes.count
        pace = (working_seconds() - started) / looked
        if failed is not None:
            return np.inf, pace
        followed = FOLLOWED
        if seconds < np.inf:
            followed = int(np.clip(seconds / (GENERATIONS * shape.ndim * max(pace, 1e-9)), FEWEST, FOLLOWED))
        if halves.count > followed:
            weight *= halves.count / followed
            halves = halves.part(rng.choice(halves.count, followed, replace=False))
        boxes = halves
    return expected, pace
