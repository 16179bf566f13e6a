"""Asking random queries, and counting what is wrong about the answers."""

from collections.abc import Callable
from typing import Any

import numpy as np

from warp_bounding.evaluation.report import Rates
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED

__all__ = ["CHUNK", "counted"]

CHUNK = 1_000_000  # queries that are asked at a time


def counted(
    draw: Callable[[int], np.ndarray],
    truth_of: Callable[[np.ndarray], np.ndarray],
    ask: Callable[[np.ndarray], np.ndarray],
    samples: int,
    progress: Callable[[int, int], None] | None = None,
    of_cells: Callable[[np.ndarray], np.ndarray] | None = None,
    **told: Any,
) -> Rates:
    """Ask a bounder.

    Args:
        draw: Returns so many queries ``(N, m)`` float32, new ones each time.
        truth_of: Answers as ``Shape.decide``, or with bool.
        ask: ``(N,)`` bool, the bounder's *maybe*.
        samples: How many queries in all.
        progress: Called with samples done and samples in all.
        of_cells: The truth of the cells that the fit bounded, where it bounded cells of a shape.
        told: The other fields of ``Rates``.
    """
    false_positive = false_negative = positive = undecided = beyond_cells = 0
    for start in range(0, samples, CHUNK):
        x = draw(min(CHUNK, samples - start))
        truth, maybe = np.asarray(truth_of(x), dtype=np.uint8), ask(x)
        false_positive += int((maybe & (truth == OUT)).sum())
        false_negative += int(((truth == IN) & ~maybe).sum())
        positive += int((truth != OUT).sum())
        undecided += int((truth == UNDECIDED).sum())
        if of_cells is not None:
            beyond_cells += int((maybe & ~of_cells(x)).sum())
        if progress:
            progress(start + len(x), samples)
    return Rates(
        fp_rate=100 * false_positive / samples,
        fn=false_negative,
        positives=100 * positive / samples,
        samples=int(samples),
        undecided=100 * undecided / samples,
        fp_rate_cells=None if of_cells is None else 100 * beyond_cells / samples,
        **told,
    )
