"""An arm: joints, each on the base or on a joint before it, and the bodies that they move.

The frame of link i is that of its parent, moved by the joint's ``origin`` and then by the joint's value: a turn about
its axis, or a way along it. Frames are kept turned so that every axis is z, which is the arm's own affair
(``_frames``): bodies are given in the frames that a user knows.
"""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.rigid import lengths, matmul, moved, nearest_rotation, ring, sine_cosine
from warp_bounding.rounding import round_up
from warp_bounding.runtime.arrays import Picklable

# --- Bodies -----------------------------------------------------------------------------------------------------------
#
# Rounded hulls: what the links of an arm and the things around it are made of.
#
# A body is the convex hull of a few points and everything within a radius of it: a point with a radius is a ball, two
# are a capsule, eight without a radius are a box. One test tells all of them apart from each other
# (``kernels.separation``).

WORLD = -1  # the link that does not move
MOST_POINTS = 512  # of a body
LARGEST = 1e6  # metres: a coordinate or radius
THIN = 1e-6  # of the largest coordinate: what is thinner counts as flat
SIDES = 16  # of a prism around a cylinder
CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T  # of a box, by 0 and 1


@dataclass(frozen=True, eq=False)
class Body(Picklable):
    """The convex hull of points, and all within a radius of it.

    Attributes:
        points: ``(P, 3)`` float64, at most ``MOST_POINTS``; metres, in the frame of the link.
        radius: Metres.
        link: Number of the joint that moves it last, from 0; ``WORLD`` where none does.
        name: For people.
        part: The rigid part that it belongs to, such as a link of a URDF file; its name if empty.

    Raises:
        ShapeError: For points or a radius that are none.

    Example:
        >>> forearm = wb.arms.Body.capsule([0, 0, 0], [0.4, 0, 0], 0.05, link=1)
        >>> table = wb.arms.Body.box([-1, -1, -0.1], [1, 1, 0])
        >>> len(forearm.points), len(table.points), table.link == wb.arms.WORLD
        (2, 8, True)
    """

    points: np.ndarray
    radius: float = 0.0
    link: int = WORLD
    name: str = "body"
    part: str = ""

    def __post_init__(self):
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1:] != (3,) or not 1 <= len(points) <= MOST_POINTS:
            raise ShapeError(f"{self.name}: expected 1 to {MOST_POINTS} points of 3 numbers, got {points.shape}")
        if not (np.abs(points) <= LARGEST).all():
            raise ShapeError(f"{self.name}: expected points of finite numbers up to {LARGEST:g}")
        radius = float(self.radius)
        if not 0 <= radius <= LARGEST:
            raise ShapeError(f"{self.name}: expected a radius from 0 to {LARGEST:g}, got {self.radius!r}")
        points.setflags(write=False)
        object.__setattr__(self, "part", self.part or self.name)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radius", radius)

    @classmethod
    def sphere(cls, center, radius: float, *, link: int = WORLD, name: str = "sphere", part: str = "") -> "Body":
        """All points within a radius of a centre ``(3,)``."""
        return cls([center], radius, link, name, part)

    @classmethod
    def capsule(cls, start, end, radius: float, *, link: int = WORLD, name: str = "capsule", part: str = "") -> "Body":
        """All points within a radius of a segment, given by its ends ``(3,)``."""
        return cls([start, end], radius, link, name, part)

    @classmethod
    def box(
        cls, lower, upper, *, pose=None, radius: float = 0.0, link: int = WORLD, name: str = "box", part: str = ""
    ) -> "Body":
        """A box between two corners ``(3,)``, rounded by a radius, at a ``(4, 4)`` pose."""
        corners = np.array([lower, upper], dtype=np.float64)
        if corners.shape != (2, 3) or not (corners[0] <= corners[1]).all():
            raise ShapeError(f"{name}: expected two corners of 3 numbers, the lower one first, got {lower} and {upper}")
        return cls(corners[CORNERS, np.arange(3)], radius, link, name, part).moved(pose)

    @classmethod
    def hull(cls, points: np.ndarray, *, link: int = WORLD, name: str = "hull", part: str = "") -> "Body":
        """A body that holds the convex hull of points ``(N, 3)``, as a mesh's: the hull, or a simpler one, grown.

        The points may lie in a plane or on a line.

        Example:
            >>> around = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.1, 0.1, 0.1]])
            >>> len(wb.arms.Body.hull(around, name="wedge").points)
            4
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not (np.abs(points) <= LARGEST).all():
            raise ShapeError(f"{name}: expected points (N, 3) of finite numbers up to {LARGEST:g}, got {points.shape}")
        return cls(*_enclosed(points), link, name, part)

    @property
    def numbers(self) -> np.ndarray:
        """All that a digest needs to know."""
        return np.append(self.points, [self.radius, self.link])

    def moved(self, pose) -> "Body":
        """This body at a pose ``(4, 4)``; itself for ``None``."""
        if pose is None:
            return self
        pose = checked_pose(pose, self.name)
        return replace(self, points=moved(self.points, pose))

    def grown(self, radius: float) -> "Body":
        """This body and all within a further radius of it."""
        return replace(self, radius=self.radius + radius)


@dataclass(frozen=True, eq=False)
class Cylinder(Picklable):
    """A cylinder in the world, exactly: an obstacle of ``Motions``.

    Attributes:
        radius: Metres.
        length: Metres, along its z axis.
        pose: ``(4, 4)``, of its middle.
        name: For people.

    Raises:
        ShapeError: For numbers that are none.

    Example:
        >>> can = wb.arms.Cylinder(0.03, 0.12, name="can")
        >>> can.radius, can.pose.shape
        (0.03, (4, 4))
    """

    radius: float
    length: float
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))
    name: str = "cylinder"

    def __post_init__(self):
        for what in ("radius", "length"):
            value = float(getattr(self, what))
            if not 0 <= value <= LARGEST:
                raise ShapeError(f"{self.name}: expected a {what} from 0 to {LARGEST:g}, got {value!r}")
            object.__setattr__(self, what, value)
        pose = checked_pose(self.pose, self.name)
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)

    @property
    def numbers(self) -> np.ndarray:
        """All that a digest needs to know."""
        return np.append(self.pose, [self.radius, self.length])

    @property
    def prism(self) -> Body:
        """A body of ``SIDES`` sides that holds it: a fiftieth of the radius wider, at its edges."""
        around = ring(SIDES) * (self.radius / sine_cosine(np.pi / SIDES)[1] * (1 + 1e-12))  # more than float64 rounds
        ends = [np.column_stack([around, np.full(SIDES, side * self.length / 2)]) for side in (-1, 1)]
        return Body(np.concatenate(ends), name=self.name).moved(self.pose)

    def moved(self, pose) -> "Cylinder":
        """This cylinder at a pose ``(4, 4)``; itself for ``None``."""
        return self if pose is None else replace(self, pose=matmul(checked_pose(pose, self.name), self.pose))


def all_of(kind: type, given, name: str) -> tuple:
    """Objects of a kind, such as bodies, or one of them, as a tuple; ``ShapeError`` for others."""
    kinds = getattr(kind, "__args__", (kind,))
    found = tuple(given) if isinstance(given, Iterable) else (given,)
    for each in found:
        if not isinstance(each, kind):
            mend = "; Body.hull(mesh.vertices) holds a mesh, and moves with link=" if Body in kinds else ""
            named = " or ".join(each.__name__ for each in kinds)
            raise ShapeError(f"{name}: expected objects of {named}, got {type(each).__name__}{mend}")
    return found


def ball_of(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre ``(3,)`` and radius of a ball that holds points ``(P, 3)``, up to rounding."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(lengths(points - center).max())


def _enclosed(points: np.ndarray) -> tuple[np.ndarray, float]:
    """At most ``MOST_POINTS`` of points ``(P, 3)``, and a radius within which of their hull all are."""
    from trimesh.triangles import closest_point

    hull, around = _solid(points)
    if len(around) > 1 and len(few := np.unique(points, axis=0)) <= MOST_POINTS:
        return few, 0.0
    corners, grown = points[np.unique(hull.vertices // len(around))], float(lengths(around[0]))
    if len(corners) <= MOST_POINTS:
        return corners, grown
    chosen = corners[_spread(corners)]
    hull, around = _solid(chosen)
    above = matmul(corners, hull.equations[:, :3].T) + hull.equations[:, 3]
    outside, triangles, off = above.max(axis=1) > 0, hull.points[hull.simplices], 0.0
    x, facing = corners[outside], triangles[above[outside].argmax(axis=1)]
    most = lengths(x - closest_point(facing, x))  # any point of the hull is no nearer than the nearest
    for k in np.argsort(-most):
        if most[k] <= off:
            break
        nearest = closest_point(triangles, np.broadcast_to(x[k], (len(triangles), 3)))
        off = max(off, float(lengths(x[k] - nearest).min()))
    off = float(round_up(off * (1 + 1e-6)))  # ``closest_point`` is off by less, and by what the CPU's BLAS rounds
    return chosen, off + 1e-12 * np.abs(corners).max() + grown + float(lengths(around[0]))


def _solid(points: np.ndarray) -> tuple[Any, np.ndarray]:
    """The convex hull of points, or of small cubes around them, and what is added to a point for the cube's corners.

    Qhull joins faces that differ by rounding only, and so loses corners of nearly flat points.
    """
    from scipy.spatial import ConvexHull, QhullError

    thin = THIN * np.abs(points).max() or 1.0
    with contextlib.suppress(QhullError):
        hull = ConvexHull(points)
        if 2 * hull.volume >= thin * hull.area:  # of a plate, half of the area times its thickness is the volume
            return hull, np.zeros((1, 3))
    around = thin * (2.0 * CORNERS - 1)
    return ConvexHull((points[:, None] + around).reshape(-1, 3)), around


def _spread(points: np.ndarray) -> np.ndarray:
    """``MOST_POINTS`` indices of points, each the farthest from those before it."""
    chosen, away, columns = [0], np.full(len(points), np.inf), np.ascontiguousarray(points.T)
    while len(chosen) < MOST_POINTS:
        away = np.minimum(away, np.sqrt(((columns - columns[:, chosen[-1:]]) ** 2).sum(axis=0)))
        chosen.append(int(away.argmax()))
    return np.array(chosen)


RIGID = 1e-6  # by how much a pose's rotation may miss being one; files give six digits or so


def checked_pose(pose, name: str) -> np.ndarray:
    """A rigid motion ``(4, 4)``, its rotation made exactly one, up to float64; ``ShapeError`` if it is none."""
    pose = np.array(pose, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not (pose[3] == [0, 0, 0, 1]).all():
        raise ShapeError(f"{name}: expected a pose of shape (4, 4) with the last row 0 0 0 1, got {pose.tolist()}")
    rotation = nearest_rotation(pose[:3, :3], RIGID)
    if rotation is None:
        raise ShapeError(f"{name}: expected a rotation without a scale or a mirror, got {pose[:3, :3].tolist()}")
    pose[:3, :3] = rotation
    return pose


# --- Joints and arms --------------------------------------------------------------------------------------------------

MOST_JOINTS = 64  # the rounding of ``Motions`` counts on it
FARTHEST = 4 * np.pi  # of a limit in radians; farther there is nothing new, and sine and cosine are less accurate
WHOLE_TURN = 2 * np.pi - 1e-5  # radians: limits so far apart count as a whole turn; files write 3.14159
PARALLEL = 1e-12  # by how much the cosine of the angle between parallel axes may miss 1
OUTWARD = 1 + 2.0**-40  # outweighs what float64 rounds in a reach


@dataclass(frozen=True, eq=False)
class Joint(Picklable):
    """What one number of a configuration moves.

    Attributes:
        origin: ``(4, 4)``, the joint's frame in that of the link before, where its value is 0.
        axis: ``(3,)``, in the joint's frame; made a unit vector.
        lower: Least value; radians, or metres.
        upper: Largest value.
        slides: Whether it slides along the axis (prismatic) instead of turning about it.
        name: For people.
        continuous: Whether it turns without end: q and q + 2 pi k are the same, and its limits, which are not told, are
            those of one turn.

    Raises:
        ShapeError: For numbers that are none, or limits in the wrong order or too far, or of a joint without any.

    Example:
        >>> elbow = wb.arms.Joint(axis=[0, 2, 0], lower=-2.0, upper=2.0)
        >>> elbow.axis
        array([0., 1., 0.])
    """

    origin: np.ndarray = field(default_factory=lambda: np.eye(4))
    axis: np.ndarray = (0.0, 0.0, 1.0)
    lower: float = -np.pi
    upper: float = np.pi
    slides: bool = False
    name: str = "joint"
    continuous: bool = False

    def __post_init__(self):
        axis = np.array(self.axis, dtype=np.float64)
        length = lengths(axis) if axis.shape == (3,) else np.nan
        if not 1e-6 < length < 1e6:
            raise ShapeError(f"{self.name}: expected an axis of 3 numbers that are not all 0, got {self.axis}")
        for what, reported in (("slides", self.slides), ("continuous", self.continuous)):
            if not isinstance(reported, bool | np.bool_):
                raise ShapeError(f"{self.name}: expected {what} to be True or False, got {reported!r}")
        lower, upper = float(self.lower), float(self.upper)
        farthest = 1e6 if self.slides else FARTHEST
        if not -farthest <= lower < upper <= farthest:
            raise ShapeError(
                f"{self.name}: expected limits from {-farthest:.4g} to {farthest:.4g}, the lower one first, got "
                f"{lower} and {upper}"
            )
        if self.continuous and (self.slides or (lower, upper) != (-np.pi, np.pi)):
            raise ShapeError(f"{self.name}: a continuous joint turns, and has no limits, got {lower} and {upper}")
        for name, value in (
            ("origin", checked_pose(self.origin, self.name)),
            ("axis", axis / length),
            ("lower", lower),
            ("upper", upper),
        ):
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def motion(self, q) -> np.ndarray:
        """What values ``(...,)`` of the joint do, ``(..., 4, 4)``, in the joint's frame."""
        q = np.asarray(q, dtype=np.float64)
        step = np.broadcast_to(np.eye(4), (*q.shape, 4, 4)).copy()
        if self.slides:
            step[..., :3, 3] = q[..., None] * self.axis
        else:
            s, c = (np.sin(q), np.cos(q)) if q.ndim else sine_cosine(float(q))
            one, zero = np.ones(q.shape), np.zeros(q.shape)
            about = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(*q.shape, 3, 3)
            step[..., :3, :3] = matmul(matmul(self.turned, about), self.turned.T)
        return step

    @property
    def turned(self) -> np.ndarray:
        """``(3, 3)`` rotation that takes z to the axis."""
        z, side = self.axis, np.eye(3)[np.abs(self.axis).argmin()]
        x = np.cross(side, z)
        x = x / lengths(x)
        return np.stack([x, np.cross(z, x), z], axis=1)


