import json
from io import StringIO

import numpy as np
import pytest
from bounding_shapes import told_of
from rich.console import Console

import warp_bounding as wb
from sims.base import compare
from sims.path.demo import SPECS, phases, run, shapes, simulate
from sims.path.planner import Example
from sims.path.worlds import World
from sims.planning.broad import BroadPhase
from sims.prefitted import FitSpec

STEPS, STATES, PROBLEMS = 60, 400, 12
MORE_STEPS = 300  # of a bounder from the inside or of distances, so that something is certain
SMALL = {"hidden": (16, 16), "steps": STEPS}
PROVEN = ("aabb", "kdop", "bvh", "learned-kdop", "mlp", "mlp-early", "distance", "distance-grid", "aabb+mlp")
PROVEN += ("mlp+inside", "bvh+inside", "distance+inside", "distance-grid+inside")


def small(name):
    """The demo's spec with a tiny fit."""
    spec = SPECS[name]
    if spec.closed:
        return spec
    more = {"steps": MORE_STEPS} if "side" in spec.options or spec.query == "distance" else {}
    more |= {"side": spec.options["side"]} if "side" in spec.options else {}
    return FitSpec(spec.method, query=spec.query, options=told_of(spec.method, spec.query, **SMALL) | more)


def walls():
    occupied = np.zeros((24, 24), dtype=bool)
    occupied[5:7, 3:18] = occupied[7:18, 16:18] = occupied[14:16, 4:12] = True
    return occupied


@pytest.fixture(scope="module")
def world():
    return World("walls", wb.IndicatorGrid(walls(), name="walls"), "path-walls")


@pytest.fixture(scope="module")
def bounders(world):
    made = {}
    for name in SPECS:
        spec = small(name)
        made[name] = wb.fit(world.grid, query=spec.query, method=spec.method, device="cpu", **spec.options)
    return made


@pytest.fixture(scope="module")
def examples(world, bounders):
    return simulate(world, bounders, states=STATES, problems=PROBLEMS)


class Everything(BroadPhase):
    """A broad phase that clears whatever it is asked."""

    def states(self, x):
        return np.ones(len(x), dtype=bool)

    def edges(self, starts, ends):
        return np.ones(len(starts), dtype=bool)


def denying(bounder, points):
    """The bounder with its threshold raised, so that it denies these points of the object."""
    raised = bounder.to("cpu")
    return raised.freeze(float(np.nextafter(raised.values(points).numpy().max(), np.float32(np.inf))), None)


def test_the_reference_plans_without_a_collision(examples, world):
    none = examples["none"]
    assert none.solved == PROBLEMS
    assert not none.collisions().any()
    assert none.missed() == 0
    assert none.milliseconds()[0] == 0.0
    for problem, path in zip(none.problems, none.paths, strict=True):
        np.testing.assert_array_equal(path[[0, -1]], problem)
        assert path.dtype == np.float32
    lengths = [np.linalg.norm(np.diff(world.grid.cell_coordinate(path), axis=0), axis=1).sum() for path in none.paths]
    np.testing.assert_allclose(none.lengths, lengths)
    assert none.checks > STATES + 2 * PROBLEMS


def test_every_broad_phase_is_there(examples):
    assert tuple(examples) == ("none", *PROVEN, "occupancy")


@pytest.mark.parametrize("name", PROVEN)
def test_a_proven_bounder_changes_nothing_but_the_number_of_checks(examples, name):
    none, example = examples["none"], examples[name]
    example.test_final(none)
    assert example.missed() == 0
    assert example.state() == none.state()
    assert example.checks < none.checks


def test_a_cascade_checks_no_more_than_its_parts(examples):
    assert examples["aabb+mlp"].checks <= min(examples["aabb"].checks, examples["mlp"].checks)


@pytest.mark.parametrize("name", ["bvh", "mlp"])
def test_a_bounder_that_denies_a_part_of_the_object_is_found_out(world, bounders, name):
    inside = world.grid.position(world.grid.occupied[::5]).astype(np.float32)
    points = np.concatenate([inside, inside], axis=1) if name == "bvh" else inside
    broken = denying(bounders[name], points)
    runs = simulate(world, {name: broken}, states=STATES, problems=PROBLEMS)
    rows = compare(runs, {name: {"walls": broken}})
    assert rows[1].missed > 0
    assert not rows[1].identical
    with pytest.raises(AssertionError, match="were cleared that collide"):
        runs[name].test_final(runs["none"])


