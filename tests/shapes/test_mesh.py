"""What a mesh says of points, boxes, segments, planes and distances is true: against rational arithmetic."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
import trimesh
from exact_mesh import (
    NAMES,
    box_is_near,
    check_boxes,
    check_decided,
    hard_points,
    in_tetrahedron,
    mesh_case,
    plane_meets,
    segment_is_near,
    squared_distance,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_bounding.errors import ShapeError
from warp_bounding.shapes import Mesh, load_shape
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED
from warp_bounding.shapes.triangles.cells import surface_cells


def _truth(mesh: Mesh, enclosed: list[np.ndarray], margin: float, points: np.ndarray) -> np.ndarray:
    def holds(x) -> bool:
        near = squared_distance(mesh.vertices, mesh.faces, x) <= Fraction(margin) ** 2
        return near or any(in_tetrahedron(corners, x) for corners in enclosed)

    return np.array([holds(x) for x in points])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.125, 0.7])
def test_points_and_boxes(rng, name, margin):
    unsure = []
    for _ in range(2):
        plain, enclosed = mesh_case(name, rng)
        mesh = plain.dilated(margin)
        points = hard_points(plain, margin, rng, 10)
        truth = _truth(plain, enclosed, margin, points)
        answer = mesh.decide(points)
        check_decided(answer, truth)
        unsure.append((answer == UNDECIDED)[:10])
        check_boxes(mesh, points, answer, truth, ~truth, rng)
    assert np.mean(unsure) < 0.02


@pytest.mark.parametrize("margin", [0.0, 0.3])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_rounding_never_decides(rng, margin, shift):
    """A triangle and some hundred points at its very margin: a wrong answer would be a matter of the last digit."""
    corners = (rng.uniform(-1, 1, (3, 3)) + shift).astype(np.float32)
    mesh = Mesh(corners, [[0, 1, 2]], margin=margin)
    a, b, c = corners.astype(np.float64)
    normal = np.cross(b - a, c - a)
    count = 150
    on = rng.dirichlet(np.ones(3), count) @ np.stack([a, b, c])
    edge = a + rng.random((count, 1)) * (b - a)
    beside = np.cross(b - a, normal)
    x = np.concatenate([on + margin * normal / np.linalg.norm(normal), edge - margin * beside / np.linalg.norm(beside)])
    x += np.spacing(x) * rng.integers(-2, 3, x.shape)
    squared = [squared_distance(corners, [[0, 1, 2]], p) for p in x]
    truth = np.array([d <= Fraction(margin) ** 2 for d in squared])
    check_decided(mesh.decide(x), truth)
    assert not (truth & mesh.empty(x, x)).any()
    assert all(
        (Fraction(d) + Fraction(margin)) ** 2 <= s or d == 0 for d, s in zip(mesh.distance(x), squared, strict=True)
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_distances_are_lower_bounds_and_good_ones(rng, name, margin):
    plain, enclosed = mesh_case(name, rng)
    mesh = plain.dilated(margin)
    points = hard_points(plain, margin, rng, 6)
    distance, high = mesh.distances(points).T
    assert (mesh.distance(points) == distance).all()
    assert ((distance >= 0) & (high >= distance)).all()
    truth = [squared_distance(plain.vertices, plain.faces, x) for x in points]
    for x, found, most, squared in zip(points, distance.tolist(), high.tolist(), truth, strict=True):
        held = any(in_tetrahedron(corners, x) for corners in enclosed)
        assert not held or found == 0
        assert found == 0 or (Fraction(found) + Fraction(margin)) ** 2 <= squared
        assert held or most == np.inf or (Fraction(most) + Fraction(margin)) ** 2 >= squared
    exact = np.maximum(np.sqrt(np.array(truth, dtype=float)) - margin, 0)
    size = np.ptp(points, axis=0).max()
    outside = mesh.decide(points) == OUT
    assert (distance[outside] >= exact[outside] - 1e-13 * size).all()
    assert (high[outside] - distance[outside] <= 1e-13 * size).all()
    assert (distance[mesh.decide(points) == IN] == 0).all()
    far = np.array([[1e300, 0, 0], [np.nan, 0, 0], [-np.inf, 0, 0]])
    assert mesh.distances(far).tolist() == [[pytest.approx(1e300), np.inf], [0, np.inf], [np.inf, np.inf]]


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
    x = hard_points(plain, margin, rng, 2)
    y = _ends(x, float(plain.extent.max()), rng)
    low, high = np.minimum(x, y), np.maximum(x, y)
    for first, last, decide, is_near in (
        (x, y, mesh.decide_segments, segment_is_near),
        (low, high, mesh.decide_boxes, box_is_near),
    ):
        truth = [
            any(in_tetrahedron(corners, a) for corners in enclosed) or is_near(plain.vertices, faces, limit, a, b)
            for a, b in zip(first, last, strict=True)
        ]
        answer = decide(first, last)
        check_decided(answer, np.array(truth))
        assert (answer[:2] == UNDECIDED).mean() <= 0.05
    assert (mesh.empty(low, high) <= (answer == OUT)).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.125])
def test_planes(rng, name, margin):
    for _ in range(2):
        plain, _ = mesh_case(name, rng)
        x = hard_points(plain, margin, rng, 10)
        normal = rng.normal(size=x.shape) * 10.0 ** rng.uniform(-20, 20, (len(x), 1))
        normal[rng.random(x.shape) < 0.2] = 0
        normal[~normal.any(axis=1)] = 1
        answer = plain.dilated(margin).decide_planes(normal, x)
        truth = [plane_meets(plain.vertices, plain.faces, margin, *q) for q in zip(normal, x, strict=True)]
        check_decided(answer, np.array(truth))
        assert (answer[:10] != UNDECIDED).all()


def test_regions_that_are_none_or_far():
    mesh = load_shape(trimesh.creation.icosphere()).dilated(0.1)
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
    check_decided(plain.dilated(margin).decide_planes(normal, point), np.array(truth))


def test_resolutions_and_margins_that_are_none():
    box = load_shape(trimesh.creation.box())
    for resolution in (1, 1025, 2.5, "64", True, np.nan):
        with pytest.raises(ShapeError, match="resolution must be an integer from 2 to 1024"):
            box.to_grid(resolution=resolution)
    for margin in (-1e-9, np.nan, np.inf, "wide", None):
        with pytest.raises(ShapeError, match="margin must be finite and non-negative"):
            box.to_grid(margin=margin)
    with pytest.raises(ShapeError, match="that float32 cells can divide"):
        box.to_grid(margin=1e40)
    with pytest.raises(ShapeError, match="of the origin"):
        load_shape(trimesh.creation.box().apply_translation([1e6, 0, 0])).to_grid()


# --- cells ------------------------------------------------------------------------------------------------------------


def turned(mesh):
    """No face along an axis, no vertex on a round number."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(1.1, [1, 2, 3], [0.1, 0.2, 0.3]))
    return mesh


