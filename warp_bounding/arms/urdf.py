"""Arms from URDF and SRDF files: the tree of moving joints, and convex hulls of the links' collision geometry.

A body holds all of its geometry: boxes and balls as they are, a prism around a cylinder, the convex hull of a mesh.
What says where geometry is and how it moves is read, and checked. All else of a file does not count: visuals, masses,
efforts, other programs' elements, and whatever has a prefix.
"""

import contextlib
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from warp_bounding.arms.arm import MOST_JOINTS, WORLD, Arm, Body, Cylinder, Joint, Mimic
from warp_bounding.arms.pieces import hulls_of
from warp_bounding.errors import ShapeError
from warp_bounding.rigid import about, matmul
from warp_bounding.runtime.progress import slow
from warp_bounding.shapes.formats.meshes import read_mesh_data
from warp_bounding.shapes.formats.reading import MeshData

Element = ElementTree.Element
TURNING, SLIDING, FIXED = ("revolute", "continuous"), ("prismatic",), ("fixed",)
# Attributes of the elements that are read, and of how many numbers each is; of none where it is text. What begins with
# + has to be there.
ATTRIBUTES: dict[str, dict[str, tuple[int, ...]]] = {
    "parent": {"+link": ()},
    "child": {"+link": ()},
    "origin": {"xyz": (3,), "rpy": (3,)},
    "axis": {"+xyz": (3,)},
    "limit": {"lower": (1,), "upper": (1,)},
    "mimic": {"+joint": (), "multiplier": (1,), "offset": (1,)},
    "box": {"+size": (3,)},
    "cylinder": {"+radius": (1,), "+length": (1,)},
    "sphere": {"+radius": (1,)},
    "capsule": {"+radius": (1,), "+length": (1,)},
    "mesh": {"+filename": (), "scale": (1, 3)},
}
SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")
OPEN = ("parent", "child", "limit")  # attributes that are not known place nothing here
SIZES = ("size", "radius", "length")  # attributes that are 0 or more
PACKAGES = ("package", "model")  # schemes of addresses
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


class _Joint(NamedTuple):
    """A joint of a file."""

    name: str
    type: str
    parent: str
    child: str
    origin: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float] | None
    mimic: tuple[str, float, float] | None  # the leader's name, a factor and an offset


class _Step(NamedTuple):
    """A link, and the joint that moves it, if one does; its or the joint's frame in that of a joint that moves."""

    link: str
    joint: _Joint | None
    origin: np.ndarray
    parent: int  # the number of that joint


