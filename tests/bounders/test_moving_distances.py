"""Distances to shapes that move: never above that to the mesh at that time; a march misses no contact."""

import dataclasses
from functools import cache

import numpy as np
import pytest
import trimesh
from bounding_shapes import reloaded
from distances import check_hard_positives
from edges import COUNT, check_until
from plain_shapes import LEANING, TETRAHEDRON

import warp_bounding as wb
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.errors import BounderError, QueryError, ShapeError
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.shapes.shape import IN

pytestmark = pytest.mark.filterwarnings("ignore:.*surface only:warp_bounding.errors.BoundingWarning")  # the sheet
TIMES = [2.0, 2.5, 4.0]


@cache
def moving(name: str, margin: float = 0.0) -> wb.shapes.MovingMesh:
    """A tetrahedron that is carried, turned and stretched, or two of its faces, which enclose nothing."""
    turned = LEANING[:, [1, 2, 0]] * [1, -1, 1] + [1.5, 0.5, 0]
    frames = np.stack([LEANING, turned, turned * 1.3 + [0, 0, 0.8]]).astype(np.float32)
    motion = wb.shapes.MovingMesh(frames, TETRAHEDRON[1] if name == "solid" else TETRAHEDRON[1][:2], TIMES, name=name)
    return motion.dilated(margin) if margin else motion


@cache
def far(name: str, margin: float = 0.0) -> wb.DistanceBounder:
    """Proven, on the CPU; never change it."""
    reported = {"hidden": (8,), "steps": 200, "budget": 6.0, "margin": margin}
    return wb.fit(moving(name), "distance", "mlp", device="cpu", progress=False, **reported)


