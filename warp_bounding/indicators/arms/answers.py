"""What the colliding configurations of an arm answer, in float64 kernels: about points and closed boxes of configurations.

What is known of single pairs of bodies comes from ``pairs``.
"""

from functools import cache
from typing import NamedTuple

import warp as wp

from warp_bounding.indicators.arms.kinematics import kinematics_of
from warp_bounding.indicators.arms.pairs import OUTWARD, Collisions, pairs_of
from warp_bounding.indicators.arms.separation import farthest, separation
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.runtime.native import named

__all__ = ["BLUR", "FREE", "FULL", "HALVES", "OPEN", "Collisions", "Kernels", "kernels_of"]

OPEN, FREE, FULL = 0, 1, 2  # answers about boxes: nothing is known, none of its configurations collides, all do
HALVES = 3  # asked for: half-spaces, where nothing else is known

MOST_OPEN = 8  # pairs of a box that a half-space is made of; where more are left there is none
LARGEST_HALF = 1.0  # radians: the second order is of no use for larger boxes
BLUR = 2.0**-50  # of a coordinate: by how much the centre of a box and its half may be off

_OPEN, _FREE, _FULL, _HALVES = wp.constant(OPEN), wp.constant(FREE), wp.constant(FULL), wp.constant(HALVES)
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_MOST_OPEN = wp.constant(MOST_OPEN)
_LARGEST_HALF = wp.constant(wp.float64(LARGEST_HALF))
_OUTWARD = wp.constant(wp.float64(OUTWARD))
_BLUR = wp.constant(wp.float64(BLUR))
_ZERO, _HALF, _ONE = (wp.constant(wp.float64(value)) for value in (0.0, 0.5, 1.0))
_INFINITY = wp.constant(wp.float64(float("inf")))


class Kernels(NamedTuple):
    """For arms of one number of joints."""

    points: wp.Kernel  # truth and distance of configurations
    boxes: wp.Kernel  # whether closed boxes are free, or all collide, and half-spaces


