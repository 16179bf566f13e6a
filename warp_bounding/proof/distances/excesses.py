"""By how much does F exceed the distance? Boxes of the domain are halved until the shape's tangents tell (``Shape.excess``).

F is known in a box by numbers at its corners (``DistanceBounder.corners``), and the shape compares them with the tangents of the distances to all of its convex
pieces at once: two trees, one of space and one of the object. So slopes cancel, and a box may be as large as F and the distance are nearly linear in it. It
is its longest side that is halved: halved where F's own bound suffers most, boxes become needles along which the distance bends, that no halving
elsewhere mends (a bunny was proven to three times the excess it has, a moving ellipsoid with twice the boxes).
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.errors import BounderError
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.distances.bars import Bars, excesses_at
from warp_bounding.proof.distances.checkpoint import Boxes, Checkpoint, Left
from warp_bounding.proof.search.best_first import halve
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds

__all__ = ["excess_within", "excesses", "largest_excess", "worst_points"]

CHUNK = 1 << 16  # boxes that are asked at a time
PARTS = 10_000  # that progress is told in
NOISE = (
    1e-12  # relative: more than float64 rounds in the map of a box to object space, and in the values at its corners
)
SAMPLES = 200_000  # points at which the largest excess is looked for first
NEAR = (2.0**-10, 2.0**-3)  # local units: how near the border half of them are, a standard deviation between these
EPS = 2e-4  # local units: by how much the excess that is proven may be above the one that is found, if there is time
COARSEST, FINER = (
    0.05,
    16.0,
)  # local units: the same of the first search, and by how much a search may be finer than the last one
SAFE = 0.6  # of the time that is left: as much is planned for the next search
WORTH = 0.7  # a search that can be no finer than this share of the last one is not begun
GROUPS, LAST = (
    16,
    0.6,
)  # of many parts: how many groups the last search takes in turn, and how much finer it is than the one before
NEARLY = 0.05  # local units: a part counts with its points where F is no farther below the distance than this
HALVINGS = 14  # on each axis, at most


def excesses(
    bounder: DistanceBounder,
    shape: Shape,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    tolerance: Bars | np.ndarray | float,
    halvings: int,
    least: float = 0.0,
    seconds: float = float("inf"),
    most: float = float("inf"),
    held: Checkpoint | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[np.ndarray, int, bool]:
    """Certified: by how much F exceeds the distance in boxes, at most.

    Args:
        bounder: Its ``corners`` are asked.
        shape: The object.
        lower: ``(N, n)`` float64, local coordinates.
        upper: ``(N, n)`` float64.
        tolerance: Of each box, or of all, or bars that rise: an excess up to this is good enough, the box is not halved. Local units.
        halvings: How often a box is halved at most.
        least: Excesses under it are not told apart.
        seconds: Time; when it is over, boxes count with what is known of them.
        most: Boxes that are looked at; when there are more, it is as if time were over.
        held: Where to begin, and to write now and then what is left: everything, when time is over or an exception ends the search.
        progress: Called with how much of the boxes' volume is done, in parts of ``PARTS``.

    Returns:
        ``(N,)`` float64, local units, at least ``least``; how many boxes were looked at; and whether there was time for all.

    Raises:
        BounderError: If the shape has no distance.
    """
    started, domain = working_seconds(), bounder.domain
    bars = tolerance if isinstance(tolerance, Bars) else Bars.of_boxes(tolerance, len(lower))
    left = held.load() if held else None
    if left is None:
        each = [slice(i, i + CHUNK) for i in range(0, len(lower), CHUNK)]
        every = np.arange(len(lower))
        left = Left([Boxes(lower[i], upper[i], every[i], 0) for i in each][::-1], np.full(len(lower), least), 0, 0.0)
    waiting, found, boxes, before = left
    complete, all_volume, file = True, _volume(lower, upper), held
    undone = sum(_volume(each.lower, each.upper) for each in waiting)
    try:
        while waiting:
            now = working_seconds() - started
            over = now > seconds or boxes > most
            if held:
                held.save(Left(waiting, found, boxes, before + now), now=over)
                held = None if over else held  # what follows is no part of the search any more
            low, high, owner, level = waiting[-1]  # taken off when all that is left of it is on the list
            values = bounder.corners(low, high)
            sides = domain.to_object(low), domain.to_object(high)
            room = NOISE * (np.abs(sides).max(initial=0.0) + domain.unit)
            noise = NOISE * (1 + np.abs(values).max(axis=1)) * bounder.steepness
            under = least - 2 * float(
                noise.max(initial=0.0)
            )  # so that what is added does not lift it above a tolerance
            allowed = bars.of(owner)
            enough = np.where(level < halvings, allowed, np.inf) * domain.unit
            excess = shape.excess(sides[0] - room, sides[1] + room, values * domain.unit, under * domain.unit, enough)
            if excess is None:
                raise BounderError(f"{shape.name}: no distance is known of it")
            excess = excess / domain.unit + noise
            above = excess > allowed
            more = above & (level < halvings) & (not over)
            bars.rise(bounder, shape, low[more], high[more], owner[more], excess[more])
            complete &= not (over and above.any())
            np.maximum.at(found, owner[~more], excess[~more])
            children = []
            if more.any():
                longest = np.argmax(high[more] - low[more], axis=1)
                halves = (*halve(low[more], high[more], longest), np.tile(owner[more], 2))
                parts = (slice(i, i + CHUNK) for i in range(0, len(halves[0]), CHUNK))
                children = [Boxes(*(side[part] for side in halves), level + 1) for part in parts]
            waiting[-1:] = children
            boxes += len(low)
            undone -= _volume(low[~more], high[~more])
            if progress is not None:
                progress(round(PARTS * (1 - min(max(undone / all_volume, 0.0), 1.0))), PARTS)
    except BaseException:
        if held:
            held.save(Left(waiting, found, boxes, before + working_seconds() - started), now=True)
        raise
    if file and complete:
        file.remove()
    return found, boxes, complete


def _volume(lower: np.ndarray, upper: np.ndarray) -> float:
    return float((upper - lower).prod(axis=1).sum())


def worst_points(
    bounder: DistanceBounder, shape: Shape, met: np.ndarray, eps: float, *, boxes: float, seconds: float
) -> np.ndarray:
    """Where F exceeds the distance by more than was met in some part, as a proof's search finds: what random points do not find.

    Args:
        bounder: Its F.
        shape: The object.
        met: ``(parts,)``, local units; raised in place, to about the greatest excesses there are, less ``eps``.
        eps: Local units: by how much an excess may be more than what was met before the search looks closer.
        boxes: How many boxes at most.
        seconds: Time.

    Returns:
        ``(K, n)`` float64, local coordinates.
    """
    lower, upper = _between(*bounder.pieces(), _knots(bounder, shape))
    bars = Bars(met, eps, bounder.part_of(lower / 2 + upper / 2))
    told = {"halvings": HALVINGS * bounder.ndim, "least": float(met.min()) + eps, "seconds": seconds, "most": boxes}
    excesses(bounder, shape, lower, upper, tolerance=bars, **told)
    return np.concatenate([*bars.raised, np.empty((0, bounder.ndim))])


def largest_excess(bounder: DistanceBounder, shape: Shape, seconds: float) -> tuple[np.ndarray, int, bool, np.ndarray]:
    """Certified: by how much F exceeds the distance in each part of the domain, at most: little more than samples have.

    Args:
        bounder: Its F.
        shape: The object.
        seconds: Time; when it is over the bound is what is known by then.

    Returns:
        The excesses ``(parts,)``, local units; how many boxes were looked at; whether there was time; and points in object space where samples
        have the largest excesses.
    """
    v, sampled, worst = _sampled(bounder, shape)
    parts, met = bounder.part_of(v), np.zeros(bounder.part_count)
    np.maximum.at(met, parts, sampled)
    weight = np.bincount(parts[: SAMPLES // 2][sampled[: SAMPLES // 2] > -NEARLY], minlength=bounder.part_count)
    return (*_refined(bounder, shape, met, weight, seconds), worst)


def excess_within(
    bounder: DistanceBounder,
    shape: Shape,
    bar: float,
    seconds: float,
    held: Checkpoint | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[float, int, bool, np.ndarray]:
    """Certified: by how much F exceeds the distance, at most; by other boxes than ``largest_excess`` has.

    Args:
        bounder: Its F.
        shape: The object.
        bar: An excess up to this is good enough, local units.
        seconds: Time.
        held: As ``excesses`` takes it.
        progress: As ``excesses`` takes it.

    Returns:
        As ``largest_excess``, of all parts together. Where samples have more than the bar, nothing is searched.
    """
    _, sampled, worst = _sampled(bounder, shape)
    if sampled.max() > bar:
        return float(sampled.max()), 0, True, worst
    bars = np.full(bounder.part_count, bar)
    excess, boxes, complete = _searched(bounder, shape, bars, 0.0, seconds, again=True, held=held, progress=progress)
    return float(excess.max()), boxes, complete, worst


def _sampled(bounder: DistanceBounder, shape: Shape) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the domain, half of them uniform, in local coordinates; by how much F exceeds the distance there; and those in object space where that is most."""
    limit, rng = bounder.domain.limit.astype(np.float64), np.random.default_rng(0)
    near = _near(bounder, shape, SAMPLES // 2, rng)
    v = np.concatenate([rng.uniform(-limit, limit, (SAMPLES // 2, bounder.ndim)), near])
    x = bounder.domain.sample_at(v)
    sampled = excesses_at(bounder, shape, v)
    if sampled is None:
        raise BounderError(f"{shape.name}: no distance is known of it")
    return v, sampled, x[np.argsort(-sampled)[:1024]]


def _refined(
    bounder: DistanceBounder, shape: Shape, met: np.ndarray, weight: np.ndarray, seconds: float
) -> tuple[np.ndarray, int, bool]:
    """The least excesses of the parts that searches prove in some time; ``met`` is what samples have, ``weight`` what a part counts.

    What a search leaves undone counts with its largest box, so the next one is only begun where it is likely to end. Boxes are in number as
    ``eps^(-n/2)``, with eps what is proven above ``met``, since a linear function's error goes with the square of a side. Of many parts the last search
    takes one group after another, those first that count most, and what it leaves undone stays as it was.
    """
    end, eps, boxes = working_seconds() + seconds, COARSEST, 0
    best, complete = np.full(len(met), np.inf), True
    while True:
        started = working_seconds()
        excess, looked, complete = _searched(bounder, shape, met, eps, end - started)
        boxes, best = boxes + looked, np.minimum(best, excess)
        now = working_seconds()
        if not complete or eps <= EPS:
            return best, boxes, complete
        planned = eps * ((now - started) / max(SAFE * (end - now), 1e-9)) ** (2 / bounder.ndim)
        finer = max(EPS, planned, eps / FINER)
        if finer > WORTH * eps:
            break
        eps = finer
    if len(met) > 1:
        order = np.argsort(-weight, kind="stable")
        for group in np.array_split(order, min(GROUPS, len(order))):
            left = end - working_seconds()
            if left <= 0:
                break
            chosen = np.isin(np.arange(len(met)), group)
            excess, looked, _ = _searched(bounder, shape, met, LAST * eps, left, chosen)
            boxes, best[chosen] = boxes + looked, np.minimum(best, excess)[chosen]
    return best, boxes, False


def _searched(
    bounder: DistanceBounder,
    shape: Shape,
    met: np.ndarray,
    eps: float,
    seconds: float,
    chosen: np.ndarray | None = None,
    *,
    again: bool = False,
    **told,
) -> tuple[np.ndarray, int, bool]:
    """The largest excesses ``(parts,)``, one up to ``eps`` above the part's ``met`` as this; how many boxes were looked at, and whether there was time.

    ``chosen`` are the parts that are asked for, all for ``None``. ``again``, to certify what another search has found: by other boxes, which begin with
    thirds; its bars do not rise. The rest is for ``excesses``.
    """
    least = float(met.min()) + eps
    told |= {"halvings": HALVINGS * bounder.ndim, "least": least, "seconds": seconds}
    lower, upper = _between(*bounder.pieces(), _knots(bounder, shape))
    if again:
        lower, upper = _thirds(lower, upper)
    parts = bounder.part_of(lower / 2 + upper / 2)
    if chosen is not None:
        kept = chosen[parts]
        lower, upper, parts = lower[kept], upper[kept], parts[kept]
    bars = Bars(met, eps, parts, fixed=again)
    found, boxes, complete = excesses(bounder, shape, lower, upper, tolerance=bars, **told)
    by_part = np.full(len(met), least)
    np.maximum.at(by_part, parts, found)
    return by_part, boxes, complete


def _thirds(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes that cover some, three along each axis for one, as long as there are few of these."""
    if len(lower) * 3 ** lower.shape[1] > CHUNK:
        return lower, upper  # cells of a grid of distances, in which the values are known
    for axis in range(lower.shape[1]):
        cuts = [lower[:, axis] + share * (upper - lower)[:, axis] for share in (1 / 3, 2 / 3)]
        ends = [lower[:, axis], *cuts, upper[:, axis]]
        parts = [(lower.copy(), upper.copy()) for _ in range(3)]
        for number, (low, high) in enumerate(parts):
            low[:, axis], high[:, axis] = ends[number], ends[number + 1]
        lower, upper = (np.concatenate(sides) for sides in zip(*parts, strict=True))
    return lower, upper


def _knots(bounder: DistanceBounder, shape: Shape) -> np.ndarray:
    """Local coordinates of the times at which a motion bends."""
    return (shape.knots - float(bounder.domain.center[0])) * float(bounder.domain.scale[0])


def _between(lower: np.ndarray, upper: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes, cut along axis 0 at the knots."""
    for knot in knots:
        cut = (lower[:, 0] < knot) & (knot < upper[:, 0])
        left, right = upper[cut].copy(), lower[cut].copy()
        left[:, 0] = right[:, 0] = knot
        lower, upper = (
            np.concatenate([lower[~cut], lower[cut], right]),
            np.concatenate([upper[~cut], left, upper[cut]]),
        )
    return lower, upper


def _near(bounder: DistanceBounder, shape: Shape, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, n)`` local coordinates of points of the domain near the object's border, and near what the shape names."""
    x, marks = border_points(shape, count, rng), shape.landmarks()
    if len(marks):
        x[::2] = marks[rng.integers(len(marks), size=len(x[::2]))]
    v = bounder.domain.to_local(x)
    v += np.exp2(rng.uniform(*np.log2(NEAR), (count, 1))) * rng.standard_normal(v.shape)
    limit = bounder.domain.limit.astype(np.float64)
    return np.clip(v, -limit, limit)
