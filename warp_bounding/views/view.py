"""What is seen of a bounder: for each radius or time the bound, the object, and points that were asked, with their answers and the truth."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, Shape
from warp_bounding.views.asked import Asked, asked_of
from warp_bounding.views.objects import object_surface
from warp_bounding.views.section import MOST_SEEN, Section
from warp_bounding.views.surfaces import Surface, level_surface, nodes

__all__ = ["CELLS", "DRAWN", "PIXELS", "Group", "State", "View", "view_of"]

CELLS, PIXELS = 80, 640  # along the longest side: of a level set in space, of a picture of a plane
BEYOND = 0.08  # of the longest side that is seen: room around what is bounded
DRAWN = 1500  # points of each group that are drawn


class Group(NamedTuple):
    """Points that were asked, by answer and truth."""

    name: str
    text: str
    colour: str
    shown: bool  # at first


GROUPS = (
    Group("denied", "no: certainly not in the object", "#7f93a6", False),
    Group("false-positives", "maybe, but not in the object", "#f08a4b", False),
    Group("false-negatives", "no, although in the object", "#e02f2f", True),
)
GROUPS_WITHIN = (
    Group("denied", "no: certainly in the object", "#7f93a6", False),
    Group("false-positives", "maybe, although in the object", "#f08a4b", False),
    Group("false-negatives", "no, although not in the object", "#e02f2f", True),
)


@dataclass
class State:
    """What is seen at one radius or time.

    Attributes:
        label: The radius or the time, for people; may be empty.
        bound: In space the surface of the bound; in a plane ``(X, Y)`` bool, its pixels.
        object: In space the object's surface; in a plane its pixels.
        points: ``(K, k)`` float32 of some points of each group, by name.
        fp_rate: False positives, per cent of the points that were asked.
        fn: False negatives, a count.
        samples: Points that were asked.
        undecided: Points whose truth could not be decided, per cent; they count as in the object, but not as ``fn``.
    """

    label: str
    bound: Surface | np.ndarray
    object: Surface | np.ndarray
    points: dict[str, np.ndarray]
    fp_rate: float
    fn: int
    samples: int
    undecided: float

    def missed(self, within: bool) -> np.ndarray:
        """Of a plane, the pixels ``(X, Y)`` whose answer is wrong: the object's that are denied, or, from the inside, others that are held."""
        return self.bound & ~self.object if within else self.object & ~self.bound

    @property
    def rates(self) -> str:
        """The rates in words."""
        missed = f"{self.fn:,} false negative{'' if self.fn == 1 else 's'}"
        text = f"{self.fp_rate:.2f} % false positives, {missed} in {self.samples:,} random points"
        return f"{text}, {self.undecided:.2f} % undecided" if self.undecided else text


@dataclass
class View:
    """A bounder, as it is seen.

    Attributes:
        names: What the coordinates that are seen are called.
        lower: ``(k,)`` float64, where what is seen begins.
        upper: ``(k,)`` float64, where it ends.
        states: At least one.
        asked: What their labels are values of: ``"radius"``, ``"time"`` or nothing.
        down: Of a plane: its coordinates are rows and columns of an image, so that the first goes down and the second to the right.
        stretch: By how much each coordinate that is seen is stretched, so that an image's pixels are squares; 1 elsewhere.
        within: The bound is seen from the inside: what it holds is certainly in the object.
        indicator: SHA-256 of what was fitted, if the shape is that of the fit.
        held: Values of coordinates that are held besides time, by their numbers.
        facts: What is known of the bounder, by heading.
    """

    names: list[str]
    lower: np.ndarray
    upper: np.ndarray
    states: list[State]
    asked: str
    down: bool
    stretch: tuple[float, ...]
    within: bool
    indicator: str
    held: dict[int, float] = field(default_factory=dict)
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def solid(self) -> bool:
        """Three coordinates are seen, not two."""
        return len(self.names) == MOST_SEEN

    @property
    def brief(self) -> str:
        """The first facts in one line: what the bounder is, and the first sentence of its certificate."""
        return ". ".join(text.partition(". ")[0].rstrip(".") for text in list(self.facts.values())[:2])

    @property
    def groups(self) -> tuple[Group, ...]:
        """Groups of points, in the order in which they are listed."""
        return GROUPS_WITHIN if self.within else GROUPS


