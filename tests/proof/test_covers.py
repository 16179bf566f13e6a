"""What a proof covers: bounds over parametrizations hold with zero slack, covers hold every positive, and no
positive is denied, at the edges of what devices compute, where bounds are NaN, and where searches are cut short."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bounding_shapes import random_mlp, random_network, random_supports, reader, shape
from rewriting import check_refuted

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.proof import certify, check, minimum, parametrized, prove
from warp_bounding.proof.covers import SupportGap, single_cells
from warp_bounding.proof.search import parametrized_minimum, prove_target
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.shapes import Grid
from warp_bounding.training.samples import samples_of

HIDDEN = (9, 7)  # of every network: each other size costs a compilation
# query, grid, activation
NETWORKS = [(*each, "sin") for each in (("ray", "c"), ("ray", "single"), ("box", "c"))]
NETWORKS += [("ray", "small", "relu"), ("box", "small", "relu")]
SLOW = [pytest.param(query, "small", marks=pytest.mark.slow) for query in ("ray", "box")]
CASES = [("ray", "c"), ("box", "c"), *SLOW]


def grid_of(name: str) -> Grid:
    if name != "small":
        return shape(name)
    occupancy = np.zeros((4, 3, 4), bool)
    occupancy[1, 1, 1] = occupancy[2, 1, 1] = occupancy[2, 2, 3] = occupancy[0, 0, 3] = True
    return Grid(occupancy)


def positives(bounder: Mlp, grid: Grid, count: int, seed: int = 0) -> np.ndarray:
    """Float32 queries that meet the object."""
    return np.concatenate(
        list(draw_positives(bounder.query_kind, grid, count, seed, "cpu", bounder.domain.oracle_length))
    )[:count]


def small_grid(seed: int, *sizes: int) -> Grid:
    """Cells of size 1 in a domain whose map is exact in float64, so that a point of a face is one."""
    occupancy = np.random.default_rng(seed).random(sizes) < 0.3
    occupancy.flat[:2] = True, False
    return Grid(occupancy, cells_per_unit=np.ones(len(sizes)), offset=np.full(len(sizes), 0.5))


def far_grid() -> Grid:
    """An object so far from the origin that the domain's float32 centre is not its middle."""
    return Grid(shape("c").occupancy, cells_per_unit=[7.0, 7.0], offset=[40003.5, 40003.5])


