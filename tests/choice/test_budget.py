"""The budget of a choice is kept, what has no room in it is told, and what is trained is trained until it can be judged.

Fits are stood in for by boxes that let the clock go on, so that no machine is too slow for what is asserted.
"""

import time

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.choice import (
    LEAST_SECONDS,
    ROUND_STEPS,
    ROUNDS,
    Candidate,
    Pace,
    Spending,
    TooSlowError,
    Watch,
    needed,
    told_budget,
)
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.solids import Box

BLOCK = Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
POINTS = np.random.default_rng(5).uniform(-2, 2, (4000, 3)).astype(np.float32)
GIVEN = {"narrow_ns": 1e5, "queries": POINTS, "device": "cpu", "progress": False}
SECONDS = {"aabb": 2.0, "sphere": 3.0, "kdop": 200.0, "voxels": 0.1}  # of a fit and its proof
SETUP, ROUND = 2.0, 1.5  # seconds of every network's training
STEP = 0.5  # seconds after which a fit looks at the clock


@pytest.fixture
def clock(monkeypatch):
    """Seconds that have passed, as a list of one; of the machine's own a thousandth, so that no launch takes no time and none takes much."""
    real, ahead = time.perf_counter, [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: 1e-3 * real() + ahead[0])
    return ahead


@pytest.fixture
def fits(monkeypatch, clock):
    """Labels of the fits that were begun, with the seconds they were given; a network denies more the longer it is trained."""
    begun, real = [], wb.fit

    def pass_time(seconds):
        while seconds > 0:
            clock[0] += min(STEP, seconds)
            seconds -= STEP
            working_seconds()

    def fit(shape, query, method, *, budget, progress, hidden=None, **options):
        begun.append((method if hidden is None else f"{method} {'-'.join(map(str, hidden))}", budget))
        bounder, steps = real(BLOCK, query, "aabb", device="cpu", progress=False), 0
        if hidden is None:
            pass_time(SECONDS[method])
        else:
            pass_time(SETUP)
            progress(0.0, 1.0, "")
            rounds = int((0.75 * budget - SETUP) / ROUND)
            for _ in range(max(rounds, 1)):
                pass_time(ROUND)
                steps += ROUND_STEPS
                progress(0.5, 1.0, "")
            pass_time(0.25 * budget)
        bounder.info["training"] |= {"steps": steps} if hidden else {}
        return bounder

    monkeypatch.setattr("warp_bounding.choice.fit", fit)
    return begun


def rows_of(choice):
    return {row.label: row for row in choice.rows}


def test_what_takes_too_long_is_stopped_and_told(fits):
    choice = wb.choose(BLOCK, budget=40.0, methods=("aabb", "kdop", "sphere", "voxels"), networks=(), **GIVEN)
    rows = rows_of(choice)
    assert choice.about["seconds"] < 1.15 * 40.0
    assert {"aabb", "sphere", "voxels 128 cells"} <= {label for label, row in rows.items() if not row.why_not}
    assert rows["kdop"].why_not.startswith("stopped after")
    assert "a budget of more than" in rows["kdop"].why_not
    assert rows["kdop k 26"].why_not.startswith("not tried: needs a budget of")
    assert rows["kdop"].needs > 40.0
    assert [label for label, _ in fits].count("kdop") == 1
    assert "kdop" in choice.more


@pytest.mark.parametrize("budget", [15.0, 45.0, 100.0, 300.0])
def test_networks_are_trained_until_they_can_be_judged_or_not_at_all(fits, budget):
    choice = wb.choose(BLOCK, budget=budget, methods=("aabb", "mlp"), **GIVEN)
    rows, enough = rows_of(choice), needed(SETUP, ROUND, 0.25)
    trained = {label for label, row in rows.items() if label.startswith("mlp") and not row.why_not}
    assert choice.about["seconds"] < 1.15 * budget
    for label, row in rows.items():
        if label.startswith("mlp") and label not in trained:
            assert row.why_not.startswith("not tried: needs a budget of")
            assert row.needs > budget
    # what was given too little was a first try, after which the pace was known
    assert sum(seconds < 0.7 * enough for _, seconds in fits[1:]) <= 1
    assert (len(trained) == 0) == (budget == 15.0)  # of which a box and the first try have left less than enough
    assert len(trained) <= budget / enough
    if len(trained) < 5:
        assert "mlp" in choice.more
    else:
        assert len(trained) == 5
        assert not any(row.note for row in rows.values())
        assert choice.more == ""


