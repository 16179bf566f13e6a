"""Attestation, where there is no proof: with the threshold frozen, fresh positives are asked, and none may be missed.

With N independent positives of a stated distribution and no failure, the rate of false negatives *under that
distribution* is below ``1 - alpha^(1/N)`` with confidence ``1 - alpha`` (Clopper and Pearson 1934), about 3/N at 95 %.
(Half of the positives come from each of two proposals, which only strengthens this: no failure is then rarer still, by
the inequality of the means.) The rule that ends the count, a number or a time, must not depend on the answers.

The search that set the threshold earns no confidence. A failure lowers the threshold below the f that failed, and the
count begins anew. With enough attempts any bounder passes in the end; therefore attempt i (from 0) spends ``alpha /
2^(i+1)``, and all of them together spend no more than alpha. The certificate's bound is that of the attempt that
passed, and its confidence is that of the whole procedure. Whoever made the bounder must not know the positives: to
check one, take a ``fresh_seed``.
"""

import secrets
from collections.abc import Callable, Sequence

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.certificates.certificate import Certificate, fn_rate_bound
from warp_bounding.certificates.claim import mismatch
from warp_bounding.certificates.document import document
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.search.best_first import Search
from warp_bounding.queries import QUERIES
from warp_bounding.queries.hard import draw_positives
from warp_bounding.runtime.launch import working_seconds

__all__ = ["CONFIDENCE", "attempt_confidence", "attest", "fn_rate_bound", "fresh_seed", "try_positives"]

CONFIDENCE = 0.95  # 1 - alpha
POSITIVES = 1_000_000  # fresh positives that are asked
MOST_RESTARTS = 20  # attempts, each after the first with a lower threshold


def attempt_confidence(attempt: int, confidence: float = CONFIDENCE) -> float:
    """The confidence of attempt number ``attempt`` (from 0) with which all attempts together reach ``confidence``."""
    return 1.0 - (1.0 - confidence) * 0.5 ** (attempt + 1)


def fresh_seed() -> int:
    """A seed from the operating system's entropy, for positives that nobody could have fitted a bounder to."""
    return secrets.randbits(63)


def try_positives(
    bounder: Bounder,
    grid: IndicatorGrid,
    count: int,
    seed: int | Sequence[int],
    progress: Callable[[int, int], None] | None = None,
    seconds: float = float("inf"),
) -> tuple[int, float, np.ndarray | None]:
    """Ask a bounder fresh positives.

    Args:
        bounder: Any bounder, with its threshold.
        grid: The object.
        count: How many positives to ask, at least.
        seed: Seed of the samples.
        progress: Called after each chunk with positives asked and positives in all.
        seconds: Time allowed: no chunk is begun that would end later if it took as long as the longest one before.
            Fewer positives are then asked, possibly none.

    Returns:
        How many were asked, the least f among them (as the device computes it), and the first query that was answered
        with *no* (``None`` if there is none; the count ends there).
    """
    started, done, least, longest = working_seconds(), 0, np.inf, 0.0
    length = bounder.domain.oracle_length
    chunks = draw_positives(bounder.query_kind, grid, count, seed, bounder.device, length)
    while done < count and (begun := working_seconds()) - started + longest < seconds:
        x = next(chunks)
        values = bounder.values(x).numpy()
        done, least = done + len(x), min(least, float(values.min(initial=np.inf)))
        missed = np.flatnonzero(values < bounder.threshold)
        if len(missed):
            return done, least, x[missed[np.argmin(values[missed])]]
        longest = max(longest, working_seconds() - begun)
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
    seconds: float = float("inf"),
    search: Search | None = None,
) -> Certificate:
    """Set a threshold below the least value that a search has found, and give the bounder a statistical certificate.

    Attempt i, after i thresholds that missed a positive, is judged at confidence ``attempt_confidence(i)``: the
    certificate's ``fn_rate_bound`` is the wider for it, and its ``confidence`` holds for the whole procedure.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object.
        least: Least f that is known of any positive.
        room: How far below it the threshold is set, beyond what rounding needs.
        count: How many fresh positives to ask.
        seed: Seed of these positives; every attempt draws others.
        progress: Called with positives asked and positives in all.
        search: A proof that did not come close enough in its time; the certificate tells what it did show.
        seconds: Time allowed for each attempt; see ``try_positives``. The bound counts the positives that were asked.

    Raises:
        BounderError: If the bounder was made for another object; or if the threshold had to be lowered too often, as
            where the search found no low f at all.
    """
    if reason := mismatch(bounder, grid):
        raise BounderError(f"{bounder.method}: {reason}")
    started, error = working_seconds(), bounder.rounding_bound()
    for restart in range(MOST_RESTARTS):
        bounder.freeze(float(round_down(least - 2 * error - room)), None)
        done, lowest, missed = try_positives(bounder, grid, count, (seed, restart), progress, seconds)
        if missed is None:
            break
        if not np.isfinite(lowest):
            outside = f"a {bounder.query_kind} that meets the object counts as outside the domain: {missed}"
            raise BounderError(f"{bounder.method}: {outside}")
        least = min(least, lowest)
    else:
        missed = f"{MOST_RESTARTS} thresholds in a row missed a positive {bounder.query_kind}"
        raise BounderError(f"{bounder.method}: {missed}")
    judged = attempt_confidence(restart)
    rate = fn_rate_bound(done, judged)
    before = f" after {restart} that missed one" if restart else ""
    message = (
        f"Statistical, not proven: {done:,} fresh positives ({QUERIES[bounder.query_kind].distribution}), "
        f"none answered with no; at {CONFIDENCE:.0%} confidence fewer than {rate:.2g} of such queries are missed "
        f"(attempt {restart + 1}{before}, judged at {judged:.6%}, so that all attempts together keep to {CONFIDENCE:.0%})."
    )
    numbers = "The threshold was set by an adversarial search. "
    if search is None:
        numbers += "No proof was tried."
    else:
        numbers += (
            f"A proof did not end in {search.seconds:.3g} s: it shows f >= {search.lower_bound:.6g} on all positives, "
            f"{least - search.lower_bound:.3g} below the least one known."
        )
    threshold, spent = float(bounder.threshold), working_seconds() - started
    # No f was computed where every positive was answered without one, or none was asked.
    margin = lowest - threshold if np.isfinite(lowest) else None
    counts = {"samples": done, "fn_rate_bound": rate, "confidence": CONFIDENCE, "worst_margin": margin}
    certificate = document(
        bounder, grid, "statistical", threshold, least, 0, spent, message, numbers=numbers, restarts=restart, **counts
    )
    bounder.freeze(threshold, certificate)
    return certificate
