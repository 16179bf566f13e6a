"""Coordinates far from 0, or between a lattice's places: nothing is denied, in float64 or float32."""

import pickle

import numpy as np
import pytest
import trimesh
from format_cases import T, V
from rewriting import rewrite

import warp_bounding as wb
from warp_bounding.shapes import load_shape
from warp_bounding.shapes.recentred import Frame, Recentred, recentred

UTM = np.array([500000.13, 4649776.37, 12.7])
BALL = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6


def site(origin=UTM):
    """Walls of 0.3 m around a yard, as vertices in float64."""
    boxes = [([0, 0, 0], [9, 0.3, 2]), ([0, 6, 0], [9, 6.3, 2]), ([0, 0, 0], [0.3, 6.3, 2])]
    walls = [trimesh.creation.box(bounds=np.array(box, float)) for box in boxes]
    joined = trimesh.util.concatenate(walls)
    return joined.vertices + origin, joined.faces, [np.array(box, float) for box in boxes]


def on_walls(boxes, count, rng) -> np.ndarray:
    """Points of walls, most of them on their borders: relative to the site."""
    lower, upper = np.array(boxes).transpose(1, 0, 2)
    which = rng.integers(len(boxes), size=count)
    share = rng.choice([0.0, 0.5, 1.0], (count, 3)) + (rng.random((count, 3)) < 0.3) * rng.uniform(
        -0.5, 0.5, (count, 3)
    )
    return lower[which] + (upper - lower)[which] * share.clip(0, 1)


@pytest.mark.parametrize("origin", [UTM, -UTM * 1000])
def test_walls_far_away_are_where_they_are(origin):
    vertices, faces, boxes = site(origin)
    shape = load_shape((vertices, faces))
    assert isinstance(shape, Recentred)
    np.testing.assert_allclose(shape.local.vertices + shape.origin, vertices, atol=2e-6, rtol=0)
    assert np.abs(shape.local.vertices).max() < 20
    bounder = wb.fit(shape, method="aabb", margin=1e-5, device="cpu")
    x = on_walls(boxes, 2000, np.random.default_rng(0)) + origin
    assert bounder.query(x).numpy().all()
    assert shape.dilated(1e-5).contains(x).all()
    yard = np.array([[4.0, 3.0, 1.0], [4.0, 0.4, 1.0], [4.0, -0.1, 1.0]]) + origin
    assert not shape.contains(yard).any()
    assert bounder.query(yard).numpy().tolist() == [1, 1, 0]
    assert wb.certify(bounder, shape).proven


def test_only_what_float32_would_move_is_recentred():
    assert not isinstance(load_shape((np.float32(V) + np.float32(1000), T)), Recentred)  # float32 already
    assert not isinstance(load_shape((V.astype(float) / 3 + 1, T)), Recentred)
    vertices, frame = recentred(V.astype(float) / 3 + 100.1)
    assert frame is not None
    assert np.abs(vertices).max() < 2
    with pytest.raises(wb.BoundingError, match="too coarse"):
        wb.shapes.Mesh(V.astype(float) + UTM, T)
    frames = np.stack([V.astype(float) + UTM, V.astype(float) + UTM + 1])
    with pytest.raises(wb.BoundingError, match="too coarse"):
        wb.shapes.MovingMesh(frames, T)


def far_ball(frame=None):
    return Recentred(load_shape(BALL, spacing=0.1), frame or Frame(tuple(UTM.tolist()), (0.0, 0.0, 0.0)))


@pytest.fixture(scope="module")
def bounder():
    return wb.fit(far_ball(), method="aabb", device="cpu")


def test_every_type_of_numbers_is_of_the_world(bounder):
    import torch
    import warp as wp

    x = UTM + np.random.default_rng(0).uniform(-0.5, 2, (300, 3))
    expected = bounder.local.query((x - UTM).astype(np.float32)).numpy()
    assert 0 < expected.sum() < len(x)
    for given in (x, x.tolist(), torch.from_numpy(x), wp.array(x, dtype=wp.vec3d, device="cpu")):
        np.testing.assert_array_equal(bounder.query(given).numpy(), expected)
    coarse = x.astype(np.float32)  # half a metre coarse: exactly these numbers are asked
    expected = bounder.local.query((coarse.astype(float) - UTM).astype(np.float32)).numpy()
    for given in (coarse, torch.from_numpy(coarse), wp.array(coarse, dtype=wp.vec3, device="cpu")):
        np.testing.assert_array_equal(bounder.query(given).numpy(), expected)
    with pytest.raises(wb.BounderError, match="beside the ones asked for"):
        wb.fit(far_ball(Frame(tuple(UTM), (0.01, 0.0, 0.0))), method="aabb", device="cpu")
    assert bounder.query(np.zeros((0, 3))).shape == (0,)
    assert bounder.query(np.array([[np.nan, *UTM[1:]], [np.inf, *UTM[1:]]])).numpy().all()
    with pytest.raises(wb.QueryError, match="shape"):
        bounder.query(np.zeros((3, 2)))


