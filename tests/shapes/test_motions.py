"""Whole motions: what is proven free is free at every sample of it, by Coal, without any tolerance."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from arm_cases import BRANCHES, posed, random_arm, random_body, robot
from commands import check_bad, run

import warp_bounding as wb
from warp_bounding.arms import Arm, Body, Cylinder, DistanceField, Joint, Motions, Scan
from warp_bounding.rigid import lengths

coal_clearance = pytest.importorskip("coal_clearance", reason="needs Coal: pip install 'warp-bounding[arms]'")
clearance = coal_clearance.clearance
COAL = 2e-6  # metres: how accurate Coal's distances are


def cylinders(rng, count: int) -> list[Cylinder]:
    return [Cylinder(*rng.uniform(0.02, 0.3, 2), posed(rng, 0.6), f"can {k}") for k in range(count)]


def edges(arm: Arm, rng, count: int, length: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    q0 = rng.uniform(arm.lower, arm.upper, (count, len(arm.free)))
    return q0, np.clip(q0 + rng.normal(size=q0.shape) * length * rng.uniform(size=(count, 1)), arm.lower, arm.upper)


def along(q0: np.ndarray, q1: np.ndarray, count: int) -> np.ndarray:
    return q0 + np.linspace(0, 1, count)[:, None] * (q1 - q0)


CASES = {f"{n} joints": (n, n % 2 == 1) for n in (1, 3, 6, 10)}


@pytest.mark.parametrize("case", [*CASES, "branches"])
def test_what_is_proven_is_free_at_every_sample(case, rng):
    arm = robot(rng) if case == "branches" else random_arm(rng, *CASES[case])[0]
    obstacles = [random_body(rng, -1, place) for place in rng.normal(size=(4, 3)) * 0.8] + cylinders(rng, 2)
    base = Motions(arm, obstacles)
    q0, q1 = edges(arm, rng, 25)
    proven = 0
    for a, b in zip(q0, q1, strict=True):
        x = along(a, b, 30)
        least = clearance(arm, obstacles, base.pairs, x).min()
        clear, share = (each[0] for each in base.segments(a[None], b[None], until=True))
        assert clear == (share == 1.0)
        assert not clear or least > 0.0
        if share > 0.0:
            assert clearance(arm, obstacles, base.pairs, along(a, a + share * (b - a), 20)).min() > 0.0
        if least > COAL:  # a margin that is a little too large for this motion is never proven
            proven += clear
            assert not Motions(arm, obstacles, margin=least + COAL).segments(a[None], b[None])[0][0]
    assert proven or case in ("6 joints", "10 joints")  # whose bodies touch each other nearly everywhere


@pytest.mark.parametrize("n", [2, 7])
def test_what_is_free_by_far_is_proven(n, rng):
    arm, _ = random_arm(rng, n)
    obstacles = [random_body(rng, -1, place) for place in rng.normal(size=(3, 3))] + cylinders(rng, 1)
    motions = Motions(arm, obstacles, self_collision=False)
    q0, q1 = edges(arm, rng, 80)
    least = np.array(
        [clearance(arm, obstacles, motions.pairs, along(a, b, 15)).min() for a, b in zip(q0, q1, strict=True)]
    )
    free = least > 0.02
    assert free.sum() > 5
    assert motions.segments(q0[free], q1[free])[0].all()


def test_configurations_are_those_of_the_shape(rng):
    arm, obstacles = random_arm(rng, 3)
    motions, shape = Motions(arm, obstacles), wb.arms.ArmConfigurations(arm, obstacles)
    q = rng.uniform(arm.lower, arm.upper, (20_000, 3))
    states, hits = motions.configurations(q), shape.contains(q)
    assert (states[~hits] != 2).all()
    assert (states[hits] != 0).all()
    assert (states == 1).mean() < 1e-3
    assert {0, 2} <= set(states.tolist())
    assert [named is None for named in motions.culprits(q[:200])] == (states[:200] == 0).tolist()


def test_many_at_once_are_those_one_by_one(device, rng):
    arm, obstacles = random_arm(rng, 4)
    motions = Motions(arm, obstacles, device=device)
    q0, q1 = edges(arm, rng, 200)
    clear, share = motions.segments(q0, q1)
    one = [motions.segments(a[None], b[None]) for a, b in zip(q0, q1, strict=True)]
    assert clear.tolist() == [each[0][0] for each in one]
    assert share.tolist() == [each[1][0] for each in one]
    assert motions.segments(q0[:0], q1[:0])[0].shape == motions.configurations(q0[:0]).shape == (0,)
    here = Motions(arm, obstacles)
    assert (clear == here.segments(q0, q1)[0]).mean() > 0.99  # sines of another library
    assert (motions.configurations(q0) == here.configurations(q0)).mean() > 0.99
    back = motions.segments(q1, q0, until=True)[0]
    assert (back == motions.segments(q0, q1, until=True)[0]).mean() > 0.99


def test_motions_of_more_joints_than_a_shape_may_have(rng):
    step = np.eye(4)
    step[0, 3] = 0.1
    joints = [Joint(step, rng.normal(size=3), -0.5, 0.5) for _ in range(64)]
    links = [Body.capsule([0, 0, 0], [0.1, 0, 0], 0.02, link=i) for i in range(64)]
    arm = Arm(joints, links, touching=[(i, j) for i in range(64) for j in range(i + 2, min(i + 4, 64))])
    motions = Motions(arm, [Body.sphere([20, 0, 0], 1.0)], self_collision=False)
    q0, q1 = edges(arm, rng, 10, 0.2)
    assert motions.segments(q0, q1)[0].all()
    with pytest.raises(wb.BoundingError, match="at most 16 joints"):
        wb.arms.ArmConfigurations(arm, [Body.sphere([20, 0, 0], 1.0)])
    with pytest.raises(wb.BoundingError, match="1 to 64 joints, got 65"):
        Arm([*joints, Joint()], links)


def test_obstacles_come_move_and_go(rng):
    arm, _ = random_arm(rng, 2)
    ball = Body.sphere([0, 0, 0], 0.6, name="ball")
    away, can = np.eye(4), Cylinder(0.1, 0.2, posed(rng, 0.3), "can")
    away[:3, 3] = 100.0
    motions, (q0, q1) = Motions(arm, self_collision=False), edges(arm, rng, 300)
    assert motions.segments(q0, q1)[0].all()
    motions.add([ball, can])
    both = motions.segments(q0, q1)[0]
    assert not both.all()
    motions.move("ball", away)
    assert np.array_equal(motions.segments(q0, q1)[0], Motions(arm, can, self_collision=False).segments(q0, q1)[0])
    motions.move("ball", np.eye(4))
    assert np.array_equal(motions.segments(q0, q1)[0], both)
    motions.remove("can")
    assert np.array_equal(motions.segments(q0, q1)[0], Motions(arm, ball, self_collision=False).segments(q0, q1)[0])
    with pytest.raises(wb.BoundingError, match="name of an obstacle, ball, got can"):
        motions.move("can", away)


def test_what_is_attached_is_checked(rng):
    arm = Arm(
        [Joint(), Joint()], [Body.box([-0.1, -0.1, 0], [0.1, 0.1, 1], link=i, name=f"link {i}") for i in range(2)]
    )
    tool, lifted = Body.capsule([0, 0, 1], [1, 0, 1], 0.05, name="tool"), np.eye(4)
    lifted[:3, 3] = [0.5, 0, 1]
    carrying = Motions(arm, [Body.sphere([1, 0, 1], 0.1, name="ball")], attached={"link 1": tool})
    q = np.array([[0.0, 0.0], [1.0, 1.0]])
    assert carrying.configurations(q).tolist() == [2, 0]
    assert carrying.culprits(q)[0] == ("tool", "ball")
    can = Motions(arm, [Body.sphere([1, 0, 1], 0.1)], attached={"link 1": Cylinder(0.6, 0.1, lifted, "can")})
    assert can.configurations([*q, [0.0, np.pi / 2]]).tolist() == [2, 0, 0]
    assert can.culprits(q)[0][0] == "can"
    with pytest.raises(wb.BoundingError, match="a part that carries what is attached, of link 0, link 1, got hand"):
        Motions(arm, attached={"hand": tool})


def test_obstacles_that_move_are_avoided_at_their_times(rng):
    arm, _ = random_arm(rng, 3)
    obstacles = [random_body(rng, -1, place) for place in rng.normal(size=(9, 3)) * 0.4] + cylinders(rng, 3)
    obstacles = [replace(body, name=f"thing {k}") for k, body in enumerate(obstacles)]
    velocities = {body.name: rng.normal(size=3) * 0.5 for body in obstacles[1:]}
    motions, (q0, q1) = Motions(arm, obstacles), edges(arm, rng, 40, 1.5)
    before = motions.segments(q0, q1)[0]
    clear, _ = motions.segments(q0, q1, velocities=velocities)
    assert 0 < clear.sum() < len(clear)
    t = np.linspace(0, 1, 30)
    shifts = np.stack([t[:, None] * velocities.get(body.name, np.zeros(3)) for body in obstacles], axis=1)
    for a, b, free in zip(q0, q1, clear, strict=True):
        least = clearance(arm, obstacles, motions.pairs, a + t[:, None] * (b - a), shifts).min()
        assert free or least < 0.02
        assert not free or least > 0.0
    assert np.array_equal(motions.segments(q0, q1)[0], before)
    with pytest.raises(wb.BoundingError, match=r"expected a velocity \(3,\) of thing 1"):
        motions.segments(q0, q1, velocities={"thing 1": [1, 2]})


def test_what_is_proven_among_triangles_is_free(rng):
    arm, _ = random_arm(rng, 3)
    triangles = rng.normal(size=(60, 1, 3)) * 0.6 + rng.normal(size=(60, 3, 3)) * 0.1
    scan = Scan(triangles, 0.01, posed(rng, 0.1), "scan")
    motions, (q0, q1) = Motions(arm, scan), edges(arm, rng, 30)
    single = [Body(corners, 0.01, name=f"{k}") for k, corners in enumerate(scan.placed)]
    clear, share = motions.segments(q0, q1, until=True)
    assert 0 < clear.sum() < len(clear)
    alone = Motions(arm, single).segments(q0, q1, until=True)
    assert np.array_equal(clear, alone[0])
    assert np.allclose(share, alone[1], atol=2.0**-11)
    normals = np.cross(scan.placed[:, 1] - scan.placed[:, 0], scan.placed[:, 2] - scan.placed[:, 0])
    flat = [Body([*x, x[0] + 1e-6 * n / lengths(n)], 0.01) for x, n in zip(scan.placed, normals, strict=True)]
    for a, b, free in zip(q0[:10], q1[:10], clear[:10], strict=True):  # Coal takes solids
        least = clearance(arm, flat, motions.pairs, along(a, b, 15)).min()
        assert not free or least > 0.0
        assert free or least < 0.02
    q = rng.uniform(arm.lower, arm.upper, (500, 3))
    assert np.array_equal(motions.configurations(q), Motions(arm, single).configurations(q))
    hit = q[motions.configurations(q) == 2]
    assert {named[1] for named in motions.culprits(hit)} - {body.name for body in arm.bodies} == {"scan"}


def test_the_inside_of_a_closed_mesh_counts(rng):
    tetrahedron = wb.shapes.Mesh(
        [[0, 0, 0], [8, 0, 0], [0, 8, 0], [0, 0, 8]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    )
    arm = Arm([Joint(), Joint()], [Body.sphere([0.5, 0, 0], 0.1, link=i, name=f"ball {i}") for i in range(2)])
    shift = np.eye(4)
    shift[:3, 3] = [-2, -2, -2]
    around, away = Scan.of_mesh(tetrahedron, pose=shift, name="rock"), np.eye(4)
    away[:3, 3] = [50, 0, 0]
    motions, q = Motions(arm, around, self_collision=False), rng.uniform(-3, 3, (20, 2))
    assert (motions.configurations(q) == 2).all()
    assert motions.culprits(q[:1])[0][1] == "rock"
    assert not motions.segments(q[:10], q[10:])[0].any()
    motions.move("rock", away)
    assert (motions.configurations(q) == 0).all()
    open_mesh = Scan.of_mesh(wb.shapes.Mesh(tetrahedron.vertices, tetrahedron.faces[:3]), pose=shift)
    assert (Motions(arm, open_mesh, self_collision=False).configurations(q) == 0).all()


@pytest.fixture(scope="module")
def rock():
    ball, rng = trimesh.creation.icosphere(1), np.random.default_rng(0)
    vertices = ball.vertices * rng.uniform(0.5, 1, (len(ball.vertices), 1)) * [0.5, 0.3, 0.6]
    mesh = wb.shapes.Mesh(vertices, ball.faces)
    options = {"nodes": 20, "device": "cpu"}
    return mesh, {k: wb.fit(mesh, "distance", "distance-grid", storage=k, **options) for k in ("float16", "uint8")}


@pytest.mark.parametrize(("n", "storage"), [(2, "uint8"), (4, "float16"), (7, "uint8")])
def test_what_is_proven_by_distances_is_free(n, storage, rock, rng):
    mesh, far = rock[0], rock[1][storage]
    arm, _ = random_arm(rng, n, slides=n == 4)
    pose, velocity, (q0, q1) = posed(rng), rng.normal(size=3) * 0.3, edges(arm, rng, 40)
    pose[:3, 3] = (arm.frames(q1[:1])[0, -1] @ [*arm.bodies[-1].points[0], 1.0])[:3]
    truth = Scan.of_mesh(mesh, pose=pose)
    motions = Motions(arm, far.field(pose, name="rock"), self_collision=False)
    exact = Motions(arm, truth, self_collision=False)
    t, proven = np.linspace(0, 1, 12), 0
    for moving in (np.zeros(3), velocity):
        clear, share = motions.segments(q0, q1, until=True, velocities={"rock": moving})
        for a, b, free, part in zip(q0, q1, clear, share, strict=True):
            if part > 0:
                x, shifts = a + part * t[:, None] * (b - a), part * t[:, None, None] * moving
                assert clearance(arm, [truth], motions.pairs, x, shifts).min() > 0.0
            assert free == (part == 1.0)
        proven += clear.sum()
    assert 0 < proven < 2 * len(q0)
    q = rng.uniform(arm.lower, arm.upper, (5000, n))
    states, far_off = motions.configurations(q), Motions(arm, truth, self_collision=False, margin=0.15)
    assert (exact.configurations(q)[states == 0] == 0).all()
    assert (states[far_off.configurations(q) == 0] == 0).all()
    assert set(states) == {0, 1}
    assert motions.culprits(q[states == 1][:1])[0][1] == "rock"


def test_plans_by_distances_know_them(rock):
    far = rock[1]["uint8"]
    arm = Arm([Joint()], [Body.capsule([0.2, 0, 0], [1, 0, 0], 0.05, link=0, name="link")])
    pose, away = np.eye(4), np.eye(4)
    pose[0, 3], away[1, 3] = 1.4, 50.0
    motions = Motions(arm, [far.field(pose, name="rock")])
    plan = motions.path([[1.5], [2.5]])
    assert plan.proven
    assert plan.certify(Motions(arm, far.field(pose))).proven
    assert not motions.path([[1.5], [0.0]]).proven
    assert motions.path([[1.5], [0.0]]).between == ("link", "rock")
    lower = DistanceField(far.field().values - 1e-3, *(getattr(far.field(), k) for k in ("center", "half", "spacing")))
    for other in (lower.moved(pose), far.field()):
        with pytest.raises(wb.BoundingError, match="a plan among other things"):
            plan.certify(Motions(arm, other))
    motions.move("rock", away)
    assert motions.path([[1.5], [0.0]]).proven
    with pytest.raises(wb.BoundingError, match="an obstacle is proven, 3D"):
        type(far)(far.domain, far.tensors, far.sizes, "cpu").field()
    with pytest.raises(wb.BoundingError, match="nodes all over the box"):
        DistanceField(np.ones((2, 2, 2)), np.zeros(3), np.ones(3), np.ones(3))


def test_points_and_heights(rng):
    arm = Arm([Joint()], [Body.capsule([0.2, 0, 0], [1, 0, 0], 0.05, link=0)])
    angles = np.linspace(0.5, 2.5, 300)
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * rng.uniform(0.2, 1, (300, 1))
    motions = Motions(arm, Scan.of_points(points, 0.01))
    assert motions.configurations([[0.0], [1.5], [-1.0]]).tolist() == [0, 2, 0]
    clear, share = motions.segments([[0.0], [0.0]], [[-1.5], [1.5]], until=True)
    assert clear.tolist() == [True, False]
    assert 0.1 < share[1] < 0.4
    hill = np.where(np.abs(np.linspace(-1, 1, 41))[:, None] < 0.2, 0.1, -0.5) * np.ones((1, 41))
    assert Motions(arm, Scan.of_heights(hill, [-1, -1], [1, 1])).configurations([[0.0]]).tolist() == [2]
    low = Scan.of_heights(hill - 0.2, [-1, -1], [1, 1])
    assert Motions(arm, low).configurations([[0.0], [1.5]]).tolist() == [0, 0]
    for bad, match in ((np.zeros((3, 2)), "points"), (np.full((1, 1, 3), np.nan), "finite")):
        with pytest.raises(wb.BoundingError, match=match):
            Scan(bad)


def test_a_plan_is_kept_and_proven_again(tmp_path, rng):
    arm, obstacles = random_arm(rng, 3)
    motions = Motions(arm, obstacles)
    q = rng.uniform(arm.lower, arm.upper, (4000, 3))
    free = q[motions.configurations(q) == 0]
    near = free + np.clip(rng.normal(size=free.shape) * 0.02, arm.lower - free, arm.upper - free)
    start, end = next((a, b) for a, b in zip(free, near, strict=True) if motions.segments(a[None], b[None])[0][0])
    hit = q[motions.configurations(q) == 2][0]
    good, bad = motions.path([start, end, start]), motions.path([start, end, hit])
    assert good.proven
    assert "Proven free: 2 motions" in good.statement
    assert not bad.proven
    assert bad.end[0] == 1
    assert 0 <= bad.end[1] < 1
    assert " and ".join(bad.between) in bad.statement
    for plan in (good, bad):
        plan.save(tmp_path / "plan.json")
        again = wb.arms.Plan.load(tmp_path / "plan.json")
        assert again.statement == plan.statement
        assert again.certify(motions).statement == plan.statement
    motions.add(Body.sphere([50, 0, 0], 0.1))
    with pytest.raises(wb.BoundingError, match="a plan among other things"):
        good.certify(motions)
    (tmp_path / "plan.json").write_text("{}")
    with pytest.raises(wb.BoundingError, match=r"expected a plan that Plan\.save wrote"):
        wb.arms.Plan.load(tmp_path / "plan.json")


def test_plans_are_certified_from_files(tmp_path, rock, capsys):
    link = '<link name="{0}"><collision><geometry><box size="0.2 0.1 0.1"/></geometry></collision></link>'
    joint = (
        '<joint name="turn{2}" type="revolute"><parent link="{0}"/><child link="{1}"/><origin xyz="0.5 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>'
    )
    parts = [link.format(name) for name in "abc"] + [joint.format("a", "b", 1), joint.format("b", "c", 2)]
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    (tmp_path / "can.scene").write_text("cell\n* can\n1\ncylinder\n0.05 0.2\n0.85 0.4 0\n0 0 0 1\n0 0 0 0\n.\n")
    far = rock[1]["uint8"]
    far.save(tmp_path / "rock.safetensors")
    trimesh.creation.box(bounds=[[2, 2, 0], [3, 3, 1]]).export(tmp_path / "box.stl")
    arm = wb.arms.load_urdf(tmp_path / "arm.urdf", held={"turn2": 0.5})
    box = Scan.of_mesh(wb.load_shape(tmp_path / "box.stl"))
    scene = [*wb.arms.load_scene(tmp_path / "can.scene"), box]
    plans = {
        "good": Motions(arm, scene, margin=0.01).path([[-1.0], [0.0]]),
        "bad": Motions(arm, scene, margin=0.01).path([[-1.0], [1.5]]),
        "rock": Motions(arm, far.field()).path([[0.0], [0.3]]),
        "carried": Motions(arm, attached={"c": Body.sphere([0.1, 0, 0], 0.1, name="cup")}).path([[-1.0], [0.0]]),
        "alone": Motions(arm, self_collision=False).path([[-1.0], [0.0]]),
    }
    for name, plan in plans.items():
        plan.save(tmp_path / f"{name}.json")
    robot, hold = tmp_path / "arm.urdf", ("--hold", "turn2=0.5")
    files = ("--scene", f"{tmp_path / 'can.scene'},{tmp_path / 'box.stl'}", *hold)

    def certify(plan: str, *options) -> tuple[int, str, str]:
        return run(capsys, "certify", tmp_path / f"{plan}.json", robot, *options)

    status, out, _ = certify("good", *files)
    assert (status, "proven: Proven free: 1 motions of arm, among 2 obstacles, margin 0.01 m." in out) == (0, True)
    status, out, _ = certify("bad", *files)
    assert (status, "undecided: Proven up to" in out) == (1, True)
    for options, what in ((hold, "robot, scene or SRDF"), ((*files, "--margin", 0.02), "margin")):
        status, out, _ = certify("good", *options)
        assert (status, f"inapplicable: the plan is of another {what}" in out) == (1, True)
    for name, words in (
        ("carried", "of arm carrying cup, among 0"),
        ("alone", "margin 0 m, not checked against itself"),
    ):
        status, out, _ = certify(name, *hold)
        assert (status, words in out) == (0, True)
    carried = tmp_path / "carried.json"
    document = json.loads(carried.read_text())
    document["plan"]["attached"]["c"][0]["radius"] = 0.05  # whoever makes the cup smaller has another plan
    carried.write_text(json.dumps(document))
    assert "inapplicable" in certify("carried", *hold)[1]
    document["plan"]["attached"]["c"][0]["radius"] = -1.0
    carried.write_text(json.dumps(document))
    check_bad(*certify("carried", *hold))
    assert certify("rock", "--scene", tmp_path / "rock.safetensors", *hold)[0] == 1 - plans["rock"].proven
    for options, message in (
        ((*files, "--jobs", 2), "a plan is certified at once; leave out --jobs"),
        (("--scene", "no.scene"), "no.scene"),
        (("--hold", "turn2"), "expected finger=0.04,wrist=0"),
    ):
        told = certify("good", *options)
        check_bad(*told)
        assert message in told[2]
    check_bad(*run(capsys, "certify", tmp_path / "rock.safetensors", robot, *hold))


@pytest.mark.parametrize(
    ("waypoints", "match"),
    [
        ([[0.0, 0.0]], r"expected waypoints \(W, 2\), at least 2, got \(1, 2\)"),
        ([[0.0], [1.0]], r"expected waypoints \(W, 2\)"),
        ([[0.0, 0.0], [0.0, np.nan]], "waypoint 1 is not finite"),
        ([[0.0, 0.0], [0.0, 9.0]], "waypoint 1 has elbow at 9.0, limits -1.0 to 1.0"),
    ],
)
def test_bad_waypoints_get_one_clear_error(waypoints, match):
    joints = [Joint(lower=-1.0, upper=1.0, name=name) for name in ("shoulder", "elbow")]
    arm = Arm(joints, [Body.sphere([1, 0, 0], 0.1, link=1)])
    with pytest.raises(wb.BoundingError, match=match):
        Motions(arm, self_collision=False).path(waypoints)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda arm: Motions(arm.joints), "expected an Arm, got tuple"),
        (lambda arm: Motions(arm, ["box"]), "expected objects of Body or Cylinder or Scan or DistanceField, got str"),
        (lambda arm: Motions(arm, [Body.sphere([0, 0, 0], 1, link=0)]), "is an obstacle, and it is of link 0"),
        (lambda arm: Motions(arm, halvings=25), "expected halvings from 0 to 24, got 25"),
        (lambda arm: Motions(arm, margin=-1), "margin"),
        (lambda arm: Motions(arm).segments([[0.0]], [[0.0]]), r"expected configurations \(N, 4\), got \(1, 1\)"),
        (lambda arm: Motions(arm).segments(np.zeros((2, 4)), np.zeros((1, 4))), "as many ends as starts, got 1 and 2"),
        (lambda arm: Cylinder(-1.0, 1.0), "expected a radius from 0"),
    ],
)
def test_bad_input_gets_one_clear_error(make, match, rng):
    arm, _ = random_arm(rng, len(BRANCHES))
    with pytest.raises(wb.BoundingError, match=match):
        make(arm)


def test_what_rounds_beyond_a_limit_is_at_the_limit(rng):
    limits = rng.uniform(0.1, 3.0, (5, 2)) * [-1, 1]
    joints = [Joint(lower=low, upper=high, slides=k == 3) for k, (low, high) in enumerate(limits)]
    arm = Arm(joints, [Body.sphere([0.1, 0, 0], 0.1, link=4)])
    motions, low, high = Motions(arm, self_collision=False), *limits.T
    q0, q1 = (np.where(rng.uniform(size=(20_000, 5)) < 0.5, low, high) for _ in range(2))
    q0 *= rng.uniform(0.5, 1, q0.shape)
    x = q0 + np.float64(1 - 2.0**-53) * (q1 - q0)
    x = np.concatenate([x, q0 + 1.0 * (q1 - q0), np.nextafter(q1, 9 * q1)])
    assert ((x < low) | (x > high)).any()
    assert (motions.configurations(x) == 0).all()
    assert motions.path(x[-2:]).proven
    assert (motions.configurations(q1 * (1 + 1e-12)) == 1).all()


def test_a_start_that_collides_is_told_with_its_bodies():
    arm = Arm([Joint()], [Body.capsule([0, 0, 0], [1, 0, 0], 0.05, link=0, name="link")])
    balls = [Body.sphere([1, 0, 0], 0.3, name="here"), Body.sphere([0, 1, 0], 0.3, name="there")]
    plan = Motions(arm, balls[::-1]).path([[0.0], [1.5]])
    assert (plan.end, plan.between) == ((0, 0.0), ("link", "here"))


def test_of_numbers_that_are_none_nothing_is_proven(rng):
    arm, _ = random_arm(rng, 2)
    motions = Motions(arm, self_collision=False)
    for bad in (np.nan, np.inf, 1e7):
        assert motions.segments([[0.0, bad]], [[0.0, 0.0]])[0].tolist() == [False]
        assert motions.segments([[0.0, 0.0]], [[0.0, bad]])[1].tolist() == [0.0]
        assert motions.configurations([[0.0, bad]]).tolist() == [1]


def test_balls_around_bodies_hold_them_and_lie_in_their_hulls(rng):
    from warp_bounding.arms.motions import ALLOWANCE, _box_around, _center_of

    for _ in range(50):
        points = random_body(rng, 0).points
        frame, half = _box_around(points)
        x = (points - frame[9:]) @ frame[:9].reshape(3, 3)
        size = np.abs(points).sum(axis=1).max()
        assert (np.abs(x) <= half + ALLOWANCE * size).all()  # the allowance of every gap counts it
        center = _center_of(points)
        assert lengths(points - center).max() <= lengths(points - points.mean(axis=0)).max() * 1.01


def test_a_plan_names_what_is_in_its_way_first():
    arm = Arm([Joint()], [Body.capsule([0, 0, 0], [1, 0, 0], 0.05, link=0, name="link")])
    balls = [Body.sphere([np.cos(q), np.sin(q), 0], 0.1, name=name) for q, name in ((1.5, "middle"), (0.8, "first"))]
    plan = Motions(arm, balls).path([[0.0], [3.0]])
    assert plan.between == ("link", "first")
    assert 0.6 < 3 * plan.end[1] < 0.7
