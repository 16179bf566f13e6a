"""How a view is shown: a picture drawn off-screen, or one self-contained web page."""

import os
import pickle
import subprocess
import sys
import tempfile
import textwrap
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from warp_bounding.errors import BoundingError
from warp_bounding.views.view import State, View, needed

__all__ = ["UPS", "Drawn", "draw", "draw_with", "page", "picture", "with_palette"]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
PIXEL_COLOURS = ("#ffffff", BOUND, STONE, MISSED)  # by ``State.pixels``
UPS = "xyz"  # the axis that is up in pictures
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
EDGE = 30.0  # degrees between two triangles from which they meet in an edge, and are no parts of one curved surface
PANEL, MOST_COLUMNS, LETTERS = 760, 3, 72  # pixels of a panel's sides; panels side by side; letters of a line in one


def eye_of(up: str) -> np.ndarray:
    """The direction from the middle of what is seen to the camera."""
    right, into, high = VIEW
    return np.array({"x": (high, right, into), "y": (right, high, -into), "z": (right, into, high)}[up])


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
    plotter.set_background("white", all_renderers=True)
    for number, state in enumerate(view.states):
        plotter.subplot(number // columns, number % columns)
        if view.solid:
            _draw_solid(plotter, view, state, up, cut)
        else:
            _draw_plane(plotter, view, state)
        plotter.enable_anti_aliasing("ssaa")
        at = f", {view.asked} {state.label}" if state.label else ""
        below = "\n".join(line for text in (state.rates, view.brief) for line in textwrap.wrap(text, LETTERS))
        plotter.add_text(title + at, position=(0.03, 0.945), viewport=True, font_size=13, color=INK)
        plotter.add_text(below, position=(0.03, 0.015), viewport=True, font_size=10, color=INK)
    plotter.screenshot(str(folder / "view.png"))
    plotter.close()


def _draw_solid(plotter, view: View, state: State, up: str, cut: str | None) -> None:
    """Object, bound and wrong points of one state in space, seen from the front."""
    bound, opacity, eye = state.bound, OPACITY, eye_of(up)
    if cut is not None and bound.n_cells:
        normal = np.eye(3)[UPS.index(cut)]
        normal *= np.sign(normal @ eye)  # the side of the camera is cut away
        bound, opacity = bound.clip(tuple(normal), origin=tuple((view.lower + view.upper) / 2)), OPENED
    smooth = {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": EDGE, "ambient": 0.3}
    plotter.enable_depth_peeling(8)
    for surface, options in ((state.object, {"color": STONE}), (bound, {"color": BOUND, "opacity": opacity})):
        if surface.n_points:
            plotter.add_mesh(surface, specular=0.2, **options, **smooth)
    for group in view.groups:
        if group.shown and len(state.points[group.name]):
            plotter.add_points(state.points[group.name], color=group.colour, point_size=6.0, lighting=False)
    bounds = np.stack([view.lower, view.upper], axis=1).ravel()  # all panels at the same scale
    plotter.view_vector(tuple(eye), viewup=tuple(np.eye(3)[UPS.index(up)]), bounds=tuple(bounds))
    plotter.camera.zoom(1.2)


def _draw_plane(plotter, view: View, state: State) -> None:
    """Pixels of one state in a plane, as an image of coloured cells."""
    import pyvista

    colours = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in PIXEL_COLOURS], np.uint8)
    pixels, size = colours[state.pixels(view.within)], (view.upper - view.lower) * view.stretch
    if view.down:
        pixels, size = pixels.transpose(1, 0, 2)[:, ::-1], size[::-1]
    count = np.array(pixels.shape[:2])
    image = pyvista.ImageData(dimensions=(*(count + 1), 1), spacing=(*(size / count), 1.0))
    image.cell_data["colour"] = pixels.reshape(-1, 3, order="F")
    plotter.add_mesh(image, scalars="colour", rgb=True, lighting=False)
    plotter.view_xy()
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = size.max() / 2 * 1.12


# --- a web page ------------------------------------------------------------------------------------------------------

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
        up: The axis that is up, a name in ``UPS``; of a view in space.
        library: Address of plotly.js (``.js``), for a page that does not hold it; else the page needs no network.

    Raises:
        BoundingError: If a package is missing.
    """
    figure, shared = needed("plotly.graph_objects").Figure(), {id(state.object) for state in view.states}
    if view.solid and len(shared) == 1:  # one object at all radii is drawn once
        _add_surface(figure, view.states[0].object, "the object", STONE, 1.0)
    first, shown = len(figure.data), []
    for number, state in enumerate(view.states):
        before = len(figure.data)
        if view.solid:
            if not first:
                _add_surface(figure, state.object, "the object", STONE, 1.0)
            _add_surface(figure, state.bound, view.bounds, BOUND, OPACITY)
        else:
            _add_pixels(figure, view, state)
        for group in view.groups:
            axes = dict(zip("xyz", state.points[group.name].T[:: -1 if view.down else 1], strict=False))
            marker = {"color": group.colour, "size": 2.5 if view.solid else 5}
            options = {"mode": "markers", "name": group.text, "marker": marker}
            options["visible"] = True if group.shown else "legendonly"
            (figure.add_scatter3d if view.solid else figure.add_scatter)(**axes, **options)
        shown.append([trace.visible for trace in figure.data[before:]])
        if number:
            for trace in figure.data[before:]:
                trace.visible = False
    count = [len(each) for each in shown]
    steps = [
        {
            "label": state.label,
            "method": "update",
            "args": [
                {
                    "visible": [True] * first
                    + [of if k == number else False for k, n in enumerate(count) for of in shown[k]]
                },
                {"title.text": state.rates},
            ],
        }
        for number, state in enumerate(view.states)
    ]
    if len(steps) > 1:
        figure.update_layout(sliders=[{"steps": steps, "currentvalue": {"prefix": f"{view.asked} "}}])
    figure.update_layout(title={"text": view.states[0].rates, "font": {"size": 14}}, margin={"t": 40}, height=700)
    names, eye = view.names, dict(zip("xyz", (1.7 * eye_of(up) / np.linalg.norm(VIEW)).tolist(), strict=True))
    if view.solid:
        axes = {f"{axis}axis_title": name for axis, name in zip("xyz", names, strict=True)}
        camera = {"up": dict(zip("xyz", np.eye(3)[UPS.index(up)].tolist(), strict=True)), "eye": eye}
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
    middles = [
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip(view.lower, view.upper, pixels.shape, strict=True)
    ]
    x, y = middles[::-1] if view.down else middles
    last = len(PIXEL_COLOURS) - 1
    scale = [[k / (last + 1), colour] for n, colour in enumerate(PIXEL_COLOURS) for k in (n, n + 1)]
    options = {"zmin": -0.5, "zmax": last + 0.5, "colorscale": scale, "showscale": False, "hoverinfo": "skip"}
    figure.add_heatmap(x=x, y=y, z=pixels if view.down else pixels.T, visible=True, **options)
