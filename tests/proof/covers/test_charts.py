"""Proofs of rays and boxes: bounds over charts hold with zero slack, charts cover every positive, no positive is denied."""

import numpy as np
import pytest
from bounding_shapes import shape
from random_networks import random_network

import warp_bounding as wb
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof import certify, charted, least_value, prove
from warp_bounding.proof.covers.ray import single_cells
from warp_bounding.proof.search.depth_first import charted_minimum, prove_target
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import draw_positives
from warp_bounding.training.samples import samples_of

CASES = [("ray", "c"), ("ray", "single"), ("ray", "small"), ("box", "c"), ("box", "single"), ("box", "small")]
SLOW = [("ray", "animated"), ("box", "animated"), ("ray", "anisotropic"), ("box", "anisotropic")]


def grid_of(name: str) -> IndicatorGrid:
    if name != "small":
        return shape(name)
    occupancy = np.zeros((4, 3, 4), bool)
    occupancy[1, 1, 1] = occupancy[2, 1, 1] = occupancy[2, 2, 3] = occupancy[0, 0, 3] = True
    return IndicatorGrid(occupancy)


def positives(bounder: Mlp, grid: IndicatorGrid, count: int, seed: int = 0) -> np.ndarray:
    """Float32 queries that meet the object."""
    length = bounder.domain.oracle_length
    chunks = []
    for x in draw_positives(bounder.query_kind, grid, count, seed, "cpu", length):
        chunks.append(x)
        if sum(map(len, chunks)) >= count:
            break
    return np.concatenate(chunks)[:count]


def positives_in(cover, lower: np.ndarray, upper: np.ndarray, rng) -> np.ndarray:
    """``v`` of random numbers of the chart's boxes, half of them at ends; they need not be in the domain or meet the object."""
    u = rng.random(lower.shape)
    u = np.where(rng.random(u.shape) < 0.5, np.round(u), u)
    return cover.coordinates(lower + u * (upper - lower))


@pytest.mark.parametrize(
    ("query", "name", "activation"),
    [(*case, "sin") for case in CASES]
    + [(*CASES[i], name) for i, name in ((0, "tanh"), (2, "relu"), (3, "relu"), (5, "tanh"))],
)
def test_bounds_hold_on_boxes_of_a_chart(query, name, activation):
    grid, rng = grid_of(name), np.random.default_rng(1)
    bounder = random_network(query, grid, 3, activation)
    cover, n = charted(bounder, grid), grid.ndim
    pick = rng.integers(len(cover.lower), size=600)
    size = cover.upper[pick] - cover.lower[pick]
    width = size * rng.random((600, 1)) ** 4 * rng.choice([0.0, 0.1, 1.0], size.shape, p=[0.1, 0.2, 0.7])
    low = cover.lower[pick] + rng.random(size.shape) * (size - width)
    high = low + width
    bounds = cover.bound(low, high)
    inside = bounder.domain.base.limit.astype(np.float64)
    truth = oracle(query, grid, "cpu", bounder.domain.oracle_length)
    tried = 0
    for _ in range(60):
        v = positives_in(cover, low, high, rng)
        if query == "ray":
            asked = (np.abs(v[:, :n]) <= inside).all(axis=1)
        else:
            asked = (v[:, :n] <= v[:, n:]).all(axis=1)
            asked[asked] = truth(bounder.domain.to_object(v[asked]))
        assert (bounder.reference(v)[asked] >= bounds.lower[asked]).all()
        tried += asked.sum()
    assert tried > 1000


@pytest.mark.parametrize(("query", "name"), [*CASES, *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW)])
def test_the_minimum_is_below_every_positive_and_close_to_one(query, name):
    grid = grid_of(name)
    bounder = random_network(query, grid, 5, gain=1.5)
    search = least_value(bounder, grid, eps=0.1, boxes=5_000_000)
    x = positives(bounder, grid, 200_000)
    values = bounder.values(x).numpy().astype(np.float64)
    assert search.lower_bound <= values.min() + bounder.rounding_bound()
    assert search.lower_bound <= search.upper_bound
    if search.complete:
        assert search.upper_bound - search.lower_bound <= 0.1
        assert search.lower_bound >= values.min() - 0.5  # samples come close
    assert np.abs(bounder.reference(search.worst[:1]) - search.upper_bound).max() < 0.1  # but for the input error


@pytest.mark.parametrize(("query", "name"), CASES)
def test_a_proven_network_is_certified_and_a_raised_threshold_is_refuted(query, name):
    grid = grid_of(name)
    bounder = random_network(query, grid, 7, gain=1.5)
    search = prove(bounder, grid, eps=0.02)
    assert bounder.certificate.proven
    assert search.complete
    x = positives(bounder, grid, 100_000, 3)
    assert bounder.query(x).numpy().all()
    proof = certify(bounder, grid)
    assert proof.proven
    assert proof.lower_bound >= float(bounder.threshold)
    assert proof.boxes > 0
    raised = float(np.quantile(bounder.reference(bounder.domain.to_local(x)), 0.3))
    bounder.freeze(raised, None)
    proof = certify(bounder, grid)
    assert proof.kind == "refuted"
    query_found = np.float32(proof.counterexample)[None]
    assert bounder.query(query_found).numpy()[0] == 0
    assert oracle(query, grid, "cpu", bounder.domain.oracle_length)(query_found)[0]


