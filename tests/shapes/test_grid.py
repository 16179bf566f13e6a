"""The map to cells is exact, closed cells own their faces, dilation and distances are those of the definition."""

from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from bounding_shapes import shape
from distances import squared_distance_to_cells
from hypothesis import example, given, settings
from hypothesis import strategies as st

import warp_bounding as wb
from warp_bounding.errors import ShapeError
from warp_bounding.shapes import Grid, load_shape
from warp_bounding.shapes import shape as limits
from warp_bounding.shapes.formula import dilate

F32 = st.floats(width=32, allow_nan=False, allow_infinity=False)


def fraction_contains(grid, point):
    """The definition, in rational arithmetic: some occupied cell i has |s x - o - i| <= 1/2 on every axis."""
    choices = []
    for x, s, o, r in zip(point, grid.cells_per_unit, grid.offset, grid.shape, strict=True):
        t = Fraction(float(x)) * Fraction(float(s)) - Fraction(float(o))
        nearest = round(t)
        choices.append([i for i in (nearest - 1, nearest, nearest + 1) if 0 <= i < r and abs(t - i) <= Fraction(1, 2)])
    return any(grid.occupancy[index] for index in product(*choices))


def near_faces(grid, rng, count):
    """Float32 points on faces, a few units in the last place off them, and around zero."""
    t = np.round(rng.uniform(-1, np.array(grid.shape), (count, grid.ndim))) + rng.choice(
        [-0.5, 0, 0.5], (count, grid.ndim)
    )
    x = grid.position(t).astype(np.float32)
    bits = np.abs(x).view(np.int32) + rng.integers(-2, 3, x.shape, dtype=np.int32)
    x = np.copysign(np.maximum(bits, 0).view(np.float32), x)
    tiny = rng.random(x.shape) < 0.05
    x[tiny] = rng.choice(np.array([0.0, -0.0, 1e-45, -1e-45, 1e-20, -1e-20], dtype=np.float32), tiny.sum())
    return x


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((7,), {}),
        ((32, 32), {}),
        ((3, 1, 5), {}),
        ((4, 3, 5, 2), {}),
        ((32, 20), {"offset": [-3.0, 4.0]}),
        ((9, 8, 7), {"cells_per_unit": [39.53125] * 3, "offset": [-39.0, 0.0, -22.0]}),
        ((9, 8), {"cells_per_unit": [40503 * 2.0**-9, 65535 * 2.0**-20], "offset": [-9000.0, 2.0**21]}),
    ],
)
def test_membership_is_exact(rng, shape, options):
    occupancy = rng.random(shape) < 0.5
    occupancy.flat[:2] = False, True
    grid = Grid(occupancy, **options)
    x = near_faces(grid, rng, 4000)
    if 1 in shape:  # an axis of one cell has a half offset, where tiny negative numbers count as 0
        x = np.where(np.abs(x) < 1e-9, np.float32(0), x)
    assert grid.contains(x).tolist() == [fraction_contains(grid, point) for point in x]


@settings(deadline=None)
@given(
    x=F32, bits=st.integers(2**15, 2**24 - 1), exponent=st.integers(-40, 10), twice=st.integers(-(2**23) + 1, 2**23 - 1)
)
@example(x=-1e-45, bits=2**23, exponent=-23, twice=1)
@example(x=-0.5, bits=8388605, exponent=0, twice=0)
def test_no_rounding_moves_a_point_out_of_its_cell(x, bits, exponent, twice):
    """For every map that a grid may have, also where the cell coordinate has to be rounded."""
    scale, offset = bits * 2.0**exponent, twice / 2
    exact = Fraction(x) * Fraction(scale) - Fraction(offset)
    cells = [i for i in (round(exact) - 1, round(exact), round(exact) + 1) if abs(exact - i) <= Fraction(1, 2)]
    for cell in cells:
        if abs(offset + cell - 1) >= 2**22:
            continue
        grid = Grid([False, True, False], cells_per_unit=[scale], offset=[offset + cell - 1])
        assert grid.contains(np.array([[x]], dtype=np.float32)).all()


def test_unit_grid_of_the_paper():
    grid = Grid(np.eye(5, dtype=bool))
    assert grid.cells_per_unit.tolist() == [4, 4]
    assert grid.offset.tolist() == [0, 0]
    assert grid.lower.tolist() == [-0.125, -0.125]
    assert grid.upper.tolist() == [1.125, 1.125]
    assert (grid.sample_lower.tolist(), grid.sample_upper.tolist()) == ([0, 0], [1, 1])
    single = Grid([[True, False]])  # an axis of one cell is the unit interval
    assert (single.lower[0], single.upper[0], single.sample_lower[0], single.sample_upper[0]) == (0, 1, 0, 1)


