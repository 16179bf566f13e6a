"""A search that gives boxes up because too many wait is still sound, and goes on where it counts."""

from functools import cache

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.proof.local import Lost
from warp_bounding.proof.search import best_first
from warp_bounding.proof.search.vacancy import ShapePositives


@cache
def network() -> tuple[wb.Bounder, wb.IndicatorFunction]:
    shape = wb.IndicatorFunction(
        None, [-0.5] * 4, [0.5] * 4, distance=lambda x: np.abs(np.linalg.norm(x, axis=1) - 0.4) - 0.05
    )
    return wb.fit(shape, hidden=(12, 12), steps=100, device="cpu", progress=False), shape


@pytest.mark.parametrize(("many", "too_many"), [(1000, 2000), (4000, 6000), (10**9, 10**9)])
def test_bounds_hold_however_few_boxes_may_wait(many, too_many, monkeypatch, rng):
    monkeypatch.setattr(best_first, "MANY", many)
    monkeypatch.setattr(best_first, "TOO_MANY", too_many)
    monkeypatch.setattr(best_first, "CHUNK", 512)
    bounder, shape = network()
    x = rng.uniform(shape.lower, shape.upper, (200_000, 4))
    positives = bounder.domain.to_local(x[shape.contains(x)])
    found = ShapePositives(bounder, shape)
    lower, upper = found.boxes()
    search = best_first.minimum(found, lower, upper, eps=1e-3, boxes=60_000, points=positives[:100], positives=found)
    assert search.lower_bound <= bounder.reference(positives).min()
    assert np.isfinite(search.lower_bound)
    halves = np.arange(2)
    lower, upper = np.repeat(lower, 2, axis=0), np.repeat(upper, 2, axis=0)
    upper[0, 0] = lower[1, 0] = 0.0

    def part(v):
        return (v[:, 0] > 0).astype(np.int64)

    values = bounder.reference(bounder.domain.to_local(x[~shape.contains(x)][:20_000]))
    place = part(bounder.domain.to_local(x[~shape.contains(x)][:20_000]))
    least = np.full(2, np.inf)
    np.minimum.at(least, part(positives[:100]), bounder.reference(positives[:100]))
    told = {"groups": halves, "group_of": part, "group_count": 2, "price": Lost(values, place, least)}
    search = best_first.minimum(
        found, lower, upper, eps=1e-3, boxes=60_000, points=positives[:100], positives=found, **told
    )
    for number in halves:
        own = positives[part(positives) == number]
        assert search.by_group[number] <= bounder.reference(own).min()
    assert search.by_group.min() == search.lower_bound


def test_what_costs_more_comes_first(rng):
    values, place = rng.normal(size=1000), rng.integers(3, size=1000)
    least = np.array([0.5, -0.2, np.inf])
    lost = Lost(values, place, least)
    for number in (0, 1):
        for bound in (-np.inf, -1.0, 0.1, 0.4):
            wrong = ((place == number) & (values >= bound) & (values < least[number])).sum()
            assert wrong <= lost(np.array([bound]), np.array([number]))[0] <= wrong + 0.5
    assert lost(np.array([-1.0]), np.array([0]))[0] > lost(np.array([-0.5]), np.array([0]))[0]
    assert np.isfinite(lost(np.array([-np.inf, 3.0]), np.array([2, 2]))).all()


def test_a_split_keeps_the_dearest(rng):
    prices = rng.random(1000)
    prices[:10] = np.inf
    chunks = best_first._chunks(np.arange(1000.0), np.arange(1000.0), prices, np.zeros(1000, int), prices)
    for level, most in ((0.7, 1000), (0.0, 100), (2.0, 1000)):
        kept, rest = best_first._split(chunks, level, most)
        dear = np.concatenate([chunk.price for chunk in kept])
        cheap = np.concatenate([chunk.price for chunk in rest])
        assert len(dear) + len(cheap) == 1000
        assert len(dear) == min((prices > level).sum(), most)
        assert cheap.max() <= dear.min()
