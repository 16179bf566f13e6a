"""Rays, planes and boxes asked of shapes placed in the world: no false negative, and what the certificate does not cover is refused."""

import sys
from functools import cache

import numpy as np
import pytest
import warp as wp
from bounding_shapes import shape
from placements import homogeneous, rotation
from region_cases import REGIONS, fitted_region, hard_regions, ray_length

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.base import FAR
from warp_bounding.queries.placement import Placement, placement_error
from warp_bounding.queries.region_domain import domain_of

NAMES = ("c", "blob", "animated")
CLEAR = 1e-9  # cells: far above the float64 rounding of the tests' own maps
QUANTUM = 2.0**-13  # of coordinates in the exact tests: a shift then stays exact


def points_and_directions(query: str, n: int) -> tuple[slice, slice]:
    first, last = slice(0, n), slice(n, 2 * n)
    return (last, first) if query == "plane" else (first, last)


def to_world(grid, query: str, q: np.ndarray, rotated, shift, factors) -> np.ndarray:
    """Rays and planes in the world, float64; boxes have no such map."""
    first, (point, direction) = int(grid.time), points_and_directions(query, grid.ndim)
    world = q.astype(np.float64)
    factors = np.broadcast_to(np.asarray(factors, dtype=np.float64), len(shift))
    turned = 1 / factors if query == "plane" else factors
    world[:, point][:, first:] = (world[:, point][:, first:] * factors) @ rotated.T + shift
    world[:, direction][:, first:] = (world[:, direction][:, first:] * turned) @ rotated.T
    return world


def to_object(grid, query: str, world: np.ndarray, rotated, shift, factors) -> np.ndarray:
    """The inverse, in float64."""
    first, (point, direction) = int(grid.time), points_and_directions(query, grid.ndim)
    q = world.astype(np.float64)
    turned = 1 / np.asarray(factors) if query == "plane" else factors
    q[:, point][:, first:] = (q[:, point][:, first:] - shift) @ rotated / factors
    q[:, direction][:, first:] = q[:, direction][:, first:] @ rotated / turned
    return q


def clear_points(grid, rng, count: int) -> np.ndarray:
    """Points in the object, most of them within a millionth of a cell's faces."""
    cells = grid.occupied[rng.integers(len(grid.occupied), size=count)]
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    near = np.copysign(0.5 - 10.0 ** rng.uniform(-8, -3, cells.shape), offset)
    return grid.position(cells + np.where(rng.random(cells.shape) < 0.8, near, offset))


def certainly_inside(grid, x: np.ndarray) -> np.ndarray:
    t = grid.cell_coordinate(x)
    index = np.clip(np.rint(t), 0, np.array(grid.shape) - 1).astype(int)
    return (np.abs(t - index) < 0.5 - CLEAR).all(axis=1) & grid.occupancy[tuple(index.T)]


def witnessed(grid, query: str, length: float, rotated, shift, factors, rng, dtype, count=3000) -> np.ndarray:
    """Queries in the world, of ``dtype`` and exactly that, which pass through points that are clearly in the object."""
    n, first = grid.ndim, int(grid.time)
    x = clear_points(grid, rng, count)
    d = rng.normal(size=x.shape) * np.where(rng.random(x.shape) < 0.2, 1e-4, 1.0)
    d = np.where((rng.random(count) < 0.2)[:, None], np.eye(n)[rng.integers(n, size=count)], d)
    if query == "box":
        y = x.copy()
        y[:, first:] = (x[:, first:] * factors) @ rotated.T + shift
        reach = rng.random((2, *y.shape)) * rng.choice([0.0, 1e-5, 0.1, 10.0, 1e4, 1e7], size=(2, count, n))
        world = np.concatenate([y - reach[0], y + reach[1]], axis=1).astype(dtype)
        y = np.clip(y, world[:, :n], world[:, n:])  # of the rounded box, the point nearest to y
        x = y.astype(np.float64)
        x[:, first:] = (y[:, first:] - shift) @ rotated / factors
        return world[certainly_inside(grid, x)]
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    if query == "plane":
        along = rng.normal(size=x.shape)
        along -= unit * (along * unit).sum(axis=1, keepdims=True)
        q = np.concatenate([unit, x + along * rng.choice([0.0, 0.5, 5.0, 50.0, 1e6], size=(count, 1))], axis=1)
    else:
        t = length * rng.choice([0.0, 1e-6, 0.3, 1 - 1e-6, 1.0], size=(count, 1))
        q = np.concatenate([x - t * unit, unit], axis=1)
    world = to_world(grid, query, q, rotated, shift, factors)
    _, direction = points_and_directions(query, n)
    world[:, direction] *= 10.0 ** rng.uniform(-6, 6, (count, 1))
    world = world.astype(dtype)
    q = to_object(grid, query, world, rotated, shift, factors)  # 1e-13 off
    a, b = q[:, :n], q[:, n:]
    if query == "plane":
        x = x - a * (((x - b) * a).sum(axis=1, keepdims=True) / (a * a).sum(axis=1, keepdims=True))
    else:
        unit = b / np.linalg.norm(b, axis=1, keepdims=True)
        x = a + unit * np.clip(((x - a) * unit).sum(axis=1, keepdims=True), 0, length * (1 - 1e-12))
    return world[certainly_inside(grid, x)]


