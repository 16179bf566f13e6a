"""Planning for arms, by roadmaps and by trees: exact checks along edges, and the same paths with every proven
bounder."""

import sys

import numpy as np
import pytest

import warp_bounding as wb
from sims.arm.demo import SPECS, Example, Trees, phases, simulate
from sims.arm.exact import STEP, Hulls, Meshes, Stepped
from sims.arm.meshes import MeshModel, mesh_of
from sims.arm.pictures import draw
from sims.arm.robots import CELLS, Cell, planar
from sims.arm.workplace import Workplace
from sims.planning.broad import BroadPhase, Every, Points, Samples, Segments

STATES, PROBLEMS = 150, 6
PROVEN = ("aabb", "bvh", "learned-kdop", "mlp", "learned-kdop+mlp")
MESHES = "checks of meshes need Coal and Pinocchio: pip install 'warp-bounding[arms]'"


@pytest.fixture(scope="module")
def place():
    posts = [wb.arms.Body.sphere([x, y, 0], 0.08, name="post") for x, y in ((0.6, 0.3), (-0.5, 0.45), (0.1, -0.65))]
    return Workplace(Cell("posts", "Two joints among posts", planar((0.45, 0.4)), tuple(posts)))


@pytest.fixture(scope="module")
def bounders(place):
    own = {"bvh": {"leaves": 24}, "learned-kdop": {"steps": 20}}
    own["mlp"] = {"hidden": (4, 12, 12), "steps": 200, "thresholds": 16}
    own["occupancy"] = {"hidden": (16, 16), "steps": 120}
    made = {}
    for name, spec in SPECS.items():
        told = {"query": spec.query, "method": spec.method, "resolution": spec.resolution} | own.get(name, {})
        made[name] = wb.fit(place.shape, **told, device="cpu", progress=False)
    return made


class Everything(BroadPhase):
    """A broad phase that clears whatever it is asked."""

    def states(self, x):
        return np.ones(len(x), dtype=bool)

    def edges(self, starts, ends):
        return np.ones(len(starts), dtype=bool)


@pytest.mark.parametrize("name", CELLS)
def test_a_cell_has_free_and_colliding_configurations(name, rng):
    shape = CELLS[name].shape()
    assert shape.ndim == len(CELLS[name].arm.joints)
    held = shape.contains(rng.uniform(shape.lower, shape.upper, (5_000, shape.ndim)))
    assert 0.05 < held.mean() < 0.95


def test_roadmaps_are_the_same_with_proven_bounders_and_what_clears_everything_is_found_out(place, bounders, tmp_path):
    examples = simulate(place, Hulls(place), bounders, states=STATES, problems=PROBLEMS)
    none = examples["none"]
    assert none.solved == PROBLEMS
    assert not none.collisions().any()
    for name in PROVEN:
        examples[name].test_final(none)
        assert examples[name].checks <= none.checks
    assert examples["learned-kdop+mlp"].checks < none.checks
    wrong = Example(place, Hulls(place), Everything(), states=STATES, problems=PROBLEMS)
    wrong.step()
    assert (wrong.checks, wrong.missed() > 0) == (0, True)
    with pytest.raises(AssertionError, match="cleared that collide"):
        wrong.test_final(none)
    assert list(phases(bounders))[-1] == "occupancy"  # what has no proof comes last
    file = draw(tmp_path, [(examples["mlp"], examples["occupancy"])], [bounders], ("mlp", "occupancy"))
    assert file.stat().st_size > 10_000


def test_an_edge_is_checked_at_configurations_that_are_near_each_other(place, rng, monkeypatch):
    exact, asked = Hulls(place), []
    monkeypatch.setattr(Hulls, "hits", lambda self, x: (asked.append(x), np.zeros(len(x), bool))[1])
    a, b = (place.draw(1, rng) for _ in range(2))
    assert not exact.segments(a, b).any()
    at = np.concatenate([a, *asked, b]).astype(np.float64)
    way = (b - a)[0].astype(np.float64)
    t = np.sort((at - a) @ way / (way @ way))
    assert len(at) == exact.checks + 2
    assert np.diff(t).max() * np.linalg.norm(way) <= STEP
    assert np.allclose(at, a + ((at - a) @ way / (way @ way))[:, None] * way)


def test_edges_do_not_miss_a_collision_and_what_is_cleared_along_them_is_not_checked(place, rng):
    a, b = place.draw(200, rng), place.draw(200, rng)
    whole, part, none = Hulls(place), Hulls(place), Hulls(place)
    hit, asked = whole.segments(a, b), []
    t = np.linspace(0, 1, 4097)[1:-1, None]
    pairs = zip(a.astype(float), b.astype(float), strict=True)
    every = np.array([place.shape.contains(p + t * (q - p)).any() for p, q in pairs])
    assert (every | ~hit).all()
    assert hit.sum() > 0.9 * every.sum()
    assert whole.checks < sum(np.linalg.norm(b - a, axis=1)) / STEP  # they stop at the first collision

    def cleared(x):
        asked.append(len(x))
        free = ~place.shape.contains(x)
        free[::2] = False
        return free

    assert (part.segments(a, b, cleared) == hit).all()
    assert part.checks < 0.8 * whole.checks == 0.8 * sum(asked)
    assert not none.segments(a, b, lambda x: np.ones(len(x), bool)).any()
    assert none.checks == 0
    one = Hulls(place)
    assert [bool(one.segments(p[None], q[None], cleared)[0]) for p, q in zip(a[:20], b[:20], strict=True)] == hit[
        :20
    ].tolist()