@pytest.mark.parametrize("outer", ["mlp", "bvh", "distance", "distance-grid"])
def test_what_certainly_collides_needs_no_check(examples, outer):
    assert examples[f"{outer}+inside"].checks < examples[outer].checks


def test_a_bounder_that_calls_free_space_inside_is_found_out(world, bounders):
    broken = denying(bounders["inside"], world.grid.position(np.argwhere(~walls())[::5]).astype(np.float32))
    runs = simulate(world, {"bvh": bounders["bvh"], "inside": broken}, states=STATES, problems=PROBLEMS)
    assert runs["bvh"].missed() == 0
    assert runs["bvh+inside"].missed() > 0
    with pytest.raises(AssertionError, match="are free and were said to collide"):
        runs["bvh+inside"].test_final(runs["none"])


def test_paths_through_walls_are_counted(world, examples):
    through = Example(world, Everything(), states=STATES, problems=PROBLEMS)
    through.step()
    assert through.checks == 0
    assert through.collisions().sum() > 0
    assert through.missed() > 0
    assert through.state() != examples["none"].state()


def test_a_path_that_collides_is_enough_to_fail(world, examples, monkeypatch):
    monkeypatch.setattr(Example, "missed", lambda self, reference: 0)
    through = Example(world, Everything(), states=STATES, problems=PROBLEMS)
    through.step()
    with pytest.raises(AssertionError, match="paths collide"):
        through.test_final(examples["none"])


@pytest.mark.parametrize("what", ["nodes", "lengths", "paths"])
def test_identical_means_to_the_bit(world, examples, what):
    again = Example(world, states=STATES, problems=PROBLEMS)
    again.step()
    assert again.state() == examples["none"].state()
    array = again.paths[3] if what == "paths" else getattr(again, what)
    array.reshape(-1)[2] = np.nextafter(array.reshape(-1)[2], array.dtype.type(np.inf))
    assert again.state() != examples["none"].state()
    with pytest.raises(AssertionError, match="the paths differ"):
        again.test_final(examples["none"])


def test_the_seed_chooses_states_and_problems(world, examples):
    other = Example(world, states=STATES, problems=PROBLEMS, seed=1)
    assert not np.array_equal(other.states, examples["none"].states)
    assert not np.array_equal(other.problems, examples["none"].problems)


def test_blocked_and_unsolvable_problems_are_counted():
    occupied = np.zeros((16, 16), dtype=bool)
    occupied[:, 7:9] = True  # a wall from side to side
    grid = wb.IndicatorGrid(occupied)
    left, right, wall = (2 / 15, 2 / 15), (12 / 15, 13 / 15), (0.5, 0.5)
    problems = np.float32([[left, (13 / 15, 2 / 15)], [left, right], [wall, right], [left, wall]])
    example = Example(World("wall", grid, "path-wall", problems=problems), states=300, problems=4)
    example.step()
    assert example.blocked.tolist() == [False, False, True, True]
    assert np.isfinite(example.lengths).tolist() == [True, False, False, False]
    assert [path is None for path in example.paths] == [False, True, True, True]
    assert example.solved == 1


@pytest.mark.parametrize("states", [2, 3, 20])
def test_hardly_any_states(world, states):
    example = Example(world, states=states, problems=3)
    example.step()
    assert example.lengths.shape == (3,)


def test_no_problem_that_can_be_asked():
    grid = wb.IndicatorGrid(np.eye(6, dtype=bool))
    blocked = np.zeros((1, 2, 2), dtype=np.float32)
    example = Example(World("eye", grid, "path-eye", problems=blocked), states=50)
    example.step()
    assert example.solved == 0
    assert example.mean_length == 0.0
    assert not example.collisions().any()


def test_the_runs_of_the_table(world, examples, bounders):
    own = {name: {"walls": bounder} for name, bounder in bounders.items()}
    runs = compare(examples, own, [{"bounder": "mlp", "fp_rate": 12.5}], section="walls")
    by_name = {each.bounder: each for each in runs}
    assert by_name["mlp"].fp_rate == 12.5
    assert by_name["mlp"].section == "walls"
    assert [by_name[name].certificate for name in ("none", "mlp", "aabb+mlp", "occupancy")] == [
        "",
        "proven",
        "proven",
        "",
    ]
    assert by_name["bvh"].extra["fewer"] > 1
    assert all(
        each.identical and not each.missed and not each.extra["collisions"] for each in runs if each.conservative
    )


