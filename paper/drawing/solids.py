"""Drawing of voxels and bounds in 3D with pyvista, in a process of its own; see ``draw`` for what it is given.

A scene is what ``scene`` makes; a layer is a packed mask ``(X, Y, Z)`` over the domain, with ``colour``, ``opacity``, and ``smooth`` (an isosurface) or not (whole cells).
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from paper.drawing.masks import unpack

__all__ = ["draw", "layer", "scene"]

SMOOTHING = 0.9  # standard deviation, in pixels of the raster, of what takes the steps out of an isosurface
VIEW = (1.15, 1.5, 0.8)  # towards the camera: along the two axes after the one that is up, and along this
ANGLE = 30.0  # of the view, degrees
DOMAIN_RADIUS = 0.8  # of what is shown of the domain, in its sides: a little less than to its corners


def layer(mask: dict[str, Any], colour: str, opacity: float = 1.0, *, smooth: bool = False) -> dict[str, Any]:
    """A layer of a packed mask."""
    return {"mask": mask, "colour": colour, "opacity": opacity, "smooth": smooth}


def scene(
    *layers: dict[str, Any], up: Sequence[int] = (0, 0, 1), around: dict[str, Any] | None = None, pixels: int = 300
) -> dict[str, Any]:
    """A scene, with the direction that is up, and the packed mask whose box fills the view; the domain if ``None``."""
    middle, radius = [0.5, 0.5, 0.5], DOMAIN_RADIUS
    if around is not None:
        inside = unpack(around)
        places = np.argwhere(inside) / np.array(inside.shape)
        low, high = places.min(axis=0), places.max(axis=0) + 1 / np.array(inside.shape)
        middle, radius = ((low + high) / 2).tolist(), float(np.linalg.norm(high - low)) / 2
    return {"layers": list(layers), "pixels": pixels, "up": list(up), "middle": middle, "radius": radius}


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Write ``0000.png``, ... into a folder: a picture of each scene; ``data["scenes"]`` is their JSON."""
    import pyvista

    for number, each in enumerate(json.loads(str(data["scenes"]))):
        plotter = pyvista.Plotter(off_screen=True, window_size=(each["pixels"],) * 2, border=False)
        plotter.set_background("white")
        for one in each["layers"]:
            surface = _surface(unpack(one["mask"]), one["smooth"])
            if surface is None or surface.n_cells == 0:
                continue
            plotter.add_mesh(
                surface,
                color=one["colour"],
                opacity=one["opacity"],
                smooth_shading=one["smooth"],
                ambient=0.25,
                diffuse=0.75,
                specular=0.1,
            )
        plotter.enable_anti_aliasing("ssaa")
        up = np.array(each["up"], dtype=float)
        view = VIEW[0] * np.roll(np.abs(up), 1) + VIEW[1] * np.roll(np.abs(up), 2) + VIEW[2] * up
        middle, distance = np.array(each["middle"]), each["radius"] / np.sin(np.radians(ANGLE) / 2)
        plotter.camera.focal_point = tuple(middle)
        plotter.camera.position = tuple(middle + distance * view / np.linalg.norm(view))
        plotter.camera.up, plotter.camera.view_angle = tuple(up), ANGLE
        plotter.screenshot(str(folder / f"{number:04}.png"))
        plotter.close()


def _surface(mask: np.ndarray, smooth: bool):
    """The surface of a mask, in the unit cube; ``None`` if it is empty."""
    import pyvista
    from scipy.ndimage import gaussian_filter

    if not mask.any():
        return None
    size = 1.0 / np.array(mask.shape)
    if not smooth:
        cells = pyvista.ImageData(dimensions=np.array(mask.shape) + 1, spacing=size)
        cells.cell_data["inside"] = mask.ravel(order="F").astype(np.uint8)
        return cells.threshold(0.5, scalars="inside").extract_surface(algorithm="dataset_surface")
    padded = gaussian_filter(np.pad(mask, 2).astype(np.float32), SMOOTHING)
    points = pyvista.ImageData(dimensions=padded.shape, spacing=size, origin=-1.5 * size)
    points.point_data["inside"] = padded.ravel(order="F")
    return points.contour([0.5], scalars="inside").compute_normals(auto_orient_normals=True, split_vertices=False)
