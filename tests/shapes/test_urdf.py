"""Arms from URDF and SRDF files: what moves, follows, is fixed and held, and bodies that hold all of the geometry."""

import warnings
from itertools import permutations

import numpy as np
import pytest
from format_cases import BINARY_STL, CENTIMETRES, GLB, V, dae
from format_cases import written as stored

import warp_bounding as wb
from warp_bounding.errors import ShapeError

trimesh = pytest.importorskip("trimesh")
BASE = '<link name="base"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>'
ALONG = '<origin xyz="0.25 0 0" rpy="0 1.5707963267948966 0"/>'
CYLINDER = f'<collision>{ALONG}<geometry><cylinder radius="0.05" length="0.5"/></geometry></collision>'
LIMIT = '<limit lower="-2" upper="2.5" effort="1" velocity="1"/>'


def joint(name, parent, child, kind="revolute", xyz="0 0 0", axis="0 0 1", limit=LIMIT, more=""):
    axis = f'<axis xyz="{axis}"/>' if axis else ""
    between = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="0 0 0"/>'
    return f'<joint name="{name}" type="{kind}">{between}{axis}{limit}{more}</joint>'


def written(folder, *parts):
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="two">{"".join(parts)}</robot>')
    return file


def link(name, inside=CYLINDER):
    return f'<link name="{name}">{inside}</link>'


ARM = (
    BASE,
    link("upper"),
    link("lower"),
    link("flange", ""),
    link("finger", '<collision><geometry><sphere radius="0.03"/></geometry></collision>'),
    joint("shoulder", "base", "upper", xyz="0 0 0.1"),
    joint("elbow", "upper", "lower", xyz="0.5 0 0", axis="0 1 0"),
    joint("mount", "lower", "flange", "fixed", xyz="0.5 0 0", limit=""),
    joint("grip", "flange", "finger", "prismatic", axis="1 0 0", limit='<limit lower="0" upper="0.1"/>'),
)


def test_a_chain_with_what_is_fixed_and_held(tmp_path):
    file = written(tmp_path, *ARM)
    whole = wb.arms.load_urdf(file)
    assert [j.name for j in whole.joints] == ["shoulder", "elbow", "grip"]
    assert [j.slides for j in whole.joints] == [False, False, True]
    assert [(j.lower, j.upper) for j in whole.joints] == [(-2, 2.5), (-2, 2.5), (0, 0.1)]
    assert [body.link for body in whole.bodies] == [wb.arms.WORLD, 0, 1, 2]
    held = wb.arms.load_urdf(file, held={"grip": 0.05}, name="one")
    assert (held.name, whole.name) == ("one", "two")
    assert [body.link for body in held.bodies] == [wb.arms.WORLD, 0, 1, 1]
    q = np.array([[0.3, -0.7, 0.05]])
    at = whole.frames(q)[0, 2, :3, 3]
    finger = held.bodies[-1].points[0]
    frame = held.frames(q[:, :2])[0, 1]
    assert np.allclose(frame[:3, :3] @ finger + frame[:3, 3], at)
    out = 0.5 + 0.55 * np.cos(0.7)
    assert np.allclose(at, [np.cos(0.3) * out, np.sin(0.3) * out, 0.1 + 0.55 * np.sin(0.7)])


def test_bodies_hold_their_geometry(tmp_path, rng):
    file = written(tmp_path, *ARM)
    upper = wb.arms.load_urdf(file).bodies[1]
    turn, along, out = rng.uniform(0, 2 * np.pi, 500), rng.uniform(0, 0.5, 500), 0.05 * np.sqrt(rng.uniform(0, 1, 500))
    inside = np.stack([along, out * np.cos(turn), out * np.sin(turn)], axis=1)
    hull = trimesh.PointCloud(upper.points).convex_hull
    away = inside @ hull.face_normals.T - (hull.triangles[:, 0] * hull.face_normals).sum(axis=1)
    assert away.max() <= 0
    assert np.ptp(upper.points, axis=0) == pytest.approx([0.5, 0.1, 0.1], rel=0.03)


