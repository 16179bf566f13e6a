"""What can be said where no proof exists: after the threshold is frozen, fresh positives are asked and none may be missed.

With N independent positives of a stated distribution and no failure, the rate of false negatives *under that distribution*
is below ``1 - (1 - confidence)^(1/N)`` (Clopper and Pearson 1934), about 3/N at 95 %. The search that set the threshold earns
no confidence. A failure lowers the threshold below what failed, and the count begins anew.
"""

import time
from collections.abc import Callable

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.certificate import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.document import document
from warp_bounding.queries.positives import DISTRIBUTION, draw_positives

__all__ = ["CONFIDENCE", "attest", "fn_rate_bound", "try_positives"]

CONFIDENCE = 0.95
POSITIVES = 1_000_000
MOST_RESTARTS = 20


def fn_rate_bound(count: int, confidence: float = CONFIDENCE) -> float:
    """Upper confidence bound of a rate of which no case was seen in ``count`` independent trials."""
    return float(-np.expm1(np.log1p(-confidence) / count)) if count else 1.0


def try_positives(
    bounder: Bounder, grid: IndicatorGrid, count: int, seed: int, progress: Callable[[int, int], None] | None = None
) -> tuple[int, float, np.ndarray | None]:
    """Ask a bounder fresh positives.

    Returns:
        How many were asked, the least f among them (as the device computes it), and the first query that was answered
        with *no* (``None`` if there is none; the count ends there).
    """
    done, least = 0, np.inf
    for x in draw_positives(bounder.query_kind, grid, count, seed, bounder.device, bounder.domain.length or 1.0):
        values = bounder.values(x).numpy()
        done, least = done + len(x), min(least, float(values.min(initial=np.inf)))
        missed = np.flatnonzero(values < bounder.threshold)
        if len(missed):
            return done, least, x[missed[np.argmin(values[missed])]]
        if progress:
            progress(min(done, count), count)
    return done, least, None


def attest(
    bounder: Bounder,
    grid: IndicatorGrid,
    *,
    least: float,
    room: float,
    count: int = POSITIVES,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Certificate:
    """Set a threshold below the least value that a search has found, and give the bounder a statistical certificate.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object.
        least: Least f that is known of any positive.
        room: How far below it the threshold is put, beyond what rounding needs.
        count: Fresh positives.
        seed: Of these.
        progress: Called with positives tried and in all.

    Raises:
        BounderError: If the threshold had to be lowered too often: the search before was not one.
    """
    started, error = time.perf_counter(), bounder.rounding_bound()
    for restart in range(MOST_RESTARTS):
        bounder.freeze(float(round_down(least - 2 * error - room)), None)
        done, lowest, missed = try_positives(bounder, grid, count, seed + restart * 7919, progress)
        if missed is None:
            break
        if not np.isfinite(lowest):
            raise BounderError(
                f"{bounder.method}: a {bounder.query_kind} that meets the object counts as outside the domain: {missed}"
            )
        least = min(least, lowest)
    else:
        raise BounderError(
            f"{bounder.method}: {MOST_RESTARTS} thresholds in a row missed a positive {bounder.query_kind}"
        )
    rate = fn_rate_bound(done)
    message = (
        f"Statistical, not proven: {done:,} fresh positives ({DISTRIBUTION}), none answered with no; at {CONFIDENCE:.0%} "
        f"confidence fewer than {rate:.2g} of such queries are missed. The threshold was set by an adversarial search, "
        f"{bounder.query_kind} queries have no proof yet."
    )
    certificate = document(
        bounder,
        grid,
        "statistical",
        float(bounder.threshold),
        least,
        0,
        time.perf_counter() - started,
        message,
        samples=done,
        fn_rate_bound=rate,
        confidence=CONFIDENCE,
        worst_margin=lowest - float(bounder.threshold),
        restarts=restart,
    )
    bounder.freeze(float(bounder.threshold), certificate)
    return certificate
