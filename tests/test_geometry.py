"""How far dilated points reach, and hulls of cells."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import spatial

from warp_bounding.geometry import farthest, hull_corners

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


def all_corners(cells):
    return np.unique((cells[:, None] + list(np.ndindex((2,) * cells.shape[1]))).reshape(-1, cells.shape[1]), axis=0)


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
    corners, kept = all_corners(cells), hull_corners(cells)
    directions = rng.integers(-9, 10, (3000, ndim))  # integers: exact, and many ties
    np.testing.assert_array_equal((directions @ kept.T).max(axis=1), (directions @ corners.T).max(axis=1))
    assert {*map(tuple, kept.tolist())} <= {*map(tuple, corners.tolist())}
    assert careless or ndim == 1 or len(kept) < len(corners)