@cache
def bounders(name: str, query: str, length: float):
    grid = shape(name)
    methods = ("aabb", "kdop", "sphere") if name == "blob" else ("kdop",)
    return [fitted_region(method, query, grid, length=length) for method in methods]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", REGIONS)
def test_placed_regions_are_never_denied(query, name, dtype, device, rng):
    grid, s = shape(name), shape(name).ndim - shape(name).time
    for length in (ray_length(grid), 30.0) if query == "ray" else (1.0,):  # long: from outside, and far outside
        for factors in (1.0, 0.1, 10.0, rng.uniform(0.5, 2, s)):
            rotated, shift = rotation(s, rng), rng.uniform(-10, 10, s)
            world = witnessed(grid, query, length, rotated, shift, factors, rng, dtype)
            assert len(world) > 1000
            for bounder in bounders(name, query, length):
                values = bounder.to(device).values(world, xform=homogeneous(rotated, shift), scale=factors).numpy()
                assert (values >= bounder.threshold).all(), (bounder, world[values < bounder.threshold][:3])


def signed_permutation(s: int, rng) -> np.ndarray:
    return np.eye(s)[rng.permutation(s)] * rng.choice([-1.0, 1.0], size=s)


@cache
def dyadic(time: bool) -> IndicatorGrid:
    """Its faces are float32 numbers, and still are after a shift."""
    occupancy = np.random.default_rng(7).random((5, 9, 9, 5) if time else (9, 9, 5)) < 0.1
    occupancy.flat[:2] = True, False
    return IndicatorGrid(occupancy, time=time)


@cache
def dyadic_bounders(time: bool, query: str):
    methods = ("kdop",) if time else ("aabb", "kdop", "sphere")
    return [fitted_region(method, query, dyadic(time)) for method in methods]


@pytest.mark.parametrize("time", [False, True])
@pytest.mark.parametrize("query", REGIONS)
def test_exact_placements_of_touching_regions(query, time, device, rng):
    """Right angles, powers of two and dyadic shifts round nothing, so the oracle knows the truth about the world."""
    grid, s = dyadic(time), dyadic(time).ndim - time
    n, first, length = grid.ndim, int(time), ray_length(grid)
    q = np.concatenate([hard_regions(query, grid, rng, length), sample(query, grid, 4000, rng)])
    snapped = slice(0, 2 * n) if query == "box" else points_and_directions(query, n)[0]
    q = q[(np.abs(q[:, snapped]) < 16).all(axis=1)]
    q[:, snapped] = np.rint(q[:, snapped] / QUANTUM) * QUANTUM
    truth = oracle(query, grid, "cpu", length)(q)
    assert truth.mean() > 0.2
    for _ in range(3):
        rotated, factors = signed_permutation(s, rng), 2.0 ** rng.integers(-2, 3, size=s)
        shift = rng.integers(-64, 64, size=s) / 16.0
        if query == "box":
            ends = [
                np.concatenate([q[:, k : k + first], (q[:, k + first : k + n] * factors) @ rotated.T + shift], 1)
                for k in (0, n)
            ]
            world = np.concatenate([np.minimum(*ends), np.maximum(*ends)], axis=1)
        else:
            world = to_world(grid, query, q, rotated, shift, factors)
        single = world.astype(np.float32)
        exact = (single == world).all(axis=1)  # all but some subnormal entries of directions
        assert exact.mean() > 0.9
        xform = homogeneous(rotated, shift)
        for bounder in (b.to(device) for b in dyadic_bounders(time, query)):
            placed = bounder.values(single, xform=xform, scale=factors).numpy() >= bounder.threshold
            plain = bounder.values(q).numpy() >= bounder.threshold
            missed = truth & ~placed & exact
            assert not missed.any(), single[missed][:3]
            assert (placed != plain).mean() < 0.02  # nor is it looser: regions that graze the volume
            idx, count = bounder.candidates(single[:1000], xform=xform, scale=factors)
            assert (
                idx.numpy()[: count.numpy()[0]]
                == np.flatnonzero(bounder.query(single[:1000], xform=xform, scale=factors).numpy())
            ).all()


