"""Rays, planes and boxes against the classic volumes: no false negative, rounding within its bound, and tight."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from bounding_shapes import shape
from region_cases import REGIONS, VOLUMES, cases, fitted_region, ray_length

from warp_bounding.bounders import load, supports
from warp_bounding.errors import BounderError

NAMES = ("c", "blob", "star", "single", "anisotropic", "mesh", "half", "animated", "five")


@cache
def known(name: str, query: str) -> tuple[np.ndarray, np.ndarray]:
    return cases(query, shape(name), np.random.default_rng(5))


@cache
def made(method: str, name: str, query: str):
    return fitted_region(method, query, shape(name))


def local(bounder, q: np.ndarray) -> np.ndarray:
    """``v`` in float64 of regions whose origin or point lies in the domain, so that no device moves it."""
    return bounder.domain.to_local(q)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_no_false_negative(method, query, name, device):
    q, truth = known(name, query)
    assert truth.sum() > 3000
    bounder = made(method, name, query).to(device)
    f = bounder.values(q).numpy()
    assert not np.isnan(f).any()
    missed = truth & (f < bounder.threshold)
    assert not missed.any(), q[missed][:3]


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_worth_something(method, query):
    """On an object that fills little of its domain, and with the object's own box as the coarsest measure."""
    q, truth = known("animated", query)
    answers = made(method, "animated", query).values(q).numpy() >= made(method, "animated", query).threshold
    assert answers[:6000].mean() < 1.0
    if method in ("obb", "kdop", "bvh"):
        box = made("aabb", "animated", query).values(q).numpy() >= 0
        assert answers[:6000].mean() <= box[:6000].mean() + 0.1
    assert (answers >= truth).all()


