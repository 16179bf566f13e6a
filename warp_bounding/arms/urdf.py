"""Arms from URDF and SRDF files: the tree of moving joints, and convex hulls of the links' collision geometry.

A body holds all of its geometry: boxes and balls as they are, a prism around a cylinder, the convex hull of a mesh.
Read with yourdfpy, which is asked for when a file is read; what it would pass over without a word is looked for before
(``_looked_through``).
"""

import io
import math
import os
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from warp_bounding.arms.arm import WORLD, Arm, Body, Joint, Mimic
from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formats.meshes import read_mesh_data

SIDES = 16  # of a prism around a cylinder
TURNING, SLIDING, FIXED = ("revolute", "continuous"), ("prismatic",), ("fixed",)
OUTWARD = 1 + 1e-12  # outweighs what float64 rounds
ONCE = {"joint": ("parent", "child", "origin", "axis", "limit", "mimic"), "collision": ("geometry", "origin")}
# Of elements that tell geometry the attributes that are known, and of how many numbers each is; of none where it is
# text or not read. What begins with + has to be there.
ATTRIBUTES: dict[str, dict[str, tuple[int, ...]]] = {
    "parent": {"+link": ()},
    "child": {"+link": ()},
    "origin": {"xyz": (3,), "rpy": (3,)},
    "axis": {"+xyz": (3,)},
    "limit": {"lower": (1,), "upper": (1,)} | dict.fromkeys(("effort", "velocity", "acceleration", "deceleration",
        "jerk"), ()),
    "mimic": {"+joint": (), "multiplier": (1,), "offset": (1,)},
    "geometry": {},
    "box": {"+size": (3,)},
    "cylinder": {"+radius": (1,), "+length": (1,)},
    "sphere": {"+radius": (1,)},
    "capsule": {"+radius": (1,), "+length": (1,)},
    "mesh": {"+filename": (), "scale": (1, 3)},
}  # fmt: skip
CAPSULE = "capsule of "  # what stands for a capsule in the file name of a mesh: yourdfpy knows none
SIZES = ("size", "radius", "length")  # attributes that are 0 or more
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


class _Step(NamedTuple):
    """A joint that moves, and where it stands: its frame in that of the link before."""

    joint: Any
    origin: np.ndarray
    parent: int  # the number of the joint whose link carries it


def load_urdf(path, *, held: Mapping[str, float] | None = None, srdf=None, touching=(), name: str | None = None) -> Arm:
    """The arm of a URDF file: a tree of joints that turn, slide, or follow others.

    Args:
        path: The file; meshes are looked for beside it and in the folders above it, and those of ``package://NAME/`` in
            folders NAME there, or of such a ``package.xml``.
        held: Values at which joints stand that are not to move, such as a gripper's, by name; radians or metres. A
            joint between equal limits stands, and so does one that mimics a joint that stands; floating and planar
            joints can be held at 0 only.
        srdf: An SRDF file, whose disabled pairs of links are not checked against each other; all others are, neighbours
            too.
        touching: More pairs that are not checked, as ``Arm`` takes them: names of links.
        name: For people; the robot's own if ``None``.

    Raises:
        ShapeError: For what is no URDF, a mesh that is missing, a joint of an unknown type or without limits, a value
            beyond its joint's limits, links in no tree, no joint that moves, an SRDF of another robot, or if yourdfpy
            is not installed.

    Example:
        >>> arm = wb.arms.load_urdf("arm.urdf", held={"finger": 0.02})
        >>> [joint.name for joint in arm.joints]
        ['shoulder', 'elbow']
    """
    (robot, notes), held = _read(Path(path)), {} if held is None else held
    if not isinstance(held, Mapping):
        raise ShapeError(f"{path}: expected held to give a value for each name of a joint, got {held!r}")
    held = {joint: _value(value, joint, path) for joint, value in held.items()}
    if unknown := sorted(map(str, set(held) - {joint.name for joint in robot.joints})):
        raise ShapeError(f"{path}: held names no joint of it: {', '.join(unknown)}")
    children: dict[str, list[Any]] = {}
    for joint in robot.joints:
        children.setdefault(joint.parent, []).append(joint)
    roots = {link.name for link in robot.links} - {joint.child for joint in robot.joints}
    if len(roots) != 1:
        raise ShapeError(f"{path}: expected one base, got {', '.join(sorted(roots)) or 'none'}")
    links, bodies, steps = {link.name: link for link in robot.links}, [], []
    named = {joint.name: joint for joint in robot.joints}

    def visit(link: str, number: int, at: np.ndarray) -> None:
        """Take a link and what is fixed to it, ``at`` in a moving joint's frame; then the joints that move it on."""
        bodies.extend(_bodies(links[link], number, at, Path(path), notes))
        onward = []
        for joint in children.get(link, ()):
            origin = at @ (np.eye(4) if joint.origin is None else joint.origin)
            value = _standing(joint, named, held, path)
            if value is not None:
                visit(joint.child, number, origin @ _moved(joint, value))
            else:
                onward.append(_Step(joint, origin, number))
        for step in onward:
            take(step)

    def take(step: _Step) -> None:
        """Take a joint that moves and what it carries; one that follows another one waits for that."""
        placed = {each.joint.name for each in steps}
        if step.joint.mimic is not None and _leader(step.joint, named)[0] not in placed:
            waiting.append(step)
            return
        steps.append(step)
        visit(step.joint.child, len(steps) - 1, np.eye(4))

    waiting: list[_Step] = []
    visit(roots.pop(), WORLD, np.eye(4))
    while waiting:
        again, count = waiting.copy(), len(steps)
        waiting.clear()
        for step in again:
            take(step)
        if len(steps) == count:
            raise ShapeError(f"{path}: joint {waiting[0].joint.name} follows a joint that it carries")
    if not steps:
        raise ShapeError(f"{path}: no joint moves; all are fixed, held, or between equal limits")
    numbers = {step.joint.name: i for i, step in enumerate(steps)}
    mimics = {}
    for i, step in enumerate(steps):
        if step.joint.mimic is not None:
            leader, factor, offset = _leader(step.joint, named)
            mimics[i] = Mimic(numbers[leader], factor, offset)
    if srdf is not None:
        apart, more = _allowed(Path(srdf), robot)
        touching = [*touching, *(pair for pair in apart if {body.part for body in bodies}.issuperset(pair))]
        notes += more
    return Arm(
        [_joint(step.joint, step.origin, path) for step in steps],
        bodies,
        parents=[step.parent for step in steps],
        mimics=mimics,
        touching=touching,
        neighbours=srdf is not None,
        name=name or robot.name or Path(path).stem,
        note="; ".join(dict.fromkeys(notes)),
    )


