"""Distances are never above the true ones, no question that follows misses anything; files and mistakes."""

from fractions import Fraction

import numpy as np
import pytest
import warp as wp
from bounding_shapes import crossed, reloaded
from distances import THINGS, TOLD, check_hard_positives, far, points_around, squared_distance_to_cells, thing
from plain_shapes import box_of
from rewriting import changed, check_refuted

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES
from warp_bounding.bounders.distance_grid import STORAGES, DistanceGrid
from warp_bounding.errors import BounderError, FileFormatError, QueryError
from warp_bounding.proof import stress_test
from warp_bounding.proof.distances import largest_overestimate, overestimates_in

GRIDS = ("c", "blob", "anisotropic")
ALL_SHAPES = ("aabb", "kdop", "mlp", "distance-grid")  # methods of which each shape has some
KINDS = (*ALL_SHAPES, "bvh")  # of them the others are special cases, with the same text
MARCHED = [method if method in KINDS else pytest.param(method, marks=pytest.mark.slow) for method in DISTANCES]


@pytest.mark.parametrize(
    ("method", "name"),
    [
        *crossed(DISTANCES, [name for name in THINGS if name != "torus"], few=("aabb",)),
        *(pytest.param(m, "torus", marks=() if m in ALL_SHAPES else pytest.mark.slow) for m in DISTANCES),
    ],
)
def test_never_above_the_distance(method, name, rng):
    bounder, shape = far(method, name), thing(name)
    assert bounder.certificate.proven
    x = points_around(shape, 4000, rng)
    g, known = bounder.distance(x).numpy(), shape.distances(x)
    assert g.dtype == np.float32
    assert (g >= 0).all()
    assert (g <= known[:, 1]).all()
    assert not g[shape.contains(x)].any()
    assert name == "c" or (bounder.query(x).numpy() == ~(g > 0)).all()  # kernels of its own in each dimension
    size, exact = np.abs(bounder.domain.to_local(x)).sum(axis=1) * bounder.domain.unit, bounder.exact(x)
    if name == "tetrahedron":  # what is taken off for rounding is a few units
        assert (g <= exact + bounder.rounding_bound() * bounder.domain.unit).all()
        assert (exact - g <= 1e-5 * (size + bounder.domain.unit)).all()
    if name in GRIDS:
        x = np.concatenate([x[:15], (x[-10:] - shape.lower) * 2.0 ** np.arange(0, 40, 4)[:, None] + shape.lower])
        x = x.astype(np.float32)
        for point, reported in zip(x, bounder.distance(x).numpy(), strict=True):
            assert Fraction(float(reported)) ** 2 <= squared_distance_to_cells(shape, point)


@pytest.mark.parametrize("method", MARCHED)
def test_everywhere(method):
    bounder = far(method, "blob")
    directions = np.random.default_rng(1).normal(size=(500, 3))
    away = 2.0 ** np.linspace(-30, 127, 500)[:, None]
    x = (directions / np.abs(directions).max(axis=1, keepdims=True) * away).astype(np.float32)
    g = bounder.distance(x).numpy()
    reach = np.linalg.norm(x.astype(np.float64), axis=1)
    assert np.isfinite(g).all()
    assert (g <= reach + 2).all()
    middle = (reach > 100) & (reach < 2.0**50)
    least = 0.9 if method != "learned-kdop" else 0.3  # of its faces only the farthest one counts
    assert (g[middle] > least * reach[middle] - 3).all()
    bad = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, np.nan], [3e38, -3e38, 3e38]], np.float32)
    assert not bounder.distance(bad[:3]).numpy().any()
    assert bounder.query(bad[:3], 1e30).numpy().all()
    maybe, t = bounder.segments(bad[:3], np.zeros((3, 3), np.float32))
    assert maybe.numpy().all()
    assert not t.numpy().any()
    assert bounder.boxes(bad[:3], bad[:3]).numpy().all()
    rays = np.concatenate([np.zeros((3, 3), np.float32), bad[:3]], axis=1)
    assert bounder.rays(rays, length=1.0)[0].numpy().all()
    assert bounder.distance(np.zeros((0, 3), np.float32)).shape == (0,)


