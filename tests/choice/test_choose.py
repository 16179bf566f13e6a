"""Choices: the cheapest of what was measured, within the budget, and nothing lost when it is stopped."""

import json
import time

import numpy as np
import pytest
from plain_shapes import ball_at, box_of

import warp_bounding as wb
from warp_bounding import choice as module
from warp_bounding.choice import HOW, Row, cost_plot, works_of
from warp_bounding.errors import BounderError, BoundingWarning, QueryError
from warp_bounding.runtime.launch import working_seconds

DISK = np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5  # of cells: fitted in no time
BALL = ball_at([0.0, 0.0, 0.0], 1.0).to_grid(resolution=12)
QUIET = {"device": "cpu", "progress": False}
SMALL = {**QUIET, "budget": 240.0, "methods": ("aabb", "obb", "bvh")}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Closed forms are fitted once: choices of the same queries go on in the same folder."""
    return {**SMALL, "checkpoint": tmp_path_factory.mktemp("choice") / "c"}


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(3).uniform(-1.4, 1.4, (20_000, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def chosen(points):
    """Choose among closed forms and one small network."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(module, "NETWORKS", ((8,),))
        given = {**SMALL, "methods": ("aabb", "obb", "mlp"), "budget": 12.0}
        return wb.choose(BALL, narrow_ns=2000.0, workload=points, **given)


def rows_of(choice):
    return {row.label: row for row in choice.rows}


def test_the_cheapest_is_chosen_and_proven(chosen, points, rng):
    able = [row for row in chosen.rows if not row.why_not]
    assert chosen.row.cost == min(row.cost for row in able)
    assert chosen.bounder.certificate.proven
    assert {"none", "aabb", "obb", "mlp 8"} <= set(rows_of(chosen))
    assert chosen.positives == pytest.approx(BALL.contains(points).mean(), abs=0.02)
    for row in able:
        assert row.missed == 0
        assert row.cost == pytest.approx(row.nanoseconds + 2000.0 * row.share)
        assert row.share >= chosen.positives
    assert chosen.prices[0].price == 0
    assert chosen.label in [stretch.label for stretch in chosen.prices]
    fresh = rng.uniform(-1.4, 1.4, (50_000, 3)).astype(np.float32)
    assert chosen.bounder.query(fresh).numpy().mean() == pytest.approx(chosen.row.share, abs=0.02)
    assert json.loads(json.dumps(chosen.to_dict()))["label"] == chosen.label
    assert cost_plot(chosen).startswith(b"\x89PNG")


def test_prices_overhead_and_memory_decide(points, kept):
    given = {"workload": points, **kept}
    free = wb.choose(BALL, narrow_ns=0.0, **given)
    assert (free.bounder, free.label) == (None, "none")
    assert wb.choose(BALL, narrow_ns=500.0, **given).bounder is not None
    choice = wb.choose(BALL, narrow_ns=500.0, overhead_ns=500.0, **given)
    assert choice.bounder is None
    assert all(row.nanoseconds > 500 for row in choice.rows if row.label != "none" and not row.why_not)
    small = wb.choose(BALL, narrow_ns=1e5, memory=100, **given)
    assert small.bounder.nbytes <= 100
    assert any("memory" in row.why_not for row in small.rows)


def test_two_prices_are_computed_as_by_hand():
    rows = [Row("loose", 0, 2.0, 0.5), Row("tight", 0, 10.0, 0.25), Row("wrong", 0, 0.0, 0.0, why_not="not proven")]
    # loose saves 0.5 * 100 - 2 = 48, tight 0.75 * 100 - 10 = 65: the best, which leaves a quarter of them to 900 ns
    mean, works = works_of(rows, 100.0, 900.0, positives=0.2)
    assert mean == 0.25 * 900 + 0.75 * 100
    assert 10 + works["tight"] * mean == pytest.approx(10 + 0.25 * 900)
    assert [mean - (row.nanoseconds + works[row.label] * mean) for row in rows[:2]] == pytest.approx([48, 65])
    mean, works = works_of(rows, 100.0, 100.0, positives=0.2)
    assert (mean, works) == (100.0, shares := {row.label: row.share for row in rows})  # one price: the paper's Eq. 6
    assert works_of([], 100.0, 900.0, positives=0.25)[0] == 300  # nothing leaves less than what meets the object
    assert works_of(rows, 0.0, 0.0, positives=0.2) == (0.0, shares)


