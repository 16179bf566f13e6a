"""A view on a pyvista plotter: what the window and the off-screen pictures have in common."""

import base64
import io
import json
import os
import subprocess
import sys
import tempfile
import textwrap
import zlib
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.errors import BoundingError
from warp_bounding.views.view import State, Surface, View, needed

__all__ = [
    "BOUND",
    "INK",
    "MISSED",
    "MOST_TRIANGLES",
    "OPACITY",
    "STONE",
    "UPS",
    "VIEW",
    "WINDOWS",
    "Drawn",
    "Placing",
    "Window",
    "aim",
    "check_display",
    "draw",
    "draw_with",
    "page",
    "picture",
    "pixels",
    "placing",
    "polygons",
    "show_points",
    "with_palette",
]

# --- off screen ------------------------------------------------------------------------------------------------------
#
# Drawing with pyvista in a process of its own, off-screen: no display is needed.
#
# Where there is no OpenGL, VTK does not raise an exception, it crashes; so a crash costs the pictures, not the program, and its complaints go
# to a log instead of the terminal. Without a display the process asks for EGL, then for OSMesa. A module of pictures has a
# ``draw(data, folder)`` that runs there.

SECONDS = 120  # for drawing
COLOURS = 256  # of a picture's palette
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
KEPT = "Everything else is complete."
PROGRAM = """
import importlib, pathlib, sys
import numpy
importlib.import_module(sys.argv[1]).draw(dict(numpy.load(sys.argv[2])), pathlib.Path(sys.argv[3]))
"""  # of the process that draws


class Drawn(NamedTuple):
    """The pictures that were drawn, and in one line why some were not."""

    paths: list[Path]
    problem: str = ""

    def lines(self) -> str:
        """For people."""
        told = [f"No pictures: {self.problem}. {KEPT}"] if self.problem else []
        return "\n".join([*(f"Picture: {path}" for path in self.paths), *told])


def draw_with(module: str, folder: Path, data: dict[str, np.ndarray], colours: int | None = COLOURS) -> Drawn:
    """Let a module draw.

    Args:
        module: Its name; ``draw(data, folder)`` in it writes PNG files into a folder, with pyvista.
        folder: Where they go; made if there is none. A picture is replaced only whole.
        data: Arrays by name.
        colours: Of each picture's palette; ``None`` for pictures as they were drawn.

    Returns:
        The pictures, or why there are none.
    """
    from PIL import Image

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    root = str(Path(__file__).resolve().parents[2])
    with tempfile.TemporaryDirectory(dir=folder, prefix=".drawing") as work:
        file, problem = Path(work) / "data.npz", ""
        np.savez(file, **data)
        for window in _windows():
            environment = {**os.environ, **window}
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
            command = [sys.executable, "-c", PROGRAM, module, str(file), work]
            try:
                done = subprocess.run(
                    command, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
                )
            except subprocess.TimeoutExpired:
                problem = problem or f"drawing took more than {SECONDS} s"
                continue
            made = sorted(Path(work).glob("*.png"))
            if done.returncode == 0 and made:
                for path in made if colours else ():
                    with_palette(Image.open(path), colours).save(path, optimize=True)
                return Drawn([path.replace(folder / path.name) for path in made])
            problem = problem or _reason(done)
    return Drawn([], problem)


def with_palette(image, colours: int = COLOURS):
    """A Pillow image with a palette, which makes its file a third as large, and no difference that one could see."""
    from PIL import Image

    return image.convert("RGB").quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)


def _windows() -> list[dict[str, str]]:
    """Environments to try: the user's own choice or display first."""
    if os.environ.get("VTK_DEFAULT_OPENGL_WINDOW") or not sys.platform.startswith("linux"):
        return [{}]
    off_screen = [{"VTK_DEFAULT_OPENGL_WINDOW": name, "DISPLAY": ""} for name in WINDOWS]
    return [{}, *off_screen] if os.environ.get("DISPLAY") else off_screen


