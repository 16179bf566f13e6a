"""The verdict: times in turns, the cheapest, what is to be known of the others, and what a larger budget would have room for."""

from dataclasses import replace
from typing import Any

import warp as wp

from warp_bounding.choice.result import NONE, Choice, Row
from warp_bounding.choice.timing import TURNS, times_of
from warp_bounding.choice.work import Tried, Work, told_budget
from warp_bounding.errors import BounderError
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.runtime.working_time import compile_seconds

__all__ = ["chosen"]

WORTH = 0.1  # of the least cost: what there must be to gain, at the most, for a larger budget to be probably worth it
MORE_TRAINING = (
    2.0  # times the seconds that left a network starved: with so many it would not be, for all that is known
)


def chosen(work: Work, tried: list[Tried], queries: int) -> Choice:
    """The choice among what was fitted, with times taken in turns.

    Raises:
        BounderError: If nothing is small enough.
    """
    untried = any(row.needs > 0 for row in work.passed.values())  # a larger budget may find what is small enough
    if work.memory is not None and not untried and not any(each.bounder.nbytes <= work.memory for each in tried):
        sizes = [(each.bounder.nbytes, each.label) for each in tried]
        nearest = f"; the nearest is {min(sizes)[1]} with {min(sizes)[0]:,}" if sizes else ""
        raise BounderError(f"memory: no candidate has {work.memory:,} bytes or less{nearest}")
    work.tell("times, in turns")
    times = times_of({each.label: each.bounder for each in tried}, work.batch, TURNS)
    rows = [Row(NONE, 0, 0.0, 1.0, work.narrow_ns, "by construction")]
    for each in tried:
        nanoseconds = work.overhead_ns + times[each.label]
        cost = nanoseconds + each.row.share * work.narrow_ns
        rows.append(replace(each.row, nanoseconds=nanoseconds, cost=cost, **_doubts(work, each.label)))
    rows.sort(key=lambda row: (bool(row.why_not), row.cost))
    best = rows[0].label
    bounder = next((each.bounder for each in tried if each.label == best), None)
    labels = {each.label for each in tried}
    others = [row for row in work.passed.values() if row.label not in labels]
    on_cpu = wp.get_device(work.device).is_cpu
    return Choice(
        bounder,
        best,
        (*rows, *others),
        work.narrow_ns,
        work.positives,
        queries,
        work.memory,
        work.device,
        cpu_threads() if on_cpu else 0,
        {
            "shape": work.shape.name,
            "query": work.query,
            "interrupted": work.interrupted,
            "budget": work.spending.budget,
            "seconds": round(work.spending.now, 3),
            "seconds_before": round(work.spending.charged, 3),
            "compile_seconds": round(compile_seconds() - work.compiled, 3),
            "larger_budget": None if work.interrupted else _larger(work, [*rows, *others]),
        },
    )


def _doubts(work: Work, label: str) -> dict[str, str | float]:
    """What a row says of a network that had too little time; what it would take is noted in ``work.foreseen``."""
    attempts = work.kept.of(label)
    if not attempts.starved:
        return {}
    work.foreseen[label] = work.pace.whole(MORE_TRAINING * max(attempts.given, default=1.0))
    needs = work.spending.budget + work.foreseen[label] - max(work.spending.left, 0.0)
    return {"note": attempts.starved, "needs": told_budget(needs)}


def _larger(work: Work, rows: list[Row]) -> dict[str, Any] | None:
    """The budget that would let in what this one had no room for, and whether that would probably change the answer."""
    missing = [row for row in rows if row.needs]
    if not missing:
        return None
    best, least = min(row.cost for row in rows if not row.why_not), work.positives * work.narrow_ns
    promising = [row for row in missing if row.label in work.networks and best - least > WORTH * best]
    more = sum(work.foreseen[row.label] for row in promising or missing) - max(work.spending.left, 0.0)
    return {
        "seconds": told_budget(work.spending.budget + more),
        "labels": [row.label for row in promising or missing],
        "probably": bool(promising),
    }
