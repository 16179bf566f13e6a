"""What an arm's colliding configurations answer is true, against distances that are computed another way."""

import numpy as np
import pytest
import trimesh
from arm_cases import random_arm
from exact_mesh import squared_between_segments
from scipy.spatial import ConvexHull

import warp_bounding as wb
from warp_bounding.arms import WORLD, Arm, ArmConfigurations, Body, Joint
from warp_bounding.shapes.shape import IN, OUT

SLIDES = pytest.mark.parametrize("slides", [False, True])
BLURRED = 1e-8  # metres: what the distances of the tests themselves may be off


def hulls_apart(one: np.ndarray, other: np.ndarray) -> float:
    """The distance of two hulls of points, below 0 by their depth where they meet; up to about 1e-9."""
    if len(one) <= 2 and len(other) <= 2:
        ends = (points[i].tolist() for points in (one, other) for i in (0, -1))
        return float(squared_between_segments(*ends)) ** 0.5
    differences = (other[:, None] - one[None]).reshape(-1, 3)
    hull = ConvexHull(differences)
    outside = hull.equations[:, 3].max()
    if outside < 0:
        return outside
    mesh = trimesh.Trimesh(differences, hull.simplices, process=False)
    return float(trimesh.proximity.closest_point_naive(mesh, [[0.0, 0.0, 0.0]])[1][0])


def gap_at(arm: Arm, obstacles: list[Body], q: np.ndarray) -> float:
    """The least distance of a link from an obstacle at one configuration, metres."""
    frames = arm.frames(q[None])[0]
    least = np.inf
    for body in (body for body in arm.bodies if body.link != WORLD):
        points = body.points @ frames[body.link][:3, :3].T + frames[body.link][:3, 3]
        for other in obstacles:
            least = min(least, hulls_apart(points, other.points) - body.radius - other.radius)
    return least


def cell(rng, n=3, slides=False, **options):
    arm, obstacles = random_arm(rng, n, slides)
    return arm, obstacles, ArmConfigurations(arm, obstacles, **options)


def configurations(shape, rng, count):
    return rng.uniform(shape.lower, shape.upper, (count, shape.ndim))


def boxes(shape, rng, count):
    x = configurations(shape, rng, count)
    size = 10.0 ** rng.uniform(-4, -0.3, (count, 1)) * rng.random(x.shape)
    return np.maximum(x - size, shape.lower), np.minimum(x + size, shape.upper)


def within(lower, upper, rng):
    share = rng.random(lower.shape)
    share[::2] = np.round(share[::2])  # corners, which are the hardest
    return np.clip(lower + share * (upper - lower), lower, upper)


