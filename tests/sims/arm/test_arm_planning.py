"""Planning for an arm: exact checks along edges, hulls and meshes as narrow phases, and the same paths with every proven bounder."""

import sys

import numpy as np
import pytest

import warp_bounding as wb
from sims.arm.demo import SPECS, Example, phases, simulate
from sims.arm.exact import STEP, Hulls, Meshes
from sims.arm.meshes import MeshModel, mesh_of
from sims.arm.pictures import draw, shapes_at, slice_of
from sims.arm.robots import CELLS, Cell, planar
from sims.arm.workplace import Workplace
from sims.planning.broad import BroadPhase

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
    own |= {
        "mlp": {"hidden": (4, 12, 12), "steps": 200, "thresholds": 16},
        "occupancy": {"hidden": (16, 16), "steps": 120},
    }
    made = {}
    for name, spec in SPECS.items():
        told = {"query": spec.query, "method": spec.method, "resolution": spec.resolution} | own.get(name, {})
        made[name] = wb.fit(place.shape, **told, device="cpu", progress=False)
    return made


@pytest.fixture(scope="module")
def examples(place, bounders):
    return simulate(place, Hulls(place), bounders, states=STATES, problems=PROBLEMS)


class Everything(BroadPhase):
    """A broad phase that clears whatever it is asked."""

    def states(self, x):
        return np.ones(len(x), dtype=bool)

    def edges(self, starts, ends):
        return np.ones(len(starts), dtype=bool)


def test_proven_bounders_change_nothing_but_the_work(examples):
    none = examples["none"]
    assert none.solved == PROBLEMS
    assert not none.collisions().any()
    for name in PROVEN:
        examples[name].test_final(none)
        assert examples[name].checks <= none.checks
    assert examples["learned-kdop+mlp"].checks < none.checks


def test_what_clears_everything_is_found_out(place, examples):
    wrong = Example(place, Hulls(place), Everything(), states=STATES, problems=PROBLEMS)
    wrong.step()
    assert wrong.checks == 0
    assert wrong.missed() > 0
    with pytest.raises(AssertionError, match="cleared that collide"):
        wrong.test_final(examples["none"])


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
    assert exact.segments(a, a).shape == (1,)


def test_edges_stop_at_the_first_collision_and_do_not_miss_one(place, rng):
    exact = Hulls(place)
    a, b = place.draw(300, rng), place.draw(300, rng)
    hit = exact.segments(a, b)
    t = np.linspace(0, 1, 4097)[1:-1, None]
    every = np.array([place.shape.contains(p + t * (q - p)).any() for p, q in zip(a.astype(float), b.astype(float), strict=True)])  # fmt: skip
    assert (every | ~hit).all()
    assert hit.sum() > 0.9 * every.sum()
    assert exact.checks < sum(np.linalg.norm(b - a, axis=1)) / STEP


def test_what_is_cleared_along_an_edge_is_not_checked(place, rng):
    a, b = place.draw(200, rng), place.draw(200, rng)
    whole, part, none = Hulls(place), Hulls(place), Hulls(place)
    hit, asked = whole.segments(a, b), []

    def cleared(x):
        asked.append(len(x))
        free = ~place.shape.contains(x)
        free[::2] = False
        return free

    assert (part.segments(a, b, cleared) == hit).all()
    assert part.checks < 0.8 * whole.checks == 0.8 * sum(asked)
    assert not none.segments(a, b, lambda x: np.ones(len(x), bool)).any()
    assert none.checks == 0


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


def test_meshes_lie_in_the_hulls(rng):
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
        assert away.max() <= body.radius
        assert away.max() >= 0.9 * body.radius


@pytest.mark.parametrize("name", ["planar-2", "six"])
def test_meshes_collide_where_hulls_do(name, rng):
    pytest.importorskip("coal", reason=MESHES)
    pytest.importorskip("pinocchio", reason=MESHES)
    place = Workplace(CELLS[name])
    x = place.draw(2000, rng)
    hulls, meshes = Hulls(place).states(x), Meshes(place).states(x)
    assert not (meshes & ~hulls).any()
    assert (meshes != hulls).mean() < 0.02
    assert meshes.any()


def test_planning_with_meshes(place, bounders):
    pytest.importorskip("coal", reason=MESHES)
    pytest.importorskip("pinocchio", reason=MESHES)
    some = {name: bounders[name] for name in ("aabb", "mlp")}
    found = simulate(place, Meshes(place), some, states=60, problems=2)
    for name in some:
        found[name].test_final(found["none"])


def test_without_coal_it_is_said_what_is_missing(place, monkeypatch):
    monkeypatch.setitem(sys.modules, "coal", None)
    with pytest.raises(wb.BoundingError, match=r"need.*pip install 'warp-bounding\[arms\]'"):
        MeshModel(place.shape)


def test_pictures(place, bounders, examples, tmp_path):
    pair = examples["mlp"], examples["occupancy"]
    file = draw(tmp_path, [pair], [bounders], ("mlp", "occupancy"))
    assert file.stat().st_size > 10_000
    assert examples["mlp"].render(tmp_path)[0].name == "arm-posts.png"
    x, degrees = slice_of(place, np.zeros(2, np.float32), 5)
    assert x.shape == (25, 2)
    assert degrees[0] == pytest.approx([-180, -90, 0, 90, 180], abs=1e-4)
    assert len(shapes_at(place, np.zeros(2))) == 2


def test_phases_ask_what_has_no_proof_last(bounders):
    assert list(phases(bounders))[-1] == "occupancy"