def test_specs_and_worlds_belong_together(bounders, world):
    assert set(shapes()) == {"path-rooms", "path-maze"}
    assert list(phases(bounders, world)) == [*PROVEN, "occupancy"]


# --- the whole demo, in a user's world --------------------------------------------------------------------------------


@pytest.fixture
def tiny(tmp_path):
    """A user's world, and fits of a few steps."""
    specs = {name: small(name) for name in SPECS}
    path = tmp_path / "mine.npy"
    np.save(path, walls())

    def go(**options):
        console = Console(record=True, width=140, highlight=False, soft_wrap=True, file=StringIO())
        given = {"specs": specs, "quick": True, "states": 300, "problems": 5, "world": path, **options}
        return run(tmp_path / "out", console=console, **given), console.export_text()

    return go


def test_a_users_world_is_fitted_once(tiny, tmp_path):
    first, text = tiny()
    assert first["identical"]
    assert "mine.npy: fitted learned-kdop, mlp, mlp-early, distance, inside, occupancy for this world" in text
    assert "5 problems, random" in text
    json.dumps(first)
    assert [each["bounder"] for each in first["runs"]] == ["none", *PROVEN, "chosen", "occupancy"]
    assert first["demo"] == "path"
    assert first["worlds"][0]["solved"] == 5
    picture = tmp_path / "out" / "path.png"
    assert first["pictures"] == [str(picture)]
    assert picture.stat().st_size > 20_000
    files = sorted(file.name for file in (tmp_path / "out").glob("*.safetensors"))
    assert len(files) == 6
    times = {file: file.stat().st_mtime_ns for file in (tmp_path / "out").glob("*.safetensors")}

    again, text = tiny()
    assert "took learned-kdop, mlp, mlp-early, distance, inside, occupancy from" in text
    assert "fitted learned" not in text
    assert {file: file.stat().st_mtime_ns for file in times} == times
    for one, other in zip(first["runs"], again["runs"], strict=True):
        if one["bounder"] == "chosen":  # by the clock
            continue
        assert one["narrow_calls"] == other["narrow_calls"]
        assert one["collisions"] == other["collisions"]

    mlp = next(file for file in times if file.name.endswith("-mlp.safetensors"))
    kept = mlp.rename(tmp_path / "kept.safetensors")
    given, _ = tiny(bounder_file=kept)
    assert given["runs"][5]["narrow_calls"] == first["runs"][5]["narrow_calls"]
    assert not mlp.exists()

    other = np.ones((9, 9), dtype=bool)
    other[2:5] = False
    np.save(tmp_path / "other.npy", other)
    with pytest.raises(wb.BounderError, match=r"expected a bounder of one of other\.npy"):
        tiny(world=tmp_path / "other.npy", bounder_file=kept)


def test_two_worlds_are_two_sections(tmp_path):
    specs = {name: small(name) for name in SPECS}
    np.save(tmp_path / "a.npy", walls())
    (tmp_path / "b.map").write_text(
        "type octile\nheight 9\nwidth 9\nmap\n" + "@@@@@@@@@\n" + "@.......@\n" * 7 + "@@@@@@@@@\n"
    )
    (tmp_path / "b.map.scen").write_text(
        "version 1\n0\tb.map\t9\t9\t2\t2\t6\t6\t5.6\n0\tb.map\t9\t9\t0\t0\t6\t6\t5.6\n"
    )
    console = Console(quiet=True)
    options = {"states": 150, "problems": 4, "specs": specs, "console": console}
    found = run(tmp_path / "out", quick=True, world=tmp_path, **options)
    assert [each["section"] for each in found["runs"]] == [
        name for name in ("a.npy", "b.map") for _ in ("none", *PROVEN, "chosen", "occupancy")
    ]
    assert found["worlds"][1] | {"blocked": 1, "solved": 1, "problems": 2} == found["worlds"][1]
    assert found["identical"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"states": 1}, "at least 2 states"),
        ({"problems": 0}, "at least 2 states and 1 problem"),
        ({"budget": -1.0}, "budget must be a positive"),
        ({"world": "there-is-none.map"}, "cannot be read"),
    ],
)
def test_bad_options_are_refused(tmp_path, options, message):
    with pytest.raises(wb.BoundingError, match=message) as caught:
        run(tmp_path, console=Console(quiet=True), **options)
    assert "\n" not in str(caught.value)


def test_a_picture_of_one_run(examples, tmp_path):
    (path,) = examples["none"].render(tmp_path)
    assert path.name == "path-walls.png"
    assert path.stat().st_size > 10_000
