"""How a view is shown: a picture drawn off-screen, or one self-contained web page."""

import base64
import io
import json
import os
import pickle
import re
import subprocess
import sys
import tempfile
import textwrap
import zlib
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.errors import BoundingError
from warp_bounding.views.view import State, View, needed

__all__ = ["UPS", "Drawn", "draw", "draw_with", "page", "picture", "with_palette"]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
UPS = {"x": 0, "y": 1, "z": 2}  # the axis that is up in pictures
VIEW = (-0.45, -1.0, 0.4)  # towards the camera: to the right, into the picture, up

# --- drawing in a process of its own ---------------------------------------------------------------------------------
#
# Where there is no OpenGL, VTK raises no exception but crashes: in a process of its own a crash costs the pictures, not
# the program. No display is needed: the process asks for EGL, then for OSMesa.

SECONDS = 120  # for drawing
COLOURS = 256  # of a picture's palette
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
PROGRAM = """
import importlib, pathlib, sys
import numpy
importlib.import_module(sys.argv[1]).draw(dict(numpy.load(sys.argv[2])), pathlib.Path(sys.argv[3]))
"""


class Drawn(NamedTuple):
    """The pictures that were drawn, and in one line why some were not."""

    paths: list[Path]
    problem: str = ""

    def lines(self) -> str:
        """For people."""
        reported = [f"No pictures: {self.problem}. Everything else is complete."] if self.problem else []
        return "\n".join([*(f"Picture: {path}" for path in self.paths), *reported])


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

    folder, root = Path(folder), str(Path(__file__).resolve().parents[2])
    folder.mkdir(parents=True, exist_ok=True)
    paths = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryDirectory(dir=folder, prefix=".drawing") as work:
        file, problem = Path(work) / "data.npz", ""
        np.savez(file, **data)
        command = [sys.executable, "-c", PROGRAM, module, str(file), work]
        for window in _windows():
            environment = {**os.environ, **window, "PYTHONPATH": paths}
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
    """A Pillow image with a palette: a third of the bytes, and no difference that one could see."""
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
    if "No module named 'pyvista'" in done.stderr:
        return "pyvista is not installed (pip install 'warp-bounding[show]')"
    if done.returncode < 0 or any(name in done.stderr for name in ("OpenGL", "EGL", "OSMesa")):
        return "this machine has no OpenGL for off-screen drawing (libEGL or libOSMesa)"
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return f"drawing failed ({lines[-1] if lines else f'status {done.returncode}'})"


# --- a picture -------------------------------------------------------------------------------------------------------

OPACITY, OPENED = 0.3, 0.9  # of the bound, whole and cut open
SMOOTH = {"smooth_shading": True, "ambient": 0.3}  # of surfaces
EDGE = 30.0  # degrees between two triangles from which they meet in an edge, and are no parts of one curved surface
ANGLE, NEAR = 28.0, 0.86  # degrees, of the view; the camera's distance, of that from which a ball fills the picture
LIGHTS = (((-3, -5, 6), 0.75), ((5, -3, 2), 0.3), ((0, 4, 5), 0.3))  # where, in radii of that ball; how strong
PANEL, MOST_COLUMNS, LETTERS = 760, 3, 72  # pixels of a panel's sides; panels side by side; letters of a line in one


