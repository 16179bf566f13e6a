"""The configurations in which an arm collides, as a shape of as many coordinates as it has joints.

Everything that a shape answers comes from float64 kernels (``kernels``): truth, certified boxes and
half-spaces. Configurations beyond the joints' limits are not in the shape, as nothing is known of them: bounders answer
*maybe* there (``shapes.joints``). The limits are rounded outwards to float32, so that a query at a limit is asked
about, and the shape reaches beyond them by what float32 rounds. Of a continuous joint q and q + 2 pi k are the same.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.arms.arm import WORLD, Arm, Body, Joint, all_of, ball_of
from warp_bounding.arms.kernels import ALLOWANCE, BLUR, FREE, FULL, HALVES, Bodies, Chain, Collisions, kernels_of
from warp_bounding.errors import ShapeError, warn
from warp_bounding.rigid import TWO_PI, lengths, matmul, moved, ring, sine_cosine
from warp_bounding.rounding import round_down, round_up
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.shapes.formula import Formula
from warp_bounding.shapes.joints import BEYOND, WIDER, Joints, turned_back
from warp_bounding.shapes.shape import UNDECIDED, HalfSpaces, Shape, checked_margin, checked_number

MOST_JOINTS = 16  # ``kernels.ALLOWANCE`` counts on it
OUTWARD = 1 + 2.0**-40  # outweighs what sums of a few products round, relative to their size
LEAST_WEIGHT = 2.0**-20  # and the largest one over it: limits are normal float32 numbers then
DEVICE = "cpu"
ROUND = 24  # corners of a solid of revolution
LANES = 8  # of native/hulls.h
SAMPLES, OFTEN = 256, 0.95  # random configurations; an arm that touches itself in more than this share is reported


class ArmConfigurations(Formula):
    """All configurations in which an arm touches an obstacle, or itself.

    A configuration q, joint values in radians (metres of a joint that slides), has the coordinates ``weights * q``.
    Beyond the limits nothing is in the shape, and every bounder answers *maybe*; continuous joints have no limits, and
    ``weights * 2 pi`` is one turn. With the weights of ``Arm.reaching`` one unit moves the arm by a metre at most.

    Args:
        arm: The arm.
        obstacles: Bodies that do not move; or one.
        self_collision: Whether links may not touch each other and the base either (``Arm.touching`` and
            ``Arm.neighbours`` say which). Where they do in ``OFTEN`` of random configurations, a warning names them.
        safety: Metres: what comes closer counts as touching.
        weights: ``(n,)``, above 0; 1 for ``None``.
        name: For people.

    Attributes:
        arm: The arm.
        obstacles: The obstacles.
        weights: ``(n,)`` float64.
        safety: Metres.
        self_collision: Whether the arm is checked against itself.
        pairs: ``(P, 2)``, pairs of bodies that are checked: numbers of the arm's, and behind these of the obstacles.
        columns: ``(n,)`` int: the shape's coordinates are these values of a configuration of the whole robot; all of
            them, except for ``Arm.self_collision``.

    Raises:
        ShapeError: For obstacles that move or are no bodies, numbers that are none, or nothing that could touch.

    Example:
        >>> arm = wb.arms.Arm([wb.arms.Joint()], [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=0)])
        >>> shape = wb.arms.ArmConfigurations(arm, [wb.arms.Body.sphere([0.5, 0, 0], 0.1)])
        >>> shape.contains(np.array([[0.0], [1.0]]))  # pointing at the ball, and away from it
        array([ True, False])
        >>> wb.fit(shape, method="aabb", device="cpu").certificate.proven
        True
    """

    def __init__(
        self,
        arm: Arm,
        obstacles: Sequence[Body] | Body = (),
        *,
        self_collision: bool = True,
        safety: float = 0.0,
        weights=None,
        name: str = "arm",
    ):
        if not isinstance(arm, Arm):
            raise ShapeError(f"{name}: expected an Arm, got {type(arm).__name__}; wb.arms.load_urdf reads files")
        if len(arm.joints) > MOST_JOINTS:
            raise ShapeError(
                f"{name}: expected at most {MOST_JOINTS} joints that move, got {len(arm.joints)}; hold others by held= "
                "of load_urdf, or ask Motions, which takes more"
            )
        self.arm, self.obstacles, self.name, self.note = arm, all_of(Body, obstacles, name), name, arm.note
        self._lay_out(safety, self_collision, weights)
        self._warn_if_it_touches_itself()

    def _lay_out(self, safety: float, self_collision: bool, weights, pairs: np.ndarray | None = None) -> None:
        arm, name = self.arm, self.name
        if not isinstance(self_collision, bool | np.bool_):
            raise ShapeError(f"{name}: expected self_collision to be True or False, got {self_collision!r}")
        self.columns = np.arange(len(arm.free))
        self.safety, self.self_collision = checked_margin(safety), bool(self_collision)
        for body in self.obstacles:
            if body.link != WORLD:
                raise ShapeError(f"{name}: {body.name} is an obstacle, and it is of link {body.link}")
        weights = np.ones(len(arm.free)) if weights is None else np.array(weights, dtype=np.float64)
        if weights.shape != (len(arm.free),):
            raise ShapeError(f"{name}: expected a weight for each of {len(arm.free)} joints, got {weights}")
        self.weights = np.array([checked_number(weight, "a weight", name) for weight in weights])
        if not ((self.weights >= LEAST_WEIGHT) & (self.weights <= 1 / LEAST_WEIGHT)).all():
            raise ShapeError(f"{name}: expected weights from 2^-20 to 2^20, got {weights}")
        self.weights.setflags(write=False)
        self.pairs = self._paired() if pairs is None else np.array(pairs, dtype=np.int32)
        self.pairs.setflags(write=False)
        if not len(self.pairs):
            raise ShapeError(
                f"{name}: there is nothing that could touch; give obstacles, or ask for collisions with itself"
            )

    def _paired(self) -> np.ndarray:
        """Pairs of bodies ``(P, 2)`` that are checked: numbers of the arm's, and behind these of the obstacles."""
        own, obstacles = self.arm.bodies, range(len(self.obstacles))
        found = [(len(own) + k, i) for i, body in enumerate(own) if body.link != WORLD for k in obstacles]
        around = np.array(found, dtype=np.int32).reshape(-1, 2)
        return np.concatenate([around, self.arm.pairs()]) if self.self_collision else around

    @property
    def _own(self) -> np.ndarray:
        """The pairs ``(P, 2)`` of bodies of the arm."""
        return self.pairs[(self.pairs < len(self.arm.bodies)).all(axis=1)]

    @property
    def remark(self) -> str:
        """What is checked against what."""
        own = len(self._own)
        around = f"{len(self.pairs) - own} with obstacles, " if self.obstacles else ""
        itself = f"{own} of the arm itself" if self.self_collision else "the arm is NOT checked against itself"
        without = ", without neighbours" if self.self_collision and not self.arm.neighbours else ""
        return f"pairs of bodies checked: {around}{itself}{without}"

    def _shares(self, pairs: np.ndarray, q: np.ndarray) -> np.ndarray:
        """For each pair of bodies of the arm, in which share of configurations ``(N, n)`` they touch."""
        return np.array([self._with(self.arm, [pair]).contains(q).mean() for pair in pairs])

    def _warn_if_it_touches_itself(self) -> None:
        if not len(own := self._own):
            return
        q = np.random.default_rng(0).uniform(self.arm.lower, self.arm.upper, (SAMPLES, self.ndim))
        if (share := self._with(self.arm, own).contains(q).mean()) < OFTEN:
            return
        shares, parts = self._shares(own, q), [body.part for body in self.arm.bodies]
        most = own[shares >= min(OFTEN, shares.max())]
        named = ", ".join(dict.fromkeys(f"{parts[a]} and {parts[b]}" for a, b in most))
        warn(
            f"{self.name}: it touches itself in {share:.0%} of {SAMPLES} random configurations, most of all {named}; "
            "leave out pairs that always touch, by touching= of Arm or srdf= of load_urdf"
        )

    # --- where it is -------------------------------------------------------------------------------------------------

    @property
    def ndim(self) -> int:
        return len(self.arm.free)

    @property
    def lower(self) -> np.ndarray:
        """See ``Shape``; of a continuous joint a little more than one turn."""
        return round_down(self.arm.lower * self.weights * np.where(self._turns, WIDER, 1.0)).astype(np.float64)

    @property
    def upper(self) -> np.ndarray:
        """See ``lower``."""
        return round_up(self.arm.upper * self.weights * np.where(self._turns, WIDER, 1.0)).astype(np.float64)

    @property
    def _padding(self) -> np.ndarray:
        return np.zeros(self.ndim)  # beyond the limits nothing is known

    @property
    def _turns(self) -> np.ndarray:
        return np.array([self.arm.joints[i].continuous for i in self.arm.free])

    @cached_property
    def _periods(self) -> list[Fraction]:
        return [TWO_PI * Fraction(each) * int(turns) for each, turns in zip(self.weights, self._turns, strict=True)]

    @cached_property
    def joints(self) -> Joints:
        return Joints.of(self.lower, self.upper, np.array(self._periods, dtype=np.float64))

    @cached_property
    def known(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Shape``: what float32 rounds to a limit counts."""
        beyond = BEYOND * np.maximum(np.abs(self.lower), np.abs(self.upper))
        return tuple(
            np.where(self._turns, np.copysign(np.inf, side), end + side * beyond)
            for side, end in ((-1, self.lower), (1, self.upper))
        )

    @property
    def waves(self) -> np.ndarray | None:
        """The angles of ``Arm.angles``, ``None`` where nothing turns.

        A network whose first hidden layer has twice as many neurons begins with their sines and cosines.
        """
        angles = self.arm.angles
        return angles / self.weights if len(angles) else None

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of all numbers of joints, bodies, obstacles, pairs, weights and the safety; names do not enter."""
        sha = hashlib.sha256(b"warp-bounding arm 1")
        self.arm.hash_into(sha, self.obstacles)
        for array in (self.pairs, self.weights, self.safety):
            sha.update(np.asarray(array, dtype="<f8").tobytes() + b";")
        self.arm.hash_tree_into(sha)
        return sha.hexdigest()

    # --- what it is --------------------------------------------------------------------------------------------------

    @cached_property
    def _collisions(self) -> Collisions:
        origins, moved = self.arm.moved
        bodies = (*self.arm.bodies, *self.obstacles)
        points = (*moved, *(body.points for body in self.obstacles))
        arm, links = self.arm, [body.link for body in bodies]
        most = np.where(self._turns, 0.0, np.maximum(*map(np.abs, self.known))) / self.weights * OUTWARD
        largest = (most[arm.coordinate] * np.abs(arm.factor) + np.abs(arm.offset)) * OUTWARD
        found = Collisions()
        found.chain, found.bodies = Chain(), Bodies()
        balls = [ball_of(each) for each in points]
        chain = {
            "parent": (arm.parents, wp.int32),
            "turn": ([origin[:3, :3] for origin in origins], wp.mat33d),
            "at": ([origin[:3, 3] for origin in origins], wp.vec3d),
            "slides": ([int(joint.slides) for joint in arm.joints], wp.int32),
            "coordinate": (arm.coordinate, wp.int32),
            "factor": (arm.factor, wp.float64),
            "offset": (arm.offset, wp.float64),
        }
        hulls = {
            "points": (np.concatenate(points), wp.vec3d),
            "first": (np.cumsum([0, *map(len, points)]), wp.int32),
            "lanes": (np.concatenate([_in_lanes(each) for each in points]), wp.float64),
            "block": (np.cumsum([0, *(3 * LANES * -(-len(each) // LANES) for each in points)]), wp.int32),
            "link": (links, wp.int32),
            "radius": ([body.radius for body in bodies], wp.float64),
            "center": ([center for center, _ in balls], wp.vec3d),
            "ball": ([radius * OUTWARD for _, radius in balls], wp.float64),
            "low": ([each.min(axis=0) for each in points], wp.vec3d),
            "high": ([each.max(axis=0) for each in points], wp.vec3d),
        }
        paths = [arm.path(links[one], other, largest) for one, other in self.pairs]
        path, sign, reach = (
            np.array(column) for column in zip(*(step for each in paths for step in each), strict=True)
        )
        first = np.cumsum([0, *map(len, paths)])
        own = {
            "pairs": (self.pairs, wp.vec2i),
            "first": (first, wp.int32),
            "path": (path, wp.int32),
            "sign": (sign, wp.float64),
            "reach": (reach, wp.float64),
        }
        for group, arrays in ((found.chain, chain), (found.bodies, hulls), (found, own)):
            for field, (values, dtype) in arrays.items():
                setattr(group, field, wp.array(np.asarray(values), dtype=dtype, device=DEVICE))
        found.weights = wp.array(self.weights, dtype=wp.float64, device=DEVICE)
        found.lower, found.upper = (wp.array(end, dtype=wp.float64, device=DEVICE) for end in self.known)
        found.safety = self.safety
        far = max(np.abs(body.points).sum(axis=1).max() + body.radius for body in bodies) * 2 + self.safety
        slides = sum(far for joint, far in zip(arm.joints, largest, strict=True) if joint.slides)
        found.allowance = ALLOWANCE * (far + slides + sum(np.abs(origin[:3, 3]).sum() for origin in origins))
        return found

    def decide(self, x: np.ndarray) -> np.ndarray:
        given = np.asarray(x, dtype=np.float64)
        x = turned_back(given, self._periods)
        answers = wp.empty(len(x), dtype=wp.uint8, device=DEVICE)
        kernel = kernels_of(len(self.arm.joints), self.ndim).points
        launch_on_cores(kernel, len(x), [self._collisions, self._array(x)], [answers], DEVICE)
        lost = np.isnan(x).any(axis=1) & np.isfinite(given).all(axis=1)  # more turns than float64 distinguishes
        return np.where(lost, np.uint8(UNDECIDED), answers.numpy())

    def _array(self, x: np.ndarray) -> wp.array:
        dtype = wp.types.vector(length=self.ndim, dtype=wp.float64)
        x = np.ascontiguousarray(x, dtype=np.float64)
        return wp.array(x, dtype=dtype, shape=(len(x),), device=DEVICE, copy=False)

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        (lower, upper), apart, _ = self._within(lower, upper)
        return apart | (self._query_boxes(lower, upper, FREE)[0] == FREE)

    def _within(
        self, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
        """The parts of boxes within what is known, which boxes have none, and which were turned back by whole turns.

        What is no box stays as it is.
        """
        lower, upper = np.array(lower, dtype=np.float64), np.array(upper, dtype=np.float64)
        real = (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
        away = self._turns & (np.abs(lower / 2 + upper / 2) > self.upper)  # never so where a proof asks
        if away.any():
            center = lower / 2 + upper / 2
            with np.errstate(invalid="ignore", over="ignore"):
                by = turned_back(center, self._periods) - center
                room = BLUR * (np.abs(lower) + np.abs(upper))  # of these sums
                lower, upper = np.where(away, lower + by - room, lower), np.where(away, upper + by + room, upper)
        first, last = self.known
        apart = real & ((lower > last) | (upper < first)).any(axis=1)
        clipped = real & ~apart
        low, high = (np.where(clipped[:, None], np.clip(x, first, last), x) for x in (lower, upper))
        return (low, high), apart, away.any(axis=1)

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        (low, high), _, _ = self._within(lower, upper)
        held = ((low <= lower) & (high >= upper) | self._turns).all(axis=1)  # nothing was cut off
        return held & (self._query_boxes(low, high, FULL)[0] == FULL)

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        (lower, upper), apart, away = self._within(lower, upper)
        answers, level, slope, axis, loss = self._query_boxes(lower, upper, HALVES)
        center = lower * 0.5 + upper * 0.5
        if away.any():  # these half-spaces are of another turn
            level, loss = np.where(away, 1.0, level), np.where(away, 0.0, loss)
            slope = np.where(away[:, None], 0.0, slope)
        return HalfSpaces(apart | (answers == FREE), center, level, slope, axis, loss)

    def _query_boxes(self, lower: np.ndarray, upper: np.ndarray, asked: int) -> tuple[np.ndarray, ...]:
        count = len(lower)
        size = count if asked == HALVES else 0
        vector = wp.types.vector(length=self.ndim, dtype=wp.float64)
        outputs = [
            wp.empty(count, dtype=wp.uint8, device=DEVICE),
            *(wp.empty(size, dtype=dtype, device=DEVICE) for dtype in (wp.float64, vector, wp.int32, wp.float64)),
        ]
        inputs = [self._collisions, self._array(lower), self._array(upper), asked]
        launch_on_cores(kernels_of(len(self.arm.joints), self.ndim).boxes, count, inputs, outputs, DEVICE)
        return tuple(output.numpy() for output in outputs)

    # --- what can be made of it --------------------------------------------------------------------------------------

    @classmethod
    def of_itself(
        cls,
        arm: Arm,
        *,
        safety: float,
        revolved: Sequence[str],
        only: Sequence[tuple[str, str]] | None,
        without: Sequence[tuple[str, str]],
        samples: int,
    ) -> "ArmConfigurations":
        """See ``Arm.self_collision``."""
        arm = arm.endless()
        whole, notes = cls._of(arm, safety), [arm.note] * bool(arm.note)
        chosen = _chosen(whole, only, without)
        for word, given in (("only", only), ("not", without)):
            if given:
                notes.append(f"pairs of parts: {word} {', '.join(' and '.join(pair) for pair in given)}")
        rng, pairs = np.random.default_rng(0), chosen
        for count in (64, samples):  # most pairs are apart in one of the first
            q = rng.uniform(arm.lower, arm.upper, (count, whole.ndim))
            always = whole._shares(pairs, q) == 1
            if count < samples:
                pairs = pairs[always]
        if len(always) and always.any():
            names = dict.fromkeys(" and ".join(arm.bodies[k].part for k in pair) for pair in pairs[always])
            notes.append(f"not checked, as they touch in all of {samples:,} random configurations: {', '.join(names)}")
        touching = {tuple(pair) for pair in pairs[always]} if len(always) else set()
        pairs = np.array([pair for pair in chosen if tuple(pair) not in touching]).reshape(-1, 2)
        if not len(pairs):
            raise ShapeError(f"{arm.name}: no two parts could touch; {'; '.join(notes)}")
        bodies, paths, rounded = list(arm.bodies), [arm.path(arm.bodies[a].link, b) for a, b in pairs], {}
        if strange := sorted(set(revolved) - {body.part for body in arm.bodies}):
            raise ShapeError(f"{arm.name}: expected names of its parts to revolve, got {', '.join(strange)}")
        for joint in range(len(arm.joints)):
            ends = _ends(joint, pairs, paths)
            turns = not arm.joints[joint].slides and (arm.coordinate == arm.coordinate[joint]).sum() == 1
            allowed = {k for k, body in enumerate(bodies) if body.part in revolved} - rounded.keys()
            if not turns or not ends or not ends <= allowed:
                continue
            for k in ends:
                bodies[k] = _revolved(bodies[k], arm.joints[joint], bodies[k].link == joint)
            rounded |= dict.fromkeys(ends, joint)
        if rounded:
            notes.append(
                f"solids of revolution in place of {', '.join(dict.fromkeys(bodies[k].part for k in rounded))}"
            )
        needed = {i for path in paths for i, *_ in path} - set(rounded.values())
        kept = sorted({int(arm.coordinate[i]) for i in needed})
        gone = [i for i in range(len(arm.joints)) if arm.coordinate[i] not in kept]
        round_arm = Arm(arm.joints, bodies, parents=arm.parents, mimics=arm.mimics, name=arm.name)
        found = whole._with(round_arm._held(gone), pairs)
        found.columns, found.note = np.array(kept), "; ".join(notes)
        return found

    def _with(self, arm: Arm, pairs) -> "ArmConfigurations":
        """These pairs of bodies of an arm."""
        return self._of(arm, self.safety, pairs, self.name)

    @classmethod
    def _of(cls, arm: Arm, safety: float, pairs=None, name: str = "arm") -> "ArmConfigurations":
        """Collisions of an arm with itself, of these pairs of bodies or of all."""
        found = object.__new__(cls)
        found.arm, found.obstacles, found.name, found.note = arm, (), name, arm.note
        found._lay_out(safety, True, None, pairs)
        return found

    def dilated(self, margin: float) -> Shape:
        """Itself for 0.

        Raises:
            ShapeError: For any other margin: bodies are dilated by ``safety``, in metres.
        """
        if self._new_margin(margin) is not None:
            raise ShapeError(
                f"{self.name}: an arm's configurations have no margin, got margin={margin}; give a safety distance, "
                "in metres, to ArmConfigurations"
            )
        return self


def _chosen(
    whole: ArmConfigurations, only: Sequence[tuple[str, str]] | None, without: Sequence[tuple[str, str]]
) -> np.ndarray:
    """The pairs ``(P, 2)`` of an arm that are to be checked; arguments as in ``Arm.self_collision``."""
    of_parts = [frozenset(whole.arm.bodies[k].part for k in pair) for pair in whole.pairs]
    wanted, unwanted = ({frozenset(pair) for pair in given or ()} for given in (only, without))
    if strange := (wanted | unwanted).difference(of_parts):
        pairs = ", ".join(sorted(" and ".join(sorted(pair)) for pair in strange))
        raise ShapeError(f"{whole.arm.name}: expected pairs of parts that are checked, got {pairs}")
    kept = [(only is None or parts in wanted) and parts not in unwanted for parts in of_parts]
    return whole.pairs[np.array(kept, dtype=bool)]


def _in_lanes(points: np.ndarray) -> np.ndarray:
    """Corners ``(P, 3)`` as native/hulls.h reads them."""
    count = -(-len(points) // LANES) * LANES
    padded = np.concatenate([points, np.broadcast_to(points[:1], (count - len(points), 3))])
    return padded.reshape(-1, LANES, 3).transpose(0, 2, 1).ravel()


def _ends(joint: int, pairs: np.ndarray, paths: list) -> set[int]:
    """The bodies next to a joint that is the first or last of each path with it; none if it is inside a path."""
    found = set()
    for (one, other), path in zip(pairs.tolist(), paths, strict=True):
        joints = [i for i, *_ in path]
        if joint == joints[-1]:
            found.add(other)
        elif joint == joints[0]:
            found.add(one)
        elif joint in joints:
            return set()
    return found


def _revolved(body: Body, joint: Joint, behind: bool) -> Body:
    """A solid of revolution about a joint that holds a body of the joint's link, or of the link that carries it."""
    frame = np.eye(4) if behind else joint.origin.copy()
    frame[:3, :3] = matmul(frame[:3, :3], joint.turned)
    x = matmul(body.points - frame[:3, 3], frame[:3, :3])
    around = lengths(x[:, :2]) / sine_cosine(np.pi / ROUND)[1] * OUTWARD
    circles = np.pad(ring(ROUND), [(0, 0), (0, 1)])
    x = (around[:, None, None] * circles + x[:, None, 2:] * [0, 0, 1]).reshape(-1, 3)
    hull = Body.hull(moved(x, frame), link=body.link, name=body.name)
    return replace(hull, radius=hull.radius + body.radius, part=body.part)