def test_what_reads_float32_in_place_is_asked_of_the_local_bounder(bounder):
    x = np.zeros((4, 3), np.float32)
    both = wb.two_sided(bounder, wb.fit(far_ball(), side="inside", hidden=(8,), steps=30, device="cpu"))
    for ask in (
        lambda: bounder.func,
        lambda: bounder.prepare(x),
        lambda: bounder.query(x, scale=1.0),
        lambda: bounder.values(x, xform=np.eye(4)),
        lambda: wb.proof.clear_segments(bounder, x, x),
        lambda: both.func,
    ):
        with pytest.raises(wb.QueryError, match=r"bounder\.local"):
            ask()
    assert both.classify(UTM[None] + 0.75).numpy()[0] > 0
    local = bounder.local
    assert local.frame is None
    assert local.prepare(x).launch().numpy().tolist() == local.query(x).numpy().tolist()
    assert local.local is local
    with pytest.raises(wb.BoundingError, match="origin"):
        wb.cascade(bounder, local)
    both = wb.cascade(*(wb.fit(far_ball(), method=m, device="cpu") for m in ("aabb", "kdop")))
    inner = UTM + np.random.default_rng(1).uniform(0.5, 1.0, (3000, 3))
    assert far_ball().contains(inner).all()
    assert both.frame == bounder.frame
    assert both.query(inner).numpy().all()
    assert wb.certify(both, far_ball()).proven
    with pytest.raises(wb.BoundingError, match=r"shape\.local"):
        wb.choose(far_ball(), narrow_ns=100.0)


def test_files_keep_the_origin_and_certify_checks_it(bounder, tmp_path):
    path = tmp_path / "a.safetensors"
    bounder.save(path)
    again = wb.load(path, device="cpu")
    assert again.frame == bounder.frame == pickle.loads(pickle.dumps(bounder)).frame
    assert pickle.loads(pickle.dumps(far_ball())).digest == far_ball().digest
    assert "origin" in again.certificate.message
    for other in (
        far_ball().local,
        far_ball(Frame((500000.14, *UTM[1:]), (0.0,) * 3)),
        far_ball(Frame(tuple(UTM), (0.01,) * 3)),
    ):
        found = wb.certify(again, other)
        assert (found.kind, "origin" in found.message) == ("inapplicable", True)
        with pytest.raises(wb.BoundingError, match="origin"):
            wb.evaluate(again, other, samples=10)
    assert wb.certify(again.local, far_ball()).kind == "inapplicable"

    def written(**changes):
        def change(document):
            assert document["format"] == 2
            document.update(changes)
            if document["frame"] is None:
                del document["frame"]

        bounder.save(path)
        rewrite(path, change)
        return path

    moved = wb.load(written(frame={"origin": [0.0, 0, 0], "blur": [0.0, 0, 0]}), device="cpu")
    assert wb.certify(moved, far_ball()).kind == "inapplicable"  # who lies about it is found out
    for changes in (
        {"format": 1},
        {"frame": None},
        {"frame": {"origin": [0.0, 0, 0], "blur": [0.0, 0, -1]}},
        {"frame": {"origin": [0.0, 0], "blur": [0.0, 0]}},
        {"frame": {"origin": ["0", 0, 0], "blur": [0.0, 0, 0]}},
        {"frame": {"origin": [0.0, 0, 0], "blur": [1.0, 0, 0]}},  # more than delta holds
    ):
        with pytest.raises(wb.FileFormatError):
            wb.load(written(**changes), device="cpu")


@pytest.mark.parametrize("method", ["kdop", "aabb"])
def test_distances_are_never_too_large(method):
    shape = far_ball(Frame(tuple(UTM.tolist()), (1e-4, 0.0, 2e-4)))
    far = wb.fit(shape, "distance", method, device="cpu")
    rng = np.random.default_rng(2)
    x = UTM + rng.uniform(-2, 4, (2000, 3))
    cells = shape.local.position(shape.local.occupied)
    nearest = np.linalg.norm((np.abs((x - UTM)[:, None] - cells[None]) - 0.05).clip(0), axis=2).min(axis=1)
    g = far.distance(x).numpy().astype(float)
    assert (g <= np.maximum(nearest - np.linalg.norm([1e-4, 2e-4]), 0) + 1e-12).all()
    assert g.max() > 1
    inside = x[nearest <= np.linalg.norm([1e-4, 2e-4])]
    assert far.query(inside).numpy().all()
    assert far.segments(x[:50], np.tile(UTM + 0.75, (50, 1)))[0].numpy().all()
    towards = np.concatenate([x, UTM + 0.75 - x], axis=1)[:50]
    assert far.rays(towards, length=20.0)[0].numpy().all()
    with pytest.raises(wb.QueryError, match="fit box queries"):
        far.boxes(x, x + 0.1)
    with pytest.raises(wb.QueryError, match=r"bounder\.local"):
        _ = far.distance_func
    bounds = shape.distances(x)
    assert (bounds[:, 0] <= np.maximum(nearest - 1e-4, 0) + 1e-9).all()
    assert (bounds[:, 1] >= nearest - 1e-12).all()


@pytest.mark.parametrize(
    ("spacing", "origin"), [(0.03, (1000.013, -7.7)), (0.15, (0.011, 0.0)), ((0.07, 0.3), (-5e5, 4.7e6))]
)
def test_cells_whose_size_has_no_float32_inverse(spacing, origin):
    array = np.zeros((700, 500), bool)
    array[3, 2] = array[640:690, 450:499] = True
    shape = load_shape(array, spacing=spacing, origin=origin)
    bounder = wb.fit(shape, method="aabb", device="cpu")
    step = np.broadcast_to(spacing, 2)
    shares = np.array([[a, b] for a in (-0.5, 0, 0.5) for b in (-0.5, 0, 0.5)])
    x = ((np.argwhere(array)[:, None] + shares) * step + origin).reshape(-1, 2)
    assert bounder.query(x).numpy().all()
    assert shape.contains(x).all()
    assert max(shape.coordinates.blur) > 0
    assert not shape.empty(x - 1e-9, x + 1e-9).any()
    free = np.argwhere(~array)[::97] * step + origin
    assert not shape.contains(free).any()
    assert shape.empty(free - step / 3, free + step / 3).all()
    assert not shape.inside(free - step, free + step).any()
