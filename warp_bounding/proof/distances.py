"""The proof of a distance, by how much F exceeds it: ``threshold <= L - E``, ``d - F >= L`` on the whole domain.

Where F is the distance to a volume that a proven bounder of points has, L is 0: the volume holds the object. Else boxes
of the domain are halved until the shape's tangents tell (``Shape.overestimate``). F is known in a box by numbers at its
corners (``DistanceBounder.corners``), and the shape compares them with the tangents of the distances to all of its
convex pieces at once: two trees, one of space and one of the object. So slopes cancel, and a box may be as large as F
and the distance are nearly linear in it. It is its longest side that is halved: halved where F's own bound suffers
most, boxes become needles along which the distance bends, that no halving elsewhere mends (a bunny was proven to three
times the overestimate it has, a moving ellipsoid with twice the boxes).
"""

import numpy as np

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.errors import BounderError
from warp_bounding.proof.halving import Boxes, Seen, search
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.shape import Shape

# --- tolerances ------------------------------------------------------------------------------------------------------


# boxes of a chunk in whose middles F is queried, at most: those whose bounds are farthest above their tolerances
ASKED = 1024


def overestimates_at(bounder: DistanceBounder, shape: Shape, v: np.ndarray) -> np.ndarray | None:
    """F less the distance at points ``(N, n)``, local coordinates and units; ``None`` where no distance is known."""
    known = shape.distances(bounder.domain.sample_at(v))
    return None if known is None else bounder.reference(v) - known[:, 0] / bounder.domain.unit


class Tolerances:
    """The overestimate up to which a box is good enough: a little above the greatest ever met.

    Samples miss the greatest overestimate, and a search that asks for less than there is halves boxes around it for
    nothing. So where a search gets stuck, F and the distance themselves are queried in the middles of its boxes, and
    the tolerance rises.

    Args:
        met: The greatest overestimate that was met, local units; or what is good enough, of each of a search's first
            boxes.
        above: By how much the tolerance is above that.
        rising: Whether it may be raised; then ``met`` is one number.

    Attributes:
        raised: Where F exceeds the distance by more than what had been met, ``(K, n)`` arrays, local coordinates.
    """

    def __init__(self, met: np.ndarray | float, above: float = 0.0, *, rising: bool = False):
        self.met, self.above, self.rising = met, above, rising
        self.raised: list[np.ndarray] = []

    def of(self, owner: np.ndarray) -> np.ndarray | float:
        """The tolerances of boxes that came from the first boxes of these numbers: ``(K,)``, or one of all."""
        return (self.met if np.ndim(self.met) == 0 else self.met[owner]) + self.above

    def rise(
        self, bounder: DistanceBounder, shape: Shape, low: np.ndarray, high: np.ndarray, overestimate: np.ndarray
    ) -> None:
        """Evaluate F where bounds ``overestimate`` are the largest, and raise the tolerance if F exceeds it."""
        if not self.rising or not len(low):
            return
        over = overestimate - (self.met + self.above)
        queried = np.argpartition(-over, ASKED)[:ASKED] if len(over) > ASKED else np.arange(len(over))
        v = low[queried] / 2 + high[queried] / 2
        met = overestimates_at(bounder, shape, v)
        if met is not None:
            self.raised.append(v[met > self.met])
            self.met = max(self.met, float(met.max()))


# --- search ----------------------------------------------------------------------------------------------------------


BOX_BATCH = 1 << 16  # boxes that are queried at a time
# relative: more than float64 rounds in the map of a box to object space, and in the values at its corners
NOISE = 1e-12
SAMPLES = 200_000  # points at which the largest overestimate is looked for first
NEAR = (2.0**-10, 2.0**-3)  # local units: how near the border half of them are, a standard deviation between these
# local units: by how much the overestimate that is proven may be above the one that is found, if there is time
EPS = 2e-4
COARSEST = 0.05  # local units: the same of the first search
FINER = 16.0  # by how much a search may be finer than the last one
SAFE = 0.6  # of the time that is left: as much is planned for the next search
WORTH = 0.7  # a search that can be no finer than this share of the last one is not begun
HALVINGS = 14  # on each axis, at most