def load_urdf(
    path,
    *,
    held: Mapping[str, float] | None = None,
    srdf=None,
    touching=(),
    upright: bool | None = None,
    pieces: int = 1,
    name: str | None = None,
) -> Arm:
    """The arm of a URDF file: a tree of joints that turn, slide, or follow others.

    Args:
        path: The file; meshes are looked for beside it and in the folders above it, and those of ``package://NAME/`` in
            folders NAME there, or of such a ``package.xml``.
        held: Values at which joints stand that are not to move, such as a gripper's, by name; radians or metres. A
            joint between equal limits stands, and so does one that mimics a joint that stands; floating and planar
            joints can be held at 0 only.
        srdf: An SRDF file, whose disabled pairs of links are not checked against each other; all others are. Without
            one neighbours are not checked: links that a moving joint joins, or, for one without geometry, the nearest
            that are fixed to it, which the note names.
        touching: More pairs that are not checked, as ``Arm`` takes them: names of links.
        upright: Whether COLLADA meshes whose up axis is not z are turned until it is, as some programs do, or, for
            ``False``, taken as they stand, as others do; refused for ``None``.
        pieces: Into how many convex bodies a mesh may be cut where that saves volume; 1 takes its hull. More pieces
            hold forks, bows and brackets more closely; see ``pieces.py``.
        name: For people; the robot's own if ``None``.

    Raises:
        ShapeError: For what is no URDF, a mesh that is missing, a joint of an unknown type or without limits, a value
            beyond its joint's limits, links in no tree, no joint that moves or too many, an SRDF of another robot.

    Example:
        >>> arm = wb.arms.load_urdf("arm.urdf", held={"finger": 0.02})
        >>> [joint.name for joint in arm.joints]
        ['shoulder', 'elbow']
    """
    path = Path(path)
    with naming(path), slow(f"reading {path.name} and its meshes"):
        robot = _Robot(path, {} if held is None else held)
        if len(robot.steps) > MOST_JOINTS:
            raise ShapeError(
                f"expected at most {MOST_JOINTS} joints that move, got {len(robot.steps)}; give others a value at "
                f"which they stand: held={{{robot.steps[-1].joint.name!r}: 0, ...}}"
            )
        joints, mimics = robot.moving()
        bodies, notes = robot.bodies(upright, pieces)
        parts = {body.part for body in bodies}
        apart, more = robot.neighbours(parts) if srdf is None else _disabled(Path(srdf), robot)
        return Arm(
            joints,
            bodies,
            parents=[step.parent for step in robot.steps],
            mimics=mimics,
            touching=[*touching, *(pair for pair in apart if parts.issuperset(pair))],
            neighbours=True,
            name=name or robot.name,
            note="; ".join(dict.fromkeys(notes + more)),
        )


@contextlib.contextmanager
def naming(where: object) -> Iterator[None]:
    """Say in a ``ShapeError`` where it is from."""
    try:
        yield
    except ShapeError as error:
        error.args = (f"{where}: {error}",)
        raise


# --- What files say ---------------------------------------------------------------------------------------------------


def _parsed(path: Path, kind: str) -> Element:
    """The robot of an XML file; names with a prefix stay as they are written, and need no namespace."""
    if not path.is_file():
        raise ShapeError("no such file")
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(path.read_bytes(), True)
    except (OSError, ValueError, LookupError, expat.ExpatError) as error:  # the middle ones of encodings
        raise ShapeError(f"expected {kind}, but it cannot be read: {error}") from error
    if (root := builder.close()).tag != "robot":
        raise ShapeError(f"expected {kind} of a robot, got {root.tag}")
    return root


def links_of(path: Path) -> tuple[Element, dict[str, Element]]:
    """The robot of a URDF file, and its links by their names."""
    root = _parsed(path, "a URDF file")
    if macros := [element.tag for element in root.iter() if element.tag.startswith("xacro:")]:
        raise ShapeError(f"expected a URDF file, got the macro {macros[0]}; let xacro write one")
    return root, _named(root, "link")


def shape_of(part: Element) -> tuple[str, dict[str, Any], np.ndarray]:
    """Kind and attributes of the one shape of a collision element, and its pose ``(4, 4)`` in the link's frame."""
    kinds = [shape.tag for geometry in part.findall("geometry") for shape in geometry]
    kinds = [kind for kind in kinds if ":" not in kind]
    if len(kinds) != 1 or kinds[0] not in SHAPES or len(part.findall("geometry")) > 1:
        got = ", ".join(kinds) or "none"
        raise ShapeError(f"expected one geometry of one shape, of {', '.join(SHAPES)}, got {got}")
    return kinds[0], _only(part.find("geometry"), kinds[0]), _pose(part)


def _named(root: Element, kind: str) -> dict[str, Element]:
    """Elements by their names."""
    found = root.findall(kind)
    names = [element.get("name", "") for element in found]
    if wrong := sorted({name for name in names if names.count(name) > 1 or not name}):
        got = f"two of {', '.join(wrong)}" if wrong[0] else "one without a name"
        raise ShapeError(f"expected each {kind} once, by its name, got {got}")
    return dict(zip(names, found, strict=True))


