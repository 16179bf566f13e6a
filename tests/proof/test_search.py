"""Branch and bound: what it returns holds whenever it stops, and is the minimum where it is complete."""

from types import SimpleNamespace

import numpy as np
import pytest
from bounding_shapes import device_coordinates, object_points, random_bounder, random_mlp, shape
from shape_kinds import network as network_of_sines

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof import least_value, minimum, positive_boxes
from warp_bounding.proof import search as module
from warp_bounding.proof.search import WORST, ShapePositives
from warp_bounding.shapes.grid import Grid, blocks_of


def brute_force(bounder, lower, upper, rng, count=200_000) -> float:
    """The least value found on a dense random sample of boxes, half of the coordinates on faces."""
    box = rng.integers(len(lower), size=count)
    u = rng.random((count, lower.shape[1]))
    u = np.where(rng.random(u.shape) < 0.5, np.round(u), u)
    return float(bounder.reference(lower[box] + u * (upper[box] - lower[box])).min())


@pytest.mark.parametrize("method", METHODS)
def test_bounds_hold_whenever_it_stops(method, rng):
    bounder, grid = random_bounder(method, "c"), shape("c")
    lower, upper = positive_boxes(bounder, grid)
    found = brute_force(bounder, lower, upper, rng)
    for eps, limit in ((1e-2, {}), (0.0, {"budget": 0.0}), (1e-9, {"boxes": 10_000})):
        search = minimum(bounder, lower, upper, eps=eps, **limit)
        assert search.lower_bound <= found
        assert search.lower_bound <= search.upper_bound
        assert search.boxes >= len(lower)
        if search.complete and method != "voxels":
            assert search.upper_bound - search.lower_bound <= max(eps, 1e-5)
            assert search.upper_bound <= found + max(eps, 1e-3)


@pytest.mark.parametrize(("hidden", "activation"), [((8,), "sin"), ((8,), "relu"), ((24, 24), "sin")])
def test_minimum_of_networks_is_what_brute_force_finds(hidden, activation, rng):
    bounder, grid, reported = random_mlp(shape("c"), hidden, activation), shape("c"), []
    lower, upper = positive_boxes(bounder, grid)
    progress = lambda *numbers: reported.append(numbers)  # noqa: E731
    search = minimum(bounder, lower, upper, eps=1e-3, boxes=5_000_000, progress=progress)
    found = brute_force(bounder, lower, upper, rng)
    assert search.complete
    assert search.lower_bound <= found
    assert search.upper_bound - search.lower_bound <= 1e-3
    assert search.lower_bound >= found - 0.02  # the sample comes close, too
    assert all(done > 0 and waiting >= 0 for done, waiting, _ in reported)
    values = bounder.reference(search.worst)
    assert len(search.worst) <= WORST
    assert (np.diff(values) >= -1e-9).all()
    assert np.isclose(values[0], search.upper_bound, atol=1e-9)
    x = search.worst[:, None]
    assert ((x >= lower - 1e-12) & (x <= upper + 1e-12)).all(axis=2).any(axis=1).all()


@pytest.mark.parametrize("cells", [(5, 4), (3, 4, 3), (2, 3, 2, 3)])
def test_the_least_value_of_a_network_over_a_grid_is_a_bound_and_complete(cells, rng):
    occupancy = rng.random(cells) < 0.4
    occupancy.flat[:2] = True, False
    grid = Grid(occupancy)
    bounder = random_mlp(grid)
    search, boxes = least_value(bounder, grid, eps=1e-3), positive_boxes(bounder, grid)
    v = device_coordinates(bounder, object_points(grid, rng, 1000))
    assert search.complete
    assert search.lower_bound <= min(brute_force(bounder, *boxes, rng), bounder.reference(v).min())
    assert search.upper_bound - search.lower_bound <= 1e-3
    assert np.isclose(bounder.reference(search.worst)[0], search.upper_bound, atol=1e-9)
    inside = [((search.worst >= low) & (search.worst <= high)).all(axis=1) for low, high in zip(*boxes, strict=True)]
    assert np.any(inside, axis=0).all()


