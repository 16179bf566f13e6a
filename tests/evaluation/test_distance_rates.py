"""Rates of a distance that is asked points, rays and boxes: counts of what oracle and bounder say, by both protocols."""

import numpy as np
import pytest
from bounding_shapes import shape
from distances import far, thing

import warp_bounding as wb
from warp_bounding.errors import QueryError
from warp_bounding.queries import oracle, sample

SAMPLES = 20_000
ASKED = {
    "point": (lambda b, x: b.query(x), {}),
    "ray": (lambda b, x: b.rays(x, length=0.6, steps=12)[0], {"length": 0.6, "steps": 12}),
    "box": (lambda b, x: b.boxes(*np.split(x, 2, axis=1), steps=20), {"steps": 20}),
}


@pytest.mark.parametrize("name", ["c", "blob"])
@pytest.mark.parametrize("query", ASKED)
def test_rates_are_what_a_count_gives(name, query):
    bounder, grid, (ask, told) = far("bvh", name), thing(name), ASKED[query]
    rates = wb.evaluate(bounder, grid, samples=SAMPLES, seed=5, query=query, **told)
    x = sample(query, grid, SAMPLES, np.random.default_rng(5))
    truth, maybe = oracle(query, grid, "cpu", told.get("length", 1.0))(x), ask(bounder, x).numpy().astype(bool)
    assert (rates.fp_rate, rates.fn) == (100 * (maybe & ~truth).sum() / SAMPLES, 0)
    assert rates.fp_rate < 100
    assert (rates.query, rates.positives) == (query, 100 * truth.sum() / SAMPLES)
    sampled = wb.evaluate(bounder, grid, SAMPLES, "sampled", seed=5, query=query, **told)
    assert sampled.fn == 0
    assert sampled.positives <= rates.positives
    assert sampled.fp_rate >= rates.fp_rate


def test_more_steps_are_tighter():
    bounder, grid = far("distance-grid", "blob"), thing("blob")
    few, many = (wb.evaluate(bounder, grid, samples=SAMPLES, query="ray", steps=n).fp_rate for n in (2, 64))
    assert many < few


def test_rays_of_a_mesh_are_judged_by_the_mesh_itself():
    rates = wb.evaluate(far("bvh", "tetrahedron"), thing("tetrahedron"), samples=4000, query="ray")
    assert (rates.truth, rates.fn) == ("of the shape itself", 0)


@pytest.mark.parametrize(
    "told",
    [
        {"query": "plane"},
        {"query": "point", "length": 1.0},
        {"query": "point", "steps": 8},
        {"query": "ray", "radius": 0.1},
        {"query": "box", "length": 1.0},
        {"query": "ray", "length": -1.0},
        {"query": "ray", "length": float("nan")},
        {"query": "ray", "steps": 0},
        {"query": "box", "steps": 1.5},
        {"radius": True},
    ],
    ids=str,
)
def test_what_makes_no_sense_is_refused(told):
    with pytest.raises(QueryError):
        wb.evaluate(far("bvh", "c"), thing("c"), samples=100, **told)


@pytest.mark.parametrize("told", [{"query": "point"}, {"length": 1.0}, {"steps": 3}, {"radius": 0.0}], ids=str)
def test_only_distances_are_told_these(told):
    (name,) = told
    with pytest.raises(QueryError, match=f"{name} is for distances"):
        wb.evaluate(wb.fit(shape("c"), method="aabb", device="cpu"), shape("c"), samples=100, **told)
