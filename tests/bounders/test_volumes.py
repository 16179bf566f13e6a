"""Volumes and grids that learn: no false negative for any query, kernels as the reference, refused numbers."""

import math
from functools import cache

import numpy as np
import pytest
from bounding_shapes import domain_points, fitted, fitted_query, object_points, shape
from region_cases import fitted_region

import warp_bounding as wb
from warp_bounding.bounders.bvh import Bvh, build
from warp_bounding.bounders.learned_kdop import LearnedKdop, classic_normals
from warp_bounding.bounders.relu_field import FieldMap, ReluField
from warp_bounding.bounders.volumes import kdop_directions
from warp_bounding.errors import BounderError
from warp_bounding.geometry import GAP
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.boundary import draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.rounding import round_down
from warp_bounding.training import fit


def leaf_cells(tree, shape_of_grid) -> np.ndarray:
    covered = np.zeros(shape_of_grid, bool)
    for index in np.flatnonzero(tree.past == np.arange(len(tree.past)) + 1):
        covered[tuple(slice(a, b + 1) for a, b in zip(tree.first[index], tree.last[index], strict=True))] = True
    return covered


@pytest.mark.parametrize("name", ["c", "star", "animated"])
def test_volumes_are_the_least_of_their_families(name):
    """Each family is part of the next; how much of a volume the domain cuts off is another matter."""
    sizes, rates = {}, {}
    for method in ("sphere", "ellipsoid", "oriented-ellipsoid", "aabb", "kdop"):
        bounder = fitted(method, name)
        rates[method] = wb.evaluate(bounder, shape(name), samples=20_000).fp_rate
        if "matrix" in bounder.tensors or method == "sphere":
            radius = math.log(-float(bounder.threshold)) / 2
            sizes[method] = shape(name).ndim * radius - np.linalg.slogdet(bounder.shape.matrix)[1]
    assert rates["kdop"] <= rates["aabb"] + 1e-6
    assert sizes["oriented-ellipsoid"] <= sizes["ellipsoid"] + shape(name).ndim * GAP
    assert sizes["ellipsoid"] <= sizes["sphere"] + shape(name).ndim * GAP


@pytest.mark.parametrize("leaves", [1, 5, 300])
def test_points_of_a_hierarchy(leaves, device, rng):
    grid = shape("blob")
    bounder = fitted_region("bvh", "point", grid, device, leaves=leaves)
    assert bounder.least(grid) == (0.0, len(grid.occupied))
    assert bounder.query(object_points(grid, rng)).numpy().all()
    x = domain_points(grid, 20_000, rng)
    answers = bounder.query(x).numpy().astype(bool)
    expected = leaf_cells(build(grid, leaves), grid.shape)
    cell = np.clip(np.round(grid.cells_per_unit * x + grid.offset), 0, np.array(grid.shape) - 1).astype(int)
    inside = ((x >= grid.lower) & (x <= grid.upper)).all(axis=1)
    assert (answers != (expected[tuple(cell.T)] & inside)).mean() < 5e-3  # cells are widened by a 4096th


def test_what_is_no_hierarchy():
    bounder = fitted_region("bvh", "box", shape("c"), leaves=5)
    for name, change in (
        ("past", lambda t: t[::-1]),
        ("past", lambda t: t + np.float32(0.5)),
        ("past", lambda t: np.zeros_like(t)),
        ("low", lambda t: t - np.arange(len(t), dtype=np.float32)[:, None]),
        ("high", lambda t: t[:-1]),
        ("low", lambda t: t * np.float32(np.nan)),
    ):
        with pytest.raises(BounderError):
            Bvh(bounder.domain, bounder.tensors | {name: change(bounder.tensors[name])}, {}, "cpu")
    for options in ({"leaves": 0}, {"leaves": 2.5}):
        with pytest.raises(BounderError, match="must be"):
            Bvh.fit(shape("c"), bounder.domain, **options)


def test_boxes_that_lose_a_cell_prove_nothing():
    grid = shape("c")
    bounder = fitted_region("bvh", "box", grid, leaves=5)
    smaller = bounder.tensors["high"].copy()
    smaller[-1] = np.nextafter(bounder.tensors["high"][-1], np.float32(-1)) - np.float32(1e-3)
    assert Bvh(bounder.domain, bounder.tensors | {"high": smaller}, {}, "cpu").least(grid)[0] == -1.0


LEARNED = [("c", "point"), ("c", "plane"), ("c", "box"), ("blob", "ray")]


def frozen(bounder, name: str):
    """At the threshold that its closed form proves."""
    least, count = bounder.least(shape(name))
    assert count > 0
    return bounder.freeze(round_down(least - bounder.rounding_bound()), None)


def learned(name: str, query: str) -> LearnedKdop:
    return fitted_query(name, "learned-kdop", query, 1.0, 60)