def _joint(element: Element, name: str) -> _Joint:
    with naming(f"joint {name}"):
        kind = element.get("type", "no type")
        parent, child = (_only(element, end, needed=True)["link"] for end in ("parent", "child"))
        axis, limit, mimic = ({} if kind in FIXED else _only(element, tag) for tag in ("axis", "limit", "mimic"))
        limits = (limit["lower"], limit["upper"]) if kind != "continuous" and len(limit) == 2 else None
        follows = (mimic["joint"], mimic.get("multiplier", 1.0), mimic.get("offset", 0.0)) if mimic else None
        axis = axis.get("xyz", np.array([1.0, 0.0, 0.0]))
        return _Joint(name, kind, parent, child, _pose(element), axis, limits, follows)


def _only(whole: Element, tag: str, *, needed: bool = False) -> dict[str, Any]:
    """The attributes of an element's one child of a tag, numbers as such; none if there is no child."""
    found = whole.findall(tag)
    if len(found) > 1 or (needed and not found):
        raise ShapeError(f"expected one {tag}, got {len(found) or 'none'}")
    if not found:
        return {}
    given, known = found[0].attrib, ATTRIBUTES[tag]
    names = {name.lstrip("+"): counts for name, counts in known.items()}
    strange = sorted(name for name in given.keys() - names.keys() - {"name"} if ":" not in name)
    if strange and tag not in OPEN:
        raise ShapeError(f"{tag}: expected {', '.join(names)}, got {', '.join(strange)}")
    if missing := [name[1:] for name in known if name[0] == "+" and name[1:] not in given]:
        raise ShapeError(f"{tag}: expected {', '.join(missing)}, got none")
    with naming(tag):
        return {name: _read(given[name], name, counts) for name, counts in names.items() if name in given}


def _read(text: str, name: str, counts: tuple[int, ...]) -> str | float | np.ndarray:
    """An attribute: a text, a number, or several."""
    if not counts:
        return text
    numbers = [float(word) if NUMBER.fullmatch(word) else np.nan for word in text.split()]
    sized = name in SIZES
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)) or (sized and min(numbers) < 0):
        many = "1 finite number" if counts == (1,) else f"{' or '.join(map(str, counts))} finite numbers"
        raise ShapeError(f"expected {name} of {many}{' from 0' * sized}, got {text!r}")
    return numbers[0] if counts == (1,) else np.array(numbers)


def _pose(whole: Element) -> np.ndarray:
    """``(4, 4)`` of an element's origin: a turn by roll, pitch and yaw, about x, then y, then z, and a shift."""
    origin, pose = _only(whole, "origin"), np.eye(4)
    roll, pitch, yaw = (about(axis, angle) for axis, angle in enumerate(origin.get("rpy", np.zeros(3))))
    pose[:3, :3] = matmul(matmul(yaw, pitch), roll)
    pose[:3, 3] = origin.get("xyz", 0.0)
    return pose


def _disabled(path: Path, robot: "_Robot") -> tuple[list[tuple[str, str]], list[str]]:
    """Pairs of links of an SRDF file that are not checked, and notes that say why.

    In any order of its lines, pairs are disabled by default, then some are enabled, then some disabled.
    """
    with naming(path):
        root, links = _parsed(path, "an SRDF file"), set(robot.links)
        alone = [element.get("link") for element in root.findall("disable_default_collisions")]
        reasons = {frozenset(pair): "Default" for pair in product(alone, links)}
        for element in root.findall("enable_collisions"):
            reasons.pop(_ends(element), None)
        for element in root.findall("disable_collisions"):
            reasons[_ends(element)] = element.get("reason") or "without a reason"
        reasons = {pair: reason for pair, reason in reasons.items() if len(pair) == 2 and None not in pair}
        strange = sorted({link for pair in reasons for link in pair} - links)
        if strange and root.get("name") != robot.name:
            named = ", ".join(strange[:3]) + ", ..." * (len(strange) > 3)
            raise ShapeError(f"an SRDF of {root.get('name')}, whose links {named} the robot {robot.name} has not")
    pairs = {tuple(sorted(pair)): reason for pair, reason in reasons.items() if pair <= links}
    counts = ", ".join(f"{count} {reason}" for reason, count in sorted(Counter(pairs.values()).items()))
    notes = [f"pairs of links not checked against each other, by {path.name}: {counts or 'none'}"]
    notes += [f"not in the URDF, and left out: links {', '.join(strange)} of {path.name}"] * bool(strange)
    return list(pairs), notes


