"""Random meshes to bake."""

from pathlib import Path

import numpy as np
import trimesh

__all__ = ["write_shapes"]


def write_shapes(folder: Path, count: int, seed: int) -> None:
    """So many random meshes: unions of two to four perturbed balls, boxes, capsules and rings, as .ply and .stl."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        rng, parts = np.random.default_rng([seed, number]), []
        for _ in range(rng.integers(2, 5)):
            kind = rng.integers(4)
            part = (
                trimesh.creation.icosphere(3)
                if kind == 0
                else trimesh.creation.box(rng.uniform(0.5, 2.0, 3)).subdivide_loop(2)
                if kind == 1
                else trimesh.creation.capsule(rng.uniform(0.5, 2.0), rng.uniform(0.2, 0.6))
                if kind == 2
                else trimesh.creation.torus(1.0, rng.uniform(0.15, 0.4))
            )
            wave = rng.normal(size=3)
            part.vertices *= 1.0 + 0.15 * np.sin(3.0 * part.vertices @ wave)[:, None]
            part.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
            part.apply_translation(rng.normal(size=3) * 0.6)
            parts.append(part)
        trimesh.util.concatenate(parts).export(folder / f"shape{number:04d}{('.ply', '.stl')[number % 2]}")