@dataclass(frozen=True)
class Mimic:
    """How a joint follows another one: ``value = factor * leader + offset``.

    Attributes:
        leader: Number of the joint that it follows: a lower one, which follows none.
        factor: Not 0.
        offset: Radians, or metres.

    Example:
        >>> joints = [wb.arms.Joint(lower=-1, upper=1), wb.arms.Joint(lower=-2, upper=2)]
        >>> link = wb.arms.Body.capsule([0, 0, 0], [1, 0, 0], 0.1, link=1)
        >>> arm = wb.arms.Arm(joints, [link], mimics={1: wb.arms.Mimic(0, factor=-2.0)})
        >>> arm.free  # a configuration has one value
        (0,)
    """

    leader: int
    factor: float = 1.0
    offset: float = 0.0


class Arm:
    """Joints and the bodies that they move; a configuration has ``(n,)`` values, of the joints that follow no other.

    Args:
        joints: At most ``MOST_JOINTS``.
        bodies: Of all links; those of the base have the link ``WORLD``.
        parents: For each joint the one whose link carries it, a lower number, or ``WORLD``; a chain for ``None``.
        mimics: Which joints follow others, by their numbers.
        touching: Pairs that are not checked against each other, since they always touch or never do: of links by their
            numbers, or of parts by their names.
        neighbours: Whether links and the links that carry them are checked against each other.
        name: For people.
        note: What users should know, such as parts of a file that were not read.

    Attributes:
        joints: The joints.
        bodies: The bodies.
        parents: A number for each joint.
        mimics: As given.
        free: Numbers of the joints that follow none, in the order of a configuration's values.
        touching: Pairs, the lower number or name first.
        neighbours: As given.
        note: As given.

    Raises:
        ShapeError: For no joint, too many, a parent that is none, a joint that follows none that leads, or bodies of
            links that are not there.

    Example:
        >>> def link(i):
        ...     return wb.arms.Body.capsule([0, 0, 0], [1, 0, 0], 0.1, link=i)
        >>> step = np.eye(4)
        >>> step[0, 3] = 1.0
        >>> arm = wb.arms.Arm([wb.arms.Joint(), wb.arms.Joint(origin=step)], [link(0), link(1)])
        >>> post = wb.arms.Body.sphere([0, 1.5, 0], 0.2)
        >>> shape = wb.arms.ArmConfigurations(arm, [post])
        >>> shape.contains(np.array([[0.0, 0.0], [np.pi / 2, 0.0]]))
        array([False,  True])
        >>> shape.empty(np.array([[-0.1, -0.1]]), np.array([[0.1, 0.1]]))
        array([ True])
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        bodies: Sequence[Body],
        *,
        parents: Sequence[int] | None = None,
        mimics: Mapping[int, Mimic] | None = None,
        touching: Iterable[tuple[int, int] | tuple[str, str]] = (),
        neighbours: bool = False,
        name: str = "arm",
        note: str = "",
    ):
        self.joints, self.bodies = all_of(Joint, joints, name), all_of(Body, bodies, name)
        self.name, self.note = name, note
        self.neighbours, self.mimics = neighbours, dict(mimics or {})
        count = len(self.joints)
        if not 1 <= count <= MOST_JOINTS:
            raise ShapeError(f"{name}: expected 1 to {MOST_JOINTS} joints, got {count}")
        self.parents = tuple(range(-1, count - 1)) if parents is None else tuple(parents)
        if len(self.parents) != count or not all(WORLD <= p < i for i, p in enumerate(self.parents)):
            raise ShapeError(f"{name}: expected a parent for each joint, a lower number or {WORLD}, got {self.parents}")
        if not any(body.link != WORLD for body in self.bodies):
            raise ShapeError(f"{name}: expected at least one body that a joint moves")
        for body in self.bodies:
            if body.link not in range(WORLD, count):
                raise ShapeError(f"{name}: {body.name} is of link {body.link}, and there are -1 to {count - 1}")
        self._follow()
        known = {*range(WORLD, count), *(body.part for body in self.bodies)}
        for pair in touching:
            if len(pair) != 2 or type(pair[0]) is not type(pair[1]) or not known.issuperset(pair):
                raise ShapeError(f"{name}: expected pairs of links from -1 to {count - 1} or of parts, got {pair}")
        self.touching = frozenset((min(pair), max(pair)) for pair in touching)

    def _follow(self) -> None:
        """Number the values of a configuration, and check who follows whom."""
        self.free = tuple(i for i in range(len(self.joints)) if i not in self.mimics)
        for i, mimic in self.mimics.items():
            if i not in range(len(self.joints)) or mimic.leader not in self.free or mimic.leader > i:
                raise ShapeError(f"{self.name}: joint {i} follows {mimic.leader}, which is no leader before it")
            joint, leader = self.joints[i], self.joints[mimic.leader]
            most = max(abs(mimic.factor * value + mimic.offset) for value in (leader.lower, leader.upper, 0.0))
            if not mimic.factor or not most <= (LARGEST if joint.slides else FARTHEST):
                raise ShapeError(f"{self.name}: {joint.name} follows {leader.name} by {mimic.factor} to {most}")
            if leader.continuous and not (joint.continuous and mimic.factor in (1, -1)):
                raise ShapeError(f"{self.name}: {joint.name} follows {leader.name}, which turns without end")
        follows = [self.mimics.get(i, Mimic(i)) for i in range(len(self.joints))]
        #: For each joint the number of its value in a configuration, and what is made of it.
        self.coordinate = np.array([self.free.index(each.leader) for each in follows])
        self.factor = np.array([each.factor for each in follows], dtype=np.float64)
        self.offset = np.array([each.offset for each in follows], dtype=np.float64)

    def __repr__(self) -> str:
        return (
            f"<Arm {self.name}: {len(self.free)} joints, {len(self.bodies)} bodies{', ' * bool(self.note)}{self.note}>"
        )

    def pairs(self) -> np.ndarray:
        """``(P, 2)`` int32: numbers of the bodies that are checked against each other, the lower link first."""
        found, links = [], [body.link for body in self.bodies]
        for one, a in enumerate(links):
            for other, b in enumerate(links):
                parts = tuple(sorted((self.bodies[one].part, self.bodies[other].part)))
                apart = a < b and (self.neighbours or self.parents[b] != a)
                if apart and (a, b) not in self.touching and parts not in self.touching:
                    found.append((one, other))
        return np.array(found, dtype=np.int32).reshape(-1, 2)

    def with_bodies(self, bodies: Iterable[Body], touching: Iterable[tuple] = ()) -> "Arm":
        """The arm with more bodies behind its own, and pairs that are not checked besides its own."""
        found = copy(self)
        found.bodies = (*self.bodies, *all_of(Body, bodies, self.name))
        found.touching = self.touching | {tuple(sorted(pair)) for pair in touching}
        found.__dict__.pop("_moved", None)
        return found

    def hash_into(self, sha, obstacles: Sequence = ()) -> None:
        """Add all numbers of joints, bodies and obstacles to a hash; names do not enter."""
        for joint in self.joints:
            numbers = [*joint.origin.ravel(), *joint.axis, joint.lower, joint.upper, joint.slides]
            numbers += [joint.continuous] * joint.continuous
            sha.update(np.array(numbers, dtype="<f8").tobytes())
        for body in (*self.bodies, *obstacles):
            sha.update(np.asarray(body.numbers, dtype="<f8").tobytes() + b";")

    def hash_tree_into(self, sha) -> None:
        """Add who carries and who follows whom, of an arm that is no chain."""
        if self.parents != tuple(range(-1, len(self.joints) - 1)) or self.mimics:
            for array in (self.parents, self.coordinate, self.factor, self.offset):
                sha.update(np.asarray(array, dtype="<f8").tobytes() + b";")

    def _held(self, numbers: Iterable[int]) -> "Arm":
        """The arm with these joints fixed in the middle of their limits; bodies keep their order."""
        values = np.array([(self.joints[i].lower + self.joints[i].upper) / 2 for i in self.free])
        values = values[self.coordinate] * self.factor + self.offset
        joints, parents, number, at = [], [], {WORLD: WORLD}, {WORLD: np.eye(4)}
        for i, (joint, parent) in enumerate(zip(self.joints, self.parents, strict=True)):
            origin = matmul(at[parent], joint.origin)
            if i in numbers:
                number[i], at[i] = number[parent], matmul(origin, joint.motion(values[i]))
                continue
            number[i], at[i] = len(joints), np.eye(4)
            joints.append(replace(joint, origin=origin))
            parents.append(number[parent])
        bodies = [replace(body.moved(at[body.link]), link=number[body.link]) for body in self.bodies]
        mimics = {number[i]: replace(m, leader=number[m.leader]) for i, m in self.mimics.items() if i not in numbers}
        return Arm(joints, bodies, parents=parents, mimics=mimics, name=self.name, note=self.note)

    def endless(self) -> "Arm":
        """The arm whose joints that turn by a whole turn or more, and lead none and follow none, turn without end.

        What lacks 1e-5 rad of a whole turn counts as one, as files write 3.14159.

        Bounders of its configurations then know one turn of such a joint instead of two or more, and answer beyond its
        limits, too: whoever plans keeps these.

        Example:
            >>> joint = wb.arms.Joint(lower=-2 * np.pi, upper=2 * np.pi)
            >>> arm = wb.arms.Arm([joint], [wb.arms.Body.sphere([1, 0, 0], 0.1, link=0)])
            >>> bool(arm.endless().joints[0].continuous), arm.endless().upper
            (True, array([3.14159265]))
        """
        bound = {*self.mimics, *(mimic.leader for mimic in self.mimics.values())}
        whole = [
            i
            for i, joint in enumerate(self.joints)
            if not joint.slides and joint.upper - joint.lower >= WHOLE_TURN and i not in bound
        ]
        found, joints = copy(self), list(self.joints)
        for i in whole:
            joints[i] = replace(joints[i], lower=-np.pi, upper=np.pi, continuous=True)
        found.joints = tuple(joints)
        return found

    @property
    def lower(self) -> np.ndarray:
        """``(n,)`` float64, the joints' least values."""
        return np.array([self.joints[i].lower for i in self.free])

    @property
    def upper(self) -> np.ndarray:
        """``(n,)`` float64, the joints' largest values."""
        return np.array([self.joints[i].upper for i in self.free])

    @property
    def moved(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Each joint's origin ``(4, 4)`` and all bodies' points ``(P, 3)``, in frames whose z is the joint's axis."""
        origins = []
        turns = [joint.turned for joint in self.joints] + [np.eye(3)]  # the last one is that of ``WORLD``
        for joint, parent, turned in zip(self.joints, self.parents, turns[:-1], strict=True):
            origin = joint.origin.copy()
            origin[:3, 3] = matmul(turns[parent].T, origin[:3, 3:])[:, 0]
            origin[:3, :3] = matmul(matmul(turns[parent].T, origin[:3, :3]), turned)
            origins.append(origin)
        return tuple(origins), tuple(matmul(body.points, turns[body.link]) for body in self.bodies)

    @property
    def angles(self) -> np.ndarray:
        """The sums ``(K, n)`` of a configuration's values whose sines and cosines describe the arm.

        One for each joint that turns: of itself and of those before it whose axes are parallel to its own, one after
        another.

        What turns about parallel axes turns by the sum, so places in an arm are made of products of sines and cosines
        of these, one of each run of axes.
        """
        frames, found = self.frames(np.zeros((1, len(self.free))))[0], []
        rows, axes = {WORLD: np.zeros(len(self.free))}, {WORLD: None}
        for i, (joint, parent) in enumerate(zip(self.joints, self.parents, strict=True)):
            rows[i], axes[i], before = rows[parent], axes[parent], axes[parent]
            if joint.slides:
                continue
            axes[i] = frames[i, :3, :3] @ joint.axis
            along = 0.0 if before is None else float(axes[i] @ before)
            rows[i] = rows[parent] * (np.sign(along) if abs(along) > 1 - PARALLEL else 0.0)
            rows[i][self.coordinate[i]] += self.factor[i]
            if rows[i].any():
                found.append(rows[i])
        return np.array(found).reshape(-1, len(self.free))

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Poses ``(N, joints, 4, 4)`` of links for ``(N, n)`` configurations, in the frames of ``Joint``, rounded."""
        q = np.asarray(q, dtype=np.float64)[:, self.coordinate] * self.factor + self.offset
        found = np.empty((len(q), len(self.joints), 4, 4))
        for i, (joint, parent) in enumerate(zip(self.joints, self.parents, strict=True)):
            frame = np.broadcast_to(np.eye(4), (len(q), 4, 4)) if parent == WORLD else found[:, parent]
            found[:, i] = frame @ joint.origin @ joint.motion(q[:, i])
        return found

    def reach(self, largest: np.ndarray | None = None) -> np.ndarray:
        """How far points of the bodies' hulls are from the joints' axes at most.

        Args:
            largest: ``(joints,)``, largest absolute values of the joints; those of the limits for ``None``.

        Returns:
            ``(bodies, joints)`` float64: metres; 1 for a joint that slides, 0 where a joint does not move the body.
        """
        found = np.zeros((len(self.bodies), len(self.joints)))
        for number in range(len(self.bodies)):
            for i, _, far in self.path(WORLD, number, largest):
                found[number, i] = far
        return found

    def path(self, link: int, body: int, largest: np.ndarray | None = None) -> list[tuple[int, float, float]]:
        """The joints that move a body, seen from a link.

        Args:
            link: A number; ``WORLD`` is the base.
            body: A number.
            largest: As ``reach`` takes it.

        Returns:
            Of each joint on the way from the link to the body's its number, 1 or -1 (the latter towards the base), and
            how far points of the body's hull are from its axis at most: metres; 1 for a joint that slides.
        """
        slides = np.array([joint.slides for joint in self.joints])
        slide = np.where(slides, self._largest if largest is None else largest, 0.0).tolist()
        back, onward = self._ancestors(link), self._ancestors(self.bodies[body].link)
        while back and onward and back[-1] == onward[-1]:
            back, onward = back[:-1], onward[:-1]
        origins, points = self._moved[0], self._moved[1][body]
        far = float(lengths(points).max()) * OUTWARD  # from the origin of the link
        near = float(lengths(points[:, :2]).max()) * OUTWARD  # from its axis
        found = []
        for i in onward:
            found.append((i, 1.0, 1.0 if slides[i] else near))
            shift = origins[i][:3, 3]
            # Seen from the frame before, the body lies within ``far`` (and the slide) of the joint's origin.
            near = (float(lengths(shift[:2])) + far + slide[i]) * OUTWARD
            far = (float(lengths(shift)) + far + slide[i]) * OUTWARD
        for i in reversed(back):  # from the link that both ways have in common, outwards
            far = (float(lengths(origins[i][:3, 3])) + far) * OUTWARD  # from the joint's origin
            found.append((i, -1.0, 1.0 if slides[i] else far))
            far = (far + slide[i]) * OUTWARD
        return found[::-1]

    def _ancestors(self, link: int) -> list[int]:
        """A link and those that carry it, the base left out."""
        found = []
        while link != WORLD:
            found.append(link)
            link = self.parents[link]
        return found

    @cached_property
    def _moved(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        return self.moved

    @property
    def _largest(self) -> np.ndarray:
        """``(joints,)``, the largest absolute values of the joints within the limits."""
        ends = np.stack([self.lower, self.upper])[:, self.coordinate] * self.factor + self.offset
        return np.abs(ends).max(axis=0)

    @property
    def reaching(self) -> np.ndarray:
        """``(n,)`` float64: how many metres a value of a configuration moves the arm at most, per radian.

        They are the weights of ``ArmConfigurations``.
        """
        reach, found = self.reach().max(axis=0) * np.abs(self.factor), np.zeros(len(self.free))
        np.add.at(found, self.coordinate, reach)
        return found

    def self_collision(
        self,
        *,
        safety: float = 0.0,
        revolved: Sequence[str] = (),
        only: Sequence[tuple[str, str]] | None = None,
        without: Sequence[tuple[str, str]] = (),
        samples: int = 2000,
    ) -> "ArmConfigurations":  # noqa: F821
        """The configurations in which the arm touches itself, in the joints that matter: a shape for all cells.

        Joints turn without end here as in ``endless``, and those that move no pair of bodies against each other are
        left out; ``columns`` of the shape tells which values of a configuration are its coordinates:
        ``bounder.query(q[:, shape.columns])``. So are pairs that touch in all of some random configurations; the
        shape's ``note`` names them.

        Args:
            safety: Metres: what comes closer counts as touching.
            revolved: Names of parts that may be replaced by solids of revolution, such as a round base and a round
                flange. A joint is left out where it is the first or the last that moves each pair, and the bodies next
                to it are replaced; more configurations count as touching then.
            only: Pairs of parts, by their names: no others are checked; all for ``None``.
            without: Pairs of parts that are not checked. Where a few pairs need a joint that the others can spare, a
                bounder of these pairs (``only``) and one of the others (``without``) are often tighter than one of all.
            samples: Random configurations, of a fixed seed.

        Raises:
            ShapeError: If no two bodies could touch, or for names or pairs that the arm does not have.

        Example:
            >>> links = [wb.arms.Body.capsule([0, 0, 0], [1, 0, 0], 0.1, link=i) for i in range(3)]
            >>> step = np.eye(4)
            >>> step[0, 3] = 1.0
            >>> joints = [wb.arms.Joint(), *(wb.arms.Joint(origin=step) for _ in range(2))]
            >>> own = wb.arms.Arm(joints, links).self_collision()
            >>> own.columns, own.contains(np.array([[np.pi, 0.0], [3.0, 2.9]]))
            (array([1, 2]), array([False,  True]))
        """
        from warp_bounding.arms.configurations import ArmConfigurations

        pairs = {"only": only, "without": without}
        return ArmConfigurations.of_itself(self, safety=safety, revolved=revolved, samples=samples, **pairs)