def cropped_grid() -> Grid:
    """The cells of ``c`` without the empty ones around them."""
    whole = shape("c")
    return Grid(
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


def network_of(domain, activation: str, seed: int = 0) -> Mlp:
    return random_mlp(None, HIDDEN, activation, seed, gain=1.5, domain=domain)


@pytest.mark.parametrize(("query", "name", "activation"), NETWORKS)
def test_bounds_hold_as_far_off_as_devices_compute(query, name, activation):
    grid, rng, count = grid_of(name), np.random.default_rng(2), 1000
    bounder = network_of(domain_of(grid, query), activation, seed=3)
    cover, n = parametrized(bounder, grid), grid.ndim
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
        queried = np.ones(count, bool)
        if query == "box":
            queried = (v[:, :n] <= v[:, n:]).all(axis=1)
            queried[queried] = truth(bounder.domain.to_object(v[queried]))
        side = np.sign(bounds.slope) if turn % 2 else rng.choice([-1.0, 1.0], v.shape)
        v = v - side * bounder.domain.delta * (1 - 1e-12)
        if query == "ray":
            queried &= (np.abs(v[:, :n]) <= limit).all(axis=1)
        assert (bounder.reference(v)[queried] >= bounds.lower[queried]).all()
        tried += queried.sum()
    assert tried > 500


@pytest.mark.parametrize("way", ["charted", "single"])
@pytest.mark.parametrize("sizes", [(8, 4), (4, 4, 4)])
def test_every_ray_lies_in_a_box_where_it_first_enters(sizes, way):
    """Multiples of 1/8, so nothing here rounds: rays along faces, through edges and corners, from outside."""
    grid, rng, n = small_grid(len(sizes), *sizes), np.random.default_rng(4), len(sizes)
    bounder = network_of(domain_of(grid, "ray", 64.0), "relu")
    cover = parametrized(bounder, grid)
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
    cover, n, base = parametrized(network_of(domain, "relu"), grid), grid.ndim, domain.base
    x = next(iter(draw_positives("box", grid, 10_000, 5, "cpu")))
    x = np.concatenate([x, reaching_out(domain)])
    assert oracle("box", grid, "cpu", 1.0)(x).all()
    v = (x - np.tile(base.center, 2)) * np.tile(base.scale, 2)
    v = np.clip(v, -np.tile(base.limit, 2), np.tile(base.limit, 2)).astype(np.float64)
    noise = np.tile(cover.numbers[2 * n :], 2)
    assert (v >= cover.coordinates(cover.lower) - noise).all()
    assert (v <= cover.coordinates(cover.upper) + noise).all()


@pytest.mark.parametrize("name", OBJECTS)
def test_a_box_that_reaches_out_of_the_domain_is_not_denied_nor_is_a_threshold_that_denies_it_proven(name):
    domain, grid = OBJECTS[name]()
    bounder, x = reader(domain, 0, "cpu"), reaching_out(domain)  # f = v_0, least at the lowest corner
    prove(bounder, grid, eps=1e-6)
    assert oracle("box", grid, "cpu", 1.0)(x).all()
    assert bounder.query(x).numpy().all()
    bounder.freeze(float(bounder.values(x).numpy()[0]) + 2 * bounder.rounding_bound(), None)
    assert not bounder.query(x).numpy().any()
    assert certify(bounder, grid).kind != "proven"


@pytest.mark.parametrize("query", ["ray", "box"])
def test_certify_closes_no_box_whose_bound_is_nan(query, monkeypatch):
    grid = shape("c")
    bounder = network_of(domain_of(grid, query), "relu").freeze(1e6, None)
    cover = parametrized(bounder, grid)
    broken = replace(cover, numbers=np.full_like(cover.numbers, np.nan))
    assert np.isnan(broken.bound(cover.lower, cover.upper).lower).any()
    monkeypatch.setattr(check, "parametrized", lambda *_: broken)
    assert certify(bounder, grid, budget=0.2).kind != "proven"


def test_planes_have_no_bound_where_their_networks_have_none():
    grid = shape("c")
    nothing = SimpleNamespace(level=np.full(8, np.nan), slope=np.zeros((8, 2)), bound=lambda *_: nothing)
    gap = SupportGap(SimpleNamespace(networks=[nothing, nothing], domain=domain_of(grid, "plane")), grid)
    gap.reference = lambda m: np.zeros(len(m))
    assert not (gap.bound(*gap.boxes()).lower > 0).any()


def test_a_search_in_depth_that_is_cut_short_promises_nothing_false():
    grid = shape("c")
    bounder = network_of(domain_of(grid, "box"), "relu", seed=8)
    cover, n = parametrized(bounder, grid), grid.ndim
    x = next(iter(draw_positives("box", grid, 100_000, 5, "cpu")))
    v = bounder.domain.to_local(x)
    least = float(bounder.reference(v[(v[:, :n] <= v[:, n:]).all(axis=1)]).min())
    whole = parametrized_minimum(cover, eps=0.02)
    assert whole.lower_bound <= least
    for boxes in (1, 100, 1000, 3000, 10_000, 100_000):
        assert parametrized_minimum(cover, eps=1e-3, boxes=boxes).lower_bound <= least
        outcome = prove_target(cover, least + 1e-6, boxes=boxes)  # false: there is a positive under it
        assert not outcome.complete
    assert prove_target(cover, whole.lower_bound - 1e-6).complete
    assert not prove_target(replace(cover, numbers=np.full_like(cover.numbers, np.nan)), -1e9, boxes=1000).complete
    broken = parametrized_minimum(
        replace(cover, numbers=np.full_like(cover.numbers, np.nan)), eps=1e-3, upper=least, boxes=1e5
    )
    assert (broken.lower_bound, broken.complete) == (-np.inf, False)
    many = replace(cover, lower=np.repeat(cover.lower, 10_000, axis=0), upper=np.repeat(cover.upper, 10_000, axis=0))
    assert not prove_target(many, -1e9, boxes=4096).complete  # all that were dealt out are closed, but there are others
    assert prove_target(many, -1e9).boxes == 10_000


# --- searches over parametrizations ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("query", "name"), CASES)
def test_the_minimum_is_proven_certified_and_refuted_where_it_is_raised(query, name):
    grid = grid_of(name)
    bounder = random_network(query, grid, 7, gain=1.5)
    search = prove(bounder, grid, eps=0.02)
    assert search.complete
    assert search.upper_bound - search.lower_bound <= 0.02
    x = positives(bounder, grid, 100_000, 3)
    values = bounder.values(x).numpy().astype(np.float64)
    assert search.lower_bound <= values.min() + bounder.rounding_bound()
    assert search.lower_bound >= values.min() - 0.5  # samples come close
    assert bounder.query(x).numpy().all()
    proof = certify(bounder, grid)
    assert proof.proven
    assert proof.lower_bound >= float(bounder.threshold)
    samples = samples_of(grid, bounder.domain)  # low points become training samples
    states = samples.at(search.numbers)
    assert states.shape[1] >= 0.9 * len(search.numbers)
    assert bounder.reference(samples.coordinates(states).T.double().numpy()).min() <= search.upper_bound + 0.1
    bounder.freeze(float(np.quantile(bounder.reference(bounder.domain.to_local(x)), 0.3)), None)
    check_refuted(bounder, grid)


# --- planes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "activation"), [("c", "relu"), ("blob", "sin"), ("animated", "sin")])
def test_bounds_hold_on_boxes_of_normals_and_what_is_proven_denies_no_plane(name, activation):
    grid, rng = shape(name), np.random.default_rng(1)
    bounder = random_supports(grid, 3, activation)
    gap = SupportGap(bounder, grid)
    lower, upper = gap.boxes()
    pick, part = rng.integers(len(lower), size=300), rng.random((300, 1)) ** 3
    center = lower[pick] + rng.random((300, grid.ndim)) * (upper - lower)[pick]
    low = np.maximum(center - part * (upper - lower)[pick], lower[pick])
    high = np.minimum(center + part * (upper - lower)[pick], upper[pick])
    bounds = gap.bound(low, high)
    for _ in range(60):
        m = low + np.round(rng.random(low.shape) * 2) / 2 * (high - low)
        assert (gap.reference(m) >= bounds.lower).all()
    assert (bounds.value >= bounds.lower).all()
    cut = minimum(gap, lower, upper, eps=0.001, boxes=10)
    search = prove(bounder, grid, eps=0.05)
    assert cut.lower_bound <= search.upper_bound
    assert bounder.query(positives(bounder, grid, 100_000, 2)).numpy().all()
    assert certify(bounder, grid).proven
    check_refuted(bounder.freeze(search.upper_bound + 0.3, None), grid)


@pytest.mark.parametrize(("query", "name"), CASES)
def test_the_hull_of_a_box_holds_its_queries(query, name, rng):
    bounder = random_network(query, grid_of(name))
    cover = parametrized(bounder, grid_of(name))
    row = rng.integers(len(cover.lower), size=300)
    share = np.sort(rng.random((2, 300, cover.lower.shape[1])), axis=0)
    lower, upper = (cover.lower[row] + s * (cover.upper - cover.lower)[row] for s in share)
    low, high = cover.parametrization.hull(lower, upper, cover.numbers)
    for z in lower + rng.random((50, *lower.shape)) * (upper - lower):
        v = cover.coordinates(z)
        assert ((low <= v) & (v <= high)).all()