def test_the_digest_knows_every_voxel_and_the_map():
    blob = shape("blob").occupancy[:4, :5, :6]
    grid = Grid(blob)
    made = [
        grid,
        replace(grid, cells_per_unit=grid.cells_per_unit * 2),
        replace(grid, offset=grid.offset + 0.5),
        replace(grid, time=True),
    ]
    made.append(Grid(blob.reshape(5, 4, 6)))
    for index in np.ndindex(blob.shape):
        changed = blob.copy()
        changed[index] = ~changed[index]
        made.append(Grid(changed))
    assert len({each.digest for each in made}) == blob.size + 5
    assert replace(grid, name="other", note="other").digest == grid.digest == Grid(blob.copy()).digest


def brute_force(occupancy, radius, static_axes, pad, shape):
    """Which cells of the padded grid come within the radius, decided exactly."""
    result = np.zeros(shape, dtype=bool)
    occupied = np.argwhere(occupancy) + pad
    for index in np.ndindex(shape):
        for cell in occupied:
            gaps = [max(abs(int(a) - int(b)) - 1, 0) for a, b in zip(index, cell, strict=True)]
            still = all(index[k] == cell[k] for k in range(len(shape)) if k in static_axes or radius[k] == 0)
            moved = [k for k in range(len(shape)) if k not in static_axes and radius[k] > 0]
            if still and sum(Fraction(gaps[k]) ** 2 / Fraction(float(radius[k])) ** 2 for k in moved) <= 1:
                result[index] = True
                break
    return result


@settings(deadline=None, max_examples=50)
@given(
    shape=st.lists(st.integers(1, 3), min_size=1, max_size=4),
    radius=st.lists(st.sampled_from([0.0, 1e-12, 0.3, 1.0, 1.5, 2.0, 2.3]), min_size=4, max_size=4),
    static=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_dilation_against_brute_force(shape, radius, static, seed):
    occupancy = np.random.default_rng(seed).random(shape) < 0.3
    occupancy.flat[0] = True
    radius, axes = np.array(radius[: len(shape)]), (0,) if static else ()
    result, pad = dilate(occupancy, radius, static_axes=axes)
    assert np.array_equal(result, brute_force(occupancy, radius, axes, pad, result.shape))


def square(x: float) -> Fraction:
    return Fraction(float(x)) ** 2


@pytest.mark.parametrize("name", ["line", "c", "blob", "anisotropic", "single"])
def test_distances(name, rng):
    grid = shape(name)
    size = grid.upper - grid.lower
    x = rng.uniform(grid.lower - size, grid.upper + size, (30, grid.ndim))
    x = np.concatenate([x, grid.position(grid.occupied[:10] - 0.5)])
    for point, (low, high) in zip(x, grid.distances(x), strict=True):
        truth = squared_distance_to_cells(grid, point)
        assert square(low) <= truth <= square(high)
        assert high - low <= 2.0**-40 * (np.abs(point).max() + 1 + high)


def test_distances_of_animated_grids_at_a_time(rng):
    grid = shape("animated")
    x = rng.uniform(-0.5, 1.5, (60, 4))
    for point, (low, high) in zip(x, grid.distances(x), strict=True):
        if not grid.lower[0] <= point[0] <= grid.upper[0]:
            assert (low, high) == (0, np.inf)
            continue
        cells = grid.occupied
        there = np.abs(grid.cell_coordinate(point[None])[0, 0] - cells[:, 0]) <= 0.5
        still = np.zeros(grid.shape[1:], bool)
        still[tuple(cells[there][:, 1:].T)] = True
        then = wb.shapes.Grid(still, cells_per_unit=grid.cells_per_unit[1:], offset=grid.offset[1:])
        assert square(low) <= squared_distance_to_cells(then, point[1:]) <= square(high)


BALL = np.linalg.norm(np.mgrid[-1:1:9j, -1:1:9j], axis=0) < 0.5
EYE = np.eye(3, dtype=bool)
BAD = (
    (lambda: Grid(EYE, cells_per_unit=[1.0]), "2 scales"),
    *((lambda s=s: Grid(EYE, cells_per_unit=[1.0, s]), "positive float32") for s in (0.0, 0.1, np.inf)),
    *((lambda o=o: Grid(EYE, offset=[0.0, o]), "multiples of 1/2") for o in (0.25, 2.0**22, np.nan)),
    (lambda: Grid(EYE).to_grid(margin=-1), "non-negative"),
    (lambda: Grid(EYE).to_grid(margin=np.nan), "finite"),
    *((lambda m=m: Grid(EYE).to_grid(margin=m), "suffice") for m in (1e300, 1e9)),
    (lambda: Grid(EYE).to_grid(resolution=8), "its own resolution"),
)


def test_what_is_no_grid_and_no_dilation(monkeypatch):
    for make, words in BAD:
        with pytest.raises(ShapeError, match=words):
            make()
    monkeypatch.setattr(limits, "_memory", lambda: 2000)
    with pytest.raises(ShapeError, match=r"dilating 81 cells needs about .* GB .* a smaller margin"):
        load_shape(BALL).to_grid(margin=0.5)