def test_the_budget_that_is_told_has_room(fits):
    few = wb.choose(BLOCK, budget=45.0, methods=("aabb", "mlp"), **GIVEN)
    more = wb.choose(BLOCK, budget=few.about["larger_budget"]["seconds"], methods=("aabb", "mlp"), **GIVEN)
    assert len(few.about["larger_budget"]["labels"]) > 0
    assert not any(row.needs for row in more.rows)


def test_a_repeat_fits_nothing_and_a_larger_budget_goes_on(fits, tmp_path):
    given = {**GIVEN, "methods": ("aabb", "kdop", "mlp"), "folder": tmp_path / "c"}
    first = wb.choose(BLOCK, budget=60.0, **given)
    begun = len(fits)
    again = wb.choose(BLOCK, budget=60.0, **given)
    assert len(fits) == begun
    assert again.about["seconds"] < 10.0
    assert again.about["seconds_before"] == pytest.approx(first.about["seconds"], abs=5.0)
    assert {row.label for row in again.rows if not row.why_not} == {row.label for row in first.rows if not row.why_not}
    wb.choose(BLOCK, budget=120.0, **given)
    assert len(fits) > begun
    assert "aabb" not in [label for label, _ in fits[begun:]]


def test_a_starved_network_says_so(fits, monkeypatch):
    monkeypatch.setattr("warp_bounding.choice.PATIENCE", np.inf)  # nobody looks after the first rounds
    choice = wb.choose(BLOCK, budget=12.0, methods=("mlp",), networks=((8, 8),), **GIVEN)
    row = rows_of(choice)["mlp 8-8"]
    assert row.note.startswith("hardly trained: ")
    assert row.needs > 12.0
    assert "mlp 8-8" in choice.more


def test_a_training_that_is_too_slow_is_stopped_after_its_first_rounds(clock):
    told = []
    watch = Watch(10.0, 0.25, told.append)
    clock[0] += 1.0
    watch(0.0, 1.0, "a")
    clock[0] += 5.0
    with pytest.raises(TooSlowError):
        watch(0.1, 1.0, "b")
    assert told == ["a", "b"]
    assert (watch.setup, watch.round) == pytest.approx((1.0, 5.0), abs=0.1)


def test_the_pace_of_one_network_tells_that_of_others():
    small, large = (Candidate("mlp", {"hidden": (n, n)}, True, 4 * n * n) for n in (16, 64))
    pace = Pace(region=False)
    assert pace.needed(small) is None
    pace.learn(small, 2.0, 1.0)
    assert pace.needed(small) == pytest.approx((2.0 + ROUNDS) / 0.75)
    assert pace.needed(large) > pace.needed(small)
    assert pace.needed(small, front=5.0) == pytest.approx(5.0 + pace.needed(small))
    pace.learn(large, 2.0, 0.01)
    assert pace.needed(large) == LEAST_SECONDS
    assert pace.needed(Candidate("mlp", {"hidden": (8,)}, True, 400, distance=True)) is None
    pace.took(10.0, 15.0)
    assert pace.given(pace.whole(7.0)) == pytest.approx(7.0)
    assert pace.whole(10.0) == pytest.approx(15.0)


def test_what_is_kept_is_charged(clock):
    spending = Spending(10.0)
    spending.charged = 4.0
    clock[0] += 3.0
    assert spending.left == pytest.approx(3.0, abs=0.2)
    assert (told_budget(61.2), told_budget(120.5), told_budget(3.2)) == (62.0, 130.0, 4.0)
