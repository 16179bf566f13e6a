"""What is seen of a bounder: for each radius or time the bound, the object, and points that were asked, with their answers and the truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.certificates.claim import as_fitted, in_local, of_side
from warp_bounding.certificates.statement import NOT_CONSERVATIVE
from warp_bounding.errors import BoundingError, QueryError
from warp_bounding.evaluation import PROTOCOLS, judge_of, judge_of_points
from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, IndicatorMotion
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, Shape
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.queries.point import POINT

__all__ = [
    "ASKED",
    "CELLS",
    "DRAWN",
    "MOST_SEEN",
    "PIXELS",
    "Asked",
    "Group",
    "Section",
    "State",
    "Surface",
    "View",
    "asked_of",
    "cell_surface",
    "facts_of",
    "level_surface",
    "needed",
    "object_surface",
    "title_of",
    "view_of",
]

# --- needed ----------------------------------------------------------------------------------------------------------
#
# What is shown with packages that the core does not need.


def needed(name: str) -> ModuleType:
    """A package of the extra ``show``.

    Raises:
        BoundingError: If it is not installed, with the extra to install.
    """
    try:
        return import_module(name)
    except ImportError as error:
        package = (error.name or name).partition(".")[0]
        raise BoundingError(f"show needs {package}: pip install 'warp-bounding[show]'") from error


# --- surfaces --------------------------------------------------------------------------------------------------------
#
# Surfaces in three dimensions where an answer changes, as triangles.
#
# A level set is found from answers alone, those that are deployed: marching cubes over answers at the nodes of a grid say between which two
# nodes the answer changes, and halving that way again and again says where. What is thinner than the grid's cells can be missed.

HALVINGS = 12  # of a grid's edge: to 1/4096 of a cell
CHUNK = 1 << 20  # points that are asked at a time


class Surface(NamedTuple):
    """Triangles, counter-clockwise as seen from outside."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int64

    @classmethod
    def empty(cls) -> "Surface":
        """No triangle."""
        return cls(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))


