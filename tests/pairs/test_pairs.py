"""Pairs of placed meshes: never *no* and never too far where two are near, whatever the placements; and their balls."""

import numpy as np
import pytest
import trimesh
import warp as wp
from plain_shapes import ball_at, box_of
from reading_order import ROOT
from scipy.spatial.transform import Rotation

import warp_bounding as wb
from warp_bounding.bounders.file_format import read, write
from warp_bounding.cli import main
from warp_bounding.pairs import Balls, Pair, PairData, kernels
from warp_bounding.pairs.pair import distance_func, query_func

HERE = np.array([[0, 0, 0, 0, 0, 0, 1]], np.float32)
TORUS = trimesh.creation.torus(1.0, 0.25, major_sections=24, minor_sections=10)


@pytest.fixture(scope="module")
def mesh() -> wb.shapes.Mesh:
    return wb.shapes.Mesh(TORUS.vertices, TORUS.faces, name="ring")


@pytest.fixture(scope="module")
def held(mesh) -> Balls:
    return Balls.of(mesh, 64)


@pytest.fixture(scope="module")
def pairs(mesh, held) -> list[Pair]:
    """A box's distance holds everywhere; one of interpolated nodes is evaluated in its domain."""
    found = [wb.fit(mesh, "distance", "aabb", device="cpu")]
    found.append(wb.fit(mesh, "distance", "distance-grid", nodes=10, budget=60, device="cpu"))
    return [Pair(bounder, held) for bounder in found]


def placements(count: int, rng: np.random.Generator, spread: float = 2.0) -> np.ndarray:
    turns = Rotation.random(count, random_state=rng).as_quat()
    return np.concatenate([rng.normal(size=(count, 3)) * spread, turns], axis=1).astype(np.float32)