def test_a_hull_of_too_many_points_is_held_by_fewer():
    points = trimesh.creation.icosphere(subdivisions=4).vertices * [0.3, 0.1, 0.05]
    body = wb.arms.Body.hull(points)
    assert len(body.points) == 512 < len(points)
    assert 0 < body.radius < 0.01
    hull = trimesh.PointCloud(body.points).convex_hull
    above = points @ hull.face_normals.T - (hull.triangles[:, 0] * hull.face_normals).sum(axis=1)
    assert above.max() <= body.radius
    away = trimesh.proximity.closest_point(hull, points)[1][above.max(axis=1) > 0]
    assert away.max() <= body.radius <= away.max() * (1 + 1e-5)  # no larger than it has to be


TURN = trimesh.transformations.euler_matrix(0.3, 0.4, 0.5)[:3, :3]
DISC = np.array([[np.cos(turn), np.sin(turn), 0.0] for turn in np.linspace(0, 6, 2000)])
THIN = np.array([0, 0, 1e-12])
FLAT = {
    "square": V[:, :3] * [1, 1, 0],
    "line": V[:, :3] * [1, 0, 0],
    "place": V[:, :3] * 0 + 0.5,
    "disc": DISC,
    "turned disc": DISC @ TURN + 100,
    "nearly flat": DISC + [0, 0, 1e-16] * np.arange(2000)[:, None],
    "many on a line": np.linspace(0, 1, 2000)[:, None] * [1.0, 2.0, 3.0],
    "a disc of both sides, as thin as float64 tells": np.concatenate([DISC, DISC + THIN]),
}


@pytest.mark.parametrize("name", FLAT)
def test_flat_points_have_a_hull(name, rng):
    """In every direction the body reaches as far as the points, and not much farther."""
    points = np.asarray(FLAT[name], dtype=np.float64)
    body, size = wb.arms.Body.hull(points, name=name), np.abs(points).max()
    along = rng.normal(size=(500, 3))
    along = np.concatenate([along / np.linalg.norm(along, axis=1, keepdims=True), np.eye(3), -np.eye(3), [TURN[:, 2]]])
    reach = (body.points @ along.T).max(axis=0) + body.radius - (points @ along.T).max(axis=0)
    assert reach.min() >= 0
    assert reach.max() <= 1e-4 * size
    assert len(body.points) <= 512


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((4, 2)), [[0, 0, np.nan]] * 4, [[0, 0, np.inf]] * 600])
def test_points_that_are_none_have_no_hull(points):
    with pytest.raises(ShapeError, match="expected points"):
        wb.arms.Body.hull(points)


MISTAKES = (
    ((BASE, link("a"), joint("float", "base", "a", "floating", limit="")), "type of revolute.* got floating"),
    ((BASE, link("a"), joint("free", "base", "a", limit="")), "free has no limits"),
    ((BASE, link("a"), link("b"), joint("one", "base", "a", more='<mimic joint="two"/>'), joint("two", "a", "b")),
        "one follows a joint that it carries"),
    ((BASE, link("a"), joint("one", "base", "a", more='<mimic joint="one"/>')), "which is no joint of its own"),
    ((BASE, link("a"), joint("one", "base", "a", axis="0 0 0")), "one: expected an axis of 3 numbers"),
    ((BASE, link("a")), "expected one base, a link that no joint carries, got a, base"),
    ((), "expected one base, a link that no joint carries, got no link"),
    ((BASE, link("a"), joint("one", "bas", "a")), "joint one: expected a link of the file as its parent, got bas"),
    ((BASE, link("a"), joint("one", "base", "a"), joint("two", "a", "b")),
        "joint two: expected a link of the file as its child, got b"),
    ((BASE, link("a"), joint("one", "base", "a"), joint("two", "base", "a")),
        "link a: expected one joint to carry it, got one, two"),
    ((BASE, link("a"), link("b"), joint("one", "b", "a"), joint("two", "a", "b", "fixed", limit="")),
        "got a loop: joint one carries a, joint two carries b"),
    ((BASE, link("a"), joint("one", "a", "a")), "got a loop: joint one carries a"),
    ((link("a"), link("b"), link("c"), joint("one", "b", "a"), joint("two", "a", "b"), joint("three", "b", "c")),
        "got a loop: joint two carries b, joint one carries a|got a loop: joint one carries a, joint two carries b"),
    ((BASE, link("a"), joint("one", "base", "a").replace(' link="a"', "")), "one: child: expected link, got none"),
    ((BASE, link(""), joint("one", "base", "")), "expected each link once, by its name, got one without a name"),
    ((BASE,), "no joint moves"),
)  # fmt: skip


