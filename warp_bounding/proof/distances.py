"""The proof of a distance, by how much F exceeds it: ``threshold <= L - E``, ``d - F >= L`` on the whole domain.

Where F is the distance to a volume that a proven bounder of points has, L is 0: the volume holds the object. Else boxes
of the domain are halved until the shape's tangents tell (``Shape.overestimate``). F is known in a box by numbers at its
corners (``DistanceBounder.corners``), and the shape compares them with the tangents of the distances to all of its
convex pieces at once: two trees, one of space and one of the object. So slopes cancel, and a box may be as large as F
and the distance are nearly linear in it. It is its longest side that is halved: halved where F's own bound suffers
most, boxes become needles along which the distance bends, that no halving elsewhere mends (a bunny was proven to three
times the overestimate it has, a moving ellipsoid with twice the boxes).
"""

import hashlib
import json
import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.proof.search import halve
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.runtime.whole_file import check_writable, file_path, write_whole
from warp_bounding.shapes.shape import Shape
from warp_bounding.version import __version__

# --- tolerances ------------------------------------------------------------------------------------------------------


# boxes of a chunk in whose middles F is queried, at most: those whose bounds are farthest above their tolerances
ASKED = 1024


def excesses_at(bounder: DistanceBounder, shape: Shape, v: np.ndarray) -> np.ndarray | None:
    """F less the distance at points ``(N, n)``, local coordinates and units; ``None`` where no distance is known."""
    known = shape.distances(bounder.domain.sample_at(v))
    return None if known is None else bounder.reference(v) - known[:, 0] / bounder.domain.unit


class Tolerances:
    """The overestimate up to which a box is good enough, by part of the domain.

    A little above the greatest ever met there.

    Samples miss the greatest overestimate of a part, and a search that asks for less than there is halves boxes around
    it for nothing. So where a search gets stuck, F and the distance themselves are queried in the middles of its boxes,
    and the part's tolerance rises.

    Args:
        met: ``(parts,)``, the greatest overestimate that was met in each part, local units; raised in place.
        above: By how much a bar is above that.
        parts: ``(N,)`` int, the parts in which a search's first boxes lie.
        fixed: Never raise them.

    Attributes:
        raised: Where F exceeds the distance by more than what had been met in the part, ``(K, n)`` arrays, local
            coordinates.
    """

    def __init__(self, met: np.ndarray, above: float, parts: np.ndarray, *, fixed: bool = False):
        self.met, self.above, self.parts, self.fixed = met, above, parts, fixed
        self.raised: list[np.ndarray] = []

    @classmethod
    def of_boxes(cls, tolerance: np.ndarray | float, count: int) -> "Tolerances":
        """Bars that do not rise, one for each of ``count`` first boxes, or one for all."""
        return cls(np.broadcast_to(tolerance, count), 0.0, np.arange(count), fixed=True)

    def of(self, owner: np.ndarray) -> np.ndarray:
        """``(K,)``, the tolerances of boxes that came from the first boxes of these numbers."""
        return self.met[self.parts[owner]] + self.above

    def rise(
        self,
        bounder: DistanceBounder,
        shape: Shape,
        low: np.ndarray,
        high: np.ndarray,
        owner: np.ndarray,
        overestimate: np.ndarray,
    ) -> None:
        """Evaluate F where bounds ``overestimate`` exceed their tolerances the most, and raise those that F exceeds."""
        if self.fixed or not len(low):
            return
        over = overestimate - self.of(owner)
        queried = np.argpartition(-over, ASKED)[:ASKED] if len(over) > ASKED else np.arange(len(over))
        v, parts = low[queried] / 2 + high[queried] / 2, self.parts[owner[queried]]
        met = excesses_at(bounder, shape, v)
        if met is not None:
            self.raised.append(v[met > self.met[parts]])
            np.maximum.at(self.met, parts, met)


# --- checkpoint ------------------------------------------------------------------------------------------------------


KEY = "warp_bounding_checkpoint"
EVERY = 15.0  # seconds between two writes
TELLING = (
    1024  # points whose distances tell one function from another, of which a digest knows little more than the object
)


class Boxes(NamedTuple):
    """Waiting boxes: ``(N, n)`` lower and upper corners, ``(N,)`` numbers of the boxes that they are parts of.

    And how often all of them were halved.
    """

    lower: np.ndarray
    upper: np.ndarray
    owner: np.ndarray
    level: int


