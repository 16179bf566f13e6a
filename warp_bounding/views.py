"""Pictures of a bound: level sets of its answers around the object, by radius or time, and how they are shown.

``view_of`` computes what is seen, with nothing but the bounder's own answers and the shape's own truth. ``page`` writes
it as one self-contained web page. Importing this module needs neither pyvista nor plotly.

A level set is found from answers alone: marching cubes over answers at the nodes of a grid say between which two nodes
the answer changes, and halving that way again and again says where. What is thinner than the grid's cells can be
missed. In a plane every pixel is queried, at its centre.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.certificates.claim import as_fitted, in_local, of_side
from warp_bounding.certificates.statement import statement
from warp_bounding.errors import BoundingError, QueryError
from warp_bounding.evaluation import judge_of, judge_of_points
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.queries.point import POINT
from warp_bounding.shapes import Grid, Mesh, MovingMesh
from warp_bounding.shapes.shape import Shape

CELLS, PIXELS = 80, 640  # along the longest side: of a level set in space, of a picture of a plane
HALVINGS = 12  # of a grid's edge: to 1/4096 of a cell
BEYOND = 0.08  # of the longest side that is seen: room around what is bounded
LEVELS = 6  # radii or times that are shown where none are given
FARTHEST = 0.25  # of the object's longest side: the largest of these radii
PLANE, SPACE = 2, 3  # coordinates that are seen
Test = Callable[[np.ndarray], np.ndarray]  # of points (N, k): (N,)
# How a bounder of each kind is asked points (N, n) float32: one of boxes, boxes without a size; a distance, whether it
# is within a radius.
ASKED: dict[str, Callable[..., Any]] = {
    POINT.name: lambda bounder, x, radius: bounder.query(x),
    BOX.name: lambda bounder, x, radius: bounder.query(np.hstack([x, x])),
    DISTANCE.name: lambda bounder, x, radius: bounder.query(x, radius),
}


def needed(name: str) -> ModuleType:
    """A package of the extra ``show``; raises ``BoundingError`` with the extra to install if it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        package = (error.name or name).partition(".")[0]
        raise BoundingError(f"show needs {package}: pip install 'warp-bounding[show]'") from error


# --- surfaces, as ``pyvista.PolyData`` of triangles ------------------------------------------------------------------


