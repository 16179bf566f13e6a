"""Planning in the plane: the same paths with every proven bounder, nothing that collides is cleared, and whole demos of
users' worlds."""

import json
from fractions import Fraction
from io import StringIO

import numpy as np
import pytest
from bounding_shapes import report_of
from broken import denying
from rich.console import Console

import warp_bounding as wb
from sims.base import compare
from sims.path.demo import SPECS, phases, run, simulate
from sims.path.exact import ExactWorld
from sims.path.planner import Example
from sims.path.worlds import World
from sims.planning.broad import FREE, HIT, MAYBE, TwoSided, _boxes, clear_by_boxes
from sims.prefitted import FitSpec

STATES, PROBLEMS = 400, 12
SMALL = {"hidden": (16, 16), "steps": 60}
PROVEN = ("aabb", "kdop", "bvh", "learned-kdop", "mlp", "mlp-early", "distance", "distance-grid", "aabb+mlp")
PROVEN += ("mlp+inside", "bvh+inside", "distance+inside", "distance-grid+inside")


def small(name):
    """The demo's spec with a tiny fit, which is longer from the inside and of distances, so that something is
    certain."""
    spec = SPECS[name]
    if spec.closed:
        return spec
    more = {"steps": 300} if "side" in spec.options or spec.query == "distance" else {}
    more |= {"side": spec.options["side"]} if "side" in spec.options else {}
    return FitSpec(spec.method, query=spec.query, options=report_of(spec.method, spec.query, **SMALL) | more)


def walls():
    occupied = np.zeros((24, 24), dtype=bool)
    occupied[5:7, 3:18] = occupied[7:18, 16:18] = occupied[14:16, 4:12] = True
    return occupied


@pytest.fixture(scope="module")
def world():
    return World("walls", wb.shapes.Grid(walls(), name="walls"), "path-walls")


@pytest.fixture(scope="module")
def bounders(world):
    specs = {name: small(name) for name in SPECS}
    return {
        name: wb.fit(world.grid, query=spec.query, method=spec.method, device="cpu", **spec.options)
        for name, spec in specs.items()
    }


@pytest.fixture(scope="module")
def examples(world, bounders):
    return simulate(world, bounders, states=STATES, problems=PROBLEMS)


def test_the_reference_plans_without_a_collision(examples, world):
    none = examples["none"]
    assert (none.solved, none.missed(), none.collisions().any()) == (PROBLEMS, 0, False)
    for problem, path in zip(none.problems, none.paths, strict=True):
        np.testing.assert_array_equal(path[[0, -1]], problem)
    lengths = [np.linalg.norm(np.diff(world.grid.cell_coordinate(path), axis=0), axis=1).sum() for path in none.paths]
    np.testing.assert_allclose(none.lengths, lengths)
    other = Example(world, states=STATES, problems=PROBLEMS, seed=1)
    assert not np.array_equal(other.states, none.states)


def test_proven_bounders_change_nothing_but_the_number_of_checks(examples, bounders):
    assert tuple(examples) == ("none", *PROVEN, "occupancy")
    none = examples["none"]
    for name in PROVEN:
        examples[name].test_final(none)
        assert (examples[name].missed(), examples[name].state()) == (0, none.state())
        assert examples[name].checks < none.checks
    checks = {name: examples[name].checks for name in PROVEN}
    assert checks["aabb+mlp"] <= min(checks["aabb"], checks["mlp"])
    for outer in ("mlp", "bvh", "distance", "distance-grid"):  # what certainly collides needs no check
        assert checks[f"{outer}+inside"] < checks[outer]
    own = {name: {"walls": bounder} for name, bounder in bounders.items()}
    runs = {each.bounder: each for each in compare(examples, own, [{"bounder": "mlp", "fp_rate": 12.5}])}
    assert [runs[name].certificate for name in ("none", "mlp", "aabb+mlp", "occupancy")] == ["", "proven", "proven", ""]
    assert runs["mlp"].fp_rate == 12.5


@pytest.mark.parametrize("name", ["bvh", "mlp", "inside"])
def test_a_broken_bounder_is_found_out(world, bounders, name):
    cells = np.argwhere(~walls()) if name == "inside" else world.grid.occupied
    points = world.grid.position(cells[::5]).astype(np.float32)
    broken = denying(bounders[name], np.concatenate([points, points], axis=1) if name == "bvh" else points)
    queried = {"bvh": bounders["bvh"], name: broken}
    runs = simulate(world, queried, states=STATES, problems=PROBLEMS)
    wrong, reported = ("bvh+inside", "said to collide") if name == "inside" else (name, "were cleared that collide")
    assert runs[wrong].missed() > 0
    with pytest.raises(AssertionError, match=reported):
        runs[wrong].test_final(runs["none"])


def test_blocked_and_unsolvable_problems_are_counted(world):
    occupied = np.zeros((16, 16), dtype=bool)
    occupied[:, 7:9] = True  # a wall from side to side
    left, right, wall = (2 / 15, 2 / 15), (12 / 15, 13 / 15), (0.5, 0.5)
    problems = np.float32([[left, (13 / 15, 2 / 15)], [left, right], [wall, right], [left, wall]])
    parted = World("wall", wb.shapes.Grid(occupied), "path-wall", problems=problems)
    example = Example(parted, states=300, problems=4)
    example.step()
    assert example.blocked.tolist() == [False, False, True, True]
    assert [path is None for path in example.paths] == [False, True, True, True]
    for states in (2, 3, 20):  # hardly any
        example = Example(world, states=states, problems=3)
        example.step()
        assert example.lengths.shape == (3,)


