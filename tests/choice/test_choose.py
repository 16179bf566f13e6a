"""Choices: the cheapest of what was measured, whatever is asked, and nothing lost when it is stopped."""

import json

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.choice import Work, cost_plot
from warp_bounding.errors import BounderError, FileFormatError, QueryError
from warp_bounding.solids import Sphere

DISK = np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5  # of cells: fitted in no time
BALL = Sphere([0.0, 0.0, 0.0], 1.0)
QUIET = {"device": "cpu", "progress": False}
FEW = ("aabb", "obb", "bvh", "mlp")  # methods that bound a ball in little time
SMALL = {**QUIET, "networks": (), "budget": 240.0, "methods": FEW}  # closed forms take no longer than they need


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Closed forms are fitted once: choices of the same queries go on in the same folder, whatever the price and the memory."""
    return {**SMALL, "folder": tmp_path_factory.mktemp("choice") / "c"}


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(3).uniform(-1.4, 1.4, (20_000, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def chosen(points, kept):
    closed = wb.choose(BALL, narrow_ns=2000.0, queries=points, **kept)
    room = closed.about["seconds"] + 8.0  # for one network
    return wb.choose(BALL, narrow_ns=2000.0, queries=points, **{**kept, "networks": ((8, 8),), "budget": room})


def test_the_cheapest_is_chosen_and_proven(chosen, points):
    able = [row for row in chosen.rows if not row.why_not]
    assert chosen.row.cost == min(row.cost for row in able)
    assert chosen.bounder.certificate.proven
    assert {"none", "aabb", "obb", "mlp 8-8"} <= {row.label for row in chosen.rows}
    assert chosen.positives == pytest.approx(BALL.contains(points).mean(), abs=0.02)
    for row in able:
        assert row.missed == 0
        assert row.cost == pytest.approx(row.nanoseconds + 2000.0 * row.share)
        assert row.share >= chosen.positives
    assert chosen.prices[0].price == 0
    assert chosen.label in [stretch.label for stretch in chosen.prices]
    assert chosen.label in chosen.why


def test_what_is_told_is_what_the_bounder_does(chosen):
    fresh = np.random.default_rng(4).uniform(-1.4, 1.4, (50_000, 3)).astype(np.float32)
    assert chosen.bounder.query(fresh).numpy().mean() == pytest.approx(chosen.row.share, abs=0.02)
    assert json.loads(json.dumps(chosen.to_dict()))["label"] == chosen.label


def test_a_free_narrow_phase_needs_nobody(points, kept):
    choice = wb.choose(BALL, narrow_ns=0.0, queries=points, **kept)
    assert choice.bounder is None
    assert choice.label == "none"
    assert "none pays" in choice.why


def test_memory_is_a_limit(points, kept):
    choice = wb.choose(BALL, narrow_ns=1e5, queries=points, memory=100, **kept)
    assert choice.bounder.nbytes <= 100
    assert any("memory" in row.why_not for row in choice.rows)
    with pytest.raises(BounderError, match=r"no candidate has 3 bytes or less; the nearest is aabb with 64"):
        wb.choose(BALL, narrow_ns=1e5, queries=points, memory=3, **kept)


def test_bounders_of_ones_own_are_measured_too(points, kept):
    own = wb.fit(BALL, method="obb", device="cpu")
    choice = wb.choose(BALL, narrow_ns=1e5, queries=points, bounders={"mine": own}, **kept)
    assert "mine" in {row.label for row in choice.rows}
    with pytest.raises(BounderError, match="expected ones of point queries in 3D"):
        wb.choose(BALL, "point", narrow_ns=1.0, bounders={"rays": wb.fit(BALL.to_grid(resolution=8), "ray", "aabb", device="cpu")}, **SMALL)  # fmt: skip


def test_what_denies_too_much_is_not_chosen(points, kept):
    wrong = wb.fit(BALL, method="obb", device="cpu")
    wrong.freeze(0.9, wrong.certificate)
    choice = wb.choose(BALL, narrow_ns=1e6, queries=points, bounders={"wrong": wrong}, **kept)
    row = next(row for row in choice.rows if row.label == "wrong")
    assert row.missed > 0
    assert "denies" in row.why_not
    assert choice.label != "wrong"


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_other_kinds_of_query(query):
    grid = BALL.to_grid(resolution=8)
    choice = wb.choose(
        grid, query, narrow_ns=1e4, **{**SMALL, "budget": 12.0, "methods": ("aabb", "bvh", "distance-grid")}
    )
    assert choice.row.cost <= 1e4
    asked = [row for row in choice.rows if row.label.startswith("distance-grid")]
    assert len(asked) == (0 if query == "plane" else 2)
    assert not any("denies" in row.why_not for row in choice.rows)


def test_distances_are_asked_as_they_answer(rng):
    """A distance stands in for a bounder of rays: the share it leaves is what it answers."""
    grid = BALL.to_grid(resolution=8)
    far = wb.fit(grid, "distance", "distance-grid", nodes=16, device="cpu")
    x = np.concatenate([rng.uniform(-2, 2, (4000, 3)), rng.normal(size=(4000, 3))], axis=1).astype(np.float32)
    choice = wb.choose(
        grid, "ray", narrow_ns=1e7, queries=x, length=0.7, bounders={"far": far}, **{**SMALL, "methods": ()}
    )
    assert isinstance(choice.bounder, wb.DistanceBounder)
    assert [row.label for row in choice.rows] == ["far", "none"]
    assert choice.row.share == pytest.approx(far.rays(x, length=0.7)[0].numpy().mean(), abs=0.03)
    with pytest.raises(BounderError, match="expected ones of plane queries in 3D"):
        wb.choose(grid, "plane", narrow_ns=1.0, bounders={"far": far}, **SMALL)


def test_the_overhead_of_asking_counts(points, kept):
    given = {"narrow_ns": 500.0, "queries": points, **kept}
    assert wb.choose(BALL, **given).bounder is not None
    choice = wb.choose(BALL, overhead_ns=500.0, **given)
    assert choice.bounder is None
    asked = [row for row in choice.rows if row.label != "none" and not row.why_not]  # the slow may have left some out
    assert asked
    assert all(row.nanoseconds > 500 for row in asked)


def test_it_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    closed = ("aabb", "sphere", "ellipsoid", "kdop", "bvh", "voxels")
    given = {"narrow_ns": 2000.0, "methods": closed, "budget": 600.0, "folder": tmp_path / "c"}
    real, fitted = Work.fitted, []

    def stop(work, candidate, seconds, limit):
        fitted.append(candidate.label)
        if len(fitted) == 6:
            raise RuntimeError("killed")
        return real(work, candidate, seconds, limit)

    monkeypatch.setattr(Work, "fitted", stop)
    with pytest.raises(RuntimeError):
        wb.choose(DISK, **given, **QUIET)
    monkeypatch.setattr(Work, "fitted", real)
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "c").glob("*.safetensors")}
    assert len(before) > 3
    choice = wb.choose(DISK, **given, **QUIET)
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "c").glob("*.safetensors")}
    assert before.items() <= after.items()  # nothing was fitted twice
    assert choice.bounder is not None
    assert choice.more == ""  # there was time for everything


def test_folders_of_others_are_left_alone(tmp_path):
    wb.choose(DISK, narrow_ns=1e4, folder=tmp_path / "c", **SMALL)
    with pytest.raises(FileFormatError, match="another seed, 0 and not 1"):
        wb.choose(DISK, narrow_ns=1e4, folder=tmp_path / "c", seed=1, **SMALL)
    settings = tmp_path / "c" / "choice.json"
    settings.write_text(settings.read_text().replace('"version": "', '"version": "9.'))
    with pytest.raises(FileFormatError, match="another version"):
        wb.choose(DISK, narrow_ns=1e4, folder=tmp_path / "c", **SMALL)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    with pytest.raises(FileFormatError, match="holds other files"):
        wb.choose(DISK, narrow_ns=1e4, folder=tmp_path / "mine", **SMALL)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


def test_the_plot(chosen):
    files = cost_plot(chosen)
    assert files["png"].startswith(b"\x89PNG")
    assert chosen.label in files["svg"].decode()


@pytest.mark.parametrize(
    ("given", "error", "told"),
    [
        ({"narrow_ns": -1.0}, BounderError, "narrow_ns must be a number of nanoseconds of at least 0, got -1.0"),
        ({"narrow_ns": float("nan")}, BounderError, "narrow_ns must be"),
        ({"narrow_ns": 1.0, "overhead_ns": -1.0}, BounderError, "overhead_ns must be a number of nanoseconds"),
        ({"narrow_ns": 1.0, "methods": ("mlp", "tree")}, BounderError, "methods must be some of .* got .tree."),
        ({"narrow_ns": 1.0, "memory": 0}, BounderError, "memory must be a whole number of bytes"),
        ({"narrow_ns": 1.0, "memory": 1.5}, BounderError, "memory must be a whole number of bytes"),
        ({"narrow_ns": 1.0, "queries": np.zeros((0, 3))}, QueryError, "at least one of them"),
        ({"narrow_ns": 1.0, "queries": np.zeros((4, 2))}, QueryError, r"must be \(Q, 3\)"),
        ({"narrow_ns": 1.0, "queries": np.full((4, 3), np.nan)}, QueryError, "NaN"),
        ({"narrow_ns": 1.0, "length": 2.0}, BounderError, "length is for ray queries"),
        ({"narrow_ns": 1.0, "query": "sphere"}, QueryError, "sphere"),
        ({"narrow_ns": 1.0, "budget": 0}, BounderError, "budget"),
        ({"narrow_ns": 1.0, "statistical": "no"}, BounderError, "statistical"),
    ],
)
def test_bad_input_is_refused_in_one_line(given, error, told):
    with pytest.raises(error, match=told) as raised:
        wb.choose(BALL, **({**SMALL, **given}))
    assert "\n" not in str(raised.value)
