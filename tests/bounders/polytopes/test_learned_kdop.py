"""Learned half-spaces: no false negative for any query, never looser than ``kdop``, kernels as the reference."""

from functools import cache

import numpy as np
import pytest
from bounding_shapes import object_points, shape

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.learned_kdop import LearnedKdop, classic_normals
from warp_bounding.bounders.volumes import kdop_directions
from warp_bounding.errors import BounderError
from warp_bounding.queries import sample
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training import fit
from warp_bounding.training.learned_kdop import train_learned_kdop
from warp_bounding.training.samples import Problem

CASES = [
    *(("c", query) for query in ("point", "ray", "plane", "box")),
    ("mesh", "point"),
    ("mesh", "ray"),
    ("animated", "plane"),
    ("animated", "ray"),
]
LENGTH = {"c": 1.0, "blob": 1.0, "mesh": 0.1, "animated": 0.7}  # of rays


def frozen(bounder: LearnedKdop, name: str) -> LearnedKdop:
    least, count = bounder.least(shape(name))
    assert count > 0
    return bounder.freeze(round_down(least - bounder.rounding_bound()), None)


@cache
def trained(name: str, query: str) -> LearnedKdop:
    problem = Problem(shape(name), domain_of(shape(name), query, LENGTH[name]), query, 2, "cpu")
    bounder, record = train_learned_kdop(LearnedKdop, problem, {"k": None, "steps": 60}, 20.0, None)
    assert record["fp_rate"] <= record["fp_rate_kdop"]
    return frozen(bounder, name)


@cache
def positives(name: str, query: str) -> np.ndarray:
    x = next(draw_positives(query, shape(name), 20_000, 3, "cpu", LENGTH[name]))
    x = x[:: max(1, len(x) // 40_000)]
    return x if query != "point" else np.concatenate([x, object_points(shape(name), np.random.default_rng(0))])


@pytest.mark.parametrize(("name", "query"), CASES)
def test_no_false_negative(name, query):
    bounder, x = trained(name, query), positives(name, query)
    assert bounder.query(x).numpy().all()
    assert bounder.values(x).numpy().min() >= bounder.threshold
    random = np.random.default_rng(1).normal(size=bounder.tensors["normals"].shape)
    other = frozen(LearnedKdop.of_normals(shape(name), bounder.domain, random, device="cpu"), name)
    assert other.query(x).numpy().all()


@pytest.mark.parametrize(("name", "query"), CASES)
def test_never_looser_than_kdop(name, query):
    bounder = trained(name, query)
    classic = frozen(LearnedKdop.fit(shape(name), bounder.domain, device="cpu"), name)
    assert len(bounder.tensors["offsets"]) == len(classic.tensors["offsets"])
    x = sample(query, shape(name), 40_000, np.random.default_rng(8))
    rate = [b.query(x).numpy().mean() for b in (bounder, classic)]
    assert rate[0] <= rate[1] + 3e-3
    if (name, query) == ("c", "point"):
        assert rate[0] < 1


@pytest.mark.parametrize(("name", "query"), CASES)
def test_kernels_decide_as_the_reference(name, query, device):
    bounder = trained(name, query).to(device)
    x = sample(query, shape(name), 5000, np.random.default_rng(4))
    exact = bounder.reference(bounder.domain.to_local(x))
    answer = bounder.query(x).numpy().astype(bool)
    assert answer[exact >= 0].all()
    sure = exact < -1e-4
    assert not answer[sure & (exact > -1)].any()  # far from any rounding
    assert answer.mean() < 1 or not sure.any()


def test_bounds_are_exact(rng):
    bounder = trained("c", "point")
    m = bounder.domain.ndim
    lower = rng.uniform(-1, 1, (200, m))
    upper = lower + rng.random((200, m)) * 0.3
    bounds = bounder.bound(lower, upper)
    for low, high, least, value in zip(lower, upper, bounds.lower, bounds.value, strict=True):
        v = np.where(rng.random((500, m)) < 0.5, low, high)
        assert bounder.reference(v).min() >= least
        assert value - least <= 1e-9


def test_the_polytope_must_hold_the_object():
    grid = shape("c")
    bounder = trained("c", "ray")
    tensors = dict(bounder.tensors) | {"offsets": bounder.tensors["offsets"] - np.float32(0.1)}
    with pytest.raises(BounderError, match="do not hold"):
        LearnedKdop(bounder.domain, tensors, {}, "cpu").least(grid)
    with pytest.raises(BounderError, match="proven by their volume"):
        bounder.bound(np.zeros((1, 4)), np.ones((1, 4)))


def test_errors():
    grid = shape("c")
    domain = domain_of(grid, "point")
    with pytest.raises(BounderError, match="zero or not finite"):
        LearnedKdop.of_normals(grid, domain, np.zeros((3, 2)))
    with pytest.raises(BounderError, match="expected tensors"):
        LearnedKdop(domain, {"normals": np.ones((3, 3), np.float32), "offsets": np.ones(3, np.float32)}, {})
    with pytest.raises(BounderError, match="kdop offers"):
        classic_normals(domain, 5)
    assert not LearnedKdop.supports("ray", 1)


@pytest.mark.parametrize("method", ["kdop", "learned-kdop"])
def test_six_half_spaces_in_2d(method):
    grid = shape("c")
    bounder = fit(grid, method=method, k=6, budget=1.0, device="cpu", progress=False)
    assert len(kdop_directions(2, 6)) == 3
    assert bounder.certificate.proven
    assert bounder.query(object_points(grid, np.random.default_rng(0)).astype(np.float32)).numpy().all()
    with pytest.raises(BounderError, match="8 and 6"):
        kdop_directions(2, 5)
