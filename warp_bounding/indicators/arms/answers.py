"""What the colliding configurations of an arm answer, in float64 kernels: about points and closed boxes of configurations.

A *pair* is two bodies that may touch, and the joints ``first .. last`` that move one against the other: those behind the link of the one
(the world or a link before) up to that of the other. Seen from the one's link, corner p of the other is a function of these joint
values alone.

*First order.* Where each joint value differs by ``h_i`` at most from the centre's, p has moved by no more than ``sum_i rho_i 2 sin(h_i / 2)``, rho_i being
how far the body is from the axis of joint i at most (``Arm.reach``).

*Second order.* With n the direction that tells the hulls apart at the centre, ``n . p`` is there ``n . p_c + sum_i c_i d_i``, ``c_i = n . dp/dq_i``, up to
``1/2 sum_ij |d_i| |d_j| |d2p/dq_i dq_j|``, and the second derivative is at most rho of the later of the two joints, since
``d2p/dq_i dq_j = z_i x (z_j x (p - o_j))`` for i before j. So the gap is above a linear function for each corner. A box over which all of them stay above
the radii is free of the pair.

A joint that slides may be taken first, at which corners go straight on; all bounds above need ``rho`` only for values within the limits, where what collides is.

*Half-spaces.* Where they do not, a configuration of the box that collides has a corner whose linear function is no more than 0. One linear
function that lies under all of them in the box, over all pairs that are left, gives a half-space.

*Distance.* In coordinates ``x_i = w_i q_i``, a ball of radius r around a configuration moves the other body by at most
``r |(rho_i / w_i)_i|``; and along n by at most ``r |(c_i / w_i)_i| + r^2 / 2 |(rho_max(i, j) / (w_i w_j))_ij|``, the last a Frobenius norm. The larger of the two radii
that follow is a distance which the pair cannot undercut.
"""

from functools import cache
from typing import NamedTuple

import warp as wp

from warp_bounding.indicators.arms.kinematics import Chain, kinematics_of
from warp_bounding.indicators.arms.separation import Bodies, Separation, corner, farthest, separation
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.runtime.native import named

__all__ = ["BLUR", "FREE", "FULL", "HALVES", "OPEN", "Collisions", "Kernels", "kernels_of"]

OPEN, FREE, FULL = 0, 1, 2  # answers about boxes: nothing is known, none of its configurations collides, all do
HALVES = 3  # asked for: half-spaces, where nothing else is known

MOST_OPEN = 8  # pairs of a box that a half-space is made of; where more are left there is none
LARGEST_HALF = 1.0  # radians: the second order is of no use for larger boxes
BLUR = 2.0**-50  # of a coordinate: by how much the centre of a box and its half may be off
OUTWARD, INWARD = 1 + 2.0**-40, 1 - 2.0**-40  # outweigh what sums of a few products round, relative to their size

_OPEN, _FREE, _FULL, _HALVES = wp.constant(OPEN), wp.constant(FREE), wp.constant(FULL), wp.constant(HALVES)
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_MOST_OPEN = wp.constant(MOST_OPEN)
_LARGEST_HALF = wp.constant(wp.float64(LARGEST_HALF))
_OUTWARD, _INWARD = wp.constant(wp.float64(OUTWARD)), wp.constant(wp.float64(INWARD))
_BLUR = wp.constant(wp.float64(BLUR))
_ZERO, _HALF, _ONE, _TWO = (wp.constant(wp.float64(value)) for value in (0.0, 0.5, 1.0, 2.0))
_HALF_TURN = wp.constant(wp.float64(3.14159265358979))
_INFINITY = wp.constant(wp.float64(float("inf")))


@wp.struct
class Collisions:
    """An arm, what it may touch, and in which coordinates."""

    chain: Chain
    bodies: Bodies
    pairs: wp.array(dtype=wp.vec2i)  # the one, the other, whose link is behind that of the one
    reach: wp.array(dtype=wp.float64, ndim=2)  # of each body from each joint's axis
    speed: wp.array(
        dtype=wp.float64
    )  # of each pair, metres by which it comes nearer at most, per unit of distance in the shape's coordinates
    weights: wp.array(dtype=wp.float64)
    lower: wp.array(dtype=wp.float64)  # limits, in the shape's coordinates
    upper: wp.array(dtype=wp.float64)
    safety: wp.float64  # metres, what comes closer counts as touching
    allowance: wp.float64  # metres, by how much a gap may be off


class Kernels(NamedTuple):
    """For arms of one number of joints."""

    points: wp.Kernel  # truth and distance of configurations
    boxes: wp.Kernel  # whether closed boxes are free, or all collide, and half-spaces


