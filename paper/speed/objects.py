"""Objects for ``speed``: one of a data folder in each dimension, or generated ones where there is no folder.

A race needs an object that is neither convex nor tiny, in each dimension: a ring with a gap, a torus with a ball beside
it, and in 4D a ball on its way through space. Their grids have about as many cells as the paper's.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from paper.shapes import Shape
from paper.speed.rows import GENERATED
from warp_bounding.indicators import IndicatorGrid

__all__ = ["generated", "usual"]

USUAL = "bunny"  # the object that is raced where none is named and the folder has it
CELLS = 32  # along each axis; in 4D along the three of space, and ``FRAMES`` along time
FRAMES = 10


def usual(shapes: Sequence[Shape]) -> list[Shape]:
    """Of each dimension the usual object, or else the first."""
    chosen = []
    for ndim in dict.fromkeys(shape.ndim for shape in shapes):
        own = [shape for shape in shapes if shape.ndim == ndim]
        chosen.append(next((shape for shape in own if shape.name == USUAL), own[0]))
    return chosen


def generated(dimensions: Iterable[int]) -> dict[Shape, Any]:
    """Grids of generated objects, by what stands for their files."""
    make = {2: _ring, 3: _torus, 4: _flight}
    return {Shape(n, GENERATED, Path(GENERATED)): IndicatorGrid(make[n](), name=GENERATED) for n in dimensions}


def _axes(*cells: int) -> list[np.ndarray]:
    """Coordinates of the cells' centres, -1 to 1 along each axis."""
    return list(np.meshgrid(*((np.arange(n) + 0.5) / n * 2 - 1 for n in cells), indexing="ij"))


def _ring() -> np.ndarray:
    x, y = _axes(CELLS, CELLS)
    radius = np.hypot(x, y)
    return (radius < 0.9) & (radius > 0.45) & ~((x > 0) & (np.abs(y) < 0.2))


def _torus() -> np.ndarray:
    x, y, z = _axes(CELLS, CELLS, CELLS)
    torus = (np.hypot(x, y) - 0.6) ** 2 + z**2 < 0.25**2
    return torus | (x**2 + y**2 + (z - 0.6) ** 2 < 0.3**2)


def _flight() -> np.ndarray:
    t, x, y, z = _axes(FRAMES, CELLS, CELLS, CELLS)
    return (x - 0.6 * t) ** 2 + (y - 0.5 * np.sin(2 * t)) ** 2 + (z + 0.3) ** 2 < 0.35**2