@SLIDES
@pytest.mark.parametrize("n", [3, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.parametrize("safety", [0.0, 0.05])
def test_truth_is_that_of_the_bodies(n, slides, safety, rng):
    """A safety distance is in metres; weights scale coordinates and nothing else."""
    for _ in range(2):
        arm, obstacles, plain = cell(rng, n, slides, safety=safety)
        q, weights = configurations(plain, rng, 40), 2.0 ** rng.integers(-1, 3, n)
        gaps = np.array([gap_at(arm, obstacles, each) for each in q]) - safety
        shape = ArmConfigurations(arm, obstacles, weights=weights, safety=safety)
        assert np.array_equal(shape.lower, plain.lower * weights)
        for answers in (plain.decide(q), shape.decide(q * weights)):
            assert (answers[gaps > BLURRED] == OUT).all()
            assert (answers[gaps < -BLURRED] != OUT).all()
            assert (answers[gaps < -1e-3] == IN).all()


def test_an_arm_that_touches_itself(rng):
    step = np.eye(4)
    step[0, 3] = 1.0
    links = [Body.capsule([0, 0, 0], [1, 0, 0], 0.05, link=i) for i in range(3)]
    arm = Arm([Joint(), Joint(step), Joint(step)], links)
    shape = ArmConfigurations(arm)
    x = configurations(shape, rng, 4000)
    answers = shape.decide(x)
    moved = x.copy()
    moved[:, 0] = rng.uniform(-np.pi, np.pi, len(x))  # which no pair of its own links can tell
    assert (shape.decide(moved) == answers).all()
    assert (answers[np.abs(x[:, 1:]).max(axis=1) < 0.5] == OUT).all()
    assert (answers[(np.abs(x[:, 1]) > 2.9) & (np.abs(x[:, 2]) < 2)] == IN).any()
    lower, upper = boxes(shape, rng, 2000)
    empty = shape.empty(lower, upper)
    assert empty.any()
    assert (shape.decide(within(lower, upper, rng))[empty] == OUT).all()
    assert ArmConfigurations(Arm(arm.joints, links, touching=[(0, 2)]), [Body.sphere([9, 9, 9], 1)]).ndim == 3
    with pytest.raises(wb.ShapeError, match="nothing that could touch"):
        ArmConfigurations(Arm(arm.joints, links, touching=[(0, 2)]))


def test_a_query_at_a_limit_is_one_of_the_shape(rng):
    arm = Arm([Joint()], [Body.capsule([0, 0, 0], [-1, 0, 0], 0.1, link=0)])
    shape = ArmConfigurations(arm, [Body.sphere([1, 0, 0], 0.2)], weights=[0.3])
    at = (np.array([[-np.pi], [np.pi]]) * 0.3).astype(np.float32)
    assert (shape.decide(at) == IN).all()
    bounder = wb.fit(shape, method="aabb", device="cpu")
    assert np.asarray(bounder.query(at)).all()


def test_limits_that_float32_widens_count():
    most = float(np.float32(0.1))  # above 0.1
    joints = [Joint(), Joint(axis=(1, 0, 0), lower=0, upper=0.1, slides=True)]
    arm = Arm(joints, [Body.sphere([0, 0, 0], 1e-4, link=1)])
    shape = ArmConfigurations(arm, [Body.sphere([-most - 2e-4 + 1e-9, 0, 0], 1e-4)])
    assert shape.decide([[np.pi, most]])[0] == IN
    box = np.array([[-np.pi, most]]), np.array([[np.pi, most]])
    assert not shape.empty(*box)[0]
    assert not shape.half_spaces(*box).empty[0]


def test_boxes_that_go_far_beyond_the_limits():
    arm = Arm([Joint(axis=(1, 0, 0), lower=0, upper=1, slides=True)], [Body.sphere([0, 0, 0], 0.1, link=0)])
    shape = ArmConfigurations(arm, [Body.sphere([0.5, 0, 0], 0.1)])
    assert shape.decide([[0.5]])[0] == IN
    for far in (1.0, 1e10, 1e155, 1e308):
        box = np.array([[-far]]), np.array([[far]])
        assert not shape.empty(*box)[0]
        assert not shape.half_spaces(*box).empty[0]
    assert shape.empty(np.array([[2.0]]), np.array([[1e300]]))[0]


def trees(rng):
    """Two branches of two joints that may touch each other."""
    arm, _ = random_arm(rng, 4)
    joints = [Joint(joint.origin, joint.axis, -2.0, 2.0) for joint in arm.joints]
    return ArmConfigurations(Arm(joints, arm.bodies, parents=(-1, 0, -1, 2)), self_collision=True)


@pytest.mark.parametrize(
    "made", [lambda rng: cell(rng, 2)[2], lambda rng: cell(rng, 6)[2], lambda rng: cell(rng, 6, True)[2], trees]
)
def test_half_spaces_of_boxes_at_the_border_hold_what_collides(made, rng):
    """Where both orders of the bounds matter: boxes of all sizes around configurations at which bodies just touch."""
    known = 0
    for _ in range(4):
        shape = made(rng)
        x = configurations(shape, rng, 4000)
        collides = shape.contains(x)
        count = min(collides.sum(), (~collides).sum(), 300)
        one, other = x[collides][:count], x[~collides][:count]
        for _ in range(12):
            middle = (one + other) / 2
            held = shape.contains(middle)[:, None]
            one, other = np.where(held, middle, one), np.where(held, other, middle)
        cube = np.arange(count)[:, None] % 2 == 0
        size = 10.0 ** rng.uniform(-3, -0.4, (count, 1)) * np.where(cube, 1.0, rng.random(one.shape))
        lower, upper = np.maximum(one - size, shape.lower), np.minimum(one + size, shape.upper)
        found = shape.half_spaces(lower, upper)
        assert not found.empty.any()
        known += found.slope.any(axis=1).sum()
        for _ in range(200):
            y = within(lower, upper, rng)
            value = found.level + (found.slope * (y - found.center)).sum(axis=1)
            assert (value[shape.decide(y) == IN] >= 0).all()
    assert known > 100


def test_a_digest_tells_arms_apart(rng):
    arm, obstacles, shape = cell(rng, 3)
    others = [
        ArmConfigurations(arm, obstacles[:-1]),
        ArmConfigurations(arm, obstacles, weights=[1, 2, 3]),
        ArmConfigurations(arm, obstacles, self_collision=True),
        ArmConfigurations(arm, obstacles, safety=0.05),
        ArmConfigurations(Arm((*arm.joints[:2], Joint()), arm.bodies), obstacles),
    ]
    assert len({shape.digest, *(other.digest for other in others)}) == 6
    assert ArmConfigurations(arm, obstacles, name="other").digest == shape.digest


def test_what_is_no_arm_and_no_cell_is_refused_in_one_line(rng):
    arm, obstacles, shape = cell(rng, 2)
    for make, message in (
        (lambda: Arm([Joint()], [Body.sphere([0, 0, 0], 1, link=1)]), "is of link 1"),
        (lambda: Arm([Joint()], [Body.sphere([0, 0, 0], 1)]), "at least one body that a joint moves"),
        (lambda: Joint(lower=1, upper=0), "the lower one first, got 1.0 and 0.0"),
        (lambda: Joint(lower=np.nan), "expected limits"),
        (lambda: Joint(axis=[0, 0, 0]), "an axis of 3 numbers that are not all 0"),
        (lambda: Joint(np.diag([1.0, 1, -1, 1])), "without a scale or a mirror"),
        (lambda: Body([[0, 0]]), "points of 3 numbers"),
        (lambda: Body.sphere([0, 0, 0], -1), "a radius from 0"),
        (lambda: Body.box([1, 0, 0], [0, 1, 1]), "the lower one first"),
        (lambda: ArmConfigurations(arm, [Body.sphere([0, 0, 0], 1, link=0)]), "is an obstacle, and it is of link 0"),
        (lambda: ArmConfigurations(arm, obstacles, weights=[1.0]), "a weight for each of 2 joints"),
        (lambda: ArmConfigurations(arm, obstacles, safety=-1.0), "margin|safety"),
        (lambda: shape.dilated(0.1), r"no margin, got margin=0\.1; give a safety distance"),
    ):
        with pytest.raises(wb.ShapeError, match=message) as caught:
            make()
        assert "\n" not in str(caught.value)
    assert shape.dilated(0.0) is shape
