"""Distinct rows: the same as NumPy's, only sooner."""

import numpy as np
import pytest

from warp_bounding.indicators.distinct_rows import distinct_rows


@pytest.mark.parametrize("dtype", [np.float32, np.int64])
@pytest.mark.parametrize(("rows", "columns"), [(1, 3), (500, 2), (500, 3), (0, 3)])
def test_they_are_those_of_numpy(dtype, rows, columns):
    values = np.random.default_rng(0).integers(-3, 4, (rows, columns)).astype(dtype)
    unique, first, inverse = np.unique(values, axis=0, return_index=True, return_inverse=True)
    found = distinct_rows(values)
    for one, other in zip(found, (unique, first, inverse.reshape(-1)), strict=True):
        assert (one == other).all()
        assert one.shape == other.shape
