"""g is never above the distance to the object, for any float32 point anywhere; every question that follows from it misses nothing."""

from fractions import Fraction

import numpy as np
import pytest
import warp as wp
from bounding_shapes import crossed, fitted
from distances import THINGS, far, points_around, squared_distance_to_cells, thing

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES
from warp_bounding.proof.stress import DISTANCE_FORMS, DistancePositives

GRIDS = ("line", "c", "blob", "anisotropic", "mesh", "five")


@pytest.mark.parametrize(("method", "name"), crossed(DISTANCES, THINGS, few=("aabb",)))
def test_never_above_the_distance(method, name, rng):
    bounder, shape = far(method, name), thing(name)
    assert bounder.certificate.proven
    x = points_around(shape, 4000, rng)
    g, known = bounder.distance(x).numpy(), shape.distances(x)
    assert g.dtype == np.float32
    assert (g >= 0).all()
    assert (g <= known[:, 1]).all()
    held = shape.contains(x)
    assert not g[held].any()
    assert (bounder.query(x).numpy() == ~(g > 0)).all()


@pytest.mark.parametrize(("method", "name"), crossed(DISTANCES, GRIDS, few=("aabb",)))
def test_never_above_the_distance_in_rational_arithmetic(method, name, rng):
    bounder, shape = far(method, name), thing(name)
    x = points_around(shape, 15, rng)
    x = np.concatenate([x, (x[:10] - shape.lower) * 2.0 ** np.arange(0, 40, 4)[:, None] + shape.lower]).astype(
        np.float32
    )
    for point, g in zip(x, bounder.distance(x).numpy(), strict=True):
        assert Fraction(float(g)) ** 2 <= squared_distance_to_cells(shape, point)


@pytest.mark.parametrize("method", DISTANCES)
def test_as_tight_as_float32_allows(method, rng):
    """What the kernel takes off for rounding is a few units of the numbers."""
    bounder, shape = far(method, "tetrahedron"), thing("tetrahedron")
    x = points_around(shape, 4000, rng)
    g, exact = bounder.distance(x).numpy(), bounder.exact(x)
    size = np.abs(bounder.domain.to_local(x)).sum(axis=1) * bounder.domain.unit
    assert (g <= exact + bounder.rounding_bound() * bounder.domain.unit).all()
    assert (exact - g <= 1e-5 * (size + bounder.domain.unit)).all()


@pytest.mark.parametrize("method", DISTANCES)
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
    [(m, name) for name in ("blob", "anisotropic", "tetrahedron", "torus") for m in DISTANCES]
    + [
        pytest.param(m, "c", marks=() if m in ("aabb", "mlp", "distance-grid") else pytest.mark.slow) for m in DISTANCES
    ],
)
def test_hard_positives_are_not_missed(method, name):
    bounder, shape = far(method, name), thing(name)
    positives = DistancePositives(bounder, shape)
    for chunk in range(2 * len(DISTANCE_FORMS)):
        form, asked, missed = positives.ask(3, chunk, 3000)
        assert missed is None, (form, missed)
        assert asked > 1000


@pytest.mark.parametrize("method", DISTANCES)
def test_marching_and_halving_decide_what_g_can(method, rng):
    """With steps enough, all segments, rays and boxes are cleared that stay away from the object by more than g loses."""
    bounder, shape = far(method, "tetrahedron"), thing("tetrahedron")
    a, b = (points_around(shape, 300, rng, 0.5) for _ in "ab")
    along = (a[:, None] + np.linspace(0, 1, 65)[None, :, None] * (b - a)[:, None]).reshape(-1, 3)
    g = bounder.exact(along).reshape(len(a), -1)
    boxed = (np.abs(bounder.domain.to_local(along)) <= bounder.domain.limit).all(axis=1).reshape(g.shape)
    held, g = ((g <= 0) & boxed).any(axis=1), g.min(axis=1)  # outside of the object's box nothing is asked
    maybe, t = (part.numpy() for part in bounder.segments(a, b, steps=4000))
    if bounder.volume is not None:  # whose g itself is a distance; others may march past a point at which g is 0
        assert (maybe[held] == 1).all()
    near = (
        np.linalg.norm(b.astype(np.float64) - a, axis=1) / 128 + 1e-3
    )  # between two of the points that were looked at
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