def random_network(grid, query: str, length: float, seed: int = 0) -> Mlp:
    """Random weights; not proven."""
    rng, domain = np.random.default_rng(seed), domain_of(grid, query, length)
    k, outputs = (grid.ndim, 2) if query == "plane" else (domain.ndim, 1)
    tensors = {}
    for index, (inputs, width) in enumerate(((k, 8), (8, outputs))):
        tensors[f"layers.{index}.weight"] = (rng.normal(size=(width, inputs)) * 2 / np.sqrt(inputs)).astype(np.float32)
        tensors[f"layers.{index}.bias"] = rng.normal(size=width).astype(np.float32)
    return Mlp(domain, tensors, {"hidden": [8], "activation": "sin", "octaves": 0}, "cpu")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", REGIONS)
def test_kernel_moves_as_the_twin_does(query, name, device, rng):
    """A network's f of moved regions is that of the exactly moved ones, within E and what delta makes of it."""
    grid, length = shape(name), 0.7
    s, n = grid.ndim - grid.time, grid.ndim
    bounder = random_network(grid, query, length).to(device)
    slope = np.abs(bounder.tensors["layers.1.weight"]).astype(np.float64) @ np.abs(bounder.tensors["layers.0.weight"])
    slope = float(slope.sum(axis=1).max()) + (query == "plane")
    for _ in range(3):
        rotated, shift, factors = rotation(s, rng), rng.uniform(-3, 3, s), rng.uniform(0.3, 3, s)
        q = sample(query, grid, 4000, rng).astype(np.float64)
        if query == "box":
            rotated = signed_permutation(s, rng)
            ends = [
                np.concatenate([q[:, k : k + n - s], (q[:, k + n - s : k + n] * factors) @ rotated.T + shift], 1)
                for k in (0, n)
            ]
            world = np.concatenate([np.minimum(*ends), np.maximum(*ends)], axis=1).astype(np.float32)
            ends = [
                np.concatenate([world[:, k : k + n - s], (world[:, k + n - s : k + n] - shift) @ rotated / factors], 1)
                for k in (0, n)
            ]
            q = np.concatenate([np.minimum(*ends), np.maximum(*ends)], axis=1)
        else:
            world = to_world(grid, query, q, rotated, shift, factors).astype(np.float32)
            q = to_object(grid, query, world, rotated, shift, factors)
        v, f = (
            bounder.domain.to_local(q),
            bounder.values(world, xform=homogeneous(rotated, shift), scale=factors).numpy(),
        )
        usual = np.isfinite(f) & (np.abs(v) <= bounder.domain.limit).all(axis=1)
        if query == "plane":  # the largest entry may be another one after rounding
            usual &= np.sort(np.abs(v[:, :n]), axis=1)[:, -2] < 1 - 1e-4
        assert usual.mean() > 0.7
        away = np.abs(f[usual] - bounder.reference(v[usual]))
        assert (away <= bounder.rounding_bound() + slope * bounder.domain.base.delta.max()).all()


@pytest.mark.parametrize("query", REGIONS)
def test_unplaced_and_placed_at_home_agree(query, rng):
    grid = shape("blob")
    bounder, q = random_network(grid, query, 1.0), sample(query, grid, 2000, rng)
    plain, placed = (bounder.values(q, scale=scale).numpy() for scale in (None, 1.0))
    both = np.isfinite(plain) & np.isfinite(placed)
    assert (np.isfinite(plain) != np.isfinite(placed)).mean() < 0.01
    assert np.abs(plain - placed)[both].max() < 1e-4


