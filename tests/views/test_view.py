"""What is seen of a bounder: its own answers and the shape's own truth, for each radius or time."""

import itertools

import numpy as np
import pytest
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.errors import QueryError
from warp_bounding.views import view_of

pytest.importorskip("pyvista")
FEW = {"resolution": 12, "samples": 4000}


def box(name: str, **options):
    return wb.fit(shape(name), method="aabb", device="cpu", **options)


def test_rates_are_those_of_evaluate():
    bounder, grid = box("star"), shape("star")
    seen = view_of(bounder, grid, resolution=8, samples=50_000).states[0]
    rates = wb.evaluate(bounder, grid, samples=50_000)
    assert seen.fp_rate == pytest.approx(rates.fp_rate, abs=1.0)
    assert (seen.fn, rates.fn, seen.samples) == (0, 0, 50_000)


def test_the_bound_of_a_box_is_that_box():
    bounder = box("star")
    seen = view_of(bounder, shape("star"), **FEW)
    grid = shape("star")
    low, high = grid.position(grid.occupied.min(axis=0) - 0.5), grid.position(grid.occupied.max(axis=0) + 0.5)
    np.testing.assert_allclose(seen.states[0].bound.vertices.min(axis=0), low, atol=1e-3)
    np.testing.assert_allclose(seen.states[0].bound.vertices.max(axis=0), high, atol=1e-3)
    assert (seen.lower < low).all()
    assert (seen.upper > high).all()


def test_groups_of_points_have_the_answer_and_the_truth_that_they_are_named_for():
    bounder, grid = box("c"), shape("c")
    broken = bounder.to("cpu").freeze(bounder.threshold + 0.2, None)  # denies a part of the object
    seen = view_of(broken, grid, **FEW).states[0]
    assert seen.fn > 0
    for name, maybe, true in (("denied", 0, False), ("false-positives", 1, False), ("false-negatives", 0, True)):
        points = seen.points[name]
        assert len(points) > 0
        assert (broken.query(points).numpy() == maybe).all()
        assert (grid.contains(points) == true).all()
    assert seen.missed(False).any()
    assert "false negatives" in seen.rates


def test_pixels_of_a_plane_are_the_answers_at_their_centres():
    bounder, grid = box("c"), shape("c")
    seen = view_of(bounder, grid, resolution=30, samples=100)
    state, side = seen.states[0], seen.states[0].bound.shape
    ticks = [
        low + (np.arange(n) + 0.5) * (up - low) / n for low, up, n in zip(seen.lower, seen.upper, side, strict=True)
    ]
    centres = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
    np.testing.assert_array_equal(state.bound.reshape(-1), bounder.query(centres).numpy() == 1)
    np.testing.assert_array_equal(state.object.reshape(-1), grid.contains(centres))
    assert not state.missed(False).any()
    assert seen.down


def test_a_distance_is_seen_at_every_radius():
    far = wb.fit(shape("star"), "distance", "aabb", device="cpu")
    seen = view_of(far, shape("star"), radii=[0.0, 0.1, 0.2], **FEW)
    assert seen.asked == "radius"
    assert [state.label for state in seen.states] == ["0", "0.1", "0.2"]
    reach = [state.bound.vertices.max(axis=0) for state in seen.states]
    for less, more in itertools.pairwise(reach):
        np.testing.assert_allclose(more - less, 0.1, atol=2e-3)
    assert seen.states[0].object is seen.states[1].object
    assert all(state.fn == 0 for state in seen.states)


def test_a_shape_that_moves_is_seen_at_its_times():
    bounder, grid = box("animated"), shape("animated")
    seen = view_of(bounder, grid, times=[0.0, 1.0], **FEW)
    assert seen.asked == "time"
    assert seen.names == ["x", "y", "z"]
    assert not np.array_equal(seen.states[0].object.vertices, seen.states[1].object.vertices)
    assert all(state.fn == 0 for state in seen.states)
    plane = view_of(bounder, grid, times=[0.5], held={1: 0.5}, **FEW)
    assert plane.names == ["coordinate 2", "coordinate 3"]
    assert plane.states[0].fn == 0


@pytest.mark.slow
def test_from_the_inside_what_is_held_is_in_the_object():
    x = np.stack(np.meshgrid(*[np.linspace(-1, 1, 24)] * 2, indexing="ij"), axis=-1)
    disc = wb.load_indicator(np.hypot(x[..., 0], x[..., 1]) < 0.8)
    bounder = wb.fit(disc, side="inside", hidden=(8,), steps=400, device="cpu", progress=False)
    seen = view_of(bounder, disc, **FEW)
    assert seen.within
    assert seen.states[0].bound.any()
    assert not seen.states[0].missed(True).any()
    assert seen.states[0].fn == 0


def test_boxes_are_asked_as_boxes_without_a_size():
    bounder = wb.fit(shape("c"), "box", "bvh", device="cpu")
    state = view_of(bounder, shape("c"), **FEW).states[0]
    assert state.fn == 0
    assert (state.object <= state.bound).all()


@pytest.mark.parametrize(
    ("name", "options", "told"),
    [
        ("star", {"radii": [0.1]}, "a radius is for distances, got one for point queries"),
        ("star", {"times": [0.1]}, "a time is for shapes that move"),
        ("animated", {}, "expected a time from -0.125 to 1.125"),
        ("animated", {"times": [9.0]}, "where the shape moves, got 9.0"),
        ("animated", {"times": [0.5], "held": {0: 0.5}}, "coordinate 0 is time: expected --time"),
        ("animated", {"times": [np.nan]}, "time must be a finite number, got nan"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(name, options, told):
    with pytest.raises(QueryError, match=told):
        view_of(box(name), shape(name), **options)


def test_what_is_no_matter_of_places_is_refused():
    rays = wb.fit(shape("c"), "ray", "aabb", device="cpu")
    with pytest.raises(QueryError, match="got one of ray queries"):
        view_of(rays, shape("c"))
    with pytest.raises(QueryError, match="the shape is 3D, the bounder 2D"):
        view_of(box("c"), shape("star"))
