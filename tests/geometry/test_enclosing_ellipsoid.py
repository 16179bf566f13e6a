"""Enclosing balls and ellipsoids: of least size up to a proven gap, however many points there are."""

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding import geometry as enclosing
from warp_bounding.geometry import GAP, enclosing_ellipsoid, extreme_corners
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


@pytest.mark.parametrize("margin", [0.0, 1e-6, 0.1])
@pytest.mark.parametrize("method", ["ellipsoid", "oriented-ellipsoid"])
def test_a_sheet_has_a_thin_one(method, margin):
    """No ellipsoid is flat; around a flat mesh, which cloth is at rest, it is about as thin as its dilation."""
    turn = np.eye(3) if method == "ellipsoid" else np.array([[0.8, -0.36, 0.48], [0.6, 0.48, -0.64], [0, 0.8, 0.6]])
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]) @ turn.T
    sheet = wb.IndicatorMesh(corners.astype(np.float32), [[0, 1, 2], [1, 2, 3]])
    with pytest.warns(wb.BoundingWarning, match="the mesh is open"):
        bounder = wb.fit(sheet, method=method, margin=margin, device="cpu")
    assert bounder.certificate.proven
    beside = corners.mean(axis=0) + np.array([[1], [-1]]) * (3 * margin + 1e-3) * turn[:, 2]
    assert not bounder.query(beside.astype(np.float32)).numpy().any()