@pytest.mark.parametrize("method", ["aabb", "sphere", "kdop"])
def test_what_only_touches_the_objects_box_is_not_cut_off(method, rng):
    """Segments and rays, of all lengths and from all distances, that end in a face, an edge or a corner of a box, pass one along an axis, or are as near as the radius."""
    lower, upper = np.sort(rng.normal(size=(2, 3)).astype(np.float32), axis=0)
    bounder = wb.fit(wb.solids.Box(lower, upper), "distance", method, device="cpu")
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


def test_times_of_contact():
    bounder = far("aabb", "tetrahedron")
    low, high = bounder.domain.lower, bounder.domain.upper
    middle = (low + high) / 2
    start = middle - [5 + (high - low)[0] / 2, 0, 0]
    for radius, expected in ((0.0, 0.5), (1.0, 0.4)):
        end = start + np.array([10.0, 0, 0])
        maybe, t = bounder.segments(start[None].astype(np.float32), end[None].astype(np.float32), radius)
        assert maybe.numpy()[0] == 1
        assert expected - 1e-3 < t.numpy()[0] <= expected
    maybe, t = bounder.segments(
        start[None].astype(np.float32), start[None].astype(np.float32), 4.9
    )  # of no length: a point
    assert (maybe.numpy()[0], t.numpy()[0]) == (0, 1.0)
    maybe, t = bounder.segments(start[None].astype(np.float32), start[None].astype(np.float32), 5.1)
    assert (maybe.numpy()[0], t.numpy()[0]) == (1, 0.0)
    assert bounder.segments(start[None].astype(np.float32), middle[None].astype(np.float32), steps=1)[0].numpy()[0] == 1


def test_radii_of_their_own(rng):
    bounder = far("sphere", "blob")
    x = points_around(thing("blob"), 500, rng)
    radius = rng.uniform(0, 1, len(x))
    g = bounder.distance(x).numpy()
    each = bounder.query(x, radius).numpy()
    assert (each[g < radius - 1e-6] == 1).all()
    assert not each[g > radius + 1e-6].any()
    assert (bounder.query(x, radius=0.25).numpy() == ~(g > 0.25)).all()
    exactly = bounder.query(x, radius=g).numpy()  # g > g is false
    assert exactly.all()
    indices, count = bounder.candidates(x, 0.25)
    assert (np.flatnonzero(bounder.query(x, 0.25).numpy()) == indices.numpy()[: int(count.numpy()[0])]).all()
    a, b = x[:-1], x[1:]
    many = bounder.segments(a, b, radius[1:])[0].numpy()
    one = [bounder.segments(a[i : i + 1], b[i : i + 1], radius[i + 1])[0].numpy()[0] for i in range(40)]
    assert (many[:40] == one).all()


def one_by_one(bounder, a, b, radius: float, steps: int) -> list[np.ndarray]:
    """What the function for kernels says of segments."""

    @wp.kernel(module="unique", enable_backward=False)
    def ask(
        data: wb.Data,
        a: wp.array(dtype=wp.vec3),
        b: wp.array(dtype=wp.vec3),
        radius: float,
        steps: int,
        maybe: wp.array(dtype=wp.uint8),
        t: wp.array(dtype=float),
    ):
        i = wp.tid()
        told, when = wp.static(bounder.segment_func)(data, a[i], b[i], radius, steps)
        maybe[i] = wp.uint8(told)
        t[i] = when

    ends = [wp.array(each, dtype=wp.vec3, device="cpu") for each in (a, b)]
    found = [wp.zeros(len(a), dtype=kind, device="cpu") for kind in (wp.uint8, float)]
    wp.launch(ask, len(a), [bounder.data, *ends, radius, steps], found, device="cpu")
    return [each.numpy() for each in found]