def _ends(element: Element) -> frozenset[str | None]:
    return frozenset((element.get("link1"), element.get("link2")))


# --- What they mean ---------------------------------------------------------------------------------------------------


class _Robot:
    """A tree of links: which joints move, one after another (``steps``), and where links are.

    ``placed`` has of each link the number of the joint that moves it, and its pose in that one's frame; ``fixed`` the
    links that standing joints join to it.
    """

    def __init__(self, path: Path, held: Mapping[str, float]):
        root, self.links = links_of(path)
        self.path, self.name = path, root.get("name") or path.stem
        self.joints = {name: _joint(element, name) for name, element in _named(root, "joint").items()}
        if not isinstance(held, Mapping):
            raise ShapeError(f"expected held to give a value for each name of a joint, got {held!r}")
        if unknown := sorted(map(str, held.keys() - self.joints.keys())):
            raise ShapeError(f"held names no joint of it: {', '.join(unknown)}")
        self.held = {joint: _value(value, joint) for joint, value in held.items()}
        self.carried: dict[str, list[_Joint]] = {link: [] for link in self.links}
        self.fixed: dict[str, list[str]] = {link: [] for link in self.links}
        self.placed: dict[str, tuple[int, np.ndarray]] = {}
        self.steps: list[_Step] = []
        self._walk(self._base())

    def _base(self) -> str:
        """The link that carries all others; ``ShapeError`` for what is no tree."""
        carriers: dict[str, _Joint] = {}
        for joint in self.joints.values():
            for end, link in (("parent", joint.parent), ("child", joint.child)):
                if link not in self.links:
                    raise ShapeError(f"joint {joint.name}: expected a link of the file as its {end}, got {link}")
            if (other := carriers.setdefault(joint.child, joint)) is not joint:
                raise ShapeError(f"link {joint.child}: expected one joint to carry it, got {other.name}, {joint.name}")
            self.carried[joint.parent].append(joint)
        for link in self.links:
            above = {}  # joints by what they carry, from a link towards the base
            while link in carriers and link not in above:
                above[link] = carriers[link].name
                link = carriers[link].parent
            if link in above:
                loop = list(above.items())[list(above).index(link) :]
                got = ", ".join(f"joint {name} carries {each}" for each, name in loop)
                raise ShapeError(f"expected a tree of links, got a loop: {got}")
        bases = sorted(self.links.keys() - carriers.keys())
        if len(bases) != 1:
            raise ShapeError(f"expected one base, a link that no joint carries, got {', '.join(bases) or 'no link'}")
        return bases[0]

    def _walk(self, base: str) -> None:
        """Take a link and what is fixed to it, then the joints that move it on; those that follow wait for a leader."""
        todo, waiting, before = [_Step(base, None, np.eye(4), WORLD)], [], -1
        while todo or waiting:
            if not todo:
                if len(self.steps) == before:
                    raise ShapeError(f"joint {waiting[0].joint.name} follows a joint that it carries")
                todo, waiting, before = waiting[::-1], [], len(self.steps)
            link, joint, at, number = step = todo.pop()
            if joint:
                if joint.mimic and self._leader(joint)[0] not in {each.joint.name for each in self.steps}:
                    waiting.append(step)
                    continue
                self.steps.append(step)
                at, number = np.eye(4), len(self.steps) - 1
            self.placed[link], fixed, moving = (number, at), [], []
            for joint in self.carried[link]:
                origin, value = matmul(at, joint.origin), self._standing(joint)
                if value is None:
                    moving.append(_Step(joint.child, joint, origin, number))
                else:
                    fixed.append(_Step(joint.child, None, matmul(origin, _moved(joint, value)), number))
                    self.fixed[link].append(joint.child)
                    self.fixed[joint.child].append(link)
            todo += reversed(fixed + moving)
        if not self.steps:
            raise ShapeError("no joint moves; all are fixed, held, or between equal limits")

    def _leader(self, joint: _Joint) -> tuple[str, float, float]:
        """The joint that one follows in the end, with the factor and the offset."""
        name, factor, offset = joint.name, 1.0, 0.0
        while (mimic := self.joints[name].mimic) is not None:
            name, factor, offset = mimic[0], factor * mimic[1], factor * mimic[2] + offset
        return name, factor, offset

    def _standing(self, joint: _Joint, followed: int = 0) -> float | None:
        """The value that a joint stands at; ``None`` of one that moves."""
        value, limits, named = self.held.get(joint.name), joint.limits, f"joint {joint.name}"
        if joint.type not in (*TURNING, *SLIDING, *FIXED) and value != 0:
            known = ", ".join((*TURNING, *SLIDING, *FIXED))
            raise ShapeError(
                f"{named}: expected a type of {known}, got {joint.type}; hold it at 0, held={{{joint.name!r}: 0}}"
            )
        if value is not None:
            if not np.isfinite(value) or (limits and not limits[0] <= value <= limits[1]):
                raise ShapeError(f"{named} is held at {value}, which is not within its limits")
            return value
        if joint.type in FIXED:
            return 0.0
        if joint.mimic:
            name, factor, offset = joint.mimic
            if name not in self.joints or followed > len(self.joints):
                raise ShapeError(f"{named} mimics {name}, which is no joint of its own")
            value = self._standing(self.joints[name], followed + 1)
            return None if value is None else factor * value + offset
        return limits[0] if limits and limits[0] == limits[1] else None

    def moving(self) -> tuple[list[Joint], dict[int, Mimic]]:
        """The joints that move, and who follows whom, as ``Arm`` takes them."""
        joints, mimics, numbers = [], {}, {step.joint.name: i for i, step in enumerate(self.steps)}
        for i, (_, joint, origin, _) in enumerate(self.steps):
            continuous = joint.type == "continuous"
            if not continuous and joint.limits is None:
                raise ShapeError(f"joint {joint.name} has no limits")
            limits = (-np.pi, np.pi) if continuous else joint.limits
            joints.append(Joint(origin, joint.axis, *limits, joint.type in SLIDING, joint.name, continuous))
            if joint.mimic:
                leader, factor, offset = self._leader(joint)
                mimics[i] = Mimic(numbers[leader], factor, offset)
        return joints, mimics

    def bodies(self, upright: bool | None, pieces: int) -> tuple[list[Body], list[str]]:
        """The links' collision geometry, and notes; each mesh is read once."""
        parts = {link: element.findall("collision") for link, element in self.links.items()}
        bare = [link for link, found in parts.items() if not found and self.links[link].find("visual") is not None]
        bodies, notes = [], [f"without collision geometry, so not bounded: {', '.join(bare)}"] * bool(bare)

        @cache
        def hulls(name: str, *scale: float) -> list[Body]:
            vertices, faces, reported = mesh_data(name, self.path, upright)
            notes.extend(reported)
            return hulls_of(vertices * scale, faces, pieces)

        shapes = SOLIDS | {"mesh": lambda filename, scale=1.0: hulls(filename, *np.broadcast_to(scale, 3))}
        for link, (number, at) in self.placed.items():
            for part in parts[link]:
                with naming(f"link {link}"):
                    kind, sizes, pose = shape_of(part)
                    made, pose = shapes[kind](**sizes), matmul(at, pose)
                for body in made if isinstance(made, list) else [made]:
                    bodies.append(replace(body, link=number, name=part.get("name") or link, part=link).moved(pose))
        return bodies, notes

    def neighbours(self, parts: set[str]) -> tuple[list[tuple[str, str]], list[str]]:
        """Pairs of links with geometry (``parts``) that moving joints join, and a note of those joined by others."""
        found, farther = [], []
        for joint in (step.joint for step in self.steps):
            pairs = list(product(self._nearest(joint.parent, parts), self._nearest(joint.child, parts)))
            found += pairs
            farther += [" and ".join(pair) for pair in pairs if pair != (joint.parent, joint.child)]
        note = f"not checked against each other, as links without geometry join them: {', '.join(farther)}"
        return found, [note] * bool(farther)

    def _nearest(self, link: str, parts: set[str]) -> list[str]:
        """A link with geometry, or those of what is fixed to it that have some and are nearest."""
        links = [link]
        for each in links:  # which grows
            links += [other for other in self.fixed[each] if other not in links] * (each not in parts)
        return [each for each in links if each in parts]