def test_two_prices_decide_by_what_is_denied(points, kept):
    given = {"workload": points, **kept}
    cheap, same = (wb.choose(BALL, narrow_ns=prices, **given) for prices in ((0.0, 5000.0), (5000.0, 5000.0)))
    assert (cheap.label, cheap.times) == ("none", 1.0)  # what costs nothing saves nothing, whatever the others cost
    assert same.label != "none"
    uneven = wb.choose(BALL, narrow_ns=[5000.0, 50000.0], **given)
    own, price = uneven.row, uneven.row.share * 50000 + (1 - uneven.row.share) * 5000
    assert uneven.narrow_ns == pytest.approx(price)
    assert own.cost == pytest.approx(own.nanoseconds + own.share * 50000)
    assert uneven.times == pytest.approx(price / own.cost)
    assert 1 < uneven.times < same.times
    assert "5000 ns if denied, 50000 ns if left" in str(uneven)


@pytest.mark.parametrize("how", list(HOW))
def test_an_exact_test_is_timed_on_what_is_left(how, points, kept, monkeypatch):
    """On a clock of its own, on which a query in the ball takes a microsecond, another one a hundredth of it."""
    clock = [0.0]

    def test(x):
        inside = np.linalg.norm(x.numpy(), axis=1) <= 1.0
        clock[0] += 1e-6 * inside.sum() + 1e-8 * (~inside).sum()
        return inside

    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    choice = wb.choose(BALL, narrow_ns=test, how=how, workload=points, **kept)
    inside = float((np.linalg.norm(points, axis=1) <= 1.0).mean())
    mean = 1000 * inside + 10 * (1 - inside)
    assert choice.narrow_ns == pytest.approx(mean, rel=0.05)
    assert {"aabb", "bvh leaves 64"} < {row.label for row in choice.rows if not row.why_not}
    for row in choice.rows:
        if row.label != "none" and not row.why_not:
            assert row.work == pytest.approx((1000 * inside + 10 * (row.share - inside)) / mean, rel=0.05)
            assert row.cost == pytest.approx(row.work * choice.narrow_ns)  # bounders take no time on this clock
    assert 1 < choice.times < 1.1  # by one price for all it were the share that is left, more than twice as fast
    assert choice.row.share < 0.5


def test_a_choice_is_printed_as_a_table(chosen):
    head, columns, *rows = filter(None, str(chosen).splitlines())
    assert "20,000 queries" in head
    assert "2000 ns for each: too hopeful where what is denied costs less" in head
    assert " ".join(columns.split()) == "bytes test ns left % time % ns in all times"
    labels = [row.label for row in chosen.rows]
    assert [row[: max(map(len, labels))].strip() for row in rows[: len(labels)]] == labels
    assert rows[labels.index(chosen.label)].split()[-2:] == [f"{chosen.times:.2f}", "proven"]
    assert f"{chosen.times:.3g} times as fast" in chosen.why


def test_functions_of_all_kinds_of_queries_are_timed(rng):
    for query in ("ray", "box"):
        low, high = np.sort(rng.uniform(-2, 2, (2, 4000, 3)), axis=0)
        x = np.concatenate([low, high], axis=1).astype(np.float32)
        given = {"workload": x, **SMALL, "methods": "aabb", "how": "function"}
        choice = wb.choose(BALL, query, narrow_ns=1e9, **given)
        assert (choice.label, choice.about["how"]) == ("aabb", "function")
    far = wb.fit(BALL, "distance", "kdop", device="cpu")
    with pytest.raises(BounderError, match="needs ones with func, got a distance, 'far'"):
        wb.choose(BALL, narrow_ns=1.0, how="function", bounders={"far": far}, **SMALL)


def test_queries_and_tests_of_other_units_are_noticed(points, kept):
    with pytest.warns(BoundingWarning, match="all queries lie outside of the object's box; are they in the units"):
        choice = wb.choose(BALL, narrow_ns=500.0, workload=1000 * points + 2000, **kept)
    assert "100 % lie outside of its box" in str(choice)
    with pytest.warns(BoundingWarning, match="your test says that .* % of the queries meet the object, and the shape"):
        wb.choose(BALL, narrow_ns=lambda x: np.linalg.norm(x.numpy(), axis=1) < 1.3, workload=points, **kept)


def test_bounders_of_ones_own_are_measured_and_wrong_ones_not_chosen(points, kept):
    own, wrong = (wb.fit(BALL, method="obb", device="cpu") for _ in range(2))
    wrong.freeze(0.9, wrong.certificate)
    choice = wb.choose(BALL, narrow_ns=1e6, workload=points, bounders={"mine": own, "wrong": wrong}, **kept)
    rows = rows_of(choice)
    assert not rows["mine"].why_not
    assert rows["wrong"].missed > 0
    assert "denies" in rows["wrong"].why_not
    assert choice.label != "wrong"
    rays = wb.fit(BALL, "ray", "aabb", device="cpu")
    with pytest.raises(BounderError, match="expected ones of point queries in 3D"):
        wb.choose(BALL, "point", narrow_ns=1.0, bounders={"rays": rays}, **SMALL)


