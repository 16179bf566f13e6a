"""The picture of the cloth: the run with a proven bounder beside the one with a network that has no proof."""

from pathlib import Path

import numpy as np

from sims.drawing import STONE, aim, panels, polygons, upright, write

__all__ = ["draw"]

PICTURE = "cloth.png"
PANEL = (800, 560)  # pixels
TIPS = "White tips: the star's points between particles; only particles collide"
CLOTH, THREADS, WRONG = "#6ea8e0", "#2c5f97", "#d62718"
EVERY = 4  # thread that is drawn, so that folds can be seen


def _top(positions: np.ndarray, triangles: np.ndarray, height: np.ndarray | float) -> np.ndarray:
    """Points a height above the particles, along the cloth's normals: at their radius its upper side."""
    q = positions.astype(np.float64)
    a, b, c = (q[triangles[:, i]] for i in range(3))
    normals, across = np.zeros_like(q), np.cross(b - a, c - a)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], across)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return q + height * np.divide(normals, length, out=np.zeros_like(q), where=length > 0)


def _threads(points: np.ndarray):
    """Some rows and columns of a square cloth, as lines."""
    import pyvista

    side = round(len(points) ** 0.5)
    numbers = np.arange(len(points)).reshape(side, side)
    lines = [*numbers[::EVERY], *numbers.T[::EVERY]]
    return pyvista.PolyData(upright(points), lines=np.insert(np.stack(lines), 0, side, axis=1).reshape(-1))


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw ``cloth.png``."""
    import pyvista

    count = len(data["names"])
    for number, plotter in panels(folder / PICTURE, count, PANEL[0] * count, PANEL[1]):
        plotter.set_background("white")
        for shape in data["shapes"]:
            surface = polygons(data[f"{shape}_vertices"], data[f"{shape}_faces"])
            plotter.add_mesh(surface, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        radius, depths = float(data["radius"]), data[f"depths{number}"]
        place = data[f"positions{number}"], data["triangles"]
        look = {"smooth_shading": True, "ambient": 0.2, "specular": 0.1}
        plotter.add_mesh(polygons(_top(*place, radius), data["triangles"]), color=CLOTH, **look)
        plotter.add_mesh(_threads(_top(*place, 1.1 * radius)), color=THREADS, line_width=1.2, lighting=False)
        under = depths > 0
        if under.any():  # drawn on the surface that they are under
            dots = pyvista.PolyData(upright(_top(*place, np.maximum(depths, radius)[:, None])[under]))
            ball = pyvista.Sphere(radius=1.2 * radius, theta_resolution=12, phi_resolution=10)
            plotter.add_mesh(dots.glyph(geom=ball, scale=False, orient=False), color=WRONG, ambient=0.5)
        head, lines = str(data[f"caption{number}"]).split("\n", 1)
        write(plotter, head, (0.04, 0.92), 15)
        write(plotter, lines, (0.04, 0.84), 11)
        write(plotter, TIPS, (0.04, 0.02), 10)
        aim(plotter, (-1.0, -5.6, 4.6), (0.08, 0.0, 0.86), 22, lit=(0.0, 0.0, 1.0))