def _leader(joint, named: dict[str, Any]) -> tuple[str, float, float]:
    """The joint that one follows in the end, with the factor and the offset."""
    name, factor, offset = joint.name, 1.0, 0.0
    while (mimic := named[name].mimic) is not None:
        name = mimic.joint
        factor, offset = factor * mimic.multiplier, factor * mimic.offset + offset
    return name, factor, offset


def _allowed(path: Path, robot) -> tuple[list[tuple[str, str]], list[str]]:
    """Pairs of links of an SRDF file that are not checked, and notes that say why."""
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except (OSError, ElementTree.ParseError) as error:
        raise ShapeError(f"{path}: no SRDF that can be read ({error})") from error
    if root.tag != "robot":
        raise ShapeError(f"{path}: expected an SRDF file of a robot, got {root.tag}")
    links, reasons = [link.name for link in robot.links], {}
    for element in root:
        ends = [element.get(end) for end in ("link1", "link2")]
        if element.tag == "disable_default_collisions":
            reasons |= {frozenset((element.get("link"), other)): "Default" for other in links}
        elif element.tag == "disable_collisions":
            reasons[frozenset(ends)] = element.get("reason") or "without a reason"
        elif element.tag == "enable_collisions":
            reasons.pop(frozenset(ends), None)
    reasons = {pair: reason for pair, reason in reasons.items() if len(pair) == 2 and None not in pair}
    strange = sorted({link for pair in reasons for link in pair} - set(links))
    if strange and root.get("name") != robot.name:
        named = ", ".join(strange[:3]) + ", ..." * (len(strange) > 3)
        raise ShapeError(f"{path}: an SRDF of {root.get('name')}, whose links {named} the robot {robot.name} has not")
    pairs = {tuple(sorted(pair)): reason for pair, reason in reasons.items() if pair.issubset(links)}
    counts = ", ".join(f"{count} {reason}" for reason, count in sorted(Counter(pairs.values()).items()))
    notes = [f"pairs of links not checked against each other, by {path.name}: {counts or 'none'}"]
    notes += [f"not in the URDF, and left out: links {', '.join(strange)} of {path.name}"] * bool(strange)
    return list(pairs), notes


def _read(path: Path) -> tuple[Any, list[str]]:
    """The robot of a file as yourdfpy holds it, and notes of what is not read."""
    try:
        import yourdfpy
    except ImportError as error:
        raise ShapeError("URDF files need yourdfpy: pip install 'warp-bounding[arms]'") from error
    if not path.is_file():
        raise ShapeError(f"{path}: no such file")
    try:
        robot = ElementTree.fromstring(path.read_bytes())
        notes = _looked_through(robot)
        for element in robot.iter("capsule"):
            element.tag, size = "mesh", [element.get("radius"), element.get("length")]
            element.attrib = {"filename": CAPSULE + " ".join(size)}
        same = io.BytesIO(ElementTree.tostring(robot))  # without comments, which yourdfpy takes for shapes
        return yourdfpy.URDF.load(same, build_scene_graph=False, load_meshes=False).robot, notes
    except Exception as error:  # whatever its reader raises, of XML and of what is in it
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ShapeError(f"{path}: no URDF that can be read ({reason})") from error