def test_mistakes(tmp_path):
    for parts, message in MISTAKES:
        with pytest.raises(ShapeError, match=message):
            wb.arms.load_urdf(written(tmp_path, *parts))
    with pytest.raises(ShapeError, match="no such file"):
        wb.arms.load_urdf(tmp_path / "none.urdf")
    (tmp_path / "text.urdf").write_text("not XML")
    with pytest.raises(ShapeError, match="expected a URDF file, but it cannot be read"):
        wb.arms.load_urdf(tmp_path / "text.urdf")
    with pytest.raises(ShapeError, match="held names no joint of it: wrist"):
        wb.arms.load_urdf(written(tmp_path, *ARM), held={"wrist": 0.0})


@pytest.mark.parametrize("count", [65, 700])
def test_too_many_joints(tmp_path, count):
    """The message names the file, the joints' number and the way out, before a mesh is read."""
    mesh = '<collision><geometry><mesh filename="none.stl"/></geometry></collision>'
    links = [link(f"l{k}", mesh) for k in range(count)]
    file = written(
        tmp_path, BASE, *links, *(joint(f"j{k}", f"l{k - 1}" if k else "base", f"l{k}") for k in range(count))
    )
    words = rf"arm\.urdf: expected at most 64 joints that move, got {count}; .*held={{'j{count - 1}': 0"
    with pytest.raises(ShapeError, match=words):
        wb.arms.load_urdf(file)


