"""How much of a domain a proof that did not end has decided."""

from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.certificates.claim import as_fitted, in_local, mismatch
from warp_bounding.errors import BounderError
from warp_bounding.proof.search.best_first import halve
from warp_bounding.proof.search.vacancy import ShapePositives
from warp_bounding.runtime.launch import working_seconds

__all__ = ["Share", "proven_share"]

CHUNK = 16_384  # boxes that are bounded at a time
MOST_WAITING = 4_000_000  # boxes: where more wait, the rest of a generation counts as not proven


class Share(NamedTuple):
    """What was proven.

    Attributes:
        volume: Share of the volume that was looked at, 0 to 1, in which no *no* can be wrong.
        boxes: Boxes that were bounded.
        seconds: That it took.
    """

    volume: float
    boxes: int
    seconds: float


def proven_share(
    bounder: Bounder,
    shape,
    *,
    seconds: float = 60.0,
    boxes: float = float("inf"),
    places: int | None = None,
    side: float = 2.0**-6,
    seed: int = 0,
) -> Share:
    """In how much of its domain a bounder of points is proven to deny nothing of a shape, at the threshold that it has.

    For bounders whose certificate is statistical. The domain is halved, largest boxes first: a box is proven where f reaches the threshold on all of
    it, or on all of it that can be object, or where the shape certifies that nothing is there.

    Args:
        bounder: Of points, its parts proven one by one counted alike.
        shape: What it bounds; anything that ``load_indicator`` takes.
        seconds: Time after which what is left counts as not proven.
        boxes: The same of boxes; the result is then the same on every machine.
        places: Look at so many random boxes rather than at all of the domain, which in many dimensions is far more than there is time for.
        side: Of such a box, as a share of the domain's.
        seed: Of their places.

    Raises:
        BounderError: For another kind of bounder, or a shape that cannot be the bounded one.

    Example:
        >>> solid = wb.solids.Sphere([0, 0, 0], 1.0)
        >>> box = wb.fit(solid, method="aabb", device="cpu")
        >>> wb.proven_share(box, solid).volume
        1.0
    """
    bounder, shape = in_local(bounder, shape)
    shape = as_fitted(bounder, shape)
    if (
        bounder.domain is not bounder.domain.base
        or bounder.composed
        or len(bounder.parts) > 1
        or shape.resolution is not None
    ):
        raise BounderError(f"a share of the domain is told of single bounders of points of shapes, got {bounder!r}")
    if reason := mismatch(bounder, shape):
        raise BounderError(reason)
    started, positives = working_seconds(), ShapePositives(bounder, shape)
    target = float(np.nextafter(float(bounder.threshold) + bounder.rounding_bound(), np.inf))
    low, high = positives.boxes()
    if places is not None:
        low, high = _random(low, high, places, side, seed)
    whole = float((high - low).prod(axis=1).sum())
    left, done = [(low, high)], 0
    open_ = whole
    while left:
        following: list[tuple[np.ndarray, np.ndarray]] = []
        while left:
            low, high = left.pop(0)
            if working_seconds() - started > seconds or done >= boxes:
                return Share(1 - open_ / whole, done, working_seconds() - started)
            if len(low) > CHUNK:
                left[:0] = [(low[part], high[part]) for part in (slice(CHUNK), slice(CHUNK, None))]
                continue
            bounds, volume = positives.bound(low, high), (high - low).prod(axis=1)
            done += len(low)
            below = ~(bounds.lower >= target)
            asked = np.flatnonzero(below)
            found = positives.held(low[asked], high[asked], bounds.part(asked), np.full(len(asked), target))
            low, high = (np.asarray(corner) for corner in found.corners)
            still = ~(found.lower >= target)
            open_ -= float(volume.sum() - (high - low).prod(axis=1)[still].sum())
            if still.any() and sum(len(rest[0]) for rest in following) < MOST_WAITING:
                following.append(halve(low[still], high[still], found.axis[still]))
        left = following
    return Share(1 - open_ / whole, done, working_seconds() - started)


def _random(low: np.ndarray, high: np.ndarray, count: int, side: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random boxes in the hull of some boxes; raises ``BounderError`` for a count or a side that makes no sense."""
    if count < 1 or not 0 < side <= 1:
        raise BounderError(f"expected at least one place and a side above 0 and up to 1, got {count} and {side}")
    low, high = low.min(axis=0), high.max(axis=0)
    size = (high - low) * side
    corner = np.random.default_rng(seed).uniform(low, high - size, (count, len(low)))
    return corner, corner + size
