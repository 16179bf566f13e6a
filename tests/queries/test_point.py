"""The oracle's kernel is ``IndicatorGrid.contains``, point by point, and its samples are where the paper's are."""

import numpy as np
import pytest
from bounding_shapes import SHAPES, domain_points, object_points, shape

from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.queries import check_query
from warp_bounding.queries.exact import oracle_kernel
from warp_bounding.queries.point import POINT


def hard_points(grid, rng):
    t = np.round(rng.uniform(-2, np.array(grid.shape) + 1, (3000, grid.ndim)) * 2) / 2
    x = grid.position(t).astype(np.float32)
    special = rng.choice(np.float32([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3e38, -3e38]), (200, grid.ndim))
    mixed = np.where(rng.random(special.shape) < 0.5, special, x[:200])
    nudged = [np.nextafter(x, np.float32(s * np.inf)) for s in (-1, 1)]
    return np.concatenate([x, *nudged, special, mixed, domain_points(grid, 3000, rng), object_points(grid, rng, 1000)])


@pytest.mark.parametrize("name", SHAPES)
def test_oracle_is_contains(name, device, rng):
    grid = shape(name)
    x = hard_points(grid, rng)
    truth = grid.contains(x)
    assert (POINT.oracle(grid, device)(x) == truth).all()
    assert truth.any()
    assert not truth.all()


@pytest.mark.parametrize("count", [0, 1, 511, 512, 513, 2049])
def test_any_number_of_points(count, device, rng):
    grid = shape("c")
    x = domain_points(grid, count, rng)
    answer = POINT.oracle(grid, device)(x)
    assert answer.dtype == bool
    assert (answer == grid.contains(x)).all()


def test_faces_and_corners_belong_to_the_object(device):
    grid = shape("mesh")
    cell = grid.occupied[7]
    corners = grid.position(cell + np.array(list(np.ndindex((2,) * 3))) - 0.5)
    exact = corners.astype(np.float32)
    assert POINT.oracle(grid, device)(exact[grid.contains(exact)]).all()
    assert POINT.oracle(grid, device)(np.float32([grid.position(cell)])).all()


@pytest.mark.parametrize("x", [np.zeros(3), np.zeros((4, 2)), np.zeros((1, 4, 3))])
def test_oracle_refuses_other_shapes(x):
    with pytest.raises(QueryError, match=r"\(N, 3\)"):
        POINT.oracle(shape("blob"), "cpu")(x)


@pytest.mark.parametrize("name", ["c", "single", "mesh", "animated"])
def test_samples_lie_between_the_outer_centres(name, rng):
    grid = shape(name)
    x = POINT.sample(grid, 20_000, rng)
    assert x.shape == (20_000, grid.ndim)
    assert x.dtype == np.float32
    step = np.float32(1e-6) * np.abs(x).max(axis=0)
    assert (x >= grid.sample_lower - step).all()
    assert (x <= grid.sample_upper + step).all()
    assert (
        np.abs(x.mean(axis=0) - (grid.sample_lower + grid.sample_upper) / 2).max()
        < 0.02 * (grid.upper - grid.lower).max()
    )


def test_kinds_of_queries():
    assert check_query("point") == "point"
    with pytest.raises(QueryError, match="'cone'"):
        check_query("cone")


def test_kernels_of_several_dimensions_do_not_mix(rng):
    oracle_kernel.cache_clear()
    kernels = [POINT.kernel(n) for n in (3, 2, 1)]  # all made before the first is compiled
    assert len({kernel.key for kernel in kernels}) == 3
    for n in (3, 2, 1):
        grid = IndicatorGrid(rng.random((5,) * n) < 0.4)
        x = rng.random((1000, n), dtype=np.float32)
        np.testing.assert_array_equal(POINT.oracle(grid, "cpu")(x), grid.contains(x))