def view_of(
    bounder: Bounder | DistanceBounder,
    shape: Shape,
    *,
    radii: Sequence[float] = (0.0,),
    times: Sequence[float] = (),
    held: dict[int, float] | None = None,
    resolution: int | None = None,
    samples: int = 100_000,
    seed: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> View:
    """Compute what is seen of a bounder.

    Args:
        bounder: Of points, boxes or distances.
        shape: Its shape, without its margin.
        radii: Of a distance, object units; others have only 0.
        times: Of a shape that moves, at least one; of others none. Not both may be several.
        held: Values of other coordinates that are held, by their numbers.
        resolution: Cells (pixels, in a plane) along the longest side; ``CELLS`` or ``PIXELS`` if ``None``.
        samples: Points to ask for each radius or time.
        seed: Of the samples.
        progress: Called with steps done and steps in all.

    Raises:
        QueryError: For a shape of another dimension, a kind of query that cannot be seen, or numbers that do not fit.
    """
    if shape.ndim != bounder.ndim:
        raise QueryError(f"the shape is {shape.ndim}D, the bounder {bounder.ndim}D")
    if shape.time != bool(bounder.domain.time):
        moves = {True: "moves", False: "does not move"}
        raise QueryError(f"the shape {moves[shape.time]}, that of the bounder {moves[not shape.time]}")
    _check(bounder, radii, times)
    held = dict(held or {})
    if shape.time and 0 in held:
        raise QueryError("coordinate 0 is time: expected --time rather than a slice of it")
    pairs = [(radius, time) for time in (times or [None]) for radius in radii]
    sections = [Section(shape.ndim, held if t is None else {0: t, **held}, shape.time) for _, t in pairs]
    of_radius = {radius: asked_of(bounder, shape, radius) for radius in dict.fromkeys(radii)}
    asked = [of_radius[radius] for radius, _ in pairs]
    lower, upper = _box(asked, sections[0], max(radii))
    objects, states = {}, []
    rng = np.random.default_rng(seed)
    cells = resolution or (CELLS if len(sections[0].axes) == MOST_SEEN else PIXELS)
    for number, ((radius, time), section, each) in enumerate(zip(pairs, sections, asked, strict=True)):
        frame = _Frame(section, lower, upper, cells)
        if time not in objects:
            objects[time] = _object(shape, frame)
        value = radius if len(radii) > 1 or (isinstance(bounder, DistanceBounder) and time is None) else time
        label = "" if value is None else f"{value:.4g}"
        x = _random_points(each, section, samples, rng)
        states.append(_state(label, each, frame, bool(bounder.domain.unbounded), objects[time], x))
        if progress:
            progress(number + 1, len(pairs))
    by_radius = isinstance(bounder, DistanceBounder) and len(times) <= 1 and (len(radii) > 1 or not times)
    axes = sections[0].axes
    down, stretch = len(axes) < MOST_SEEN and isinstance(shape, IndicatorGrid), np.ones(len(axes))
    if down:
        stretch = shape.cells_per_unit[axes] / shape.cells_per_unit[axes].max()
    return View(
        names=[f"coordinate {axis}" for axis in axes] if down else sections[0].names,
        lower=lower,
        upper=upper,
        states=states,
        asked="radius" if by_radius else "time" if times else "",
        down=down,
        stretch=tuple(stretch.tolist()),
        within=bool(bounder.domain.unbounded),
        indicator=asked[0].fitted.digest,
        held=held,
    )


def _check(bounder: Bounder | DistanceBounder, radii: Sequence[float], times: Sequence[float]) -> None:
    if not isinstance(bounder, DistanceBounder) and any(radii):
        raise QueryError(f"a radius is for distances, got one for {bounder.query_kind} queries")
    for name, values, least in (("radius", radii, 0.0), ("time", times, -np.inf)):
        for value in values:
            if not least <= value < np.inf:
                told = " of at least 0" if least == 0 else ""
                raise QueryError(f"{name} must be a finite number{told}, got {value}")
    if times and not bounder.domain.time:
        raise QueryError("a time is for shapes that move, got one for a shape at rest")
    if bounder.domain.time:
        start, end = float(bounder.domain.lower[0]), float(bounder.domain.upper[0])
        if not times:
            raise QueryError(f"expected a time from {start:.6g} to {end:.6g}")
        for time in times:
            if not start <= time <= end:
                raise QueryError(f"time must be from {start:.6g} to {end:.6g}, where the shape moves, got {time}")
    if len(radii) > 1 and len(times) > 1:
        raise QueryError(f"expected one radius or one time, got {len(radii)} radii and {len(times)} times")


def _box(asked: list[Asked], section: Section, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """What is seen: the box that holds the object and its margin, the radius, and some room."""
    shape = asked[0].around
    lower, upper = shape.lower[section.axes], shape.upper[section.axes]
    room = radius + BEYOND * (upper - lower).max()
    return lower - room, upper + room


class _Frame(NamedTuple):
    """What is looked at: a section, the box of it that is seen, and into how many cells or pixels its longest side is cut."""

    section: Section
    lower: np.ndarray
    upper: np.ndarray
    cells: int

    @property
    def solid(self) -> bool:
        """Three coordinates are seen, not two."""
        return len(self.section.axes) == MOST_SEEN

    def pixels(self, holds: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Of a plane, at which pixels ``(X, Y)`` a test of points ``(N, 2)`` holds, asked at their centres."""
        count, _ = nodes(self.lower, self.upper, self.cells)
        sides = count - 1
        ends = zip(self.lower, self.upper, sides, strict=True)
        ticks = [a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in ends]
        return holds(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2)).reshape(sides)


def _object(shape: Shape, frame: _Frame) -> Surface | np.ndarray:
    if frame.solid:
        return object_surface(shape, frame.section, frame.cells)
    return frame.pixels(lambda x: shape.contains(frame.section.lift(x)))


def _state(label: str, asked: Asked, frame: _Frame, within: bool, seen: Surface | np.ndarray, x: np.ndarray) -> State:
    """The bound at one radius and time, and how it answers the points ``x`` of the section."""
    section = frame.section

    def held(x: np.ndarray) -> np.ndarray:
        return asked.maybe(section.lift(x)) != within

    bound = level_surface(held, frame.lower, frame.upper, frame.cells) if frame.solid else frame.pixels(held)
    lifted = section.lift(x)
    maybe, truth = asked.maybe(lifted), np.asarray(asked.truth(lifted), dtype=np.uint8)
    groups = (~maybe & (truth != IN), maybe & (truth == OUT), ~maybe & (truth == IN))
    drawn = {group.name: x[np.flatnonzero(mask)[:DRAWN]] for group, mask in zip(GROUPS, groups, strict=True)}
    share = 100 / len(x)
    undecided = share * int((truth == UNDECIDED).sum())
    return State(label, bound, seen, drawn, share * int(groups[1].sum()), int(groups[2].sum()), len(x), undecided)


def _random_points(asked: Asked, section: Section, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points ``(count, k)`` float32 of a section, in the box that samples come from."""
    low, high = (side[section.axes] for side in (asked.around.sample_lower, asked.around.sample_upper))
    return rng.uniform(low, high, (count, len(low))).astype(np.float32)