@pytest.mark.parametrize(
    ("method", "name"),
    [
        *(pytest.param(m, "blob", marks=() if m in KINDS else pytest.mark.slow) for m in DISTANCES),
        *((m, "tetrahedron") for m in ALL_SHAPES),
        ("mlp", "c"),
    ],
)
def test_hard_positives_are_not_missed(method, name):
    check_hard_positives(far(method, name), thing(name), 1000)


@pytest.mark.parametrize("method", MARCHED)
def test_marching_and_halving_decide_what_g_can(method, rng):
    """With steps enough, all is cleared that stays away from the object by more than g loses."""
    bounder, shape = far(method, "tetrahedron"), thing("tetrahedron")
    a, b = (points_around(shape, 300, rng, 0.5) for _ in "ab")
    along = (a[:, None] + np.linspace(0, 1, 65)[None, :, None] * (b - a)[:, None]).reshape(-1, 3)
    g = bounder.exact(along).reshape(len(a), -1)
    boxed = (np.abs(bounder.domain.to_local(along)) <= bounder.domain.limit).all(axis=1).reshape(g.shape)
    held, g = ((g <= 0) & boxed).any(axis=1), g.min(axis=1)  # outside of the object's box nothing is asked
    maybe, t = (part.numpy() for part in bounder.segments(a, b, steps=4000))
    if bounder.volume is not None:  # whose g itself is a distance; others may march past a point at which g is 0
        assert (maybe[held] == 1).all()
    # between two of the points that were looked at
    near = np.linalg.norm(b.astype(np.float64) - a, axis=1) / 128 + 1e-3
    assert not maybe[g > near].any()
    assert (t[maybe == 0] == 1).all()
    d = (b - a) * np.float32(3)
    length = np.linalg.norm(b.astype(np.float64) - a, axis=1)
    of_rays, when = (part.numpy() for part in bounder.rays(np.concatenate([a, d], axis=1), length=length, steps=4000))
    assert (of_rays != maybe).mean() < 0.01  # but for what rounding turns
    assert np.abs(when - t)[of_rays == maybe].max() < 1e-2
    low, high = np.minimum(a, a + (b - a) * 0.1), np.maximum(a, a + (b - a) * 0.1)
    boxed = bounder.boxes(low, high, steps=4000).numpy()
    reach = np.linalg.norm(high.astype(np.float64) - low, axis=1)
    assert not boxed[bounder.exact((low + high) / 2) > reach].any()
    assert boxed[shape.decide_boxes(low, high) == 1].all()