def _reason(done: subprocess.CompletedProcess) -> str:
    """Why the drawing process failed, in a few words."""
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    if "No module named 'pyvista'" in done.stderr:
        return "pyvista is not installed (pip install 'warp-bounding[show]')"
    if done.returncode < 0 or "OpenGL" in done.stderr or "EGL" in done.stderr or "OSMesa" in done.stderr:
        return "this machine has no OpenGL for off-screen drawing (libEGL or libOSMesa)"
    return f"drawing failed ({lines[-1] if lines else f'status {done.returncode}'})"


Placing = Callable[[np.ndarray], np.ndarray]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
OPACITY = 0.3  # of the bound
POINT = 6.0  # pixels, of a point
UPS = {"x": 0, "y": 1, "z": 2}  # the axis that is up in pictures
ANGLE = 28.0  # of the view, degrees
EDGE = (
    30.0  # degrees between two triangles from which they meet in an edge, rather than being parts of one curved surface
)
NEAR = 0.86  # of the distance from which the ball around what is seen fills the picture
VIEW = (-0.45, -1.0, 0.4)  # towards the camera: to the right, into the picture, up


def placing(view: View, up: str) -> Placing:
    """Where points of a view are put: a function from ``(N, k)`` to ``(N, 3)`` float64.

    Args:
        view: Of space, or of a plane, which lies at z = 0.
        up: The axis that becomes z, a name in ``UPS``; of a view of space.
    """
    axis, stretch = UPS[up], np.asarray(view.stretch)

    def of_space(points: np.ndarray) -> np.ndarray:
        x, y, z = np.asarray(points, dtype=np.float64).T
        return np.stack(((y, z, x), (x, -z, y), (x, y, z))[axis], axis=1)

    def of_plane(points: np.ndarray) -> np.ndarray:
        a, b = (np.asarray(points, dtype=np.float64) * stretch).T
        x, y = (b, -a) if view.down else (a, b)
        return np.stack([x, y, np.zeros(len(x))], axis=1)

    return of_space if view.solid else of_plane


def polygons(surface: Surface, place: Placing):
    """A pyvista mesh of a surface, put in its place, with sharp edges where it has some; ``None`` where it is empty."""
    pyvista = needed("pyvista")
    if not len(surface.faces):
        return None
    faces = np.insert(surface.faces, 0, 3, axis=1).reshape(-1)
    found = pyvista.PolyData(place(surface.vertices), faces)
    return found.compute_normals(
        split_vertices=True, feature_angle=EDGE, consistent_normals=False, auto_orient_normals=False
    )


def pixels(view: View, state: State, place: Placing, layers: tuple[str, ...] = ("object", "bound")):
    """A picture of a plane as a pyvista image of coloured cells."""
    pyvista = needed("pyvista")
    colours = coloured(view, state, layers)
    if view.down:
        colours = colours.transpose(1, 0, 2)[:, ::-1]
    count = np.array(colours.shape[:2])
    corners = place(np.stack([view.lower, view.upper]))
    lower, size = corners.min(axis=0), (corners.max(axis=0) - corners.min(axis=0))[:2] / count
    image = pyvista.ImageData(dimensions=(*(count + 1), 1), spacing=(*size, 1.0), origin=tuple(lower))
    image.cell_data["colour"] = colours.reshape(-1, 3, order="F")
    return image


def coloured(view: View, state: State, layers: tuple[str, ...]) -> np.ndarray:
    """``(X, Y, 3)`` uint8: the pixels of a plane."""
    bound = state.bound if "bound" in layers else np.zeros_like(state.bound)
    body = state.object if "object" in layers else np.zeros_like(bound)
    colours = np.full((*bound.shape, 3), 255, dtype=np.uint8)
    first, second = ((body, STONE), (bound, BOUND)) if view.within else ((bound, BOUND), (body, STONE))
    for mask, colour in (first, second):
        colours[mask] = _rgb(colour)
    colours[state.missed(view.within)] = _rgb(MISSED)
    return colours


def _rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def show_points(plotter, view: View, state: State, place: Placing, shown: dict[str, bool]) -> None:
    """Add the groups of points that are shown, and take away the others."""
    pyvista = needed("pyvista")
    for group in view.groups:
        points = state.points[group.name]
        if not shown.get(group.name, group.shown) or not len(points):
            plotter.remove_actor(group.name, render=False)
            continue
        options: dict[str, Any] = {
            "color": group.colour,
            "point_size": POINT,
            "render_points_as_spheres": True,
            "lighting": False,
        }
        plotter.add_mesh(pyvista.PolyData(place(points)), name=group.name, **options)


