"""Attacks on proofs over charts: queries at the edges of what devices compute, bounds that are NaN, searches that are cut short."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.bounders.mlp import Mlp, encoding_tensors
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof import certify, charted, prove
from warp_bounding.proof.covers.plane import SupportGap
from warp_bounding.proof.covers.ray import single_cells
from warp_bounding.proof.search.best_first import minimum
from warp_bounding.proof.search.depth_first import STACK, _fill, charted_minimum, prove_target
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of

HIDDEN = (9, 7)  # of every network: each other size costs a compilation
NETWORKS = [("ray", "sin", 0), ("ray", "relu", 0), ("ray", "tanh", 0), ("ray", "sin", 1), ("box", "sin", 0)]


def small_grid(seed: int, *sizes: int) -> IndicatorGrid:
    """Cells of size 1 in a domain whose map is exact in float64, so that a point of a face is one."""
    occupancy = np.random.default_rng(seed).random(sizes) < 0.3
    occupancy.flat[:2] = True, False
    return IndicatorGrid(occupancy, cells_per_unit=np.ones(len(sizes)), offset=np.full(len(sizes), 0.5))


def far_grid() -> IndicatorGrid:
    """An object so far from the origin that the domain's float32 centre is not its middle."""
    return IndicatorGrid(shape("c").occupancy, cells_per_unit=[7.0, 7.0], offset=[40003.5, 40003.5])


def cropped_grid() -> IndicatorGrid:
    """The cells of ``c`` without the empty ones around them."""
    whole = shape("c")
    return IndicatorGrid(
        whole.occupancy[2:10, 2:10], cells_per_unit=whole.cells_per_unit, offset=whole.offset + np.array([2.0, 2.0])
    )


def wide_domain():
    """What a file may say: boxes are cut far outside the object's grid."""
    domain = domain_of(shape("c"), "box")
    return replace(domain, base=replace(domain.base, limit=domain.base.limit * np.float32(1.5)))


OBJECTS = {  # the domain that a bounder is made for, the grid that it is proven on
    "c": lambda: (domain_of(shape("c"), "box"), shape("c")),
    "far": lambda: (domain_of(far_grid(), "box"), far_grid()),
    "cropped": lambda: (domain_of(shape("c"), "box"), cropped_grid()),
    "wide": lambda: (wide_domain(), shape("c")),
}


def reaching_out(domain) -> np.ndarray:
    """A float32 box that holds the whole domain, ``(1, 2 n)``."""
    return np.concatenate([domain.lower - 1, domain.upper + 1]).astype(np.float32)[None]


def network_of(domain, activation: str, octaves: int = 0, seed: int = 0) -> Mlp:
    rng, tensors = np.random.default_rng(seed), {}
    inputs = domain.ndim * (1 + 2 * octaves)
    for i, (k, h) in enumerate(zip((inputs, *HIDDEN), (*HIDDEN, 1), strict=True)):
        tensors[f"layers.{i}.weight"] = (rng.normal(size=(h, k)) * 1.5 / np.sqrt(k)).astype(np.float32)
        tensors[f"layers.{i}.bias"] = rng.normal(size=h).astype(np.float32)
    tensors |= encoding_tensors(domain.ndim, octaves) if octaves else {}
    return Mlp(domain, tensors, {"hidden": list(HIDDEN), "activation": activation, "octaves": octaves}, "cpu")


def first_input_of(domain) -> Mlp:
    """``f = v_0 + 1``, as a network of ReLUs: least where a box's lower corner is as low as it gets."""
    tensors = {}
    for i, (k, h) in enumerate(zip((domain.ndim, *HIDDEN), (*HIDDEN, 1), strict=True)):
        weight, bias = np.zeros((h, k), np.float32), np.zeros(h, np.float32)
        weight[0, 0], bias[0] = 1.0, (4.0, 0.0, -3.0)[i]
        tensors |= {f"layers.{i}.weight": weight, f"layers.{i}.bias": bias}
    return Mlp(domain, tensors, {"hidden": list(HIDDEN), "activation": "relu", "octaves": 0}, "cpu")


@pytest.mark.parametrize(("query", "activation", "octaves"), NETWORKS)
def test_bounds_hold_as_far_off_as_devices_compute(query, activation, octaves):
    grid, rng, count = shape("c"), np.random.default_rng(2), 1000
    bounder = network_of(domain_of(grid, query), activation, octaves, seed=3)
    cover, n = charted(bounder, grid), grid.ndim
    pick = rng.integers(len(cover.lower), size=count)
    size = cover.upper[pick] - cover.lower[pick]
    width = size * 2.0 ** -rng.integers(0, 14, (count, 1)) * rng.choice([0.0, 0.1, 1.0], size.shape, p=[0.1, 0.2, 0.7])
    low = cover.lower[pick] + rng.random(size.shape) * (size - width)
    high, tried = low + width, 0
    bounds = cover.bound(low, high)
    limit, truth = bounder.domain.base.limit.astype(np.float64), oracle(query, grid, "cpu", 1.0)
    for turn in range(40):
        u = rng.random(low.shape)
        v = cover.coordinates(low + np.where(rng.random(u.shape) < 0.5, np.round(u), u) * width)
        asked = np.ones(count, bool)
        if query == "box":
            asked = (v[:, :n] <= v[:, n:]).all(axis=1)
            asked[asked] = truth(bounder.domain.to_object(v[asked]))
        side = np.sign(bounds.slope) if turn % 2 else rng.choice([-1.0, 1.0], v.shape)
        v = v - side * bounder.domain.delta * (1 - 1e-12)
        if query == "ray":
            asked &= (np.abs(v[:, :n]) <= limit).all(axis=1)
        assert (bounder.reference(v)[asked] >= bounds.lower[asked]).all()
        tried += asked.sum()
    assert tried > 1000


