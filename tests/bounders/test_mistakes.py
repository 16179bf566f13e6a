"""What users write by mistake gets one clear line: other units, radii without distances, other types, thresholds."""

import copy

import numpy as np
import pytest
import trimesh
import warp as wp

import warp_bounding as wb
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.queries import QUERIES

MILLIMETRES = 1000.0
MARCHES = "distance", "segment", "ray", "box"
BALL = trimesh.creation.icosphere(subdivisions=1)


@pytest.fixture(scope="module")
def bounders() -> dict[str, wb.Bounder]:
    grid = wb.load_shape(BALL).to_grid(resolution=8)
    lengths = {name: {"length": 0.5} if kind.has_length else {} for name, kind in QUERIES.items()}
    return {name: wb.fit(grid, name, "aabb", device="cpu", progress=False, **lengths[name]) for name in QUERIES}


def queries(kind: str, count: int, rng) -> np.ndarray:
    """Queries of a kind, near the ball, in metres."""
    a = rng.uniform(-1, 1, (count, 3))
    return np.concatenate([a, a + 0.1][: len(QUERIES[kind].directed)], axis=1).astype(np.float32)


def scaled(kind: str, x: np.ndarray) -> np.ndarray:
    """The same in millimetres."""
    parts = np.split(x, len(QUERIES[kind].directed), axis=1)
    both = zip(parts, QUERIES[kind].directed, strict=True)
    return np.concatenate([part if directed else part * np.float32(MILLIMETRES) for part, directed in both], axis=1)


@pytest.mark.parametrize("kind", list(QUERIES))
def test_a_batch_in_other_units_is_reported_once(kind, bounders, rng):
    for made in (np.asarray, np.ndarray.tolist):
        bounder, near = copy.deepcopy(bounders[kind]), queries(kind, 200, rng)
        bounder.query(made(near))
        bounder.query(made(near[:0].reshape(0, near.shape[1])))
        if kind == "plane":  # one through any point may meet the ball
            bounder.query(made(scaled(kind, near)))
            continue
        with pytest.warns(wb.BoundingWarning, match="all 200 queries lie far from .*: are they in other units"):
            answers = bounder.query(made(scaled(kind, near) + np.float32(100))).numpy()
        assert not answers.any()
        bounder.query(made(scaled(kind, near)))
        bounder.to("cpu").query(made(scaled(kind, near)))


def test_a_batch_that_may_be_meant_is_not_reported(bounders, rng):
    """Where one query is near, or nothing is known of it, or the shape is placed; what lies on a device is not read."""
    far = scaled("point", queries("point", 300, rng)) + np.float32(100)
    near, unknown = far.copy(), far.copy()
    near[7], unknown[:] = 0.5, np.nan
    spread = far * np.linspace(0, 0.05, 300, dtype=np.float32)[:, None]
    for x in (near, unknown, spread, wp.array(far, dtype=wp.vec3, device="cpu")):
        copy.deepcopy(bounders["point"]).query(x)
    copy.deepcopy(bounders["point"]).query(far, xform=wp.transform(wp.vec3(500.0), wp.quat_identity()))
    inside_out = copy.deepcopy(bounders["box"])
    assert inside_out.query(np.float32([[-900] * 3 + [900] * 3])).numpy().all()


def test_local_coordinates_of_a_shape_in_the_world_are_reported(rng):
    far = wb.load_shape(np.eye(4, dtype=bool)[None].repeat(4, 0), spacing=0.5, origin=(500000.13, 4649776.37, 12.0))
    bounder, local = wb.fit(far, method="aabb", device="cpu", progress=False), rng.uniform(0, 2, (50, 3))
    bounder.query(local + far.origin)
    bounder.local.query(local)
    with pytest.warns(wb.BoundingWarning, match=r"far from \[499999\.88.*, 4649776\.12.*, 11\.75\] to "):
        bounder.query(local)


def test_only_distances_have_radii(bounders):
    bounder, x = bounders["point"], np.zeros((1, 3), np.float32)
    for ask in (bounder.query, bounder.candidates):
        with pytest.raises(QueryError, match=r"radius: wb\.fit\(shape, 'distance'\)"):
            ask(x, radius=0.1)
    for name in ("distance", "segments", "rays", "boxes", "slack", *(f"{each}_func" for each in MARCHES)):
        assert hasattr(DistanceBounder, name)
        with pytest.raises(AttributeError, match=r"only distances have this: wb\.fit\(shape, 'distance'\)"):
            getattr(bounder, name)


def test_a_threshold_is_not_assigned(bounders):
    for kind in (bounders["point"], wb.cascade(bounders["point"], bounders["point"])):
        held = kind.threshold
        with pytest.raises(BounderError, match=r"cannot be assigned: bounder\.freeze\(0\.5, None\)"):
            kind.threshold = 0.5
        assert kind.threshold == held
        assert kind.to("cpu").freeze(held - 0.5, None).threshold == held - 0.5


@pytest.mark.parametrize("kind", ["point", "box", "distance"])
def test_a_function_says_what_it_takes(kind, bounders):
    far = wb.fit(wb.load_shape(BALL), "distance", "aabb", device="cpu", progress=False)
    bounder = far if kind == "distance" else bounders[kind]
    test = far.distance_func if kind == "distance" else bounder.func
    takes = {"point": "q: vec3f", "box": "a: vec3f, b: vec3f", "distance": "x: vec3f"}[kind]

    @wp.kernel(module="unique", enable_backward=False)
    def other_type(data: wb.Data, x: wp.array(dtype=wp.vec3d), answers: wp.array(dtype=float)):
        answers[0] = float(wp.static(test)(data, x[0]))

    @wp.kernel(module="unique", enable_backward=False)
    def other_order(data: wb.Data, x: wp.array(dtype=wp.vec3d), answers: wp.array(dtype=float)):
        answers[0] = float(wp.static(test)(wp.vec2(1.0, 2.0), data))

    for kernel, got in ((other_type, "Data, vec3d"), (other_order, "(vec2f|vector of 2 float32), Data")):
        inputs = [bounder.data, wp.zeros(1, dtype=wp.vec3d, device="cpu"), wp.zeros(1, dtype=float, device="cpu")]
        with pytest.raises(TypeError, match=rf"takes \(data: Data, {takes}\), got \({got}\); convert float64"):
            wp.launch(kernel, 1, inputs, device="cpu")