def test_it_closes_no_box_whose_bound_is_nan():
    def f(v):
        return np.where(v[:, 0] > 0.9, -1.0, 0.0)

    def bound(low, high):
        center = (low + high) / 2
        least = np.where(high[:, 0] > 0.9, np.nan, 0.0)
        return BoxBounds(least, np.argmax(high - low, axis=1), center, f(center), None)

    fake = SimpleNamespace(reference=f, bound=bound)
    assert not minimum(fake, np.zeros((1, 2)), np.ones((1, 2)), eps=0.1, boxes=500).lower_bound > -1


@pytest.mark.parametrize("name", ["c", "single", "five"])
def test_blocks_cover_the_object_once(name):
    grid = shape(name)
    cover = np.zeros(grid.shape, int)
    for first, last in zip(*blocks_of(grid.occupancy), strict=True):
        cover[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] += 1
    assert (cover == grid.occupancy).all()


@pytest.mark.parametrize("name", ["c", "single", "mesh", "animated"])
def test_boxes_hold_all_that_devices_compute(name, rng):
    """P_delta: every coordinate that a device makes of a float32 point of the object lies in one of the boxes."""
    for bounder in (random_bounder("aabb", name), random_bounder("mlp", name)):
        grid = shape(name)
        v = device_coordinates(bounder, object_points(grid, rng, 300))
        lower, upper = positive_boxes(bounder, grid)
        queried = (np.abs(v) <= bounder.domain.limit).all(axis=1)  # outside of time: maybe, without asking
        inside = ((v[:, None] >= lower) & (v[:, None] <= upper)).all(axis=2).any(axis=1)
        assert (inside | ~queried).all()
        assert grid.time or queried.all()


# --- many boxes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("many", "too_many"), [(1000, 2000), (10**9, 10**9)])
def test_bounds_hold_however_few_boxes_may_wait(many, too_many, monkeypatch, rng):
    for name, value in (("MANY", many), ("TOO_MANY", too_many), ("BOX_BATCH", 512)):
        monkeypatch.setattr(module, name, value)
    shell = wb.shapes.Function(
        None, [-0.4] * 3, [0.4] * 3, distance=lambda x: np.abs(np.linalg.norm(x, axis=1) - 0.35) - 0.05
    )
    bounder = random_mlp(shell)
    x = rng.uniform(shell.lower, shell.upper, (100_000, 3))
    points = bounder.domain.to_local(x[shell.contains(x)])
    positives = ShapePositives(bounder, shell)
    search = minimum(positives, *positives.boxes(), eps=1e-4, boxes=20_000, points=points[:100])
    assert -np.inf < search.lower_bound <= bounder.reference(points).min()


# --- half-spaces that hold a shape in boxes --------------------------------------------------------------------------


def test_what_is_held_bounds_f_and_what_is_cut_off_does_not_matter(rng):
    own = network_of_sines()
    bounder = random_mlp(own)
    positives = ShapePositives(bounder, own)
    limit = bounder.domain.limit.astype(float)
    size = 2 * limit * 10.0 ** rng.uniform(-3, 0.2, (4000, 1)) * rng.random((4000, 3))
    low = rng.uniform(-limit - size / 2, limit - size / 2)
    low, high = np.maximum(low, -limit), np.minimum(low + size, limit)
    bounds = positives.bound(low, high)
    target = bounds.lower + rng.uniform(-1, 3, 4000)
    found = positives.tightened(low, high, bounds, target)
    inside, outside = found.corners
    v = low[:, None] + rng.choice([0.0, 1.0, 0.5, 0.2, 0.7], (4000, 40, 3)) * (high - low)[:, None]
    holds = positives.holds(v.reshape(-1, 3)).reshape(4000, 40)
    f = bounder.reference(v.reshape(-1, 3)).reshape(4000, 40)
    assert (f >= found.lower[:, None])[holds].all()
    kept = ((v >= inside[:, None]) & (v <= outside[:, None])).all(axis=2)
    assert (f >= target[:, None])[holds & ~kept].all()
    assert (inside >= low).all()
    assert (outside <= high).all()
    assert (holds & ~kept).any()
    assert ((found.lower > bounds.lower) & (found.lower < np.inf)).any()
    assert (found.cut == ((inside > low) | (outside < high)).any(axis=1)).all()
