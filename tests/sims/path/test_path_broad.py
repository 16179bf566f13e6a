from fractions import Fraction

import numpy as np
import pytest

import warp_bounding as wb
from sims.path.demo import BY_QUERY
from sims.path.exact import ExactWorld
from sims.planning.broad import (
    FREE,
    HIT,
    MAYBE,
    Boxes,
    First,
    Samples,
    Segments,
    TwoSided,
    _boxes,
    clear_by_boxes,
)

STEPS = 60  # of training: the proof, not the fit, is what is tested


@pytest.fixture(scope="module")
def grid():
    occupied = np.zeros((20, 20), dtype=bool)
    occupied[4:7, 3:15] = occupied[7:16, 12:15] = occupied[14:17, 4:6] = True
    return wb.IndicatorGrid(occupied, name="walls")


@pytest.fixture(scope="module")
def edges(grid):
    """Short and long edges, some of which end in a corner of a cell or one float beside it."""
    rng = np.random.default_rng(1)
    starts = (grid.lower + rng.random((4000, 2)) * (grid.upper - grid.lower)).astype(np.float32)
    way = rng.normal(size=(4000, 2)) * rng.choice([0.01, 0.05, 0.3], (4000, 1))
    ends = (starts + way).astype(np.float32)
    corners = grid.position(grid.occupied[rng.integers(0, len(grid.occupied), 500)] - 0.5).astype(np.float32)
    ends[:500] = np.nextafter(corners, np.float32(rng.choice([-1.0, 1.0], (500, 2)) * np.inf).astype(np.float32))
    return starts, ends


@pytest.fixture(scope="module")
def bounders(grid):
    def fit(method, query="point", **options):
        return wb.fit(grid, query=query, method=method, device="cpu", **options)

    return {
        "aabb": fit("aabb", "box"),
        "kdop": fit("kdop", "box"),
        "bvh": fit("bvh", "box", leaves=12),
        "learned-kdop": fit("learned-kdop", "box", steps=STEPS),
        "mlp": fit("mlp", hidden=(16, 16), steps=STEPS),
        "mlp-early": fit("mlp-early", hidden=(16, 16), steps=STEPS),
        "distance": fit("mlp", "distance", hidden=(16, 16), steps=10 * STEPS),
        "distance-grid": fit("distance-grid", "distance", nodes=32),
        "inside": fit("mlp", hidden=(16, 16), steps=5 * STEPS, side="inside"),
    }


def phase(bounders, name):
    if name == "aabb+mlp":
        return First(Boxes(bounders["aabb"]), Segments(bounders["mlp"]))
    return BY_QUERY[bounders[name].query_kind](bounders[name])


@pytest.mark.parametrize("name", ["bvh", "mlp", "aabb+mlp", "distance", "distance-grid"])
def test_what_is_certain_on_both_sides_is_true(name, grid, edges, bounders):
    world, broad = ExactWorld(grid), phase(bounders, name)
    sided, states = TwoSided(broad, bounders["inside"]), np.concatenate(edges)
    for asked, truth in (((states,), world.states(states)), (edges, world.segments(*edges))):
        found, without = sided.classify(*asked), broad.classify(*asked)
        assert not truth[found == FREE].any()
        assert truth[found == HIT].all()
        assert (found[without == FREE] == FREE).all()
        assert (found == HIT).sum() > 100
        assert (found == MAYBE).sum() < (without == MAYBE).sum()
        assert broad.classify(*(part[:0] for part in asked)).shape == (0,)
        assert sided.classify(*(part[:0] for part in asked)).shape == (0,)


@pytest.mark.parametrize(
    "name", ["aabb", "kdop", "bvh", "learned-kdop", "mlp", "mlp-early", "aabb+mlp", "distance", "distance-grid"]
)
def test_nothing_that_collides_is_cleared(name, grid, edges, bounders):
    world, broad = ExactWorld(grid), phase(bounders, name)
    assert not (broad.edges(*edges) & world.segments(*edges)).any()
    assert not (broad.edges(*edges[::-1]) & world.segments(*edges)).any()
    x = np.concatenate(edges)
    assert not (broad.states(x) & world.states(x)).any()
    assert broad.edges(*edges).sum() > 500


def test_the_boxes_of_pieces_hold_them():
    """In exact arithmetic, with coordinates of very different sizes."""
    rng, count = np.random.default_rng(2), 300
    starts, ends = (
        (rng.normal(size=(count, 2)) * 10.0 ** rng.integers(-12, 4, (count, 2))).astype(np.float32) for _ in range(2)
    )
    first = rng.integers(0, 8, count) / 8
    last = first + 1 / 8
    boxes = _boxes(starts.astype(np.float64), ends.astype(np.float64), first, last)
    assert boxes.dtype == np.float32
    for i in range(count):
        for k in range(2):
            a, b = Fraction(float(starts[i, k])), Fraction(float(ends[i, k]))
            for t in (Fraction(first[i]), Fraction(last[i])):
                assert Fraction(float(boxes[i, k])) <= a + t * (b - a) <= Fraction(float(boxes[i, 2 + k]))


def test_halving_clears_more(grid, edges, bounders):
    shares = [clear_by_boxes(bounders["bvh"], *edges, halvings=h).mean() for h in (0, 1, 3)]
    assert shares[0] < shares[1] < shares[2]


def test_a_cascade_clears_what_either_clears(edges, bounders):
    first, second = Boxes(bounders["aabb"]), Segments(bounders["mlp"])
    both = First(first, second)
    np.testing.assert_array_equal(both.edges(*edges), first.edges(*edges) | second.edges(*edges))
    x = edges[0]
    np.testing.assert_array_equal(both.states(x), first.states(x) | second.states(x))


def test_samples_are_half_a_cell_apart_and_miss_what_lies_between(grid, bounders):
    class Watched:
        def query(self, x):
            self.points = x
            return bounders["mlp"].query(x)

    watched = Watched()
    samples = Samples(watched, grid.cells_per_unit)
    starts, ends = np.float32([[0.0, 0.0], [0.5, 0.5]]), np.float32([[0.1, 0.9], [0.5, 0.5]])
    assert samples.edges(starts, ends).shape == (2,)
    length = np.linalg.norm((ends[0] - starts[0]) * 19)
    assert len(watched.points) == np.ceil(length / 0.5) + 1 + 2
    np.testing.assert_array_equal(watched.points[0], starts[0])
    np.testing.assert_allclose(watched.points[-3], ends[0], rtol=1e-6)
    steps = np.linalg.norm(np.diff(watched.points[:-2], axis=0) * 19, axis=1)
    assert steps.max() <= 0.5 + 1e-5
    assert samples.edges(starts[:0], ends[:0]).shape == (0,)


def test_nothing_to_ask(bounders):
    nothing = np.zeros((0, 2), dtype=np.float32)
    for name in ("bvh", "mlp", "aabb+mlp", "distance", "distance-grid"):
        assert phase(bounders, name).edges(nothing, nothing).shape == (0,)
        assert phase(bounders, name).states(nothing).shape == (0,)


def test_bad_input_is_refused(bounders):
    x = np.zeros((3, 2), dtype=np.float32)
    with pytest.raises(wb.BounderError, match="bounder of boxes"):
        clear_by_boxes(bounders["mlp"], x, x)
    with pytest.raises(wb.QueryError, match=r"\(N, 2\)"):
        clear_by_boxes(bounders["bvh"], x, x[:2])
    with pytest.raises(wb.QueryError, match="halvings"):
        clear_by_boxes(bounders["bvh"], x, x, halvings=-1)