def _value(value, joint: str) -> float:
    """A value at which a joint is held; the limits are checked where it stands."""
    try:
        if isinstance(value, bool | np.bool_ | str | bytes) or np.ndim(value):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(f"joint {joint}: expected a number to hold it at, got {value!r}") from error


def _moved(joint: _Joint, value: float) -> np.ndarray:
    """The motion of a joint at a value that it stands at."""
    if joint.type not in (*TURNING, *SLIDING):
        return np.eye(4)
    return Joint(axis=joint.axis, slides=joint.type in SLIDING, name=joint.name).motion(value)


# --- Geometry ---------------------------------------------------------------------------------------------------------


SOLIDS: dict[str, Callable[..., Body]] = {
    "box": lambda size: Body.box(-size / 2, size / 2),
    "sphere": lambda radius: Body.sphere([0, 0, 0], radius),
    "cylinder": lambda radius, length: Cylinder(radius, length).prism,
    "capsule": lambda radius, length: Body.capsule([0, 0, -length / 2], [0, 0, length / 2], radius),
}


def mesh_data(name: str, path: Path, upright: bool | None) -> MeshData:
    """Vertices, faces and notes of a mesh that a URDF file names so."""
    found = _mesh_file(name, path)
    if found is None:
        raise ShapeError(
            f"mesh {name} is missing: expected it in the file's folder, in a folder above, or in a package of its name "
            "there"
        )
    vertices, faces, notes = read_mesh_data(found, upright=upright)
    notes += ("glTF, whose y is up by its standard, is taken as it stands",) * (
        found.suffix.lower() in (".glb", ".gltf")
    )
    return MeshData(vertices, faces, tuple(f"{found.name}: {note}" for note in notes))


def _mesh_file(name: str, path: Path) -> Path | None:
    """The nearest file that a URDF file names so, from its folder upwards; ``None`` if there is none."""
    start = path.parent.resolve() if ".." in path.parts else path.parent.absolute()
    scheme, _, plain = name.rpartition("://")
    if scheme not in ("", "file", *PACKAGES):
        return None
    plain = plain.lstrip("/") if scheme in PACKAGES else plain
    for folder, inside in product((start, *start.parents), [plain, unquote(plain)] if scheme else [plain]):
        package, _, within = inside.partition("/")
        packaged = scheme in PACKAGES and package in (folder.name, _package(folder))
        for place in [folder / inside, *[folder / within] * packaged]:
            if os.path.isfile(place):  # false of names that no system takes
                return place
    return None


def _package(folder: Path) -> str | None:
    """The name that a folder's ``package.xml`` gives it."""
    try:
        return (ElementTree.parse(folder / "package.xml").findtext("name") or "").strip()
    except (OSError, ElementTree.ParseError):
        return None