@cache
def kernels_of(n: int) -> Kernels:
    """The kernels for arms of n joints."""
    arm = kinematics_of(n)
    values, rotations_of, origins_of, link = arm.values, arm.rotations, arm.origins, arm.link
    own = pairs_of(n)
    center_of, balls_apart, arcs, swept, bend = own.center_of, own.balls_apart, own.arcs, own.swept, own.bend
    slopes, bound, room_of, middle, meets = own.slopes, own.bound, own.room_of, own.middle, own.meets
    radius_of = own.radius_of
    normals = wp.types.matrix(shape=(MOST_OPEN, 3), dtype=wp.float64)
    numbers = wp.types.vector(length=MOST_OPEN, dtype=wp.int32)

    @named(f"arm_points_{n}").kernel
    def points(
        first: int,
        # inputs
        c: Collisions,
        x: wp.array(dtype=values),
        near: wp.float64,
        # outputs
        answers: wp.array(dtype=wp.uint8),
        distances: wp.array(dtype=wp.float64),
    ):
        """Truth of configurations, and a lower bound of the distance to the next colliding one; none above ``near`` is told."""
        t, _ = wp.tid()
        t += first
        p = x[t]
        q, within, finite = middle(c, p, p), wp.bool(True), wp.bool(True)
        for i in range(n):
            finite = finite and wp.abs(p[i]) < _INFINITY
            within = within and p[i] >= c.lower[i] and p[i] <= c.upper[i]
        answers[t] = wp.uint8(_OUT)
        distances[t] = _ZERO
        if not finite:
            return
        turn = rotations_of(c.chain, q)
        at = origins_of(c.chain, q, turn)
        touches, unsure, nearest = wp.bool(False), wp.bool(False), near + wp.float64(0.0)
        moving, center = wp.int32(-1), wp.vec3d()
        for number in range(c.pairs.shape[0]):
            pair = c.pairs[number]
            room, reach = room_of(c, pair), c.speed[number]
            if pair[1] != moving:
                moving = pair[1]
                center = center_of(c, turn, at, moving)
            if balls_apart(c, turn, at, pair, center) - room > nearest * reach:
                continue
            a, b = link(turn, at, c.bodies.link[pair[0]]), link(turn, at, c.bodies.link[pair[1]])
            s = separation(c.bodies, pair[0], a, pair[1], b, room + nearest * reach)
            gap = s.gap - room
            if gap > _ZERO:
                if gap < nearest * reach:
                    nearest = wp.min(nearest, radius_of(c, turn, at, pair, s.normal, gap, reach))
            else:
                nearest = wp.float64(0.0)
                if meets(c, s, pair, wp.float64(0.0)):
                    touches = wp.bool(True)
                    break
                unsure = wp.bool(True)
        if within and touches:
            answers[t] = wp.uint8(_IN)
        elif within and unsure:
            answers[t] = wp.uint8(_UNDECIDED)
        distances[t] = nearest

    @named(f"arm_boxes_{n}").kernel
    def boxes(
        first: int,
        # inputs
        c: Collisions,
        lower: wp.array(dtype=values),
        upper: wp.array(dtype=values),
        asked: int,
        # outputs
        answers: wp.array(dtype=wp.uint8),
        levels: wp.array(dtype=wp.float64),
        lines: wp.array(dtype=values),
        axes: wp.array(dtype=wp.int32),
        losses: wp.array(dtype=wp.float64),
    ):
        """What is certain about closed boxes of configurations, within the limits: that asked for, ``FREE``, ``FULL`` or ``HALVES``."""
        t, _ = wp.tid()
        t += first
        answers[t] = wp.uint8(_OPEN)
        if asked == _HALVES:
            levels[t] = _ONE  # a half-space that holds everything
            lines[t] = values()
            axes[t] = 0
            losses[t] = _ZERO
        low, high = lower[t], upper[t]
        half, within = values(), wp.bool(True)
        for i in range(n):
            if not (low[i] <= high[i] and wp.abs(low[i]) < _INFINITY and wp.abs(high[i]) < _INFINITY):
                return
            within = within and low[i] >= c.lower[i] and high[i] <= c.upper[i]
        q, small = middle(c, low, high), wp.bool(True)
        for i in range(n):
            size = wp.max(wp.abs(low[i]), wp.abs(high[i]))
            half[i] = ((high[i] * _HALF - low[i] * _HALF) * _OUTWARD + size * _BLUR) / c.weights[i] * _OUTWARD
            small = small and half[i] <= _LARGEST_HALF
        turn = rotations_of(c.chain, q)
        at = origins_of(c.chain, q, turn)
        directions, left = normals(), numbers()
        count, known = wp.int32(0), wp.bool(True)
        lowest, slope, arc = wp.float64(wp.inf), values(), arcs(c, half)
        moving, still, center, way = wp.int32(-1), wp.int32(-2), wp.vec3d(), wp.float64(0.0)
        for number in range(c.pairs.shape[0]):
            pair = c.pairs[number]
            room = room_of(c, pair)
            if pair[1] != moving:
                moving = pair[1]
                still = wp.int32(-2)
                center = center_of(c, turn, at, moving)
            if c.bodies.link[pair[0]] != still:
                still = c.bodies.link[pair[0]]
                way = swept(c, pair, arc)
            if balls_apart(c, turn, at, pair, center) > room + way:
                continue
            a, b = link(turn, at, c.bodies.link[pair[0]]), link(turn, at, c.bodies.link[pair[1]])
            s = separation(c.bodies, pair[0], a, pair[1], b, room + way)
            if asked == _FULL:
                if within and meets(c, s, pair, way):
                    answers[t] = wp.uint8(_FULL)
                    return
                continue
            if s.gap > room + way:
                continue
            bent, value = bend(c, pair, half), -wp.float64(wp.inf)
            if small and s.gap > -_INFINITY:
                value = bound(c, turn, at, pair, s.normal, room, half, values()) - bent
                if value > _ZERO:
                    continue
            if asked == _FREE:
                return
            known = known and count < _MOST_OPEN and value > -_INFINITY
            if known:
                for k in range(3):
                    directions[count, k] = s.normal[k]
                left[count] = number
                count += 1
                if value < lowest:
                    lowest = value
                    slope = slopes(c, turn, at, pair, s.normal, farthest(c.bodies, pair[1], b, -s.normal))
        if asked == _FULL:
            return
        if known and count == 0:
            answers[t] = wp.uint8(_FREE)
            return
        if not known:
            return
        level, worst = wp.float64(wp.inf), wp.int32(0)
        for k in range(count):
            pair = c.pairs[left[k]]
            normal = wp.vec3d(directions[k, 0], directions[k, 1], directions[k, 2])
            value = bound(c, turn, at, pair, normal, room_of(c, pair), half, slope) - bend(c, pair, half)
            if value < level:
                level, worst = value, k
        # What the linear function loses is what the second order takes and what the corners' slopes differ by.
        pair = c.pairs[left[worst]]
        normal = wp.vec3d(directions[worst, 0], directions[worst, 1], directions[worst, 2])
        other = c.bodies.link[pair[1]]
        b = link(turn, at, other)
        x = farthest(c.bodies, pair[1], b, -normal)
        steps = slopes(c, turn, at, pair, normal, x)
        axis, most, loss = wp.int32(0), wp.float64(-1.0), wp.float64(0.0)
        for i in range(n):
            part = wp.abs(steps[i] - slope[i]) * half[i]
            for j in range(n):
                part += _HALF * c.reach[pair[1], wp.max(i, j)] * half[i] * half[j]
            loss += part
            if part > most:
                axis, most = i, part
        for i in range(n):
            slope[i] = -slope[i] / c.weights[i]
        levels[t] = -level
        lines[t] = slope
        axes[t] = axis
        losses[t] = loss

    return Kernels(points, boxes)
