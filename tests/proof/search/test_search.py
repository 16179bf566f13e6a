"""Branch and bound: what it returns holds whenever it stops, and is the minimum where it is complete."""

import tracemalloc

import numpy as np
import pytest
from bounding_shapes import object_points, random_bounder, random_mlp, shape

from warp_bounding.bounders import METHODS
from warp_bounding.indicators.grid import blocks_of
from warp_bounding.proof import Search, minimum, positive_boxes
from warp_bounding.proof.search.best_first import WORST, halve


def brute_force(bounder, lower, upper, rng, count=200_000) -> float:
    """The least value found on a dense random sample of boxes, half of the coordinates on faces."""
    box = rng.integers(len(lower), size=count)
    u = rng.random((count, lower.shape[1]))
    u = np.where(rng.random(u.shape) < 0.5, np.round(u), u)
    return float(bounder.reference(lower[box] + u * (upper[box] - lower[box])).min())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("eps", "limit"), [(0.1, {}), (1e-2, {}), (0.0, {"seconds": 0.0}), (1e-9, {"boxes": 20_000})], ids=str
)
def test_bounds_hold_whenever_it_stops(method, eps, limit, rng):
    bounder, grid = random_bounder(method, "c"), shape("c")
    lower, upper = positive_boxes(bounder, grid)
    search = minimum(bounder, lower, upper, eps=eps, **limit)
    assert isinstance(search, Search)
    found = brute_force(bounder, lower, upper, rng)
    assert search.lower_bound <= found
    assert search.lower_bound <= search.upper_bound
    assert search.boxes >= len(lower)
    if search.complete and method != "voxels":
        assert search.upper_bound - search.lower_bound <= max(eps, 1e-5)
        assert search.upper_bound <= found + max(eps, 1e-3)


@pytest.mark.parametrize(
    ("hidden", "activation", "octaves"),
    [((25, 25), "sin", 0), ((25, 25), "relu", 0), ((9, 9), "tanh", 0), ((13, 30, 5), "sin", 0), ((8,), "sin", 2)],
)
def test_minimum_of_networks_is_what_brute_force_finds(hidden, activation, octaves, rng):
    grid = shape("c")
    for seed in range(2):
        bounder = random_mlp(grid, hidden, activation, octaves, seed=seed)
        lower, upper = positive_boxes(bounder, grid)
        search = minimum(bounder, lower, upper, eps=1e-3, boxes=5_000_000)
        found = brute_force(bounder, lower, upper, rng)
        assert search.complete
        assert search.lower_bound <= found
        assert search.upper_bound - search.lower_bound <= 1e-3
        assert search.lower_bound >= found - 0.02  # the sample comes close, too


def test_worst_points_are_sorted_low_and_in_the_boxes():
    bounder, grid = random_mlp(shape("blob")), shape("blob")
    lower, upper = positive_boxes(bounder, grid)
    search = minimum(bounder, lower, upper, eps=1e-3)
    values = bounder.reference(search.worst)
    assert len(search.worst) <= WORST
    assert (np.diff(values) >= -1e-9).all()
    assert np.isclose(values[0], search.upper_bound, atol=1e-9)
    inside = (
        ((search.worst[:, None] >= lower - 1e-12) & (search.worst[:, None] <= upper + 1e-12)).all(axis=2).any(axis=1)
    )
    assert inside.all()


def test_points_that_are_known_speed_it_up_and_change_nothing(rng):
    bounder, grid = random_mlp(shape("blob")), shape("blob")
    lower, upper = positive_boxes(bounder, grid)
    plain = minimum(bounder, lower, upper, eps=1e-4)
    helped = minimum(bounder, lower, upper, eps=1e-4, points=plain.worst)
    assert helped.boxes <= plain.boxes
    assert helped.lower_bound <= plain.upper_bound
    assert plain.lower_bound <= helped.upper_bound


@pytest.mark.parametrize("eps", [0.0, 1e-15])
def test_it_ends_without_a_tolerance(eps):
    """Float64 cannot tell bound and value apart any further; the search must not try for ever."""
    bounder, grid = random_mlp(shape("line")), shape("line")
    search = minimum(bounder, *positive_boxes(bounder, grid), eps=eps, boxes=5_000_000)
    assert search.complete
    assert search.upper_bound - search.lower_bound < 1e-6


def test_memory_grows_with_depth_only():
    bounder, grid = random_mlp(shape("five"), (25, 25), gain=12.0), shape("five")
    lower, upper = positive_boxes(bounder, grid)
    tracemalloc.start()
    search = minimum(bounder, lower, upper, eps=1e-6, boxes=100_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert search.lower_bound <= search.upper_bound
    assert peak < 500e6


def test_progress_is_reported():
    bounder, grid = random_mlp(shape("blob"), (25, 25)), shape("blob")
    seen = []
    minimum(bounder, *positive_boxes(bounder, grid), eps=1e-4, boxes=100_000, progress=lambda *a: seen.append(a))
    assert seen
    assert all(done > 0 and waiting >= 0 for done, waiting, _ in seen)


def test_halves_are_the_whole(rng):
    low, high = rng.random((50, 3)), 1 + rng.random((50, 3))
    axis = rng.integers(3, size=50)
    lower, upper = halve(low, high, axis)
    assert np.allclose((upper - lower).prod(axis=1).reshape(2, -1).sum(axis=0), (high - low).prod(axis=1))
    assert (np.minimum(lower[:50], lower[50:]) == low).all()
    assert (np.maximum(upper[:50], upper[50:]) == high).all()
    assert (upper[np.arange(50), axis] == lower[np.arange(50, 100), axis]).all()


@pytest.mark.parametrize("name", ["line", "c", "star", "single", "animated", "five"])
def test_blocks_cover_the_object_once(name):
    grid = shape(name)
    cover = np.zeros(grid.shape, int)
    for first, last in zip(*blocks_of(grid.occupancy), strict=True):
        cover[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] += 1
    assert (cover == grid.occupancy).all()


@pytest.mark.parametrize("name", ["line", "c", "single", "mesh", "animated"])
def test_boxes_hold_all_that_devices_compute(name, rng):
    """P_delta: every coordinate that a device makes of a float32 point of the object lies in one of the boxes."""
    from bounding_shapes import device_coordinates

    for bounder in (random_bounder("aabb", name), random_bounder("mlp", name)):
        grid = shape(name)
        v = device_coordinates(bounder, object_points(grid, rng, 300))
        lower, upper = positive_boxes(bounder, grid)
        asked = (np.abs(v) <= bounder.domain.limit).all(axis=1)  # outside of time: maybe, without asking
        inside = ((v[:, None] >= lower) & (v[:, None] <= upper)).all(axis=2).any(axis=1)
        assert (inside | ~asked).all()
        assert grid.time or asked.all()
