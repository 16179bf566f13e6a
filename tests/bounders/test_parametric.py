"""Volumes in the space of a region's own numbers: supports that hold for every positive, zero slack, and no false negative."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders import METHODS
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.errors import BounderError
from warp_bounding.geometry.direction_patches import DirectionPatches
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.positives import draw_positives
from warp_bounding.support_functions.parametric import ParametricSupport

CLASSICS = ("aabb", "obb", "kdop", "sphere", "ellipsoid", "oriented-ellipsoid")
REGIONS = ("ray", "plane", "box")
LENGTH = {"c": 1.0, "blob": 0.4, "anisotropic": 3.0, "animated": 1.0}  # of rays


@cache
def domain(name: str, query: str):
    return domain_of(shape(name), query, LENGTH[name], "parametric")


@cache
def support(name: str, query: str) -> ParametricSupport:
    return ParametricSupport(shape(name), domain(name, query))


@cache
def positives(name: str, query: str) -> np.ndarray:
    x = next(draw_positives(query, shape(name), 20_000, 7, "cpu", LENGTH[name]))
    return x[:: max(1, len(x) // 40_000)]


def asked(name: str, query: str) -> np.ndarray:
    """Those that the volume decides: a plane whose point is outside the domain is answered with maybe."""
    x, d = positives(name, query), domain(name, query)
    return x[(np.abs(d.to_local(x)) <= d.limit).all(axis=1)]


def extreme_positives(name: str, query: str, g: np.ndarray) -> np.ndarray:
    """Positives that a search pushes towards large ``g . v``, still positive by the exact oracle."""
    grid, rng = shape(name), np.random.default_rng(0)
    truth, d = oracle(query, grid, "cpu", LENGTH[name]), domain(name, query)
    x = asked(name, query)
    x = x[np.argsort(-(d.to_local(x) @ g))[:200]]
    size = np.concatenate([grid.upper - grid.lower] * 2)
    if query == "plane":
        size[: grid.ndim] = 1
    if query == "ray":
        size[grid.ndim :] = 1
    low, high = np.concatenate([grid.lower] * 2), np.concatenate([grid.upper] * 2)
    for step in (0.1, 0.03, 0.01, 0.003):
        for _ in range(6):
            moved = x + rng.normal(size=x.shape) * step * size
            for part in (slice(0, grid.ndim), slice(grid.ndim, None)):
                if (query, part.start) in (("ray", grid.ndim), ("plane", 0)):
                    moved[:, part] /= np.linalg.norm(moved[:, part], axis=1, keepdims=True)
                else:
                    moved[:, part] = np.clip(moved[:, part], low[part], high[part])
            moved = moved.astype(np.float32)
            moved = moved[truth(moved)]
            x = np.concatenate([x, moved])
            x = x[np.argsort(-(d.to_local(x) @ g))[:200]]
    return x


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "blob", "anisotropic"])
def test_supports_hold_and_are_tight(name, query, rng):
    d, certified = domain(name, query), support(name, query)
    axes = np.eye(d.ndim)
    g = np.concatenate([axes, -axes, rng.normal(size=(4, d.ndim))])
    bound = certified(g)
    v = d.to_local(asked(name, query))
    assert ((v @ g.T).max(axis=0) <= bound).all()
    inside = np.abs(g) @ d.limit.astype(np.float64)
    assert (bound <= inside * (1 + 1e-6)).all()
    for row in range(len(g) - 4, len(g)):
        found = float((d.to_local(extreme_positives(name, query, g[row])) @ g[row]).max())
        assert found <= bound[row]
        assert bound[row] - found <= 0.12 * inside[row]


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "blob"])
def test_squares_hold(name, query, rng):
    d, certified = domain(name, query), support(name, query)
    v = d.to_local(asked(name, query))
    for scale in (np.ones(d.ndim), rng.random(d.ndim)):
        matrix, offset = rng.normal(size=(d.ndim, d.ndim)) * scale, rng.normal(size=d.ndim)
        assert ((v @ matrix.T + offset) ** 2).sum(axis=1).max() <= certified.square(matrix, offset)


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "animated"])
def test_no_false_negative(name, query):
    grid, d = shape(name), domain(name, query)
    x = positives(name, query)
    v = d.to_local(x[:2000])
    for method in CLASSICS if name == "c" else ("obb", "oriented-ellipsoid"):
        bounder = METHODS[method].fit_parametric(grid, d, v, device="cpu")
        least, count = bounder.least(grid)
        assert count > 0
        bounder.freeze(round_down(least - bounder.rounding_bound()), None)
        assert bounder.query(x).numpy().all(), method
        assert bounder.values(x).numpy().min() >= bounder.threshold
        assert bounder.reference(d.to_local(asked(name, query))).min() >= least


def test_they_leave_something_out():
    for query in REGIONS:
        grid, d = shape("c"), domain("c", query)
        v = d.to_local(positives("c", query)[:2000])
        uniform = sample(query, grid, 20_000, np.random.default_rng(1))
        rate = {}
        for method in ("aabb", "kdop"):
            bounder = METHODS[method].fit_parametric(grid, d, v, device="cpu")
            least, _ = bounder.least(grid)
            assert abs(least) < 1e-4
            rate[method] = (
                bounder.freeze(round_down(least - bounder.rounding_bound()), None).query(uniform).numpy().mean()
            )
        assert rate["kdop"] <= rate["aabb"] <= 1
        assert rate["aabb"] < 1 or query != "box"


def test_sampled_fits_of_the_benchmark_are_what_they_are_called(rng, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    from protocol_check import sampled_fit

    q = rng.normal(size=(500, 4)) * [1, 2, 3, 4]
    for method in ("aabb", "obb", "kdop"):
        inside = sampled_fit(method, q)
        assert inside(q).all()
        assert not inside(q * 3).all()
    assert sampled_fit("aabb", q)(np.array([q.max(axis=0)])).all()


@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
def test_patches_cover_the_sphere(ndim, rng):
    """Every unit vector is ``f y`` with y a mean of a patch's vertices: a convex function is largest at some vertex."""
    patches = DirectionPatches.cover(ndim, 3)
    for cover in (patches, patches.split() if ndim > 1 else patches):
        u = rng.normal(size=(4000, ndim))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        face = u / np.abs(u).max(axis=1, keepdims=True)
        axis, sign = np.argmax(np.abs(u), axis=1), np.sign(u[np.arange(len(u)), np.argmax(np.abs(u), axis=1)])
        others = np.array([np.delete(row, k) for row, k in zip(face, axis, strict=True)]).reshape(len(u), ndim - 1)
        held = (cover.axis == axis[:, None]) & (cover.sign == sign[:, None])
        held &= ((others[:, None] >= cover.lower) & (others[:, None] <= cover.upper)).all(axis=2)
        assert held.any(axis=1).all()
        index = held.argmax(axis=1)
        vertices = cover.vertices(1e-6)
        for convex in (
            lambda z, a: z @ a,
            lambda z, a: np.abs(z - a).sum(axis=-1),
            lambda z, a: ((z + a) ** 2).sum(axis=-1),
        ):
            a = rng.normal(size=ndim)
            for factor in (1 - 1e-6, 1, 1 + 1e-6):
                assert (convex(u * factor, a) <= convex(vertices[index], a).max(axis=1) + 1e-12).all()


def test_errors():
    grid, d = shape("c"), domain("c", "ray")
    with pytest.raises(BounderError, match="positives"):
        METHODS["aabb"].fit_parametric(grid, d, np.zeros((0, 4)))
    with pytest.raises(BounderError, match="parametric space"):
        METHODS["aabb"].fit_parametric(grid, domain_of(grid, "ray"), np.zeros((5, 4)))
    with pytest.raises(BounderError, match="no such volume"):
        METHODS["voxels"].fit_parametric(grid, d, np.zeros((5, 4)))
    with pytest.raises(BounderError, match="parametric space"):
        ParametricSupport(grid, domain_of(grid, "point"))
