"""What is known of a pair of bodies of an arm, at a configuration and over boxes of them, in float64.

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
from typing import Any

import warp as wp

from warp_bounding.indicators.arms.kinematics import Chain, kinematics_of
from warp_bounding.indicators.arms.separation import Bodies, Separation, corner, farthest
from warp_bounding.runtime.native import named

__all__ = ["OUTWARD", "Collisions", "pairs_of"]

OUTWARD, INWARD = 1 + 2.0**-40, 1 - 2.0**-40  # outweigh what sums of a few products round, relative to their size

_OUTWARD, _INWARD = wp.constant(wp.float64(OUTWARD)), wp.constant(wp.float64(INWARD))
_HALF, _ONE, _TWO = (wp.constant(wp.float64(value)) for value in (0.5, 1.0, 2.0))
_HALF_TURN = wp.constant(wp.float64(3.14159265358979))


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


class Pairs:
    """Warp functions for arms of n joints; each is explained where it is written."""

    def __init__(self, n: int):
        arm = kinematics_of(n)
        values, turns, places, link, rate = arm.values, arm.turns, arm.places, arm.link, arm.rate

        @named(f"arm_center_{n}").func
        def center_of(c: Collisions, turn: turns, at: places, body: int) -> wp.vec3d:
            """The centre of the ball around a hull, where its link is."""
            own = c.bodies.link[body]
            if own < 0:
                return c.bodies.center[body]
            place = link(turn, at, own)
            return place.turn * c.bodies.center[body] + place.at

        @named(f"arm_apart_{n}").func
        def balls_apart(c: Collisions, turn: turns, at: places, pair: wp.vec2i, center: wp.vec3d) -> wp.float64:
            """How far the balls around two hulls are from each other, by the centre of the other one."""
            way = center - center_of(c, turn, at, pair[0])
            return wp.length(way) - c.bodies.ball[pair[0]] - c.bodies.ball[pair[1]]

        @named(f"arm_arcs_{n}").func
        def arcs(c: Collisions, half: values) -> values:
            """How far each joint of a box takes a point at most that is a metre from its axis."""
            found = values()
            for i in range(n):
                found[i] = half[i]
                if c.chain.slides[i] == 0:
                    found[i] = _TWO * wp.sin(wp.min(half[i], _HALF_TURN) * _HALF)
            return found

        @named(f"arm_swept_{n}").func
        def swept(c: Collisions, pair: wp.vec2i, arc: values) -> wp.float64:
            """How far a pair comes nearer at most in a box, by its arcs; first order."""
            most = wp.float64(0.0)
            for i in range(c.bodies.link[pair[0]] + 1, c.bodies.link[pair[1]] + 1):
                most += c.reach[pair[1], i] * arc[i]
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

        self.center_of = center_of
        self.balls_apart = balls_apart
        self.arcs = arcs
        self.swept = swept
        self.bend = bend
        self.slopes = slopes
        self.bound = bound
        self.room_of = room_of
        self.middle = middle
        self.meets = meets
        self.radius_of = radius_of


@cache
def pairs_of(n: int) -> Any:
    """The functions for n joints."""
    return Pairs(n)
