"""Enclosed air: what is empty is certainly empty, what is filled is said, and meshes and cells agree."""

from functools import reduce

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.shape import IN, OUT


def box(half: float, inverted: bool = False) -> trimesh.Trimesh:
    made = trimesh.creation.box(extents=[2 * half] * 3)
    if inverted:
        made.invert()
    return made


def walls() -> list[trimesh.Trimesh]:
    """Six boxes that run through one another: a room without a door."""
    made = []
    for axis in range(3):
        for low, high in ((-1, -0.8), (0.8, 1)):
            corners = np.array([[-1.0] * 3, [1.0] * 3])
            corners[:, axis] = low, high
            made.append(trimesh.creation.box(bounds=corners))
    return made


def cube(half: float):
    return lambda x: np.abs(x).max(axis=1) <= half


def hole(half: float):
    return lambda x: np.abs(x).max(axis=1) < half


TANK = [box(1), box(0.8, True)]
# name: parts, which points are solid, closed hollows
CASES = {
    "tank": (TANK, lambda x: cube(1)(x) & ~hole(0.8)(x), 1),
    "tank turned inside out": ([box(1, True), box(0.8)], lambda x: cube(1)(x) & ~hole(0.8)(x), 1),
    "thin tank": ([box(1), box(0.999, True)], lambda x: cube(1)(x) & ~hole(0.999)(x), 1),
    "tank in a tank": (
        [*TANK, box(0.6), box(0.4, True)],
        lambda x: (cube(1)(x) & ~hole(0.8)(x)) | (cube(0.6)(x) & ~hole(0.4)(x)),
        2,
    ),
    "room of walls": (walls(), lambda x: cube(1)(x) & ~hole(0.8)(x), 1),
    "box in a box": ([box(1), box(0.5)], cube(1), 0),  # both turned outwards: solid twice over
    "boxes that overlap": (
        [trimesh.creation.box(bounds=[[-1] * 3, [0.3] * 3]), trimesh.creation.box(bounds=[[-0.3] * 3, [1] * 3])],
        lambda x: ((x >= -1) & (x <= 0.3)).all(axis=1) | ((x >= -0.3) & (x <= 1)).all(axis=1),
        0,
    ),
}


def made(parts, **options):
    joined = trimesh.util.concatenate(parts)
    return load_indicator((joined.vertices, joined.faces), **options)


@pytest.mark.parametrize("name", CASES)
def test_empty_hollows_of_a_mesh(name):
    parts, solid, hollows = CASES[name]
    filled, empty = (made(parts, hollow=hollow) for hollow in ("filled", "empty"))
    words = f"{hollows} closed hollow{'s' * (hollows != 1)} " if hollows else ""
    assert (filled.remark, empty.remark) == tuple(words + word if words else "" for word in ("filled", "empty"))
    assert filled.digest != empty.digest
    assert filled.digest == made(parts).digest
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.2, 1.2, (6000, 3))
    x[:1000] = np.round(x[:1000] * 10) / 10  # on faces, edges and diagonals
    truth, found = solid(x), empty.decide(x)
    on = np.isclose(np.abs(x)[..., None], [1, 0.999, 0.8, 0.6, 0.5, 0.4, 0.3]).any(axis=(1, 2))
    assert not (truth & ~on & (found == OUT)).any()
    assert not (~truth & ~on & (found == IN)).any()
    assert ((found == OUT) == ~truth)[~on].mean() > 0.99
    reach = rng.uniform(0, 0.2, (6000, 1))
    lower, upper = x - reach, x + reach
    inner = solid((lower[:, None] + (upper - lower)[:, None] * rng.random((6000, 16, 3))).reshape(-1, 3)).reshape(
        -1, 16
    )
    assert not (empty.empty(lower, upper) & inner.any(axis=1)).any()
    assert not (empty.inside(lower, upper) & ~inner.all(axis=1)).any()
    low, high = empty.distances(x).T
    assert (low[truth & ~on] == 0).all()
    assert (low <= high).all()
    for margin in (0.0, 0.05):
        grid = empty.to_grid(resolution=24, margin=margin)
        assert grid.contains(x[truth]).all()
        if hollows and name != "tank in a tank":
            assert not grid.contains(np.zeros((1, 3)))[0]
            assert filled.to_grid(resolution=24, margin=margin).contains(np.zeros((1, 3)))[0]


def test_bounders_of_a_tank():
    tank = made(TANK, hollow="empty")
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.2, 1.2, (20000, 3))
    truth = CASES["tank"][1](x)
    bounder = wb.fit(tank, method="bvh", leaves=64, resolution=24, device="cpu")
    answers = bounder.query(x).numpy()
    assert answers[truth].all()
    assert answers[hole(0.6)(x)].mean() < 0.05
    assert wb.certify(bounder, tank).proven
    assert "1 closed hollow empty" in bounder.certificate.message
    filled = wb.fit(made(TANK), method="aabb", device="cpu")
    assert "1 closed hollow filled" in filled.certificate.message
    assert wb.certify(bounder, made(TANK)).kind == "refuted"  # of the filled one it would not be true


def test_faces_must_be_turned_alike_for_empty_hollows():
    joined = trimesh.util.concatenate(TANK)
    faces = joined.faces.copy()
    faces[0] = faces[0][::-1]
    with pytest.raises(wb.BoundingError, match="turned alike"):
        load_indicator((joined.vertices, faces), hollow="empty")
    assert "turned alike" in load_indicator((joined.vertices, faces)).remark
    assert load_indicator((box(1).vertices, box(1).faces)).remark == ""


def test_other_shapes_are_refused():
    frames = np.stack([box(1).vertices, box(1).vertices + 0.1])
    for shape in (wb.IndicatorMotion(frames, box(1).faces), wb.solids.Sphere([0, 0, 0], 1.0)):
        with pytest.raises(wb.BoundingError, match="hollow is for grids and for meshes"):
            load_indicator(shape, hollow="empty")
    with pytest.raises(wb.BoundingError, match="hollow must be"):
        load_indicator(np.eye(4) > 0, hollow="full")


@pytest.mark.parametrize("time", [False, True])
def test_hollows_of_cells(time):
    rng = np.random.default_rng(3)
    array = rng.random((9, 10, 11)) < 0.75
    plain, filled, kept = (load_indicator(array, time=time, hollow=hollow) for hollow in (None, "filled", "empty"))
    np.testing.assert_array_equal(plain.occupancy, array)
    np.testing.assert_array_equal(kept.occupancy, array)
    reached = np.zeros(np.array(array.shape) + 2, bool)
    reached[0] = True
    if time:
        reached[:, 0] = True
    air = ~np.pad(array, 1)
    axes = range(1, 3) if time else range(3)
    while True:  # a flood from outside, from face to face
        wider = (
            reduce(np.logical_or, [np.roll(reached, step, axis) for axis in axes for step in (-1, 1)], reached) & air
        )
        if (wider | reached == reached).all():
            break
        reached |= wider
    np.testing.assert_array_equal(filled.occupancy, ~reached[1:-1, 1:-1, 1:-1])
    assert "closed hollow" in filled.remark