@pytest.fixture(scope="module")
def edges(world):
    """Short and long edges, some of which end in a corner of a cell or one float beside it."""
    rng, grid = np.random.default_rng(1), world.grid
    starts = (grid.lower + rng.random((4000, 2)) * (grid.upper - grid.lower)).astype(np.float32)
    ends = (starts + rng.normal(size=(4000, 2)) * rng.choice([0.01, 0.05, 0.3], (4000, 1))).astype(np.float32)
    corners = grid.position(grid.occupied[rng.integers(0, len(grid.occupied), 500)] - 0.5).astype(np.float32)
    ends[:500] = np.nextafter(corners, np.float32(rng.choice([-1.0, 1.0], (500, 2)) * np.inf).astype(np.float32))
    return starts, ends


def test_nothing_that_collides_is_cleared_and_nothing_free_is_said_to_collide(world, edges, bounders):
    exact, x = ExactWorld(world.grid), np.concatenate(edges)
    broad = phases(bounders, world)
    for name in PROVEN:
        assert not (broad[name].edges(*edges) & exact.segments(*edges)).any(), name
        assert not (broad[name].edges(*edges[::-1]) & exact.segments(*edges)).any(), name
        assert not (broad[name].states(x) & exact.states(x)).any(), name
        assert broad[name].edges(*edges).sum() > 500, name
        assert broad[name].edges(edges[0][:0], edges[1][:0]).shape == (0,)
    for name in ("bvh", "mlp", "aabb+mlp", "distance", "distance-grid"):
        sided = TwoSided(broad[name], bounders["inside"])
        for queried, truth in (((x,), exact.states(x)), (edges, exact.segments(*edges))):
            found, without = sided.classify(*queried), broad[name].classify(*queried)
            assert not truth[found == FREE].any()
            assert truth[found == HIT].all()
            assert (found[without == FREE] == FREE).all()
            assert (found == HIT).sum() > 100
            assert (found == MAYBE).sum() < (without == MAYBE).sum()


def test_the_boxes_of_pieces_hold_them(bounders, edges):
    """In exact arithmetic, with coordinates of very different sizes."""
    rng, count = np.random.default_rng(2), 300
    sizes = (10.0 ** rng.integers(-12, 4, (count, 2)) for _ in range(2))
    starts, ends = ((rng.normal(size=(count, 2)) * size).astype(np.float32) for size in sizes)
    first = rng.integers(0, 8, count) / 8
    boxes = _boxes(starts.astype(np.float64), ends.astype(np.float64), first, first + 1 / 8)
    assert boxes.dtype == np.float32
    for i in range(count):
        for k in range(2):
            a, b = Fraction(float(starts[i, k])), Fraction(float(ends[i, k]))
            for t in (Fraction(first[i]), Fraction(first[i] + 1 / 8)):
                assert Fraction(float(boxes[i, k])) <= a + t * (b - a) <= Fraction(float(boxes[i, 2 + k]))
    shares = [clear_by_boxes(bounders["bvh"], *edges, halvings=h).mean() for h in (0, 1, 3)]
    assert shares[0] < shares[1] < shares[2]
    with pytest.raises(wb.BounderError, match="bounder of boxes"):
        clear_by_boxes(bounders["mlp"], starts, ends)
    with pytest.raises(wb.QueryError, match=r"\(N, 2\)"):
        clear_by_boxes(bounders["bvh"], starts, ends[:2])


def test_users_worlds_are_fitted_once(tmp_path):
    specs, out, mine = {n: small(n) for n in ("aabb", "mlp", "occupancy")}, tmp_path / "out", tmp_path / "mine"
    mine.mkdir()
    np.save(mine / "a.npy", walls())
    rows = "@@@@@@@@@\n" + "@.......@\n" * 7 + "@@@@@@@@@\n"
    (mine / "b.map").write_text(f"type octile\nheight 9\nwidth 9\nmap\n{rows}")
    (mine / "b.map.scen").write_text("version 1\n0\tb.map\t9\t9\t2\t2\t6\t6\t5.6\n0\tb.map\t9\t9\t0\t0\t6\t6\t5.6\n")

    def go(**options):
        console = Console(record=True, width=140, highlight=False, soft_wrap=True, file=StringIO())
        given = {"specs": specs, "quick": True, "states": 200, "problems": 4, "world": mine, **options}
        return run(out, console=console, **given), console.export_text()

    first, text = go()
    json.dumps(first)
    assert first["identical"]
    assert "a.npy: fitted mlp, occupancy for this world" in text
    rows = [
        (world, name)
        for world in ("a.npy", "b.map")
        for name in ("none", "aabb", "mlp", "aabb+mlp", "chosen", "occupancy")
    ]
    assert [(each["section"], each["bounder"]) for each in first["runs"]] == rows
    assert first["worlds"][1] | {"blocked": 1, "solved": 1, "problems": 2} == first["worlds"][1]
    assert first["pictures"] == [str(out / "path.png")]
    times = {file: file.stat().st_mtime_ns for file in out.glob("*.safetensors")}
    assert len(times) == 4
    again, text = go(world=mine / "a.npy")
    assert "took mlp, occupancy from" in text
    assert {file: file.stat().st_mtime_ns for file in times} == times
    for one, other in zip(first["runs"], again["runs"], strict=False):
        assert one["bounder"] == "chosen" or one["narrow_calls"] == other["narrow_calls"]  # chosen by the clock
    mlp = next(file for file in times if file.name.startswith("path-a") and file.name.endswith("-mlp.safetensors"))
    with pytest.raises(wb.BounderError, match=r"expected a bounder of one of b\.map"):
        go(world=mine / "b.map", bounder_file=mlp)
