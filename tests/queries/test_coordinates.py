"""From a region's numbers to coordinates: within the bound of the proofs, with zero slack; what is maybe."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from asking import ask, run_text
from bounding_shapes import shape
from region_cases import REGIONS, fitted_region, hard_regions, ray_length

from warp_bounding.bounders import Cascade
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import TOOLS
from warp_bounding.queries import locate
from warp_bounding.queries.base import FAR
from warp_bounding.queries.region_domain import RegionDomain, domain_of
from warp_bounding.shapes import Grid

NAMES = ("c", "blob", "anisotropic", "mesh", "animated", pytest.param("five", marks=pytest.mark.slow))
COUNT = 4000
LANES = 8
EXACT = np.longdouble  # 64 bits of mantissa on x86; elsewhere it may be float64, which is far finer than float32 too


class Located(NamedTuple):
    """``v`` ``(N, ndim)`` float64, and the two answers that the text gives."""

    v: np.ndarray
    testable: np.ndarray
    inside: np.ndarray


def _text(query: str, n: int, time: bool, coordinates: int, lanes: bool) -> str:
    """The text that maps queries, one at a time or a vector of them, and what writes ``v`` and both answers."""
    vector = f"constexpr int L = {LANES}; typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));"
    vector += " typedef int Mask __attribute__((vector_size(4 * L)));"
    kind, zero, at = (
        (vector, "{}", "[l]") if lanes else ("constexpr int L = 1; typedef float V; typedef int Mask;", "0.0f", "")
    )
    return f"""
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
const float* center = numbers.data; const float* scale = center + {n}; const float* limit = center + {2 * n};
const float* extra = center + {3 * n};
{kind}
const int first = block * L, count = x.shape[0] / {2 * n};
{TOOLS}
const V zero = {zero};
V q[{2 * n}], v[{coordinates}];
for (int l = 0; l < L; ++l) for (int k = 0; k < {2 * n}; ++k) {{
    const int j = first + l < count ? first + l : count - 1; q[k]{at} = x.data[(long long)j * {2 * n} + k];
}}
{locate(query, n, time)}
for (int l = 0; l < L && first + l < count; ++l) {{
    float* to = out.data + (long long)(first + l) * {coordinates + 2};
    for (int k = 0; k < {coordinates}; ++k) to[k] = v[k]{at};
    to[{coordinates}] = testable{at} != 0; to[{coordinates + 1}] = inside{at} != 0;
}}
"""


def located(domain: RegionDomain, q: np.ndarray, device: str = "cpu", lanes: bool = True) -> Located:
    """What a device makes of queries ``(N, 2 n)``: a vector of them at a time, or one (all that CUDA does)."""
    lanes = lanes and device == "cpu"
    with np.errstate(over="ignore"):
        flat = np.asarray(q, dtype=np.float32)
    n, width = domain.space_ndim, domain.ndim + 2
    name = f"wb_test_locate_{domain.query}_geometric_{n}d_{domain.time:d}_{lanes:d}"
    text, count = _text(domain.query, n, domain.time, domain.ndim, lanes), -(-len(q) // LANES) if lanes else len(q)
    numbers = np.concatenate([domain.header, domain.extra, [0.0]])
    found = run_text(name, text, count, flat, numbers, (len(q), width), device)
    return Located(found[:, :-2].astype(np.float64), *(found[:, -2:].T == 1))


def to_local(domain: RegionDomain, x: np.ndarray) -> np.ndarray:
    """Local coordinates, as nearly exact as NumPy can."""
    return (x.astype(EXACT) - domain.center.astype(EXACT)) * domain.scale.astype(EXACT)


def corners(domain: RegionDomain) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the domain in local space."""
    return to_local(domain, domain.lower), to_local(domain, domain.upper)