def _looked_through(robot: ElementTree.Element) -> list[str]:
    """A note of links without collision geometry; raises ``ValueError`` for what is ambiguous or not known."""
    if macros := [element.tag for element in robot.iter() if "xacro" in element.tag]:
        raise ValueError(f"expected a URDF file, got the macro {macros[0].rpartition('}')[2]}; let xacro write one")
    if robot.tag != "robot":
        raise ValueError(f"expected a robot, got {robot.tag}")
    for kind in ("link", "joint"):
        names = [element.get("name") for element in robot.findall(kind)]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"expected each {kind} once, got two of {', '.join(map(str, sorted(twice, key=str)))}")
    for joint in robot.findall("joint"):
        _check(joint, f"joint {joint.get('name')}", ("parent", "child"))
    for link in robot.findall("link"):
        for part in link.findall("collision"):
            shapes = [len(geometry) for geometry in part.findall("geometry")]
            if shapes != [1]:
                raise ValueError(
                    f"link {link.get('name')}: expected one geometry of one shape in a collision, got {shapes}"
                )
            _check(part, f"link {link.get('name')}")
    links = [link for link in robot.findall("link") if link.find("collision") is None]
    bare = [str(link.get("name")) for link in links if link.find("visual") is not None]
    return [f"without collision geometry, so not bounded: {', '.join(bare)}"] if bare else []


def _check(whole: ElementTree.Element, where: str, needed: tuple[str, ...] = ()) -> None:
    """Raise ``ValueError`` for elements of a joint or collision that are doubled or lack, or have other attributes."""
    for tag in ONCE[whole.tag]:
        if (count := len(whole.findall(tag))) > 1 or (tag in needed and not count):
            raise ValueError(f"{where}: expected one {tag}, got {count or 'none'}")
    for element in whole.iter():
        if (known := ATTRIBUTES.get(element.tag)) is None:
            continue
        names = {name.lstrip("+"): counts for name, counts in known.items()}
        if unknown := sorted(set(element.attrib) - set(names)):
            raise ValueError(
                f"{where}: {element.tag}: expected {', '.join(names) or 'no attributes'}, got {', '.join(unknown)}"
            )
        if missing := [name[1:] for name in known if name[0] == "+" and name[1:] not in element.attrib]:
            raise ValueError(f"{where}: {element.tag}: expected {', '.join(missing)}, got none")
        for name, counts in names.items():
            words = element.get(name, "").split()
            good = len(words) in counts and all(NUMBER.fullmatch(word) and math.isfinite(float(word)) for word in words)
            good = good and (name not in SIZES or min(map(float, words)) >= 0)
            if counts and name in element.attrib and not good:
                many = "1 finite number" if counts == (1,) else f"{' or '.join(map(str, counts))} finite numbers"
                least = " from 0" * (name in SIZES)
                raise ValueError(f"{where}: {element.tag}: expected {name} of {many}{least}, got {element.get(name)!r}")


def _value(value, joint, path) -> float:
    """A value at which a joint is held; the limits are checked where it stands."""
    if isinstance(value, bool | np.bool_ | str | bytes) or np.ndim(value):
        raise ShapeError(f"{path}: joint {joint}: expected a number to hold it at, got {value!r}")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"{path}: joint {joint}: expected a number to hold it at, got {value!r}") from error


def _standing(joint, named: dict[str, Any], held: Mapping[str, float], path, followed: int = 0) -> float | None:
    """The value that a joint stands at; ``None`` of one that moves."""
    value, limit = held.get(joint.name), joint.limit
    if joint.type not in (*TURNING, *SLIDING, *FIXED) and value != 0:
        known = ", ".join((*TURNING, *SLIDING, *FIXED))
        raise ShapeError(
            f"{path}: joint {joint.name}: expected a type of {known}, got {joint.type}; "
            f"hold it at 0, held={{{joint.name!r}: 0}}"
        )
    limited = joint.type != "continuous" and limit is not None and None not in (limit.lower, limit.upper)
    if value is not None:
        if not np.isfinite(value) or (limited and joint.type not in FIXED and not limit.lower <= value <= limit.upper):
            raise ShapeError(f"{path}: joint {joint.name} is held at {value}, which is not within its limits")
        return float(value)
    if joint.type in FIXED:
        return 0.0
    if joint.mimic is not None:
        leader = named.get(joint.mimic.joint)
        if leader is None or followed > len(named):
            raise ShapeError(f"{path}: joint {joint.name} mimics {joint.mimic.joint}, which is no joint of its own")
        value = _standing(leader, named, held, path, followed + 1)
        return None if value is None else joint.mimic.multiplier * value + joint.mimic.offset
    return float(limit.lower) if limited and limit.lower == limit.upper else None