def overestimates_in(
    bounder: DistanceBounder,
    shape: Shape,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    tolerance: Tolerances | np.ndarray | float,
    halvings: int,
    least: float = 0.0,
    budget: float = float("inf"),
    most: float = float("inf"),
    **options,
) -> tuple[np.ndarray, int, bool]:
    """Certified: by how much F exceeds the distance in boxes, at most.

    Args:
        bounder: Its ``corners`` are queried.
        shape: The object.
        lower: ``(N, n)`` float64, local coordinates.
        upper: ``(N, n)`` float64.
        tolerance: Of each box, or of all, or tolerances that rise: an overestimate up to this is good enough, the box
            is not halved. Local units.
        halvings: How often a box is halved at most.
        least: Overestimates under it are not distinguished.
        budget: Seconds; when it is over, boxes count with what is known of them.
        most: Boxes that are looked at; when there are more, it is as if time were over.
        **options: For ``halving.search``.

    Returns:
        ``(N,)`` float64, local units, at least ``least``; how many boxes were looked at; and whether there was time for
        all.

    Raises:
        BounderError: If the shape has no distance.
    """
    tolerances = tolerance if isinstance(tolerance, Tolerances) else Tolerances(tolerance)
    look = _Overestimates(bounder, shape, tolerances, halvings, least)
    state = search(look, [(lower, upper, 1.0)], np.full(len(lower), least), budget=budget, most=most, **options)
    overestimates, boxes, complete = state.maxima, state.boxes, True
    for each in state.waiting:  # there is no time: they count with what is known of them
        for start in range(0, each.count, look.chunk):
            some = each.part(slice(start, start + look.chunk))
            overestimate, above = look.measured(some)
            np.maximum.at(overestimates, some.owner, overestimate)
            boxes, complete = boxes + some.count, complete and not above.any()
    return overestimates, boxes, complete


class _Overestimates:
    """Looks at boxes: by how much F exceeds the distance there; arguments as in ``overestimates_in``."""

    chunk = BOX_BATCH

    def __init__(self, bounder: DistanceBounder, shape: Shape, tolerances: Tolerances, halvings: int, least: float):
        self.bounder, self.shape, self.tolerances = bounder, shape, tolerances
        self.halvings, self.least = halvings, least

    def measured(self, boxes: Boxes) -> tuple[np.ndarray, np.ndarray]:
        """``(N,)`` certified overestimates, and whether they are above the tolerances."""
        bounder, shape, domain = self.bounder, self.shape, self.bounder.domain
        values = bounder.corners(boxes.lower, boxes.upper)
        low, high = domain.to_object(boxes.lower), domain.to_object(boxes.upper)
        rounding = NOISE * (max(np.abs(low).max(initial=0.0), np.abs(high).max(initial=0.0)) + domain.unit)
        noise = NOISE * (1 + np.abs(values).max(axis=1)) * bounder.steepness
        under = self.least - 2 * float(noise.max(initial=0.0))  # what is added does not lift it above a tolerance
        allowed = self.tolerances.of(boxes.owner)
        enough = np.where(boxes.level < self.halvings, allowed, np.inf) * domain.unit
        low, high = low - rounding, high + rounding
        overestimate = shape.overestimate(low, high, values * domain.unit, under * domain.unit, enough)
        if overestimate is None:
            raise BounderError(f"{shape.name}: no distance is known of it")
        overestimate = overestimate / domain.unit + noise
        return overestimate, overestimate > allowed

    def __call__(self, boxes: Boxes) -> Seen:
        overestimate, above = self.measured(boxes)
        more = above & (boxes.level < self.halvings)
        open_ = boxes.part(more)
        self.tolerances.rise(self.bounder, self.shape, open_.lower, open_.upper, overestimate[more])
        longest = np.argmax(open_.upper - open_.lower, axis=1)
        return Seen(open_.halves(longest), boxes.owner[~more], overestimate[~more])


def worst_points(
    bounder: DistanceBounder, shape: Shape, met: float, eps: float, *, boxes: float, budget: float
) -> np.ndarray:
    """Where F exceeds the distance by more than any sample: what a proof's search finds and points miss.

    Args:
        bounder: Its F.
        shape: The object.
        met: The greatest overestimate of samples, local units.
        eps: Local units: by how much an overestimate may be more than what was met before the search looks closer.
        boxes: How many boxes at most.
        budget: Seconds.

    Returns:
        ``(K, n)`` float64, local coordinates.
    """
    lower, upper = _between(*bounder.pieces(), _knots(bounder, shape))
    tolerances = Tolerances(met, eps, rising=True)
    options = {"halvings": HALVINGS * bounder.ndim, "least": met + eps, "budget": budget, "most": boxes}
    overestimates_in(bounder, shape, lower, upper, tolerance=tolerances, **options)
    return np.concatenate([*tolerances.raised, np.empty((0, bounder.ndim))])


