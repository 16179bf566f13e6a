"""Planning for arms, by roadmaps and trees: exact checks along edges, the same paths with proven bounders."""

import sys

import numpy as np
import pytest

import warp_bounding as wb
from sims.arm.demo import SPECS, Example, Trees, phases, robot_places, simulate
from sims.arm.exact import STEP, Hulls, Meshes
from sims.arm.meshes import MeshModel
from sims.arm.pictures import draw
from sims.arm.robot_pictures import posed
from sims.arm.robots import CELLS, Cell, planar
from sims.arm.seven import cell, planned
from sims.arm.workplace import Workplace
from sims.planning.broad import BroadPhase, Every, Points, Samples, Segments
from sims.prefitted import stored

STATES, PROBLEMS = 150, 6
PROVEN = ("aabb", "bvh", "learned-kdop", "mlp", "learned-kdop+mlp")
MESHES = "checks of meshes need Coal and Pinocchio: pip install 'warp-bounding[arms]'"


class Everything(BroadPhase):
    """It clears whatever it is queried."""

    def states(self, x):
        return np.ones(len(x), dtype=bool)

    def edges(self, starts, ends):
        return np.ones(len(starts), dtype=bool)


@pytest.fixture(scope="module")
def place():
    posts = [wb.arms.Body.sphere([x, y, 0], 0.08, name="post") for x, y in ((0.6, 0.3), (-0.5, 0.45), (0.1, -0.65))]
    return Workplace(Cell("posts", "Two joints among posts", planar((0.45, 0.4)), tuple(posts)))


@pytest.fixture(scope="module")
def bounders(place):
    own = {"bvh": {"leaves": 24}, "learned-kdop": {"steps": 20}}
    own["mlp"] = {"hidden": (4, 12, 12), "steps": 200}
    own["occupancy"] = {"hidden": (16, 16), "steps": 120}
    made = {}
    for name, spec in SPECS.items():
        reported = {"query": spec.query, "method": spec.method, "resolution": spec.resolution} | own.get(name, {})
        made[name] = wb.fit(place.shape, **reported, device="cpu", progress=False)
    return made


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


def test_edges_do_not_miss_a_collision_and_what_is_cleared_along_them_is_not_checked(place, rng):
    a, b = place.draw(200, rng), place.draw(200, rng)
    whole, part, none = Hulls(place), Hulls(place), Hulls(place)
    hit, queried = whole.segments(a, b), []
    t = np.linspace(0, 1, 4097)[1:-1, None]
    pairs = zip(a.astype(float), b.astype(float), strict=True)
    every = np.array([place.shape.contains(p + t * (q - p)).any() for p, q in pairs])
    assert (every | ~hit).all()
    assert hit.sum() > 0.9 * every.sum()
    assert whole.checks < sum(np.linalg.norm(b - a, axis=1)) / STEP  # they stop at the first collision

    def cleared(x):
        queried.append(len(x))
        free = ~place.shape.contains(x)
        free[::2] = False
        return free

    assert (part.segments(a, b, cleared) == hit).all()
    assert part.checks < 0.8 * whole.checks == 0.8 * sum(queried)
    assert not none.segments(a, b, lambda x: np.ones(len(x), bool)).any()
    assert none.checks == 0


def check_meshes(place: Workplace, rng: np.random.Generator) -> None:
    """Where meshes collide, so do the hulls; they seldom differ."""
    x = place.draw(1000, rng)
    hulls, meshes = Hulls(place).states(x), Meshes(place).states(x)
    assert not (meshes & ~hulls).any()
    assert (meshes != hulls).mean() < 0.02
    assert meshes.any()


def test_meshes_lie_in_the_hulls_and_collide_where_these_do(place, bounders, rng, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "coal", None)
        with pytest.raises(wb.BoundingError, match=r"need.*pip install 'warp-bounding\[arms\]'"):
            MeshModel(place.shape)
    pytest.importorskip("coal", reason=MESHES)
    pytest.importorskip("pinocchio", reason=MESHES)
    check_meshes(Workplace(CELLS["planar-2"]), rng)
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


def test_a_cell_and_the_arm_itself():
    """Two bounders, of the cell and of the arm alone, clear what neither says maybe to; no answer changes."""
    cell = CELLS["planar-3"]
    both, own = Workplace(cell, itself=True), wb.arms.ArmConfigurations(cell.arm, weights=cell.arm.reaching)
    around, alone = (
        wb.fit(shape, method="learned-kdop", steps=20, device="cpu", progress=False) for shape in (both.around, own)
    )
    x = both.draw(2000, np.random.default_rng(2))
    phase = Every(Segments(around), Segments(alone))
    assert not both.shape.contains(x[phase.states(x)]).any()
    assert (both.shape.contains(x) == (both.around.contains(x) | own.contains(x))).all()
    runs = [Trees(both, Hulls(both), each, samples=300, problems=3) for each in (None, phase)]
    for run in runs:
        run.step()
    runs[1].test_final(runs[0])


# --- a robot ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ur5():
    found, lacking = robot_places()
    if lacking:
        pytest.skip(lacking)
    return found[0]


def test_a_robot_plans_the_same_paths_with_bounders_of_its_cell_and_of_itself(ur5):
    """Only together they know all that a UR5 may touch."""
    cell = wb.load(stored(ur5.scene, "mlp"), device="cpu")
    runs = simulate(ur5, Hulls(ur5), {"mlp": cell}, states=200, problems=4)
    runs["mlp"].test_final(runs["none"])
    assert runs["mlp"].checks < runs["none"].checks / 3
    alone = Example(ur5, Hulls(ur5), Segments(cell), states=200, problems=4)
    alone.step()
    assert alone.missed()


def test_meshes_of_a_robot_lie_in_its_hulls(ur5, rng):
    pytest.importorskip("coal", reason=MESHES)
    pytest.importorskip("pinocchio", reason=MESHES)
    check_meshes(ur5, rng)


def test_a_robot_is_drawn_where_its_hulls_are(ur5, rng):
    x = ur5.draw(5, rng)
    arm = ur5.cell.arm
    for vertices, frames in zip(posed(ur5.cell, ur5.joint_values(x))[0], arm.frames(ur5.joint_values(x)), strict=True):
        hulls = [b.points @ frames[b.link, :3, :3].T + frames[b.link, :3, 3] for b in arm.bodies[:-1] if b.link >= 0]
        hulls = np.concatenate([*hulls, arm.bodies[0].points])
        for end in (np.min, np.max):
            assert end(vertices, axis=0) == pytest.approx(end(hulls, axis=0), abs=2e-3)  # metres


def test_a_panda_plans_with_all_joints_and_again_around_a_post(ur5):
    seven = planned(cell())
    assert len(seven.motions.arm.free) == 7
    assert seven.first.proven
    assert not seven.spoiled.proven
    assert seven.spoiled.between[1] == "post"
    assert seven.second.proven
    assert (seven.second.waypoints[[0, -1]] == seven.first.waypoints[[0, -1]]).all()
