"""The exact truth about segments and states in a grid, beside rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from exact_mesh import passes_box

import warp_bounding as wb
from sims.path.exact import ExactWorld


def meets_world(grid, start, end):
    """The truth for one float32 segment, over all occupied cells."""
    half = Fraction(1, 2)
    scale, offset = ([Fraction(float(v)) for v in values] for values in (grid.cells_per_unit, grid.offset))
    a, b = ([Fraction(float(x[k])) * scale[k] - offset[k] for k in range(2)] for x in (start, end))
    return any(passes_box(a, b, [c - half for c in cell], [c + half for c in cell]) for cell in grid.occupied.tolist())


def random_world(shape, seed, share=0.15, **placed):
    occupied = np.random.default_rng(seed).random(shape) < share
    occupied[0, 0], occupied[-1, -1] = True, False
    return wb.shapes.Grid(occupied, **placed)


WORLDS = {
    "unit": random_world((9, 9), 0),
    "faces that float32 hits": random_world((9, 17), 1),  # scales 8 and 16: all corners are float32
    "odd": random_world((12, 7), 2, cells_per_unit=np.float32([3.7, 0.3]).astype(float), offset=np.array([-2.5, 7.0])),
    "one row": random_world((1, 12), 3),
}


def agree(grid, starts, ends):
    world = ExactWorld(grid)
    found = world.segments(starts, ends)
    truth = [meets_world(grid, a, b) for a, b in zip(starts, ends, strict=True)]
    np.testing.assert_array_equal(found, truth)
    np.testing.assert_array_equal(world.segments(ends, starts), truth)  # the other way round
    return world, found


@pytest.mark.parametrize("name", WORLDS)
def test_segments_and_states(name):
    """At random, and between corners and one float beside them; a state is a segment of no length."""
    grid, rng = WORLDS[name], np.random.default_rng(4)
    size = grid.upper - grid.lower
    starts = (grid.lower + (rng.random((300, 2)) * 1.4 - 0.2) * size).astype(np.float32)
    ends = (starts + rng.normal(size=(300, 2)) * size * rng.choice([0.02, 0.2, 1.0], (300, 1))).astype(np.float32)
    _, found = agree(grid, starts, ends)
    assert 0 < found.sum() < len(found)
    corners = [rng.integers(-1, cells + 2, (300, 2)) - 0.5 for cells in grid.shape]
    places = np.stack(corners, axis=-1)  # (300, 2 ends, 2 coordinates)
    x = ((places + grid.offset) / grid.cells_per_unit).astype(np.float32)
    step = rng.integers(-1, 2, x.shape).astype(np.float32)
    x = np.where(step == 0, x, np.nextafter(x, np.float32(np.inf) * np.where(step == 0, 1, step)))
    world, _ = agree(grid, x[:, 0].copy(), x[:, 1].copy())
    x = np.concatenate([starts, x[:, 0]])
    found = world.states(x)
    np.testing.assert_array_equal(found, world.segments(x, x))
    np.testing.assert_array_equal(found, [meets_world(grid, p, p) for p in x])
    if name != "odd":  # where the grid's own answer is exact
        np.testing.assert_array_equal(found[:300], grid.contains(starts))


def test_touching_counts_and_integers_decide_it():
    occupied = np.zeros((9, 9), dtype=bool)
    occupied[4, 4] = True
    grid = wb.shapes.Grid(occupied)  # the cell spans 3.5 / 8 to 4.5 / 8 along both axes
    low, high = 3.5 / 8, 4.5 / 8
    touching = [  # along a face, through a corner, ending in a corner, ending on a face, a point on a corner
        ((low, 0.0), (low, 1.0)),
        ((high - 0.25, high + 0.25), (high + 0.25, high - 0.25)),
        ((0.0, 0.0), (low, low)),
        ((0.5, 0.0), (0.5, low)),
        ((high, high), (high, high)),
    ]
    starts, ends = (np.array([pair[k] for pair in touching], dtype=np.float32) for k in (0, 1))
    world, found = agree(grid, starts, ends)
    assert found.all()
    assert world.doubts > 0
    away = np.float32([[-1, 0], [1, 1], [-1, -1], [0, -1], [1, 1]])
    moved = [
        np.where(away == 0, x, np.nextafter(x, np.float32(np.inf) * np.where(away == 0, 1, away)))
        for x in (starts, ends)
    ]
    _, found = agree(grid, *moved)
    assert not found.any()  # one float away


def test_lines_through_a_corner_that_float64_cannot_tell():
    """Coordinates of 48 bits, products of 96: rounding alone would call one half of these free."""
    occupied = np.zeros((8, 8), dtype=bool)
    occupied[4, 4] = True
    scale = np.float32([7.1234565, 5.9876547]).astype(np.float64)
    # the cell has a corner in the origin
    grid = wb.shapes.Grid(occupied, cells_per_unit=scale, offset=np.full(2, -3.5))
    rng = np.random.default_rng(9)
    starts = (rng.random((400, 2), dtype=np.float32) + np.float32(0.01)) * np.float32([-0.4, 0.4])
    ends = -starts * np.float32(2.0) ** -rng.integers(0, 4, (400, 1)).astype(np.float32)
    world, found = agree(grid, starts, ends)
    assert found.all()
    assert world.doubts > 400
    aside = np.nextafter(starts, np.float32(rng.choice([-1.0, 1.0], starts.shape) * np.inf))
    _, found = agree(grid, aside, ends)
    assert 0 < found.sum() < len(found)
