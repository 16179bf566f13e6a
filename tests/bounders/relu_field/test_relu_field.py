"""The learned grid: what the kernels look up, bounds that hold with zero slack, covers that miss no positive, no false negative."""

from functools import cache

import numpy as np
import pytest
from bounding_shapes import object_points, shape

import warp_bounding as wb
from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.relu_field import FieldMap, ReluField, positive_boxes
from warp_bounding.errors import BounderError
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.relu_field import train_relu_field
from warp_bounding.training.samples import Problem

CASES = [
    ("c", "point"),
    ("c", "box"),
    ("c", "plane"),
    ("c", "ray"),
    ("blob", "point"),
    ("animated", "point"),
    ("single", "point"),
]


@cache
def trained(name: str, query: str) -> ReluField:
    grid = shape(name)
    problem = Problem(grid, domain_of(grid, query), query, 1, "cpu")
    bounder, record = train_relu_field(ReluField, problem, {"steps": 12}, 30.0, None)
    assert record["steps"] <= 12
    least, boxes = bounder.least(grid)
    assert boxes > 0
    return bounder.freeze(round_down(least - bounder.rounding_bound()), None)


def random_field(name: str, query: str, seed: int = 0) -> ReluField:
    grid = shape(name)
    domain = domain_of(grid, query)
    field = FieldMap.of(grid, domain)
    values = np.random.default_rng(seed).uniform(-0.5, 1.5, field.nodes)
    return ReluField.of_values(domain, field, values, "cpu")


def positives(name: str, query: str) -> np.ndarray:
    grid = shape(name)
    hard = next(draw_positives(query, grid, 20_000, 3, "cpu", 1.0))
    return hard if query != "point" else np.concatenate([hard, object_points(grid, np.random.default_rng(0))])


@pytest.mark.parametrize(("name", "query"), CASES)
def test_no_false_negative(name, query):
    bounder, x = trained(name, query), positives(name, query)
    assert oracle(query, shape(name), "cpu", 1.0)(x).all()
    assert bounder.query(x).numpy().all()
    values = bounder.values(x).numpy()
    assert values.min() >= bounder.threshold
    uniform = sample(query, shape(name), 20_000, np.random.default_rng(1))
    assert not bounder.query(uniform).numpy().all()


@pytest.mark.parametrize(("name", "query"), CASES)
def test_the_cover_holds_every_positive(name, query):
    bounder = trained(name, query)
    v = bounder.domain.to_local(positives(name, query).astype(np.float64)[:300])
    if query == "plane":  # where two entries of a normal are largest, either may be the one that is 1
        v = v[np.abs(v[:, :2]).min(axis=1) < 1]
    covered = np.zeros(len(v), dtype=bool)
    for lower, upper in positive_boxes(shape(name), bounder.domain, bounder.field):
        for start in range(0, len(lower), 20_000):
            a, b = lower[start : start + 20_000, None], upper[start : start + 20_000, None]
            covered |= ((v >= a - 1e-12) & (v <= b + 1e-12)).all(axis=2).any(axis=0)
    limit = bounder.domain.limit.astype(np.float64)
    inside = (np.abs(v) <= limit * (1 + 1e-12)).all(axis=1)
    assert inside.mean() > 0.5
    assert covered[inside].all()


@pytest.mark.parametrize(("name", "query"), CASES)
def test_bounds_hold_and_are_attained(name, query, rng):
    bounder = random_field(name, query)
    limit = bounder.domain.limit.astype(np.float64)
    lower = rng.uniform(-1, 1, (60, len(limit))) * limit
    upper = np.minimum(lower + rng.random((60, 1)) * 1.5 / bounder.field.factor.astype(np.float64), limit)
    bounds = bounder.bound(lower, upper)
    assert ((bounds.point >= lower) & (bounds.point <= upper)).all()
    for low, high, least in zip(lower, upper, bounds.lower, strict=True):
        v = low + rng.random((2000, len(limit))) * (high - low)
        v[:1000] = np.where(rng.random((1000, len(limit))) < 0.5, low, high)
        assert bounder.reference(v).min() >= least
    attained = bounds.value - bounds.lower
    assert attained.min() >= 0
    assert np.median(attained) <= 1e-2


@pytest.mark.parametrize(("name", "query"), CASES)
def test_kernels_compute_what_the_reference_does(name, query, device):
    bounder = random_field(name, query).to(device)
    x = sample(query, shape(name), 3000, np.random.default_rng(2))
    values = bounder.values(x).numpy()
    asked = np.isfinite(values)
    assert asked.any()
    error = np.abs(values - bounder.reference(bounder.domain.to_local(x)))[asked].max()
    # the reference starts from exact coordinates: what the map rounds comes on top
    assert error <= bounder.rounding_bound() + bounder.domain.delta @ np.abs(bounder._steepest * bounder.field.factor)


@pytest.mark.parametrize("query", ["point", "box", "plane", "ray"])
def test_training_gains(query):
    """More than where it starts: every node near a positive at one height."""
    grid = shape("c")
    start = ReluField.fit(grid, domain_of(grid, query), device="cpu")
    start.freeze(round_down(start.least(grid)[0] - start.rounding_bound()), None)
    x = sample(query, grid, 20_000, np.random.default_rng(5))
    rate = [b.query(x).numpy().mean() for b in (trained("c", query), start)]
    assert rate[0] <= rate[1] + 2e-3


def test_what_it_supports():
    assert ReluField.supports("ray", 2)
    assert ReluField.supports("point", 4)
    assert not ReluField.supports("ray", 3)
    assert not ReluField.supports("point", 5)
    with pytest.raises(BounderError, match="does not bound"):
        wb.fit(shape("blob"), "ray", "relu-field", steps=1)
    domain = domain_of(shape("c"), "point")
    with pytest.raises(BounderError, match="nodes"):
        ReluField(domain, trained("c", "point").tensors, {"nodes": [12, 1]})
    with pytest.raises(BounderError, match="expected tensors"):
        ReluField(domain, trained("c", "point").tensors, {"nodes": [12, 13]})


@pytest.mark.parametrize(("name", "nodes"), [("c", 2), ("blob", 7), ("animated", 3)])
def test_fields_of_another_resolution_have_no_false_negative(name, nodes):
    grid = shape(name)
    bounder = wb.fit(grid, method="relu-field", nodes=nodes, steps=20, device="cpu", progress=False)
    assert bounder.field.nodes == (nodes,) * grid.ndim
    assert bounder.certificate.proven
    assert bounder.query(positives(name, "point").astype(np.float32)).numpy().all()


def test_a_resolution_that_makes_no_sense_is_refused():
    for nodes, query in ((1, "point"), (2000, "point"), (8, "box")):
        with pytest.raises(BounderError, match="nodes"):
            wb.fit(shape("c"), query, "relu-field", nodes=nodes, device="cpu")
    with pytest.raises(BounderError, match="too fine for the object's cells"):
        wb.fit(shape("c"), method="relu-field", nodes=200, device="cpu")
