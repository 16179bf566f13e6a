"""Rays, planes and boxes against the volumes: no false negative, rounding within its bound, and tight."""

from functools import cache

import numpy as np
import pytest
from asking import ask, run_text
from bounding_shapes import crossed, shape
from region_cases import REGIONS, VOLUMES, cases, fitted_region

from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import TOOLS, Lanes
from warp_bounding.runtime.native import unique_name

KINDS = ("obb", "kdop", "bvh")  # of them the others are special cases, with the same text
NAMES = ("c", "blob", "single", "anisotropic", "animated")


@cache
def known(name: str, query: str) -> tuple[np.ndarray, np.ndarray]:
    return cases(query, shape(name), np.random.default_rng(5))


@cache
def made(method: str, name: str, query: str):
    return fitted_region(method, query, shape(name))


@pytest.mark.parametrize(("method", "name"), crossed(VOLUMES, NAMES, kinds=KINDS))
@pytest.mark.parametrize("query", REGIONS)
def test_no_false_negative(method, query, name, device):
    q, truth = known(name, query)
    assert truth.sum() > 3000
    bounder = made(method, name, query).to(device)
    f = bounder.values(q).numpy()
    assert not np.isnan(f).any()
    missed = truth & (f < bounder.threshold)
    assert not missed.any(), q[missed][:3]
    if name == "animated" and method in ("obb", "kdop", "bvh"):  # fills little of its domain: not looser than a box
        box = made("aabb", name, query).values(q[:6000]).numpy() >= 0
        assert (f[:6000] >= bounder.threshold).mean() <= box.mean() + 0.1
    if name == "blob" and method in ("kdop", "bvh"):
        batch, alone = bounder.query(q).numpy(), ask(bounder, q)
        assert alone[truth].all()
        assert batch[truth].all()
        assert (alone != batch).sum() <= 20  # regions that graze the volume


def device_values(bounder, v: np.ndarray) -> np.ndarray:
    """f of float32 coordinates ``(N, ndim)``, as they are, as the bounder's device computes it."""
    source = bounder.source
    text = f"""
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
{TOOLS}
typedef float V; typedef int Mask; V f;
const float* v = x.data + (long long)block * {source.coordinates}; const float* w = numbers.data;
{source.body(Lanes(vector=False))}
out.data[block] = f;
"""
    f = run_text(unique_name(source, "body"), text, len(v), v, bounder.weights(), len(v), bounder.device)
    return f.astype(np.float64)


def random_coordinates(domain, rng: np.random.Generator, count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """float32 ``v`` of regions, and points of them, inside the domain, as float64."""
    n, limit = domain.space_ndim, domain.base.limit
    a, b = (rng.uniform(-1, 1, (count, n)).astype(np.float32) * limit for _ in range(2))
    b = np.where(rng.random((count, 1)) < 0.3, a + (b - a) * np.float32(1e-3), b)
    if domain.query == "box":
        low, high = np.minimum(a, b).astype(np.float64), np.maximum(a, b).astype(np.float64)
        points = [low + rng.choice([0.0, 0.5, 1.0], size=a.shape) * (high - low) for _ in range(10)]
        points += [low + rng.random(a.shape) * (high - low) for _ in range(20)]
        return np.concatenate([low, high], axis=1).astype(np.float32), points
    if domain.query == "ray":
        w = (b - a) * np.where(rng.random(a.shape) < 0.2, np.float32(0), np.float32(0.999))
        return np.concatenate([a, w], axis=1), [a + t * w.astype(np.float64) for t in np.linspace(0, 1, 40)]
    m = np.where(rng.random(a.shape) < 0.2, 0, rng.normal(size=a.shape))
    m[np.abs(m).max(axis=1) == 0, 0] = 1
    m = (m / np.take_along_axis(m, np.abs(m).argmax(axis=1)[:, None], axis=1)).astype(np.float32)
    c = (m.astype(np.float64) * a).sum(axis=1).astype(np.float32)
    points = []
    for _ in range(40):
        p = rng.uniform(-1, 1, a.shape) * limit
        off = ((m.astype(np.float64) * p).sum(axis=1) - c) / (m.astype(np.float64) ** 2).sum(axis=1)
        p = p - m.astype(np.float64) * off[:, None]
        points.append(np.where((np.abs(p) <= limit).all(axis=1)[:, None], p, np.nan))
    return np.concatenate([m, c[:, None]], axis=1), points


@pytest.mark.parametrize(("method", "name"), [(m, "blob") for m in KINDS])
@pytest.mark.parametrize("query", REGIONS)
def test_rounding_bound(method, query, name, device, rng):
    """A device's number is at least f of every point of the region, less the bound, and as the reference says."""
    bounder = made(method, name, query).to(device)
    error = bounder.rounding_bound()
    assert error < 1e-3
    v, points = random_coordinates(bounder.domain, rng, 3000)
    q, _ = known(name, query)
    n, limit = bounder.domain.space_ndim, bounder.domain.limit
    hard = bounder.domain.to_local(q[:, : 2 * n]).astype(np.float32)
    hard = hard[(np.abs(hard) <= limit).all(axis=1)]
    exact = bounder.reference(np.concatenate([v, hard]).astype(np.float64))
    f = device_values(bounder, np.concatenate([v, hard]))
    with np.errstate(invalid="ignore"):
        best = np.nanmax([-np.ones(len(v)) * 1e9, *(bounder.volume.reference(p) for p in points)], axis=0)
    held = best >= (0.0 if method == "bvh" else 1e-12)  # the samples themselves round in float64
    assert held.any()
    assert (f[: len(v)][held] >= -error).all()
    if method == "bvh" or query == "ray":
        assert set(np.unique(f)) <= {0.0, -1.0}
        assert (f >= exact).all()
        assert (f > exact).mean() < 0.1  # grazing regions, of which there are many here
    else:
        assert (np.abs(f - exact) <= error).all()


def test_a_volume_that_does_not_hold_the_object():
    bounder = made("aabb", "c", "box")
    smaller = type(bounder)(bounder.domain, {k: t * np.float32(0.9) for k, t in bounder.tensors.items()}, {}, "cpu")
    with pytest.raises(BounderError, match="do not hold all of the object"):
        smaller.least(shape("c"))