def ray_points(domain: RegionDomain, q: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points of rays inside the domain: ends, entries, exits, or between: ``y (N, n)``, and who has one."""
    n = domain.space_ndim
    low, high = corners(domain)
    origin, d = to_local(domain, q[:, :n]), q[:, n:].astype(EXACT)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        d = d / np.abs(d).max(axis=1, keepdims=True)
        w = d / np.sqrt((d * d).sum(axis=1, keepdims=True)) * domain.scale.astype(EXACT) * EXACT(domain.length)
        near, far = (low - origin) / w, (high - origin) / w
        near, far = np.minimum(near, far), np.maximum(near, far)
    parallel, within = w == 0, (origin >= low) & (origin <= high)
    near = np.where(parallel, np.where(within, 0, 2), near)
    far = np.where(parallel, np.where(within, 1, -1), far)
    enter, leave = np.maximum(near.max(axis=1), 0), np.minimum(far.min(axis=1), 1)
    share = rng.choice([0.0, 1.0, 0.5, -1.0], size=len(q))
    share = np.where(share < 0, rng.random(len(q)), share)
    t = enter + share * (leave - enter)
    return origin + t[:, None] * w, enter <= leave


def ray_distance(v: np.ndarray, y: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """``(N,)``: least distance of segments ``v`` from points y, the largest over the axes; from above."""
    n = y.shape[1]
    a, w = v[:, :n].astype(EXACT), v[:, n:].astype(EXACT)
    best = np.full(len(v), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = w / unit
        along = ((y - a) / unit * scaled).sum(axis=1) / (scaled * scaled).sum(axis=1)
        tries = [along, np.zeros(len(v)), np.ones(len(v)), *((y - a) / w).T]
    for t in tries:
        t = np.clip(np.nan_to_num(t), 0, 1)[:, None]
        best = np.minimum(best, (np.abs(a + t * w - y) / unit).max(axis=1))
    return best.astype(np.float64)


def plane_points(domain: RegionDomain, q: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points of planes inside the domain, mostly on its faces, edges and corners, and which planes have one."""
    n = domain.space_ndim
    low, high = corners(domain)
    normal, point = q[:, :n].astype(EXACT), to_local(domain, q[:, n:])
    with np.errstate(divide="ignore", invalid="ignore"):
        m = normal / domain.scale.astype(EXACT)
        m = m / np.abs(m).max(axis=1, keepdims=True)
    share = rng.choice([0.0, 1.0, -1.0], size=point.shape)
    share = np.where(share < 0, rng.random(point.shape), share)
    y, row = low + share * (high - low), np.arange(len(q))
    pivot = np.abs(m).argmax(axis=1)
    y[row, pivot] += ((point - y) * m).sum(axis=1) / m[row, pivot]
    good = (y[row, pivot] >= low[pivot]) & (y[row, pivot] <= high[pivot])
    return y, good & np.isfinite(m).all(axis=1)


def wide_regions(query: str, grid, length: float, count: int, rng: np.random.Generator, dtype) -> np.ndarray:
    """Through points of the domain and of its border; skewed by up to 12 decades, of any size, near and far."""
    n, size = grid.ndim, grid.upper - grid.lower
    x = grid.lower + rng.random((count, n)) * size
    border = np.where(rng.random(x.shape) < 0.5, grid.lower, grid.upper)
    x = np.where(rng.random(x.shape) < 0.3, border, x)
    if query == "box":
        reach = size * 10.0 ** rng.uniform(-9, 3, (2, count, n)) * rng.choice([0.0, 1.0], size=(2, count, n))
        return np.concatenate([x - reach[0], x + reach[1]], axis=1).astype(dtype)
    d = rng.normal(size=(count, n)) * 10.0 ** rng.uniform(-12, 0, (count, n))
    d *= rng.choice([0.0, 1.0], p=[0.1, 0.9], size=(count, n))
    d[np.abs(d).max(axis=1) == 0, 0] = 1
    if query == "ray":
        d *= size
        unit = d / np.linalg.norm(d, axis=1, keepdims=True)
        origin = x - length * rng.choice([0.0, 1e-4, 0.5, 1 - 1e-7, 1.0], size=(count, 1)) * unit
        return np.concatenate([origin, d * 10.0 ** rng.uniform(-20, 20, (count, 1))], axis=1).astype(dtype)
    normal = d / size
    along = rng.normal(size=x.shape) * size
    along -= normal * ((along * normal).sum(axis=1) / (normal * normal).sum(axis=1))[:, None]
    away = along * rng.choice([0.0, 0.5, 2.0, 1e2, 1e5], size=(count, 1))
    return np.concatenate([normal * 10.0 ** rng.uniform(-20, 20, (count, 1)), x + away], axis=1).astype(dtype)


def test_unit_vectors_stay_within_the_limit(device, rng):
    """One entry is nearly the length, so rounding may take it beyond 1; the sum of squares grows with n."""
    n = 9
    grid = Grid(np.arange(2**n).reshape((2,) * n) == 0)
    domain = domain_of(grid, "ray")
    d = rng.normal(size=(COUNT, n)) * 10.0 ** rng.uniform(-9, 0, (COUNT, 1))
    d[np.arange(COUNT), rng.integers(n, size=COUNT)] = rng.normal(size=COUNT)
    x = np.full((COUNT, n), 0.5)
    q = np.concatenate([x, d], axis=1).astype(np.float32)
    v, testable, inside = located(domain, q, device, False)
    assert (testable & inside).all()
    assert (np.abs(v) <= domain.limit).all()


def regions(query: str, grid, length: float, rng, dtype) -> np.ndarray:
    hard = hard_regions(query, grid, rng, length, COUNT).astype(dtype)
    return np.concatenate([hard, wide_regions(query, grid, length, 2 * COUNT, rng, dtype)])


def check_passes(domain: RegionDomain, q: np.ndarray, rng, device: str, lanes: bool) -> float:
    """It passes each point of the region in the domain, within the bound; returns the share that is asked about."""
    n, needed = domain.space_ndim, domain.kind.rounding(domain.base, domain.length)
    assert (needed <= domain.base.delta).all()
    v, testable, inside = located(domain, q, device, lanes)
    queried = testable & inside
    assert (np.abs(v[queried]) <= domain.limit).all()
    if domain.query == "box":
        low, high = corners(domain)
        first, last = to_local(domain, q[:, :n]), to_local(domain, q[:, n:])
        good = ((first <= last) & (first <= high) & (last >= low)).all(axis=1)
        first, last = np.maximum(first, low), np.minimum(last, high)  # the part inside
        off = np.maximum(v[:, :n] - first, last - v[:, n:])
    elif domain.query == "ray":
        y, good = ray_points(domain, q, rng)
        off = ray_distance(v, y, needed)[:, None] * needed
    else:
        y, good = plane_points(domain, q, rng)
        off = np.abs((v[:, :n].astype(EXACT) * y).sum(axis=1) - v[:, n])[:, None]
        assert (v[queried, :n].max(axis=1) == 1).all()  # exactly, which the proof over a cube's faces takes for granted
    assert good.mean() > 0.3
    assert inside[good & testable].all()
    assert (off[good & queried] <= needed).all()
    return float(queried.mean())


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", REGIONS)
def test_the_computed_region_passes_every_point_of_the_exact_one(query, name, dtype, device, rng):
    grid = shape(name)
    domain = domain_of(grid, query, ray_length(grid))
    q = regions(query, grid, ray_length(grid), rng, dtype)
    for lanes in (True, False):
        assert check_passes(domain, q, rng, device, lanes) > 0.3


@pytest.mark.parametrize("exponent", [-50, 20, 50])
@pytest.mark.parametrize("query", REGIONS)
def test_tiny_and_huge_objects(query, exponent, device, rng):
    """Normals of 1e-41 have few bits left in float32; where the domain is huge, its size would hide that."""
    occupancy = np.zeros((8, 6, 5), bool)
    occupancy[3:5, 3:5, 2:4] = True
    grid = Grid(occupancy, cells_per_unit=[2.0**-exponent] * 3, offset=[0.0] * 3)
    domain = domain_of(grid, query, 4 * 2.0**exponent)
    q = wide_regions(query, grid, 4 * 2.0**exponent, 3 * COUNT, rng, np.float64)
    if query != "box":
        turn = slice(0, 3) if query == "plane" else slice(3, 6)
        size = np.abs(q[:, turn]).max(axis=1, keepdims=True)
        q[:, turn] *= 10.0 ** rng.uniform(-44, -20, size.shape) / size
    for lanes in (True, False):
        check_passes(domain, q, rng, device, lanes)


# --- answers ---------------------------------------------------------------------------------------------------------


@cache
def bounders(name: str, query: str):
    """A cascade, whose kernels gather queries first; in 3D also a volume, whose kernel works on all."""
    grid = shape(name)
    volume = fitted_region("aabb", query, grid)
    first = Cascade.of([volume, fitted_region("bvh", query, grid)])
    return [first, *([volume] if name == "blob" else [])]


def outside(query: str, grid) -> np.ndarray:
    """``(2 n,)`` float32, a region in the range of time and far from the domain; not so far that one does not look."""
    n, size = grid.ndim, grid.upper - grid.lower
    far = grid.upper + size
    if grid.time:
        far[0] = (grid.lower + grid.upper)[0] / 2
    slanted = np.where(np.arange(n) < n - 1, 1e-3, 1.0)
    q = {"box": [far, far + 0 * size], "ray": [far, slanted], "plane": [slanted / size[-1], far]}[query]
    return np.concatenate(q).astype(np.float32)


def strange(query: str, grid) -> np.ndarray:
    """``(S, 2 n)`` float32: maybe, though nothing else about them is near the object."""
    n, usual, rows = grid.ndim, outside(query, grid), []
    for k in range(2 * n):
        for bad in (np.nan, np.inf, -np.inf):
            rows.append(usual.copy())
            rows[-1][k] = bad
    if query == "box":
        for k in range(n):
            rows.append(usual.copy())
            rows[-1][k] = np.nextafter(usual[n + k], np.float32(np.inf))
        rows.append(np.concatenate([np.full(n, 3e38), np.full(n, -3e38)]))
    else:
        turn = slice(0, n) if query == "plane" else slice(n, 2 * n)
        for size in (0.0, -0.0, 1e-45, 1e-38, 3e38):
            rows.append(usual.copy())
            rows[-1][turn] = size
        huge = usual.copy()
        huge[slice(n, 2 * n) if query == "plane" else slice(0, n)] = 3e38
        rows.append(huge)
    return np.float32(rows)


@pytest.mark.parametrize("name", ["blob", "animated"])
@pytest.mark.parametrize("query", REGIONS)
def test_strange_numbers_are_maybe_and_stay_in_their_lane(query, name, device):
    grid = shape(name)
    usual = outside(query, grid)
    cases = strange(query, grid)
    for bounder in (b.to(device) for b in bounders(name, query)):
        assert not bounder.query(np.tile(usual, (600, 1))).numpy().any()
        assert bounder.query(cases).numpy().all()
        assert (bounder.values(cases).numpy() == np.inf).all()
        assert ask(bounder, cases).all()
        width = 33  # more than all lanes: one strange query among ordinary ones, in every place
        block = np.tile(usual, (len(cases), width, 1))
        for place in range(width):
            mixed = block.copy()
            mixed[:, place] = cases
            answers = bounder.query(mixed.reshape(-1, len(usual))).numpy().reshape(len(cases), width)
            assert (answers == (np.arange(width) == place)).all()


@pytest.mark.parametrize("name", ["blob", "animated"])
@pytest.mark.parametrize("query", REGIONS)
def test_every_count_and_the_function(query, name, device, rng):
    """Whole blocks, parts of them and none; the function answers as the batch does, but for rounding."""
    grid = shape(name)
    q = regions(query, grid, ray_length(grid), rng, np.float32)[rng.permutation(3 * COUNT)[:1100]]
    q[rng.permutation(1100)[:100]] = strange(query, grid)[rng.integers(len(strange(query, grid)), size=100)]
    for bounder in (b.to(device) for b in bounders(name, query)):
        answers, values = bounder.query(q).numpy(), bounder.values(q).numpy()
        assert (answers == ~(values < bounder.threshold)).all()
        for count in (0, 1, 15, 17, 511, 513, 1025):
            assert (bounder.query(q[:count]).numpy() == answers[:count]).all()
            assert (bounder.values(q[:count]).numpy() == values[:count]).all()
            idx, found = bounder.candidates(q[:count])
            assert (idx.numpy()[: found.numpy()[0]] == np.flatnonzero(answers[:count])).all()
        same = ask(bounder, q) == answers
        assert same[values == np.inf].all()
        assert same.mean() > 0.9  # many of them graze the volume or the domain
        if bounder.method == "mlp":
            clear = (np.abs(values - bounder.threshold) > 1e-3) & np.isfinite(values)
            assert clear.mean() > 0.2
            assert same[clear].all()


# --- time ------------------------------------------------------------------------------------------------------------


def test_rays_through_time(device, rng):
    """Maybe, if all of a ray lies before the beginning or after the end; else by its part inside."""
    grid = shape("animated")
    for length in (0.5, 3.0, 30.0):
        domain = domain_of(grid, "ray", length)
        q = wide_regions("ray", grid, length, 3 * COUNT, rng, np.float32)
        q[:, 0] = rng.uniform(-4, 6, len(q)) * rng.choice([1.0, length], size=len(q))
        d = q[:, 4:].astype(EXACT)
        d = d / np.abs(d).max(axis=1, keepdims=True)
        begin = q[:, 0].astype(EXACT)
        end = begin + d[:, 0] / np.sqrt((d * d).sum(axis=1)) * EXACT(length)
        off = (np.maximum(begin, end) < grid.lower[0]) | (np.minimum(begin, end) > grid.upper[0])
        assert off.mean() > 0.1
        assert not located(domain, q, device).testable[off].any()


def test_a_plane_that_leans_in_time_is_answered_by_its_part_inside(device):
    grid = shape("animated")
    domain = domain_of(grid, "plane")
    leaning = np.float32([[1.0, 1e-3, 0, 0, 4.0, 0.5, 0.5, 0.5], [1.0, 0, 0, 0, 4.0, 0.5, 0.5, 0.5]])
    assert located(domain, leaning, device).testable.tolist() == [True, False]
    assert not located(domain, leaning, device).inside[0]


# --- domains ---------------------------------------------------------------------------------------------------------


def test_rays_that_are_too_long_are_refused():
    for length in (1e4, 1e9, 1e300):
        with pytest.raises(BounderError, match="length"):
            domain_of(shape("blob"), "ray", length)


def test_a_region_from_too_far_away_is_maybe_unless_it_misses_the_domain(device):
    grid = shape("blob")
    towards, past = [0.5 - 100, 0.5, 0.5, 1, 0, 0], [0.5 - 100, 1.5, 0.5, 1, 0, 0]
    domain = domain_of(grid, "ray", 200.0)
    _, testable, inside = located(domain, np.float32([towards, past]), device)
    assert testable.tolist() == [False, True]
    assert inside.tolist() == [True, False]
    assert FAR < 100