def level_surface(inside: Test, lower: np.ndarray, upper: np.ndarray, cells: int):
    """The surface around the points of a box ``(3,)`` for which a test is true, closed where the box ends.

    Args:
        inside: Called with ``(N, 3)`` float64 it returns ``(N,)`` bool.
        lower: ``(3,)`` float64.
        upper: ``(3,)`` float64.
        cells: Along the longest side.
    """
    pyvista, sides = needed("pyvista"), _sides(lower, upper, cells)
    x, y, z = (np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, sides, strict=True))
    layer = np.stack(np.meshgrid(0.0, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    mask = np.zeros(sides + 3, dtype=bool)  # a ring of false nodes around the box
    for number, place in enumerate(x):
        layer[:, 0] = place
        mask[number + 1, 1:-1, 1:-1] = inside(layer).reshape(sides[1:] + 1)
    if not mask.any():
        return pyvista.PolyData()
    grid = pyvista.ImageData(dimensions=mask.shape)
    grid["inside"] = mask.ravel(order="F").astype(np.uint8)
    found = grid.contour([0.5], scalars="inside", compute_normals=False)
    halves = np.rint(2 * np.asarray(found.points)).astype(int)  # a vertex is in the middle of an edge between nodes
    ends = np.stack([halves // 2, -(-halves // 2)])
    ends = np.where(mask[tuple(ends[0].T)][:, None], ends, ends[::-1])  # the node where the test is true comes first
    yes, no = np.clip(lower + (ends - 1) * (upper - lower) / sides, lower, upper)  # nothing is queried in the ring
    for _ in range(HALVINGS):
        middle = (yes + no) / 2
        true = inside(middle)[:, None]
        yes, no = np.where(true, middle, yes), np.where(true, no, middle)
    return pyvista.PolyData.from_regular_faces((yes + no) / 2, found.regular_faces)


def object_surface(shape: Shape, held: Mapping[int, float], cells: int):
    """The surface of an object without its margin, where three coordinates run and the others are held at values.

    Triangles of a mesh, else a level set of the truth.
    """
    pyvista, axes = needed("pyvista"), _running(shape.ndim, held)
    if isinstance(shape, Mesh):
        return pyvista.PolyData.from_regular_faces(np.asarray(shape.vertices, np.float64), shape.faces)
    if isinstance(shape, MovingMesh) and axes == [1, 2, 3]:
        return pyvista.PolyData.from_regular_faces(shape.vertices_at(held[0]).astype(np.float64), shape.faces)
    lower, upper = shape.lower[axes], shape.upper[axes]
    step = (upper - lower).max() / cells
    return level_surface(lambda x: shape.contains(_lifted(x, axes, held)), lower - step, upper + step, cells)


def _pixels(holds: Test, lower: np.ndarray, upper: np.ndarray, cells: int) -> np.ndarray:
    """At which pixels ``(X, Y)`` of a plane a test holds, asked at their centres."""
    sides = _sides(lower, upper, cells)
    middles = np.meshgrid(*_middles(lower, upper, sides), indexing="ij")
    return holds(np.stack(middles, axis=-1).reshape(-1, PLANE)).reshape(sides)


def _middles(lower: np.ndarray, upper: np.ndarray, sides) -> list[np.ndarray]:
    return [a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in zip(lower, upper, sides, strict=True)]


def _sides(lower: np.ndarray, upper: np.ndarray, cells: int) -> np.ndarray:
    """Cells along each side of a box, of which the longest has about ``cells``."""
    size = np.maximum(upper - lower, np.finfo(np.float64).tiny)
    return np.maximum(np.ceil(cells * size / size.max()).astype(int), 2)


def _running(ndim: int, held: Mapping[int, float]) -> list[int]:
    """The coordinates that run, ascending.

    Raises ``QueryError`` for a wrong number of them, or for a fixed one that does not exist.
    """
    for axis, value in held.items():
        if not 0 <= axis < ndim:
            raise QueryError(f"slice: expected coordinates 0 to {ndim - 1}, got {axis}")
        if not np.isfinite(value):
            raise QueryError(f"slice: expected a finite value of coordinate {axis}, got {value}")
    axes = [axis for axis in range(ndim) if axis not in held]
    if (more := len(axes) - SPACE) > 0:
        hint = f"hold {more} more of them by --slice, such as --slice {axes[-1]}=0"
        raise QueryError(f"at most {SPACE} coordinates can be shown, the bounder has {ndim}: {hint}")
    if len(axes) < PLANE:
        raise QueryError(f"at least {PLANE} coordinates must run, got {len(axes)} of the bounder's {ndim}")
    return axes


def _lifted(points: np.ndarray, axes: list[int], held: Mapping[int, float]) -> np.ndarray:
    """Points ``(N, k)`` of the coordinates that run as points ``(N, n)`` float32 of the whole space."""
    found = np.empty((len(points), len(axes) + len(held)), dtype=np.float32)
    found[:, axes] = points
    found[:, list(held)] = list(held.values())
    return found


# --- views -----------------------------------------------------------------------------------------------------------


@dataclass
class State:
    """What is seen at one radius or time."""

    label: str  # the radius or the time, for people; may be empty
    bound: Any  # in space the surface of the bound, a pyvista.PolyData; in a plane (X, Y) bool, its pixels
    object: Any  # the object's, likewise

    def pixels(self, within: bool) -> np.ndarray:
        """What the pixels ``(X, Y)`` of a plane show: 0 nothing, 1 the bound, 2 the object, 3 what is wrong."""
        if within:  # what is held and not the object's is wrong
            return np.where(self.bound, np.where(self.object, 1, 3), 2 * self.object)
        return np.where(self.object, np.where(self.bound, 2, 3), self.bound)


@dataclass
class View:
    """A bounder, as it is seen: in space, or in a plane where two coordinates run."""

    title: str  # the shape and the method
    names: list[str]  # of the coordinates that are seen
    lower: np.ndarray  # (k,) float64, where what is seen begins
    upper: np.ndarray  # (k,) float64, where it ends
    states: list[State]  # at least one
    asked: str  # what their labels are values of: "radius", "time" or nothing
    down: bool  # a plane of an image: the first coordinate goes down and the second to the right, as rows and columns
    stretch: tuple[float, ...]  # of each coordinate, so that an image's pixels are squares; else 1
    within: bool  # seen from the inside: what the bound holds is certainly in the object
    indicator: str  # SHA-256 of what was fitted, if the shape is that of the fit
    facts: dict[str, str]  # what is known of the bounder, by heading, in the order in which it is to be read

    @property
    def solid(self) -> bool:
        """Three coordinates are seen, not two."""
        return len(self.names) == SPACE

    @property
    def bounds(self) -> str:
        """What the bound says of the places that it holds."""
        return "certainly inside" if self.within else "the bound: maybe"


def view_of(
    bounder: Bounder,
    shape: Shape,
    *,
    radii: Sequence[float] = (),
    times: Sequence[float] = (),
    held: Mapping[int, float] | None = None,
    resolution: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> View:
    """Compute what is seen of a bounder.

    Args:
        bounder: Of points, boxes or distances.
        shape: Its shape, without its margin.
        radii: Of a distance, object units; others have only 0. Some are chosen where none are given.
        times: Of a shape that moves; of others none. Some are chosen where none are given. Not both may be several.
        held: Values of other coordinates that are held, by their numbers.
        resolution: Cells (pixels, in a plane) along the longest side; ``CELLS`` or ``PIXELS`` if ``None``.
        progress: Called with steps done and steps in all.

    Raises:
        QueryError: For a shape of another dimension, a kind of query that cannot be seen, or numbers that do not fit.
    """
    held = dict(held or {})
    radii, times = list(radii) or _radii(bounder, times), list(times) or _times(shape, radii)
    _check(bounder, shape, radii, times, held)
    pairs = [(radius, time) for time in (times or [None]) for radius in radii]
    axes, within = _running(shape.ndim, held | ({0: 0.0} if shape.time else {})), bool(bounder.domain.unbounded)
    local, shape = in_local(bounder, shape)
    fitted, own = as_fitted(local, shape), of_side(local, shape)
    if local.of_distances:
        around = judge_of_points(local, own, fitted, radii[0])[1]
    else:
        around = judge_of(own, fitted, POINT.name)
    room = max(radii) + BEYOND * (around.upper - around.lower)[axes].max()
    lower, upper, solid = around.lower[axes] - room, around.upper[axes] + room, len(axes) == SPACE
    cells = resolution or (CELLS if solid else PIXELS)
    level_set, ask = level_surface if solid else _pixels, ASKED[bounder.query_kind]
    by_radius = bounder.of_distances and (len(radii) > 1 or not times)
    objects, states = {}, []
    for radius, time in pairs:
        section = held if time is None else {0: time, **held}
        lifted = partial(_lifted, axes=axes, held=section)
        if time not in objects:
            if solid:
                objects[time] = object_surface(shape, section, cells)
            else:
                objects[time] = _pixels(lambda x, lifted=lifted: shape.contains(lifted(x)), lower, upper, cells)

        def held_by(x: np.ndarray, lifted=lifted, radius=radius) -> np.ndarray:
            return ask(local, lifted(x), radius).numpy() != within

        value = radius if by_radius else time
        label = "" if value is None else f"{value:.4g}"
        states.append(State(label, level_set(held_by, lower, upper, cells), objects[time]))
        if progress:
            progress(len(states), len(pairs))
    down = not solid and isinstance(shape, Grid)
    scale = shape.cells_per_unit[axes] / shape.cells_per_unit[axes].max() if down else np.ones(len(axes))
    all_of_space = not down and axes == list(range(int(shape.time), shape.ndim))
    return View(
        title=f"{shape.name}, bounded by {bounder.method}",
        names=list("xyz")[: len(axes)] if all_of_space else [f"coordinate {axis}" for axis in axes],
        lower=lower,
        upper=upper,
        states=states,
        asked="radius" if by_radius else "time" if times else "",
        down=down,
        stretch=tuple(scale.tolist()),
        within=within,
        indicator=fitted.digest,
        facts=_facts(bounder, shape, fitted.digest, held),
    )


def _radii(bounder: Bounder, times: Sequence[float]) -> list[float]:
    """Radii to show a distance at, if none are given: from 0 to a share of the object's longest side."""
    if bounder.query_kind != DISTANCE.name or bounder.domain.time or len(times) > 1:
        return [0.0]
    farthest = float(f"{FARTHEST * bounder.size:.1g}")
    return [round(farthest * k / (LEVELS - 1), 12) for k in range(LEVELS)]


def _times(shape: Shape, radii: Sequence[float]) -> list[float]:
    """Times to show a motion at, if none are given: evenly spread, or the middle one where there are several radii."""
    if not shape.time:
        return []
    start, end = float(shape.sample_lower[0]), float(shape.sample_upper[0])
    return [(start + end) / 2] if len(radii) > 1 else np.linspace(start, end, LEVELS).tolist()


def _check(bounder, shape: Shape, radii: Sequence[float], times: Sequence[float], held: Mapping[int, float]) -> None:
    """Refuse what cannot be seen, and numbers that do not fit."""
    if (shape.ndim, shape.time) != (bounder.ndim, bool(bounder.domain.time)):
        moves = {True: "moves", False: "does not move"}
        of_bounder = f"that of the bounder is {bounder.ndim}D and {moves[bool(bounder.domain.time)]}"
        raise QueryError(f"the shape is {shape.ndim}D and {moves[shape.time]}, {of_bounder}")
    if bounder.query_kind not in ASKED:
        reported = f"bounders of {', '.join(ASKED)} queries, got one of {bounder.query_kind} queries"
        raise QueryError(f"show is for {reported}: what it answers depends on more than a place")
    if not bounder.of_distances and any(radii):
        raise QueryError(f"a radius is for distances, got one for {bounder.query_kind} queries")
    for radius in radii:
        if not 0 <= radius < np.inf:
            raise QueryError(f"radius must be a finite number of at least 0, got {radius}")
    if times and not shape.time:
        raise QueryError("a time is for shapes that move, got one for a shape at rest")
    start, end = float(bounder.domain.lower[0]), float(bounder.domain.upper[0])
    for time in times:
        if not start <= time <= end:
            raise QueryError(f"time must be from {start:.6g} to {end:.6g}, where the shape moves, got {time}")
    if shape.time and 0 in held:
        raise QueryError("coordinate 0 is time: expected --time rather than a slice of it")
    if len(radii) > 1 and len(times) > 1:
        raise QueryError(f"expected one radius or one time, got {len(radii)} radii and {len(times)} times")


def _facts(bounder: Bounder, shape: Shape, indicator: str, held: Mapping[int, float]) -> dict[str, str]:
    """What is known of a bounder, in the words that stand beside a picture of it."""
    facts, fitted = statement(bounder), bounder.info.get("indicator") or "unknown"
    if indicator != fitted:
        digests = f"SHA-256 {indicator[:16]}, that of the fit {fitted[:16]}"
        facts["another shape"] = f"{shape.name} is not the shape that the bounder was fitted to: {digests}"
    if held:
        facts["held"] = ", ".join(f"coordinate {axis} at {value:g}" for axis, value in held.items())
    return facts


# --- a page ----------------------------------------------------------------------------------------------------------

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
PIXEL_COLOURS = ("#ffffff", BOUND, STONE, MISSED)  # by ``State.pixels``
VIEW = (-0.65, -1.45, 0.6)  # towards the camera: to the right, into the picture, up

OPACITY = 0.3  # of the bound
EDGE = 30.0  # degrees between two triangles from which they meet in an edge, and are no parts of one curved surface
MOST_TRIANGLES = 60_000  # of a surface; one with more is simplified, so that a browser turns it smoothly
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title><style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 1rem; color: {ink} }} h1 {{ font-size: 1.15rem; margin: 0 }}
dt {{ font-weight: 600 }} dd {{ margin: 0 0 .5rem; overflow-wrap: anywhere }}
</style></head><body><h1>{title}</h1>
{plot}
<dl>
{facts}
</dl></body></html>
"""


def page(view: View, title: str, up: str, library: str | None = None) -> str:
    """A page of a view, which turns with the mouse; its legend hides and shows what is seen.

    Args:
        view: What is seen.
        title: Its heading.
        up: The axis that is up, ``"x"``, ``"y"`` or ``"z"``; of a view in space.
        library: Address of plotly.js (``.js``), for a page that does not hold it; else the page needs no network.

    Raises:
        BoundingError: If a package is missing.
    """
    figure, owners = needed("plotly.graph_objects").Figure(), []  # the state that each trace belongs to; -1: to all
    shared = view.solid and len({id(state.object) for state in view.states}) == 1
    if shared:  # one object at all radii is drawn once
        _add_surface(figure, view.states[0].object, "the object", STONE, 1.0)
        owners.append(-1)
    for number, state in enumerate(view.states):
        if view.solid:
            if not shared:
                _add_surface(figure, state.object, "the object", STONE, 1.0)
            _add_surface(figure, state.bound, view.bounds, BOUND, OPACITY)
        else:
            _add_pixels(figure, view, state)
        owners += [number] * (len(figure.data) - len(owners))
    seen = [[owner in (-1, number) for owner in owners] for number in range(len(view.states))]
    for trace, first in zip(figure.data, seen[0], strict=True):
        trace.visible = first
    if len(view.states) > 1:
        steps = [
            {"label": state.label, "method": "update", "args": [{"visible": visible}]}
            for state, visible in zip(view.states, seen, strict=True)
        ]
        figure.update_layout(sliders=[{"steps": steps, "currentvalue": {"prefix": f"{view.asked} "}}])
    figure.update_layout(margin={"t": 20}, height=700)
    names, (right, into, high) = view.names, VIEW
    if view.solid:
        eye = {"x": (high, right, into), "y": (right, high, -into), "z": (right, into, high)}[up]
        axes = {f"{axis}axis_title": name for axis, name in zip("xyz", names, strict=True)}
        camera = {"up": {axis: int(axis == up) for axis in "xyz"}, "eye": dict(zip("xyz", eye, strict=True))}
        figure.update_layout(scene={**axes, "aspectmode": "data", "camera": camera})
    else:
        right, high = (1, 0) if view.down else (0, 1)
        figure.update_xaxes(title=names[right])
        figure.update_yaxes(title=names[high], scaleanchor="x", scaleratio=view.stretch[high] / view.stretch[right])
        figure.update_yaxes(autorange="reversed" if view.down else True)
    facts = "\n".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in view.facts.items())
    plot = figure.to_html(full_html=False, include_plotlyjs=library or True, config={"displaylogo": False})
    return PAGE.format(title=escape(title), ink=INK, plot=plot, facts=facts)


def _add_surface(figure, surface, name: str, colour: str, opacity: float) -> None:
    """A surface with sharp edges, and no more triangles than a browser turns smoothly."""
    if surface.n_cells > MOST_TRIANGLES:
        surface = surface.clean().triangulate()
        surface = surface.decimate(1 - MOST_TRIANGLES / surface.n_cells)
    if surface.n_cells:
        surface = surface.compute_normals(split_vertices=True, feature_angle=EDGE, consistent_normals=False)
    corners = surface.regular_faces.astype(np.int32) if surface.n_cells else np.empty((0, 3), np.int32)
    axes = dict(zip("xyzijk", (*np.asarray(surface.points, np.float32).T, *corners.T), strict=True))
    figure.add_mesh3d(**axes, name=name, color=colour, opacity=opacity, showlegend=True, hoverinfo="skip")


def _add_pixels(figure, view: View, state: State) -> None:
    """Pixels of one state in a plane."""
    pixels = state.pixels(view.within)
    middles = _middles(view.lower, view.upper, pixels.shape)
    x, y = middles[::-1] if view.down else middles
    last = len(PIXEL_COLOURS) - 1
    scale = [[k / (last + 1), colour] for n, colour in enumerate(PIXEL_COLOURS) for k in (n, n + 1)]
    options = {"zmin": -0.5, "zmax": last + 0.5, "colorscale": scale, "showscale": False, "hoverinfo": "skip"}
    figure.add_heatmap(x=x, y=y, z=pixels if view.down else pixels.T, visible=True, **options)
