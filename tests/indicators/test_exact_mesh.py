"""What a mesh says of points and boxes is true: against rational arithmetic, with no tolerance at all."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from exact_mesh import NAMES, hard_points, in_tetrahedron, mesh_case, squared_distance

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import IndicatorMesh, load_indicator
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED


def _truth(mesh: IndicatorMesh, enclosed: list[np.ndarray], margin: float, points: np.ndarray) -> np.ndarray:
    limit = Fraction(margin) ** 2
    return np.array(
        [
            any(in_tetrahedron(corners, x) for corners in enclosed)
            or squared_distance(mesh.vertices, mesh.faces, x) <= limit
            for x in points
        ]
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.125, 0.7])
def test_points_and_boxes(rng, name, margin):
    unsure = []
    for _ in range(3):
        plain, enclosed = mesh_case(name, rng)
        mesh = plain.dilated(margin)
        points = hard_points(plain, margin, rng, 15)
        truth = _truth(plain, enclosed, margin, points)
        answer = mesh.decide(points)
        assert not (truth & (answer == OUT)).any()
        assert not (~truth & (answer == IN)).any()
        unsure.append((answer == UNDECIDED)[:15])
        # A box with a point of the object on its border is not empty, one with a point outside lies not inside.
        below, above = (rng.uniform(0, 1, points.shape) * 10.0 ** rng.uniform(-9, 0, (len(points), 1)) for _ in "ab")
        below[rng.random(points.shape) < 0.4] = 0
        above[rng.random(points.shape) < 0.4] = 0
        empty, inside = (f(points - below, points + above) for f in (mesh.empty, mesh.inside))
        assert not (empty & truth).any()
        assert not (inside & ~truth).any()
        # Points are boxes too.
        empty, inside = (f(points, points) for f in (mesh.empty, mesh.inside))
        assert not (empty & (answer != OUT)).any()
        assert not (inside & (answer == OUT)).any()
        assert (empty | (answer != OUT)).all()
    assert np.mean(unsure) < 0.02


@pytest.mark.parametrize("margin", [0.0, 0.3])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_rounding_never_decides(rng, margin, shift):
    """A triangle and some hundred points at its very margin: a wrong answer would be a matter of the last digit."""
    corners = (rng.uniform(-1, 1, (3, 3)) + shift).astype(np.float32)
    mesh = IndicatorMesh(corners, [[0, 1, 2]], margin=margin)
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
    answer = mesh.decide(x)
    assert not (truth & (answer == OUT)).any()
    assert not (~truth & (answer == IN)).any()
    assert not (truth & mesh.empty(x, x)).any()
    assert all(
        (Fraction(d) + Fraction(margin)) ** 2 <= s or d == 0 for d, s in zip(mesh.distance(x), squared, strict=True)
    )


@pytest.mark.parametrize("margin", [0.0, 0.03])
@pytest.mark.parametrize("name", ["icosphere", "torus", "box", "two spheres", "open"])
def test_answers_never_contradict_each_other(rng, name, margin):
    solid = {
        "icosphere": lambda: trimesh.creation.icosphere(subdivisions=3),
        "torus": lambda: trimesh.creation.torus(1, 0.3),
        "box": lambda: trimesh.creation.box(extents=(1, 2, 0.5)),
        "two spheres": lambda: trimesh.util.concatenate(
            [trimesh.creation.icosphere(), trimesh.creation.icosphere(radius=0.8).apply_translation([0.9, 0, 0])]
        ),
        "open": lambda: trimesh.Trimesh(*trimesh.remesh.subdivide(*_open_box()), process=False),
    }[name]()
    mesh = load_indicator(solid).dilated(margin)
    count = 100_000
    x = rng.uniform(mesh.sample_lower, mesh.sample_upper, (count, 3))
    size = 10.0 ** rng.uniform(-4, 0, (count, 1))
    low, high = x - size * rng.random((count, 3)), x + size * rng.random((count, 3))
    within = low + rng.random((count, 3)) * (high - low)
    empty, inside = mesh.empty(low, high), mesh.inside(low, high)
    assert empty.mean() > 0.1
    for points in (x, within):
        answer = mesh.decide(points)
        assert not (empty & (answer == IN)).any()
        assert not (inside & (answer == OUT)).any()
        assert (answer == UNDECIDED).mean() < 1e-3
        assert (mesh.contains(points) == (answer != OUT)).all()
        assert (
            mesh.decide(points.astype(np.float32)) == mesh.decide(points.astype(np.float32).astype(np.float64))
        ).all()


def _open_box():
    box = trimesh.creation.box(extents=(1, 1, 1))
    return box.vertices, box.faces[2:]


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_against_trimesh(rng, shift):
    solid = trimesh.creation.icosphere(subdivisions=2, radius=1000.0 if shift else 1.0)
    solid.apply_translation([shift, -shift, shift])
    mesh = load_indicator((np.float32(solid.vertices), solid.faces))  # float64 ones would be recentred
    solid = trimesh.Trimesh(mesh.vertices.astype(np.float64) - [shift, -shift, shift], mesh.faces, process=False)
    x = rng.uniform(mesh.sample_lower, mesh.sample_upper, (2000, 3))
    signed = trimesh.proximity.signed_distance(solid, x - [shift, -shift, shift])
    size = float(mesh.extent.max())
    answer = mesh.decide(x)
    clear = np.abs(signed) > 1e-6 * size
    assert (answer[clear] == np.where(signed[clear] > 0, IN, OUT)).all()
    dilated = mesh.dilated(0.1 * size)
    clear = np.abs(signed + 0.1 * size) > 1e-6 * size
    assert (dilated.decide(x)[clear] == np.where(signed[clear] > -0.1 * size, IN, OUT)).all()


def _vase(neck: float) -> IndicatorMesh:
    profile = [[0, 0], [1, 0.4], [1, 1.6], [neck + 0.2, 2], [neck, 2], [0.8, 1.5], [0.8, 0.5], [0, 0.2]]
    return load_indicator(trimesh.creation.revolve(np.array(profile), sections=24))


def test_the_hollow_of_a_vase_is_outside_and_that_of_a_ball_is_not():
    middle = np.array([[0.01, 0.02, 1.0]])
    vase = _vase(0.05)
    assert vase.watertight
    assert vase.decide(middle) == OUT
    assert vase.empty(middle - 0.1, middle + 0.1)
    assert not vase.empty(middle - 1, middle + 1)
    narrow = _vase(0.0005)
    assert narrow.decide(middle) != IN
    shells = [trimesh.creation.icosphere(subdivisions=2, radius=radius) for radius in (1.0, 0.5)]
    shells[1].invert()
    ball = load_indicator(trimesh.util.concatenate(shells))
    assert ball.decide(middle - [0, 0, 1]) == IN
    assert ball.inside(middle - [0.1, 0.1, 1.1], middle - [-0.1, -0.1, 0.9])


def test_flipped_faces_change_nothing(rng):
    solid = trimesh.creation.torus(1, 0.3)
    mesh = load_indicator(solid)
    faces = mesh.faces.copy()
    turned = rng.random(len(faces)) < 0.5
    faces[turned] = faces[turned, ::-1]
    x = rng.uniform(mesh.sample_lower, mesh.sample_upper, (20_000, 3))
    assert (IndicatorMesh(mesh.vertices, faces).decide(x) == mesh.decide(x)).all()


def test_numbers_that_are_none_and_boxes_that_are_none():
    mesh = load_indicator(trimesh.creation.icosphere()).dilated(0.1)
    nan, inf = float("nan"), float("inf")
    bad = np.array([[nan, 0, 0], [0, 0, nan], [inf, 0, 0], [0, -inf, 0], [1e300, 0, 0]])
    assert (mesh.decide(bad) == OUT).all()
    lower = np.array([[nan, 0, 0], [1, 0, 0], [5, nan, 5], [-inf, -inf, -inf], [0, 0, 0], [5, 1, 5]])
    upper = np.array([[1, 1, 1], [0, 1, 1], [6, 6, 6], [inf, inf, inf], [inf, 1, 1], [6, 0, 6]])
    assert not mesh.empty(lower, upper).any()
    assert not mesh.inside(lower, upper).any()
    assert mesh.empty(np.array([[2, 0, 0]]), np.array([[inf, 1, 1]])).all()
    assert mesh.decide(np.empty((0, 3))).shape == (0,)


def test_a_dilated_mesh():
    mesh = load_indicator(trimesh.creation.icosphere())
    dilated = mesh.dilated(0.25)
    assert dilated.dilated(0.25) is dilated
    assert mesh.dilated(0) is mesh
    assert (dilated.margin, mesh.margin) == (0.25, 0.0)
    assert dilated.geometry == mesh.geometry
    assert dilated.digest != mesh.digest
    assert (dilated.lower <= mesh.lower - 0.25).all()
    assert (dilated.upper >= mesh.upper + 0.25).all()
    assert "margin 0.25" in repr(dilated)
    for grid in (dilated.to_grid(resolution=16), dilated.to_grid(resolution=16, margin=0.25)):
        assert grid.digest == mesh.to_grid(resolution=16, margin=0.25).digest
        assert grid.margin == 0.25
    assert IndicatorMesh(mesh.vertices, mesh.faces, margin=0.25).decide(np.array([[1.2, 0, 0]])) == IN
    with pytest.raises(IndicatorError, match=r"dilated by 0\.25 already"):
        dilated.dilated(0.5)
    with pytest.raises(IndicatorError, match=r"dilated by 0\.25 already"):
        dilated.to_grid(margin=0.5)
    with pytest.raises(IndicatorError, match="margin must be"):
        IndicatorMesh(mesh.vertices, mesh.faces, margin=-1)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_distances_are_lower_bounds_and_good_ones(rng, name, margin):
    plain, enclosed = mesh_case(name, rng)
    mesh = plain.dilated(margin)
    points = hard_points(plain, margin, rng, 6)
    distance = mesh.distance(points)
    assert (distance >= 0).all()
    truth = [squared_distance(plain.vertices, plain.faces, x) for x in points]
    for x, found, squared in zip(points, distance, truth, strict=True):
        assert not any(in_tetrahedron(corners, x) for corners in enclosed) or found == 0
        assert found == 0 or (Fraction(found) + Fraction(margin)) ** 2 <= squared
    exact = np.maximum(np.sqrt(np.array(truth, dtype=float)) - margin, 0)
    size = np.ptp(points, axis=0).max()
    outside = mesh.decide(points) == OUT
    assert (distance[outside] >= exact[outside] - 1e-13 * size).all()
    assert (distance[mesh.decide(points) == IN] == 0).all()
    # A box is no farther than any of its points is.
    low, high = points - rng.random(points.shape) * 0.3 * size, points + rng.random(points.shape) * 0.3 * size
    clearance = mesh.clearance(low, high)
    for corner in range(4):
        within = low + (rng.integers(0, 2, points.shape) if corner < 2 else rng.random(points.shape)) * (high - low)
        within = np.clip(within, low, high)
        for bound, x in zip(clearance, within, strict=True):
            squared = squared_distance(plain.vertices, plain.faces, x)
            assert bound == 0 or (Fraction(bound) + Fraction(margin)) ** 2 <= squared
    assert (mesh.empty(low, high) | (clearance == 0)).all()


def test_clearance_is_tight(rng):
    mesh = load_indicator(trimesh.creation.icosphere(subdivisions=2)).dilated(0.05)
    x = rng.uniform(-2, 2, (20_000, 3))
    half = 0.2 * rng.random(x.shape)
    clearance, empty = mesh.clearance(x - half, x + half), mesh.empty(x - half, x + half)
    nearest = x + np.clip(-x, -half, half)  # of the box, to the middle of the ball
    exact = np.linalg.norm(nearest, axis=1) - 1.05
    assert (clearance <= np.maximum(exact, 0) + 0.05).all()  # the facets lie under the sphere
    assert (clearance >= exact - 1e-6)[exact > 0].all()
    assert ((clearance > 0) == empty).mean() > 0.999
    far = np.array([[1e300, 0, 0], [float("nan"), 0, 0], [-float("inf"), 0, 0]])
    assert mesh.distance(far).tolist() == [pytest.approx(1e300), 0.0, float("inf")]


def test_landmarks_lie_on_the_border():
    solid = trimesh.creation.icosphere(subdivisions=2)
    mesh = load_indicator(solid)
    assert len(mesh.landmarks()) == len(solid.vertices)
    landmarks = mesh.dilated(0.25).landmarks()
    assert len(landmarks) == len(solid.vertices)
    assert np.linalg.norm(landmarks, axis=1) == pytest.approx(1.25, abs=1e-3)


def _room(overlap: float) -> IndicatorMesh:
    """Six solid plates around a hollow, each as large as its side of the room."""
    plates = []
    for axis in range(3):
        for side in (-1, 1):
            extents = np.full(3, 2.0 + overlap)
            extents[axis] = 0.2
            middle = np.zeros(3)
            middle[axis] = side * 0.9
            plates.append(trimesh.creation.box(extents=extents).apply_translation(middle))
    return load_indicator(trimesh.util.concatenate(plates))


def test_a_hollow_that_no_part_encloses_alone_belongs_to_the_object(rng):
    mesh = _room(0.0)
    x = rng.uniform(-0.7, 0.7, (1000, 3))
    assert mesh.contains(x).all()
    assert not mesh.empty(x - 0.05, x + 0.05).any()
    assert (mesh.decide(x + np.array([2, 0, 0])) == OUT).all()


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_cells_hold_the_object(rng, margin):
    for mesh in (_room(0.1), _vase(0.05), load_indicator(trimesh.creation.torus(1, 0.3))):
        grid, dilated = mesh.to_grid(resolution=40, margin=margin), mesh.dilated(margin)
        x = rng.uniform(dilated.sample_lower, dilated.sample_upper, (20_000, 3))
        assert grid.contains(x[dilated.decide(x) == IN]).all()
        cells = grid.position(grid.occupied[rng.permutation(len(grid.occupied))[:2000]])
        half = 0.5 / grid.cells_per_unit
        assert not dilated.empty(cells - half, cells + half)[dilated.decide(cells) == IN].any()


def test_a_surface_of_faces_that_are_crushed_doubled_and_turned(rng):
    """A ball whose faces are split at their edges, where faces without area fill the cracks, and that is doubled in part."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = ball.vertices.tolist(), []
    for a, b, c in ball.faces[:40]:
        middle = len(vertices)
        vertices.append(((ball.vertices[a] + ball.vertices[b]) / 2).tolist())
        faces += [[a, middle, c], [middle, b, c], [a, b, middle]]
    faces += ball.faces[40:].tolist() + ball.faces[60:90, ::-1].tolist() + [[0, 0, 5], [7, 7, 7]]
    mesh, plain = IndicatorMesh(vertices, faces), load_indicator(ball)
    assert mesh.watertight
    x = rng.uniform(-1.3, 1.3, (20_000, 3))
    answer, expected = mesh.decide(x), plain.decide(x)
    near = plain.distance(x) + (expected == IN) < 1e-6
    assert (answer == expected)[~near].all()
    assert (answer == UNDECIDED).mean() < 1e-3
