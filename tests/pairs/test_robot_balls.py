"""Balls of robots: those that are made hold every link, those of others are proven or refuted, without a tolerance."""

import json

import numpy as np
import pytest
from commands import check_bad, run

from warp_bounding.errors import BoundingError
from warp_bounding.pairs import RobotBalls

trimesh = pytest.importorskip("trimesh")
JOINT = '<joint name="{0}" type="{1}"><parent link="base"/><child link="{0}"/>{2}</joint>'
TURN = '<axis xyz="0 0 1"/><limit lower="-1" upper="1"/>'
POSE = '<origin xyz="0.1 0.2 -0.05" rpy="0.3 -0.4 0.5"/>'


def solid(shape, origin=POSE):
    return f"<collision>{origin}<geometry>{shape}</geometry></collision>"


ROUND = solid('<cylinder radius="0.05" length="0.3"/>') + solid('<sphere radius="0.06"/>')
PARTS = {
    "base": solid('<box size="0.3 0.2 0.1"/>') + solid('<mesh filename="ring.obj" scale="1 1 -1"/>', ""),
    "upper": ROUND,
    "lower": solid('<capsule radius="0.04" length="0.2"/>') + "<visual/>",
    "hand": solid('<mesh filename="open.obj" scale="0.1 0.1 0.1"/>'),
    "flange": "",
}


@pytest.fixture
def robot(tmp_path):
    """A file of a robot with one link of each kind of geometry, a closed mesh and an open one."""
    trimesh.creation.torus(0.15, 0.03, 16, 8).export(tmp_path / "ring.obj")
    shell = trimesh.creation.box()
    trimesh.Trimesh(shell.vertices, shell.faces[:-3]).export(tmp_path / "open.obj")
    return written(tmp_path, PARTS)


def written(folder, parts):
    links = "".join(f'<link name="{name}">{inside}</link>' for name, inside in parts.items())
    joints = [JOINT.format(name, "revolute" if name == "upper" else "fixed", TURN) for name in list(parts)[1:]]
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="mixed">{links}{"".join(joints)}</robot>')
    return file


