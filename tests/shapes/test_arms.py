"""What an arm's colliding configurations answer is true, against distances that are computed another way."""

import copy

import numpy as np
import pytest
import trimesh
import warp as wp
from arm_cases import BRANCHES, random_arm, robot
from exact_mesh import squared_between_segments
from plain_shapes import within
from scipy.spatial import ConvexHull

import warp_bounding as wb
from warp_bounding.arms import WORLD, Arm, ArmConfigurations, Body, Joint, Mimic
from warp_bounding.arms.kernels import Chain, placed
from warp_bounding.certificates.statement import statement
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
    return arm, obstacles, ArmConfigurations(arm, obstacles, self_collision=False, **options)


def configurations(shape, rng, count):
    return rng.uniform(shape.lower, shape.upper, (count, shape.ndim))


def boxes(shape, rng, count):
    x = configurations(shape, rng, count)
    size = 10.0 ** rng.uniform(-4, -0.3, (count, 1)) * rng.random(x.shape)
    return np.maximum(x - size, shape.lower), np.minimum(x + size, shape.upper)


@SLIDES
@pytest.mark.parametrize("n", [3, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.parametrize("safety", [0.0, 0.05])
def test_truth_is_that_of_the_bodies(n, slides, safety, rng):
    """A safety distance is in metres; weights scale coordinates and nothing else."""
    for _ in range(2):
        arm, obstacles, plain = cell(rng, n, slides, safety=safety)
        q, weights = configurations(plain, rng, 40), 2.0 ** rng.integers(-1, 3, n)
        gaps = np.array([gap_at(arm, obstacles, each) for each in q]) - safety
        shape = ArmConfigurations(arm, obstacles, self_collision=False, weights=weights, safety=safety)
        assert np.array_equal(shape.lower, plain.lower * weights)
        for answers in (plain.decide(q), shape.decide(q * weights)):
            assert (answers[gaps > BLURRED] == OUT).all()
            assert (answers[gaps < -BLURRED] != OUT).all()
            assert (answers[gaps < -1e-3] == IN).all()


@SLIDES
def test_kernels_place_links_as_the_arm_does(slides, rng):
    arm, _, shape = cell(rng, 3, slides)
    turns, places = (wp.types.matrix(shape=size, dtype=wp.float64) for size in ((9, 3), (3, 3)))

    @wp.kernel(module="unique", enable_backward=False)
    def place(chain: Chain, q: wp.array(dtype=wp.vec3d), turn: wp.array(dtype=turns), at: wp.array(dtype=places)):
        i = wp.tid()
        a, b = placed(chain, q[i], turns(), places())
        turn[i] = a
        at[i] = b

    q = configurations(shape, rng, 5)
    turn, at = (wp.zeros(5, dtype=kind, device="cpu") for kind in (turns, places))
    wp.launch(place, 5, [shape._collisions.chain, wp.array(q, dtype=wp.vec3d, device="cpu"), turn, at], device="cpu")
    frames = arm.frames(q)
    axes = np.stack([frames[:, i, :3, :3] @ joint.axis for i, joint in enumerate(arm.joints)], axis=1)
    assert np.abs(turn.numpy().reshape(5, 3, 3, 3)[..., 2] - axes).max() < 1e-14
    assert np.abs(at.numpy() - frames[:, :, :3, 3]).max() < 1e-14


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


def test_obstacles_leave_an_arm_checked_against_itself(tmp_path):
    """Shape, certificate and file say what is checked."""
    arm, far = straight(), [Body.sphere([9, 9, 9], 0.1)]
    folded = np.array([[0.0, 3.0, 0.0], [0.0, 0.1, 0.1]])
    for shape, held, words in (
        (ArmConfigurations(arm, far), [True, False], "3 with obstacles, 1 of the arm itself, without neighbours"),
        (ArmConfigurations(arm), [True, False], "checked: 1 of the arm itself, without neighbours"),
        (ArmConfigurations(arm, far, self_collision=False), [False, False], "the arm is NOT checked against itself"),
    ):
        assert shape.contains(folded).tolist() == held
        assert words in repr(shape)
    near = ArmConfigurations(arm, [Body.sphere([0, 2, 0], 0.3)], self_collision=False)
    wb.fit(near, method="aabb", device="cpu", progress=False).save(tmp_path / "arm.safetensors")
    known = statement(wb.load(tmp_path / "arm.safetensors", device="cpu"))["what is proven"]
    assert "3 with obstacles, the arm is NOT checked against itself" in known


def test_what_a_user_writes_by_mistake_gets_one_line_with_the_mend():
    arm, ball, box = straight(), Body.sphere([1, 0, 0], 0.2), trimesh.creation.box([1, 1, 1])
    assert ArmConfigurations(arm, ball).digest == ArmConfigurations(arm, [ball]).digest
    mesh, hull = wb.load_shape(box), r"Body\.hull\(mesh\.vertices\)"
    for make, message in (
        *((lambda obstacles=each: ArmConfigurations(arm, obstacles), hull) for each in (box, [box], mesh)),
        (lambda: Arm([Joint()], box), "expected objects of Body, got Trimesh"),
        (lambda: Arm([np.eye(4)], [ball]), "expected objects of Joint, got ndarray"),
        (lambda: ArmConfigurations("robot.urdf", [ball]), "expected an Arm, got str; .*load_urdf"),
        (lambda: ArmConfigurations(arm, ball, self_collision=None), "self_collision to be True or False, got None"),
    ):
        with pytest.raises(wb.ShapeError, match=message) as caught:
            make()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("weights", [None, [0.2, 3.0, 1.0]])
def test_values_of_another_unit_are_refused_and_are_not_free(weights):
    """Degrees, and millimetres of what slides; a continuous joint takes any angle, and a little beyond is no error."""
    joints = [Joint(lower=-3, upper=3), Joint(axis=[1, 0, 0], lower=0, upper=0.5, slides=True), Joint(continuous=True)]
    arm = Arm(joints, [Body.capsule([0, 0, 0], [1, 0, 0], 0.1, link=2)])
    shape = ArmConfigurations(arm, Body.sphere([0.5, 0, 0], 0.1), weights=weights)
    fitted = wb.fit(shape, method="aabb", device="cpu", progress=False)
    for q in ([90, 0.2, 0], [0, -90, 0], [1.0, 250, 1.0]):
        x = np.array([[0.0, 0.1, 0.2], q]) * shape.weights
        with pytest.raises(wb.errors.QueryError, match="expected radians, and metres of what slides, times weights"):
            shape.contains(x)
        bounder = copy.deepcopy(fitted)
        with pytest.warns(wb.BoundingWarning, match="expected radians"):
            assert bounder.query(x[1:].astype(np.float32)).numpy().all()
        bounder.query(x[1:])  # once
    for q in ([3.5, 0.2, 0], [-6, 0.6, 300], [np.nan, 0, 0], [0, np.inf, 0]):
        x = np.array([q]) * shape.weights
        shape.contains(x)
        fitted.query(x)
    for ask in (shape.contains, fitted.query, lambda x: fitted.prepare(np.float32(x))):
        with pytest.raises(wb.errors.QueryError, match=r"shape \(N, 3\), got \(1, 6\); .*q\[:, shape\.columns\]"):
            ask(np.zeros((1, 6)))


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
        ArmConfigurations(arm, obstacles),
        ArmConfigurations(arm, obstacles[:-1], self_collision=False),
        ArmConfigurations(arm, obstacles, self_collision=False, weights=[1, 2, 3]),
        ArmConfigurations(arm, obstacles, self_collision=False, safety=0.05),
        ArmConfigurations(Arm((*arm.joints[:2], Joint()), arm.bodies), obstacles, self_collision=False),
    ]
    assert len({shape.digest, *(other.digest for other in others)}) == 6
    assert ArmConfigurations(arm, obstacles, self_collision=False, name="other").digest == shape.digest


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


# --- trees, and what a robot does to itself ---------------------------------------------------------------------------

CARRY = ((0,), (0, 1), (0, 2), (0, 2, 3))  # the joints that move each link


def gap_of(shape: ArmConfigurations, q: np.ndarray) -> float:
    """The least distance of the pairs that are checked, at one configuration, metres."""
    frames = {WORLD: np.eye(4)} | dict(enumerate(shape.arm.frames(q[None])[0]))
    placed = [each.moved(frames[each.link]) for each in (*shape.arm.bodies, *shape.obstacles)]
    pairs = [(placed[a], placed[b]) for a, b in shape.pairs]
    return min(hulls_apart(a.points, b.points) - a.radius - b.radius for a, b in pairs)


@pytest.fixture
def shapes(rng) -> list[ArmConfigurations]:
    return [
        ArmConfigurations(arm, [Body.sphere([0.9, 0.2, 0.1], 0.2)], self_collision=True, weights=[1.0, 2.0, 0.5])
        for arm in (robot(rng) for _ in range(3))
    ]


def test_truth_of_a_tree_is_that_of_the_bodies(shapes, rng):
    for shape in shapes:
        assert shape.arm.free == (0, 1, 2)
        links = {tuple(shape.arm.bodies[k].link for k in pair) for pair in shape.pairs if max(pair) < 7}
        assert {(1, 2), (1, 3)} <= links  # across the branches
        x = configurations(shape, rng, 60)
        gaps = np.array([gap_of(shape, q) for q in x / shape.weights])
        answers = shape.decide(x)
        assert (answers[gaps > BLURRED] == OUT).all()
        assert (answers[gaps < -1e-3] == IN).all()


def test_bodies_stay_within_what_a_path_reaches(rng):
    """`Arm.path` names each joint between two bodies, from either of them."""
    arm = robot(rng)
    q = rng.uniform(arm.lower, arm.upper, (200, len(arm.free)))
    frames = arm.frames(q)
    for one in range(len(BRANCHES)):
        for body in range(len(arm.bodies) - 1):
            path = arm.path(one, body)
            assert {joint for joint, *_ in path} == set(CARRY[one]) ^ set(CARRY[arm.bodies[body].link])
            for joint, sign, far in path:
                assert sign == (-1 if joint in CARRY[one] else 1)
                if arm.joints[joint].slides:
                    assert far == 1
                    continue
                at = frames[:, joint]
                link = frames[:, arm.bodies[body].link]
                points = arm.bodies[body].points @ link[:, :3, :3].transpose(0, 2, 1) + link[:, None, :3, 3]
                axis, way = at[:, :3, :3] @ arm.joints[joint].axis, points - at[:, None, :3, 3]
                assert np.linalg.norm(np.cross(way, axis[:, None]), axis=2).max() <= far


def test_a_tree_of_one_branch_is_the_chain(rng):
    arm, obstacles = random_arm(rng, 3, False)
    tree = Arm(arm.joints, arm.bodies, parents=(-1, 0, 1), mimics={})
    one, other = ArmConfigurations(arm, obstacles), ArmConfigurations(tree, obstacles)
    assert one.digest == other.digest
    assert ArmConfigurations(Arm(arm.joints, arm.bodies, parents=(-1, 0, 0)), obstacles).digest != one.digest


def test_a_tree_is_proven(shapes):
    shape = shapes[0]
    assert wb.fit(shape, method="aabb", device="cpu").certificate.proven
    assert shape.waves.shape[1] == shape.ndim


def straight() -> Arm:
    step = np.eye(4)
    step[0, 3] = 1.0
    links = [Body.box([0, -0.1, -0.1], [0.9, 0.1, 0.1], link=i, name=f"link {i}") for i in range(3)]
    axes = ([0, 0, 1], [0, 1, 0], [1, 0, 0])
    return Arm([Joint(step if i else np.eye(4), axes[i]) for i in range(3)], links)


def test_self_collision_has_the_joints_that_matter(rng):
    arm = straight()
    own = arm.self_collision()
    assert own.columns.tolist() == [1, 2]  # no pair of links is moved by the first joint alone
    whole = ArmConfigurations(arm, self_collision=True)
    q = configurations(whole, rng, 3000)
    assert np.array_equal(own.contains(q[:, own.columns]), whole.contains(q))
    rounded = arm.self_collision(revolved=["link 2"])
    assert rounded.columns.tolist() == [1]  # the last joint turns a box about its length
    found = rounded.contains(q[:, rounded.columns])
    assert found[whole.contains(q)].all()  # a solid of revolution holds all that turns
    assert found.mean() < whole.contains(q).mean() + 0.05
    assert rounded.note == "solids of revolution in place of link 2"
    with pytest.raises(wb.ShapeError, match="names of its parts to revolve, got link 9"):
        arm.self_collision(revolved=["link 9"])


def test_self_collision_of_some_pairs_and_of_the_others_are_all(rng):
    step = np.eye(4)
    step[0, 3] = 1.0
    links = [Body.box([0, -0.1, -0.1], [0.9, 0.1, 0.1], link=i, name=f"link {i}") for i in range(4)]
    arm = Arm([Joint(step if i else np.eye(4), [0, i % 2, 1]) for i in range(4)], links)
    some = [("link 3", "link 1")]
    whole, own, others = (arm.self_collision(**pairs) for pairs in ({}, {"only": some}, {"without": some}))
    assert (len(whole.pairs), len(own.pairs), len(others.pairs)) == (3, 1, 2)
    assert own.columns.tolist() == [2, 3]  # fewer joints move these two against each other
    q = rng.uniform(arm.lower, arm.upper, (5000, 4))
    found, rest = own.contains(q[:, own.columns]), others.contains(q[:, others.columns])
    assert found.any()
    assert (rest & ~found).any()
    assert np.array_equal(found | rest, whole.contains(q[:, whole.columns]))
    assert own.note == "pairs of parts: only link 3 and link 1"
    assert others.note == "pairs of parts: not link 3 and link 1"
    with pytest.raises(wb.ShapeError, match="expected pairs of parts that are checked, got link 0 and link 1"):
        arm.self_collision(without=[("link 0", "link 1")])
    with pytest.raises(wb.ShapeError, match="no two parts could touch"):
        arm.self_collision(only=[])


def test_joints_of_a_whole_turn_turn_without_end_for_self_collision(rng):
    arm = straight()
    limits = ((-1.0, 1.0), (-2 * np.pi, 2 * np.pi), (-3.0, 3.0))
    joints = [Joint(j.origin, j.axis, *ends) for j, ends in zip(arm.joints, limits, strict=True)]
    wide, followed = Arm(joints, arm.bodies), Arm(joints, arm.bodies, mimics={2: Mimic(1, 0.5)})
    own, whole = wide.self_collision(), ArmConfigurations(wide, self_collision=True)
    assert own.upper[0] < 3.2 < own.arm.joints[0].upper + 0.1
    q = configurations(whole, rng, 3000)
    held = whole.contains(q)
    assert 0.02 < held.mean() < 0.98
    assert np.array_equal(own.contains(q[:, own.columns]), held)
    assert followed.self_collision().upper[0] > 6  # its limits are also those of what follows it
    ends = (3.14159, 3.1415)  # as files write pi; and less
    joints = [Joint(j.origin, j.axis, -end, end) for j, end in zip(arm.joints, (*ends, 3.0), strict=True)]
    assert [joint.continuous for joint in Arm(joints, arm.bodies).endless().joints] == [True, False, False]


def test_pairs_that_always_touch_are_left_out(rng):
    arm = straight()
    ball, knob = (Body.sphere([0.9, 0, 0], r, link=i, name=n) for r, i, n in ((0.4, 0, "ball"), (1.8, 2, "knob")))
    thick = Arm(arm.joints, [*arm.bodies, ball, knob])
    own = thick.self_collision()
    for obstacles in ([], [Body.sphere([9, 9, 9], 1)]):
        with pytest.warns(wb.BoundingWarning, match=r"in 100% of 256 .* most of all .*ball and knob.*"):
            whole = ArmConfigurations(thick, obstacles)
        assert whole.contains(configurations(whole, rng, 100)).all()
    assert "they touch in all of 2,000 random configurations: " in own.note
    assert "ball and knob" in own.note
    assert (3, 4) in set(map(tuple, whole.pairs)) - set(map(tuple, own.pairs))
    named = Arm(thick.joints, thick.bodies, touching=[("knob", "ball")])
    assert (3, 4) not in set(map(tuple, ArmConfigurations(named).pairs))


def test_what_is_no_tree_is_refused():
    joints, bodies = [Joint(), Joint(), Joint(lower=-3, upper=3)], [Body.sphere([1, 0, 0], 0.1, link=2)]
    for options, message in (
        ({"parents": (-1, 1, 0)}, "expected a parent for each joint"),
        ({"parents": (-1, 0)}, "expected a parent for each joint"),
        ({"mimics": {1: Mimic(2)}}, "no leader before it"),
        ({"mimics": {1: Mimic(0), 2: Mimic(1)}}, "no leader before it"),
        ({"mimics": {2: Mimic(0, 0.0)}}, "by 0"),
        ({"mimics": {2: Mimic(0, 9.0)}}, "by 9"),
        ({"touching": [(0, "x")]}, "pairs of links"),
        ({"touching": [("a", "b")]}, "pairs of links"),
    ):
        with pytest.raises(wb.ShapeError, match=message):
            Arm(joints, bodies, **options)