def largest_overestimate(bounder: DistanceBounder, shape: Shape, budget: float) -> tuple[float, int, bool, np.ndarray]:
    """Certified: by how much F exceeds the distance, at most: little more than samples have.

    What a search leaves undone counts with its largest box, so the next one is only begun where it is likely to end.
    Boxes are in number as ``eps^(-n/2)``, with eps what is proven above what samples have, since a linear function's
    error goes with the square of a side.

    Args:
        bounder: Its F.
        shape: The object.
        budget: Seconds; when it is over the bound is what is known by then.

    Returns:
        The overestimate, local units; how many boxes were looked at; whether there was time; and points in object space
        where samples have the largest overestimates.
    """
    sampled, worst = _sampled(bounder, shape)
    met, best, boxes = max(float(sampled.max()), 0.0), np.inf, 0
    end, eps = working_seconds() + budget, COARSEST
    while True:
        started = working_seconds()
        tolerance = Tolerances(met, eps, rising=True)
        overestimate, looked, complete = _searched(bounder, shape, tolerance, end - started)
        boxes, best, met = boxes + looked, min(best, overestimate), tolerance.met
        now = working_seconds()
        if not complete or eps <= EPS:
            return best, boxes, complete, worst
        planned = eps * ((now - started) / max(SAFE * (end - now), 1e-9)) ** (2 / bounder.ndim)
        finer = max(EPS, planned, eps / FINER)
        if finer > WORTH * eps:
            return best, boxes, False, worst
        eps = finer


def overestimate_within(
    bounder: DistanceBounder,
    shape: Shape,
    enough: float,
    budget: float,
    **options,
) -> tuple[float, int, bool, np.ndarray]:
    """Certified: by how much F exceeds the distance, at most; by other boxes than ``largest_overestimate`` has.

    Args:
        bounder: Its F.
        shape: The object.
        enough: An overestimate up to this is good enough, local units.
        budget: Seconds.
        **options: For ``halving.search``.

    Returns:
        As ``largest_overestimate``. Where samples have more than that, nothing is searched.
    """
    sampled, worst = _sampled(bounder, shape)
    if sampled.max() > enough:
        return float(sampled.max()), 0, True, worst
    return (*_searched(bounder, shape, Tolerances(enough), budget, again=True, **options), worst)


def _sampled(bounder: DistanceBounder, shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """F less the distance at points of the domain, half of them uniform; in object space those where it is most."""
    limit, rng = bounder.domain.limit.astype(np.float64), np.random.default_rng(0)
    near = _near(bounder, shape, SAMPLES // 2, rng)
    v = np.concatenate([rng.uniform(-limit, limit, (SAMPLES // 2, bounder.ndim)), near])
    x = bounder.domain.sample_at(v)
    sampled = overestimates_at(bounder, shape, v)
    if sampled is None:
        raise BounderError(f"{shape.name}: no distance is known of it")
    return sampled, x[np.argsort(-sampled)[:1024]]


def _searched(
    bounder: DistanceBounder, shape: Shape, tolerance: Tolerances, budget: float, *, again: bool = False, **options
) -> tuple[float, int, bool]:
    """The largest overestimate, where one up to the tolerance counts as that; how many boxes; whether there was time.

    ``again``, to certify what another search has found: by other boxes, which begin with thirds. The rest is for
    ``overestimates_in``.
    """
    least = tolerance.met + tolerance.above
    options |= {"halvings": HALVINGS * bounder.ndim, "least": least, "budget": budget}
    lower, upper = _between(*bounder.pieces(), _knots(bounder, shape))
    if again:
        lower, upper = _thirds(lower, upper)
    overestimates, boxes, complete = overestimates_in(bounder, shape, lower, upper, tolerance=tolerance, **options)
    return max(least, float(overestimates.max())), boxes, complete


def _thirds(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes that cover some, three along each axis for one, as long as there are few of these."""
    if len(lower) * 3 ** lower.shape[1] > BOX_BATCH:
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
    """``(count, n)`` local points of the domain near the object's border, and near what the shape names."""
    x, marks = border_points(shape, count, rng), shape.landmarks()
    if len(marks):
        x[::2] = marks[rng.integers(len(marks), size=len(x[::2]))]
    v = bounder.domain.to_local(x)
    v += np.exp2(rng.uniform(*np.log2(NEAR), (count, 1))) * rng.standard_normal(v.shape)
    limit = bounder.domain.limit.astype(np.float64)
    return np.clip(v, -limit, limit)
