"""``choose_among``: the cheapest of broad phases that one's own code asks, whatever they are made of."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warp_bounding.choice.result import NONE, Choice, Row
from warp_bounding.errors import BounderError
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.checks import is_number

__all__ = ["choose_among"]

TURNS = 5  # calls of each that are timed


def choose_among(
    asked: Mapping[str, Callable[[], Any]], queries: int, *, narrow_ns: float, turns: int = TURNS
) -> Choice:
    """Choose among broad phases as they are asked in one's own code: what a query costs there is what counts, all overhead included.

    Where ``choose`` fits and asks bounders of one kind of query, this takes anything that answers: a planner's edges by boxes of their pieces or by
    marching, two bounders one after another, code without a bounder. Whether an answer is proven is for the caller to know.

    Args:
        asked: By label, called without arguments; each asks the same queries and returns ``(queries,)`` answers, not zero where the narrow phase is needed.
        queries: How many these are.
        narrow_ns: What the narrow phase takes for one query, nanoseconds.
        turns: Calls of each that are timed, after one that is not; they take turns, and the fastest counts.

    Returns:
        The choice; its ``bounder`` is ``None``, its ``label`` says which. No broad phase is one of the answers.

    Raises:
        BounderError: For a price that makes no sense, or answers that are not so many.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> box, x = wb.fit(ball, method="aabb", device="cpu"), np.random.rand(10_000, 3).astype(np.float32)
        >>> wb.choose_among({"box": lambda: box.query(x).numpy()}, len(x), narrow_ns=0.0).label
        'none'
    """
    if not is_number(narrow_ns) or narrow_ns < 0:
        raise BounderError(f"narrow_ns must be a number of nanoseconds of at least 0, got {narrow_ns!r}")
    if isinstance(queries, bool) or not isinstance(queries, (int, np.integer)) or queries < 1:
        raise BounderError(f"queries must be a whole number of at least 1, got {queries!r}")
    best, shares = dict.fromkeys(asked, math.inf), {}
    for turn in range(max(int(turns), 1) + 1):
        for label, ask in asked.items():
            start = time.perf_counter()
            answers = ask()
            seconds = time.perf_counter() - start
            if turn:
                best[label] = min(best[label], seconds)
            else:
                shares[label] = _share(label, answers, queries)
    rows = [Row(NONE, 0, 0.0, 1.0, float(narrow_ns), "by construction")]
    for label, seconds in best.items():
        nanoseconds = 1e9 * seconds / queries
        rows.append(Row(label, 0, nanoseconds, shares[label], nanoseconds + shares[label] * narrow_ns))
    rows.sort(key=lambda row: row.cost)
    least = min(shares.values(), default=1.0)
    return Choice(None, rows[0].label, tuple(rows), float(narrow_ns), least, int(queries), None, "cpu", cpu_threads())


def _share(label: str, answers, queries: int) -> float:
    """Of the queries that are left."""
    found = np.asarray(answers.numpy() if hasattr(answers, "numpy") else answers)
    if found.shape != (queries,):
        raise BounderError(f"{label}: expected ({queries},) answers, got {found.shape}")
    return float(np.count_nonzero(found)) / queries
