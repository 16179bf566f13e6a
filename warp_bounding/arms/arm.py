"""A serial arm: joints one after another, and the bodies that they move.

The frame of link i is that of link i - 1, moved by the joint's ``origin`` and then by the joint's value: a turn about
its axis, or a way along it. Frames are kept turned so that every axis is z, which is the arm's own affair
(``_frames``): bodies are given in the frames that a user knows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from warp_bounding.errors import ShapeError
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


@dataclass(frozen=True, eq=False)
class Body(Picklable):
    """The convex hull of points, and all within a radius of it.

    Attributes:
        points: ``(P, 3)`` float64, at most ``MOST_POINTS``; metres, in the frame of the link.
        radius: Metres.
        link: Number of the joint that moves it last, from 0; ``WORLD`` where none does.
        name: For people.

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
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radius", radius)

    @classmethod
    def sphere(cls, center, radius: float, *, link: int = WORLD, name: str = "sphere") -> "Body":
        """All points within a radius of a centre ``(3,)``."""
        return cls([center], radius, link, name)

    @classmethod
    def capsule(cls, start, end, radius: float, *, link: int = WORLD, name: str = "capsule") -> "Body":
        """All points within a radius of a segment, given by its ends ``(3,)``."""
        return cls([start, end], radius, link, name)

    @classmethod
    def box(cls, lower, upper, *, pose=None, radius: float = 0.0, link: int = WORLD, name: str = "box") -> "Body":
        """A box between two corners ``(3,)``, rounded by a radius, at a ``(4, 4)`` pose."""
        corners = np.array([lower, upper], dtype=np.float64)
        if corners.shape != (2, 3) or not (corners[0] <= corners[1]).all():
            raise ShapeError(f"{name}: expected two corners of 3 numbers, the lower one first, got {lower} and {upper}")
        index = np.indices((2, 2, 2)).reshape(3, -1).T
        return cls(corners[index, np.arange(3)], radius, link, name).moved(pose)

    def moved(self, pose) -> "Body":
        """This body at a pose ``(4, 4)``; itself for ``None``."""
        if pose is None:
            return self
        pose = checked_pose(pose, self.name)
        return replace(self, points=self.points @ pose[:3, :3].T + pose[:3, 3])

    def grown(self, radius: float) -> "Body":
        """This body and all within a further radius of it."""
        return replace(self, radius=self.radius + radius)


def ball_of(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre ``(3,)`` and radius of a ball that holds points ``(P, 3)``, up to rounding."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


RIGID = 1e-6  # by how much a pose's rotation may miss being one; files give six digits or so


def checked_pose(pose, name: str) -> np.ndarray:
    """A rigid motion ``(4, 4)``, its rotation made exactly one, up to float64; ``ShapeError`` if it is none."""
    pose = np.array(pose, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not (pose[3] == [0, 0, 0, 1]).all():
        raise ShapeError(f"{name}: expected a pose of shape (4, 4) with the last row 0 0 0 1, got {pose.tolist()}")
    u, _, v = np.linalg.svd(pose[:3, :3])
    rotation = u @ v
    if np.abs(rotation - pose[:3, :3]).max() > RIGID or np.linalg.det(rotation) < 0:
        raise ShapeError(f"{name}: expected a rotation without a scale or a mirror, got {pose[:3, :3].tolist()}")
    pose[:3, :3] = rotation
    return pose


# --- Joints and arms --------------------------------------------------------------------------------------------------

MOST_JOINTS = 16  # ``kinematics.ALLOWANCE`` counts on it
FARTHEST = 4 * np.pi  # of a limit in radians; farther there is nothing new, and sine and cosine are less accurate
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
        length = np.linalg.norm(axis) if axis.shape == (3,) else np.nan
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

    @property
    def turned(self) -> np.ndarray:
        """``(3, 3)`` rotation that takes z to the axis."""
        z, side = self.axis, np.eye(3)[np.abs(self.axis).argmin()]
        x = np.cross(side, z)
        x = x / np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z], axis=1)