def points_of(folder, rng):
    """Points of each link, by other means: shapes of trimesh, at poses of trimesh."""
    matrix = trimesh.transformations.euler_matrix(0.3, -0.4, 0.5, "sxyz")
    matrix[:3, 3] = 0.1, 0.2, -0.05
    ring, shell = (trimesh.load(folder / f"{name}.obj", force="mesh") for name in ("ring", "open"))
    shell.apply_scale(0.1)
    box, turn = rng.uniform(-1, 1, (4000, 3)) * [0.15, 0.1, 0.05], rng.uniform(0, 2 * np.pi, 4000)
    tube = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), rng.choice([-0.15, 0.15, 0.0], 4000)])
    way = rng.normal(size=(4000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    ends = 0.04 * way + np.outer(rng.choice([-0.1, 0.1], 4000), [0, 0, 1])

    def posed(x):
        return x @ matrix[:3, :3].T + matrix[:3, 3]

    inside = trimesh.sample.volume_mesh(ring, 4000)
    return {
        "base": np.concatenate([posed(box), ring.sample(4000), inside]),
        "upper": posed(np.concatenate([tube, 0.06 * way])),
        "lower": posed(ends),
        "hand": posed(shell.sample(4000)),
    }


def out_of(points, balls):
    return (np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]).min(axis=1)


@pytest.mark.parametrize("suffix", ["urdf", "yaml"])
def test_balls_hold_every_link_and_so_do_their_files(robot, rng, suffix):
    made = RobotBalls.of(robot, 30, progress=False)
    assert sum(map(len, made.links.values())) <= 30
    made.save(robot.parent / f"balls.{suffix}")
    read = RobotBalls.load(robot.parent / f"balls.{suffix}")
    for link, points in points_of(robot.parent, rng).items():
        np.testing.assert_array_equal(read.links[link], made.links[link])
        assert out_of(points, read.links[link]).max() <= 1e-12  # what sampling rounds
    held = read.certify(robot, progress=False)
    assert list(held) == ["base", "upper", "lower", "hand"]
    assert all(link.proven and link.growth == 0 and link.point is None for link in held.values())


def test_more_balls_stand_out_less(robot):
    few, many = (sum(b[:, 3].max() for b in RobotBalls.of(robot, n).links.values()) for n in (8, 40))
    assert many < few


def test_what_is_refuted_is_shown_by_a_point_and_mended(robot, rng):
    made = RobotBalls.of(robot, 20)
    points = points_of(robot.parent, rng)
    less = {link: np.maximum(balls - [0, 0, 0, 0.01], [-9, -9, -9, 0]) for link, balls in made.links.items()}
    held = RobotBalls(less).certify(robot)
    for link, found in held.items():
        assert found.kind == "refuted"
        assert out_of(np.array([found.point]), less[link])[0] >= found.outside > 0
        assert out_of(points[link], less[link]).max() <= found.growth
        assert found.outside <= found.growth <= 0.0102
    more = {link: less[link] + [0, 0, 0, found.growth] for link, found in held.items()}
    assert all(found.proven for found in RobotBalls(more).certify(robot).values())


@pytest.mark.parametrize("size", ["0.1 0.1 0.1", "0.2 0.1 0.05"])
def test_the_point_is_of_the_link_and_the_distance_is_the_largest(tmp_path, size):
    file = written(tmp_path, {"base": solid(f'<box size="{size}"/>', "")})
    half = np.array(size.split(), dtype=float) / 2
    [found] = RobotBalls({"base": [[0.0, 0.0, 0.0, 0.06]]}).certify(file).values()
    true = np.linalg.norm(half) - 0.06
    assert (np.abs(found.point) <= half).all()
    assert 0.99 * true <= found.outside <= true <= found.growth <= 1.02 * true


def test_a_sphere_is_held_by_itself_exactly_and_by_no_less(tmp_path):
    file = written(tmp_path, {"base": solid('<sphere radius="0.082031"/>')})
    own = RobotBalls.load(file)
    assert own.certify(file)["base"].proven
    less = RobotBalls({"base": own.links["base"] - [0, 0, 0, 1e-15]}).certify(file)["base"]
    assert less.kind == "undecided"
    assert less.growth > 0
    less = RobotBalls({"base": own.links["base"] - [0, 0, 0, 1e-3]}).certify(file)["base"]
    assert less.kind == "refuted"
    assert 0.0009 < less.outside <= 0.001 <= less.growth


@pytest.mark.parametrize("closed", [True, False])
def test_a_hollow_within_a_closed_mesh_is_found(tmp_path, closed):
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    trimesh.Trimesh(box.vertices, box.faces if closed else box.faces[:-1]).export(tmp_path / "box.obj")
    file = written(tmp_path, {"base": solid('<mesh filename="box.obj"/>', "")})
    places = np.linspace(-0.1, 0.1, 9)
    grid = np.stack(np.meshgrid(places, places, places), axis=-1).reshape(-1, 3)
    shell = grid[np.abs(grid).max(axis=1) == 0.1]
    [found] = RobotBalls({"base": np.column_stack([shell, np.full(len(shell), 0.03)])}).certify(file).values()
    assert found.kind == ("refuted" if closed else "proven")
    assert not closed or (np.abs(found.point).max() < 0.1 and found.growth >= 0.07 - 1e-9)


def test_time_that_is_over_proves_nothing(robot):
    held = RobotBalls.of(robot, 20).certify(robot, budget=0.0)["base"]
    assert held.kind != "proven"
    assert held.growth == np.inf


BAD = {
    "a.txt": ("", "expected a name that ends with .urdf, .yaml, .yml"),
    "a.yaml": ("collision_spheres: {base: [{center: [0, 0, 0]}]}", "'radius' is missing"),
    "b.yml": ("- 1", "expected collision_spheres"),
    "c.yaml": ("collision_spheres: {base: [{center: [0, 0], radius: 1}]}", "expected collision_spheres"),
    "d.yaml": ("collision_spheres: {base: [{center: [0, 0, .nan], radius: 1}]}", "finite"),
    "a.urdf": (
        '<robot><link name="base">' + solid('<box size="1 1 1"/>') + "</link></robot>",
        "expected balls, got box",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_files_that_are_refused(tmp_path, name):
    (tmp_path / name).write_text(BAD[name][0])
    with pytest.raises(BoundingError, match=BAD[name][1]) as error:
        RobotBalls.load(tmp_path / name)
    assert "\n" not in str(error.value)


def test_balls_that_curobo_switches_off_and_its_own_form(tmp_path):
    text = "{base: [{center: [0, 0, 1], radius: 2}, {center: [0, 0, 0], radius: -10.0}]}"
    (tmp_path / "a.yml").write_text(f"robot_cfg: {{kinematics: {{collision_spheres: {text}}}}}")
    found = RobotBalls.load(tmp_path / "a.yml")
    np.testing.assert_array_equal(found.links["base"], [[0, 0, 1, 2]])
    with pytest.raises(BoundingError, match="of no URDF"):
        found.save(tmp_path / "a.urdf")


WRONG = {
    "fit {robot} -o {few}": "--balls 60",
    "fit {robot} --balls 3 -o {few}": "from 4",
    "fit {robot} --balls 9 --margin 1 -o {few}": "take no --margin",
    "fit {robot} --balls 9 -o {robot}": "is read here",
    "fit {robot} --balls 9 -o {few}.safetensors": "ends with .urdf",
    "certify {balls} {robot} --length 1": "leave out --length",
    "certify {robot} {balls}": "expected balls, got box; the balls come first",
    "certify {balls} {balls}.npy": "balls.urdf.npy",
}


def test_the_commands(robot, capsys):
    balls, few = robot.parent / "balls.urdf", robot.parent / "few.yaml"
    status, out, _ = run(capsys, "fit", robot, "--balls", 12, "-o", balls, "--json")
    assert status == 0
    assert json.loads(out)["proven"]
    status, out, _ = run(capsys, "certify", balls, robot)
    assert status == 0
    assert "proven: 4 of 4 links" in out
    RobotBalls({"upper": RobotBalls.load(balls).links["upper"], "none": [[0, 0, 0, 1]]}).save(few)
    status, out, err = run(capsys, "certify", few, robot, "--json")
    found = json.loads(out)
    assert status == 1
    assert found["kind"] == "refuted"
    assert "none" in err
    assert [link["proven"] for link in found["links"].values()] == [False, True, False, False]
    assert found["links"]["base"]["growth"] is None
    for words, message in WRONG.items():
        status, out, err = run(capsys, *words.format(robot=robot, balls=balls, few=few).split())
        check_bad(status, out, err)
        assert message in err