@pytest.mark.parametrize("method", ["aabb", "kdop"])
def test_what_only_touches_the_objects_box_is_not_cut_off(method, rng):
    """They end in a face, an edge or a corner of a box, pass one along an axis, or are as near as the radius."""
    lower, upper = np.sort(rng.normal(size=(2, 3)).astype(np.float32), axis=0)
    bounder = wb.fit(box_of(lower, upper), "distance", method, device="cpu")
    count = 3000
    p = np.clip(rng.normal(size=(count, 3)) * 2, lower, upper).astype(np.float32)
    axis, side = rng.integers(3, size=count), rng.integers(2, size=count)
    each = np.arange(count)
    p[each, axis] = np.where(side, upper[axis], lower[axis])
    size = 10.0 ** rng.uniform(-6, 6, (count, 1))
    start = (p + size * rng.normal(size=(count, 3))).astype(np.float32)
    maybe, t = (part.numpy() for part in bounder.segments(start, p))
    assert (maybe == 1).all()
    inside = ((start >= lower) & (start <= upper)).all(axis=1)
    assert (t[inside] == 0).all()
    way = size[:, 0] * rng.choice([-1, 1], count)
    one, other = p.copy(), p.copy()
    one[each, axis] = (p[each, axis] - way).astype(np.float32)
    other[each, axis] = (p[each, axis] + way).astype(np.float32)
    maybe, t = (part.numpy() for part in bounder.segments(one, other))
    assert (maybe == 1).all()
    met = (p[each, axis].astype(np.float64) - one[each, axis]) / (
        other[each, axis].astype(np.float64) - one[each, axis]
    )
    assert (t <= np.where(np.isfinite(met), met, 1.0)).all()
    turned = (axis + 1) % 3
    for ends in (one, other):
        aside = ends.copy()
        aside[each, turned] += np.float32(5.0)
        radius = np.abs(ends[each, axis].astype(np.float64) - p[each, axis])
        assert (bounder.segments(aside, ends, radius)[0].numpy() == 1).all()
        assert (bounder.segments(ends, aside, radius)[0].numpy() == 1).all()
    d = np.zeros_like(p)
    d[each, axis] = np.sign(other[each, axis] - one[each, axis])
    assert (bounder.rays(np.concatenate([one, d], axis=1), length=2.1 * np.abs(way) + 1e-6)[0].numpy() == 1).all()


def test_radii_of_their_own(rng):
    bounder, x = far("kdop", "blob"), points_around(thing("blob"), 500, rng)
    radius, g = rng.uniform(0, 1, len(x)), bounder.distance(x).numpy()
    each = bounder.query(x, radius).numpy()
    assert (each[g < radius - 1e-6] == 1).all()
    assert not each[g > radius + 1e-6].any()
    assert bounder.query(x, radius=g).numpy().all()  # g > g is false
    indices, count = bounder.candidates(x, 0.25)
    assert (np.flatnonzero(~(g > 0.25)) == indices.numpy()[: int(count.numpy()[0])]).all()
    still, t = (part.numpy() for part in bounder.segments(x, x, radius))  # of no length: points
    assert not still[g > radius + 1e-6].any()
    assert still[thing("blob").contains(x)].all()
    assert (t == np.where(still, 0.0, 1.0)).all()
    many = bounder.segments(x[:-1], x[1:], radius[1:])[0].numpy()
    one = [bounder.segments(x[i : i + 1], x[i + 1 : i + 2], radius[i + 1])[0].numpy()[0] for i in range(40)]
    assert (many[:40] == one).all()


@pytest.mark.parametrize("method", ["aabb", "distance-grid", "mlp"])
def test_what_float64_is_rounded_by_is_charged(method, rng):
    """A float64 point is farther from its float32 one than g knows; every question allows for it."""
    bounder, shape = far(method, "tetrahedron"), thing("tetrahedron")
    x, end = (points_around(shape, 3000, rng).astype(np.float64) for _ in range(2))
    x, end = (each * (1 + 2.0**-25 * rng.uniform(-1, 1, each.shape)) for each in (x, end))
    one, other = x.astype(np.float32), end.astype(np.float32)
    moved = np.linalg.norm(x - one, axis=1)
    assert (moved > 0).any()
    g = bounder.distance(one).numpy().astype(np.float64)
    found = bounder.distance(x).numpy()
    assert (found <= np.maximum(g - moved, 0)).all()
    assert (found >= np.maximum(g - 1e-5 * (1 + np.abs(x).max()), 0)).all()
    radius = np.maximum(g - moved, 0)  # not less than this is the distance of the float64 point, for all that is known
    assert bounder.query(x, radius=radius).numpy().all()
    for r in (0.0, 0.1):
        both = np.maximum(moved, np.linalg.norm(end - other, axis=1))
        free = bounder.segments(x, end, r)[0].numpy() == 0
        assert not bounder.segments(one, other, r + both)[0].numpy()[free].any()
        rays = np.concatenate([x, end], axis=1)
        free = bounder.rays(rays, length=2.0, radius=r)[0].numpy() == 0
        turned = rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
        turned -= other / np.linalg.norm(other.astype(np.float64), axis=1, keepdims=True)
        both = moved + 2.0 * np.linalg.norm(turned, axis=1)
        assert not bounder.rays(rays.astype(np.float32), length=2.0, radius=r + both)[0].numpy()[free].any()
    low, high = np.minimum(x, end), np.maximum(x, end)
    free = bounder.boxes(low, high).numpy() == 0
    assert free.any()
    outer = [np.nextafter(side.astype(np.float32), np.float32(way)) for side, way in ((low, -np.inf), (high, np.inf))]
    assert not bounder.boxes(*outer).numpy()[free].any()


