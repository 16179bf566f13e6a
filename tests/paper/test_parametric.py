"""Volumes around the numbers of regions: supports that hold for every positive, no false negative, and the rates that were measured before."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bounding_shapes import shape

from paper.parametric.direction_patches import DirectionPatches
from paper.parametric.supports import ParametricSupport, limit_of, to_local
from paper.parametric.volumes import fit, rates
from warp_bounding.errors import BounderError
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of

CLASSICS = ("aabb", "obb", "kdop", "sphere", "ellipsoid", "oriented-ellipsoid")
REGIONS = ("ray", "plane", "box")
LENGTH = {"c": 1.0, "blob": 0.4, "anisotropic": 3.0, "animated": 1.0}  # of rays


@cache
def domain(name: str, query: str):
    return domain_of(shape(name), query, LENGTH[name])


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
    return x[(np.abs(to_local(d, x)) <= limit_of(d)).all(axis=1)]


def extreme_positives(name: str, query: str, g: np.ndarray) -> np.ndarray:
    """Positives that a search pushes towards large ``g . v``, still positive by the exact oracle."""
    grid, rng = shape(name), np.random.default_rng(0)
    truth, d = oracle(query, grid, "cpu", LENGTH[name]), domain(name, query)
    x = asked(name, query)
    x = x[np.argsort(-(to_local(d, x) @ g))[:200]]
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
            x = x[np.argsort(-(to_local(d, x) @ g))[:200]]
    return x


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "blob", "anisotropic"])
def test_supports_hold_and_are_tight(name, query, rng):
    d, certified = domain(name, query), support(name, query)
    axes = np.eye(2 * d.space_ndim)
    g = np.concatenate([axes, -axes, rng.normal(size=(4, 2 * d.space_ndim))])
    bound = certified(g)
    v = to_local(d, asked(name, query))
    assert ((v @ g.T).max(axis=0) <= bound).all()
    inside = np.abs(g) @ limit_of(d)
    assert (bound <= inside * (1 + 1e-6)).all()
    for row in range(len(g) - 4, len(g)):
        found = float((to_local(d, extreme_positives(name, query, g[row])) @ g[row]).max())
        assert found <= bound[row]
        assert bound[row] - found <= 0.12 * inside[row]


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "blob"])
def test_squares_hold(name, query, rng):
    d, certified = domain(name, query), support(name, query)
    v = to_local(d, asked(name, query))
    for scale in (np.ones(2 * d.space_ndim), rng.random(2 * d.space_ndim)):
        matrix, offset = rng.normal(size=2 * [len(scale)]) * scale, rng.normal(size=len(scale))
        assert ((v @ matrix.T + offset) ** 2).sum(axis=1).max() <= certified.square(matrix, offset)


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "animated"])
def test_no_false_negative(name, query):
    x, d = positives(name, query), domain(name, query)
    begins = x[(np.abs(to_local(d, x)) <= limit_of(d)).all(axis=1)]
    for method in (*CLASSICS, "learned-kdop") if name == "c" else ("obb", "oriented-ellipsoid"):
        volume = fit(shape(name), query, method, length=LENGTH[name], steps=30)
        assert volume.query(begins).all(), method
        found = rates(volume, shape(name), 20_000, "exact", seed=3)
        assert found.fn == 0
        assert 0 < found.fp_rate + found.positives <= 100 + 1e-9


def test_they_leave_something_out():
    for query in REGIONS:
        rate = {
            m: rates(fit(shape("c"), query, m), shape("c"), 20_000, "exact", seed=1).fp_rate for m in ("aabb", "kdop")
        }
        assert rate["kdop"] <= rate["aabb"]


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


def test_points_have_no_other_numbers():
    with pytest.raises(BounderError, match="expected regions"):
        ParametricSupport(shape("c"), domain_of(shape("c"), "point"))