@pytest.mark.parametrize("name", ["c", "blob", "mesh", "animated"])
@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_rounding_bound(method, query, name, device):
    """Devices compute at least the volume's largest f on the region, less the bound; and not much more."""
    grid, bounder = shape(name), made(method, name, query).to(device)
    q, _ = known(name, query)
    n = grid.ndim
    first = q[:, :n] if query != "plane" else q[:, n:]
    within = ((first >= grid.lower) & (first <= grid.upper)).all(axis=1)
    if query == "ray":  # an origin on the border is moved
        within &= (np.abs(bounder.domain.base.to_local(first)) < 0.99).all(axis=1)
    q = q[within]
    f, v = bounder.values(q).numpy(), local(bounder, q)
    asked = np.isfinite(f)
    assert asked.sum() > 1000
    error = (bounder.reference(v) - f)[asked]
    assert bounder.rounding_bound() < 1e-3
    # f itself moves with the input error of v by no more than its slope times that
    decides = method == "bvh" or (query == "ray" and method in ("aabb", "obb", "kdop"))
    if decides:
        assert (error != 0).mean() < 0.25  # grazing regions are decided by room
        assert set(np.unique(f[asked])) <= {0.0, -1.0}
    else:
        scale = 1 + np.abs(f[asked])
        assert (np.abs(error) <= bounder.rounding_bound() + 1e-4 * scale).mean() > 0.99


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_upper_bound_of_points(method, query, rng):
    """f of a region is at least f of each of its points: sampled in float64, and against what devices compute."""
    grid, bounder = shape("blob"), made(method, "blob", query)
    domain, n = bounder.domain, grid.ndim
    limit = domain.base.limit.astype(np.float64)
    a, b = (rng.uniform(-1, 1, (4000, n)) * limit for _ in range(2))
    if query == "box":
        v = np.concatenate([np.minimum(a, b), np.maximum(a, b)], axis=1)
        points = [v[:, :n] + rng.random((len(v), n)) * (v[:, n:] - v[:, :n]) for _ in range(30)]
    elif query == "ray":
        v = np.concatenate([a, b - a], axis=1)
        points = [a + t * (b - a) for t in np.linspace(0, 1, 30)]
    else:
        m = rng.normal(size=a.shape)
        m /= np.take_along_axis(m, np.abs(m).argmax(axis=1)[:, None], axis=1)
        v = np.concatenate([m, (m * a).sum(axis=1, keepdims=True)], axis=1)
        points = [a]
        for _ in range(30):
            p = rng.uniform(-1, 1, a.shape) * limit
            points.append(p - m * (((m * p).sum(axis=1) - v[:, -1]) / (m * m).sum(axis=1))[:, None])
    best = np.max([bounder.volume.reference(p) for p in points], axis=0)
    f = bounder.reference(v)
    held = best >= -1 if method in ("sphere", "ellipsoid", "oriented-ellipsoid") else best >= 0
    if method in ("sphere", "ellipsoid", "oriented-ellipsoid"):
        assert (f >= best - bounder.rounding_bound()).all()
    else:
        assert held.any()
        assert (f[held] >= -bounder.rounding_bound()).all()


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_function_in_a_kernel(method, query, device):
    """The same answers as the batch path but for rounding: both within the bound, both without false negatives."""
    bounder = made(method, "blob", query).to(device)
    q, truth = known("blob", query)
    test, n = bounder.func, len(q)

    @wp.kernel(enable_backward=False, module="unique")
    def ask(data: bounder.Data, a: wp.array(dtype=wp.vec3), b: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if test(data, a[i], b[i]):
            out[i] = wp.uint8(1)

    a, b = (wp.array(np.ascontiguousarray(part), dtype=wp.vec3, device=device) for part in (q[:, :3], q[:, 3:]))
    out = wp.zeros(n, dtype=wp.uint8, device=device)
    wp.launch(ask, dim=n, inputs=[bounder.data, a, b], outputs=[out], device=device)
    batch = bounder.query(q).numpy().astype(bool)
    alone = out.numpy().astype(bool)
    assert (alone >= truth).all()
    assert (batch >= truth).all()
    assert (alone != batch).sum() <= 20  # regions that graze the volume


@pytest.mark.parametrize("query", REGIONS)
def test_boxes_are_boxes(query, rng):
    """The axis-aligned box answers like exact arithmetic for regions that are a hundred-thousandth off its faces."""
    grid = shape("blob")
    bounder = made("aabb", "blob", query)
    low, high = grid.position(grid.occupied - 0.5).min(axis=0), grid.position(grid.occupied + 0.5).max(axis=0)
    cell = 1 / grid.cells_per_unit
    normals = rng.normal(size=(300, 3))
    corner = np.where(normals > 0, high, low)
    for away, answer in ((1e-2, 0), (-1e-2, 1)):
        p = corner + away * cell * np.sign(normals)
        if query == "box":
            reach = rng.random(p.shape) * cell
            q = np.concatenate([np.where(normals > 0, p, p - reach), np.where(normals > 0, p + reach, p)], axis=1)
        elif query == "plane":
            q = np.concatenate([normals, p], axis=1)
        else:
            d = np.cross(normals, rng.normal(size=p.shape))
            q = np.concatenate([p - d / np.linalg.norm(d, axis=1, keepdims=True) * 0.6 * ray_length(grid), d], axis=1)
        inside_domain = (np.abs(bounder.domain.base.to_local(q[:, 3:] if query == "plane" else q[:, :3])) < 7).all(
            axis=1
        )
        assert (bounder.query(q[inside_domain].astype(np.float32)).numpy() == answer).all()


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", VOLUMES)
def test_saved_and_loaded(method, query, tmp_path):
    bounder = made(method, "c", query)
    bounder.save(tmp_path / "b.safetensors")
    twin = load(tmp_path / "b.safetensors", device="cpu")
    assert (twin.weights() == bounder.weights()).all()
    assert twin.source == bounder.source
    assert twin.nbytes == bounder.nbytes
    assert twin.least(shape("c")) == bounder.least(shape("c"))


def test_a_volume_that_does_not_hold_the_object():
    bounder = made("aabb", "c", "box")
    smaller = type(bounder)(bounder.domain, {k: t * np.float32(0.9) for k, t in bounder.tensors.items()}, {}, "cpu")
    with pytest.raises(BounderError, match="do not hold all of the object"):
        smaller.least(shape("c"))


def test_what_is_supported():
    for method in VOLUMES:
        for query in REGIONS:
            assert supports(method, query, 3)
            assert not supports(method, query, 1)
    assert not supports("kdop", "plane", 7)
    assert supports("kdop", "box", 7)
