"""Shapes for a first look: meshes that installed packages bring along; nothing is downloaded.

``python -m sims --assets DIR`` writes them as ``.obj`` files, so that what documentation shows runs as printed.
"""

import copy
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warp_bounding as wb

__all__ = ["MESHES", "Shape", "asset_mesh", "obj", "once", "surface"]

MESHES = ("bunny", "bear", "rocks")  # by the names of warp-lang's files
Shape = wb.shapes.Mesh | wb.shapes.MovingMesh | wb.shapes.Grid  # what a scene is made of, margin included


def asset_mesh(name: str) -> wb.shapes.Mesh:
    """A mesh that ships in warp-lang, such as the Stanford bunny; y up.

    Raises:
        ShapeError: If it is not there, or cannot be read.
    """
    import warp.examples

    path = Path(warp.examples.get_asset_directory()) / f"{name}.usd"
    if not path.is_file():
        raise wb.ShapeError(f"{path}: expected this mesh in the installed warp-lang; no such file")
    return wb.load_shape(path)


def once(shape: Shape) -> Shape:
    """The shape; a mesh that caches its cells and decided points, since a demo needs them for each bounder."""
    if not isinstance(shape, wb.shapes.Mesh | wb.shapes.MovingMesh):
        return shape
    known: dict[tuple, Any] = {}

    class Once(type(shape)):
        def decide(self, x: np.ndarray) -> np.ndarray:
            key = self.digest, hashlib.sha256(np.ascontiguousarray(x)).digest()
            if key not in known:
                known[key] = super().decide(x)
            return known[key]

        def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> wb.shapes.Grid:
            key = self.digest, resolution, margin or self.margin
            if key not in known:
                known[key] = super().to_grid(resolution=resolution, margin=margin)
            return known[key]

    made = copy.copy(shape)
    object.__setattr__(made, "__class__", Once)
    return made


def obj(shape: wb.shapes.Mesh) -> bytes:
    """A mesh as an ``.obj`` file; its float32 numbers are read back to the bit."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(shape.vertices, np.float32)]
    lines += [f"f {a} {b} {c}" for a, b, c in shape.faces + 1]
    return ("\n".join(lines) + "\n").encode()


def surface(vertices: np.ndarray, faces: np.ndarray, device: wp.Device | str, moving: bool = False) -> wp.Mesh:
    """A mesh for queries in kernels; one that moves has velocities, of 0."""
    points = wp.array(vertices, dtype=wp.vec3, device=device)
    indices = wp.array(faces.reshape(-1), dtype=wp.int32, device=device)
    return wp.Mesh(points=points, indices=indices, velocities=wp.zeros_like(points) if moving else None)
