"""Solids that turn, slide and stretch from keyframe to keyframe."""

import numpy as np
import trimesh

from warp_bounding.indicators import IndicatorMotion


def turning(solid: trimesh.Trimesh, keyframes: int = 5, angle: float = 1.5) -> np.ndarray:
    angles = angle * np.sin(np.linspace(0, 3, keyframes))
    x, y, z = solid.vertices.T
    return np.array(
        [np.stack([np.cos(a) * x - np.sin(a) * y + a, np.sin(a) * x + np.cos(a) * y, z * (1 + a)], 1) for a in angles]
    )


SOLIDS = {
    "icosphere": lambda: trimesh.creation.icosphere(subdivisions=3),
    "torus": lambda: trimesh.creation.torus(1, 0.3),
    "box": lambda: trimesh.creation.box(extents=(1, 2, 0.5)),
    "two spheres": lambda: trimesh.util.concatenate(
        [trimesh.creation.icosphere(), trimesh.creation.icosphere(radius=0.8).apply_translation([0.9, 0, 0])]
    ),
}


def unevenly_turning(name: str, margin: float) -> IndicatorMotion:
    """A solid that turns between times of uneven distances; ``open``: half the faces of a sphere."""
    solid = SOLIDS["icosphere" if name == "open" else name]()
    faces = solid.faces[: len(solid.faces) // 2] if name == "open" else solid.faces
    return IndicatorMotion(turning(solid), faces, times=[-1, 0.5, 1, 1.25, 4]).dilated(margin)
