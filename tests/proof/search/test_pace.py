"""Searches that must end in time."""

import numpy as np
import pytest

from warp_bounding.proof.search.pace import Pace

COUNT = 100_000


def finish(work, gap, *, noise=0.0, stuck=0.0, slow=False, seed=0):
    """Run a search whose share grows by ``1 / work(gap)`` a unit of time; the pace, and the time that it took."""
    pace, rng, used, share, boxes = Pace(gap), np.random.default_rng(seed), 0.0, 0.0, 0
    while share < 1:
        pace.update(used, share, boxes, COUNT)
        used += 0.001
        speed = 0.5 if slow and 0.3 < used < 0.4 else 1.0
        boxes += round(1000 * speed)
        if used > stuck:
            share += 0.001 * speed / work(pace.gap) * np.exp(rng.normal(0, noise))
        assert used < 2
    return pace, used


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("slow", [False, True])
def test_a_search_that_is_in_time_keeps_its_gap(noise, slow):
    pace, used = finish(lambda gap: 0.7, 0.1, noise=noise, slow=slow)
    assert (pace.gap, pace.whole) == (0.1, 0.0)
    assert used < 0.9


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("exponent", [0.15, 0.3, 0.7])
@pytest.mark.parametrize("whole", [1.2, 2.0, 5.0])
def test_a_search_that_is_late_widens_its_gap_and_ends(whole, exponent, noise):
    pace, used = finish(lambda gap: whole * (0.1 / gap) ** exponent, 0.1, noise=noise)
    assert pace.gap > 0.1
    assert pace.whole == pytest.approx(whole, rel=0.3)
    assert used < 1
    if whole <= 2:
        best = 0.1 * whole ** (1 / exponent)  # that would just be in time, were it known
        assert pace.gap < 10 * best


def test_a_search_that_does_not_move_widens_its_gap_too():
    pace, used = finish(lambda gap: 0.05, 1e-3, stuck=0.9)
    assert pace.gap > 1e-3
    assert used < 1


def test_behind_the_end_gaps_widen_fast():
    pace = Pace(1.0)
    pace.update(0.94, 1.0, 1000, COUNT)
    for used in np.arange(0.95, 1.0, 0.01):
        pace.update(used, 1.0, 1000, COUNT)
    assert pace.gap > 30


def test_a_gap_that_cannot_be_had_is_not_aimed_at():
    pace = Pace(0.1)
    pace.reach(0.05)
    assert pace.gap == 0.1
    pace.reach(0.3)
    assert pace.gap == 0.3


def test_gaps_can_be_widened_by_hand():
    pace = Pace(1.0)
    pace.widen()
    assert pace.gap == 10.0