@pytest.mark.parametrize("count", [1, 7, 16, 33, 511, 513, 1500])
@pytest.mark.parametrize("method", ["aabb", "bvh", "distance-grid"])
def test_lanes_are_filled_again(method, count, rng):
    """Marching in lanes is marching one by one: every query of a block is answered, once, with its own answer."""
    bounder = far(method, "tetrahedron")
    a, b = (points_around(thing("tetrahedron"), (count + 1) // 2, rng, 0.5)[:count] for _ in "ab")
    a[::5, 0] = np.nan
    for steps in (1, 3, 40):
        maybe, t = (part.numpy() for part in bounder.segments(a, b, 0.01, steps))
        alone, when = one_by_one(bounder, a, b, 0.01, steps)
        assert (maybe != alone).mean() <= 0.01
        assert np.abs(t - when)[maybe == alone].max(initial=0.0) < 1e-3
        assert maybe[::5].all()
        assert not t[::5].any()


@pytest.mark.parametrize("name", ["c", "tetrahedron"])
def test_margins(name, rng):
    shape = thing(name)
    for method in ("aabb", "sphere"):
        bounder = far(method, name, 0.1)
        x = points_around(shape, 2000, rng)
        known = shape.dilated(0.1).distances(x)
        assert (bounder.distance(x).numpy() <= known[:, 1]).all()
        assert bounder.info["margin"] == 0.1


@pytest.mark.parametrize("method", ["aabb", "obb", "kdop", "learned-kdop", "bvh", "voxels"])
def test_volumes_of_points_clear_segments(method, rng):
    """``clear_segments`` for every method that has a distance; for others it says so."""
    bounder, shape = fitted(method, "blob"), thing("blob")
    if method not in DISTANCES:
        with pytest.raises(wb.BounderError, match="segments need"):
            wb.clear_segments(bounder, np.zeros((1, 3)), np.zeros((1, 3)))
        return
    a, b = rng.uniform(-1, 2, (2, 500, 3))
    clear = wb.clear_segments(bounder, a, b)
    along = a[:, None] + np.linspace(0, 1, 100)[None, :, None] * (b - a)[:, None]
    assert 0 < clear.sum() < len(clear)
    assert not shape.contains(along[clear].reshape(-1, 3)).any()
    distance = far(method, "blob")
    assert not shape.contains(along[wb.clear_segments(distance, a, b)].reshape(-1, 3)).any()


@pytest.mark.parametrize("name", ["tetrahedron", "torus"])
def test_a_network_learns_the_distance(name, rng):
    """Also of a solid, which knows its distance from below only."""
    bounder, shape = far("mlp", name), thing(name)
    x = points_around(shape, 2000, rng, 0.05)
    away = shape.distances(x)[:, 0] > 0.2 * float(shape.extent.max())
    assert away.any()
    assert (bounder.distance(x[away]).numpy() > 0).mean() > 0.5


@pytest.mark.parametrize("name", ["c", "tetrahedron"])
def test_parts_have_a_slack_of_their_own(name, rng, tmp_path):
    shape = thing(name)
    options = {"method": "mlp", "hidden": (12, 12), "steps": 300, "seed": 0, "device": "cpu"}
    whole, cut = (wb.fit(shape, "distance", thresholds=parts, **options) for parts in (1, 40))
    assert cut.lattice.count > 8
    assert cut.relief.max() > 0
    assert cut.relief.min() == 0
    assert wb.certify(cut, shape).proven
    x = points_around(shape, 20_000, rng)
    v = cut.domain.to_local(x)
    edges = cut.lattice.edges[-1]
    v[::3, -1] = rng.choice(edges, len(v[::3]))  # on an edge, where the slack jumps
    x = np.concatenate([x, cut.domain.to_object(v)]).astype(np.float32)
    known = shape.distances(x)
    g = cut.distance(x).numpy()
    assert (g <= known[:, 1]).all()
    file = tmp_path / "cut.safetensors"
    cut.save(file)
    again = wb.load(file, device="cpu")
    assert (again.distance(x).numpy() == g).all()
    assert again.nbytes - whole.nbytes < 4 * cut.lattice.count + 200
    maybe, t = (each.numpy() for each in cut.segments(x[:2000], x[2000:4000]))
    assert not ((t > 0) & shape.contains(x[:2000])).any()
    assert maybe[shape.contains(x[:2000])].all()


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
