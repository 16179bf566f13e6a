"""What a motion says of points and boxes of time and space is true: against rational arithmetic, with no tolerance at all.

There are two truths, and answers hold for both: the straight ways, and what ``vertices_at`` rounds them to.
"""

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from exact_mesh import NAMES, hard_points, in_tetrahedron, mesh_case, squared_distance
from turning_solids import SOLIDS, turning, unevenly_turning

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import IndicatorMesh, IndicatorMotion, load_indicator
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED, HalfSpaces


def _motion_case(name: str, rng, keyframes: int, wild: bool) -> tuple[IndicatorMotion, list[np.ndarray]]:
    """A mesh whose places go to and fro, and the vertices of the tetrahedra that it encloses."""
    mesh, enclosed = mesh_case(name, rng)
    places, of = np.unique(mesh.vertices, axis=0, return_inverse=True)
    of = of.reshape(-1)
    middle, size = places.mean(axis=0), np.ptp(places, axis=0).max()
    frames = [places]
    for _ in range(keyframes - 1):
        if wild and name != "nested":
            frames.append(places + size * rng.uniform(-0.5, 0.5, places.shape))
        else:
            turned = (places - middle) @ (np.eye(3) + rng.uniform(-0.6, 0.6, (3, 3)))
            frames.append(middle + turned + size * rng.uniform(-0.5, 0.5, 3))
    if name == "on round numbers":
        frames = [np.rint(f) for f in frames]
    times = np.cumsum(rng.uniform(0.01, 1, keyframes)) - 0.7
    motion = IndicatorMotion(np.array(frames)[:, of], mesh.faces, times)
    index = [[int(np.flatnonzero((mesh.vertices == c).all(axis=1))[0]) for c in corners] for corners in enclosed]
    return motion, index


def _exact_vertices(motion: IndicatorMotion, time: float) -> np.ndarray:
    times = [Fraction(float(t)) for t in motion.times]
    k = max(i for i in range(len(times) - 1) if times[i] <= time)
    share = (Fraction(time) - times[k]) / (times[k + 1] - times[k])
    first, last = ([[Fraction(float(x)) for x in v] for v in motion.frames[i]] for i in (k, k + 1))
    way = [[a + share * (b - a) for a, b in zip(p, q, strict=True)] for p, q in zip(first, last, strict=True)]
    return np.array(way, dtype=object)


def _in(vertices: np.ndarray, faces: np.ndarray, enclosed: list, margin: float, x: np.ndarray) -> bool:
    if any(in_tetrahedron([vertices[i] for i in tetrahedron], x) for tetrahedron in enclosed):
        return True
    return squared_distance(vertices, faces, x) <= Fraction(margin) ** 2