def test_float64_that_float32_cannot_hold_is_maybe():
    bounder = far("aabb", "tetrahedron")
    for number in (1e39, np.nan, -np.inf):
        x = np.full((2, 3), number)
        assert not bounder.distance(x).numpy().any()
        assert bounder.query(x, radius=0.1).numpy().all()
        assert bounder.segments(x, x + 1)[0].numpy().all()
        assert bounder.boxes(x, x + 1).numpy().all()
    tiny = np.array([[9.0, 9.0, 9.0, 3e-46, 1e-46, 0.0]])  # a direction that float32 rounds to none
    assert bounder.rays(tiny, length=1.0)[0].numpy().all()


@pytest.mark.parametrize("method", DISTANCES)
def test_saved_loaded_certified(method, tmp_path, rng):
    bounder, x = far(method, "blob"), points_around(thing("blob"), 300, rng)
    again = reloaded(bounder, tmp_path)
    assert type(again) is type(bounder)
    assert (again.distance(x).numpy() == bounder.distance(x).numpy()).all()
    proof = wb.certify(again, thing("blob"))
    assert proof.proven, proof.message
    assert wb.certify(again, thing("blob"), margin=0.1).kind == "inapplicable"
    assert wb.certify(again, thing("blob"), query="distance").proven
    assert wb.certify(again, thing("blob"), query="point").kind == "inapplicable"


@pytest.mark.parametrize("method", DISTANCES)
def test_another_shape_is_refuted(method):
    cells, scale = np.pad(np.ones((15, 15, 15), bool), 1), thing("blob").cells_per_unit
    larger = wb.shapes.Grid(cells, cells_per_unit=scale, offset=[-4.0] * 3)
    check_refuted(far(method, "blob"), larger)


def test_a_threshold_that_does_not_cover_rounding_is_not_proven():
    bounder = far("kdop", "blob").to()
    bounder.freeze(0.0, None)
    proof = wb.certify(bounder, thing("blob"))
    assert proof.kind == "undecided"
    assert "rounds" in proof.message
    with pytest.raises(BounderError, match="at most 0"):
        bounder.freeze(0.5, None)


def test_edited_files(tmp_path):
    bounder = far("kdop", "blob")
    smaller = changed(bounder, {"high": bounder.tensors["high"] - np.float32(0.5)})  # cuts off a part of the object
    assert wb.certify(smaller, thing("blob")).kind == "refuted"
    assert stress_test(bounder, thing("blob"), 100_000, seed=1).missed is None
    assert stress_test(smaller, thing("blob"), 1_000_000, seed=1).missed is not None
    bounder.to().freeze(float(bounder.threshold) / 2, bounder.certificate).save(tmp_path / "b.safetensors")
    with pytest.raises(FileFormatError, match="threshold"):
        wb.load(tmp_path / "b.safetensors")
    for sizes in ({}, {"volume": {}}, {"volume": {**bounder.sizes["volume"], "threshold": 0.1}}):
        with pytest.raises(BounderError):
            type(bounder)(bounder.domain, bounder.tensors, sizes, "cpu")