def aim(plotter, view: View, place: Placing) -> None:
    """Lights, and a camera that sees all of a view."""
    pyvista = needed("pyvista")
    corners = place(np.stack([view.lower, view.upper]))
    middle, size = corners.mean(axis=0), np.abs(corners[1] - corners[0])
    if not view.solid:
        plotter.view_xy()
        plotter.camera.parallel_projection = True
        plotter.camera.focal_point, plotter.camera.position = middle, middle + np.array([0, 0, size.max()])
        width, height = plotter.renderer.GetSize()
        plotter.camera.parallel_scale = max(size[1], size[0] * height / max(width, 1)) / 2 * 1.12
        plotter.reset_camera_clipping_range()
        return
    radius = np.linalg.norm(size) / 2
    plotter.remove_all_lights()
    for source, strength in (((-3, -5, 6), 0.75), ((5, -3, 2), 0.3), ((0, 4, 5), 0.3)):
        at = tuple(middle + radius * np.array(source))
        plotter.add_light(
            pyvista.Light(position=at, focal_point=tuple(middle), intensity=strength, light_type="scene light")
        )
    away = np.array(VIEW) / np.linalg.norm(VIEW) * radius / np.sin(np.radians(ANGLE) / 2) * NEAR
    plotter.camera.focal_point, plotter.camera.position = tuple(middle), tuple(middle + away)
    plotter.camera.up, plotter.camera.view_angle = (0, 0, 1), ANGLE


# --- picture ---------------------------------------------------------------------------------------------------------
#
# Off-screen pictures of a view: a panel for each radius or time, drawn in a process of its own (``off_screen``).

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


# --- window ----------------------------------------------------------------------------------------------------------
#
# A window on a view: turn it with the mouse, slide through radii or times, drag a plane that cuts the bound open, tick what is shown.

SIZE = (1200, 900)  # pixels
BOX, FIRST, STEP = 22, 20, 34  # pixels: a tick box, where the first begins, and from one to the next
LETTERS_OF_WINDOW = 110  # of a line of text
OPENED = 0.85  # opacity of a bound that is cut open