def _truths(
    motion: IndicatorMotion, enclosed: list, margin: float, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of each point, whether it is in the object of straight ways, and in that of rounded vertices."""
    exact, rounded = [], []
    for time, *x in points.tolist():
        exact.append(_in(_exact_vertices(motion, time), motion.faces, enclosed, margin, x))
        rounded.append(_in(motion.vertices_at(time), motion.faces, enclosed, margin, x))
    return np.array(exact), np.array(rounded)


def _moments(motion: IndicatorMotion, margin: float, rng, count: int) -> np.ndarray:
    """Hard points of the mesh at some times, keyframes among them."""
    first, last = motion.times[[0, -1]]
    times = np.r_[rng.uniform(first, last, 2), motion.times[rng.integers(len(motion.times))]].astype(np.float32)
    times = np.clip(times, first, last)
    found = []
    for time in times.tolist():
        at = IndicatorMesh(motion.vertices_at(time), motion.faces)
        x = hard_points(at, margin, rng, count)
        found.append(np.insert(x, 0, time, axis=1))
    return np.concatenate(found)


def _linear(known: HalfSpaces, i: int, x: np.ndarray) -> Fraction:
    """The linear function of box i at a point, exactly."""
    terms = zip(known.slope[i].tolist(), x.tolist(), known.center[i].tolist(), strict=True)
    return Fraction(known.level[i]) + sum(Fraction(s) * (Fraction(p) - Fraction(c)) for s, p, c in terms)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "far away"])  # refused: too coarse in float32
@pytest.mark.parametrize("margin", [0.0, 0.125, 0.7])
@pytest.mark.parametrize("wild", [False, True])
def test_points_and_boxes(rng, name, margin, wild):
    plain, enclosed = _motion_case(name, rng, 4, wild)
    motion = plain.dilated(margin)
    points = _moments(plain, margin, rng, 2)
    exact, rounded = _truths(plain, enclosed, margin, points)
    answer = motion.decide(points)
    assert not ((exact | rounded) & (answer == OUT)).any()
    assert not (~(exact & rounded) & (answer == IN)).any()
    sure = np.resize(np.arange(14) < 2, len(points))  # those at random
    assert (answer == UNDECIDED)[sure].mean() <= 0.1
    # A box with a point of the object on its border is not empty, one with a point outside lies not inside.
    for _ in range(3):
        below, above = (rng.uniform(0, 1, points.shape) * 10.0 ** rng.uniform(-9, 0, (len(points), 1)) for _ in "ab")
        below[rng.random(points.shape) < 0.4] = 0
        above[rng.random(points.shape) < 0.4] = 0
        empty, inside = (f(points - below, points + above) for f in (motion.empty, motion.inside))
        assert not (empty & (exact | rounded)).any()
        assert not (inside & ~(exact & rounded)).any()
        known = motion.half_spaces(points - below, points + above)
        assert (known.empty == empty).all()
        assert all(_linear(known, i, points[i]) >= 0 for i in np.flatnonzero(exact | rounded))
    empty, inside = (f(points, points) for f in (motion.empty, motion.inside))
    assert not (empty & (answer != OUT)).any()
    assert not (inside & (answer == OUT)).any()
    assert (empty | (answer != OUT)).all()


@pytest.mark.parametrize("margin", [0.0, 0.03])
@pytest.mark.parametrize("name", [*SOLIDS, "open"])
def test_answers_never_contradict_each_other(rng, name, margin):
    motion = unevenly_turning(name, margin)
    count = 50_000
    x = rng.uniform(motion.sample_lower, motion.sample_upper, (count, 4))
    size = 10.0 ** rng.uniform(-4, 0, (count, 1)) * [0.3, 1, 1, 1]
    low, high = x - size * rng.random((count, 4)), x + size * rng.random((count, 4))
    within = low + rng.random((count, 4)) * (high - low)
    empty, inside = motion.empty(low, high), motion.inside(low, high)
    assert empty.mean() > 0.1
    assert inside.any() or (name == "open" and margin == 0)
    for points in (x, within, within.clip(motion.lower, motion.upper)):
        answer = motion.decide(points)
        there = (points >= low).all(axis=1) & (points <= high).all(axis=1)
        assert not (empty & there & (answer == IN)).any()
        assert not (inside & there & (answer == OUT)).any()
        assert (answer == UNDECIDED).mean() < 1e-3
        assert (motion.contains(points) == (answer != OUT)).all()
        assert (
            motion.decide(points.astype(np.float32)) == motion.decide(points.astype(np.float32).astype(float))
        ).all()


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_at_each_time_it_is_the_mesh_there(rng, name, margin):
    solid = SOLIDS[name]()
    motion = IndicatorMotion(turning(solid), solid.faces, margin=margin)
    for time in np.float32([0, 0.1, 0.25, 0.6, 0.99, 1]).tolist():
        mesh = IndicatorMesh(motion.vertices_at(time), solid.faces, margin=margin)
        x = rng.uniform(motion.sample_lower[1:], motion.sample_upper[1:], (5000, 3))
        answer = motion.decide(np.insert(x, 0, time, axis=1))
        assert (answer == mesh.decide(x)).mean() > 0.999
        assert not ((answer == OUT) & (mesh.decide(x) == IN)).any()
        assert not ((answer == IN) & (mesh.decide(x) == OUT)).any()
        half = 0.1 * rng.random(x.shape)
        boxes = [np.insert(x + way * half, 0, time, axis=1) for way in (-1, 1)]
        assert (motion.empty(*boxes) == mesh.empty(x - half, x + half)).mean() > 0.999
        assert (motion.inside(*boxes) == mesh.inside(x - half, x + half)).mean() > 0.99


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_a_motion_that_stands_still_is_the_mesh(rng, margin):
    mesh = load_indicator(trimesh.creation.torus(1, 0.3)).dilated(margin)
    motion = IndicatorMotion(np.stack([mesh.vertices] * 3), mesh.faces, times=[1, 2, 5], margin=margin)
    assert (motion.lower == [1, *mesh.lower]).all()
    assert (motion.upper == [5, *mesh.upper]).all()
    assert (motion.extent == mesh.extent).all()
    x = rng.uniform(mesh.sample_lower, mesh.sample_upper, (20_000, 3))
    half = 0.1 * rng.random(x.shape)
    low, high = (np.insert(x + way * half, 0, time, axis=1) for way, time in ((-1, 1.5), (1, 4.5)))
    assert (motion.empty(low, high) == mesh.empty(x - half, x + half)).mean() > 0.999
    assert (motion.inside(low, high) == mesh.inside(x - half, x + half)).mean() > 0.99
    answer = motion.decide(np.insert(x, 0, rng.uniform(1, 5, len(x)), axis=1))
    assert (answer == mesh.decide(x)).mean() > 0.999


def test_a_hollow_is_part_of_the_object_while_it_is_shut():
    """A vase whose rim goes through itself: no face comes near the middle, and yet it is inside at the end."""
    profile = [[0, 0], [1, 0.4], [1, 1.6], [0.5, 2], [0.3, 2], [0.8, 1.5], [0.8, 0.5], [0, 0.2]]
    vase = trimesh.creation.revolve(np.array(profile), sections=24)
    shut, rim = vase.vertices.copy(), vase.vertices[:, 2] > 1.99
    shut[rim, :2] *= 1 - 0.4 / np.linalg.norm(shut[rim, :2], axis=1, keepdims=True)
    motion = IndicatorMotion(np.array([vase.vertices, shut]), vase.faces)
    assert motion.watertight
    middle = np.array([0.01, 0.02, 1.0])
    times = np.array([0.0, 0.25, 0.5, 1.0])
    answer = motion.decide(np.insert(np.tile(middle, (4, 1)), 0, times, axis=1))
    assert answer[0] == answer[1] == OUT
    assert answer[3] != OUT
    low, high = np.insert(middle - 0.05, 0, 0.0), np.insert(middle + 0.05, 0, 0.25)
    assert motion.empty(low[None], high[None]).all()
    high[0] = 1.0
    assert not motion.empty(low[None], high[None]).any()
    low[0] = 0.95
    assert not motion.empty(low[None], high[None]).any()


def test_a_jump(rng):
    """From one place to another between two neighbouring numbers, and across: all that lies between is met."""
    solid = trimesh.creation.box(extents=(1, 1, 1))
    start = np.float32(1.5)
    times = [0, start, np.nextafter(start, np.float32(2)), 2]
    frames = [solid.vertices + np.array([way, 0, 0]) for way in (0, 0, 100, 100)]
    motion = IndicatorMotion(np.array(frames), solid.faces, times, margin=0.01)
    x = np.column_stack([rng.uniform(-1, 101, 3000), rng.uniform(-1, 1, (3000, 2))])
    met = (np.abs(x - [50, 0, 0]) <= [50.49, 0.49, 0.49]).all(axis=1)
    low, high = np.insert(x, 0, start, axis=1), np.insert(x, 0, times[2], axis=1)
    assert not motion.empty(low, high)[met].any()
    missed = (np.abs(x - [50, 0, 0]) > [50.52, 0.52, 0.52]).any(axis=1)
    assert motion.empty(low, high)[missed].mean() > 0.9
    low[:, 0] = 0
    assert motion.empty(low, low)[(np.abs(x) > 0.52).any(axis=1)].all()
    assert motion.decide(np.array([[2.0, 100, 0, 0], [2.0, 0, 0, 0], [1.0, 100, 0, 0]])).tolist() == [IN, OUT, OUT]


def test_faces_that_are_crushed_on_their_way(rng):
    """A ball that is pressed flat and turned inside out, with doubled faces and faces without area."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = np.concatenate([ball.faces, ball.faces[:20], [[0, 0, 1], [3, 3, 3]]])
    frames = np.array([ball.vertices * [1, 1, way] for way in (1.0, 0.0, 0.0, -1.0)])
    motion = IndicatorMotion(frames, faces)
    assert motion.watertight
    x = rng.uniform(-1.2, 1.2, (20_000, 3))
    x[:5000, 2] *= 1e-4
    for time in (0.0, 0.3, 0.5, 0.75, 1.0):
        height = abs(np.interp(time, motion.times.astype(float), [1, 0, 0, -1]))
        answer = motion.decide(np.insert(x, 0, time, axis=1))
        assert (answer != UNDECIDED).mean() > 0.99
        size = np.linalg.norm(x / [1, 1, max(height, 1e-12)], axis=1)
        assert not (answer == OUT)[size < 0.95].any()
        assert not (answer == IN)[size > 1 + 1e-6].any()
        if height:
            assert (answer == IN)[(size < 0.95) & (np.abs(x[:, 2]) > 1e-6)].all()


def test_numbers_that_are_none_and_boxes_that_are_none():
    ball = trimesh.creation.icosphere()
    motion = IndicatorMotion(np.stack([ball.vertices] * 2), ball.faces, times=[0, 2], margin=0.1)
    nan, inf = float("nan"), float("inf")
    bad = np.array([[nan, 0, 0, 0], [0, 0, 0, nan], [1, inf, 0, 0], [1, 0, -inf, 0], [1, 1e300, 0, 0], [inf, 0, 0, 0]])
    assert (motion.decide(bad) == OUT).all()
    lower = np.array([[nan, 0, 0, 0], [0, 1, 0, 0], [2, 0, 0, 0], [0, -inf, -inf, -inf], [-inf, 0, 0, 0]])
    upper = np.array([[1, 1, 1, 1], [1, 0, 1, 1], [1, 1, 1, 1], [1, inf, inf, inf], [inf, 1, 1, 1]])
    assert not motion.empty(lower, upper).any()
    assert not motion.inside(lower, upper).any()
    assert motion.empty(np.array([[0, 2, 0, 0]]), np.array([[1, inf, 1, 1]])).all()
    assert motion.decide(np.empty((0, 4))).shape == (0,)


def test_before_and_after_the_motion_there_is_nothing():
    ball = trimesh.creation.icosphere()
    motion = IndicatorMotion(np.stack([ball.vertices] * 2), ball.faces, times=[0, 2])
    x = np.array([[-0.1, 0, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0], [2.1, 0, 0, 0]])
    assert motion.decide(x).tolist() == [OUT, IN, IN, OUT]
    assert motion.empty(x - 0.05, x + 0.05).tolist() == [True, False, False, True]
    assert motion.inside(x - 0.05, x + 0.05).tolist() == [False, False, False, False]
    assert motion.inside(x[1:3], x[1:3]).all()
    aside = np.array([[1, 2, 2, 2]])
    assert not motion.empty(aside - 1.5, aside + 1.5).any()
    assert motion.empty(aside - 1.25, aside + 1.25).all()


def test_a_dilated_motion():
    ball = trimesh.creation.icosphere()
    motion = IndicatorMotion(np.stack([ball.vertices, ball.vertices + 1]), ball.faces)
    dilated = motion.dilated(0.25)
    assert dilated.dilated(0.25) is dilated
    assert motion.dilated(0) is motion
    assert (dilated.margin, motion.margin) == (0.25, 0.0)
    assert dilated.geometry == motion.geometry
    assert dilated.digest != motion.digest
    assert (dilated.lower[1:] <= motion.lower[1:] - 0.25).all()
    assert (dilated.lower[0], dilated.upper[0]) == (0, 1)
    assert "margin 0.25" in repr(dilated)
    for grid in (dilated.to_grid(resolution=8), dilated.to_grid(resolution=8, margin=0.25)):
        assert grid.digest == motion.to_grid(resolution=8, margin=0.25).digest
        assert grid.margin == 0.25
    with pytest.raises(IndicatorError, match=r"dilated by 0\.25 already"):
        dilated.dilated(0.5)
    with pytest.raises(IndicatorError, match=r"dilated by 0\.25 already"):
        dilated.to_grid(margin=0.5)
    with pytest.raises(IndicatorError, match="margin must be"):
        IndicatorMotion(motion.frames, motion.faces, margin=-1)


def test_landmarks_lie_on_the_border():
    ball = trimesh.creation.icosphere(subdivisions=2)
    motion = IndicatorMotion(np.stack([ball.vertices, ball.vertices + 1]), ball.faces, times=[2, 3])
    assert len(motion.landmarks()) == 2 * len(ball.vertices)
    landmarks = motion.dilated(0.25).landmarks()
    assert len(landmarks) == 2 * len(ball.vertices)
    middle = landmarks[:, :1] - 2
    assert np.linalg.norm(landmarks[:, 1:] - middle, axis=1) == pytest.approx(1.25, abs=1e-3)


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_random_points_are_of_the_object(rng, margin):
    solid = trimesh.creation.torus(1, 0.3)
    motion = IndicatorMotion(turning(solid), solid.faces, times=[1, 2, 4, 5, 6]).dilated(margin)
    points = motion.points(5000, rng)
    assert points.shape == (5000, 4)
    assert motion.contains(points).mean() > (0.95 if margin else 0.3)  # undecided, as a rule, and rounded
    assert np.histogram(points[:, 0], bins=5, range=(1, 6))[0] == pytest.approx(1000, abs=150)


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_cells_hold_the_object(rng, margin):
    solid = trimesh.creation.torus(1, 0.3)
    motion = IndicatorMotion(turning(solid), solid.faces, time_cells=5)
    grid, dilated = motion.to_grid(resolution=20, margin=margin), motion.dilated(margin)
    x = rng.uniform(dilated.sample_lower, dilated.sample_upper, (20_000, 4))
    x[:, 0] = rng.uniform(grid.lower[0], grid.upper[0], len(x))
    assert grid.contains(x[dilated.decide(x) == IN]).all()
