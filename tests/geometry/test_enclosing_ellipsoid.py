"""Enclosing balls and ellipsoids: of least size up to a proven gap, however many points there are."""

import numpy as np
import pytest

from warp_bounding.geometry import enclosing_ellipsoid as enclosing
from warp_bounding.geometry.enclosing_ellipsoid import GAP, enclosing_ellipsoid, extreme_corners
from warp_bounding.indicators import IndicatorGrid

FAMILIES = ("trace", "diagonal", "determinant")


def torus(resolution):
    x, y, z = np.mgrid[[slice(-1, 1, resolution * 1j)] * 3]
    return IndicatorGrid((np.hypot(x, y + 0.3 * z) - 0.6) ** 2 + z**2 < 0.3**2)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("sides", [(3, 5), (2, 4, 9), (1, 2, 3, 4)])
def test_around_a_box_the_ellipsoid_is_known(family, sides):
    """Half sides h: the ball's radius is |h|, the semi-axes of the ellipsoids are h sqrt(n)."""
    occupancy = np.zeros([s + 4 for s in sides], dtype=bool)
    occupancy[tuple(slice(2, 2 + s) for s in sides)] = True
    grid = IndicatorGrid(occupancy, cells_per_unit=np.ones(len(sides)), offset=np.zeros(len(sides)))
    matrix, center = enclosing_ellipsoid(grid, family)
    half = np.array(sides) / 2
    np.testing.assert_allclose(center, 1.5 + half, atol=1e-2)
    expected = np.linalg.norm(half) ** len(half) if family == "trace" else np.prod(half * np.sqrt(len(half)))
    assert 1 - 1e-9 <= 1 / np.linalg.det(matrix) / expected <= (1 + GAP) ** len(half)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", range(3))
def test_of_scattered_cells_none_is_left_out_and_the_gap_is_proven(family, seed):
    rng = np.random.default_rng(seed)
    grid = IndicatorGrid(rng.random((9, 12, 10)) < 0.02)
    points = extreme_corners(grid)
    matrix, center = enclosing_ellipsoid(grid, family)
    reach = (((points - center) @ matrix.T) ** 2).sum(axis=1)
    assert reach.max() == pytest.approx(1, abs=1e-9)
    # Any weights bound the optimum from below; those of all points at once come as near as the ellipsoid says.
    weights = np.full(len(points), 1 / len(points))
    _, shape, goal, _, closed = enclosing._enclose(points, weights, family, enclosing.MOST_STEPS)
    assert closed
    size = goal if family == "trace" else -np.linalg.slogdet(shape / goal)[1]
    ours = np.linalg.det(matrix) ** (-2 / 3) if family == "trace" else -2 * np.linalg.slogdet(matrix)[1]
    assert abs(ours / size - 1) < 3 * GAP if family == "trace" else abs(ours - size) < 9 * GAP


@pytest.mark.parametrize("family", FAMILIES)
def test_only_a_few_of_many_points_are_fitted_to(family, monkeypatch):
    """What a search costs is how many points it is about, and how many searches there are."""
    asked, inner = [], enclosing._enclose
    monkeypatch.setattr(enclosing, "_enclose", lambda points, *rest: asked.append(len(points)) or inner(points, *rest))
    grid = torus(80)
    enclosing_ellipsoid(grid, family)
    assert len(extreme_corners(grid)) > 1000
    assert max(asked) < 500
    assert len(asked) < 10