def _moved(joint, value: float) -> np.ndarray:
    """The motion of a joint at a value that it stands at."""
    if joint.type not in (*TURNING, *SLIDING):
        return np.eye(4)
    return Joint(axis=_axis(joint), slides=joint.type in SLIDING, name=joint.name).motion(value)


def _axis(joint) -> np.ndarray:
    return np.array([1.0, 0.0, 0.0]) if joint.axis is None else np.asarray(joint.axis, dtype=np.float64)


def _joint(joint, origin: np.ndarray, path) -> Joint:
    lower, upper, continuous = -np.pi, np.pi, joint.type == "continuous"
    if not continuous:
        limit = joint.limit
        if limit is None or limit.lower is None or limit.upper is None:
            raise ShapeError(f"{path}: joint {joint.name} has no limits")
        lower, upper = limit.lower, limit.upper
    return Joint(origin, _axis(joint), lower, upper, joint.type in SLIDING, joint.name, continuous)


def _bodies(link, number: int, at: np.ndarray, path: Path, notes: list[str]) -> list[Body]:
    """A link's collision geometry, ``at`` in the frame of its joint; adds to the notes."""
    found = []
    for part in link.collisions:
        pose = at @ (np.eye(4) if part.origin is None else part.origin)
        shape, reported = part.geometry, {"link": number, "name": part.name or link.name, "part": link.name}
        if shape.sphere is not None:
            body = Body.sphere([0, 0, 0], shape.sphere.radius, **reported)
        elif shape.box is not None:
            half = np.asarray(shape.box.size, dtype=np.float64) / 2
            body = Body.box(-half, half, **reported)
        elif shape.cylinder is not None:
            turn = 2 * np.pi * np.arange(SIDES) / SIDES
            around = shape.cylinder.radius / np.cos(np.pi / SIDES) * OUTWARD
            ring = np.stack([np.cos(turn) * around, np.sin(turn) * around], axis=1)
            ends = [np.column_stack([ring, np.full(SIDES, side * shape.cylinder.length / 2)]) for side in (-1, 1)]
            body = Body(np.concatenate(ends), **reported)
        elif shape.mesh is not None:
            if (rounded := shape.mesh.filename.partition(CAPSULE))[1]:
                radius, length = map(float, rounded[2].split())
                body = Body.capsule([0, 0, -length / 2], [0, 0, length / 2], radius, **reported)
            else:
                body = Body.hull(_points(shape.mesh, path, notes), **reported)
        else:
            raise ShapeError(f"{path}: link {link.name}: expected a box, cylinder, sphere or mesh")
        found.append(body.moved(pose))
    return found


def _points(mesh, path: Path, notes: list[str]) -> np.ndarray:
    """``(N, 3)``, the corners of a mesh's faces, scaled; metres."""
    scale = np.asarray(1.0 if mesh.scale is None else mesh.scale, dtype=np.float64)
    found = _mesh_file(mesh.filename, path)
    if found is None:
        raise ShapeError(
            f"{path}: mesh {mesh.filename} is missing: not beside the file nor in the folders above "
            "it, or in no package of that name there"
        )
    vertices, faces, reported = read_mesh_data(found)
    reported += ("glTF, whose y is up by its standard, is taken as it stands",) * (
        found.suffix.lower() in (".glb", ".gltf")
    )
    notes.extend(f"{found.name}: {note}" for note in reported)
    return vertices[np.unique(faces)] * scale


def _mesh_file(name: str, path: Path) -> Path | None:
    """The nearest file that a URDF file names so, from its folder upwards; ``None`` if there is none."""
    start = path.parent.resolve() if ".." in path.parts else path.parent.absolute()
    scheme, apart, inside = name.rpartition("://")
    package, _, within = inside.partition("/")
    for folder in (start, *start.parents):
        places = [folder / inside]
        if scheme in ("package", "model"):
            places += [folder / within] * (package in (folder.name, _package(folder)))
        elif apart and scheme != "file":
            return None
        if found := next(
            (place for place in places if os.path.isfile(place)), None
        ):  # false of names that no system takes
            return found
    return None


def _package(folder: Path) -> str | None:
    """The name that a folder's ``package.xml`` gives it."""
    try:
        return (ElementTree.parse(folder / "package.xml").findtext("name") or "").strip()
    except (OSError, ElementTree.ParseError):
        return None