def check_display() -> None:
    """Refuse where there is no display to open a window on, rather than let VTK crash.

    Raises:
        BoundingError: Saying what works without one.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise BoundingError("there is no display for a window: expected --screenshot FILE.png or --html FILE.html")


class Window:
    """A window, not yet open.

    Args:
        view: What is seen.
        title: Of the window.
        up: The axis that is up, a name in ``UPS``; of a view in space.
        off_screen: Draw where nobody sees it, for tests.

    Raises:
        BoundingError: If pyvista is missing.
    """

    def __init__(self, view: View, title: str, up: str, *, off_screen: bool = False):
        pyvista = needed("pyvista")
        self.view, self.place, self.number = view, placing(view, up), 0
        self.shown = {"object": True, "bound": True, **{g.name: g.shown for g in view.groups}}
        self.plane: tuple[np.ndarray, np.ndarray] | None = None  # normal and origin of the cut
        self.plotter = pyvista.Plotter(window_size=SIZE, title=title, off_screen=off_screen)
        self.plotter.set_background("white")
        if view.solid:
            self.plotter.enable_depth_peeling(8)
            self.plotter.enable_anti_aliasing("fxaa")  # with samples of pixels nothing that is peeled is drawn
        self.draw()
        aim(self.plotter, view, self.place)
        self._controls()

    def open(self) -> None:
        """Show the window until it is closed."""
        self.plotter.show()

    def draw(self) -> None:
        """Draw what is shown by now."""
        view, plotter, state = self.view, self.plotter, self.view.states[self.number]
        if view.solid:
            self._add("object", polygons(state.object, self.place), STONE, 1.0)
            self._add("bound", self._bound(), BOUND, OPACITY if self.plane is None else OPENED)
        else:
            layers = tuple(name for name in ("object", "bound") if self.shown[name])
            plotter.add_mesh(
                pixels(view, state, self.place, layers), scalars="colour", rgb=True, lighting=False, name="pixels"
            )
        show_points(plotter, view, state, self.place, self.shown)
        at = f"{view.asked} {state.label}: " if state.label else ""
        text = "\n".join(
            [*textwrap.wrap(f"{at}{state.rates}", LETTERS_OF_WINDOW), *textwrap.wrap(view.brief, LETTERS_OF_WINDOW)]
        )
        plotter.add_text(text, position="upper_left", font_size=11, color=INK, name="rates")

    def toggle(self, name: str, shown: bool) -> None:
        """Show something, or hide it: ``object``, ``bound`` or a group of points."""
        self.shown[name] = bool(shown)
        self.draw()

    def go(self, number: float) -> None:
        """Go to the state that is nearest to a number."""
        nearest = round(float(number))
        if nearest != self.number:
            self.number = nearest
            self.draw()

    def cut(self, normal, origin) -> None:
        """Cut the bound by a plane, and show what lies on its normal's side."""
        self.plane = np.asarray(normal, dtype=float), np.asarray(origin, dtype=float)
        self.draw()

    def _bound(self):
        bound = polygons(self.view.states[self.number].bound, self.place)
        if bound is None or self.plane is None:
            return bound
        return bound.clip(tuple(-self.plane[0]), origin=tuple(self.plane[1]))

    def _add(self, name: str, surface, colour: str, opacity: float) -> None:
        if surface is None or not surface.n_cells or not self.shown[name]:
            self.plotter.remove_actor(name, render=False)
            return
        options = {"smooth_shading": True, "ambient": 0.3, "specular": 0.2, "reset_camera": False}
        self.plotter.add_mesh(surface, color=colour, opacity=opacity, name=name, **options)

    def _controls(self) -> None:
        view, plotter = self.view, self.plotter
        bound = "certainly inside" if view.within else "the bound: maybe"
        listed = [("object", "the object", STONE), ("bound", bound, BOUND)]
        listed += [(group.name, group.text, group.colour) for group in view.groups]
        ticks = [(text, colour, self.shown[name], partial(self.toggle, name)) for name, text, colour in listed]
        if view.solid:
            ticks.append(("a plane that cuts the bound", INK, False, self._cutting))
        for place, (text, colour, shown, tell) in enumerate(reversed(ticks)):
            high = FIRST + STEP * place
            options = {"value": shown, "position": (FIRST, high), "size": BOX, "border_size": 2}
            plotter.add_checkbox_button_widget(tell, **options, color_on=colour, color_off="white")
            plotter.add_text(text, position=(FIRST + BOX + 10, high), font_size=10, color=INK)
        if len(view.states) > 1:
            last = len(view.states) - 1
            options = {"title": f"{view.asked} {view.states[0].label} to {view.states[last].label}", "color": INK}
            plotter.add_slider_widget(
                self.go,
                rng=(0, last),
                value=0,
                pointa=(0.55, 0.08),
                pointb=(0.95, 0.08),
                fmt="",
                style="modern",
                **options,
            )

    def _cutting(self, on: bool) -> None:
        """Add the plane that cuts, or take it away."""
        if not on:
            self.plotter.clear_plane_widgets()
            self.plane = None
            self.draw()
            return
        middle = self.place(((self.view.lower + self.view.upper) / 2)[None])[0]
        corners = self.place(np.stack([self.view.lower, self.view.upper]))
        bounds = np.sort(corners, axis=0).T.reshape(-1).tolist()
        self.plotter.add_plane_widget(
            self.cut, normal=(0, 1, 0), origin=tuple(middle), color=INK, bounds=bounds, factor=1.0
        )


# --- page ------------------------------------------------------------------------------------------------------------
#
# One self-contained web page of a view, which turns with the mouse and needs no network: plotly.js comes from the installed plotly.
#
# Surfaces are stored as 16-bit numbers between the corners of what is seen, compressed; pictures of a plane as PNG.

MOST_TRIANGLES = 60_000  # of a surface; one with more is simplified
CUTS = (2, 2, 1)  # by the axis that is up: the axis along which the camera looks the most
DISTANCE = 1.7  # of the camera from the middle, in plotly's units: about the sides of what is seen


