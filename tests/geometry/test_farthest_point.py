"""How far dilated points reach: never less than any place of them, and no more than the best of many."""

import numpy as np
import pytest

from warp_bounding.geometry import farthest

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


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("size", [1e-6, 0.3, 5.0])
@pytest.mark.parametrize("diagonal", [True, False])
def test_it_is_the_farthest_place_and_never_nearer(n, size, diagonal):
    rng = np.random.default_rng(n)
    centres, matrix = rng.normal(size=(20, n)), size * rng.normal(size=(n, n))
    matrix = np.diag(np.diag(matrix)) if diagonal else matrix
    found, best = farthest(centres, matrix), best_place(centres, matrix)
    assert best * (1 - 1e-15) <= found <= best * (1 + NEAR)


def test_centres_on_an_axis_or_at_the_origin_are_no_special_case():
    stretch = np.diag([3.0, 1.0, 1.0])  # the farthest places of a centre on another axis are not above it
    for centre in ([0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 2.0, 0.0], [1.0, 0.0, 0.0]):
        centres = np.array([centre])
        best = best_place(centres, stretch)
        assert best * (1 - 1e-15) <= farthest(centres, stretch) <= best * (1 + NEAR)


def test_the_sum_of_lengths_is_what_it_improves_on():
    centres, matrix = np.array([[0.0, 1.0]]), np.diag([1.0, 0.1])
    assert farthest(centres, matrix) < 0.75 * 2.0


def test_nothing_that_is_added_leaves_the_length():
    assert farthest(np.array([[3.0, 4.0]]), np.zeros((2, 2))) == pytest.approx(5.0, rel=1e-13)


def test_a_flat_dilation_goes_one_way_only():
    assert farthest(np.array([[3.0, 4.0]]), np.array([[0.0, 0.0], [0.0, 2.0]])) == pytest.approx(45.0**0.5, rel=1e-11)
