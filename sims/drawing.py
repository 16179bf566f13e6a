"""What the demos' pictures share.

Those of pyvista are drawn in a process of their own (``warp_bounding.views.draw_with``), where a ``draw(data, folder)``
runs.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from warp_bounding.views import Drawn, draw_with, with_palette

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

COLOURS = 256  # of a figure's palette
STONE, INK = "#d8cfc4", "#22303c"
CAPTIONS = {"mlp": "mlp: a network with a proof", "occupancy": "occupancy: a network with no proof"}  # of panels


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
