"""What the demos' pictures share.

Those of pyvista are drawn in a process of their own (``draw_with``), where a ``draw(data, folder)`` runs.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

__all__ = [
    "CAPTIONS",
    "INK",
    "STONE",
    "Drawn",
    "aim",
    "draw_with",
    "heading",
    "panels",
    "polygons",
    "save_figure",
    "upright",
    "with_palette",
    "write",
]

COLOURS = 256  # of a picture's palette
STONE, INK = "#d8cfc4", "#22303c"
CAPTIONS = {"mlp": "mlp: a network with a proof", "occupancy": "occupancy: a network with no proof"}  # of panels


# --- drawing in a process of its own ---------------------------------------------------------------------------------
#
# Where there is no OpenGL, VTK raises no exception but crashes: in a process of its own a crash costs the pictures, not
# the program. No display is needed: the process asks for EGL, then for OSMesa.

SECONDS = 120  # for drawing
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

    folder, root = Path(folder), str(Path(__file__).resolve().parents[1])
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
        return "pyvista is not installed (pip install 'warp-bounding[sims]')"
    if done.returncode < 0 or any(name in done.stderr for name in ("OpenGL", "EGL", "OSMesa")):
        return "this machine has no OpenGL for off-screen drawing (libEGL or libOSMesa)"
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return f"drawing failed ({lines[-1] if lines else f'status {done.returncode}'})"


# --- what they share -------------------------------------------------------------------------------------------------


def save_figure(figure, path: Path, dpi: int, colours: int = COLOURS) -> Path:
    """Write a matplotlib figure on an Agg canvas as a PNG file with a palette; makes its folder."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.set_dpi(dpi)
    figure.canvas.draw()
    with_palette(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())), colours).save(path, optimize=True)
    return path


def heading(axes, name: str, line: str) -> None:
    """What stands above a panel of a figure: what was run, and a line about what came of it."""
    axes.set_title(f"{CAPTIONS.get(name, name)}\n{line}", loc="left", fontsize=11, color=INK, linespacing=1.35)


def upright(points: np.ndarray) -> np.ndarray:
    """Coordinates for drawing, y up turned into z up: x, -z, y."""
    points = np.asarray(points, dtype=np.float64)
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def polygons(vertices: np.ndarray, faces: np.ndarray):
    """A pyvista surface of a mesh whose y is up."""
    import pyvista

    surface = pyvista.PolyData(upright(vertices), np.insert(np.asarray(faces), 0, 3, axis=1).reshape(-1))
    return surface.compute_normals(split_vertices=False, feature_angle=180.0)


def panels(path: Path, count: int, width: int, height: int) -> Iterator[tuple]:
    """Numbers of a picture's panels, side by side, each with a pyvista plotter; writes the picture after the last.

    Args:
        path: Of the PNG file.
        count: Of the panels.
        width: Of the whole picture, pixels.
        height: Of it, pixels.
    """
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, shape=(1, count), window_size=(width, height), border=False)
    for number in range(count):
        plotter.subplot(0, number)
        yield number, plotter
    plotter.screenshot(str(path))
    plotter.close()


def write(plotter, text: str, place: tuple[float, float], size: int, color: str = INK) -> None:
    """Text in a panel, at shares of its width and height, in the font of the figures."""
    if text:
        from matplotlib import font_manager

        font = font_manager.findfont("DejaVu Sans")
        plotter.add_text(text, position=place, viewport=True, font_size=size, color=color, font_file=font)


def aim(plotter, position, focal_point, angle: float, lit: tuple[float, float, float] = (0.0, 0.0, 0.8)) -> None:
    """Three lights (key, fill, rim) towards ``lit``, and an upright camera; ``angle`` of the view in degrees."""
    import pyvista

    plotter.remove_all_lights()
    for source, strength in (((-3, -5, 6), 0.75), ((5, -3, 2), 0.3), ((0, 4, 5), 0.3)):
        place = tuple(np.add(source, lit) - np.array([0, 0, 0.8]))
        lamp = pyvista.Light(position=place, focal_point=lit, intensity=strength, light_type="scene light")
        plotter.add_light(lamp)
    plotter.enable_anti_aliasing("ssaa")
    plotter.camera.position, plotter.camera.focal_point = position, focal_point
    plotter.camera.up, plotter.camera.view_angle = (0, 0, 1), angle
