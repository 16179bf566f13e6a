"""Sections: which coordinates run, which are held, and what is refused."""

import numpy as np
import pytest

from warp_bounding.errors import QueryError
from warp_bounding.views.view import Section


def test_points_are_lifted_into_the_whole_space():
    section = Section(5, {0: 0.25, 3: -2.0})
    assert section.axes == [1, 2, 4]
    lifted = section.lift(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    assert lifted.dtype == np.float32
    np.testing.assert_array_equal(lifted, [[0.25, 1, 2, -2, 3], [0.25, 4, 5, -2, 6]])


@pytest.mark.parametrize(
    ("ndim", "held", "time", "names"),
    [
        (2, {}, False, ["x", "y"]),
        (4, {0: 0.0}, True, ["x", "y", "z"]),
        (4, {0: 0.0, 2: 0.0}, True, ["coordinate 1", "coordinate 3"]),
        (6, {0: 0.0, 1: 0.0, 2: 0.0}, False, ["coordinate 3", "coordinate 4", "coordinate 5"]),
    ],
)
def test_names(ndim, held, time, names):
    assert Section(ndim, held, time).names == names


@pytest.mark.parametrize(
    ("ndim", "held", "told"),
    [
        (6, {}, "hold 3 more of them by --slice, such as --slice 5=0"),
        (3, {0: 0.0, 1: 0.0}, "at least 2 coordinates must run, got 1 of the bounder's 3"),
        (1, {}, "at least 2 coordinates must run, got 1 of the bounder's 1"),
        (3, {3: 0.0}, "expected coordinates 0 to 2, got 3"),
        (4, {0: np.nan}, "expected a finite value of coordinate 0, got nan"),
    ],
)
def test_what_cannot_be_seen_is_refused(ndim, held, told):
    with pytest.raises(QueryError, match=told):
        Section(ndim, held)
