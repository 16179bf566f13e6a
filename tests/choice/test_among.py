"""Choices among what one's own code asks: the cheapest by time and by what is left, no broad phase among them."""

import time

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.errors import BounderError

COUNT = 1000


def asking(seconds: float, left: int):
    """A broad phase that takes its time and leaves so many queries."""

    def ask() -> np.ndarray:
        time.sleep(seconds)
        return np.arange(COUNT) < left

    return ask


def test_time_and_share_are_weighed_by_the_price():
    asked = {"slow and tight": asking(0.02, 10), "quick and loose": asking(0.0, 500)}
    dear = wb.choose_among(asked, COUNT, narrow_ns=1e6)
    assert (dear.label, dear.bounder, dear.positives) == ("slow and tight", None, 0.01)
    assert dear.row.nanoseconds >= 1e9 * 0.02 / COUNT
    cheap = wb.choose_among(asked, COUNT, narrow_ns=20_000.0)
    assert cheap.label == "quick and loose"
    assert wb.choose_among(asked, COUNT, narrow_ns=0.0).label == "none"
    assert [stretch.label for stretch in cheap.prices] == ["none", "quick and loose", "slow and tight"]


def test_answers_of_warp_are_taken(rng):
    ball = np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5
    box, x = wb.fit(ball, method="aabb", device="cpu"), rng.uniform(-20, 30, (COUNT, 2)).astype(np.float32)
    choice = wb.choose_among({"box": lambda: box.query(x)}, COUNT, narrow_ns=1e9)
    assert choice.label == "box"
    assert choice.row.share == box.query(x).numpy().mean()


@pytest.mark.parametrize(
    ("asked", "count", "price", "told"),
    [
        ({}, COUNT, -1.0, "narrow_ns must be a number"),
        ({}, 0, 1.0, "queries must be a whole number"),
        ({"a": lambda: np.zeros(3)}, COUNT, 1.0, r"a: expected \(1000,\) answers, got \(3,\)"),
    ],
)
def test_bad_input_is_refused(asked, count, price, told):
    with pytest.raises(BounderError, match=told):
        wb.choose_among(asked, count, narrow_ns=price)
