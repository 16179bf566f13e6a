"""The map between object space and cells is exact, and closed cells own their faces."""

from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import IndicatorGrid, load_indicator

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
    grid = IndicatorGrid(occupancy, **options)
    x = near_faces(grid, rng, 4000)
    if 1 in shape:  # an axis of one cell has a half offset, where tiny negative numbers count as 0
        x = np.where(np.abs(x) < 1e-9, np.float32(0), x)
    assert grid.contains(x).tolist() == [fraction_contains(grid, point) for point in x]


@settings(deadline=None)
@given(
    x=F32, bits=st.integers(2**15, 2**24 - 1), exponent=st.integers(-40, 10), twice=st.integers(-(2**23) + 1, 2**23 - 1)
)
@example(x=-1e-45, bits=2**23, exponent=-23, twice=1)
def test_no_rounding_moves_a_point_out_of_its_cell(x, bits, exponent, twice):
    """For every map that a grid may have, also where the cell coordinate has to be rounded."""
    scale, offset = bits * 2.0**exponent, twice / 2
    exact = Fraction(x) * Fraction(scale) - Fraction(offset)
    cells = [i for i in (round(exact) - 1, round(exact), round(exact) + 1) if abs(exact - i) <= Fraction(1, 2)]
    for cell in cells:
        if abs(offset + cell) >= 2**22:
            continue
        grid = IndicatorGrid([False, True, False], cells_per_unit=[scale], offset=[offset + cell - 1])
        assert grid.contains(np.array([[x]], dtype=np.float32)).all()


def test_unit_grid_of_the_paper():
    grid = IndicatorGrid(np.eye(5, dtype=bool))
    assert grid.cells_per_unit.tolist() == [4, 4]
    assert grid.offset.tolist() == [0, 0]
    assert grid.lower.tolist() == [-0.125, -0.125]
    assert grid.upper.tolist() == [1.125, 1.125]
    assert grid.sample_lower.tolist() == [0, 0]
    assert grid.sample_upper.tolist() == [1, 1]


def test_an_axis_of_one_cell_is_the_unit_interval():
    grid = IndicatorGrid([[True, False]])
    assert (grid.lower[0], grid.upper[0]) == (0, 1)
    assert (grid.sample_lower[0], grid.sample_upper[0]) == (0, 1)


def test_faces_belong_to_both_cells():
    """One occupied cell owns its whole boundary, and nothing beyond."""
    occupancy = np.zeros((5, 5, 5), dtype=bool)
    occupancy[2, 2, 2] = True
    grid = IndicatorGrid(occupancy)  # the cell spans [3/8, 5/8]
    on = np.array(list(product([0.375, 0.5, 0.625], repeat=3)), dtype=np.float32)
    assert grid.contains(on).all()
    below, above = np.nextafter(np.float32(0.375), np.float32(0)), np.nextafter(np.float32(0.625), np.float32(1))
    for axis, value in product(range(3), [below, above]):
        off = on.copy()
        off[:, axis] = value
        assert not grid.contains(off).any()


def test_points_outside_and_not_a_number_are_in_no_cell():
    grid = IndicatorGrid(np.pad([[False]], 1, constant_values=True))
    x = np.array([[np.nan, 0], [np.inf, 0], [-np.inf, 0], [0, 3e38], [-0.2501, 0], [-0.25, 0]], dtype=np.float32)
    assert grid.contains(x).tolist() == [False] * 5 + [True]
    assert grid.contains(np.zeros((0, 2))).shape == (0,)


def test_position_inverts_cell_coordinate(rng):
    grid = IndicatorGrid(rng.random((6, 7)) < 0.5, cells_per_unit=[2.5, 4], offset=[-1.5, 3])
    t = rng.uniform(-1, 7, (100, 2))
    assert np.allclose(grid.cell_coordinate(grid.position(t)), t)


def test_digest_knows_every_voxel_and_the_map(blob):
    grid = IndicatorGrid(blob)
    digests = {grid.digest}
    for index in np.ndindex(blob.shape):
        changed = blob.copy()
        changed[index] = ~changed[index]
        digests.add(IndicatorGrid(changed).digest)
    assert len(digests) == blob.size + 1
    others = {
        replace(grid, cells_per_unit=grid.cells_per_unit * 2).digest,
        replace(grid, offset=grid.offset + 0.5).digest,
        replace(grid, time=True).digest,
        IndicatorGrid(blob.reshape(5, 4, 6)).digest,
    }
    assert len(digests | others) == blob.size + 5
    assert replace(grid, name="other", note="other").digest == grid.digest == IndicatorGrid(blob.copy()).digest


def test_boundary_against_brute_force(blob):
    grid = IndicatorGrid(np.pad(blob, 1, mode="edge"))
    expected = []
    for index in grid.occupied:
        around = [index + np.array(d) for d in product([-1, 0, 1], repeat=3)]
        inside = [c for c in around if (c >= 0).all() and (c < grid.shape).all()]
        if not all(grid.occupancy[tuple(c)] for c in inside):
            expected.append(index.tolist())
    assert grid.boundary.tolist() == expected


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cells_per_unit": [1.0]}, "2 scales"),
        ({"cells_per_unit": [1.0, 0.0]}, "positive float32"),
        ({"cells_per_unit": [1.0, 0.1]}, "positive float32"),
        ({"cells_per_unit": [1.0, np.inf]}, "positive float32"),
        ({"offset": [0.0, 0.25]}, "multiples of 1/2"),
        ({"offset": [0.0, 2.0**22]}, "multiples of 1/2"),
        ({"offset": [0.0, np.nan]}, "multiples of 1/2"),
    ],
)
def test_bad_maps(options, words):
    with pytest.raises(IndicatorError, match=words):
        IndicatorGrid(np.eye(3, dtype=bool), **options)


def test_margin_dilates_and_moves_the_map(rng):
    """A dilated grid contains every point within the margin of the old cells."""
    grid = load_indicator(rng.random((5, 6, 7)) < 0.1)
    margin = 0.3
    wide = grid.to_grid(margin=margin)
    assert wide.margin == margin
    assert grid.to_grid(margin=0.0) is grid
    assert wide.to_grid(margin=margin) is wide
    with pytest.raises(IndicatorError, match=r"dilated by 0\.3 already"):
        wide.to_grid(margin=0.4)
    inside = grid.position(grid.occupied.repeat(100, axis=0) + rng.uniform(-0.5, 0.5, (100 * len(grid.occupied), 3)))
    direction = rng.normal(size=inside.shape)
    direction *= margin * rng.random((len(inside), 1)) ** 0.2 / np.linalg.norm(direction, axis=1, keepdims=True)
    assert grid.contains(inside).all()
    assert wide.contains(inside + direction).all()


def test_time_is_not_dilated():
    occupancy = np.zeros((4, 3, 3, 3), dtype=bool)
    occupancy[2, 1, 1, 1] = True
    wide = load_indicator(occupancy).to_grid(margin=0.1)
    assert wide.time
    assert np.array_equal(wide.occupied[:, 0], np.full(27, 2))