class Arm:
    """Joints and the bodies that they move; its configurations are ``(n,)`` joint values.

    Args:
        joints: In order from the base, at most ``MOST_JOINTS``.
        bodies: Of all links; those of the base have the link ``WORLD``.
        touching: Pairs of links that always touch or may, and are not checked against each other; neighbours are not in
            any case.
        name: For people.
        note: What users should know, such as parts of a file that were not read.

    Attributes:
        joints: The joints.
        bodies: The bodies.
        touching: Pairs of links, the lower number first.
        note: As given.

    Raises:
        ShapeError: For no joint, too many, or bodies of links that are not there.

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
        touching: Sequence[tuple[int, int]] = (),
        name: str = "arm",
        note: str = "",
    ):
        self.joints, self.bodies, self.name, self.note = tuple(joints), tuple(bodies), name, note
        if not 1 <= len(self.joints) <= MOST_JOINTS:
            raise ShapeError(f"{name}: expected 1 to {MOST_JOINTS} joints, got {len(self.joints)}")
        links = range(WORLD, len(self.joints))
        if not any(body.link != WORLD for body in self.bodies):
            raise ShapeError(f"{name}: expected at least one body that a joint moves")
        for body in self.bodies:
            if body.link not in links:
                raise ShapeError(f"{name}: {body.name} is of link {body.link}, and there are -1 to {links[-1]}")
        for pair in touching:
            if len(pair) != 2 or not all(link in links for link in pair):
                raise ShapeError(f"{name}: expected pairs of links from -1 to {links[-1]}, got {pair}")
        self.touching = frozenset((min(pair), max(pair)) for pair in touching)

    def __repr__(self) -> str:
        return (
            f"<Arm {self.name}: {len(self.joints)} joints, {len(self.bodies)} "
            f"bodies{', ' * bool(self.note)}{self.note}>"
        )

    def first(self, count: int) -> "Arm":
        """The arm that ends behind its first ``count`` joints, with what these move."""
        if not 1 <= count <= len(self.joints):
            raise ShapeError(f"{self.name}: expected 1 to {len(self.joints)} joints, got {count}")
        bodies = [body for body in self.bodies if body.link < count]
        touching = [pair for pair in self.touching if pair[1] < count]
        return Arm(self.joints[:count], bodies, touching=touching, name=self.name, note=self.note)

    @property
    def lower(self) -> np.ndarray:
        """``(n,)`` float64, the joints' least values."""
        return np.array([joint.lower for joint in self.joints])

    @property
    def upper(self) -> np.ndarray:
        """``(n,)`` float64, the joints' largest values."""
        return np.array([joint.upper for joint in self.joints])

    @property
    def moved(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Each joint's origin ``(4, 4)`` and all bodies' points ``(P, 3)``, in frames whose z is the joint's axis."""
        origins, before = [], np.eye(3)
        for joint in self.joints:
            origin, turned = joint.origin.copy(), joint.turned
            origin[:3, 3] = before.T @ origin[:3, 3]
            origin[:3, :3] = before.T @ origin[:3, :3] @ turned
            origins.append(origin)
            before = turned
        turns = [joint.turned for joint in self.joints] + [np.eye(3)]  # the last one is that of ``WORLD``
        return tuple(origins), tuple(body.points @ turns[body.link] for body in self.bodies)

    @property
    def angles(self) -> np.ndarray:
        """The sums ``(K, n)`` of joint values whose sines and cosines describe the arm.

        One for each joint that turns: of itself and of those before it whose axes are parallel to its own, one after
        another.

        What turns about parallel axes turns by the sum, so places in an arm are made of products of sines and cosines
        of these, one of each run of axes.
        """
        frames, found, row = self.frames(np.zeros((1, len(self.joints))))[0], [], np.zeros(len(self.joints))
        before = None
        for i, joint in enumerate(self.joints):
            if joint.slides:
                continue
            axis = frames[i, :3, :3] @ joint.axis
            along = 0.0 if before is None else float(axis @ before)
            row = row * np.sign(along) if abs(along) > 1 - PARALLEL else np.zeros(len(self.joints))
            row[i], before = 1.0, axis
            found.append(row)
        return np.array(found).reshape(-1, len(self.joints))

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Poses ``(N, n, 4, 4)`` of the links for ``(N, n)`` configurations, in the frames of ``Joint``, rounded."""
        q = np.asarray(q, dtype=np.float64)
        frame, found = np.broadcast_to(np.eye(4), (len(q), 4, 4)), []
        for i, joint in enumerate(self.joints):
            step, turn = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy(), joint.turned
            if joint.slides:
                step[:, :3, 3] = q[:, i, None] * joint.axis
            else:
                c, s, one = np.cos(q[:, i]), np.sin(q[:, i]), np.ones(len(q))
                zero = np.zeros(len(q))
                about = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
                step[:, :3, :3] = turn @ about @ turn.T
            frame = frame @ joint.origin @ step
            found.append(frame)
        return np.stack(found, axis=1)

    def reach(self, largest: np.ndarray | None = None) -> np.ndarray:
        """How far points of the bodies' hulls are from the joints' axes at most.

        Args:
            largest: ``(n,)``, largest absolute values of the joints; those of the limits for ``None``.

        Returns:
            ``(bodies, n)`` float64: metres; 1 for a joint that slides, 0 where a joint does not move the body.
        """
        largest = np.maximum(np.abs(self.lower), np.abs(self.upper)) if largest is None else largest
        origins, moved = self.moved
        found = np.zeros((len(moved), len(self.joints)))
        for number, (body, points) in enumerate(zip(self.bodies, moved, strict=True)):
            if body.link == WORLD:
                continue
            far = float(np.linalg.norm(points, axis=1).max()) * OUTWARD  # from the origin of the link
            near = float(np.hypot(*points[:, :2].T).max()) * OUTWARD  # from its axis
            for i in range(body.link, -1, -1):
                slide = float(largest[i]) if self.joints[i].slides else 0.0
                found[number, i] = 1.0 if self.joints[i].slides else near
                x, y, z = origins[i][:3, 3]
                # Seen from the frame before, the body lies within ``far`` (and the slide) of the joint's origin.
                near = (np.hypot(x, y) + far + slide) * OUTWARD
                far = (np.sqrt(x * x + y * y + z * z) + far + slide) * OUTWARD
        return found

    @property
    def reaching(self) -> np.ndarray:
        """``(n,)`` float64: how many metres a joint moves the arm at most, per radian.

        They are the weights of ``ArmConfigurations``.
        """
        return self.reach().max(axis=0)