@pytest.mark.parametrize("way", ["charted", "single"])
@pytest.mark.parametrize("sizes", [(8, 4), (4, 4, 4)])
def test_every_ray_lies_in_a_box_where_it_first_enters(sizes, way):
    """All numbers are multiples of 1/8, so nothing here rounds: rays along faces, through edges and corners, from outside."""
    grid, rng, n = small_grid(len(sizes), *sizes), np.random.default_rng(4), len(sizes)
    bounder = network_of(domain_of(grid, "ray", 64.0), "relu")
    cover = charted(bounder, grid)
    lower, upper = cover.lower, cover.upper
    if way == "single":
        lower, upper = (np.concatenate(side) for side in zip(*single_cells(bounder, grid), strict=True))
    origin = rng.integers(-4, 2 * np.array(sizes) + 5, (3000, n)) / 2 + grid.lower
    origin += rng.choice([0.0, 0.25], origin.shape, p=[0.7, 0.3])
    d = rng.choice([-2.0, -1.0, 0.0, 1.0, 2.0], origin.shape)
    d[~d.any(axis=1), 0] = 1.0
    first, last = grid.position(grid.occupied - 0.5)[:, None], grid.position(grid.occupied + 0.5)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort(np.stack([(first - origin) / d, (last - origin) / d]), axis=0)  # (2, cells, rays, n)
    within = (origin >= first) & (origin <= last)
    near = np.where(d == 0, np.where(within, 0.0, np.inf), ends[0]).max(axis=2).clip(0)
    far = np.where(d == 0, np.inf, ends[1]).min(axis=2)
    enter = np.where(near <= far, near, np.inf).min(axis=0)
    hit = np.isfinite(enter)
    origin, d, enter = origin[hit], d[hit], enter[hit, None]
    p = bounder.domain.base.to_local(origin + enter * d)
    z = np.concatenate([p, np.where(enter > 0, 0.5, 0.0), d / np.abs(d).max(axis=1, keepdims=True)], axis=1)[:, None]
    assert ((z >= lower) & (z <= upper)).all(axis=2).any(axis=1).all()
    assert (enter > 0).sum() > 100
    assert (enter == 0).sum() > 100


@pytest.mark.parametrize("name", OBJECTS)
def test_every_box_that_a_device_makes_of_a_positive_lies_in_the_chart(name):
    domain, grid = OBJECTS[name]()
    assert domain.fault() is None
    cover, n, base = charted(network_of(domain, "relu"), grid), grid.ndim, domain.base
    x = next(iter(draw_positives("box", grid, 10_000, 5, "cpu")))
    x = np.concatenate([x, reaching_out(domain)])
    assert oracle("box", grid, "cpu", 1.0)(x).all()
    v = (x - np.tile(base.center, 2)) * np.tile(base.scale, 2)
    v = np.clip(v, -np.tile(base.limit, 2), np.tile(base.limit, 2)).astype(np.float64)
    noise = np.tile(cover.numbers[2 * n :], 2)
    assert (v >= cover.coordinates(cover.lower) - noise).all()
    assert (v <= cover.coordinates(cover.upper) + noise).all()


@pytest.mark.parametrize("name", OBJECTS)
def test_a_box_that_reaches_out_of_the_domain_is_not_denied(name):
    domain, grid = OBJECTS[name]()
    bounder, x = first_input_of(domain), reaching_out(domain)
    prove(bounder, grid, eps=1e-6)
    assert oracle("box", grid, "cpu", 1.0)(x).all()
    assert bounder.query(x).numpy().all()


@pytest.mark.parametrize("name", OBJECTS)
def test_certify_does_not_prove_a_threshold_that_denies_such_a_box(name):
    domain, grid = OBJECTS[name]()
    bounder, x = first_input_of(domain), reaching_out(domain)
    bounder.freeze(float(bounder.values(x).numpy()[0]) + 2 * bounder.rounding_bound(), None)
    assert not bounder.query(x).numpy().any()
    assert certify(bounder, grid).kind != "proven"