class Left(NamedTuple):
    """What a search has found, and what it has still to do.

    Attributes:
        waiting: The last one is next.
        found: ``(N,)``, what is known of each box that the search began with.
        boxes: How many boxes were looked at.
        seconds: How long that took.
    """

    waiting: list[Boxes]
    found: np.ndarray
    boxes: int
    seconds: float


class Checkpoint:
    """What a search has still to do, in a file: read at the beginning, written now and then, removed at the end.

    Such a file is believed as far as its claim goes: it is part of the machine that proves, not of what is to be
    proven. It names the bounder's numbers, the shape with its margin, some of its distances and the library's version,
    and holds a SHA-256 of its content; a file that says anything else is refused, and kept as it is.
    """

    def __init__(self, path: str | os.PathLike, bounder: DistanceBounder, shape: Shape):
        """Look at the file, if there is one.

        Raises:
            FileFormatError: If it is no checkpoint, one of another proof, or damaged, or if none can be written there.
        """
        self.path, self._written = file_path(path), working_seconds()
        about = {"method": bounder.method, "sizes": bounder.sizes, "domain": bounder.domain.to_dict()}
        about |= {"threshold": float(bounder.threshold), "shape": shape.digest, "library": __version__}
        low, high = shape.lower, shape.upper  # what the search rests on, as this machine computes it
        queried = low + np.random.default_rng(0).uniform(-0.5, 1.5, (TELLING, shape.ndim)) * (high - low)
        about["distances"] = hashlib.sha256(np.asarray(shape.distances(queried)).tobytes()).hexdigest()
        self._claim = digest_of(bounder.tensors, about)
        self._ndim = shape.ndim
        check_writable(self.path)
        self._left = self._read() if self.path.exists() else None

    def load(self, count: int) -> Left | None:
        """What was left of ``count`` boxes; ``None`` for a proof that begins.

        Raises:
            FileFormatError: If it is about another number of boxes.
        """
        if self._left is not None and len(self._left.found) != count:
            raise FileFormatError(f"{self.path}: the checkpoint is damaged; remove it to begin anew")
        return self._left

    @property
    def seconds(self) -> float:
        """How long the proof has taken until it was stopped."""
        return self._left.seconds if self._left else 0.0

    def save(self, left: Left, *, now: bool = False) -> None:
        """Write what is left, unless that was done a moment ago, or at once.

        Raises:
            FileFormatError: If it cannot be written.
        """
        if not now and working_seconds() - self._written < EVERY:
            return
        tensors = {"found": left.found} | {
            f"{name}.{i}": np.ascontiguousarray(getattr(boxes, name))
            for i, boxes in enumerate(left.waiting)
            for name in ("lower", "upper", "owner")
        }
        document = {"claim": self._claim, "boxes": left.boxes, "seconds": left.seconds}
        document["levels"] = [boxes.level for boxes in left.waiting]
        text = json.dumps({"sha256": digest_of(tensors, document), "left": document})
        write_whole(self.path, safetensors.numpy.save(tensors, metadata={KEY: text}))
        self._written = working_seconds()

    def remove(self) -> None:
        """The proof has ended."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> Left:
        try:
            with safetensors.safe_open(str(self.path), framework="numpy") as file:
                text = (file.metadata() or {})[KEY]
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            signed = json.loads(text)
            document, sha = signed["left"], signed["sha256"]
        except (safetensors.SafetensorError, OSError, ValueError, TypeError, KeyError) as error:
            raise FileFormatError(
                f"{self.path}: expected the checkpoint of a proof, or no file yet; it is kept"
            ) from error
        damaged = FileFormatError(f"{self.path}: the checkpoint is damaged; remove it to begin anew")
        if sha != digest_of(tensors, document) or not isinstance(document, dict):
            raise damaged
        if document.get("claim") != self._claim:
            raise FileFormatError(f"{self.path}: the checkpoint of another bounder, shape or version; it is kept")
        try:
            waiting = [
                Boxes(*(tensors[f"{name}.{i}"] for name in ("lower", "upper", "owner")), level)
                for i, level in enumerate(document["levels"])
            ]
            left = Left(waiting, tensors["found"].copy(), document["boxes"], document["seconds"])
            if not self._sound(left):
                raise damaged
        except (KeyError, TypeError, ValueError) as error:
            raise damaged from error
        return left

    def _sound(self, left: Left) -> bool:
        """Whether these are numbers of the kinds and sizes that a search has."""
        counts = [left.boxes, *(boxes.level for boxes in left.waiting)]
        sound = all(type(count) is int and count >= 0 for count in counts)
        sound = sound and type(left.seconds) is float and 0 <= left.seconds < float("inf")
        sound = sound and left.found.dtype == np.float64 and left.found.ndim == 1
        for low, high, owner, _ in left.waiting:
            sound = sound and low.dtype == high.dtype == np.float64 and owner.dtype == np.int64
            sound = sound and low.shape == high.shape == (len(owner), self._ndim) and owner.ndim == 1
            sound = sound and ((owner >= 0) & (owner < len(left.found))).all() and (low <= high).all()
        return bool(sound)


# --- search ----------------------------------------------------------------------------------------------------------


CHUNK = 1 << 16  # boxes that are queried at a time
PARTS = 10_000  # that progress is told in
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
GROUPS, LAST = 16, 0.6  # of many parts: how many groups the last search takes in turn, and how much finer it is
NEARLY = 0.05  # local units: a part counts with its points where F is no farther below the distance than this
HALVINGS = 14  # on each axis, at most


def excesses(
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
    held: Checkpoint | None = None,
    progress: Callable[[int, int], None] | None = None,
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
        least: Excesses under it are not distinguished.
        budget: Seconds; when it is over, boxes count with what is known of them.
        most: Boxes that are looked at; when there are more, it is as if time were over.
        held: Where to begin, and to write now and then what is left: everything, when time is over or an exception ends
            the search.
        progress: Called with how much of the boxes' volume is done, in parts of ``PARTS``.

    Returns:
        ``(N,)`` float64, local units, at least ``least``; how many boxes were looked at; and whether there was time for
        all.

    Raises:
        BounderError: If the shape has no distance.
    """
    started, domain = working_seconds(), bounder.domain
    tolerances = tolerance if isinstance(tolerance, Tolerances) else Tolerances.of_boxes(tolerance, len(lower))
    left = held.load(len(lower)) if held else None
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
            over = now > budget or boxes > most
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
            allowed = tolerances.of(owner)
            enough = np.where(level < halvings, allowed, np.inf) * domain.unit
            overestimate = shape.overestimate(
                sides[0] - room, sides[1] + room, values * domain.unit, under * domain.unit, enough
            )
            if overestimate is None:
                raise BounderError(f"{shape.name}: no distance is known of it")
            overestimate = overestimate / domain.unit + noise
            above = overestimate > allowed
            more = above & (level < halvings) & (not over)
            tolerances.rise(bounder, shape, low[more], high[more], owner[more], overestimate[more])
            complete &= not (over and above.any())
            np.maximum.at(found, owner[~more], overestimate[~more])
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
    bounder: DistanceBounder, shape: Shape, met: np.ndarray, eps: float, *, boxes: float, budget: float
) -> np.ndarray:
    """Where F exceeds the distance by more than any sample of a part: what a proof's search finds and points miss.

    Args:
        bounder: Its F.
        shape: The object.
        met: ``(parts,)``, local units; raised in place, to about the greatest overestimates there are, less ``eps``.
        eps: Local units: by how much an overestimate may be more than what was met before the search looks closer.
        boxes: How many boxes at most.
        budget: Seconds.

    Returns:
        ``(K, n)`` float64, local coordinates.
    """
    lower, upper = _between(*bounder.pieces(), _knots(bounder, shape))
    tolerances = Tolerances(met, eps, bounder.part_of(lower / 2 + upper / 2))
    told = {"halvings": HALVINGS * bounder.ndim, "least": float(met.min()) + eps, "budget": budget, "most": boxes}
    excesses(bounder, shape, lower, upper, tolerance=tolerances, **told)
    return np.concatenate([*tolerances.raised, np.empty((0, bounder.ndim))])


