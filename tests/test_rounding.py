"""Rounding, and the geometry that bounders are made of, are on the safe side."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import spatial

from warp_bounding import rounding
from warp_bounding.geometry import farthest, hull_corners
from warp_bounding.rounding import UNIT32, UNIT64, gamma, round_down, round_up

F32 = np.float32
DOUBLES = st.floats(allow_nan=False, allow_infinity=False)


@settings(deadline=None, max_examples=300)
@given(DOUBLES)
def test_a_number_is_rounded_to_its_nearest_float32_below_and_above(value):
    below, above = round_down(value)[()], round_up(value)[()]
    assert below.dtype == above.dtype == F32
    assert float(below) <= value <= float(above)
    with np.errstate(over="ignore"):
        assert float(np.nextafter(below, F32(np.inf))) > value > float(np.nextafter(above, F32(-np.inf)))


def test_rounding_works_on_arrays_and_at_the_ends():
    values = np.array([1 / 3, -1 / 3, 1e300, -1e300, 1e-300, -1e-300])
    down, up = round_down(values), round_up(values)
    assert down.dtype == up.dtype == F32
    assert (down.astype(float) < values).all()
    assert (up.astype(float) > values).all()


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 10**6), st.sampled_from([UNIT32, UNIT64]))
def test_gamma_bounds_the_growth_of_roundings(count, unit):
    from fractions import Fraction

    k = Fraction(count) * Fraction(unit)
    assert Fraction(gamma(count, unit)) >= k / (1 - k)


def test_gamma_refuses_what_has_no_bound():
    with pytest.raises(ValueError, match="count="):
        gamma(2**23)


@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=40), st.integers(0, 2**32 - 1))
def test_gamma_bounds_a_float32_sum_of_products(values, seed):
    rng = np.random.default_rng(seed)
    a, b = np.array(values, dtype=F32), rng.normal(size=len(values)).astype(F32)
    exact = float((a.astype(np.longdouble) * b.astype(np.longdouble)).sum())
    allowed = gamma(len(a) + 1) * float((np.abs(a.astype(float)) * np.abs(b)).sum()) + len(a) * 2 * rounding.TINY
    for _ in range(5):
        order, total = rng.permutation(len(a)), F32(0)
        for i in order:
            total = F32(total + a[i] * b[i])
        assert abs(float(total) - exact) <= allowed


# --- geometry: the places that are farthest, and the corners of hulls -------------------------------------------------

NEAR = 1e-11  # relative: how much farther than the farthest place that an ascent finds the bound may lie


def best_place(centres: np.ndarray, matrix: np.ndarray) -> float:
    """The farthest place that ascents from many starts find, around each centre."""
    rng, best = np.random.default_rng(5), 0.0
    for z in centres:
        u = rng.normal(size=(100, matrix.shape[1]))
        for _ in range(300):
            u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-300)
            u = (z + u @ matrix.T) @ matrix
        u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-300)
        best = max(best, float(np.linalg.norm(z + u @ matrix.T, axis=1).max()))
    return best


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("size", [1e-6, 0.3, 5.0])
@pytest.mark.parametrize("diagonal", [True, False])
def test_it_is_the_farthest_place_and_never_nearer(n, size, diagonal):
    rng = np.random.default_rng(n)
    centres, matrix = rng.normal(size=(20, n)), size * rng.normal(size=(n, n))
    matrix = np.diag(np.diag(matrix)) if diagonal else matrix
    for some in (centres, np.zeros((1, n)), np.eye(n)[-1:]):  # also at the origin and on an axis
        found, best = farthest(some, matrix), best_place(some, matrix)
        assert best * (1 - 1e-15) <= found <= best * (1 + NEAR)


@pytest.mark.parametrize("careless", [False, True])
@pytest.mark.parametrize(("ndim", "size"), [(1, 9), (2, 40), (3, 16), (4, 9)])
def test_hull_corners_support_in_every_direction(ndim, size, careless, rng, monkeypatch):
    """Corners that Qhull drops stay unless integers say that they are inside."""
    honest, t = spatial.ConvexHull, np.indices((size,) * ndim) - (size - 1) / 2
    cells = np.argwhere((t * t).sum(axis=0) < (size / 2) ** 2)
    cells = cells[rng.random(len(cells)) < 0.8]

    def some_lost(points):
        hull = honest(points[::3])
        return SimpleNamespace(simplices=hull.simplices * 3, neighbors=hull.neighbors)

    if careless:
        monkeypatch.setattr(spatial, "ConvexHull", some_lost)
    corners = np.unique((cells[:, None] + list(np.ndindex((2,) * ndim))).reshape(-1, ndim), axis=0)
    kept = hull_corners(cells)
    directions = rng.integers(-9, 10, (3000, ndim))  # integers: exact, and many ties
    np.testing.assert_array_equal((directions @ kept.T).max(axis=1), (directions @ corners.T).max(axis=1))
    assert {*map(tuple, kept.tolist())} <= {*map(tuple, corners.tolist())}
    assert careless or ndim == 1 or len(kept) < len(corners)