def test_single_cells_are_the_same_rays():
    for name in ("c", "small"):
        grid = grid_of(name)
        bounder = random_network("ray", grid, 2, gain=1.0)
        cover = charted(bounder, grid)
        lower, upper = (np.concatenate(side) for side in zip(*single_cells(bounder, grid), strict=True))
        sizes = (cover.upper - cover.lower, upper - lower)
        assert np.isclose(*(np.prod(np.where(size > 0, size, 1.0), axis=1).sum() for size in sizes))
        single = type(cover)(cover.network, cover.chart, lower, upper, cover.numbers, cover.limit)
        first, second = (charted_minimum(c, eps=0.02) for c in (cover, single))
        assert abs(first.lower_bound - second.lower_bound) <= 0.02


@pytest.mark.parametrize(("query", "name"), CASES)
def test_clear_tells_what_it_proved(query, name):
    grid = grid_of(name)
    bounder = random_network(query, grid, 4, gain=1.5)
    cover = charted(bounder, grid)
    least = charted_minimum(cover, eps=0.02)
    below, above = prove_target(cover, least.upper_bound - 0.1), prove_target(cover, least.upper_bound + 0.1)
    assert below.complete
    assert below.least >= least.upper_bound - 0.1
    assert not above.complete
    assert above.values[0] < least.upper_bound + 0.1
    cut = prove_target(cover, least.upper_bound - 1e-3, boxes=10)
    assert not cut.complete or cut.boxes <= 10 + 64


@pytest.mark.parametrize("seed", range(2))
def test_who_asks_for_too_small_a_gap_gets_no_larger_one(seed):
    """The set that is proven holds inputs that no point of it is: f there may lie lower than any point's, however small the boxes."""
    grid = grid_of("c")
    bounder = random_network("ray", grid, seed, gain=20.0)
    cover = charted(bounder, grid)
    usual = charted_minimum(cover, eps=0.1)
    at = cover.bound(usual.numbers[:1], usual.numbers[:1])
    left_over = float((at.value - at.lower)[0])
    fine = charted_minimum(cover, eps=left_over / 4, boxes=20_000_000)
    assert not fine.complete
    assert usual.lower_bound <= fine.lower_bound < fine.upper_bound <= usual.upper_bound
    for x in draw_positives("ray", grid, 100_000, seed, "cpu", 1.0):
        assert bounder.values(x).numpy().min() >= fine.lower_bound - bounder.rounding_bound()


@pytest.mark.parametrize(("query", "name"), CASES)
def test_low_points_become_training_samples(query, name):
    grid = grid_of(name)
    bounder = random_network(query, grid, 6, gain=1.5)
    search = least_value(bounder, grid, eps=0.1)
    samples = samples_of(grid, bounder.domain)
    states = samples.at(search.numbers)
    assert states.shape[1] >= 0.9 * len(search.numbers)
    v = samples.coordinates(states).T.double().numpy()
    assert bounder.reference(v).min() <= search.upper_bound + 0.1


@pytest.mark.parametrize("name", ["blob", "star", "c"])
def test_a_search_without_known_points_begins(name):
    bounder = random_network("box", shape(name), activation="relu")
    search = least_value(bounder, shape(name), eps=0.05, boxes=5_000_000)
    assert search.complete
    assert np.isfinite(search.upper_bound)


@pytest.mark.parametrize("query", ["ray", "box"])
def test_a_target_out_of_reach_is_given_up_for_a_lower_one(query):
    grid = grid_of("c")
    bounder = random_network(query, grid, 9, gain=4.0)
    cover, x = charted(bounder, grid), positives(bounder, grid, 100_000, 3)
    least = float(bounder.reference(bounder.domain.to_local(x)).min())
    whole = charted_minimum(cover, eps=0.02, upper=least)
    assert whole.complete
    searches = [charted_minimum(cover, eps=1e-6, upper=least, boxes=whole.boxes / part) for part in (2, 2, 8, 1e9)]
    first, again, shorter, least_of_all = searches
    assert (first.lower_bound, first.boxes) == (again.lower_bound, again.boxes)
    assert first.lower_bound >= shorter.lower_bound >= least_of_all.lower_bound
    assert first.lower_bound > least_of_all.lower_bound
    for search in searches:
        assert search.lower_bound <= least
        assert not search.complete
        assert np.isfinite(search.lower_bound)


def test_time_that_is_too_short_is_told():
    grid = grid_of("c")
    bounder = random_network("ray", grid, 8)
    prove(bounder, grid, eps=0.02)
    assert certify(bounder, grid, seconds=0.0).kind in ("undecided", "proven")
    search = least_value(random_network("ray", grid, 9, gain=8.0), grid, eps=1e-9, seconds=0.0)
    assert np.isfinite(search.lower_bound)
    assert not search.complete


def test_a_fit_of_rays_and_boxes_is_proven(tmp_path):
    for query in ("ray", "box"):
        bounder = wb.fit(shape("c"), query=query, hidden=(9, 7), steps=30, device="cpu")
        assert bounder.certificate.proven, bounder.certificate.message
        bounder.save(tmp_path / "b.safetensors")
        assert wb.certify(wb.load(tmp_path / "b.safetensors"), shape("c")).proven