def largest_overestimate(
    bounder: DistanceBounder, shape: Shape, budget: float
) -> tuple[np.ndarray, int, bool, np.ndarray]:
    """Certified: by how much F exceeds the distance in each part of the domain, at most: little more than samples have.

    Args:
        bounder: Its F.
        shape: The object.
        budget: Seconds; when it is over the bound is what is known by then.

    Returns:
        The overestimates ``(parts,)``, local units; how many boxes were looked at; whether there was time; and points
        in object space where samples have the largest overestimates.
    """
    v, sampled, worst = _sampled(bounder, shape)
    parts, met = bounder.part_of(v), np.zeros(bounder.part_count)
    np.maximum.at(met, parts, sampled)
    weight = np.bincount(parts[: SAMPLES // 2][sampled[: SAMPLES // 2] > -NEARLY], minlength=bounder.part_count)
    return (*_refined(bounder, shape, met, weight, budget), worst)


def overestimate_within(
    bounder: DistanceBounder,
    shape: Shape,
    bar: float,
    budget: float,
    held: Checkpoint | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[float, int, bool, np.ndarray]:
    """Certified: by how much F exceeds the distance, at most; by other boxes than ``largest_overestimate`` has.

    Args:
        bounder: Its F.
        shape: The object.
        bar: An overestimate up to this is good enough, local units.
        budget: Seconds.
        held: As ``excesses`` takes it.
        progress: As ``excesses`` takes it.

    Returns:
        As ``largest_overestimate``, of all parts together. Where samples have more than the bar, nothing is searched.
    """
    _, sampled, worst = _sampled(bounder, shape)
    if sampled.max() > bar:
        return float(sampled.max()), 0, True, worst
    tolerances = np.full(bounder.part_count, bar)
    overestimate, boxes, complete = _searched(
        bounder, shape, tolerances, 0.0, budget, again=True, held=held, progress=progress
    )
    return float(overestimate.max()), boxes, complete, worst


def _sampled(bounder: DistanceBounder, shape: Shape) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the domain, half of them uniform, in local coordinates, and F less the distance there.

    And those points, in object space, where that is most.
    """
    limit, rng = bounder.domain.limit.astype(np.float64), np.random.default_rng(0)
    near = _near(bounder, shape, SAMPLES // 2, rng)
    v = np.concatenate([rng.uniform(-limit, limit, (SAMPLES // 2, bounder.ndim)), near])
    x = bounder.domain.sample_at(v)
    sampled = excesses_at(bounder, shape, v)
    if sampled is None:
        raise BounderError(f"{shape.name}: no distance is known of it")
    return v, sampled, x[np.argsort(-sampled)[:1024]]


def _refined(
    bounder: DistanceBounder, shape: Shape, met: np.ndarray, weight: np.ndarray, budget: float
) -> tuple[np.ndarray, int, bool]:
    """The least overestimates of the parts that searches prove in a given time.

    ``met`` holds those of samples, ``weight`` what a part counts.

    What a search leaves undone counts with its largest box, so the next one is only begun where it is likely to end.
    Boxes are in number as ``eps^(-n/2)``, with eps what is proven above ``met``, since a linear function's error goes
    with the square of a side. Of many parts the last search takes one group after another, those first that count most,
    and what it leaves undone stays as it was.
    """
    end, eps, boxes = working_seconds() + budget, COARSEST, 0
    best, complete = np.full(len(met), np.inf), True
    while True:
        started = working_seconds()
        overestimate, looked, complete = _searched(bounder, shape, met, eps, end - started)
        boxes, best = boxes + looked, np.minimum(best, overestimate)
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
            overestimate, looked, _ = _searched(bounder, shape, met, LAST * eps, left, chosen)
            boxes, best[chosen] = boxes + looked, np.minimum(best, overestimate)[chosen]
    return best, boxes, False


def _searched(
    bounder: DistanceBounder,
    shape: Shape,
    met: np.ndarray,
    eps: float,
    budget: float,
    chosen: np.ndarray | None = None,
    *,
    again: bool = False,
    **told,
) -> tuple[np.ndarray, int, bool]:
    """The largest overestimates ``(parts,)``, where one up to ``eps`` above its part's ``met`` counts as that.

    And the number of boxes, and whether the time was enough.

    ``chosen`` are the parts that are requested, all for ``None``. ``again``, to certify what another search has found:
    by other boxes, which begin with thirds; its tolerances do not rise. The rest is for ``excesses``.
    """
    least = float(met.min()) + eps
    told |= {"halvings": HALVINGS * bounder.ndim, "least": least, "budget": budget}
    lower, upper = _between(*bounder.pieces(), _knots(bounder, shape))
    if again:
        lower, upper = _thirds(lower, upper)
    parts = bounder.part_of(lower / 2 + upper / 2)
    if chosen is not None:
        kept = chosen[parts]
        lower, upper, parts = lower[kept], upper[kept], parts[kept]
    tolerances = Tolerances(met, eps, parts, fixed=again)
    found, boxes, complete = excesses(bounder, shape, lower, upper, tolerance=tolerances, **told)
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
    """``(count, n)`` local points of the domain near the object's border, and near what the shape names."""
    x, marks = border_points(shape, count, rng), shape.landmarks()
    if len(marks):
        x[::2] = marks[rng.integers(len(marks), size=len(x[::2]))]
    v = bounder.domain.to_local(x)
    v += np.exp2(rng.uniform(*np.log2(NEAR), (count, 1))) * rng.standard_normal(v.shape)
    limit = bounder.domain.limit.astype(np.float64)
    return np.clip(v, -limit, limit)