def test_mistakes(place):
    exact = Hulls(place)
    for x in (np.zeros((3, 2)), np.zeros((3, 3), np.float32), np.full((1, 2), np.nan, np.float32)):
        with pytest.raises(wb.QueryError):
            exact.states(x)
    with pytest.raises(wb.QueryError, match="as many ends"):
        exact.segments(np.zeros((3, 2), np.float32), np.zeros((2, 2), np.float32))
    swallowed = Cell("full", "Full", planar((0.5,)), (wb.arms.Body.sphere([0, 0, 0], 1.0),))
    with pytest.raises(wb.IndicatorError, match="free of collisions"):
        Workplace(swallowed).problems_of(2, 0)


def test_meshes_lie_in_the_hulls_and_collide_where_these_do(place, bounders, rng, monkeypatch):
    for body in (
        wb.arms.Body.capsule([0, 0, 0], [0.5, 0.1, 0], 0.05),
        wb.arms.Body.box([0, 0, 0], [1, 2, 3], radius=0.1),
        wb.arms.Body.box([0, 0, 0], [1, 2, 3]),
    ):
        x = mesh_of(body).vertices
        low, high = body.points.min(axis=0), body.points.max(axis=0)
        if len(body.points) == 2:
            way = high - low
            t = np.clip((x - low) @ way / (way @ way), 0, 1)[:, None]
            away = np.linalg.norm(x - low - t * way, axis=1)
        else:
            away = np.linalg.norm(np.maximum(np.maximum(low - x, x - high), 0), axis=1)
        assert 0.9 * body.radius <= away.max() <= body.radius
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "coal", None)
        with pytest.raises(wb.BoundingError, match=r"need.*pip install 'warp-bounding\[arms\]'"):
            MeshModel(place.shape)
    pytest.importorskip("coal", reason=MESHES)
    pytest.importorskip("pinocchio", reason=MESHES)
    for name in ("planar-2", "six"):
        cell = Workplace(CELLS[name])
        x = cell.draw(1000, rng)
        hulls, meshes = Hulls(cell).states(x), Meshes(cell).states(x)
        assert not (meshes & ~hulls).any()
        assert (meshes != hulls).mean() < 0.02
        assert meshes.any()
    some = {name: bounders[name] for name in ("aabb", "mlp")}
    found = simulate(place, Meshes(place), some, states=60, problems=2)
    for name in some:
        found[name].test_final(found["none"])


# --- trees of RRT-Connect --------------------------------------------------------------------------------------------


def test_trees_find_free_paths_and_the_same_with_proven_bounders(place, bounders):
    alone = Trees(place, Hulls(place), problems=PROBLEMS)
    alone.step()
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
    kdop = bounders["learned-kdop"]
    for phase in (Segments(bounders["aabb"]), Segments(kdop), Points(kdop)):
        example = Trees(place, Hulls(place), phase, problems=PROBLEMS)
        example.step()
        example.test_final(alone)
        assert example.checks <= alone.checks
    broken = bounders["aabb"].to("cpu").freeze(2.0, None)  # denies nearly everything
    example = Trees(place, Hulls(place), Samples(broken, [50.0, 50.0], 1.0), problems=PROBLEMS)
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


def test_few_states_are_answered_as_by_a_query(place, bounders, rng):
    phase, x = Points(bounders["learned-kdop"]), place.draw(300, rng)
    truth = bounders["learned-kdop"].query(x).numpy() == 0
    assert 0 < truth.sum() < len(x)
    for first, last in ((0, 300), (0, 64), (64, 65), (100, 100), (120, 180)):
        assert (phase.states(x[first:last]) == truth[first:last]).all()
    assert not phase.edges(x, x).any()


def test_a_cell_and_the_arm_itself():
    """Two bounders, of the cell and of the arm alone, clear only what neither says maybe to; together they change no
    answer."""
    cell = CELLS["planar-3"]
    both, own = Workplace(cell, itself=True), wb.arms.ArmConfigurations(cell.arm, weights=cell.arm.reaching)
    around, alone = (
        wb.fit(shape, method="learned-kdop", steps=20, device="cpu", progress=False) for shape in (cell.shape(), own)
    )
    x = both.draw(2000, np.random.default_rng(2))
    phase = Every(Segments(around), Segments(alone))
    assert not both.shape.contains(x[phase.states(x)]).any()
    assert (both.shape.contains(x) == (cell.shape().contains(x) | own.contains(x))).all()
    runs = [Trees(both, Hulls(both), each, samples=300, problems=3) for each in (None, phase)]
    for run in runs:
        run.step()
    runs[1].test_final(runs[0])
