"""What a motion says of points and boxes of time and space is true, as are its cells: against rational arithmetic, with
no tolerance at all.

There are two truths, and answers hold for both: the straight ways, and what ``vertices_at`` rounds them to.
"""

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from exact_mesh import NAMES, check_boxes, check_decided, hard_points, in_tetrahedron, mesh_case, squared_distance
from hypothesis import example, given
from hypothesis import strategies as st
from plain_shapes import LEANING, TETRAHEDRON

import warp_bounding as wb
from warp_bounding.errors import ShapeError
from warp_bounding.queries.boundary import ENDS_SHARE, border_points
from warp_bounding.shapes import Mesh, MovingMesh
from warp_bounding.shapes.formula import SPARE, time_axis
from warp_bounding.shapes.motion import MAX_TIMES
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED, HalfSpaces


def _motion_case(name: str, rng, keyframes: int, wild: bool) -> tuple[MovingMesh, list[np.ndarray]]:
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
    motion = MovingMesh(np.array(frames)[:, of], mesh.faces, times)
    index = [[int(np.flatnonzero((mesh.vertices == c).all(axis=1))[0]) for c in corners] for corners in enclosed]
    return motion, index


def _exact_vertices(motion: MovingMesh, time: float) -> np.ndarray:
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


def _truths(motion: MovingMesh, enclosed: list, margin: float, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each point, whether it is in the object of straight ways, and in that of rounded vertices."""
    exact, rounded = [], []
    for time, *x in points.tolist():
        exact.append(_in(_exact_vertices(motion, time), motion.faces, enclosed, margin, x))
        rounded.append(_in(motion.vertices_at(time), motion.faces, enclosed, margin, x))
    return np.array(exact), np.array(rounded)


def _moments(motion: MovingMesh, margin: float, rng, count: int) -> np.ndarray:
    """Hard points of the mesh at some times, keyframes among them."""
    first, last = motion.times[[0, -1]]
    times = np.r_[rng.uniform(first, last, 2), motion.times[rng.integers(len(motion.times))]].astype(np.float32)
    times = np.clip(times, first, last)
    found = []
    for time in times.tolist():
        at = Mesh(motion.vertices_at(time), motion.faces)
        x = hard_points(at, margin, rng, count)
        found.append(np.insert(x, 0, time, axis=1))
    return np.concatenate(found)


def _linear(known: HalfSpaces, i: int, x: np.ndarray) -> Fraction:
    """The linear function of box i at a point, exactly."""
    terms = zip(known.slope[i].tolist(), x.tolist(), known.center[i].tolist(), strict=True)
    return Fraction(known.level[i]) + sum(Fraction(s) * (Fraction(p) - Fraction(c)) for s, p, c in terms)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "far away"])  # refused: too coarse in float32
@pytest.mark.parametrize(("margin", "wild"), [(0.0, False), (0.125, True)])
def test_points_and_boxes(rng, name, margin, wild):
    plain, enclosed = _motion_case(name, rng, 4, wild)
    motion = plain.dilated(margin)
    points = _moments(plain, margin, rng, 2)
    exact, rounded = _truths(plain, enclosed, margin, points)
    answer = motion.decide(points)
    held, free = exact | rounded, ~(exact & rounded)
    check_decided(answer, held, free)
    sure = np.resize(np.arange(14) < 2, len(points))  # those at random
    assert (answer == UNDECIDED)[sure].mean() <= 0.1
    for _ in range(3):
        lower, upper, empty = check_boxes(motion, points, answer, held, free, rng)
        known = motion.half_spaces(lower, upper)
        assert (known.empty == empty).all()
        assert all(_linear(known, i, points[i]) >= 0 for i in np.flatnonzero(held))


def test_a_hollow_is_part_of_the_object_while_it_is_shut():
    """A vase whose rim goes through itself: no face comes near the middle, and yet it is inside at the end."""
    profile = [[0, 0], [1, 0.4], [1, 1.6], [0.5, 2], [0.3, 2], [0.8, 1.5], [0.8, 0.5], [0, 0.2]]
    vase = trimesh.creation.revolve(np.array(profile), sections=24)
    shut, rim = vase.vertices.copy(), vase.vertices[:, 2] > 1.99
    shut[rim, :2] *= 1 - 0.4 / np.linalg.norm(shut[rim, :2], axis=1, keepdims=True)
    motion = MovingMesh(np.array([vase.vertices, shut]), vase.faces)
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
    motion = MovingMesh(np.array(frames), solid.faces, times, margin=0.01)
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
    motion = MovingMesh(frames, faces)
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


def test_before_and_after_the_motion_there_is_nothing():
    ball = trimesh.creation.icosphere()
    motion = MovingMesh(np.stack([ball.vertices] * 2), ball.faces, times=[0, 2])
    x = np.array([[-0.1, 0, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0], [2.1, 0, 0, 0]])
    assert motion.decide(x).tolist() == [OUT, IN, IN, OUT]
    assert motion.empty(x - 0.05, x + 0.05).tolist() == [True, False, False, True]
    assert motion.inside(x - 0.05, x + 0.05).tolist() == [False, False, False, False]
    assert motion.inside(x[1:3], x[1:3]).all()
    aside = np.array([[1, 2, 2, 2]])
    assert not motion.empty(aside - 1.5, aside + 1.5).any()
    assert motion.empty(aside - 1.25, aside + 1.25).all()


def test_half_spaces_far_away_in_time_and_over_many_keyframes(rng):
    solid = trimesh.creation.icosphere(subdivisions=1)
    times = 1e6 + 2.0**-4 * np.arange(30)
    angles = np.linspace(0, 3, len(times))
    frames = np.array([solid.vertices * (1 + 0.2 * np.sin(a)) + [a, 0, np.cos(3 * a)] for a in angles])
    motion = MovingMesh(frames, solid.faces, times).dilated(0.02)
    at = rng.uniform(times[0], times[-1], 3000)
    border = np.array([np.insert(motion.vertices_at(t)[rng.integers(len(solid.vertices))], 0, t) for t in at])
    size = 10.0 ** rng.uniform(-3, 0, (len(border), 1)) * [1.5, 0.3, 0.3, 0.3]
    low, high = border - size * rng.random(border.shape), border + size * rng.random(border.shape)
    known = motion.half_spaces(low, high)
    spans = np.searchsorted(times, high[:, 0]) - np.searchsorted(times, low[:, 0])
    found = known.slope.any(axis=1)
    assert found[spans <= 1].sum() > 20
    assert found[(spans > 1) & (spans < 6)].any()
    assert (spans > 9).sum() > 100
    assert not found[spans > 9].any()
    for _ in range(10):
        x = low + rng.random(low.shape) * (high - low)
        value = known.level + (known.slope * (x - known.center)).sum(axis=1)
        assert (value[(motion.decide(x) == IN) & ~known.empty] >= 0).all()


def stretching(mesh, keyframes=9, angle=np.pi, shift=(0.3, 0.0, 0.1)) -> np.ndarray:
    frames = []
    for share in np.linspace(0, 1, keyframes):
        turn = trimesh.transformations.rotation_matrix(share * angle, [1, 2, 3])[:3, :3]
        frames.append(mesh.vertices @ turn.T * (1 + 0.3 * np.sin(3 * share)) + share * np.array(shift))
    return np.array(frames)


SMALL = {
    "box": lambda: trimesh.creation.box(extents=(1, 0.6, 0.3)),
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=2, radius=0.5),
}


@pytest.mark.parametrize(("name", "margin"), [("box", 0.07), ("sphere", 0.0)])
def test_every_point_at_every_time_lies_in_an_occupied_cell(name, margin, rng):
    solid = SMALL[name]()
    motion = MovingMesh(stretching(solid), solid.faces, times=np.linspace(2.0, 3.5, 9), time_cells=7)
    assert motion.watertight
    grid = motion.to_grid(resolution=14, margin=margin)
    assert grid.time
    assert grid.lower[0] == 2.0
    assert grid.upper[0] == 3.5
    ends = grid.position(np.arange(grid.shape[0] + 1)[:, None] - 0.5)[:, 0]
    times = np.unique(np.concatenate([rng.uniform(2.0, 3.5, 20), motion.times, ends]).astype(np.float32))
    for t in times:
        corners = motion.vertices_at(t).astype(np.float64)[solid.faces]
        x = np.einsum("fkc,fcx->fkx", rng.dirichlet(np.ones(3) / 2, size=(len(corners), 30)), corners).reshape(-1, 3)
        x = np.concatenate([x, corners.reshape(-1, 3)])
        inside = rng.uniform(x.min(axis=0), x.max(axis=0), (200, 3))
        at = trimesh.Trimesh(motion.vertices_at(t).astype(np.float64), solid.faces, process=False)
        x = np.concatenate([x, inside[at.contains(inside)]])
        if margin:
            away = rng.normal(size=x.shape)
            x += away / np.linalg.norm(away, axis=1, keepdims=True) * margin * rng.random((len(x), 1))
        assert grid.contains(np.column_stack([np.full(len(x), t, np.float64), x])).all()


@given(start=st.floats(-1e3, 1e3, width=32), length=st.floats(2.0**-6, 1e3, width=32), count=st.integers(1, MAX_TIMES))
@example(start=2.0, length=1.5, count=7)
@example(start=-0.3, length=1e-2, count=MAX_TIMES)
def test_cells_of_time_lie_between_the_keyframes(start, length, count):
    start, end = float(np.float32(start)), float(np.float32(start + length))
    rate, begin, cells = time_axis(start, end, count, "motion")
    assert count <= cells <= count + SPARE
    assert float(np.float32(rate)) == rate
    assert (2 * begin).is_integer()
    assert Fraction(start) <= Fraction(begin) / Fraction(rate)
    assert (Fraction(begin) + cells) / Fraction(rate) <= Fraction(end)
    assert (Fraction(end) - Fraction(start)) * Fraction(rate) - cells < 1
    with pytest.raises(ShapeError, match="float32 cells can divide"):
        time_axis(0.0, 2.0**-149, 32, "motion")


@pytest.mark.parametrize("behind", [True, False])
def test_a_jump_between_neighbouring_numbers_that_a_face_of_time_cuts(behind):
    solid, end, count = SMALL["box"](), 3.0, 7
    rate, begin, cells = time_axis(0.0, end, count, "motion")
    faces = (begin + np.arange(1, cells)) / rate
    rounded = faces.astype(np.float32)
    keyframe = rounded[(rounded > faces) == behind][0]  # the nearest number to a face, on one side of it
    other = np.nextafter(keyframe, np.float32(0.0 if behind else end))
    there = np.array(solid.vertices, dtype=np.float32) + np.float32(10.0)
    frames = [solid.vertices, solid.vertices, there, solid.vertices][:: 1 if behind else -1]
    motion = MovingMesh(np.array(frames), solid.faces, np.sort([0.0, keyframe, other, end]), count)
    x = np.column_stack([np.full(len(there), keyframe), motion.vertices_at(keyframe)])
    assert (x[:, 1:] == there).all()
    assert motion.to_grid(resolution=40).contains(x).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frames": np.zeros((1, 3, 3))}, "K >= 2"),
        ({"frames": np.full((2, 8, 3), np.nan)}, "finite"),
        ({"faces": np.array([[0, 1, 99]])}, "vertices 0 to 7"),
        ({"times": [1.0, 0.0]}, "ascending"),
        ({"times": [0.0, 1.0, 2.0]}, "2 ascending"),
        ({"time_cells": 0}, "time_cells"),
    ],
)
def test_bad_motions(change, words):
    solid = SMALL["box"]()
    good = {"frames": stretching(solid, 2), "faces": solid.faces}
    with pytest.raises(ShapeError, match=words):
        MovingMesh(**(good | change))


def test_distances_at_a_time(rng):
    """As the mesh that the motion is then, but for the rounding of its vertices."""
    frames = np.stack([LEANING, LEANING + np.float32(0.5), LEANING * np.float32(2)])
    motion = wb.shapes.MovingMesh(frames, TETRAHEDRON[1], times=[0.0, 1.0, 3.0], margin=0.05)
    for time in (0.0, 0.3, 1.0, 2.5, 3.0):
        x = np.column_stack([np.full(1000, time), rng.uniform(-2, 4, (1000, 3))])
        bounds = motion.distances(x)
        still = wb.shapes.Mesh(motion.vertices_at(time), TETRAHEDRON[1], margin=0.05).distances(x[:, 1:])
        assert (bounds[:, 0] <= bounds[:, 1]).all()
        assert (bounds[:, 0] <= still[:, 1] + 1e-6).all()  # the mesh then is rounded to float32
        assert (bounds[:, 1] >= still[:, 0] - 1e-6).all()
        assert (bounds[:, 1] - bounds[:, 0] < 1e-5).mean() > 0.99
    outside = motion.distances(np.array([[-1.0, 0, 0, 0], [4.0, 0, 0, 0], [np.nan, 0, 0, 0], [1.0, np.inf, 0, 0]]))
    assert (outside == [0, np.inf]).all()
    assert (motion.distance(x) == motion.distances(x)[:, 0]).all()


def test_an_object_that_is_cut_off_has_points_on_its_ends(rng):
    ball, count, axis = SMALL["sphere"](), 4000, 0
    frames = [ball.vertices, ball.vertices * 1.2 + 0.3, ball.vertices + np.array([0.5, 0.0, 0.0])]
    shape = MovingMesh(np.array(frames), ball.faces, times=[0.5, 1.0, 3.0])
    x = border_points(shape, count, rng)
    assert shape.contains(x).all()
    for end in (shape.lower[axis], shape.upper[axis]):
        on = x[x[:, axis] == end]
        assert 0.5 * ENDS_SHARE / 2 < len(on) / count <= ENDS_SHARE / 2
        away = np.delete(on, axis, axis=1)
        outside = away + 1e-3 * (away - away.mean(axis=0))  # outwards, about
        assert (~shape.contains(np.insert(outside, axis, end, axis=1))).mean() > 0.5