@pytest.mark.parametrize("query", ["ray", "box"])
def test_certify_closes_no_box_whose_bound_is_nan(query, monkeypatch):
    grid = shape("c")
    bounder = network_of(domain_of(grid, query), "relu").freeze(1e6, None)
    cover = charted(bounder, grid)
    broken = replace(cover, numbers=np.full_like(cover.numbers, np.nan))
    assert np.isnan(broken.bound(cover.lower, cover.upper).lower).any()
    monkeypatch.setattr(import_module("warp_bounding.proof.certify"), "charted", lambda *_: broken)
    assert certify(bounder, grid, seconds=0.2).kind != "proven"


def test_a_search_closes_no_box_whose_bound_is_nan():
    def f(v):
        return np.where(v[:, 0] > 0.9, -1.0, 0.0)

    def bound(low, high):
        center = (low + high) / 2
        least = np.where(high[:, 0] > 0.9, np.nan, 0.0)
        return BoxBounds(least, np.argmax(high - low, axis=1), center, f(center), None)

    fake = SimpleNamespace(reference=f, bound=bound)
    search = minimum(fake, np.zeros((1, 2)), np.ones((1, 2)), eps=0.1, boxes=500)
    assert not search.lower_bound > -1


def test_planes_have_no_bound_where_their_networks_have_none():
    grid = shape("c")
    nothing = SimpleNamespace(level=np.full(8, np.nan), slope=np.zeros((8, 2)), bound=lambda *_: nothing)
    gap = SupportGap(SimpleNamespace(networks=[nothing, nothing], domain=domain_of(grid, "plane")), grid)
    gap.reference = lambda m: np.zeros(len(m))
    assert not (gap.bound(*gap.boxes()).lower > 0).any()


def test_a_search_in_depth_that_is_cut_short_promises_nothing_false():
    grid = shape("c")
    bounder = network_of(domain_of(grid, "box"), "relu", seed=8)
    cover, n = charted(bounder, grid), grid.ndim
    x = next(iter(draw_positives("box", grid, 100_000, 5, "cpu")))
    v = bounder.domain.to_local(x)
    least = float(bounder.reference(v[(v[:, :n] <= v[:, n:]).all(axis=1)]).min())
    whole = charted_minimum(cover, eps=0.02)
    assert whole.lower_bound <= least
    for boxes in (1, 100, 1000, 3000, 10_000, 100_000):
        assert charted_minimum(cover, eps=1e-3, boxes=boxes).lower_bound <= least
        outcome = prove_target(cover, least + 1e-6, boxes=boxes)  # false: there is a positive under it
        assert not outcome.complete
    assert prove_target(cover, whole.lower_bound - 1e-6).complete
    assert not prove_target(replace(cover, numbers=np.full_like(cover.numbers, np.nan)), -1e9, boxes=1000).complete
    broken = charted_minimum(
        replace(cover, numbers=np.full_like(cover.numbers, np.nan)), eps=1e-3, upper=least, boxes=1e5
    )
    assert (broken.lower_bound, broken.complete) == (-np.inf, False)
    many = replace(cover, lower=np.repeat(cover.lower, 10_000, axis=0), upper=np.repeat(cover.upper, 10_000, axis=0))
    assert not prove_target(many, -1e9, boxes=4096).complete  # all that were dealt out are closed, but there are others
    assert prove_target(many, -1e9).boxes == 10_000


def test_boxes_are_halved_within_and_between_cells():
    chart, rng = (
        charted(network_of(domain_of(shape("c"), "box"), "relu", seed=8), shape("c")).chart,
        np.random.default_rng(0),
    )
    a = rng.uniform(-3, 3, 1000)
    b = a + rng.choice([1e-9, 0.3, 1.0, 7.0], 1000)
    middle = chart.middle(a, b)
    assert ((a < middle) & (middle < b)).all()
    edges = np.floor(b - 0.5) + 0.5  # the last edge that is not above b
    spans = (edges > a) & (edges < b)
    assert (middle[spans] % 1 == 0.5).all()
    assert spans.any()
    assert not spans.all()


@pytest.mark.parametrize("seed", range(20))
def test_boxes_that_are_dealt_out_anew_are_the_same(seed):
    rng = np.random.default_rng(seed)
    blocks = int(rng.integers(1, 70))
    heights = np.where(rng.random(blocks) < 0.5, 0, rng.integers(0, STACK + 1, blocks)).astype(np.int32)
    reserve = np.arange(1e6, 1e6 + rng.choice([0, 1, 7, 5000])).reshape(-1, 1, 1)
    stacks = np.arange(blocks * STACK, dtype=np.float64).reshape(blocks, STACK, 1, 1)

    def held() -> np.ndarray:
        return np.concatenate([stack[:height, 0, 0] for stack, height in zip(stacks, heights, strict=True)])

    first = np.minimum(heights, rng.integers(0, STACK, blocks)).astype(np.int32)
    before, waiting = held(), int(first.sum())
    taken = _fill(stacks, heights, first, reserve)
    after = np.concatenate([held(), reserve[: len(reserve) - taken, 0, 0]])
    assert np.array_equal(np.sort(after), np.sort(np.concatenate([before, reserve[:, 0, 0]])))
    assert heights.max() <= STACK
    assert (first <= heights).all()
    assert first.sum() == waiting + taken
    assert heights.any() or not len(before) + len(reserve)