def moments(shape: wb.shapes.MovingMesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Times at which the shape is there, keyframes among them, and places around it."""
    x = rng.uniform(shape.lower - 1, shape.upper + 1, (count, 4))
    x[:, 0] = rng.uniform(*np.array(TIMES)[[0, -1]], count)
    x[: count // 8, 0] = rng.choice(TIMES, count // 8)
    return x.astype(np.float32)


@pytest.mark.parametrize(("name", "margin"), [("solid", 0.0), ("sheet", 0.1)])
def test_never_above_the_distance_of_the_mesh_at_that_time(name, margin, rng):
    bounder, motion = far(name, margin), moving(name)
    assert bounder.certificate.proven
    assert bounder.domain.time
    x = moments(motion, 200, rng)
    x[:, 0] = np.repeat(x[::5, 0], 5)  # a mesh takes long
    g = bounder.distance(x).numpy()
    for some in range(0, 200, 5):
        mesh = wb.shapes.Mesh(motion.vertices_at(x[some, 0]), motion.faces).dilated(margin)
        assert (g[some : some + 5] <= mesh.distances(x[some : some + 5, 1:])[:, 1]).all()
    known = moving(name, margin).distances(x)
    assert (g <= known[:, 1]).all()
    assert (g > 0).mean() > 0.4  # it is a bound that says something
    assert np.allclose(g, bounder.exact(x), atol=1e-3)


def test_nothing_is_told_of_other_times(rng):
    bounder = far("solid")
    far_off = np.float32([0, 50, 0, 0])
    x = moments(moving("solid"), 100, rng) + far_off
    assert (bounder.distance(x).numpy() > 40).all()
    ends = moments(moving("solid"), 100, rng) + far_off
    assert not bounder.segments(x, ends)[0].numpy().any()
    ends[:, 0] = 4.5  # segments that leave the range of time
    maybe, t = (part.numpy() for part in bounder.segments(x, ends))
    assert maybe.all()
    assert not t.any()
    for time in (1.9, 4.1, -np.inf, np.nan):
        x[:, 0] = time
        assert not bounder.distance(x).numpy().any()
        assert (bounder.query(x).numpy() == 1).all()


def test_a_moving_point_against_a_moving_mesh(rng):
    """What is cleared stays clear at all times, and a time of contact is not behind the first one that is found."""
    bounder, motion = far("solid"), moving("solid")
    a, b = (moments(motion, 300, rng) for _ in "ab")
    b[:50, 0] = a[:50, 0]  # at one time
    radius = rng.uniform(0, 0.3, 300) * (rng.random(300) > 0.5)
    maybe, t = (part.numpy() for part in bounder.segments(a, b, radius, steps=200))
    assert 0.05 < maybe.mean() < 0.95
    share = np.linspace(0, 1, 201)
    along = a[:, None].astype(np.float64) + share[None, :, None] * (b.astype(np.float64) - a)[:, None]
    touched = (motion.distances(along.reshape(-1, 4))[:, 1] <= np.repeat(radius, 201)).reshape(300, 201)
    assert not touched[maybe == 0].any()
    first = np.where(touched.any(axis=1), share[touched.argmax(axis=1)], 1.0)
    assert (t <= first).all()
    assert (t[maybe == 0] == 1).all()


def test_boxes_of_time_and_space(rng):
    bounder, motion = far("solid"), moving("solid")
    held = motion.points(200, rng).astype(np.float32)
    held = held[motion.decide(held) == IN]
    sides = rng.uniform(0, 0.2, held.shape).astype(np.float32)
    low, high = np.maximum(held - sides, motion.lower.astype(np.float32)), held + sides
    low[:, 0], high[:, 0] = np.clip(low[:, 0], 2, 4), np.clip(high[:, 0], 2, 4)
    assert bounder.boxes(low, high).numpy().all()
    away = np.float32([0, 9, 0, 0])
    assert not bounder.boxes(low + away, high + away).numpy().any()
    assert bounder.boxes(low + away + np.float32([3, 0, 0, 0]), high + away + np.float32([3, 0, 0, 0])).numpy().all()


@pytest.mark.parametrize("name", ["solid", "sheet"])
def test_hard_positives_are_not_missed(name):
    margin = 0.0 if name == "solid" else 0.1  # no float32 point lies on a face for certain
    check_hard_positives(far(name, margin), moving(name, margin), 800)


def test_marching_depends_on_the_speed(rng):
    """Points that stand still where the solid will come are not cleared, but would be if it stood still."""
    bounder, motion = far("solid"), moving("solid")
    inner = rng.dirichlet(np.ones(4), 300) @ motion.frames[-1].astype(np.float64)
    a, b = (np.insert(inner, 0, time, axis=1).astype(np.float32) for time in TIMES[::2])
    held = (bounder.distance(a).numpy() > 0) & (motion.decide(b) == IN)
    assert held.any()
    assert bounder.segments(a[held], b[held])[0].numpy().all()
    still = bounder.to()
    still.domain = dataclasses.replace(bounder.domain, speed=0.0)
    still._data = None
    assert not still.segments(a[held], b[held])[0].numpy().any()


@pytest.mark.parametrize("margin", [0.0, 0.1])
@pytest.mark.parametrize("name", ["solid", "sheet"])
def test_overestimates_hold(name, margin, rng):
    """No point of a box has more than what is said of it, for functions that are multilinear in it."""
    shape, count = moving(name, margin), 300
    low = moments(shape, count, rng).astype(np.float64)
    high = low + rng.uniform(0, 1, (count, 4)) * np.exp2(rng.uniform(-8, 0, (count, 1)))
    key = np.clip(np.searchsorted(TIMES, low[:, 0], side="right") - 1, 0, 1)
    high[:, 0] = np.minimum(high[:, 0], np.array(TIMES)[key + 1])
    values = shape.distances((low + high) / 2)[:, :1] + rng.normal(size=(count, 16)) * 0.1
    reported = shape.overestimate(low, high, values, -9.0)
    assert (reported <= values.max(axis=1)).all()
    assert (reported < values.max(axis=1) - 1e-3).mean() > 0.3
    assert (shape.overestimate(low, high, values, -9.0, enough=0.1) >= np.minimum(reported, 0.1)).all()
    for _ in range(40):
        u = rng.random((count, 4))
        weight = np.stack(
            [np.prod([u[:, k] if i >> k & 1 else 1 - u[:, k] for k in range(4)], axis=0) for i in range(16)]
        )
        f = (weight.T * values).sum(axis=1)
        assert (f - shape.distances(low + u * (high - low))[:, 1] <= reported).all()


def test_saved_loaded_certified(tmp_path, rng):
    bounder, motion = far("solid"), moving("solid")
    again = reloaded(bounder, tmp_path)
    x = moments(motion, 200, rng)
    assert (again.distance(x).numpy() == bounder.distance(x).numpy()).all()
    assert again.domain.speed == bounder.domain.speed > 0
    assert wb.certify(again, motion).proven
    slower = wb.shapes.MovingMesh(motion.frames * np.float32(1.1), motion.faces, TIMES)
    assert not wb.certify(again, slower).proven
    assert wb.evaluate(again, motion, samples=5000, radius=0.1).fn == 0


def test_a_certificate_needs_the_speed():
    """The threshold may hold, but what marches does not, if the file's speed is not that of the motion."""
    bounder = far("solid").to()
    bounder.domain = dataclasses.replace(bounder.domain, speed=bounder.domain.speed / 2)
    assert wb.certify(bounder, moving("solid")).kind != "proven"


def test_what_there_is_not():
    bounder = far("solid")
    with pytest.raises(QueryError, match="at rest"):
        bounder.rays(np.zeros((1, 8), np.float32), length=1.0)
    with pytest.raises(BounderError, match="moves"):
        wb.fit(moving("solid"), "distance", "aabb", device="cpu")
    grid = wb.shapes.Grid(np.eye(4, dtype=bool)[None].repeat(3, 0), time=True)
    with pytest.raises((BounderError, ShapeError), match=r"moves|time"):
        wb.fit(grid, "distance", "mlp", steps=1, device="cpu")


@cache
def closing() -> tuple[wb.shapes.MovingMesh, wb.DistanceBounder]:
    """A cup over which a lid closes and opens again; and a distance in it that falls faster than anything moves."""

    def box(lower, upper):
        return trimesh.creation.box(bounds=[lower, upper])

    walls = [box([-1, -1, -1], [1, 1, -0.8]), box([-1, -1, -1], [-0.8, 1, 1]), box([0.8, -1, -1], [1, 1, 1])]
    walls += [box([-1, -1, -1], [1, -0.8, 1]), box([-1, 0.8, -1], [1, 1, 1]), box([-1, -1, 3], [1, 1, 3.2])]
    mesh = trimesh.util.concatenate(walls)
    low = mesh.vertices.copy()
    low[-8:, 2] -= 2.1
    motion = wb.shapes.MovingMesh([mesh.vertices, low, mesh.vertices], mesh.faces, times=[0, 1, 2], name="cup")
    domain = DistanceDomain.of(motion, 0.1)
    # relu(c - |x|_1 - c h(t)): as far as the walls; h goes from 0 at 0.8 to 1 at 0.9, and back from 1.1 to 1.2
    scale, middle = domain.scale.astype(float), domain.to_local(np.array([1.0, 0, 0, 0]))
    first, bias = np.zeros((12, 4)), np.zeros(12)
    for k in range(1, 4):
        first[[2 * k - 2, 2 * k - 1], k] = 1, -1
        bias[[2 * k - 2, 2 * k - 1]] = -middle[k], middle[k]
    for row, (way, at) in enumerate([(1, 0.8), (1, 0.9), (1, 1.1), (1, 1.2)], 6):
        first[row, 0], bias[row] = way, -way * (at - float(domain.center[0])) * scale[0]
    fall = 0.6 * scale[1] / (0.1 * scale[0])
    second = np.zeros((12, 12))
    second[0, :10] = [-1] * 6 + [-fall, fall, fall, -fall]
    layers = (first, bias), (second, np.eye(12)[0] * 0.6 * scale[1]), (np.eye(1, 12), np.zeros(1))
    tensors = {
        f"layers.{k}.{name}": value.astype(np.float32)
        for k, layer in enumerate(layers)
        for name, value in zip(("weight", "bias"), layer, strict=True)
    }
    sizes = {"hidden": [12, 12], "activation": "relu"}
    bounder = MlpDistance(domain, tensors, sizes, "cpu").freeze(-1e-4, None)
    bounder.info = {"margin": 0.0}
    return motion, bounder


def enclosed(motion, low, high, count=33):
    """Whether a point of the segments from corner to corner is in the object, of many that are looked at."""
    share = np.linspace(0, 1, count)[:, None, None]
    return motion.contains(((1 - share) * low + share * high).reshape(-1, 4)).reshape(count, -1).any(axis=0)


def test_points_that_a_hole_closes_around_are_in_the_object(rng):
    """Nothing touches them, so a march may pass; distances, boxes of time and space and ``clear_segments`` tell."""
    motion, bounder = closing()
    x = np.zeros((2001, 4))
    x[:, 0] = np.linspace(0.0, 2.0, 2001)
    held = motion.contains(x)
    assert 50 < held.sum() < 400
    assert not bounder.distance(x).numpy()[held].any()
    assert not bounder.distance(x.astype(np.float32)).numpy()[held].any()
    assert (bounder.distance(x).numpy() > 0.5).mean() > 0.5
    a, b = np.zeros((2, 600, 4))
    a[:, 0] = rng.uniform(0, 2, 600)
    b[:, 0] = np.clip(a[:, 0] + rng.choice([-1, 1], 600) * np.exp2(rng.uniform(-10, 0, 600)), 0, 2)
    a[:, 1:], b[:, 1:] = rng.uniform(-0.1, 0.1, (2, 600, 3))
    a[0], b[0] = [0.5, 0, 0, 0], [1.5, 0, 0, 0]  # over all of it, outside at either end
    a[1], b[1] = [0.8, 0, 0, 0], [0.97, 0, 0, 0]  # into it
    met = enclosed(motion, a, b)
    assert met[:2].all()
    clear = wb.proof.clear_segments(bounder, a, b)
    assert not (clear & met).any()
    assert clear.mean() > 0.5
    low, high = np.minimum(a, b).astype(np.float32), np.maximum(a, b).astype(np.float32)
    free = bounder.boxes(low, high, steps=512).numpy() == 0
    assert not (free & enclosed(motion, low, high)).any()
    assert free.mean() > 0.2
    assert not bounder.segments(a[1:2], b[1:2])[0].numpy().any()  # which promises contact, and there is none


def test_no_place_of_a_moving_distance_is_behind_the_object(rng):
    """Random networks, whose F is often under the slack: there the object may be, and a segment is not clear."""
    domain, sizes = far("solid").domain, [(12, 4), (12, 12), (1, 12)]
    tensors = {f"layers.{i}.weight": rng.normal(0, 0.7, size).astype(np.float32) for i, size in enumerate(sizes)}
    tensors |= {f"layers.{i}.bias": rng.normal(0, 1, size[0]).astype(np.float32) for i, size in enumerate(sizes)}
    bounder = MlpDistance(domain, tensors, {"hidden": [12, 12], "activation": "sin"}, "cpu")
    v = rng.uniform(-1, 1, (1000, 4)) * domain.limit
    bounder.freeze(min(-float(np.float32(np.quantile(bounder.reference(v), 0.3))), 0.0), None)

    def contains(x: np.ndarray) -> np.ndarray:
        v = domain.to_local(x)
        return (np.abs(v) <= domain.limit).all(axis=1) & (bounder.reference(v) + float(bounder.threshold) <= 0)

    for _ in range(3):
        check_until(bounder, contains, *(moments(moving("solid"), COUNT, rng) for _ in "ab"))


@pytest.mark.parametrize("activation", ["sin", "relu"])
def test_the_pace_is_no_less_than_any_slope_in_time(activation, rng):
    """Over the whole domain, of random networks."""
    domain = far("solid").domain
    for size in (0.3, 1.5):
        tensors = {f"layers.{i}.weight": rng.normal(0, size, s) for i, s in enumerate([(12, 4), (12, 12), (1, 12)])}
        tensors |= {f"layers.{i}.bias": rng.normal(0, 1, s) for i, s in enumerate([12, 12, 1])}
        tensors = {name: value.astype(np.float32) for name, value in tensors.items()}
        bounder = MlpDistance(domain, tensors, {"hidden": [12, 12], "activation": activation}, "cpu")
        v = rng.uniform(-1, 1, (20_000, 4)) * domain.limit
        w = v.copy()
        w[:, 0] = rng.uniform(-1, 1, len(v)) * domain.limit[0]
        fall = np.abs(bounder.reference(v) - bounder.reference(w))
        assert (fall <= bounder.rate * np.abs(v[:, 0] - w[:, 0]) + 1e-12).all()
        assert bounder.pace >= domain.speed
        with pytest.raises(BounderError, match="parts have slacks of their own are gone"):
            MlpDistance(domain, tensors, bounder.sizes | {"shape": [3, 2, 1, 2]}, "cpu")
