"""Planning in the plane: the same paths with proven bounders, nothing that collides is cleared; users' worlds."""

import json
from fractions import Fraction
from io import StringIO

import numpy as np
import pytest
from bounding_shapes import denying, report_of
from exact_mesh import passes_box
from rich.console import Console

import warp_bounding as wb
from sims.base import compare
from sims.path.demo import SPECS, phases, run, simulate
from sims.path.exact import ExactWorld
from sims.path.moving_ai import read_map, read_scen, scen_beside
from sims.path.planner import Example
from sims.path.worlds import World, problems_of, worlds_at
from sims.planning.broad import FREE, HIT, MAYBE, TwoSided, _boxes, clear_by_boxes
from sims.prefitted import FitSpec

STATES, PROBLEMS = 400, 12
SMALL = {"hidden": (16, 16), "steps": 60}
PROVEN = ("aabb", "kdop", "bvh", "learned-kdop", "mlp", "distance", "distance-grid", "aabb+mlp")
PROVEN += ("mlp+inside", "bvh+inside", "distance+inside", "distance-grid+inside")


def small(name):
    """The demo's spec with a tiny fit, longer from the inside and of distances, so that something is certain."""
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
    assert {each["section"] for each in first["runs"]} == {"a.npy", "b.map"}
    assert {each["bounder"] for each in first["runs"]} == {"none", "aabb", "mlp", "aabb+mlp", "chosen", "occupancy"}
    assert first["worlds"][1] | {"blocked": 1, "solved": 1, "problems": 2} == first["worlds"][1]
    assert first["pictures"] == [str(out / "path.png")]
    times = {file: file.stat().st_mtime_ns for file in out.glob("*.safetensors")}
    assert len(times) == 4
    text = go(world=mine / "a.npy")[1]
    assert "took mlp, occupancy from" in text
    assert {file: file.stat().st_mtime_ns for file in times} == times
    mlp = next(file for file in times if file.name.startswith("path-a") and file.name.endswith("-mlp.safetensors"))
    with pytest.raises(wb.BounderError, match=r"expected a bounder of one of b\.map"):
        go(world=mine / "b.map", bounder_file=mlp)


# --- worlds of users --------------------------------------------------------------------------------------------------

MAP = "type octile\nheight 3\nwidth 4\nmap\n.@..\nGTSW\n...O\n"
SCEN = "version 1\n0\tm.map\t4\t3\t0\t0\t2\t2\t4.0\n1\tm.map\t4\t3\t3\t0\t1\t2\t3.5\n"


@pytest.fixture
def map_file(tmp_path):
    path = tmp_path / "m.map"
    path.write_text(MAP)
    return path


def test_a_map(map_file):
    grid = read_map(map_file)
    assert (grid.occupancy == [[0, 1, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1]]).all()
    np.testing.assert_array_equal(grid.cells_per_unit, [3, 3])  # cells are squares
    np.testing.assert_array_equal(grid.contains(np.float32([[0, 1 / 3], [0, 0], [1 / 3, 1]])), [True, False, True])


@pytest.mark.parametrize("name", ["m.map.scen", "m.scen"])
def test_a_scenario(map_file, name):
    path = map_file.with_name(name)
    assert scen_beside(map_file) is None
    path.write_text(SCEN)
    assert scen_beside(map_file) == path
    (world,) = worlds_at(map_file)
    np.testing.assert_allclose(world.problems * 3, [[[0, 0], [2, 2]], [[0, 3], [2, 1]]], atol=1e-6)
    assert world.problems.dtype == np.float32
    assert problems_of(world, 1, 0).shape == (1, 2, 2)
    np.testing.assert_array_equal(problems_of(world, 10, 0), world.problems)


BAD = (  # which text, what is replaced in it, and what is said
    (MAP, "type octile", "type hex", "line 1: expected 'type octile'"),
    (MAP, "GTSW\n", "", "expected 3 rows, got 2"),
    (MAP, "GTSW", "GT?W", r"line 6: expected cells of .*, got '\?'"),
    (SCEN, "m.map\t4\t3\t0", "m.map\t3\t4\t0", "line 2: expected a map of 4 x 3 cells, got 3 x 4"),
    (SCEN, "\t2\t2\t", "\t4\t2\t", "line 2: expected cells of the map"),
    (SCEN, SCEN, "version 1\n", "at least one problem"),
)


@pytest.mark.parametrize(("text", "old", "new", "message"), BAD)
def test_what_is_no_map_and_no_scenario(map_file, text, old, new, message):
    changed = text.replace(old, new, 1)
    (map_file if text is MAP else map_file.with_name("m.scen")).write_text(changed, encoding="utf-8")
    with pytest.raises(wb.ShapeError, match=message) as caught:
        read_scen(map_file.with_name("m.scen"), read_map(map_file))
    assert "\n" not in str(caught.value)


