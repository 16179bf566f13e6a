"""Arms that are trees, whose joints follow others, and what a robot does to itself."""

import numpy as np
import pytest
from arm_cases import BRANCHES, random_arm, robot
from test_arms import BLURRED, configurations, hulls_apart

import warp_bounding as wb
from warp_bounding.arms import WORLD, Arm, ArmConfigurations, Body, Joint, Mimic
from warp_bounding.shapes.shape import IN, OUT

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
    """Both ways around: what moves one body against another is told of each joint between them."""
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


def test_pairs_that_always_touch_are_left_out():
    arm = straight()
    ball, knob = (Body.sphere([0.9, 0, 0], r, link=i, name=n) for r, i, n in ((0.4, 0, "ball"), (1.8, 2, "knob")))
    thick = Arm(arm.joints, [*arm.bodies, ball, knob])
    own, whole = thick.self_collision(), ArmConfigurations(thick, self_collision=True)
    assert "they touch in all of 2,000 random configurations: " in own.note
    assert "ball and knob" in own.note
    assert (3, 4) in set(map(tuple, whole.pairs)) - set(map(tuple, own.pairs))
    named = Arm(thick.joints, thick.bodies, touching=[("knob", "ball")])
    assert (3, 4) not in set(map(tuple, ArmConfigurations(named, self_collision=True).pairs))


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