@cache
def kernels_of(n: int) -> Kernels:
    """The kernels for arms of n joints."""
    arm = kinematics_of(n)
    values, turns, places = arm.values, arm.turns, arm.places
    rotations_of, origins_of, link, rate = arm.rotations, arm.origins, arm.link, arm.rate
    normals = wp.types.matrix(shape=(MOST_OPEN, 3), dtype=wp.float64)
    numbers = wp.types.vector(length=MOST_OPEN, dtype=wp.int32)

    @named(f"arm_apart_{n}").func
    def balls_apart(c: Collisions, turn: turns, at: places, pair: wp.vec2i) -> wp.float64:
        """How far the balls around two hulls are from each other."""
        one, other = pair[0], pair[1]
        a, b = link(turn, at, c.bodies.link[one]), link(turn, at, c.bodies.link[other])
        way = (b.turn * c.bodies.center[other] + b.at) - (a.turn * c.bodies.center[one] + a.at)
        return wp.length(way) - c.bodies.ball[one] - c.bodies.ball[other]

    @named(f"arm_swept_{n}").func
    def swept(c: Collisions, pair: wp.vec2i, half: values) -> wp.float64:
        """How far a pair comes nearer at most in a box; first order."""
        most = wp.float64(0.0)
        for i in range(c.bodies.link[pair[0]] + 1, c.bodies.link[pair[1]] + 1):
            way = half[i]
            if c.chain.slides[i] == 0:
                way = _TWO * wp.sin(wp.min(half[i], _HALF_TURN) * _HALF)
            most += c.reach[pair[1], i] * way
        return most * _OUTWARD

    @named(f"arm_bend_{n}").func
    def bend(c: Collisions, pair: wp.vec2i, half: values) -> wp.float64:
        """By how much a linear function of a pair may be off in a box; second order."""
        most = wp.float64(0.0)
        begin, end = c.bodies.link[pair[0]] + 1, c.bodies.link[pair[1]] + 1
        before = wp.float64(0.0)
        for j in range(begin, end):
            most += c.reach[pair[1], j] * half[j] * (before + _HALF * half[j])
            before += half[j]
        return most * _OUTWARD

    @named(f"arm_slopes_{n}").func
    def slopes(c: Collisions, turn: turns, at: places, pair: wp.vec2i, normal: wp.vec3d, x: wp.vec3d) -> values:
        """How ``normal . x`` changes with each joint, of the place x of a corner of the other body."""
        found = values()
        for i in range(c.bodies.link[pair[0]] + 1, c.bodies.link[pair[1]] + 1):
            found[i] = wp.dot(normal, rate(c.chain, turn, at, i, x))
        return found

    @named(f"arm_bound_{n}").func
    def bound(
        c: Collisions,
        turn: turns,
        at: places,
        pair: wp.vec2i,
        normal: wp.vec3d,
        room: wp.float64,
        half: values,
        slope: values,
    ) -> wp.float64:
        """A number under ``gap - slope . (q - center)`` in a box, of all corners."""
        one, other = pair[0], pair[1]
        b = link(turn, at, c.bodies.link[other])
        level = wp.dot(normal, farthest(c.bodies, one, link(turn, at, c.bodies.link[one]), normal)) + room
        least = wp.float64(wp.inf)
        for k in range(c.bodies.first[other], c.bodies.first[other + 1]):
            x = corner(c.bodies, b, k)
            own = slopes(c, turn, at, pair, normal, x)
            value = wp.dot(normal, x) - level
            for i in range(n):
                value -= wp.abs(own[i] - slope[i]) * half[i]
            least = wp.min(least, value)
        return least

    @named(f"arm_room_{n}").func
    def room_of(c: Collisions, pair: wp.vec2i) -> wp.float64:
        """The radii of a pair, and what may be off."""
        return (c.bodies.radius[pair[0]] + c.bodies.radius[pair[1]] + c.safety) * _OUTWARD + c.allowance

    @named(f"arm_middle_{n}").func
    def middle(c: Collisions, lower: values, upper: values) -> values:
        q = values()
        for i in range(n):
            q[i] = (lower[i] * _HALF + upper[i] * _HALF) / c.weights[i]
        return q

    @named(f"arm_meets_{n}").func
    def meets(c: Collisions, s: Separation, pair: wp.vec2i, way: wp.float64) -> bool:
        """Do two bodies touch for certain, even if they go apart by some way?"""
        radii = (c.bodies.radius[pair[0]] + c.bodies.radius[pair[1]] + c.safety) * _INWARD - c.allowance
        return s.apart + way <= radii or s.depth > way + c.allowance

    @named(f"arm_radius_{n}").func
    def radius_of(
        c: Collisions, turn: turns, at: places, pair: wp.vec2i, normal: wp.vec3d, gap: wp.float64, reach: wp.float64
    ) -> wp.float64:
        """A distance, in the shape's coordinates, that a pair with a gap cannot undercut."""
        begin, end = c.bodies.link[pair[0]] + 1, c.bodies.link[pair[1]] + 1
        b = link(turn, at, c.bodies.link[pair[1]])
        steep, bent, before = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
        for k in range(c.bodies.first[pair[1]], c.bodies.first[pair[1] + 1]):
            own = slopes(c, turn, at, pair, normal, corner(c.bodies, b, k))
            square = wp.float64(0.0)
            for i in range(begin, end):
                part = (wp.abs(own[i]) + c.allowance) / c.weights[i]
                square += part * part
            steep = wp.max(steep, square)
        for j in range(begin, end):
            share, part = _ONE / (c.weights[j] * c.weights[j]), c.reach[pair[1], j] / c.weights[j]
            bent += part * part * (_TWO * before + share)
            before += share
        slope, curve = wp.sqrt(steep) * _OUTWARD, wp.sqrt(bent) * _OUTWARD
        # The root of slope r + curve r^2 / 2 = gap, written so that nothing cancels.
        root = _TWO * gap / (slope + wp.sqrt(slope * slope + _TWO * curve * gap))
        return wp.max(gap / reach, root) * _INWARD

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
        t = first + wp.tid()
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
        for number in range(c.pairs.shape[0]):
            pair = c.pairs[number]
            room, reach = room_of(c, pair), c.speed[number]
            if balls_apart(c, turn, at, pair) - room > nearest * reach:
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
        t = first + wp.tid()
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
        lowest, slope = wp.float64(wp.inf), values()
        for number in range(c.pairs.shape[0]):
            pair = c.pairs[number]
            room, way = room_of(c, pair), swept(c, pair, half)
            if balls_apart(c, turn, at, pair) > room + way:
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
        own = slopes(c, turn, at, pair, normal, x)
        axis, most, loss = wp.int32(0), wp.float64(-1.0), wp.float64(0.0)
        for i in range(n):
            part = wp.abs(own[i] - slope[i]) * half[i]
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
