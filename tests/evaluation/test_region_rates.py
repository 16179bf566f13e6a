"""Rates of rays, planes and boxes: counts of what oracle and bounder say, by both protocols, with the bounder's own length."""

from functools import cache

import numpy as np
import pytest
from bounding_shapes import shape, told_of

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.errors import QueryError
from warp_bounding.queries import oracle, sample

REGIONS = ("ray", "plane", "box")
SAMPLES = 20_000
CLASSICS = [
    (method, query)
    for method in ("aabb", "kdop", "sphere", "bvh")
    for query in REGIONS
    if method in METHODS and METHODS[method].supports(query, 3)
]


@cache
def fitted(method: str, query: str, length: float = 0.6):
    """On the CPU; never change it."""
    told = told_of(method, query, length=length)
    return wb.fit(shape("star"), query=query, method=method, device="cpu", **told)


def test_there_are_classics():
    assert {query for _, query in CLASSICS} == set(REGIONS)


@pytest.mark.parametrize(("method", "query"), CLASSICS)
def test_rates_are_what_a_count_gives(method, query, device):
    bounder, grid = fitted(method, query).to(device), shape("star")
    rates = wb.evaluate(bounder, grid, samples=SAMPLES, seed=5)
    x = sample(query, grid, SAMPLES, np.random.default_rng(5))
    truth, maybe = oracle(query, grid, "cpu", 0.6)(x), bounder.query(x).numpy().astype(bool)
    assert rates.fn == 0
    assert rates.fp_rate == 100 * (maybe & ~truth).sum() / SAMPLES
    assert rates.positives == 100 * truth.sum() / SAMPLES
    assert (rates.samples, rates.protocol, rates.seed) == (SAMPLES, "exact", 5)


@pytest.mark.parametrize("name", ["c", "star", "animated"])
@pytest.mark.parametrize("query", REGIONS)
def test_sampled_positives_are_fewer(query, name):
    """Random points of a region miss thin hits and invent none, so what misses nothing under one protocol does so under both."""
    grid = shape(name)
    told = told_of("aabb", query, length=0.6)
    bounder = wb.fit(grid, query=query, method="aabb", device="cpu", **told)
    exact = wb.evaluate(bounder, grid, samples=SAMPLES, seed=2)
    sampled = wb.evaluate(bounder, grid, samples=SAMPLES, seed=2, protocol="sampled")
    assert exact.fn == sampled.fn == 0
    assert exact.positives > sampled.positives > 0
    assert exact.fp_rate < sampled.fp_rate
    assert exact.fp_rate + exact.positives == pytest.approx(
        sampled.fp_rate + sampled.positives
    )  # all that it lets through


def test_each_bounder_is_asked_rays_of_its_own_length():
    positives = [
        wb.evaluate(fitted("aabb", "ray", length=length), shape("star"), SAMPLES).positives
        for length in (0.05, 0.6, 2.0)
    ]
    assert positives == sorted(positives)
    assert positives[0] < positives[1] < positives[2]
    for length in (0.05, 2.0):
        rates = [
            wb.evaluate(fitted("aabb", "ray", length=length), shape("star"), SAMPLES, protocol=p)
            for p in ("exact", "sampled")
        ]
        assert [r.fn for r in rates] == [0, 0]


@pytest.mark.parametrize("query", REGIONS)
def test_false_negatives_are_counted(query):
    grid = shape("star")
    told = told_of("sphere", query, length=0.6)
    bounder = wb.fit(grid, query=query, method="sphere", device="cpu", **told)
    bounder.freeze(float(bounder.threshold) + 0.5, None)
    x = sample(query, grid, SAMPLES, np.random.default_rng(1))
    truth, maybe = oracle(query, grid, "cpu", 0.6)(x), bounder.query(x).numpy().astype(bool)
    rates = wb.evaluate(bounder, grid, SAMPLES)
    assert rates.fn == (truth & ~maybe).sum() > 0


@pytest.mark.parametrize("query", REGIONS)
def test_seeds_tell_samples_apart(query):
    rates = [wb.evaluate(fitted("aabb", query), shape("star"), 5000, seed=s, protocol="sampled") for s in (3, 3, 4)]
    assert rates[0] == rates[1]
    assert rates[0] != rates[2]


def test_a_shape_of_another_dimension():
    with pytest.raises(QueryError, match="2D"):
        wb.evaluate(fitted("aabb", "box"), shape("c"))
