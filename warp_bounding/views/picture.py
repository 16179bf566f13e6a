"""Off-screen pictures of a view: a panel for each radius or time, drawn in a process of its own (``off_screen``)."""

import json
import tempfile
import textwrap
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from warp_bounding.errors import BoundingError
from warp_bounding.views.needed import needed
from warp_bounding.views.off_screen import draw_with
from warp_bounding.views.stage import (
    BOUND,
    INK,
    OPACITY,
    STONE,
    UPS,
    VIEW,
    Placing,
    aim,
    pixels,
    placing,
    polygons,
    show_points,
)
from warp_bounding.views.surfaces import Surface
from warp_bounding.views.view import State, View

__all__ = ["draw", "picture"]

PICTURE = "view.png"
PANEL, MOST_COLUMNS = (760, 760), 3  # pixels of a panel; panels side by side
TOLD = ("names", "asked", "down", "stretch", "within", "indicator", "facts")  # of a view, what is no array
LETTERS = 72  # of a line of text in a panel


def picture(view: View, title: str, up: str, cut: str | None = None) -> bytes:
    """A PNG of a view.

    Args:
        view: What is seen.
        title: Its heading.
        up: The axis that is up, a name in ``UPS``; of a view in space.
        cut: The axis at right angles to which the bound is cut open in the middle, or ``None``.

    Raises:
        BoundingError: If a package is missing, or this machine cannot draw.
    """
    needed("pyvista")
    needed("PIL")
    told = {"title": title, "up": up, "cut": None if cut is None else UPS[cut], **_told(view)}
    data = {"told": np.array(json.dumps(told)), "lower": view.lower, "upper": view.upper}
    for number, state in enumerate(view.states):
        for name in ("bound", "object"):
            shown = getattr(state, name)
            parts = shown._asdict() if isinstance(shown, Surface) else {"pixels": shown}
            data |= {f"{number}.{name}.{part}": value for part, value in parts.items()}
        data |= {f"{number}.{name}": points for name, points in state.points.items()}
    with tempfile.TemporaryDirectory() as folder:
        drawn = draw_with(__spec__.name, Path(folder), data)
        if not drawn.paths:
            raise BoundingError(f"no picture: {drawn.problem}; --html needs no OpenGL here")
        return drawn.paths[0].read_bytes()


def _told(view: View) -> dict:
    """What of a view is no array."""
    states = []
    for state in view.states:
        states.append(asdict(replace(state, bound=None, object=None, points={})) | {"points": list(state.points)})
    return {**{name: getattr(view, name) for name in TOLD}, "states": states}


def _view(data: dict[str, np.ndarray], told: dict) -> View:
    """Inverse of what ``picture`` sends."""

    def seen(number: int, name: str) -> Surface | np.ndarray:
        start = f"{number}.{name}."
        if start + "pixels" in data:
            return data[start + "pixels"]
        return Surface(data[start + "vertices"], data[start + "faces"])

    states = []
    for number, each in enumerate(told["states"]):
        points = {name: data[f"{number}.{name}"] for name in each.pop("points")}
        states.append(
            State(**{**each, "bound": seen(number, "bound"), "object": seen(number, "object"), "points": points})
        )
    return View(lower=data["lower"], upper=data["upper"], states=states, **{name: told[name] for name in TOLD})


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw ``view.png`` into a folder, from what ``picture`` sends."""
    import pyvista

    told = json.loads(str(data["told"]))
    view = _view(data, told)
    place, count = placing(view, told["up"]), len(view.states)
    columns = min(count, MOST_COLUMNS)
    rows = -(-count // columns)
    size = (PANEL[0] * columns, PANEL[1] * rows)
    plotter = pyvista.Plotter(off_screen=True, shape=(rows, columns), window_size=size, border=False)
    for number, state in enumerate(view.states):
        plotter.subplot(number // columns, number % columns)
        plotter.set_background("white")
        add(plotter, view, state, place, told["cut"])
        aim(plotter, view, place)
        plotter.enable_anti_aliasing("ssaa")
        text = f"{view.asked} {state.label}" if state.label else ""
        heading = told["title"] + (f", {text}" if text else "")
        plotter.add_text(heading, position=(0.03, 0.945), viewport=True, font_size=13, color=INK)
        lines = "\n".join([*textwrap.wrap(state.rates, LETTERS), *textwrap.wrap(view.brief, LETTERS)])
        plotter.add_text(lines, position=(0.03, 0.015), viewport=True, font_size=10, color=INK)
    for number in range(count, rows * columns):
        plotter.subplot(number // columns, number % columns)
        plotter.set_background("white")
    plotter.screenshot(str(folder / PICTURE))
    plotter.close()


def add(plotter, view: View, state: State, place: Placing, cut: int | None) -> None:
    """Add object, bound and points to a panel."""
    if not view.solid:
        plotter.add_mesh(pixels(view, state, place), scalars="colour", rgb=True, lighting=False)
    else:
        body, bound = polygons(state.object, place), polygons(state.bound, place)
        if body is not None:
            plotter.add_mesh(body, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        if bound is not None and cut is not None:
            bound = _opened(view, bound, place, cut)
        if bound is not None and bound.n_cells:
            plotter.enable_depth_peeling(8)
            options = {"smooth_shading": True, "ambient": 0.3, "specular": 0.4, "specular_power": 30}
            plotter.add_mesh(bound, color=BOUND, opacity=OPACITY if cut is None else 0.9, **options)
    show_points(plotter, view, state, place, {})


def _opened(view: View, bound, place: Placing, cut: int):
    """The half of a bound that lies behind the middle of the object, as the camera looks."""
    normal = place(np.eye(3)[[cut]])[0]
    middle = place(((view.lower + view.upper) / 2)[None])[0]
    towards = normal if normal @ VIEW > 0 else -normal
    return bound.clip(tuple(towards), origin=tuple(middle))