def nodes(lower: np.ndarray, upper: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of nodes along each axis of a box, and the step between them: about ``resolution`` along the longest side."""
    size = np.maximum(upper - lower, np.finfo(np.float64).tiny)
    count = np.maximum(np.ceil(resolution * size / size.max()).astype(int), 2) + 1
    return count, size / (count - 1)


def level_surface(
    inside: Callable[[np.ndarray], np.ndarray], lower: np.ndarray, upper: np.ndarray, resolution: int
) -> Surface:
    """The surface around the points of a box for which a test is true, closed where the box ends.

    Args:
        inside: The test: called with ``(N, 3)`` float64 it returns ``(N,)`` bool.
        lower: ``(3,)`` float64.
        upper: ``(3,)`` float64.
        resolution: Cells along the longest side.
    """
    count, step = nodes(lower, upper, resolution)
    ticks = [low + np.arange(n) * d for low, n, d in zip(lower, count, step, strict=True)]
    mask = np.zeros(count + 2, dtype=bool)  # a ring of false nodes around the box
    mask[1:-1, 1:-1, 1:-1] = _asked(inside, ticks).reshape(count)
    if not mask.any():
        return Surface.empty()
    pyvista = needed("pyvista")
    grid = pyvista.ImageData(dimensions=mask.shape)
    grid["inside"] = mask.ravel(order="F").astype(np.uint8)
    found = grid.contour([0.5], scalars="inside", compute_normals=False)
    halves = np.rint(2 * np.asarray(found.points)).astype(int)  # each vertex is in the middle of an edge between nodes
    first, second = halves // 2, -(-halves // 2)
    true_first = mask[tuple(first.T)][:, None]
    yes, no = (lower + (np.where(true_first, *pair) - 1) * step for pair in ((first, second), (second, first)))
    within = ((no >= lower - step / 2) & (no <= upper + step / 2)).all(axis=1)
    no = np.clip(no, lower, upper)  # the ring lies outside the box, where nothing is asked
    for _ in range(HALVINGS):
        middle = (yes + no) / 2
        true = inside(middle)
        yes, no = np.where(true[:, None], middle, yes), np.where(true[:, None], no, middle)
    vertices = np.where(within[:, None], (yes + no) / 2, no)
    return _outwards(Surface(vertices, found.regular_faces.astype(np.int64)))


def _asked(inside: Callable[[np.ndarray], np.ndarray], ticks: list[np.ndarray]) -> np.ndarray:
    """The answers at all nodes, some planes of nodes at a time."""
    layers = max(1, CHUNK // (len(ticks[1]) * len(ticks[2])))
    found = []
    for start in range(0, len(ticks[0]), layers):
        points = np.stack(np.meshgrid(ticks[0][start : start + layers], *ticks[1:], indexing="ij"), axis=-1)
        found.append(inside(points.reshape(-1, 3)))
    return np.concatenate(found)


def _outwards(surface: Surface) -> Surface:
    """The surface, turned inside out if it encloses a negative volume."""
    a, b, c = (surface.vertices[surface.faces[:, k]] - surface.vertices.mean(axis=0) for k in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:
        return Surface(surface.vertices, surface.faces[:, ::-1].copy())
    return surface


def cell_surface(occupied: np.ndarray, edges: list[np.ndarray]) -> Surface:
    """The surface of closed cells.

    Args:
        occupied: ``(X, Y, Z)`` bool.
        edges: Where the cells begin and end along each axis: ``(X + 1,)``, ``(Y + 1,)``, ``(Z + 1,)`` float64.
    """
    padded, size = np.pad(occupied, 1).astype(np.int8), np.array(occupied.shape) + 1
    squares = []
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        change = np.diff(padded, axis=axis)
        trimmed = np.take(np.take(change, range(1, size[others[0]]), others[0]), range(1, size[others[1]]), others[1])
        at = np.argwhere(trimmed)
        corners = np.repeat(at[:, None], 4, axis=1)
        corners[:, [1, 2], others[0]] += 1
        corners[:, [2, 3], others[1]] += 1
        # The corners run from one other axis to the next, counter-clockwise about +axis for axes 0 and 2 and clockwise for axis 1.
        along = (trimmed[tuple(at.T)] < 0) ^ (axis == 1)
        squares.append(np.where(along[:, None, None], corners, corners[:, ::-1]))
    squares = np.concatenate(squares).reshape(-1, 3)
    numbers, faces = np.unique(np.ravel_multi_index(squares.T, size), return_inverse=True)
    places = np.unravel_index(numbers, size)
    vertices = np.stack([edge[place] for edge, place in zip(edges, places, strict=True)], axis=1)
    faces = faces.reshape(-1, 4)
    return Surface(vertices, np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]]))


# --- section ---------------------------------------------------------------------------------------------------------
#
# The part of a space that is seen: two or three coordinates run, the others are held at values, as time is.

LEAST_SEEN, MOST_SEEN = 2, 3  # coordinates that a picture has
NAMES = ("x", "y", "z")


@dataclass(frozen=True)
class Section:
    """A plane or a space that cuts an n-dimensional one at right angles to its axes.

    Attributes:
        ndim: n.
        held: The value of each coordinate that is held, by its number.
        time: Coordinate 0 is time.

    Raises:
        QueryError: If a coordinate does not exist, or other than two or three coordinates run.
    """

    ndim: int
    held: Mapping[int, float]
    time: bool = False

    def __post_init__(self) -> None:
        for axis, value in self.held.items():
            if not 0 <= axis < self.ndim:
                raise QueryError(f"slice: expected coordinates 0 to {self.ndim - 1}, got {axis}")
            if not np.isfinite(value):
                raise QueryError(f"slice: expected a finite value of coordinate {axis}, got {value}")
        seen = len(self.axes)
        if seen > MOST_SEEN:
            raise QueryError(
                f"at most {MOST_SEEN} coordinates can be shown, the bounder has {self.ndim}: "
                f"hold {seen - MOST_SEEN} more of them by --slice, such as --slice {self.axes[-1]}=0"
            )
        if seen < LEAST_SEEN:
            raise QueryError(f"at least {LEAST_SEEN} coordinates must run, got {seen} of the bounder's {self.ndim}")

    @property
    def axes(self) -> list[int]:
        """The coordinates that run, ascending."""
        return [axis for axis in range(self.ndim) if axis not in self.held]

    @property
    def names(self) -> list[str]:
        """What the coordinates that run are called: x, y and z where these are all of space, else by their numbers."""
        space = list(range(int(self.time), self.ndim))
        if self.axes == space and len(space) <= len(NAMES):
            return list(NAMES[: len(space)])
        return [f"coordinate {axis}" for axis in self.axes]

    def lift(self, points: np.ndarray) -> np.ndarray:
        """Points ``(N, k)`` of the section as points ``(N, n)`` float32 of the whole space."""
        found = np.empty((len(points), self.ndim), dtype=np.float32)
        found[:, self.axes] = points
        for axis, value in self.held.items():
            found[:, axis] = value
        return found


# --- asked -----------------------------------------------------------------------------------------------------------
#
# How a bounder of each kind is asked about points, and what the truth is: the test whose level set is shown.
#
# A bounder of points is asked them; one of boxes, boxes without a size; a distance, points within a radius. The other kinds have no such test:
# whether a ray or a plane meets the object depends on more than a point.

Answers = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Asked:
    """A bounder and its shape, asked about points ``(N, n)`` float32.

    Attributes:
        maybe: ``(N,)`` bool, where the bounder says *maybe*.
        truth: ``(N,)`` uint8, as of ``Shape.decide``.
        around: The shape around which points are drawn.
        fitted: What the fit bounded, if the shape is that of the fit.
    """

    maybe: Answers
    truth: Answers
    around: Shape
    fitted: Shape


def _points(bounder: Bounder, shape: Shape, radius: float) -> Asked:
    fitted = as_fitted(bounder, shape)
    judge = judge_of(of_side(bounder, shape), fitted, POINT.name, PROTOCOLS[0])
    return Asked(lambda x: bounder.query(x).numpy() != 0, judge.decide, judge, fitted)


def _boxes(bounder: Bounder, shape: Shape, radius: float) -> Asked:
    points = _points(bounder, shape, radius)
    return Asked(
        lambda x: bounder.query(np.concatenate([x, x], axis=1)).numpy() != 0,
        points.truth,
        points.around,
        points.fitted,
    )


def _distances(bounder: DistanceBounder, shape: Shape, radius: float) -> Asked:
    fitted = as_fitted(bounder, shape)
    _, around, truth = judge_of_points(bounder, shape, fitted, radius)
    return Asked(lambda x: bounder.query(x, radius).numpy() != 0, truth, around, fitted)


# By kind of query: called with a bounder, its shape and a radius, which only a distance is asked with.
ASKED: dict[str, Callable[..., Asked]] = {POINT.name: _points, BOX.name: _boxes, DISTANCE.name: _distances}


def asked_of(bounder: Bounder | DistanceBounder, shape: Shape, radius: float) -> Asked:
    """A bounder and its shape, asked about points.

    Raises:
        QueryError: For a kind of query that a point says nothing about.
    """
    if bounder.query_kind not in ASKED:
        raise QueryError(
            f"show is for bounders of {', '.join(ASKED)} queries, got one of {bounder.query_kind} queries: "
            "what it answers depends on more than a place"
        )
    return ASKED[bounder.query_kind](*in_local(bounder, shape), radius)


# --- objects ---------------------------------------------------------------------------------------------------------
#
# The object itself as a surface, without its margin: triangles of a mesh, cells of a grid, and else a level set of the truth.


@singledispatch
def object_surface(shape: Shape, section: Section, resolution: int) -> Surface:
    """The surface of an object in a section with three coordinates.

    Args:
        shape: The object.
        section: Where it is cut.
        resolution: Cells along the longest side, where it has to be searched for.
    """
    lower, upper = shape.lower[section.axes], shape.upper[section.axes]
    step = (upper - lower).max() / resolution
    return level_surface(lambda x: shape.contains(section.lift(x)), lower - step, upper + step, resolution)


@object_surface.register
def _of_mesh(shape: IndicatorMesh, section: Section, resolution: int) -> Surface:
    return Surface(np.asarray(shape.vertices, dtype=np.float64), np.asarray(shape.faces, dtype=np.int64))


@object_surface.register
def _of_motion(shape: IndicatorMotion, section: Section, resolution: int) -> Surface:
    if section.axes != [1, 2, 3]:  # time runs, or a coordinate of space is held
        return object_surface.dispatch(Shape)(shape, section, resolution)
    vertices = shape.vertices_at(section.held[0]).astype(np.float64)
    return Surface(vertices, np.asarray(shape.faces, dtype=np.int64))


@object_surface.register
def _of_grid(shape: IndicatorGrid, section: Section, resolution: int) -> Surface:
    cells = shape.occupancy
    for axis in sorted(section.held, reverse=True):
        centres = shape.position(np.repeat(np.arange(shape.shape[axis])[:, None], shape.ndim, axis=1))[:, axis]
        cells = np.take(cells, np.abs(centres - section.held[axis]).argmin(), axis)
    edges = []
    for axis in section.axes:
        places = np.repeat(np.arange(shape.shape[axis] + 1)[:, None] - 0.5, shape.ndim, axis=1)
        edges.append(shape.position(places)[:, axis])
    return cell_surface(cells, edges)


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


# --- facts -----------------------------------------------------------------------------------------------------------
#
# What is known of a bounder, in the words that stand beside a picture of it.

FINENESS = {
    True: "what is thinner than a cell of the grid that finds it can be missing.",
    False: "each was asked at its centre.",
}  # by whether three coordinates are seen
NONE = "None: nothing is known of its false negatives."


def title_of(bounder: Bounder | DistanceBounder, shape: Shape) -> str:
    """A heading: the shape and the method."""
    return f"{shape.name}, bounded by {bounder.method}"


def facts_of(bounder: Bounder | DistanceBounder, shape: Shape, view: View) -> dict[str, str]:
    """Facts by heading, in the order in which they are to be read.

    Args:
        bounder: Any.
        shape: That is shown with it.
        view: That is shown with them.
    """
    side = ", from the inside" if bounder.domain.unbounded else ""
    facts = {
        "Bounder": f"{bounder.method}, {bounder.ndim}D {bounder.query_kind} queries{side}, {bounder.nbytes:,} bytes"
    }
    if bounder.certificate is not None:
        facts["Certificate"] = bounder.certificate.message
    else:
        facts["Certificate"] = NONE if bounder.conservative else NOT_CONSERVATIVE
    indicator = view.indicator
    if indicator != bounder.info.get("indicator"):
        fitted = bounder.info.get("indicator") or "unknown"
        facts["Another shape"] = (
            f"{shape.name} is not the shape that the bounder was fitted to: SHA-256 {indicator[:16]}, "
            f"that of the fit {fitted[:16]}. The certificate says nothing of it."
        )
    margin = bounder.info.get("margin") or 0.0
    object_told = f"{shape.name} as it is read" + (
        f"; the bound holds it dilated by {margin:g} (object units)" if margin else ""
    )
    where = "the surface" if view.solid else "the pixels"
    facts["Drawn"] = (
        f"The object is {object_told}. The bound is {where} where the deployed answers change; {FINENESS[view.solid]}"
    )
    if view.held:
        facts["Held"] = ", ".join(f"coordinate {axis} at {value:g}" for axis, value in view.held.items())
    facts["Points"] = f"Drawn at random in and around the object; at most {DRAWN:,} of a kind are shown."
    return facts