@pytest.mark.parametrize(("name", "query"), LEARNED)
def test_never_looser_than_kdop_and_kernels_decide_as_the_reference(name, query, device):
    bounder = learned(name, query).to(device)
    classic = frozen(LearnedKdop.fit(shape(name), bounder.domain, device=device), name)
    assert len(bounder.tensors["offsets"]) == len(classic.tensors["offsets"])
    x = sample(query, shape(name), 20_000, np.random.default_rng(8))
    answer, other = (b.query(x).numpy().astype(bool) for b in (bounder, classic))
    assert answer.mean() <= other.mean() + 3e-3
    exact = bounder.reference(bounder.domain.to_local(x))
    assert answer[exact >= 0].all()
    sure = exact < -1e-4
    assert not answer[sure & (exact > -1)].any()  # far from any rounding
    assert answer.mean() < 1 or not sure.any()


def test_the_polytope_must_hold_the_object():
    grid = shape("c")
    bounder = learned("c", "ray")
    tensors = dict(bounder.tensors) | {"offsets": bounder.tensors["offsets"] - np.float32(0.1)}
    with pytest.raises(BounderError, match="do not hold"):
        LearnedKdop(bounder.domain, tensors, {}, "cpu").least(grid)
    with pytest.raises(BounderError, match="proven by their volume"):
        bounder.bound(np.zeros((1, 4)), np.ones((1, 4)))


FIELDS = ["c", "blob"]


def field(name: str, query: str = "point") -> ReluField:
    return fitted_query(name, "relu-field", query, 1.0, 12)


def random_field(name: str) -> ReluField:
    grid = shape(name)
    domain = domain_of(grid)
    field = FieldMap.of(grid, domain)
    values = np.random.default_rng(0).uniform(-0.5, 1.5, field.nodes)
    return ReluField.of_values(domain, field, values, "cpu")


@cache
def positives(name: str, query: str) -> np.ndarray:
    grid = shape(name)
    hard = next(draw_positives(query, grid, 20_000, 3, "cpu", 1.0))
    return hard if query != "point" else np.concatenate([hard, object_points(grid, np.random.default_rng(0))])


def random_half_spaces(name: str, query: str) -> LearnedKdop:
    made = learned(name, query)
    normals = np.random.default_rng(1).normal(size=made.tensors["normals"].shape)
    return frozen(LearnedKdop.of_normals(shape(name), made.domain, normals, device="cpu"), name)


@pytest.mark.parametrize(
    ("make", "name", "query"),
    [
        *((make, *case) for case in LEARNED for make in (learned, random_half_spaces)),
        *((field, name, "point") for name in FIELDS),
    ],
)
def test_no_false_negative(make, name, query):
    bounder, x = make(name, query), positives(name, query)
    assert oracle(query, shape(name), "cpu", 1.0)(x).all()
    assert bounder.query(x).numpy().all()
    assert bounder.values(x).numpy().min() >= bounder.threshold
    uniform = sample(query, shape(name), 20_000, np.random.default_rng(1))
    assert make is random_half_spaces or not bounder.query(uniform).numpy().all()


@pytest.mark.parametrize("name", FIELDS)
def test_bounds_hold_and_are_attained(name, rng):
    bounder = random_field(name)
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


@pytest.mark.parametrize("name", FIELDS)
def test_kernels_of_fields(name, device):
    bounder = random_field(name).to(device)
    x = sample("point", shape(name), 3000, np.random.default_rng(2))
    values = bounder.values(x).numpy()
    queried = np.isfinite(values)
    assert queried.any()
    error = np.abs(values - bounder.reference(bounder.domain.to_local(x)))[queried].max()
    # the reference starts from exact coordinates: what the map rounds comes on top
    assert error <= bounder.rounding_bound() + bounder.domain.delta @ np.abs(bounder._steepest * bounder.field.factor)


def test_other_numbers_of_half_spaces_and_nodes():
    for name, reported in (
        ("c", {"method": "kdop", "k": 6}),
        ("blob", {"method": "relu-field", "nodes": 7, "steps": 20}),
    ):
        bounder = fit(shape(name), budget=1.0, device="cpu", progress=False, **reported)
        assert bounder.certificate.proven
        assert bounder.query(object_points(shape(name), np.random.default_rng(0)).astype(np.float32)).numpy().all()


def test_numbers_that_are_refused():
    grid, domain = shape("c"), domain_of(shape("c"), "point")
    for work in (
        lambda: LearnedKdop.of_normals(grid, domain, np.zeros((3, 2))),
        lambda: LearnedKdop(domain, {"normals": np.ones((3, 3), np.float32), "offsets": np.ones(3, np.float32)}, {}),
        lambda: classic_normals(domain, 5),
        lambda: kdop_directions(2, 5),
        lambda: ReluField(domain, field("c").tensors, {"nodes": [12, 1]}),
        lambda: ReluField(domain, field("c").tensors, {"nodes": [12, 13]}),
        lambda: wb.fit(shape("blob"), "ray", "relu-field", steps=1),
        *(
            lambda nodes=nodes: wb.fit(grid, "point", "relu-field", nodes=nodes, device="cpu")
            for nodes in (1, 2000, 200)
        ),
    ):
        with pytest.raises(BounderError):
            work()
