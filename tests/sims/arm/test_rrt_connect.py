"""RRT-Connect: trees that meet, the same to the bit with a proven bounder, and nothing found where there is nothing."""

import numpy as np
import pytest

import warp_bounding as wb
from sims.arm.demo import Trees
from sims.arm.exact import Hulls, Stepped
from sims.arm.robots import CELLS, Cell, planar
from sims.arm.workplace import Workplace
from sims.planning.broad import Every, Points, Samples, Segments

PROBLEMS = 6


@pytest.fixture(scope="module")
def place():
    posts = [wb.arms.Body.sphere([x, y, 0], 0.08, name="post") for x, y in ((0.6, 0.3), (-0.5, 0.45), (0.1, -0.65))]
    return Workplace(Cell("posts", "Two joints among posts", planar((0.45, 0.4)), tuple(posts)))


@pytest.fixture(scope="module")
def alone(place):
    example = Trees(place, Hulls(place), problems=PROBLEMS)
    example.step()
    return example


def test_paths_lead_from_start_to_goal_and_are_free(place, alone):
    assert alone.solved >= PROBLEMS - 1
    assert not alone.collisions().any()
    for problem, path, length in zip(alone.problems, alone.paths, alone.lengths, strict=True):
        if path is None:
            assert not np.isfinite(length)
            continue
        assert (path[[0, -1]] == problem).all()
        steps = np.linalg.norm(np.diff(path.astype(np.float64), axis=0), axis=1)
        assert (steps <= alone.reach * (1 + 1e-6)).all()
        assert length == pytest.approx(steps.sum())


@pytest.mark.parametrize(
    ("method", "phase"), [("aabb", Segments), ("learned-kdop", Segments), ("learned-kdop", Points)]
)
def test_a_proven_bounder_changes_nothing_but_the_work(method, phase, place, alone):
    options = {"steps": 20} if method == "learned-kdop" else {}
    bounder = wb.fit(place.shape, method=method, device="cpu", progress=False, **options)
    example = Trees(place, Hulls(place), phase(bounder), problems=PROBLEMS)
    example.step()
    example.test_final(alone)
    assert example.checks <= alone.checks
    again = example.state()
    example.step()
    assert example.state() == again


def test_what_clears_too_much_is_found_out(place, alone):
    bounder = wb.fit(place.shape, method="aabb", device="cpu", progress=False)
    bounder.freeze(2.0, None)  # denies nearly everything
    example = Trees(place, Hulls(place), Samples(bounder, [50.0, 50.0], 1.0), problems=PROBLEMS)
    example.step()
    assert example.missed(alone)


def test_no_way_is_no_path(place):
    class Walls(Stepped):
        def hits(self, x):
            return (np.abs(x) < 0.5).any(axis=1)

    example = Trees(place, Walls(place), samples=60, problems=PROBLEMS)
    example.step()
    across = ~example.blocked & ((example.problems[:, 0] > 0) != (example.problems[:, 1] > 0)).any(axis=1)
    assert across.any()
    assert not np.isfinite(example.lengths[across]).any()
    assert all(example.paths[number] is None for number in np.flatnonzero(across))


def test_edges_asked_at_once_are_asked_alike(place, rng):
    shape = place.shape
    ends = rng.uniform(shape.lower, shape.upper, (2, 20, 2)).astype(np.float32)
    asked = []

    def cleared(x):
        asked.append(len(x))
        return x[:, 0] > 0.3

    one = Hulls(place)
    few = [bool(one.segments(a[None], b[None], cleared)[0]) for a, b in zip(*ends, strict=True)]
    assert len(asked) <= 20
    other = Hulls(place)
    assert few == other.segments(*ends, cleared).tolist()
    assert one.checks == other.checks


def test_few_states_are_answered_as_by_a_query(place, rng):
    bounder = wb.fit(place.shape, method="learned-kdop", steps=20, device="cpu", progress=False)
    phase, x = Points(bounder), place.draw(300, rng)
    truth = bounder.query(x).numpy() == 0
    assert 0 < truth.sum() < len(x)
    for first, last in ((0, 300), (0, 64), (64, 65), (100, 100), (120, 180)):
        assert (phase.states(x[first:last]) == truth[first:last]).all()
    assert not phase.edges(x, x).any()


def test_a_cell_and_the_arm_itself():
    """Two bounders, of the cell and of the arm alone, clear only what neither says maybe to; together they change no answer."""
    cell = CELLS["planar-3"]
    both, own = Workplace(cell, itself=True), wb.arms.ArmConfigurations(cell.arm, weights=cell.arm.reaching)
    around, alone = (
        wb.fit(shape, method="learned-kdop", steps=20, device="cpu", progress=False) for shape in (cell.shape(), own)
    )
    x = both.draw(4000, np.random.default_rng(2))
    phase = Every(Segments(around), Segments(alone))
    cleared = phase.states(x)
    assert not both.shape.contains(x[cleared]).any()
    assert (both.shape.contains(x) == (cell.shape().contains(x) | own.contains(x))).all()
    runs = [Trees(both, Hulls(both), each, samples=300, problems=3) for each in (None, phase)]
    for run in runs:
        run.step()
    runs[1].test_final(runs[0])
