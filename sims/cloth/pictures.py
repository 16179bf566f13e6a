"""The picture of the cloth: the run with a proven bounder beside the one with a network that has no proof."""

from pathlib import Path

import numpy as np

from sims.drawing import STONE, aim, panels, polygons, upright, write

__all__ = ["draw"]

PICTURE = "cloth.png"
PANEL = (800, 560)  # pixels
TIPS = "White tips: the star's points between particles; only particles collide"
CLOTH, WRONG, OPACITY = "#3f7fc4", "#d62718", 0.55  # what lies under the cloth shows through


def _top(positions: np.ndarray, triangles: np.ndarray, radius: float) -> np.ndarray:
    """The upper side of the cloth, which is as thick as its particles."""
    q = positions.astype(np.float64)
    a, b, c = (q[triangles[:, i]] for i in range(3))
    normals, across = np.zeros_like(q), np.cross(b - a, c - a)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], across)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return q + radius * np.divide(normals, length, out=np.zeros_like(q), where=length > 0)


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw ``cloth.png``."""
    import pyvista

    count = len(data["names"])
    for number, plotter in panels(folder / PICTURE, count, PANEL[0] * count, PANEL[1]):
        plotter.set_background("white")
        for shape in data["shapes"]:
            surface = polygons(data[f"{shape}_vertices"], data[f"{shape}_faces"])
            plotter.add_mesh(surface, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        top = _top(data[f"positions{number}"], data["triangles"], float(data["radius"]))
        cloth = polygons(top, data["triangles"])
        look = {"smooth_shading": True, "ambient": 0.15, "specular": 0.25, "specular_power": 20}
        plotter.enable_depth_peeling(8)
        plotter.add_mesh(cloth, color=CLOTH, opacity=OPACITY, **look)
        under = data[f"depths{number}"] > 0
        if under.any():
            dots = pyvista.PolyData(upright(top[under]))
            ball = pyvista.Sphere(radius=1.3 * float(data["radius"]), theta_resolution=12, phi_resolution=10)
            plotter.add_mesh(dots.glyph(geom=ball, scale=False, orient=False), color=WRONG, ambient=0.5)
        head, lines = str(data[f"caption{number}"]).split("\n", 1)
        write(plotter, head, (0.04, 0.92), 15)
        write(plotter, lines, (0.04, 0.84), 11)
        write(plotter, TIPS, (0.04, 0.02), 10)
        aim(plotter, (-1.0, -5.6, 4.6), (0.08, 0.0, 0.86), 22, lit=(0.0, 0.0, 1.0))