def test_distances_answer_in_the_place_of_bounders(rng):
    far = wb.fit(BALL, "distance", "kdop", device="cpu")
    x = np.concatenate([rng.uniform(-2, 2, (4000, 3)), rng.normal(size=(4000, 3))], axis=1).astype(np.float32)
    given = {**SMALL, "methods": (), "bounders": {"far": far}}
    choice = wb.choose(BALL, "ray", narrow_ns=1e7, workload=x, length=0.7, **given)
    assert (choice.bounder.query_kind, [row.label for row in choice.rows]) == ("distance", ["far", "none"])
    assert choice.row.share == pytest.approx(far.rays(x, length=0.7)[0].numpy().mean(), abs=0.03)


def test_it_goes_on_where_it_was_killed(tmp_path, monkeypatch):
    given = {"narrow_ns": 2000.0, "methods": ("aabb", "sphere", "bvh"), "checkpoint": tmp_path, **QUIET}
    (tmp_path / "thesis.tex").write_text("x")  # what else is there is left alone
    real, begun = module.fit, []

    def killed(*args, **options):
        begun.append(args)
        if len(begun) == 4:
            raise RuntimeError("killed")
        return real(*args, **options)

    monkeypatch.setattr(module, "fit", killed)
    with pytest.raises(RuntimeError):
        wb.choose(DISK, **given)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert len(before) == 4
    assert wb.choose(DISK, **given).bounder is not None
    assert before.items() <= {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}.items()
    count, one = len(begun), next(path for path in before if path.suffix == ".safetensors")
    one.write_bytes(b"damaged")
    wb.choose(DISK, **given)
    assert len(begun) == count + 1
    wb.choose(DISK, seed=1, **{**given, "methods": "aabb"})  # other settings have files of their own
    assert len(begun) == count + 2


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"narrow_ns": -1.0}, BounderError, "narrow_ns must be nanoseconds of at least 0, .* got -1.0"),
        ({"narrow_ns": (1.0, -2.0)}, BounderError, r"two of them \(denied, left\), .* got \(1.0, -2.0\)"),
        ({"narrow_ns": (1.0, 2.0, 3.0)}, BounderError, r"got \(1.0, 2.0, 3.0\)"),
        ({"narrow_ns": "fast"}, BounderError, "narrow_ns must be .* got 'fast'"),
        ({"narrow_ns": lambda x: None}, BounderError, "narrow_ns: expected .* answers of the function .* got NoneType"),
        ({"narrow_ns": lambda x: x[:1]}, BounderError, r"narrow_ns: expected .* got \(1,\)"),
        ({"overhead_ns": -1.0}, BounderError, "overhead_ns must be a number of nanoseconds of at least 0, got -1.0"),
        ({"how": "kernel"}, BounderError, "how must be one of batch, function, got 'kernel'"),
        ({"methods": ("mlp", "tree")}, BounderError, "methods must be some of .* got .tree."),
        ({"memory": 1.5}, BounderError, "memory must be a whole number of bytes"),
        ({"workload": np.zeros((0, 3))}, QueryError, "at least one of them"),
        ({"query": "sphere"}, QueryError, "sphere"),
    ],
)
def test_bad_input_is_refused_in_one_line(given, error, words):
    with pytest.raises(error, match=words) as raised:
        wb.choose(BALL, **({**SMALL, "narrow_ns": 1.0, **given}))
    assert "\n" not in str(raised.value)


def test_what_takes_too_long_is_stopped(ticking, monkeypatch):
    """On a clock that counts looks at it, so that no machine is too slow; half-spaces never end."""
    real, clock = module.fit, ticking(0.01)

    def fit(shape, query, method, **options):
        while method == "kdop":
            working_seconds()  # raises where the time is over
        return real(shape, query, method, **options)

    monkeypatch.setattr(module, "fit", fit)
    block, x = box_of([0.0] * 3, [1.0] * 3), np.random.default_rng(5).uniform(-2, 2, (4000, 3)).astype(np.float32)
    given = {"narrow_ns": 1e5, "workload": x, "budget": 40.0, "methods": ("aabb", "kdop", "sphere")}
    rows = rows_of(wb.choose(block, **given, **QUIET))
    assert clock.seconds < 1.15 * 40.0
    assert {label for label, row in rows.items() if not row.why_not} == {"none", "aabb", "sphere"}
    assert all(rows[label].why_not.startswith("stopped after") for label in ("kdop", "kdop k 26"))