def test_joints_that_stand(tmp_path):
    """Between equal limits, held, and mimicking one of these; what floats only at 0."""
    equal = '<limit lower="0.3" upper="0.3" effort="1" velocity="1"/>'
    parts = (
        BASE, link("a"), link("b"), link("c"), link("d"), link("e"),
        joint("float", "base", "a", "floating", limit=""),
        joint("equal", "a", "b", limit=equal),
        joint("turn", "b", "c", "continuous", xyz="0.5 0 0", axis="0 0 -3", limit=""),
        joint("like", "c", "d", xyz="0.5 0 0", more='<mimic joint="equal" multiplier="-2" offset="0.1"/>'),
        joint("finger", "d", "e", "prismatic", axis="", limit='<limit lower="0" upper="0.1" effort="1" velocity="1"/>'),
    )  # fmt: skip
    file = written(tmp_path, *parts)
    arm = wb.arms.load_urdf(file, held={"float": 0, "finger": 0.05})
    (turn,) = arm.joints
    assert (turn.name, turn.continuous, turn.axis.tolist()) == ("turn", True, [0, 0, -1])
    assert np.allclose(turn.origin[:2, :2], [[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    along = np.array([np.cos(-0.5), np.sin(-0.5)])  # of d, which stands at -2 * 0.3 + 0.1; e is 0.05 along its x
    assert np.allclose(arm.bodies[-1].points.mean(axis=0)[:2], [0.5, 0] + 0.3 * along)
    for held, message in (
        ({"float": 0.1, "finger": 0}, "float: expected a type"),
        ({"float": 0, "finger": 0.2}, "finger is held at 0.2"),
        ({"float": 0, "finger": np.nan}, "finger is held at nan"),
        ({"finger": "x"}, "finger: expected a number to hold it at, got 'x'"),
        (["finger"], "expected held to give a value for each name"),
    ):
        with pytest.raises(ShapeError, match=message):
            wb.arms.load_urdf(file, held=held)


HAND = (
    BASE,
    link("arm"),
    link("left", '<collision><geometry><capsule radius="0.02" length="0.1"/></geometry></collision>'),
    link("right"),
    joint("right", "arm", "right", "prismatic", more='<mimic joint="left" multiplier="-1" offset="0.01"/>'),
    joint("left", "arm", "left", "prismatic", xyz="0.1 0 0"),
    joint("turn", "base", "arm"),
)


def test_a_hand_is_a_tree_whose_fingers_follow(tmp_path):
    arm = wb.arms.load_urdf(written(tmp_path, *HAND))
    assert [each.name for each in arm.joints] == ["turn", "left", "right"]  # who leads stands before who follows
    assert (arm.parents, arm.free) == ((-1, 0, 0), (0, 1))
    assert arm.mimics == {2: wb.arms.Mimic(1, -1.0, 0.01)}
    frames = arm.frames(np.array([[0.0, 0.5]]))[0]
    assert np.allclose(frames[1:, :3, 3], [[0.1, 0, 0.5], [0, 0, -0.49]])
    capsule = next(body for body in arm.bodies if body.part == "left")
    assert np.allclose(capsule.points, [[0, 0, -0.05], [0, 0, 0.05]])
    assert capsule.radius == 0.02


def srdf(folder, *elements, name="two"):
    file = folder / "arm.srdf"
    file.write_text(f'<robot name="{name}">{"".join(elements)}</robot>')
    return file


def apart(one, other, tag="disable_collisions", reason="Never"):
    return f'<{tag} link1="{one}" link2="{other}" reason="{reason}"/>'


def checked(arm) -> set[tuple[str, str]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wb.BoundingWarning)  # neighbours always touch
        shape = wb.arms.ArmConfigurations(arm)
    return {tuple(sorted(arm.bodies[k].part for k in pair)) for pair in shape.pairs}


def test_an_srdf_says_which_links_are_checked(tmp_path):
    file = written(tmp_path, *HAND)
    everything = {("arm", "base"), ("arm", "left"), ("arm", "right"), ("base", "left"), ("base", "right")}
    everything |= {("left", "right")}
    assert checked(wb.arms.load_urdf(file)) == {("base", "left"), ("base", "right"), ("left", "right")}
    near = [apart("arm", other, reason="Adjacent") for other in ("base", "left")]
    arm = wb.arms.load_urdf(file, srdf=srdf(tmp_path, *near, apart("base", "left")))
    assert checked(arm) == everything - {("arm", "base"), ("arm", "left"), ("base", "left")}
    assert "pairs of links not checked against each other, by arm.srdf: 2 Adjacent, 1 Never" in arm.note
    lost = wb.arms.load_urdf(file, srdf=srdf(tmp_path, apart("tool", "arm"), apart("arm", "left", reason="")))
    assert "by arm.srdf: 1 without a reason; not in the URDF, and left out: links tool of arm.srdf" in lost.note
    default = '<disable_default_collisions link="left"/>'
    again = srdf(tmp_path, default, apart("left", "right", "enable_collisions"))
    assert checked(wb.arms.load_urdf(file, srdf=again)) == everything - {("arm", "left"), ("base", "left")}


DEFAULT = '<disable_default_collisions link="left"/>'
LINES = (
    DEFAULT,
    apart("left", "right", "enable_collisions"),
    apart("arm", "right", "enable_collisions"),
    apart("arm", "right"),
)


@pytest.mark.parametrize("lines", list(permutations(LINES)))
def test_the_order_of_an_srdf_does_not_count(tmp_path, lines):
    arm = wb.arms.load_urdf(written(tmp_path, *HAND), srdf=srdf(tmp_path, *lines))
    assert checked(arm) == {("arm", "base"), ("base", "right"), ("left", "right")}


TOOL = (BASE, link("fore"), link("wrist"), link("tool"), joint("a", "base", "fore"))
FIXED = {"limit": "", "xyz": "0.06 0 0"}


@pytest.mark.parametrize(
    ("parts", "held", "apart", "note"),
    [
        # the tool may touch the forearm, and what it is fixed to may not
        ((joint("b", "fore", "wrist"), joint("f", "wrist", "tool", "fixed", **FIXED)), {}, ["fore wrist"], ""),
        # held at a value is as fixed
        ((joint("b", "fore", "wrist"), joint("f", "wrist", "tool")), {"f": 1.0}, ["fore wrist"], ""),
        # a tool that is fixed to the base
        ((joint("b", "fore", "wrist"), joint("f", "base", "tool", "fixed", **FIXED)), {}, ["fore wrist"], ""),
        # links without geometry stand for those that are fixed to them
        ((link("e1", ""), link("e2", ""), joint("x", "fore", "e1", "fixed", limit=""), joint("b", "e1", "e2"),
            joint("y", "e2", "wrist", "fixed", limit=""), joint("f", "wrist", "tool", "fixed", **FIXED)),
            {}, ["fore wrist"], "not checked against each other, as links without geometry join them: fore and wrist"),
    ],
)  # fmt: skip
def test_links_that_are_fixed_to_each_other_are_checked_one_by_one(tmp_path, parts, held, apart, note):
    arm = wb.arms.load_urdf(written(tmp_path, *TOOL, *parts), held=held)
    moved = {body.part: body.link for body in arm.bodies}
    pairs = {tuple(sorted((one, other))) for one in moved for other in moved if moved[one] != moved[other]}
    assert checked(arm) == pairs - {tuple(pair.split()) for pair in ["base fore", *apart]}
    assert arm.note == note


def test_a_fixed_tool_that_folds_back_collides(tmp_path):
    parts = (joint("b", "fore", "wrist", xyz="0.6 0 0"), joint("f", "wrist", "tool", "fixed", **FIXED))
    arm = wb.arms.load_urdf(written(tmp_path, *TOOL, *parts))
    shape = wb.arms.ArmConfigurations(arm, self_collision=True)
    assert shape.contains(np.array([[0.0, 0.0], [0.0, 2.45]])).tolist() == [False, True]


def test_an_srdf_of_another_robot_is_refused(tmp_path):
    file = written(tmp_path, *HAND)
    with pytest.raises(ShapeError, match="an SRDF of other, whose links tool the robot two has not"):
        wb.arms.load_urdf(file, srdf=srdf(tmp_path, apart("tool", "arm"), name="other"))
    with pytest.raises(ShapeError, match=r"none\.srdf: no such file"):
        wb.arms.load_urdf(file, srdf=tmp_path / "none.srdf")
    (tmp_path / "arm.srdf").write_text("<sdf/>")
    with pytest.raises(ShapeError, match="expected an SRDF file of a robot, got sdf"):
        wb.arms.load_urdf(file, srdf=tmp_path / "arm.srdf")


CUBE, STL = '<mesh filename="a.stl"/>', {"a.stl": BINARY_STL}
PACKAGE = '<mesh filename="package://robot/meshes/a.stl"/>'
BAR = link("bar", f'<collision><origin xyz="1 0 0"/><geometry>{CUBE}</geometry></collision>')
TURNING = f'<robot name="two">{link("base", "")}{BAR}{joint("j", "base", "bar")}</robot>'
VISUAL = link("more", '<visual><geometry><box size="1 1 1"/></geometry></visual>')
VISUAL += joint("k", "bar", "more", "fixed", limit="")
NAMED = {"package.xml": "<package><name>robot</name></package>", "meshes/a.stl": BINARY_STL}


@pytest.mark.parametrize(
    ("old", "new", "files", "note", "half"),
    [
        (CUBE, '<!-- a cube --><mesh filename="a.stl" scale="1 -2 3"/>', STL, "", (1, 2, 3)),
        (CUBE, PACKAGE, {"robot/meshes/a.stl": BINARY_STL}, "", (1, 1, 1)),
        (CUBE, PACKAGE, NAMED, "", (1, 1, 1)),
        (CUBE, '<mesh filename="a.dae"/>', {"a.dae": CENTIMETRES}, "", (1, 1, 1)),
        (CUBE, '<mesh filename="a.dae"/>', {"a.dae": dae(asset="")}, "a.dae: no up_axis", (1, 1, 1)),
        (CUBE, PACKAGE.replace("robot/m", "a%20robot/m"), {"a robot/meshes/a.stl": BINARY_STL}, "", (1, 1, 1)),
        (CUBE, PACKAGE.replace("//robot", "///robot"), {"robot/meshes/a.stl": BINARY_STL}, "", (1, 1, 1)),
        (CUBE, CUBE.replace("a.stl", "file://a%20b.stl"), {"a b.stl": BINARY_STL}, "", (1, 1, 1)),
        (CUBE, CUBE.replace("a.stl", "file://a%20b.stl"), {"a%20b.stl": BINARY_STL}, "", (1, 1, 1)),
        (CUBE, CUBE.replace("a.stl", "a%20b.stl"), {"a%20b.stl": BINARY_STL}, "", (1, 1, 1)),
        (CUBE, '<mesh filename="a.glb"/>', {"a.glb": GLB}, "taken as it stands", (1, 1, 1)),
        ("</robot>", VISUAL + "</robot>", STL, "so not bounded: more", (1, 1, 1)),
    ],
)
def test_meshes_of_links(tmp_path, old, new, files, note, half):
    arm = wb.arms.load_urdf(stored(tmp_path, "a.urdf", {"a.urdf": TURNING.replace(old, new)} | files))
    (body,) = arm.bodies
    assert sorted(body.points.tolist()) == pytest.approx(np.array(sorted((V * half + [1, 0, 0]).tolist())))
    assert note in arm.note
    assert bool(arm.note) == bool(note)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (CUBE, '<mesh filename="a.stl" scale="1 2"/>', "scale of 1 or 3 finite numbers"),
        (CUBE, PACKAGE, "is missing"),
        (CUBE, '<mesh filename="a.urdf"/>', "expected a mesh file"),
        (CUBE, '<sphere radius="1"/><box size="1 1 1"/>', "one geometry of one shape"),
        (CUBE, '<cylinder radius="1"/>', "cylinder: expected length"),
        (CUBE, '<cylinder radius="-1" length="1"/>', "radius of 1 finite number from 0, got '-1'"),
        (CUBE, '<cone radius="1" length="1"/>', "cone"),
        ("</collision>", f"<geometry>{CUBE}</geometry></collision>", "one geometry of one shape"),
        ("</joint>", '<origin xyz="5 0 0"/></joint>', "joint j: expected one origin, got 2"),
        ('xyz="1 0 0"', 'xyz="1 0 0" quat_xyzw="0 0 1 0"', "got quat_xyzw"),
        ('xyz="1 0 0"', 'xyz="1 0 0 7"', "xyz of 3 finite numbers"),
        ("</robot>", '<link name="base"/></robot>', "two of base"),
        ('name="two">', 'name="r" xmlns:xacro="http://wiki.ros.org/xacro"><xacro:include filename="b"/>', "macro"),
        ("</robot>", "", "expected a URDF file, but it cannot be read"),
    ],
)
def test_files_that_are_refused(tmp_path, old, new, words):
    files = {"a.urdf": TURNING.replace(old, new)} | STL
    with pytest.raises(ShapeError) as caught:
        wb.arms.load_urdf(stored(tmp_path, "a.urdf", files))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


MASS = '<inertial><mass value="${m}"/></inertial>'
HARMLESS = {
    "another program's collisions": ("</link>", '<collision_checking><capsule name="a"/></collision_checking></link>'),
    "a prefix with a namespace": ('name="two">', 'name="two" xmlns:drake="d"><drake:joint drake:name="j"/>'),
    "a prefix without one": ('<limit lower="-2"', '<limit lower="-2" drake:acceleration="2"'),
    "a namespace of all": ('name="two"', 'name="two" xmlns="http://www.ros.org"'),
    "an effort": ('effort="1"', 'effort="${most}" current="1"'),
    "a name of a geometry": ("<geometry>", '<geometry name="g">'),
    "a name of a mesh": ("<mesh", '<mesh name="m"'),
    "a prefix in a placement": ('<origin xyz="1 0 0"', '<origin xyz="1 0 0" drake:frame="f"'),
    "a prefix in a mesh": (CUBE, CUBE.replace("/>", "><drake:declare_convex/></mesh>")),
    "a prefix in a geometry": (CUBE, f"{CUBE}<drake:convex/>"),
    "a visual without a shape": ("</link>", "<visual><geometry/></visual></link>"),
    "a visual with two": ("</link>", '<visual><geometry><box size="x"/><cone/></geometry></visual></link>'),
    "a mass": ("</link>", f"{MASS}</link>"),
    "dynamics": ("</joint>", '<dynamics damping="?"/><safety_controller k_velocity="-"/></joint>'),
    "a transmission": ("</robot>", '<transmission><joint name="j"/><link name="bar"/></transmission></robot>'),
    "a simulator's element": ("</robot>", '<gazebo reference="bar"><collision/><origin xyz="a"/></gazebo></robot>'),
    "a fixed joint's axis": ("</robot>", link("flange", "") + joint("k", "bar", "flange", "fixed", axis="", limit="")
        .replace("</joint>", '<axis/><limit lower="?"/></joint>') + "</robot>"),
}  # fmt: skip


@pytest.mark.parametrize("name", HARMLESS)
def test_what_is_no_geometry_does_not_count(tmp_path, name):
    old, new = HARMLESS[name]
    assert old in TURNING
    arms = [
        wb.arms.load_urdf(stored(tmp_path, "a.urdf", {"a.urdf": text} | STL))
        for text in (TURNING, TURNING.replace(old, new))
    ]
    first, second = (wb.arms.ArmConfigurations(arm, [wb.arms.Body.sphere([1, 2, 0], 0.5)]) for arm in arms)
    assert first.digest == second.digest
    assert arms[1].note in ("", "without collision geometry, so not bounded: base")


def test_a_robot_without_a_name_has_the_files(tmp_path):
    file = stored(tmp_path, "a.urdf", {"a.urdf": TURNING.replace(' name="two"', "")} | STL)
    assert wb.arms.load_urdf(file).name == "a"


@pytest.mark.parametrize(
    ("up", "turned"),
    [("Y_UP", lambda v: v[:, [0, 2, 1]] * [1, -1, 1]), ("X_UP", lambda v: v[:, [1, 2, 0]] * [-1, -1, 1])],
)
def test_the_caller_says_which_way_is_up(tmp_path, up, turned):
    points = V * [1, 2, 3] + [0, 5, 7]
    files = {"a.urdf": TURNING.replace("a.stl", "a.dae"), "a.dae": dae(points=points, asset=f"<up_axis>{up}</up_axis>")}
    file = stored(tmp_path, "a.urdf", files)
    for upright, expected in ((True, turned(points)), (False, points)):
        (body,) = wb.arms.load_urdf(file, upright=upright).bodies
        assert sorted(body.points.tolist()) == sorted((expected + np.array([1, 0, 0])).tolist())
    with pytest.raises(ShapeError, match=f"link bar: .*a.dae: expected up_axis Z_UP, .* got {up}; .*upright=True"):
        wb.arms.load_urdf(file)


def test_a_mesh_is_read_once_and_what_is_slow_is_said(tmp_path, monkeypatch):
    read, said = [], []
    reader, slow = wb.arms.urdf.read_mesh_data, wb.arms.urdf.slow
    monkeypatch.setattr(
        wb.arms.urdf, "read_mesh_data", lambda *given, **more: read.append(given) or reader(*given, **more)
    )
    monkeypatch.setattr(wb.arms.urdf, "slow", lambda what: said.append(what) or slow(what))
    twice = BAR.replace('"bar"', '"more"') + joint("k", "bar", "more").replace('xyz="0 0 0"', 'xyz="0 3 0"')
    file = stored(tmp_path, "a.urdf", {"a.urdf": TURNING.replace("</robot>", twice + "</robot>")} | STL)
    bar, more = wb.arms.load_urdf(file).bodies
    assert (len(read), said) == (1, ["reading a.urdf and its meshes"])
    assert (bar.points == more.points).all()
    assert (bar.part, more.part, bar.link, more.link) == ("bar", "more", 0, 1)
