"""Distance bounders of every method and of shapes of every kind, and the truth about grids in rational arithmetic."""

from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from bounding_shapes import shape
from plain_shapes import LEANING, TETRAHEDRON, torus_at

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES
from warp_bounding.proof.stress import DISTANCE_FORMS, DistancePositives

TOLD = {
    "bvh": {"leaves": 6},
    "learned-kdop": {"steps": 4},
    "mlp": {"hidden": (8,), "steps": 200, "budget": 5.0},
    "distance-grid": {"nodes": 7},
}


@cache
def thing(name: str):
    """A shape: one of ``bounding_shapes``, a mesh with a margin, or a solid."""
    if name == "tetrahedron":
        return wb.shapes.Mesh(LEANING.astype(float) * 3 + 7, TETRAHEDRON[1])
    if name == "torus":
        return torus_at([0.5, 0, 1], 1.0, 0.3)
    return shape(name)


THINGS = ("line", "c", "blob", "anisotropic", "five", "tetrahedron", "torus")


@cache
def far(method: str, name: str, margin: float = 0.0) -> wb.DistanceBounder:
    """A proven distance bounder on the CPU, through the public door; never change it."""
    if not DISTANCES[method].supports("distance", thing(name).ndim):
        pytest.skip(f"{method} has no distance of {thing(name).ndim}D objects")
    own, flat = dict(TOLD.get(method, {})), thing(name).ndim <= 3
    if method == "distance-grid" and (not flat or name == "torus"):
        own = {"nodes": 4}
    own |= {"resolution": 24} if (method, name) == ("bvh", "torus") else {}
    own |= {"budget": 100.0} if "budget" in own and flat else {}  # enough on a slow machine; it ends when it is done
    return wb.fit(thing(name), "distance", method, margin=margin, device="cpu", progress=False, **own)


def points_around(thing, count: int, rng: np.random.Generator, reach: float = 1.0) -> np.ndarray:
    """Uniform float32 points of a box around the object, and as many near it."""
    size = float(thing.extent.max())
    x = rng.uniform(thing.lower - reach * size, thing.upper + reach * size, (count, thing.ndim))
    near = rng.uniform(thing.lower, thing.upper, (count, thing.ndim))
    near += rng.normal(size=near.shape) * size * np.exp2(rng.uniform(-20, -1, (count, 1)))
    return np.concatenate([x, near]).astype(np.float32)


def squared_distance_to_cells(grid: wb.shapes.Grid, x: np.ndarray) -> Fraction:
    """From a point to the nearest occupied cell, exactly."""
    p = [Fraction(float(v)) for v in x]
    per_unit, offset = ([Fraction(float(v)) for v in values] for values in (grid.cells_per_unit, grid.offset))
    best = None
    for cell in grid.occupied.tolist():
        total = Fraction(0)
        for v, c, s, o in zip(p, cell, per_unit, offset, strict=True):
            low, high = (c - Fraction(1, 2) + o) / s, (c + Fraction(1, 2) + o) / s
            total += max(low - v, v - high, Fraction(0)) ** 2
        best = total if best is None or total < best else best
    return best


def check_hard_positives(bounder: wb.DistanceBounder, shape, least: int) -> None:
    """None of what a stress test asks is missed, of each form at least so many."""
    positives = DistancePositives(bounder, shape)
    for chunk in range(2 * len(DISTANCE_FORMS)):
        form, queried, missed = positives.ask(3, chunk, 3000)
        assert missed is None, (form, missed)
        assert queried > least