def test_grids_that_move_are_refused_and_may_be_asked_without_their_time(rng):
    grid = thing("animated")
    with pytest.raises(BounderError, match="moves"):
        wb.fit(grid, "distance", "aabb")
    still = wb.shapes.Grid(grid.occupancy)
    bounder = wb.fit(still, "distance", "bvh", device="cpu", **TOLD["bvh"])
    x = points_around(still, 2000, rng)
    assert (bounder.distance(x).numpy() <= still.distances(x)[:, 1]).all()
    assert wb.certify(bounder, still).proven


@pytest.mark.parametrize("method", ["aabb", "distance-grid"])
def test_functions_in_kernels_and_lanes_that_are_filled_again(method, rng):
    """Batches march in lanes: every query of a block is answered, once, as the function for kernels answers it."""
    bounder, n = far(method, "blob"), 513
    x, y = (points_around(thing("blob"), 257, rng, 0.5)[:n] for _ in "xy")
    x[::5, 0] = np.nan

    @wp.kernel(module="unique", enable_backward=False)
    def ask(
        data: wb.Data,
        x: wp.array(dtype=wp.vec3),
        y: wp.array(dtype=wp.vec3),
        d: wp.array(dtype=float),
        maybe: wp.array(dtype=wp.bool),
        t: wp.array(dtype=float),
        hit: wp.array(dtype=wp.bool),
        boxed: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        d[i] = wp.static(bounder.distance_func)(data, x[i])
        reported, when = wp.static(bounder.segment_func)(data, x[i], y[i], 0.05)
        maybe[i] = reported
        t[i] = when
        met, _where = wp.static(bounder.ray_func)(data, x[i], y[i] - x[i], 2.0, 0.0)
        hit[i] = met
        boxed[i] = wp.static(bounder.box_func)(data, wp.min(x[i], y[i]), wp.max(x[i], y[i]))

    def run(data):
        out = [wp.zeros(n, dtype=kind, device="cpu") for kind in (float, wp.bool, float, wp.bool, wp.bool)]
        places = [wp.array(part, dtype=wp.vec3, device="cpu") for part in (x, y)]
        wp.launch(ask, n, [data, *places, *out], device="cpu")
        return [part.numpy() for part in out]

    d, maybe, t, hit, boxed = run(bounder.data)
    numbers, exact = np.isfinite(x).all(axis=1), method == "aabb"  # in a grid sums round in another order
    assert (d[numbers] <= thing("blob").distances(x[numbers])[:, 1]).all()
    error = 0.0 if exact else 2 * bounder.rounding_bound() * bounder.domain.unit
    assert np.abs(d - bounder.distance(x).numpy()).max() <= error
    for count in (1, 33, n):
        reported, when = (part.numpy() for part in bounder.segments(x[:count], y[:count], 0.05))
        assert (maybe[:count] != reported).mean() < 0.02  # sums round in another order
        assert np.abs(t[:count] - when)[maybe[:count] == reported].max() < 1e-3
        assert reported[::5].all()
        assert not when[::5].any()
    assert (hit != bounder.rays(np.concatenate([x, y - x], axis=1), length=2.0)[0].numpy()).mean() < 0.02
    differ = (boxed != bounder.boxes(np.minimum(x, y), np.maximum(x, y)).numpy())[numbers]
    assert differ.mean() <= (0.0 if exact else 0.02)
    assert 0 < maybe[numbers].sum() < numbers.sum()
    for other in (far("kdop", "blob").data, wb.Data()):  # of another source, or none: nothing is known
        d, maybe, t, hit, boxed = run(other)
        assert not d.any()
        assert maybe.all()
        assert hit.all()
        assert boxed.all()
        assert not t.any()


def test_bad_questions():
    bounder, x = far("aabb", "blob"), np.zeros((3, 3), np.float32)
    for radius in (-0.1, np.nan, np.inf, [0.1, 0.2], "wide", None):
        for ask in (lambda r: bounder.query(x, r), lambda r: bounder.segments(x, x, r)):
            with pytest.raises(QueryError, match="radius must be"):
                ask(radius)
    for steps in (0, 1.5, True):
        for ask in (lambda s: bounder.segments(x, x, steps=s), lambda s: bounder.boxes(x, x, steps=s)):
            with pytest.raises(QueryError, match="steps must be a whole number of at least 1"):
                ask(steps)
    for ask, words in (
        (lambda: bounder.segments(x, x[:2]), "as many"),
        (lambda: bounder.rays(np.zeros((3, 6), np.float32), length=-1), "length must be"),
        (lambda: bounder.distance(np.zeros((3, 2), np.float32)), r"\(N, 3\)"),
        (lambda: bounder.query(x, scale=2.0), "object space"),
    ):
        with pytest.raises(QueryError, match=words):
            ask()
    assert bounder.boxes(x + np.float32(2), x).numpy().all()  # upside down


def test_bad_fits():
    unknown = wb.shapes.Function(
        lambda x: (x**2).sum(axis=1) < 1,
        [-1, -1],
        [1, 1],
        empty=lambda low, high: (np.maximum(np.maximum(low, -high), 0) ** 2).sum(axis=1) > 1,
    )
    for shape, query, method, told, error, words in (
        *((thing("c"), "distance", m, {}, BounderError, "of a distance must be") for m in ("voxels", "aabb+sphere")),
        (thing("c"), "distance", "aabb", {"hidden": (8,)}, BounderError, "aabb takes no option 'hidden'"),
        (thing("c"), "distance", "aabb", {"length": 2.0}, BounderError, "length is not for distances"),
        (thing("c"), "distance", "aabb", {"side": "inside"}, BounderError, "side is not for distances"),
        (thing("c"), "distances", "aabb", {}, QueryError, "point, ray, plane, box, distance"),
        *((thing("c"), "distance", "distance-grid", {"nodes": n}, BounderError, "nodes") for n in (1, 2.5)),
        (thing("c"), "distance", "distance-grid", {"storage": "float64"}, BounderError, "storage"),
        (unknown, "distance", "distance-grid", {}, BounderError, "functions with distance= have one"),
        (wb.shapes.Function(unknown.contains, [-1, -1], [1, 1]), "distance", "aabb", {}, wb.BoundingError, "certifies"),
    ):
        with pytest.raises(error, match=words):
            wb.fit(shape, query, method, **told)
    bounder, value = far("distance-grid", "c"), np.float16(1e-6)
    for values in (np.zeros((3, 3, 3), np.float16), np.zeros((1, 5), np.float16), np.full((3, 3), value)):
        with pytest.raises(BounderError):
            DistanceGrid(bounder.domain, {"values": values}, bounder.sizes, "cpu")
    for tensors, sizes, words in (
        ({"values": np.zeros((3, 3), np.float32)}, {}, "stored"),
        (bounder.tensors, {"refine": 2}, "no longer read"),
    ):
        with pytest.raises(BounderError, match=words):
            DistanceGrid(bounder.domain, tensors, bounder.sizes | sizes, "cpu")


def brute(bounder, x: np.ndarray, count: int = 400_000) -> np.ndarray:
    """About the distance from points to the volume: to the nearest of many points that are certainly in it."""
    from scipy.spatial import cKDTree

    volume, rng = bounder.volume, np.random.default_rng(5)
    limit = volume.domain.limit.astype(np.float64)
    v = rng.uniform(-limit, limit, (count, volume.ndim)) * 2.5
    v = v[volume.reference(v) >= float(volume.threshold)]
    # to the border, along lines between points in the volume and others: bisection
    out = rng.uniform(-limit, limit, (len(v), volume.ndim)) * 4
    low, high = np.zeros(len(v)), np.ones(len(v))
    for _ in range(40):
        t = (low + high) / 2
        held = volume.reference(v + t[:, None] * (out - v)) >= float(volume.threshold)
        low, high = np.where(held, t, low), np.where(held, high, t)
    border = volume.domain.to_object(v + low[:, None] * (out - v))
    return cKDTree(np.concatenate([border, volume.domain.to_object(v)])).query(x)[0]


@pytest.mark.parametrize("name", ["c", "tetrahedron"])
@pytest.mark.parametrize("method", [method for method in DISTANCES if method not in ("mlp", "distance-grid")])
def test_forms_against_dense_points(method, name, rng):
    """No point of the volume is nearer than F says; of exact forms none but a little farther is the nearest one."""
    bounder, size = far(method, name), float(thing(name).extent.max())
    x = points_around(thing(name), 200, rng).astype(np.float64)
    exact, dense = bounder.exact(x), brute(bounder, x)
    outside = dense > 0.05 * size
    assert (exact[outside] <= dense[outside] * (1 + 1e-12)).all()
    assert (exact > 0).sum() > 50
    if "kdop" not in method:  # whose F is not the nearest point's
        share = 1e-9 if method == "aabb" else 1e-5
        assert (dense[outside] <= exact[outside] * (1 + share) + 0.05 * size).all()


@pytest.mark.parametrize(("storage", "name"), [*((each, "c") for each in STORAGES), (STORAGES[-1], "tetrahedron")])
def test_storages(storage, name, rng, tmp_path):
    shape, reported = thing(name), {"nodes": 12 if name == "c" else 6, "storage": storage}
    bounder = wb.fit(shape, "distance", "distance-grid", **reported, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert bounder.tensors["values"].dtype == storage
    x = points_around(shape, 3000, rng)
    g, exact, known = bounder.distance(x).numpy(), bounder.exact(x), shape.distances(x)
    assert (g <= known[:, 1]).all()
    assert (g <= exact).all()
    assert (g > 0).sum() > 0.8 * (known[:, 0] > 0).sum()
    again = reloaded(bounder, tmp_path)
    assert (again.distance(x).numpy() == g).all()
    assert wb.certify(again, shape).proven


def test_raised_values_are_not_proven():
    bounder, shape = far("distance-grid", "tetrahedron"), thing("tetrahedron")
    assert wb.certify(bounder, shape).proven
    raised = changed(bounder, {"values": (bounder.tensors["values"].astype(np.float32) + 0.2).astype(np.float16)})
    proof = wb.certify(raised, shape)
    assert proof.kind == "refuted"
    point = np.array([proof.counterexample], np.float32)
    assert raised.distance(point).numpy()[0] > shape.distances(point)[0, 1]


def test_overestimates_hold(rng):
    """No point of a box has a larger overestimate than is certified, and the largest is not far from that."""
    shape, bounder = thing("c"), far("distance-grid", "c")
    tensors = {"values": (bounder.tensors["values"].astype(np.float32) + 0.1)}
    raised = DistanceGrid(bounder.domain, tensors, bounder.sizes | {"storage": "float32"}, "cpu")
    lower, upper = raised.pieces()
    found, boxes, complete = overestimates_in(raised, shape, lower, upper, tolerance=1e-3, halvings=12)
    assert complete
    assert boxes >= len(lower)
    for cell in rng.integers(len(lower), size=60):
        v = rng.uniform(lower[cell], upper[cell], (400, 2))
        above = raised.reference(v) - shape.distances(raised.domain.to_object(v))[:, 1] / raised.domain.unit
        assert above.max() <= found[cell] + 1e-12
    most, _, _, _ = largest_overestimate(raised, shape, 60.0)
    v = rng.uniform(lower.min(axis=0), upper.max(axis=0), (100_000, 2))
    above = raised.reference(v) - shape.distances(raised.domain.to_object(v))[:, 0] / raised.domain.unit
    assert above.max() <= most <= above.max() + 0.01