def picture(view: View, title: str, up: str, cut: str | None = None) -> bytes:
    """A PNG of a view: a panel for each of its states, drawn in a process of its own.

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
    with tempfile.TemporaryDirectory() as folder:
        data = {"view": np.frombuffer(pickle.dumps((view, title, up, cut)), np.uint8)}
        drawn = draw_with(__spec__.name, Path(folder), data)
        if not drawn.paths:
            raise BoundingError(f"no picture: {drawn.problem}; --html needs no OpenGL here")
        return drawn.paths[0].read_bytes()


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw what ``picture`` sends, as ``view.png`` into a folder."""
    import pyvista

    view, title, up, cut = pickle.loads(data["view"].tobytes())
    columns = min(len(view.states), MOST_COLUMNS)
    rows = -(-len(view.states) // columns)
    size = (PANEL * columns, PANEL * rows)
    plotter = pyvista.Plotter(off_screen=True, shape=(rows, columns), window_size=size, border=False)
    for number in range(rows * columns):
        plotter.subplot(number // columns, number % columns)
        plotter.set_background("white")
        if number >= len(view.states):
            continue
        state = view.states[number]
        if view.solid:
            _draw_solid(plotter, view, state, UPS[up], cut)
        else:
            _draw_plane(plotter, view, state)
        plotter.enable_anti_aliasing("ssaa")
        at = f", {view.asked} {state.label}" if state.label else ""
        below = "\n".join(line for text in (state.rates, view.brief) for line in textwrap.wrap(text, LETTERS))
        plotter.add_text(title + at, position=(0.03, 0.945), viewport=True, font_size=13, color=INK)
        plotter.add_text(below, position=(0.03, 0.015), viewport=True, font_size=10, color=INK)
    plotter.screenshot(str(folder / "view.png"))
    plotter.close()


def _draw_solid(plotter, view: View, state: State, up: int, cut: str | None) -> None:
    """Object, bound and wrong points of one state in space, seen from the front."""
    import pyvista

    def place(points: np.ndarray) -> np.ndarray:  # turned so that ``up`` is z
        x, y, z = np.asarray(points, dtype=np.float64).T
        return np.stack(((y, z, x), (x, -z, y), (x, y, z))[up], axis=1)

    def surface(of):
        found = of.copy()
        found.points = place(of.points)
        return _with_edges(found)

    def add(mesh, **options) -> None:
        if mesh.n_points:
            plotter.add_mesh(mesh, reset_camera=False, **options)

    corners = place(np.stack([view.lower, view.upper]))
    middle, radius = corners.mean(axis=0), np.linalg.norm(corners[1] - corners[0]) / 2
    bound, opacity = surface(state.bound), OPACITY
    if cut is not None and bound.n_cells:
        normal = place(np.eye(3)[[UPS[cut]]])[0]
        normal = normal if normal @ VIEW > 0 else -normal  # the side of the camera is cut away
        bound, opacity = bound.clip(tuple(normal), origin=tuple(middle)), OPENED
    plotter.enable_depth_peeling(8)
    add(surface(state.object), color=STONE, **SMOOTH | {"ambient": 0.25, "specular": 0.1})
    add(bound, color=BOUND, opacity=opacity, specular=0.4, specular_power=30, **SMOOTH)
    for group in (group for group in view.groups if group.shown):
        dots = {"point_size": 6.0, "render_points_as_spheres": True, "lighting": False}
        add(pyvista.PolyData(place(state.points[group.name])), color=group.colour, **dots)
    plotter.remove_all_lights()
    for source, strength in LIGHTS:
        light = {"focal_point": tuple(middle), "intensity": strength, "light_type": "scene light"}
        plotter.add_light(pyvista.Light(position=tuple(middle + radius * np.array(source)), **light))
    away = np.array(VIEW) / np.linalg.norm(VIEW) * radius / np.sin(np.radians(ANGLE) / 2) * NEAR
    camera = plotter.camera
    camera.focal_point, camera.position = tuple(middle), tuple(middle + away)
    camera.up, camera.view_angle = (0, 0, 1), ANGLE


def _draw_plane(plotter, view: View, state: State) -> None:
    """Pixels of one state in a plane, as an image of coloured cells."""
    import pyvista

    layers = [(state.bound, BOUND), (state.object, STONE)][:: -1 if view.within else 1]
    colours = np.full((*state.bound.shape, 3), 255, dtype=np.uint8)
    for mask, colour in (*layers, (state.missed(view.within), MISSED)):
        colours[mask] = _rgb(colour)
    size = (view.upper - view.lower) * view.stretch
    if view.down:
        colours, size = colours.transpose(1, 0, 2)[:, ::-1], size[::-1]
    count = np.array(colours.shape[:2])
    image = pyvista.ImageData(dimensions=(*(count + 1), 1), spacing=(*(size / count), 1.0))
    image.cell_data["colour"] = colours.reshape(-1, 3, order="F")
    plotter.add_mesh(image, scalars="colour", rgb=True, lighting=False)
    plotter.view_xy()
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = size.max() / 2 * 1.12


def _rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def _with_edges(surface):
    """A ``pyvista.PolyData`` whose vertices at sharp edges are split, so that these look sharp."""
    if not surface.n_cells:
        return surface
    options = {"consistent_normals": False, "auto_orient_normals": False}
    return surface.compute_normals(split_vertices=True, feature_angle=EDGE, **options)


# --- a web page ------------------------------------------------------------------------------------------------------
#
# It turns with the mouse and needs no network: plotly.js comes from the installed plotly. Surfaces are stored as 16-bit
# numbers between the corners of what is seen, compressed; pictures of a plane as PNG.

MOST_TRIANGLES = 60_000  # of a surface; one with more is simplified
CUTS = (2, 2, 1)  # by the axis that is up: the axis along which the camera looks the most
DISTANCE = 1.7  # of the camera from the middle, in plotly's units: about the sides of what is seen


def page(view: View, title: str, up: str, library: str | None = None) -> str:
    """A page of a view.

    Args:
        view: What is seen.
        title: Its heading.
        up: The axis that is up, a name in ``UPS``; of a view in space.
        library: Address of plotly.js, for a page that does not hold it.

    Raises:
        BoundingError: If a package is missing.
    """
    surfaces: dict[int, int] = {}  # numbers of surfaces, which several states can share, by identity
    packed: list[dict[str, str]] = []

    def number_of(surface) -> int:
        if id(surface) not in surfaces:
            surfaces[id(surface)] = len(packed)
            packed.append(_packed(view, surface))
        return surfaces[id(surface)]

    def about(state: State) -> dict[str, Any]:
        reported = {"label": state.label, "rates": state.rates, "fn": state.fn}
        reported["points"] = {name: _places(view, points) for name, points in state.points.items()}
        reported["counts"] = {name: len(points) for name, points in state.points.items()}
        if view.solid:
            return reported | {"object": number_of(state.object), "bound": number_of(state.bound)}
        layers = {"object": (state.object, STONE), "bound": (state.bound, BOUND)}
        layers["missed"] = (state.missed(view.within), MISSED)
        return reported | {"pictures": {name: _png(view, mask, colour) for name, (mask, colour) in layers.items()}}

    names = ("names", "solid", "asked", "within", "down", "stretch")
    right, into, high = np.array(VIEW) / np.linalg.norm(VIEW) * DISTANCE
    eye = ((high, right, into), (right, high, -into), (right, into, high))[UPS[up]]  # the camera, as in pictures
    reported = {name: getattr(view, name) for name in names} | {"up": UPS[up], "cut": CUTS[UPS[up]]}
    reported |= {"lower": view.lower.tolist(), "upper": view.upper.tolist(), "eye": dict(zip("xyz", eye, strict=True))}
    reported |= {"colours": {"object": STONE, "bound": BOUND}, "groups": [group._asdict() for group in view.groups]}
    reported |= {"states": [about(state) for state in view.states], "surfaces": packed}
    facts = "\n".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in view.facts.items())
    parts = {"title": escape(title), "facts": facts, "library": ""}
    if library is None:
        parts["library"] = f"<script>\n{needed('plotly.offline').get_plotlyjs()}\n</script>"
    else:
        parts["library"] = f'<script src="{escape(library)}"></script>'
    parts["view"] = json.dumps(reported, allow_nan=False).replace("</", "<\\/")
    template = (files("warp_bounding.views") / "page.html").read_text(encoding="utf-8")
    return re.sub(r"@(title|facts|library|view)@", lambda found: parts[found[1]], template)


def _packed(view: View, surface) -> dict[str, str]:
    """A surface with sharp edges, and no more triangles than a browser turns smoothly."""
    found = _with_edges(surface)
    if found.n_cells > MOST_TRIANGLES:
        whole = found.clean().triangulate()
        found = _with_edges(whole.decimate(1 - MOST_TRIANGLES / whole.n_cells))
    faces = found.regular_faces.astype("<u4") if found.n_cells else np.empty((0, 3), "<u4")
    return {"vertices": _places(view, np.asarray(found.points)), "faces": _deflated(faces.T)}


def _places(view: View, points: np.ndarray) -> str:
    """Points ``(N, k)`` as 16-bit numbers between the corners of what is seen, axis by axis."""
    shares = (points - view.lower) / (view.upper - view.lower)
    return _deflated(np.rint(np.clip(shares, 0, 1) * 65535).astype("<u2").T)


def _deflated(values: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode()


def _png(view: View, mask: np.ndarray, colour: str) -> str:
    """A plane's mask as a picture, clear where it is false."""
    rows = np.ascontiguousarray(mask if view.down else np.rot90(mask)).astype(np.uint8)
    image, content = needed("PIL.Image").fromarray(rows, mode="P"), io.BytesIO()
    image.putpalette([0, 0, 0, *_rgb(colour)])
    image.save(content, "png", transparency=0, optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode()