def placed(points: np.ndarray, places: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Where placements ``(N, 7)`` and scales ``(N, 3)`` put points ``(P, 3)`` or ``(N, P, 3)``: ``(N, P, 3)``."""
    x = points.astype(np.float64) * scale[:, None].astype(np.float64)
    turns = Rotation.from_quat(places[:, 3:].astype(np.float64)).as_matrix()
    return np.einsum("nij,npj->npi", turns, x) + places[:, None, :3].astype(np.float64)


def apart(mesh, a, b, scale_a, scale_b, points) -> np.ndarray:
    """``(N,)``: upper bounds of the distance between two placed copies; scales lengthen by the largest one."""
    at = placed(points, b, scale_b) - a[:, None, :3].astype(np.float64)
    turns = Rotation.from_quat(a[:, 3:].astype(np.float64)).as_matrix()
    own = np.einsum("nji,npj->npi", turns, at) / scale_a[:, None].astype(np.float64)
    high = mesh.distances(own.reshape(-1, 3))[:, 1].reshape(len(a), -1)
    return high.min(axis=1) * np.abs(scale_a).max(axis=1)


def touching(mesh, a, b, scale_a, scale_b, away: float, rng: np.random.Generator) -> np.ndarray:
    """Placements of B moved so that a vertex of it is ``away`` from a vertex of A; rounded to float32."""
    vertices = mesh.vertices.astype(np.float64)
    of_a, of_b = (vertices[rng.integers(len(vertices), size=len(a))] for _ in range(2))
    still = b.copy()
    still[:, :3] = 0
    at_a, at_b = placed(of_a[:, None], a, scale_a)[:, 0], placed(of_b[:, None], still, scale_b)[:, 0]
    step = rng.normal(size=(len(a), 3))
    found = b.copy()
    found[:, :3] = at_a - at_b + away * step / np.linalg.norm(step, axis=1, keepdims=True)
    return found


SCALES = {
    "none": lambda count, rng: np.ones((count, 3), np.float32),
    "sizes": lambda count, rng: np.repeat(np.exp2(rng.uniform(-3, 3, (count, 1))), 3, 1).astype(np.float32),
    "mirrored": lambda count, rng: (np.exp2(rng.uniform(-2, 2, (count, 3))) * [-1, 1, 1]).astype(np.float32),
}


@pytest.mark.parametrize("scaled", SCALES)
def test_what_may_touch_is_never_denied(mesh, pairs, scaled):
    rng = np.random.default_rng(3)
    count, gap = 300, 0.05
    points = np.concatenate([mesh.vertices, mesh.points(300, rng)]).astype(np.float64)
    scale_a, scale_b = SCALES[scaled](count, rng), SCALES[scaled](count, rng)
    for away in (None, 0.0, gap * (1 - 1e-6)):
        a, b = placements(count, rng), placements(count, rng)
        if away is not None:
            b = touching(mesh, a, b, scale_a, scale_b, away, rng)
        high = apart(mesh, a, b, scale_a, scale_b, points)
        for pair in pairs:
            maybe = pair.query(a, b, gap, scale_a=scale_a, scale_b=scale_b).numpy()
            low = pair.distance(a, b, scale_a=scale_a, scale_b=scale_b).numpy()
            assert (low <= high).all()
            assert maybe[high <= gap].all()
            assert (low[maybe == 0] > 0).all()
            if away is None:
                assert (maybe == 0).any()


def test_a_ball_is_never_told_farther_than_it_is(held):
    """One ball against a box, whose distances are known: what float32 makes of placements is taken off."""
    rng = np.random.default_rng(5)
    middle, half = np.array([[0.25, -0.5, 0.125]], np.float32), np.array([0.75, 0.5, 0.25], np.float32)
    far = wb.fit(box_of((middle - half)[0], (middle + half)[0]), "distance", "aabb", device="cpu")
    center, radius = np.array([[0.3, 0.7, -0.2]], np.float32), np.array([0.1], np.float32)
    pair, count = Pair(far, Balls(center, radius, "")), 20000
    for size, spread in ((1.0, 3.0), (1.0, 1e4), (1e5, 1.0), (1e-5, 1.0)):
        a, b = placements(count, rng, spread), placements(count, rng, spread)
        near = rng.random(count) < 0.5
        b[near, :3] = a[near, :3] + rng.normal(size=(near.sum(), 3)) * size
        of = np.exp2(rng.uniform(-1, 1, (count, 1))) * size * rng.choice([-1, 1], (count, 3))
        scale = of.astype(np.float32)
        one = np.ones(3) * np.abs(scale[:, :1])
        at_a, ends = placed(middle, a, scale), placed(middle + np.eye(3), a, scale)
        at_b, axes = placed(center, b, scale), ends - at_a
        along = np.abs(((at_b - at_a) * axes).sum(axis=2)) / np.linalg.norm(axes, axis=2)
        outside = np.linalg.norm(np.maximum(along - half * one, 0), axis=1)
        true = outside - one[:, 0].astype(np.float64) * float(radius[0])
        low = pair.distance(a, b, scale_a=scale, scale_b=scale).numpy()
        assert (low <= np.maximum(true, 0)).all()
        assert (low[true > size] > 0).mean() > 0.9


def test_kernels_answer_as_batches_do(pairs):
    rng = np.random.default_rng(7)
    a, b = placements(200, rng), placements(200, rng)
    for pair in pairs:
        query, distance = query_func(pair.bounder.source), distance_func(pair.bounder.source)

        @wp.kernel(module="unique")
        def ask(
            data: PairData,
            a: wp.array(dtype=wp.transform),
            b: wp.array(dtype=wp.transform),
            maybe: wp.array(dtype=wp.bool),
            low: wp.array(dtype=float),
        ):
            i = wp.tid()
            maybe[i] = wp.static(query)(data, a[i], b[i], 0.1)  # noqa: B023
            low[i] = wp.static(distance)(data, a[i], b[i])  # noqa: B023

        xa, xb = (wp.array(x, dtype=wp.transform, device="cpu") for x in (a, b))
        maybe, low = wp.zeros(200, dtype=wp.bool, device="cpu"), wp.zeros(200, dtype=float, device="cpu")
        wp.launch(ask, 200, [pair.data, xa, xb, maybe, low], device="cpu")
        away = pair.distance(xa, xb).numpy()  # compilers fuse what they like, and the proof lets them
        assert np.abs(low.numpy() - away).max() < 1e-4
        clear = np.abs(away - 0.1) > 1e-4
        assert (maybe.numpy() == pair.query(xa, xb, 0.1).numpy())[clear].all()
        other = PairData()
        other.bounder, other.slots, other.links = pairs[0].bounder.data, pair.data.slots, pair.data.links
        if pair is not pairs[0]:  # another source's data
            wp.launch(ask, 200, [other, xa, xb, maybe, low], device="cpu")
            assert maybe.numpy().all()
            assert not low.numpy().any()


def test_nothing_touches_before_the_contact_time(mesh, pairs):
    rng = np.random.default_rng(11)
    count, duration, gap = 40, 2.0, 0.02
    a, b = placements(count, rng), placements(count, rng)
    velocities = [np.concatenate([rng.normal(size=(count, 3)), 2 * rng.normal(size=(count, 3))], 1) for _ in range(2)]
    velocities = [v.astype(np.float32) for v in velocities]
    ones, points = np.ones((count, 3), np.float32), mesh.vertices.astype(np.float64)

    def at(places, v, t):
        found = places.astype(np.float64)
        found[:, :3] += v[:, :3].astype(np.float64) * t[:, None]
        turn = Rotation.from_rotvec(v[:, 3:].astype(np.float64) * t[:, None])
        found[:, 3:] = (turn * Rotation.from_quat(found[:, 3:])).as_quat()
        return found

    for pair in pairs:
        maybe, t = (x.numpy() for x in pair.contact_time(a, b, *velocities, gap, duration=duration))
        assert ((maybe == 1) | (t == duration)).all()
        assert (t <= duration).all()
        assert (t > 0).any()
        for share in np.linspace(0, 1 - 1e-9, 25):
            now = t.astype(np.float64) * share
            high = apart(mesh, at(a, velocities[0], now), at(b, velocities[1], now), ones, ones, points)
            assert (high[t > 0] > gap).all()
    still = np.zeros((1, 6), np.float32)
    maybe, t = (x.numpy() for x in pairs[0].contact_time(a, b, still, still, gap, duration=duration))
    assert (maybe == pairs[0].query(a, b, gap).numpy()).all()


def test_double_placements_are_counted(mesh, pairs):
    """A float64 place is not a float32 one: far from the origin the difference is larger than the gap."""
    rng = np.random.default_rng(13)
    count = 200
    a, b = (placements(count, rng).astype(np.float64) for _ in range(2))
    for places in (a, b):
        places[:, 3:] /= np.linalg.norm(places[:, 3:], axis=1, keepdims=True)
    ones = np.ones((count, 3))
    points = mesh.vertices.astype(np.float64)
    b = b + 0.0
    b[:, :3] = a[:, :3] + placed(points[:1], a * [0, 0, 0, 1, 1, 1, 1], ones)[:, 0]
    b[:, :3] -= placed(points[1:2], b * [0, 0, 0, 1, 1, 1, 1], ones)[:, 0]
    for places in (a, b):
        places[:, :3] += 1e6  # two vertices touch
    for pair in pairs:
        assert pair.query(a, b).numpy().all()
        assert not pair.distance(a, b).numpy().any()


def test_every_ball_of_the_tree_holds_its_children(held):
    slots, links = held.tree
    seen = []

    def walk(group: int, above: tuple[np.ndarray, float] | None) -> None:
        for i in range(kernels.GROUP):
            center, radius = slots[group, :3, i].astype(np.float64), float(slots[group, 3, i])
            if radius == -np.inf:
                assert links[group, i] == -1
                continue
            if above is not None:  # exact but for float64, whose rounding is far under a float32 unit
                assert np.linalg.norm(center - above[0]) + radius <= above[1]
            if links[group, i] < 0:
                seen.append((*center, radius))
            else:
                walk(int(links[group, i]), (center, radius))

    walk(0, None)
    stored = np.column_stack([held.centers, held.radii]).astype(np.float64)
    assert sorted(map(tuple, stored)) == sorted(seen)


def test_balls_hold_points_of_the_solid(mesh, held):
    rng = np.random.default_rng(1)
    points = rng.uniform(mesh.lower, mesh.upper, (4000, 3))
    points = np.concatenate([points[mesh.decide(points) == wb.shapes.shape.IN], mesh.corners(), mesh.points(2000, rng)])
    away = np.linalg.norm(points[:, None] - held.centers.astype(np.float64), axis=2) - held.radii
    assert (away.min(axis=1) <= 1e-12).all()  # points on faces are rounded
    assert held.certify(mesh).proven


def test_certify_finds_what_is_missing(mesh, held):
    for k in (0, len(held.radii) // 2):
        fewer = Balls(np.delete(held.centers, k, 0), np.delete(held.radii, k), held.mesh)
        found = fewer.certify(mesh)
        assert found.kind == "refuted"
        point = np.array(found.counterexample)
        assert mesh.contains(point[None])[0]
        assert (np.linalg.norm(point - fewer.centers, axis=1) > fewer.radii).all()
    smaller = Balls(held.centers, held.radii * np.float32(0.98), held.mesh)
    assert not smaller.certify(mesh).proven
    huge = np.append(held.centers, np.float32([[1e9, 0, 0]]), 0), np.append(held.radii, np.float32(9e8))
    # next to this ball the KD-tree cannot tell the others apart
    found = Balls(*huge, held.mesh).certify(mesh, budget=20.0)
    assert found.kind != "refuted"
    assert held.certify(mesh.dilated(0.1)).kind == "inapplicable"
    assert held.certify(ball_at([0, 0, 0], 1.0)).kind == "inapplicable"
    assert held.certify(mesh, budget=0.0).kind == "undecided"


def test_what_certify_proves_of_spoilt_balls_is_true(mesh, held):
    """Balls that shrink, move, are lost or swapped: whatever is still called proven holds the solid."""
    rng, kinds = np.random.default_rng(17), []
    points = rng.uniform(mesh.lower, mesh.upper, (4000, 3))
    points = np.concatenate([points[mesh.decide(points) == wb.shapes.shape.IN], mesh.corners()])
    for _ in range(24):
        centers, radii, k = held.centers.copy(), held.radii.copy(), rng.integers(len(held.radii))
        spoilt = rng.integers(4)
        if spoilt == 0:
            radii[k] *= np.float32(1 - 2.0 ** rng.uniform(-12, -2))
        elif spoilt == 1:
            centers[k] += rng.normal(size=3).astype(np.float32) * radii[k] * np.float32(2.0 ** rng.uniform(-12, -2))
        elif spoilt == 2:
            centers, radii = np.delete(centers, k, 0), np.delete(radii, k)
        else:
            radii[[k, k - 1]] = radii[[k - 1, k]]
        found = Balls(centers, radii, held.mesh).certify(mesh)
        kinds.append(found.kind)
        if found.proven:
            away = np.linalg.norm(points[:, None] - centers.astype(np.float64), axis=2) - radii
            assert (away.min(axis=1) <= 0).all()
    assert {"refuted", "proven"} <= set(kinds)


@pytest.mark.parametrize("kind", ["open", "dilated", "inside out", "flat"])
def test_other_meshes_are_held_too(mesh, kind):
    if kind == "open":
        other = wb.shapes.Mesh(mesh.vertices, mesh.faces[5:])
    elif kind == "dilated":
        other = mesh.dilated(0.05)
    elif kind == "inside out":
        other = wb.shapes.Mesh(mesh.vertices, mesh.faces[:, ::-1])
    else:
        other = wb.shapes.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    found = Balls.of(other, 32)
    assert found.certify(other).proven
    assert len(found.radii) <= 32


def test_balls_of_a_thin_part_stay_near_it():
    block, plate = trimesh.creation.box((1, 0.3, 0.3)), trimesh.creation.box((0.6, 0.6, 5e-5))
    both = trimesh.util.concatenate([block, plate.apply_translation((0, 0, 0.4))])
    mesh = wb.shapes.Mesh(both.vertices.astype(np.float32), both.faces)
    balls = Balls.of(mesh, 64)
    assert mesh.distances(balls.centers.astype(float)).max() < 0.01
    assert balls.radii.max() < 0.3
    assert balls.certify(mesh).kind == "proven"


def test_files(held, mesh, tmp_path, capsys):
    path = tmp_path / "ring.safetensors"
    held.save(path)
    again = Balls.load(path)
    assert (again.centers == held.centers).all()
    assert (again.radii == held.radii).all()
    assert (again.mesh, again.name) == (mesh.digest, "ring")
    with pytest.raises(wb.FileFormatError, match=r"Balls\.load"):
        wb.load(path)
    shape = tmp_path / "ring.obj"
    rows = ["v {:.9g} {:.9g} {:.9g}".format(*v) for v in mesh.vertices]
    shape.write_text("\n".join([*rows, *("f {} {} {}".format(*(f + 1)) for f in mesh.faces)]) + "\n")
    with pytest.raises(SystemExit) as ended:
        main(["certify", str(path), str(shape)])
    assert ended.value.code == 0
    assert "balls hold the solid of ring.obj" in capsys.readouterr().out
    with pytest.raises(SystemExit) as ended:
        main(["certify", str(path), str(shape), "--jobs", "2", "--margin", "0.1"])
    assert ended.value.code == 2
    assert "leave out --margin, --jobs" in capsys.readouterr().err
    tensors, document = read(path)
    write(path, {"centers": tensors["centers"], "radii": -tensors["radii"]}, document)
    with pytest.raises(wb.FileFormatError, match="radii of at least 0"):
        Balls.load(path)
    write(path, {"centers": tensors["centers"]}, document)
    with pytest.raises(wb.FileFormatError, match="missing"):
        Balls.load(path)
    with pytest.raises(wb.FileFormatError, match="expected balls"):
        Balls.load(next((ROOT / "sims/bounders").glob("*-mlp.safetensors")))


def test_what_has_no_answer_is_maybe(pairs):
    far = HERE.copy()
    far[0, 0] = 50
    assert not pairs[0].query(HERE, far).numpy()[0]
    bad = {
        "nan": far + np.float32([np.nan, 0, 0, 0, 0, 0, 0]),
        "infinite": far + np.float32([np.inf, 0, 0, 0, 0, 0, 0]),
        "quaternion": far * np.float32([1, 1, 1, 1, 1, 1, 1.1]),
        "no turn": far * np.float32([1, 1, 1, 0, 0, 0, 0]),
    }
    for pair in pairs:
        for places in bad.values():
            assert pair.query(HERE, places).numpy()[0] == 1
            assert pair.query(places, HERE).numpy()[0] == 1
            assert pair.distance(HERE, places).numpy()[0] == 0
        for scale in (0.0, np.nan, np.inf, 2.0**-41, 2.0**41):
            given = np.full((1, 3), scale, np.float32)
            assert pair.query(HERE, far, scale_a=given).numpy()[0] == 1
            assert pair.distance(HERE, far, scale_b=given).numpy()[0] == 0


def test_bad_input(pairs, mesh, held):
    pair = pairs[0]
    cases = {
        "as many": lambda: pair.query(np.repeat(HERE, 2, 0), np.repeat(HERE, 3, 0)),
        r"\(N, 7\)": lambda: pair.query(HERE[:, :6], HERE),
        "gap must be": lambda: pair.query(HERE, HERE, -1.0),
        "duration": lambda: pair.contact_time(HERE, HERE, np.zeros((1, 6)), np.zeros((1, 6)), duration=0.0),
        "steps": lambda: pair.contact_time(HERE, HERE, np.zeros((1, 6)), np.zeros((1, 6)), steps=0),
        r"\(N, 6\)": lambda: pair.contact_time(HERE, HERE, np.zeros((1, 3)), np.zeros((1, 6))),
    }
    for message, call in cases.items():
        with pytest.raises(wb.QueryError, match=message):
            call()
    with pytest.raises(wb.BounderError, match="distance bounder"):
        Pair(wb.fit(mesh, method="aabb", device="cpu"), held)
    with pytest.raises(wb.BounderError, match=r"Balls\.of"):
        Pair(pair.bounder, held.centers)
    with pytest.raises(wb.BounderError, match="count must be"):
        Balls.of(mesh, 4)
    with pytest.raises(wb.ShapeError, match="balls hold meshes"):
        Balls.of(np.linalg.norm(np.indices((8, 8, 8)) - 3.5, axis=0) < 3)


def test_one_placement_serves_all(pairs):
    b = placements(50, np.random.default_rng(2))
    for pair in pairs:
        assert (pair.distance(HERE, b).numpy() == pair.distance(np.repeat(HERE, 50, 0), b).numpy()).all()
        assert len(pair.query(HERE, b[:0]).numpy()) == 0


def test_balls_all_around_equally_far(pairs):
    """Every group of a level waits before the first leaf is asked."""
    x = np.random.default_rng(19).normal(size=(4096, 3))  # 512 groups of leaves
    around = (10 * x / np.linalg.norm(x, axis=1, keepdims=True)).astype(np.float32)
    pair = Pair(pairs[0].bounder, Balls(around, np.full(len(x), 0.01, np.float32), ""))
    assert 8 < pair.distance(HERE, HERE).numpy()[0] < 9
    assert not pair.query(HERE, HERE, 8.0).numpy()[0]


@pytest.mark.parametrize("speed", [1e-30, 2.2e-23, 1e-45])
def test_slow_ones_arrive_too(pairs, speed):
    """Squares of these speeds are no float32 numbers."""
    point = Pair(pairs[0].bounder, Balls(np.zeros((1, 3), np.float32), np.zeros(1, np.float32), ""))
    scale = np.full((1, 3), 2.0**-39, np.float32)
    there = HERE * 0 + np.float32([2e-11, 0, 0, 0, 0, 0, 1])
    velocity, still = np.float32([[-speed, 0, 0, 0, 0, 0]]), np.zeros((1, 6), np.float32)
    arrival = 2e-11 / speed
    given = (HERE, there, still, velocity)
    maybe, t = (x.numpy() for x in point.contact_time(*given, duration=min(2 * arrival, 1e36), scale_a=scale))
    assert maybe[0] or t[0] < arrival
    assert t[0] <= arrival
