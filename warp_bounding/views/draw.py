"""How a view is shown: one self-contained web page. Also how others draw off-screen, in a process of its own."""

import os
import subprocess
import sys
import tempfile
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from warp_bounding.views.view import State, View, needed

__all__ = ["Drawn", "draw_with", "page", "with_palette"]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
PIXEL_COLOURS = ("#ffffff", BOUND, STONE, MISSED)  # by ``State.pixels``
VIEW = (-0.65, -1.45, 0.6)  # towards the camera: to the right, into the picture, up

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


# --- a web page ------------------------------------------------------------------------------------------------------

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
    middles = [
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip(view.lower, view.upper, pixels.shape, strict=True)
    ]
    x, y = middles[::-1] if view.down else middles
    last = len(PIXEL_COLOURS) - 1
    scale = [[k / (last + 1), colour] for n, colour in enumerate(PIXEL_COLOURS) for k in (n, n + 1)]
    options = {"zmin": -0.5, "zmax": last + 0.5, "colorscale": scale, "showscale": False, "hoverinfo": "skip"}
    figure.add_heatmap(x=x, y=y, z=pixels if view.down else pixels.T, visible=True, **options)