def test_what_is_no_world(tmp_path):
    np.save(tmp_path / "solid.npy", np.eye(4, dtype=bool)[None].repeat(2, 0))
    for name, message in (("nothing.png", "no such file"), ("solid.npy", "expected a 2D world, got 3 dimensions")):
        with pytest.raises(wb.ShapeError, match=message):
            worlds_at(tmp_path / name)


# --- the exact truth --------------------------------------------------------------------------------------------------


def meets_world(grid, start, end):
    """The truth for one float32 segment, over all occupied cells."""
    half = Fraction(1, 2)
    scale, offset = ([Fraction(float(v)) for v in values] for values in (grid.cells_per_unit, grid.offset))
    a, b = ([Fraction(float(x[k])) * scale[k] - offset[k] for k in range(2)] for x in (start, end))
    return any(passes_box(a, b, [c - half for c in cell], [c + half for c in cell]) for cell in grid.occupied.tolist())


def random_world(shape, seed, share=0.15, **placed):
    occupied = np.random.default_rng(seed).random(shape) < share
    occupied[0, 0], occupied[-1, -1] = True, False
    return wb.shapes.Grid(occupied, **placed)


WORLDS = {
    "unit": random_world((9, 9), 0),
    "faces that float32 hits": random_world((9, 17), 1),  # scales 8 and 16: all corners are float32
    "odd": random_world((12, 7), 2, cells_per_unit=np.float32([3.7, 0.3]).astype(float), offset=np.array([-2.5, 7.0])),
    "one row": random_world((1, 12), 3),
}


def agree(grid, starts, ends):
    world = ExactWorld(grid)
    found = world.segments(starts, ends)
    truth = [meets_world(grid, a, b) for a, b in zip(starts, ends, strict=True)]
    np.testing.assert_array_equal(found, truth)
    np.testing.assert_array_equal(world.segments(ends, starts), truth)  # the other way round
    return world, found


@pytest.mark.parametrize("name", WORLDS)
def test_segments_and_states(name):
    """At random, and between corners and one float beside them; a state is a segment of no length."""
    grid, rng = WORLDS[name], np.random.default_rng(4)
    size = grid.upper - grid.lower
    starts = (grid.lower + (rng.random((300, 2)) * 1.4 - 0.2) * size).astype(np.float32)
    ends = (starts + rng.normal(size=(300, 2)) * size * rng.choice([0.02, 0.2, 1.0], (300, 1))).astype(np.float32)
    _, found = agree(grid, starts, ends)
    assert 0 < found.sum() < len(found)
    corners = [rng.integers(-1, cells + 2, (300, 2)) - 0.5 for cells in grid.shape]
    places = np.stack(corners, axis=-1)  # (300, 2 ends, 2 coordinates)
    x = ((places + grid.offset) / grid.cells_per_unit).astype(np.float32)
    step = rng.integers(-1, 2, x.shape).astype(np.float32)
    x = np.where(step == 0, x, np.nextafter(x, np.float32(np.inf) * np.where(step == 0, 1, step)))
    world, _ = agree(grid, x[:, 0].copy(), x[:, 1].copy())
    x = np.concatenate([starts, x[:, 0]])
    found = world.states(x)
    np.testing.assert_array_equal(found, world.segments(x, x))
    np.testing.assert_array_equal(found, [meets_world(grid, p, p) for p in x])
    if name != "odd":  # where the grid's own answer is exact
        np.testing.assert_array_equal(found[:300], grid.contains(starts))


def test_lines_through_a_corner_that_float64_cannot_tell():
    """Coordinates of 48 bits, products of 96: rounding alone would call one half of these free."""
    occupied = np.zeros((8, 8), dtype=bool)
    occupied[4, 4] = True
    scale = np.float32([7.1234565, 5.9876547]).astype(np.float64)
    # the cell has a corner in the origin
    grid = wb.shapes.Grid(occupied, cells_per_unit=scale, offset=np.full(2, -3.5))
    rng = np.random.default_rng(9)
    starts = (rng.random((400, 2), dtype=np.float32) + np.float32(0.01)) * np.float32([-0.4, 0.4])
    ends = -starts * np.float32(2.0) ** -rng.integers(0, 4, (400, 1)).astype(np.float32)
    world, found = agree(grid, starts, ends)
    assert found.all()
    assert world.doubts > 400
    aside = np.nextafter(starts, np.float32(rng.choice([-1.0, 1.0], starts.shape) * np.inf))
    _, found = agree(grid, aside, ends)
    assert 0 < found.sum() < len(found)