def page(view: View, title: str, up: str) -> str:
    """A page of a view.

    Args:
        view: What is seen.
        title: Its heading.
        up: The axis that is up, a name in ``UPS``; of a view in space.

    Raises:
        BoundingError: If a package is missing.
    """
    library = needed("plotly.offline").get_plotlyjs()
    surfaces: list[dict[str, str]] = []
    numbers: dict[int, int] = {}  # of surfaces that several states have, by identity

    def number_of(surface: Surface) -> int:
        if id(surface) not in numbers:
            numbers[id(surface)] = len(surfaces)
            surfaces.append(_packed(view, surface))
        return numbers[id(surface)]

    told = {
        "names": view.names,
        "lower": view.lower.tolist(),
        "upper": view.upper.tolist(),
        "solid": view.solid,
        "asked": view.asked,
        "within": view.within,
        "down": view.down,
        "stretch": list(view.stretch),
        "up": UPS[up],
        "cut": CUTS[UPS[up]],
        "eye": _eye(UPS[up]),
        "colours": {"object": STONE, "bound": BOUND},
        "groups": [group._asdict() for group in view.groups],
        "states": [_state(view, state, number_of) for state in view.states],
        "surfaces": surfaces,
    }
    return _template("page.html").substitute(
        title=escape(title),
        style=_template("page.css").template,
        facts="\n".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in view.facts.items()),
        library=library,
        view=json.dumps(told, allow_nan=False).replace("</", "<\\/"),
        program=_template("page.js").template,
    )


def _template(name: str) -> Template:
    return Template((files("warp_bounding.views") / "templates" / name).read_text(encoding="utf-8"))


def _state(view: View, state: State, number_of) -> dict[str, Any]:
    about: dict[str, Any] = {"label": state.label, "rates": state.rates, "fn": state.fn}
    about["points"] = {name: _places(view, points) for name, points in state.points.items()}
    about["counts"] = {name: len(points) for name, points in state.points.items()}
    if view.solid:
        return about | {"object": number_of(state.object), "bound": number_of(state.bound)}
    layers = {"object": (state.object, STONE), "bound": (state.bound, BOUND)}
    layers["missed"] = (state.missed(view.within), MISSED)
    return about | {
        "pictures": {
            name: _png(mask if view.down else np.rot90(mask), colour) for name, (mask, colour) in layers.items()
        }
    }


def _eye(up: int) -> dict[str, float]:
    """Where the camera stands, in plotly's units, seen from the middle; as in pictures."""
    right, into, high = np.array(VIEW) / np.linalg.norm(VIEW) * DISTANCE
    turned = {0: (high, right, into), 1: (right, high, -into), 2: (right, into, high)}[up]
    return dict(zip("xyz", map(float, turned), strict=True))


def _packed(view: View, surface: Surface) -> dict[str, str]:
    """A surface with split edges, so that these look sharp, and no more triangles than a browser turns smoothly."""
    found = polygons(surface, np.asarray)
    if found is None:
        return {"vertices": _deflated(np.empty(0, "<u2")), "faces": _deflated(np.empty(0, "<u4"))}
    if found.n_cells > MOST_TRIANGLES:
        whole = found.clean().triangulate()
        simple = whole.decimate(1 - MOST_TRIANGLES / whole.n_cells)
        found = polygons(Surface(np.asarray(simple.points, np.float64), simple.regular_faces), np.asarray)
    faces = found.regular_faces.astype("<u4")
    return {"vertices": _places(view, np.asarray(found.points)), "faces": _deflated(np.ascontiguousarray(faces.T))}


def _places(view: View, points: np.ndarray) -> str:
    """Points ``(N, k)`` as 16-bit numbers between the corners of what is seen, axis by axis."""
    shares = (points - view.lower) / (view.upper - view.lower)
    return _deflated(np.ascontiguousarray(np.rint(np.clip(shares, 0, 1) * 65535).astype("<u2").T))


def _deflated(values: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode()


def _png(mask: np.ndarray, colour: str) -> str:
    """Rows of a mask as a picture, clear where it is false."""
    image = needed("PIL.Image").fromarray(np.ascontiguousarray(mask).astype(np.uint8), mode="P")
    image.putpalette([0, 0, 0, *(int(colour[k : k + 2], 16) for k in (1, 3, 5))])
    content = io.BytesIO()
    image.save(content, "png", transparency=0, optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode()