def open_box():
    box = trimesh.creation.box(extents=(1, 1, 1))
    return trimesh.Trimesh(box.vertices, box.faces[2:], process=False)


SHAPES = {
    "icosphere": lambda: trimesh.creation.icosphere(subdivisions=3),
    "box": lambda: trimesh.creation.box(extents=(1, 2, 0.5)),
    "turned box": lambda: turned(trimesh.creation.box(extents=(1, 2, 0.5))),
    "torus": lambda: trimesh.creation.torus(1, 0.3),
    "thin plate": lambda: turned(trimesh.creation.box(extents=(1, 1, 1e-4))),
    "open box": open_box,
    "turned open box": lambda: turned(open_box()),
    "needle": lambda: trimesh.Trimesh([[0, 0, 0], [1, 2, 3], [1, 2, 3.00001]], [[0, 1, 2]], process=False),
    "two spheres in one": lambda: trimesh.util.concatenate(
        [trimesh.creation.icosphere(subdivisions=2), trimesh.creation.icosphere(subdivisions=2, radius=0.8)]
    ),
}


def surface_points(mesh, rng, count):
    """Dense samples of every triangle, in its inside, on its edges and at its corners: float32 rounded and not."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    weights = rng.dirichlet(np.ones(3), size=(len(corners), count))
    weights[:, :3] = np.eye(3)
    weights[:, 3:6] = [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]
    weights[:, 6 : 6 + count // 4, 0] = 0
    weights /= weights.sum(axis=-1, keepdims=True)
    return np.einsum("fkc,fcx->fkx", weights, corners).reshape(-1, 3)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize(("resolution", "margin"), [(24, 0.0), (3, 0.11), (24, 0.11)])
def test_every_point_of_the_dilated_object_lies_in_an_occupied_cell(rng, name, resolution, margin):
    mesh = load_shape(SHAPES[name]())
    grid = mesh.to_grid(resolution=resolution, margin=margin)
    points = surface_points(mesh, rng, max(40, 20_000 // len(mesh.faces)))
    # Samples are rounded to float64, so they may lie off the triangle, by less than the slack of the cells.
    assert grid.contains(points).all()
    if margin:
        direction = rng.normal(size=points.shape)
        direction[::3] = rng.choice([-1.0, 0.0, 1.0], size=direction[::3].shape)  # along axes and diagonals
        length = np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        distance = margin * np.where(rng.random(len(points)) < 0.5, 1, rng.random(len(points)))[:, None]
        assert grid.contains(points + direction / length * distance).all()


def lattice_of(triangle, steps):
    """Points of a triangle, corners included; every other point of it is within its longest edge / steps of one."""
    i, j = (a.ravel() for a in np.mgrid[: steps + 1, : steps + 1])
    weights = np.stack([i, j, steps - i - j], axis=1)[i + j <= steps] / steps
    return weights @ triangle


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    margin=st.sampled_from([0.0, 0.01, 0.7, 2.5]),
    round_to=st.sampled_from([None, 1, 2]),
)
def test_cells_of_one_triangle_against_brute_force(seed, margin, round_to):
    """Neither too few nor too many, also for corners on faces of cells and for triangles that are a line or a point."""
    triangle = 5 + np.random.default_rng(seed).uniform(-2, 2, (3, 3))
    if round_to:
        triangle = np.round(triangle * round_to) / round_to
    steps = 40
    shape = (11, 11, 11)
    occupied = surface_cells(triangle, np.array([[0, 1, 2]]), shape, margin).reshape(-1)
    cells = np.indices(shape).reshape(3, -1).T
    distance = np.full(len(cells), np.inf)
    for point in lattice_of(triangle, steps):  # upper bounds of the distance between cell and triangle
        gap = np.maximum(np.abs(cells - point) - 0.5, 0)
        distance = np.minimum(distance, np.sqrt((gap**2).sum(axis=1)))
    spacing = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max() / steps
    assert occupied[distance <= margin].all()
    assert (distance[occupied] <= margin + spacing + 1e-6).all()


def test_slack_outweighs_rounding(rng):
    """An edge through the corner of cells touches all eight, exactly; in float64, only the slack can tell."""
    for _ in range(200):
        corner = np.full(3, 4.5)
        along = (rng.uniform(-1, 1, 3).astype(np.float32) / np.float32(3)).astype(np.float64)
        start, end = corner - 3 * along, corner + rng.integers(1, 8) * along  # exact: 24 bits and small factors
        triangle = np.array([start, end, rng.uniform(0, 9, 3)])
        occupied = surface_cells(triangle, np.array([[0, 1, 2]]), (10, 10, 10), 0.0)
        assert occupied[4:6, 4:6, 4:6].all()


@settings(deadline=None, max_examples=8)
@given(scale=st.floats(-20, 20), shift=st.floats(-60, 60), resolution=st.integers(2, 40), margin=st.floats(0, 1))
def test_any_size_and_place(scale, shift, resolution, margin):
    """Sizes from a millionth to a million, up to 60 sizes from the origin; farther off the mesh is refused."""
    size = 2.0**scale
    solid = trimesh.creation.icosphere(subdivisions=1, radius=size)
    mesh = Mesh(solid.vertices + shift * size, solid.faces)
    grid = mesh.to_grid(resolution=resolution, margin=margin * size)
    assert grid.contains(mesh.vertices).all()
    for axis, sign in product(range(3), [-1, 1]):
        reach = mesh.vertices[np.argmax(sign * mesh.vertices[:, axis])].astype(np.float64)
        reach[axis] += sign * margin * size
        assert grid.contains(reach[None])[0]
