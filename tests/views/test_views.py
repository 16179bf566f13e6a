"""What is seen of a bounder is its own answers and the shape's own truth, and pictures, windows and pages show that."""

import itertools
import re

import numpy as np
import pytest
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.errors import QueryError
from warp_bounding.views import object_surface, page, view_of

pytest.importorskip("pyvista")
pytest.importorskip("plotly")
FEW = {"resolution": 12}
RADII = [0.0, 0.1, 0.3]


def box(name: str, query: str = "point"):
    return wb.fit(shape(name), query, "aabb", device="cpu")


def volume(surface) -> float:
    """The enclosed volume of a surface that is closed, positive where it is turned outwards."""
    assert surface.is_manifold
    a, b, c = (np.asarray(surface.points, np.float64)[surface.regular_faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_the_object_of_a_grid_lies_where_its_cells_do():
    grid, moving = shape("star"), shape("animated")
    low, high = grid.position(grid.occupied.min(axis=0) - 0.5), grid.position(grid.occupied.max(axis=0) + 0.5)
    found = object_surface(grid, {}, 60)
    np.testing.assert_allclose(np.reshape(found.bounds, (3, 2)).T, [low, high], atol=1e-4)
    assert volume(found) == pytest.approx(len(grid.occupied) / np.prod(grid.cells_per_unit), rel=0.03)
    time = float(moving.position(np.full((1, 4), 3.0))[0, 0])
    cells = moving.occupancy[3].sum() / np.prod(moving.cells_per_unit[1:])
    assert volume(object_surface(moving, {0: time}, 60)) == pytest.approx(cells, rel=0.03)


def test_what_a_wrong_bound_denies_of_the_object_is_seen():
    broken = box("c").to("cpu")
    broken.freeze(broken.threshold + 0.2, None)
    seen = view_of(broken, shape("c"), **FEW).states[0]
    assert (seen.pixels(False) == 3).any()
    assert ((seen.pixels(False) == 3) == (seen.object & ~seen.bound)).all()


@pytest.mark.parametrize("query", ["point", "box"])
def test_pixels_of_a_plane_are_the_answers_at_their_centres(query):
    bounder, grid = box("c", query), shape("c")
    seen = view_of(bounder, grid, resolution=30)
    state, sides = seen.states[0], seen.states[0].bound.shape
    ends = zip(seen.lower, seen.upper, sides, strict=True)
    ticks = [low + (np.arange(n) + 0.5) * (up - low) / n for low, up, n in ends]
    centres = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
    asked = centres if query == "point" else np.hstack([centres, centres])
    np.testing.assert_array_equal(state.bound.reshape(-1), bounder.query(asked).numpy() == 1)
    np.testing.assert_array_equal(state.object.reshape(-1), grid.contains(centres))
    assert ((state.pixels(False) == 3).sum(), seen.down) == (0, True)


def test_a_distance_is_seen_at_every_radius():
    seen = view_of(box("star", "distance"), shape("star"), radii=RADII, **FEW)
    assert (seen.asked, [state.label for state in seen.states]) == ("radius", ["0", "0.1", "0.3"])
    for (less, more), grown in zip(itertools.pairwise(seen.states), np.diff(RADII), strict=True):
        far = np.abs(np.subtract(more.bound.bounds, less.bound.bounds))
        np.testing.assert_allclose(far, grown, atol=4e-3)
    assert seen.states[0].object is seen.states[1].object


def test_a_shape_that_moves_is_seen_at_its_times_and_in_slices():
    bounder, grid = box("animated"), shape("animated")
    seen = view_of(bounder, grid, times=[0.0, 1.0], **FEW)
    assert (seen.asked, seen.names) == ("time", ["x", "y", "z"])
    assert seen.states[0].object.bounds != seen.states[1].object.bounds
    plane = view_of(bounder, grid, times=[0.5], held={1: 0.5}, **FEW)
    assert plane.names == ["coordinate 2", "coordinate 3"]


def test_from_the_inside_what_is_held_is_in_the_object():
    x = np.stack(np.meshgrid(*[np.linspace(-1, 1, 24)] * 2, indexing="ij"), axis=-1)
    disc = wb.load_shape(np.hypot(x[..., 0], x[..., 1]) < 0.8)
    seen = view_of(wb.fit(disc, method="sphere", side="inside", device="cpu"), disc, **FEW)
    assert (seen.within, (seen.states[0].pixels(True) == 3).sum()) == (True, 0)


@pytest.mark.parametrize(
    ("name", "query", "options", "told"),
    [
        ("star", "point", {"radii": [0.1]}, "a radius is for distances, got one for point queries"),
        ("star", "point", {"times": [0.1]}, "a time is for shapes that move"),
        ("star", "point", {"held": {0: 0.0, 1: 0.0}}, "at least 2 coordinates must run, got 1 of the bounder's 3"),
        ("animated", "point", {"times": [np.nan]}, "where the shape moves, got nan"),
        ("animated", "point", {"times": [0.5], "held": {0: 0.5}}, "coordinate 0 is time: expected --time"),
        ("c", "ray", {}, "got one of ray queries"),
    ],
)
def test_what_cannot_be_seen_is_refused(name, query, options, told):
    with pytest.raises(QueryError, match=told):
        view_of(box(name, query), shape(name), **options)


def test_a_page_is_whole_in_itself_and_has_a_step_for_each_radius():
    view = view_of(box("star", "distance"), shape("star"), radii=RADII, **FEW)
    view.facts["Bounder"] = "</script><b>"
    text = page(view, "<i>&", "y")
    markup = re.sub(r"<script.*?</script>", "", text, flags=re.S)
    assert re.findall(r'(?:src|href)="(?!data:)[^"]+"', markup) == []
    assert "<title>&lt;i&gt;&amp;</title>" in text
    assert "<dd>&lt;/script&gt;&lt;b&gt;</dd>" in text
    assert all(f"<dt>{fact}</dt>" in text for fact in view.facts)
    assert '"prefix":"radius "' in text
    plane = page(view_of(box("c"), shape("c"), resolution=16), "c", "y", "plotly.min.js")
    assert 'src="plotly.min.js"' in plane
    assert len(plane) < 100_000