@pytest.mark.parametrize("query", REGIONS)
def test_length_stays_in_object_units(query):
    """A ray that just reaches a shape of ten times the size is ten times as long in the world."""
    grid = shape("half")  # a slab: x <= 0.5
    bounder = fitted_region("aabb", query, grid, length=0.5)
    world = {
        "ray": [[9.9, 5, 5, -1, 0, 0], [10.1, 5, 5, -1, 0, 0]],
        "plane": [[-1, 0, 0, 4.9, 5, 5], [-1, 0, 0, 5.1, 5, 5]],
        "box": [[4.9, 0, 0, 6, 1, 1], [5.1, 0, 0, 6, 1, 1]],
    }[query]
    assert bounder.values(np.float32(world), scale=10.0).numpy().tolist()[0] >= bounder.threshold
    assert bounder.values(np.float32(world), scale=10.0).numpy().tolist()[1] < bounder.threshold
    moved = np.float32(world)
    moved[:, 3 if query == "plane" else 0] += 64
    if query == "box":
        moved[:, 3] += 64
    answers = bounder.values(moved, xform=wp.transform((64.0, 0.0, 0.0), wp.quat_identity()), scale=10.0).numpy()
    assert (answers >= bounder.threshold).tolist() == [True, False]


TURNED = wp.transform((1.0, 2.0, 3.0), wp.quat(0.5, 0.5, 0.5, 0.5))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("query", REGIONS)
def test_placed_special_numbers(query, scale):
    """Maybe, whatever else: not finite, no direction, upside down, so large that the map overflows."""
    bounder = fitted_region("aabb", query, shape("blob"))
    usual = [9.0, 9, 9, 9.5, 9.5, 9.5]
    strange = [[*usual[:k], bad, *usual[k + 1 :]] for k in range(6) for bad in (np.nan, np.inf, -np.inf)]
    if query == "box":
        strange += [[9, 9, 9, 9, 9, 8], [1, 0, 0, -1, 1, 1], [-3e38, -3e38, -3e38, 3e38, 3e38, 3e38]]
    else:
        shortest = [0.0] * 3, [1e-45, 0, 0], [1e-30, -1e-30, 0]
        strange += [[*d, 9, 9, 9] if query == "plane" else [9, 9, 9, *d] for d in shortest]
        strange += [[3e38] * 6, [-3e38, 3e38, 1, 3e38, -3e38, 1]]
    assert (bounder.values(np.float32(strange), xform=TURNED, scale=scale).numpy() >= bounder.threshold).all()
    assert bounder.query(np.float32(strange), xform=TURNED, scale=scale).numpy().all()


@pytest.mark.parametrize("query", REGIONS)
def test_far_outside_is_no(query):
    bounder = fitted_region("aabb", query, shape("blob"))
    world = np.float32(
        [[0, 0, 1, 0, 0, 900], [0, 0, 1, 0, 0, 90]] if query == "plane" else [[90, 90, 90, 91, 91, 91]] * 2
    )
    answers = bounder.values(world, xform=TURNED, scale=2.0).numpy() >= bounder.threshold
    assert not answers.any()


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("cells", [(32, 32), (32, 32, 32), (8, 24, 24, 24)])
def test_ordinary_placements_are_not_refused(query, cells, rng):
    occupancy = np.zeros(cells, dtype=bool)
    occupancy.flat[::3] = True
    grid = IndicatorGrid(occupancy, time=len(cells) == 4)
    s, domain = grid.ndim - grid.time, domain_of(grid, query)
    for factors in (0.1, 1.0, 10.0, *rng.uniform(0.5, 2, (5, s))):
        xform = homogeneous(rotation(s, rng), rng.uniform(-10, 10, s))
        for double in (False, True):
            Placement.of(domain, xform, factors).check(domain, double=double)


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize(
    ("options", "dtype"),
    [
        ({"xform": [1e6, 0, 0, 0, 0, 0, 1]}, np.float64),
        ({"xform": [0.1 + 1e6, 0, 0, 0, 0, 0, 1]}, np.float32),
        ({"scale": 1e37}, np.float32),
        ({"xform": [1e30, 0, 0, 0, 0, 0, 1]}, np.float64),
    ],
    ids=str,
)
def test_placements_beyond_the_certificate_are_refused(query, options, dtype):
    bounder = random_network(shape("blob"), query, 1.0)
    with pytest.raises(QueryError, match=f"move a {query} by a rounding error .* certificate covers"):
        bounder.query(np.zeros((1, 6), dtype), **options)
    with pytest.raises(QueryError):
        bounder.candidates(np.zeros((1, 6), dtype), **options)


