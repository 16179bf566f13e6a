"""Whole motions of an arm, proven to touch nothing: any number of joints, nothing fitted, obstacles that may change.

*What is proven.* For every t in [0, 1], as a real number, at ``q0 + t (q1 - q0)`` no body of the arm is within
``margin`` of an obstacle, or of another body that it is checked against.

*How.* In an interval of half-length h around its middle, a point p of a link moves by ``s v``, ``|s| <= h``, and by
``h^2 / 2 A`` more at most. v is its velocity at the middle, and A the largest acceleration: the sum over joints j and k
of ``|dq_j| |dq_k| R``, R the largest distance that p can have from the axis of the one of the two joints that is nearer
to p. (For a joint that slides R is 1, and it counts with those before it that turn only.) Let n be a unit vector from
one body towards another. Points of the second have ``n . (p + s v) - h^2 / 2 A`` at least, which is linear in p and in
s, so that its least value lies at a corner and at ``s = -h`` or ``s = h``. If that is above all of the first body by
the radii and the margin, the two are apart in the whole interval. Else the interval is halved, for these two bodies
alone. n comes from a box around one body and a ball around the other, then from the search of Gilbert, Johnson and
Keerthi; the proof holds for any n.

*Rounding.* Everything is float64. Let u = 2^-53, S the sum of all lengths of the arm and the farthest coordinate of an
obstacle, and D the sum of all ``|dq_j|``. With up to 64 joints, a rotation is off by 32 u for each joint before it, a
position by ``2^12 u S``, and a velocity, which sums products of ``dq_j`` and such numbers, by ``2^14 u S D``. That
values are computed at the rounded ``q0 + t (q1 - q0)``, of up to 1000, moves a point by ``2^17 u S`` more. The
allowance is ``2^19 u S (1 + D)``, more than the sum of all. Where a compiler fuses a product and a sum, there is one
rounding in place of two, each as small relative to the terms that these counts bound, so they hold there, too.

The idea is that of Schwarzer, Saha and Latombe, "Adaptive dynamic collision checking" (2005); new are directions and
corners, and that it holds in float64.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.arms.arm import LARGEST, WORLD, Arm, Body, Cylinder, all_of, checked_pose
from warp_bounding.arms.scan import DistanceField, Scan
from warp_bounding.errors import FileFormatError, ShapeError
from warp_bounding.rigid import lengths, matmul, moved, principal_axes
from warp_bounding.runtime.arrays import Picklable
from warp_bounding.runtime.header import array, private, write
from warp_bounding.runtime.launch import BlockLaunch, device_of
from warp_bounding.runtime.native import constant, fill, named, native_text
from warp_bounding.runtime.whole_file import write_whole
from warp_bounding.shapes.shape import checked_margin

__all__ = ["Motions", "Plan"]

FREE, UNDECIDED, COLLIDING = 0, 1, 2  # states of configurations and motions
ALLOWANCE = 2.0**-34  # of the size S: by how much a gap may be off, see above
OUTWARD = 1 + 2.0**-40  # outweighs what sums of a few products round, relative to their size
ROUNDED = 2.0**-51  # of a joint's limits: what q0 + t (q1 - q0) rounds beyond them at most, and more
LANES = 8  # corners of a group
DEEPEST = 24  # times that a motion is halved, at most

HULL, CYLINDER, FIELD = 0, 1, 2  # kinds of bodies, as the native text numbers them

Obstacle = Body | Cylinder | Scan | DistanceField


class Motions:
    """Whether motions of an arm are free of obstacles and of the arm itself, all along, by proof.

    Args:
        arm: The arm; see ``load_urdf``.
        obstacles: Bodies, cylinders, scans and distance fields that stand in the world.
        attached: What links carry, such as a grasped object, by the names of parts of the arm: bodies and cylinders (by
            their prisms) in the frame of the joint that moves the part (``Body.link`` is not heeded). They are checked
            against what the part is checked against.
        self_collision: Whether the arm is checked against itself, as ``Arm.pairs`` says.
        margin: Metres: what comes closer counts as touching.
        halvings: How often a motion is halved at most; each halving doubles the time that a hopeless one takes.
        device: Warp device that proves batches; on CUDA a thread takes a motion.

    Attributes:
        arm: With what is attached.
        attached: As given, cylinders as their prisms: bodies by part.
        self_collision: As given.
        margin: As given.
        device: As given, a ``wp.Device``.
        pairs: ``(P, 2)`` numbers of bodies of the arm that are checked against each other.

    Raises:
        ShapeError: For obstacles of another kind, or attached bodies on a part that the arm does not have.

    Example:
        >>> arm = wb.arms.Arm([wb.arms.Joint()], [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=0)])
        >>> motions = wb.arms.Motions(arm, [wb.arms.Body.sphere([0.5, 0, 0], 0.1, name="ball")])
        >>> clear, share = motions.segments([[1.0], [1.0]], [[2.0], [0.0]])
        >>> clear, share
        (array([ True, False]), array([1. , 0.5]))
        >>> motions.move("ball", [[1, 0, 0, 0], [0, 1, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> motions.segments([[1.0]], [[0.0]])[0]
        array([ True])
    """

    def __init__(
        self,
        arm: Arm,
        obstacles: Sequence[Obstacle] | Obstacle = (),
        *,
        attached: Mapping[str, Sequence[Body | Cylinder] | Body | Cylinder] | None = None,
        self_collision: bool = True,
        margin: float = 0.0,
        halvings: int = 12,
        device: str = "cpu",
    ):
        if not isinstance(arm, Arm):
            raise ShapeError(f"motions: expected an Arm, got {type(arm).__name__}; wb.arms.load_urdf reads files")
        if not 0 <= halvings <= DEEPEST:
            raise ShapeError(f"{arm.name}: expected halvings from 0 to {DEEPEST}, got {halvings}")
        self.attached = {part: _solid(given, arm.name) for part, given in (attached or {}).items()}
        self.arm, self.margin, self.halvings = _carrying(arm, self.attached), checked_margin(margin), int(halvings)
        self.self_collision = bool(self_collision)
        self.pairs = self.arm.pairs() if self_collision else np.empty((0, 2), dtype=np.int32)
        self.device = device_of(device)
        self._given: list[tuple[Obstacle, np.ndarray | None]] = []
        self._velocities: dict[str, Sequence[float]] = {}
        self._fixed = self._layout_of_arm()
        turning = np.array([self.arm.joints[i].continuous for i in self.arm.free])
        self._limits = np.where(turning, -np.inf, self.arm.lower), np.where(turning, np.inf, self.arm.upper)
        self.add(obstacles)

    def __repr__(self) -> str:
        return f"<Motions of {self.arm.name}: {len(self._given)} obstacles, {len(self.pairs)} pairs of its own>"

    # --- Obstacles ---------------------------------------------------------------------------------------------------

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles where they are now."""
        return tuple(body.moved(pose) for body, pose in self._given)

    def add(self, obstacles: Sequence[Obstacle] | Obstacle) -> None:
        """Put more obstacles into the world."""
        given = all_of(Obstacle, obstacles, self.arm.name)
        for body in given:
            if getattr(body, "link", WORLD) != WORLD:
                raise ShapeError(f"{self.arm.name}: {body.name} is an obstacle, and it is of link {body.link}")
        self._given += [(body, None) for body in given]
        self._arrays = None

    def move(self, name: str, pose) -> None:
        """Move the obstacles of a name from where they were given by a pose ``(4, 4)``."""
        self._of_name(name)
        pose = checked_pose(pose, name)
        self._given = [(body, pose if body.name == name else before) for body, before in self._given]
        self._arrays = None

    def remove(self, name: str) -> None:
        """Take the obstacles of a name away."""
        gone = self._of_name(name)
        self._given = [each for each in self._given if each[0] not in gone]
        self._arrays = None

    def _of_name(self, name: str) -> list[Obstacle]:
        found = [body for body, _ in self._given if body.name == name]
        if not found:
            known = ", ".join(dict.fromkeys(body.name for body, _ in self._given)) or "none"
            raise ShapeError(f"{self.arm.name}: expected the name of an obstacle, {known}, got {name}")
        return found

    # --- Questions ---------------------------------------------------------------------------------------------------

    def segments(
        self, q0, q1, *, until: bool = False, velocities: Mapping[str, Sequence[float]] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Whether straight motions from configurations to others are proven free, and how far.

        Args:
            q0: ``(N, n)`` configurations, radians or metres. Beyond the joints' limits nothing is proven.
            q1: ``(N, n)``.
            until: Go on halving motions that collide, to find how far they are free; that takes longer.
            velocities: By what ``(3,)`` obstacles move while the arm does, metres, by their names. They start where
                they are; meanwhile the base is checked against them, too.

        Returns:
            ``(N,)`` bool, and ``(N,)`` float64, the share from the start that is proven free, 1 where all of it is.
            With ``until=False`` it may be far too small.

        Raises:
            ShapeError: For arrays of other shapes. Of numbers that are none nothing is proven.
        """
        q0, q1 = self._configurations(q0), self._configurations(q1)
        if q0.shape != q1.shape:
            raise ShapeError(f"{self.arm.name}: expected as many ends as starts, got {len(q1)} and {len(q0)}")
        try:
            self._set_velocities(velocities or {})
            states, _, shares = self._ask(bool(until), q0, q1)
        finally:
            self._set_velocities({})
        return states == FREE, shares

    def _set_velocities(self, velocities: Mapping[str, Sequence[float]]) -> None:
        if not velocities and not self._velocities:
            return
        for name, velocity in velocities.items():
            self._of_name(name)
            if np.shape(velocity) != (3,) or not (np.abs(velocity) <= LARGEST).all():
                raise ShapeError(f"{self.arm.name}: expected a velocity (3,) of {name}, got {velocity}")
        self._velocities, self._arrays = dict(velocities), None

    def configurations(self, q) -> np.ndarray:
        """Whether configurations ``(N, n)`` are free, 0, collide, 2, or neither can be proven, 1: ``(N,)`` int32.

        Beyond limits nothing is proven. What ``q0 + t (q1 - q0)`` of two configurations rounds beyond them counts as
        the limit.
        """
        return self._ask(None, self._configurations(q))[0]

    def culprits(self, q) -> list[tuple[str, str] | None]:
        """Name two bodies that collide or are too close, for each configuration ``(N, n)``; ``None`` if it is free."""
        return [self._named(each) for each in self._ask(None, self._configurations(q))[1].tolist()]

    def path(self, waypoints) -> "Plan":
        """Prove a whole plan: straight motions from each waypoint ``(n,)`` to the next.

        Args:
            waypoints: ``(W, n)``, at least two.

        Raises:
            ShapeError: For waypoints of another size, numbers that are none, or values beyond limits of joints.

        Example:
            >>> plan = motions.path([[1.5], [2.0], [3.0]])
            >>> plan.proven, plan.statement
            (True, 'Proven free: 2 motions of arm, among 1 obstacles, margin 0 m.')
        """
        given, name = np.array(waypoints, dtype=np.float64), self.arm.name
        if given.ndim != 2 or given.shape[1] != len(self.arm.free) or len(given) < 2:
            raise ShapeError(f"{name}: expected waypoints (W, {len(self.arm.free)}), at least 2, got {given.shape}")
        if not np.isfinite(given).all():
            raise ShapeError(f"{name}: waypoint {int(np.argwhere(~np.isfinite(given))[0, 0])} is not finite")
        within = self._configurations(given)
        if (beyond := np.argwhere(np.isnan(within))).size:
            at, column = beyond[0].tolist()
            joint, value = self.arm.joints[self.arm.free[column]], float(given[at, column])
            raise ShapeError(
                f"{name}: waypoint {at} has {joint.name} at {value}, limits {joint.lower} to {joint.upper}"
            )
        states, culprits, share = self._ask(True, within[:-1], within[1:])
        first = int(np.argmax(states != FREE))
        between = self._named(int(culprits[first]))
        if share[first] == 0.0:  # it starts so
            between = self.culprits(given[first : first + 1])[0] or between
        around = self.digest, name, len(self._given), between, self.attached, self.self_collision
        return Plan(given, share, self.margin, *around)

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers of the arm, the obstacles where they are, the pairs and the margin."""
        sha = hashlib.sha256(b"warp-bounding motions 1")
        self.arm.hash_into(sha, self.obstacles)
        for each in (self.pairs, self.margin):
            sha.update(np.asarray(each, dtype="<f8").tobytes() + b";")
        self.arm.hash_tree_into(sha)
        return sha.hexdigest()

    # --- Headers for C -----------------------------------------------------------------------------------------------

    def export(self, path, name: str | None = None) -> None:
        """Write a header for C99, C++11 and CUDA that answers single motions and configurations; see *In C++*.

        Args:
            path: As for ``Bounder.export``.
            name: As for ``Bounder.export``.

        Raises:
            BounderError: As ``Bounder.export`` does.
            FileFormatError: As ``Bounder.export`` does.
            ShapeError: As ``cell`` does.

        Example:
            >>> motions.export("panda.h")
            >>> "int panda_segment(const double q0[1], const double q1[1]" in open("panda.h").read()
            True
        """
        (whole, numbers), text, n = self.cell(), native_text("motions.h"), len(self.arm.free)
        limits = np.clip(self._limits, -LARGEST, LARGEST)  # numbers so large prove nothing anyway
        sizes = {"n": n, "halvings": self.halvings, "rounded": constant(ROUNDED)}
        own = private(text.MOTIONS + fill(text.HEADER, name="$name", **sizes))
        arrays = {"limits": limits.ravel(), "numbers": numbers}
        parts = [array(what, "double", map(constant, values.tolist())) for what, values in arrays.items()]
        among = ", ".join(body.name for body, _ in self._given) or "none"
        about = [
            f"Motions of {self.arm.name}{'' if self.self_collision else ', not checked against itself'}.",
            f"Obstacles: {among}. Carried: {', '.join(self.attached) or 'nothing'}. Margin: {self.margin:g} m.",
            f"SHA-256 of the arm, the obstacles, the pairs and the margin, `Motions.digest`: {self.digest}",
        ]
        write(path, name, about, [*parts, array("whole", "int", map(str, whole.tolist())), own])

    def cell(self) -> tuple[np.ndarray, np.ndarray]:
        """The arm and the obstacles where they are now, as functions of headers read them whose names end in ``_in``.

        Returns:
            Whole numbers, int32, and numbers, float64, both of one axis.

        Raises:
            ShapeError: For a closed scan: only Python tells that a body begins inside of it.

        Example:
            >>> whole, numbers = motions.cell()
            >>> whole.dtype, numbers.dtype
            (dtype('int32'), dtype('float64'))
        """
        for body, _ in self._given:
            if isinstance(body, Scan) and body.solid is not None:
                raise ShapeError(
                    f"{self.arm.name}: headers cannot tell the inside of {body.name}, a closed scan; expected bodies "
                    "or a distance field, or its surface alone, `dataclasses.replace(scan, solid=None)`"
                )
        whole, numbers = self._laid_out()
        return whole.numpy(), numbers.numpy()

    def _configurations(self, q) -> np.ndarray:
        q, n = np.ascontiguousarray(q, dtype=np.float64), len(self.arm.free)
        if q.ndim != 2 or q.shape[1] != n:
            raise ShapeError(f"{self.arm.name}: expected configurations (N, {n}), got {q.shape}")
        low, high = self._limits
        if ((q >= low) & (q <= high)).all():
            return q
        with np.errstate(invalid="ignore"):
            at = np.clip(q, low, high)  # what is moved by rounding is where it was, up to rounding
            return np.where(np.abs(q - at) <= ROUNDED * (np.abs(low) + np.abs(high)), at, np.nan)

    def _named(self, item: int) -> tuple[str, str] | None:
        own, around = self.arm.bodies, len(self._owners)
        if item < 0:
            return None
        if item < len(own) * around:
            return own[item // around].name, self._given[self._owners[item % around]][0].name
        return tuple(own[k].name for k in self.pairs[item - len(own) * around])

    def _ask(self, until: bool | None, *given: np.ndarray) -> list[np.ndarray]:
        """States, culprits and, of motions, shares; the launch for one is kept."""
        if self._arrays is None:
            self._arrays, self._kept = self._laid_out(), {}
        count = len(given[0])
        if (call := self._kept.get(until)) is None or count != 1:
            call = _Call(self._arrays, count, given[0].shape[1], until, self.halvings, self.device)
            if count == 1:
                self._kept[until] = call
        answers = call.ask(given)
        if any(isinstance(body, Scan) and body.solid is not None for body, _ in self._given):
            self._look_inside(given[0], answers)
        return answers

    def _look_inside(self, q: np.ndarray, answers: list[np.ndarray]) -> None:
        """Bodies that begin inside of a closed scan: what never crosses its surface stays there."""
        finite, own = np.isfinite(q).all(axis=1), [i for i, body in enumerate(self.arm.bodies) if body.link != WORLD]
        frames = self.arm.frames(np.where(finite[:, None], q, 0.0))
        for number, scan in enumerate(self.obstacles):
            if not isinstance(scan, Scan) or scan.solid is None:
                continue
            first = int(np.argmax(self._owners == number))
            for i in own:
                body = self.arm.bodies[i]
                pose, middle = frames[:, body.link], body.points.mean(axis=0)
                inside = finite & scan.holds(matmul(pose[:, :3, :3], middle[:, None])[..., 0] + pose[:, :3, 3])
                for answer, value in zip(answers, (COLLIDING, i * len(self._owners) + first, 0.0), strict=False):
                    answer[inside] = value

    # --- Arrays, as native/motions.h reads them ----------------------------------------------------------------------

    def _layout_of_arm(self) -> tuple[list[np.ndarray], list[np.ndarray], "_Laid", float]:
        """Whole numbers and numbers of the joints, the numbers of each body, and the size of the arm."""
        arm, (origins, moved) = self.arm, self.arm.moved
        paths = [arm.path(WORLD, k) for k in range(len(arm.bodies))]
        paths += [arm.path(arm.bodies[one].link, other) for one, other in self.pairs]
        whole = [
            np.array(arm.parents),
            np.array([joint.slides for joint in arm.joints]),
            arm.coordinate,
            np.cumsum([0, *map(len, paths)]),
            np.array([step[0] for path in paths for step in path]),
            self.pairs.ravel(),
        ]
        poses = [np.concatenate([origin[:3, :3].ravel(), origin[:3, 3]]) for origin in origins]
        numbers = [arm.factor, arm.offset, np.concatenate(poses), np.array([s[2] for path in paths for s in path])]
        bodies = _Laid.joined([_Laid.of(points, body.radius) for points, body in zip(moved, arm.bodies, strict=True)])
        limits = np.stack([arm.lower, arm.upper])[:, arm.coordinate] * arm.factor + arm.offset
        slides = sum(np.abs(ends).max() for joint, ends in zip(arm.joints, limits.T, strict=True) if joint.slides)
        size = slides + sum(np.abs(origin[:3, 3]).sum() for origin in origins) + bodies.size
        return whole, numbers, bodies, size

    def _laid_out(self) -> tuple[wp.array, wp.array]:
        (parent, slides, coordinate, first, path, pairs), (factor, offset, origin, reach), own, size = self._fixed
        around = _Laid.joined([_Laid.around(body) for body in self.obstacles])
        owners = np.repeat(np.arange(len(self._given)), [_count(body) for body, _ in self._given])
        shifts = np.array([self._velocities.get(body.name, (0.0, 0.0, 0.0)) for body, _ in self._given]).reshape(-1, 3)
        order, skip, group, boxes = _tree(around, shifts[owners])
        self._owners, around = owners[order], around.sorted(order)
        bodies, fixed = _Laid.joined([own, around]), np.zeros((len(own.half), 3))
        velocities = np.concatenate([fixed, shifts[self._owners]])
        size += self.margin + around.size + np.abs(velocities).sum(axis=1).max()
        links = [*(body.link for body in self.arm.bodies), *([WORLD] * len(order))]
        lanes = np.cumsum([0, *map(len, bodies.lanes)])
        whole = [parent, slides, coordinate, links, bodies.kind, lanes, first, path, pairs, skip, group]
        numbers = [factor, offset, origin, bodies.frame, bodies.half, bodies.radius, bodies.ball, velocities, reach]
        counts = [len(parent), len(self.arm.free), len(own.half), len(links), len(self.pairs), len(skip)]
        numbers = [np.ravel(each).astype(np.float64) for each in (*numbers, np.concatenate(bodies.lanes), boxes)]
        whole = [np.ravel(each).astype(np.int32) for each in whole]
        header = len(counts) + len(whole) + len(numbers)
        at = header + np.cumsum([0, *map(len, whole[:-1])])
        places = 2 + np.cumsum([0, *map(len, numbers[:-1])])
        constants = [self.margin, ALLOWANCE * size]
        return (
            wp.array(np.concatenate([counts, at, places, *whole]), dtype=wp.int32, device=self.device),
            wp.array(np.concatenate([constants, *numbers]), dtype=wp.float64, device=self.device),
        )


@dataclass(frozen=True, eq=False)
class Plan(Picklable):
    """What is proven of a plan; ``Motions.path`` makes one.

    Attributes:
        waypoints: ``(W, n)`` float64.
        shares: ``(W - 1,)``, of each motion the share from its start that is proven free; 1 where all of it is.
        margin: Metres.
        digest: Of the arm and what was around it, ``Motions.digest``.
        name: Of the arm.
        obstacles: How many there were.
        between: Names of the two bodies that are in the way first, if it is not proven.
        attached: What the arm carried: bodies by part, ``Motions.attached``.
        self_collision: Whether the arm was checked against itself.

    Example:
        >>> plan = motions.path([[1.5], [2.0]])
        >>> plan.save("plan.json")
        >>> wb.arms.Plan.load("plan.json").certify(motions).proven
        True
    """

    waypoints: np.ndarray
    shares: np.ndarray
    margin: float
    digest: str
    name: str = "arm"
    obstacles: int = 0
    between: tuple[str, str] | None = None
    attached: dict[str, list[Body]] | None = None
    self_collision: bool = True

    @property
    def proven(self) -> bool:
        """Whether all of it is."""
        return bool((np.asarray(self.shares) == 1.0).all())

    @property
    def end(self) -> tuple[int, float]:
        """Up to where it is proven: the number of a motion, and the share of that."""
        at = int(np.argmin(np.asarray(self.shares) == 1.0)) if not self.proven else len(self.shares) - 1
        return at, float(self.shares[at])

    @property
    def statement(self) -> str:
        """What is known, in a sentence."""
        names = [body.name for carried in (self.attached or {}).values() for body in carried]
        carrying = f" carrying {', '.join(names)}" if names else ""
        what = f"{len(self.shares)} motions of {self.name}{carrying}, among {self.obstacles} obstacles"
        what += f", margin {self.margin:g} m{'' if self.self_collision else ', not checked against itself'}"
        if self.proven:
            return f"Proven free: {what}."
        at, share = self.end
        return f"Proven up to {share:.3f} of motion {at}, where {' and '.join(self.between)} are too close: {what}."

    def save(self, path) -> None:
        """Write it as JSON; what is written is proven again by ``certify``."""
        document = {"plan": asdict(self) | {"waypoints": self.waypoints.tolist(), "shares": self.shares.tolist()}}
        document["plan"]["attached"] = {
            part: [{"points": body.points.tolist(), "radius": body.radius, "name": body.name} for body in carried]
            for part, carried in (self.attached or {}).items()
        }
        write_whole(path, json.dumps(document, indent=1).encode(), ".json")

    @classmethod
    def load(cls, path) -> "Plan":
        """Read what ``save`` wrote.

        Raises:
            FileFormatError: If it is something else.
        """
        try:
            fields = json.loads(Path(path).read_text(encoding="utf-8"))["plan"]
            fields["waypoints"], fields["shares"] = (
                np.array(fields["waypoints"], float),
                np.array(fields["shares"], float),
            )
            fields["between"] = fields["between"] and tuple(fields["between"])
            carried = fields.get("attached", {}).items()
            fields["attached"] = {part: [Body(**body) for body in bodies] for part, bodies in carried}
            plan = cls(**fields)
        except (ValueError, KeyError, TypeError, AttributeError, UnicodeDecodeError, ShapeError) as error:
            raise FileFormatError(f"{path}: expected a plan that Plan.save wrote") from error
        if plan.waypoints.ndim != 2 or plan.shares.shape != (len(plan.waypoints) - 1,):
            raise FileFormatError(f"{path}: expected waypoints (W, n) and a share for each motion between them")
        return plan

    def certify(self, motions: Motions) -> "Plan":
        """Prove it again, of the arm and obstacles given here.

        Raises:
            ShapeError: If they are others than those of the plan, or stand elsewhere.
        """
        if (digest := motions.digest) != self.digest:
            raise ShapeError(f"{self.name}: a plan among other things, of digest {self.digest[:12]}, got {digest[:12]}")
        return motions.path(self.waypoints)


def _count(body: Obstacle) -> int:
    """The number of convex parts of an obstacle."""
    return len(body.corners) if isinstance(body, Scan) else 1


class _Call:
    """A recorded launch and its memory: for ``count`` configurations or motions of n coordinates."""

    def __init__(self, arrays, count: int, n: int, until: bool | None, halvings: int, device: wp.Device):
        of_motions = until is not None
        self._given = [wp.empty((count, n), dtype=wp.float64, device=device) for _ in range(1 + of_motions)]
        kinds = [wp.int32, wp.int32] + [wp.float64] * of_motions
        self._answers = [wp.empty(count, dtype=kind, device=device) for kind in kinds]
        if device.is_cpu:  # the same memory, once and for all
            self._here, self._read = ([x.numpy() for x in part] for part in (self._given, self._answers))
        inputs = [*arrays, *(x.flatten() for x in self._given)] + [halvings, int(bool(until))] * of_motions
        kernel = _kernels().segments if of_motions else _kernels().configurations
        self._launch = BlockLaunch(kernel, count, [0, *inputs], self._answers, device, first_index=0, block=1)
        self._cpu = device.is_cpu

    def ask(self, given: Sequence[np.ndarray]) -> list[np.ndarray]:
        """States and culprits ``(N,)`` int32, and shares ``(N,)`` float64 of motions."""
        for number, values in enumerate(given):
            if self._cpu:
                self._here[number][:] = values
            else:
                self._given[number].assign(values)
        self._launch.launch()
        return [x.copy() for x in self._read] if self._cpu else [x.numpy() for x in self._answers]


@dataclass(frozen=True)
class _Laid:
    """K bodies as the kernels read them.

    Attributes:
        frame: ``(K, 12)``, of boxes or cylinders around them: rotation by rows, then place.
        half: ``(K, 3)``, half the sides; of a cylinder its radius twice and half its length.
        radius: ``(K,)``.
        ball: ``(K, 4)``, centre and radius.
        lanes: Of each the corners in groups of eight, or the numbers of a field.
        kind: ``(K,)``: ``HULL``, ``CYLINDER`` or ``FIELD``.
        size: The largest sum of coordinates and radius.
    """

    frame: np.ndarray
    half: np.ndarray
    radius: np.ndarray
    ball: np.ndarray
    lanes: list[np.ndarray]
    kind: np.ndarray
    size: float
    _ARRAYS: ClassVar = ("frame", "half", "radius", "ball", "kind")

    @classmethod
    def joined(cls, parts: "Sequence[_Laid]") -> "_Laid":
        """All of them, one behind the other."""
        parts = [cls._none(), *parts]
        arrays = (np.concatenate([getattr(part, name) for part in parts]) for name in cls._ARRAYS)
        found = dict(zip(cls._ARRAYS, arrays, strict=True))
        lanes = [each for part in parts for each in part.lanes]
        return cls(**found, lanes=lanes, size=max(part.size for part in parts))

    @classmethod
    def _none(cls) -> "_Laid":
        shapes = ((0, 12), (0, 3), (0,), (0, 4))
        return cls(*map(np.empty, shapes), lanes=[], kind=np.empty(0, dtype=int), size=0.0)

    def sorted(self, order: np.ndarray) -> "_Laid":
        """In another order."""
        arrays = {name: getattr(self, name)[order] for name in self._ARRAYS}
        return replace(self, **arrays, lanes=[self.lanes[k] for k in order])

    @classmethod
    def around(cls, body: Obstacle) -> "_Laid":
        """Lays an obstacle out."""
        if isinstance(body, Body):
            return cls.of(body.points, body.radius)
        if isinstance(body, Scan):
            return cls.of_many(body.placed, body.radius)
        if isinstance(body, DistanceField):
            half, place, kind, lanes = body.half, moved(body.center[None], body.pose)[0], FIELD, body.lanes
        else:
            half, place = np.array([body.radius, body.radius, body.length / 2]), body.pose[:3, 3]
            kind, lanes = CYLINDER, np.empty(0)
        frame, ball = np.append(body.pose[:3, :3], place), np.append(place, lengths(half) * OUTWARD)
        size = float(np.abs(place).sum() + half.sum())
        return cls(frame[None], half[None], np.zeros(1), ball[None], [lanes], np.array([kind]), size)

    @classmethod
    def of(cls, points: np.ndarray, radius: float) -> "_Laid":
        """Lays out a rounded hull of points ``(P, 3)``."""
        frame, half = _box_around(points)
        center = _center_of(points)
        ball = np.append(center, lengths(points - center).max() * OUTWARD)
        size = float(np.abs(points).sum(axis=1).max() + radius)
        return cls(
            frame[None],
            half[None],
            np.array([radius]),
            ball[None],
            list(_in_lanes(points[None])),
            np.array([HULL]),
            size,
        )

    @classmethod
    def of_many(cls, corners: np.ndarray, radius: float) -> "_Laid":
        """Lays out K hulls of P points each, ``(K, P, 3)``; their boxes have the world's axes."""
        low, high, count = corners.min(axis=1), corners.max(axis=1), len(corners)
        center, half = (low + high) / 2, (high - low) / 2 * OUTWARD
        frame = np.concatenate([np.tile(np.eye(3).ravel(), (count, 1)), center], axis=1)
        ball = np.concatenate([center, lengths(half)[:, None] * OUTWARD], axis=1)
        size = float(np.abs(corners).sum(axis=2).max() + radius)
        return cls(frame, half, np.full(count, radius), ball, list(_in_lanes(corners)), np.full(count, HULL), size)


def _in_lanes(corners: np.ndarray) -> np.ndarray:
    """``(K, L)``: of K hulls ``(K, P, 3)`` x, y and z of eight corners, one behind another; the first fills up."""
    count = -(-corners.shape[1] // LANES) * LANES
    first = np.broadcast_to(corners[:, :1], (len(corners), count - corners.shape[1], 3))
    padded = np.concatenate([corners, first], axis=1).reshape(len(corners), -1, LANES, 3)
    return padded.transpose(0, 1, 3, 2).reshape(len(corners), -1)


def _tree(bodies: _Laid, shifts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A tree of boxes over obstacles that move by ``(K, 3)``, in groups of eight neighbours.

    Returns:
        The order of the obstacles, and of each node, depth first, which one follows after all below it, the number of
        its group or -1, and its box ``(6,)``.
    """
    center, turn = bodies.frame[:, 9:], bodies.frame[:, :9].reshape(-1, 3, 3)
    half = (np.abs(turn) * bodies.half[:, None]).sum(axis=2) + bodies.radius[:, None]
    half *= OUTWARD
    low, high = center - half + np.minimum(shifts, 0), center + half + np.maximum(shifts, 0)
    count = max(1, -(-len(center) // LANES))
    depth = max(0, (count - 1).bit_length())
    order = _along_a_curve((low + high) / 2)
    boxes = np.full((LANES << depth, 6), np.inf)
    boxes[: len(order)] = np.concatenate([low[order], -high[order]], axis=1)
    level = boxes.reshape(-1, LANES, 6).min(axis=1)
    nodes, places = (2 << depth) - 1, np.zeros(1, dtype=np.int64)
    skip, group, found = np.empty(nodes, np.int32), np.full(nodes, -1, np.int32), np.empty((nodes, 6))
    levels = [level]
    for _ in range(depth):
        levels.append(levels[-1].reshape(-1, 2, 6).min(axis=1))
    for above, boxes in enumerate(reversed(levels)):
        below = (2 << (depth - above)) - 1  # a node and all below it
        skip[places], found[places] = places + below, boxes
        if above == depth:
            group[places] = np.arange(len(places))
        else:
            places = (places[:, None] + [1, 1 + below // 2]).ravel()
    found[:, 3:] *= -1
    return order, skip, group, found


def _along_a_curve(points: np.ndarray) -> np.ndarray:
    """The order of points ``(K, 3)`` by Morton's codes of 16 bits."""
    if not len(points):
        return np.empty(0, dtype=np.int64)
    low = points.min(axis=0)
    cells = ((points - low) / max(float((points - low).max()), 1e-300) * 65535).astype(np.int64)
    bits = np.arange(16)
    codes = ((cells[:, :, None] >> bits & 1) << (3 * bits + np.arange(3)[:, None])).sum(axis=(1, 2))
    return np.argsort(codes, kind="stable")


def _center_of(points: np.ndarray) -> np.ndarray:
    """The centre of a small ball that holds points ``(P, 3)``, a point of their hull (Badoiu and Clarkson 2003)."""
    center = best = points.mean(axis=0)
    least = lengths(points - center).max()
    for step in range(2, 100):
        center = center + (points[lengths(points - center).argmax()] - center) / step
        if (radius := lengths(points - center).max()) < least:
            best, least = center, radius
    return best


def _box_around(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frame, twelve numbers, of a small box around points ``(P, 3)``, and half its sides.

    The axes are the world's, the points' principal ones, or edges at the first point, as a box has them.
    """
    candidates = [np.eye(3), principal_axes(points)]
    if len(points) == 8:
        edges = points[[4, 2, 1]] - points[0]
        if (size := lengths(edges)).all() and np.abs(
            matmul(edges, edges.T) - np.diag(size**2)
        ).max() < 1e-9 * size.max() ** 2:
            candidates.append(edges / size[:, None])
    best = None
    for axes in candidates:
        axes = np.stack([axes[0], axes[1], np.cross(axes[0], axes[1])])
        x = matmul(points, axes.T)
        low, high = x.min(axis=0), x.max(axis=0)
        half = (high - low) / 2 * OUTWARD
        cost = half[0] * half[1] + half[1] * half[2] + half[2] * half[0] + 1e-9 * half.sum()
        if best is None or cost < best[0] * (1 - 1e-9):
            center = matmul(axes.T, ((low + high) / 2)[:, None])[:, 0]
            best = cost, np.concatenate([axes.T.ravel(), center]), half
    return best[1], best[2]


def _solid(given: Sequence[Body | Cylinder] | Body | Cylinder, name: str) -> list[Body]:
    """What is attached to a part of an arm, as bodies."""
    return [body.prism if isinstance(body, Cylinder) else body for body in all_of(Body | Cylinder, given, name)]


def _carrying(arm: Arm, attached: Mapping[str, list[Body]]) -> Arm:
    """The arm with more bodies on its parts."""
    bodies, touching = [], set(arm.touching)
    for part, given in attached.items():
        link = next((body.link for body in arm.bodies if body.part == part), None)
        if link is None:
            known = ", ".join(dict.fromkeys(body.part for body in arm.bodies))
            raise ShapeError(f"{arm.name}: expected a part that carries what is attached, of {known}, got {part}")
        for body in given:
            bodies.append(replace(body, link=link, part=f"{body.name} on {part}"))
            touching.add(tuple(sorted((bodies[-1].part, part))))
            touching |= {
                tuple(sorted((bodies[-1].part, other)))
                for pair in arm.touching
                if part in pair
                for other in pair
                if other != part
            }
    return arm.with_bodies(bodies, touching) if bodies else arm


class _Kernels(NamedTuple):
    segments: wp.Kernel
    configurations: wp.Kernel


@cache
def _kernels() -> _Kernels:
    """The kernels that answer motions and configurations."""
    text = f"struct Text {{{native_text('motions.h').MOTIONS}}};\n"
    text += "const auto c = Text::cell_of(whole.data, numbers.data);\n"
    text += "const long long at = c.coordinates * (long long)block;\n"
    answers = "states.data + block, culprits.data + block"

    @named("arm_motions").block_kernel(
        f"{text}shares.data[block] = Text::segment(&c, q0.data + at, q1.data + at, deepest, until, {answers});", ""
    )
    def segments(
        block: int,
        # inputs
        whole: wp.array(dtype=wp.int32),
        numbers: wp.array(dtype=wp.float64),
        q0: wp.array(dtype=wp.float64),
        q1: wp.array(dtype=wp.float64),
        deepest: int,
        until: int,
        # outputs
        states: wp.array(dtype=wp.int32),
        culprits: wp.array(dtype=wp.int32),
        shares: wp.array(dtype=wp.float64),
    ): ...

    @named("arm_configurations").block_kernel(
        f"{text}states.data[block] = Text::configuration(&c, q.data + at, culprits.data + block);", ""
    )
    def configurations(
        block: int,
        # inputs
        whole: wp.array(dtype=wp.int32),
        numbers: wp.array(dtype=wp.float64),
        q: wp.array(dtype=wp.float64),
        # outputs
        states: wp.array(dtype=wp.int32),
        culprits: wp.array(dtype=wp.int32),
    ): ...

    return _Kernels(segments, configurations)
