"""Dilation against the definition, cell by cell, in rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_bounding.indicators.grid import dilate


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
def test_against_brute_force(shape, radius, static, seed):
    occupancy = np.random.default_rng(seed).random(shape) < 0.3
    occupancy.flat[0] = True
    radius, axes = np.array(radius[: len(shape)]), (0,) if static else ()
    result, pad = dilate(occupancy, radius, static_axes=axes)
    assert np.array_equal(result, brute_force(occupancy, radius, axes, pad, result.shape))


@pytest.mark.parametrize(("radius", "cells"), [(0.0, 1), (1e-300, 3), (0.999, 3), (1.0, 5), (1.001, 5), (7.0, 17)])
def test_reach_along_a_line(radius, cells):
    result, pad = dilate(np.array([True]), np.array([radius]))
    assert result.tolist() == [True] * cells
    assert pad.tolist() == [cells // 2]


def test_padding_that_stays_empty_is_cut_off_and_given_cells_stay():
    occupancy = np.zeros((9, 9), dtype=bool)
    occupancy[8, 4] = True
    result, pad = dilate(occupancy, np.array([2.5, 2.5]))
    assert result.shape == (12, 9)
    assert pad.tolist() == [0, 0]


def test_a_large_radius_takes_no_time_to_speak_of():
    """Axis by axis: 3 x 61 passes, where the definition has 227,000 shifts."""
    occupancy = np.zeros((20, 20, 20), dtype=bool)
    occupancy[10, 10, 10] = True
    result, _ = dilate(occupancy, np.full(3, 30.0))
    assert abs(result.sum() / (4 / 3 * np.pi * 31**3) - 1) < 0.06