@pytest.mark.parametrize("query", REGIONS)
def test_impossible_placements_are_refused(query):
    bounder = random_network(shape("blob"), query, 1.0)
    for options in ({"scale": 0.0}, {"xform": np.eye(3)}, {"xform": 2 * np.eye(4)}, {"scale": [1e-9, 1.0, 1.0]}):
        with pytest.raises(QueryError):
            bounder.query(np.zeros((1, 6)), **options)


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS")
@pytest.mark.parametrize("query", REGIONS)
def test_kernels_compile_for_cuda(query, tmp_path):
    kernel = batch_kernel(random_network(shape("blob"), query, 1.0).source, True, False)
    wp.compile_aot_module(kernel.module, device=None, arch=86, module_dir=tmp_path)
    assert [*tmp_path.rglob("*.ptx"), *tmp_path.rglob("*.cubin")]


def in_single(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``x matrix^T`` as float32 products and sums, float64."""
    products = x.astype(np.float32)[:, None] * matrix.astype(np.float32)
    total = products[..., 0]
    for k in range(1, products.shape[2]):
        total = total + products[..., k]
    return total.astype(np.float64)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", ["ray", "plane"])
def test_rounding_stays_within_its_bound(query, name, dtype, rng):
    """The moved float32 numbers, and how far the exact region of those passes a point of the exact region, near and far."""
    grid, length = shape(name), 3.0
    n, s, domain = grid.ndim, grid.ndim - grid.time, domain_of(grid, query, length)
    scale, center = domain.base.scale.astype(np.float64), domain.base.center.astype(np.float64)
    point, direction = points_and_directions(query, n)
    near_share = 0.0
    for factors in (1.0, 0.1, 10.0, *rng.uniform(0.3, 3, (8, s))):
        rotated, shift = rotation(s, rng), rng.uniform(-10, 10, s)
        placement = Placement.of(domain, homogeneous(rotated, shift), factors)
        bound = placement_error(domain, placement.world, double=dtype is np.float64)
        matrix, drift = placement.values[n : n + n * n].reshape(n, n), placement.values[n + n * n : 2 * n + n * n]
        x = domain.base.to_object(rng.uniform(-0.9, 0.9, (4000, n)))
        unit = rng.normal(size=x.shape)
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        away = rng.normal(size=x.shape)
        away -= unit * (away * unit).sum(axis=1, keepdims=True)
        away *= rng.choice([0.0, 1.0, 1e3, 1e5], size=(4000, 1))
        q = np.concatenate(
            [unit, x + away] if query == "plane" else [x - rng.random((4000, 1)) * length * unit, unit], 1
        )
        world = to_world(grid, query, q, rotated, shift, factors).astype(dtype)
        q = to_object(grid, query, world, rotated, shift, factors)
        single = world.astype(np.float32)
        turn = matrix if query == "ray" else placement.values[2 * n + n * n :].reshape(n, n)
        moved, turned = (
            in_single(matrix, single[:, point] - placement.values[:n]),
            in_single(turn, single[:, direction]),
        )
        far = np.abs((q[:, point] - center) * scale).sum(axis=1)[:, None]
        d = q[:, direction] / np.linalg.norm(q[:, direction], axis=1, keepdims=True)
        if query == "ray":
            t = np.clip(((x - q[:, point]) * d).sum(axis=1, keepdims=True), 0, length)
            off = q[:, point] + t * d - (moved + t * turned / np.linalg.norm(turned, axis=1, keepdims=True))
            off = np.abs(off) * scale
        else:
            x = x - d * ((x - q[:, point]) * d).sum(axis=1, keepdims=True)
            normal = turned / scale
            off = np.abs((normal * ((x - moved) * scale)).sum(axis=1)) / np.abs(normal).max(axis=1)
            off = off[:, None]
        host = 1e-13 * (1 + far)  # what this test's own float64 rounds
        allowed = bound + np.where(far > FAR, far * drift, 0.0) + host
        assert (off <= allowed).all()
        near_share = max(near_share, float((off / allowed)[far[:, 0] <= FAR].max()))
    assert near_share > 0.05  # and the bound is worth something
