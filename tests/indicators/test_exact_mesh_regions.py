"""What a mesh says of boxes, segments and planes is true: against rational arithmetic, with no tolerance at all."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from exact_mesh import NAMES, box_is_near, hard_points, in_tetrahedron, mesh_case, plane_meets, segment_is_near

from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED

COUNT = 2  # of each sort of hard points, so seven times as many queries
UNSURE = 0.05  # at most so many of random queries are undecided


def _checked(answer: np.ndarray, truth: list[bool]) -> None:
    truth = np.array(truth)
    assert not (truth & (answer == OUT)).any()
    assert not (~truth & (answer == IN)).any()


def _ends(points: np.ndarray, size: float, rng) -> np.ndarray:
    """Beside the points, at all distances, along an axis now and then."""
    away = rng.uniform(-1, 1, points.shape) * size * 10.0 ** rng.uniform(-3, 0.3, (len(points), 1))
    away[rng.random(points.shape) < 0.25] = 0
    return points + away


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.125])
def test_boxes_and_segments(rng, name, margin):
    plain, enclosed = mesh_case(name, rng)
    mesh, limit = plain.dilated(margin), Fraction(margin) ** 2
    faces = [f for f in plain.faces if len(set(f)) == 3]
    x = hard_points(plain, margin, rng, COUNT)
    y = _ends(x, float(plain.extent.max()), rng)
    low, high = np.minimum(x, y), np.maximum(x, y)
    truth = [
        any(in_tetrahedron(corners, a) for corners in enclosed) or box_is_near(plain.vertices, faces, limit, a, b)
        for a, b in zip(low, high, strict=True)
    ]
    answer = mesh.decide_boxes(low, high)
    _checked(answer, truth)
    assert (answer[:COUNT] == UNDECIDED).mean() <= UNSURE
    assert (mesh.empty(low, high) <= (answer == OUT)).all()
    truth = [
        any(in_tetrahedron(corners, a) for corners in enclosed) or segment_is_near(plain.vertices, faces, limit, a, b)
        for a, b in zip(x, y, strict=True)
    ]
    answer = mesh.decide_segments(x, y)
    _checked(answer, truth)
    assert (answer[:COUNT] == UNDECIDED).mean() <= UNSURE


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.125])
def test_planes(rng, name, margin):
    for _ in range(3):
        plain, _ = mesh_case(name, rng)
        x = hard_points(plain, margin, rng, 10)
        normal = rng.normal(size=x.shape) * 10.0 ** rng.uniform(-20, 20, (len(x), 1))
        normal[rng.random(x.shape) < 0.2] = 0
        normal[~normal.any(axis=1)] = 1
        answer = plain.dilated(margin).decide_planes(normal, x)
        truth = [plane_meets(plain.vertices, plain.faces, margin, *q) for q in zip(normal, x, strict=True)]
        _checked(answer, truth)
        assert (answer[:10] != UNDECIDED).all()


@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_regions_of_a_torus(rng, margin):
    mesh = load_indicator(trimesh.creation.torus(1, 0.3)).dilated(margin)
    count = 50_000
    x, y = rng.uniform(mesh.sample_lower, mesh.sample_upper, (2, count, 3))
    y[::2] = x[::2] + 0.1 * (y[::2] - x[::2])
    boxes, segments = mesh.decide_boxes(np.minimum(x, y), np.maximum(x, y)), mesh.decide_segments(x, y)
    planes = mesh.decide_planes(y - x, x)
    for answer in (boxes, segments, planes):
        assert (answer == UNDECIDED).mean() < 1e-3
        assert 0.05 < (answer == IN).mean() < 0.99
    between = x + rng.random((count, 1)) * (y - x)
    held = {
        "boxes": mesh.decide(np.minimum(x, y) + rng.random(x.shape) * np.abs(y - x)),
        "segments": mesh.decide(between),
    }
    assert not ((boxes == OUT) & (held["boxes"] == IN)).any()
    assert not ((segments == OUT) & (held["segments"] == IN)).any()
    assert not ((boxes == OUT) & (segments == IN)).any()
    assert not ((planes == OUT) & (mesh.decide(x) == IN)).any()
    assert (mesh.empty(np.minimum(x, y), np.maximum(x, y)) == (boxes == OUT)).mean() > 0.999


def test_regions_that_are_none_or_far():
    mesh = load_indicator(trimesh.creation.icosphere()).dilated(0.1)
    nan, inf = float("nan"), float("inf")
    zero, one = np.zeros((1, 3)), np.ones((1, 3))
    assert mesh.decide_boxes(one, zero) == OUT
    assert mesh.decide_boxes(zero * nan, one) == OUT
    assert mesh.decide_boxes(zero - inf, zero + inf) == IN
    assert mesh.decide_boxes(one * 1e300, one * 2e300) == OUT
    assert mesh.decide_boxes(zero, one * inf) == UNDECIDED
    assert mesh.decide_segments(one * nan, zero) == OUT
    assert mesh.decide_segments(zero, zero) == IN
    assert mesh.decide_segments(one * 1e300, zero) == UNDECIDED
    assert mesh.decide_segments(one * 1e30, zero) == IN
    assert mesh.decide_planes(zero, zero) == OUT
    assert mesh.decide_planes(one * nan, zero) == OUT
    assert mesh.decide_planes(one * inf, zero) == OUT
    assert mesh.decide_planes(one * 1e300, zero) == UNDECIDED
    assert mesh.decide_planes(one * np.float32(1e-45), zero) == IN


@pytest.mark.parametrize("margin", [0.0, 0.125])
def test_planes_that_touch(rng, margin):
    """At the very margin from the vertex that lies farthest along the normal: a matter of the last digit."""
    plain, _ = mesh_case("tetrahedron", rng)
    normal = rng.normal(size=(400, 3))
    normal[::2] = normal[::2].astype(np.float32)
    vertices = plain.vertices.astype(np.float64)
    point = vertices[np.argmax(normal @ vertices.T, axis=1)]
    point = point + margin * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    point += np.spacing(point) * rng.integers(-2, 3, point.shape)
    point[::4] += rng.normal(size=(100, 3)) * 1e-15
    normal[1::2] *= -1
    truth = [plane_meets(plain.vertices, plain.faces, margin, *q) for q in zip(normal, point, strict=True)]
    assert 0.1 < np.mean(truth) < 0.9
    _checked(plain.dilated(margin).decide_planes(normal, point), truth)
