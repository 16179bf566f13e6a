"""Float64 kernels that answer about points and closed boxes of configurations in which an arm collides."""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from warp_bounding.runtime.native import named, native_text
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED

# --- How far two hulls are apart --------------------------------------------------------------------------------------
#
# The distance of two convex hulls in float64: a direction that proves a lower bound, two points that are an upper one.
#
# For any vector n, however it was found, all points a of one hull and b of the other have ``n . (b - a) >= gap``, where
# the gap is the least ``n . b`` less the largest ``n . a`` over the corners. So the gap over the length of n is a lower
# bound of the distance that depends only on these two searches over corners. The search for a good n needs no rigour:
# it is GJK (Gilbert, Johnson and Keerthi), which keeps up to four of the differences ``b - a``, whose hull comes ever
# nearer to 0.
#
# Where 0 lies inside the hull of four differences, the hulls meet. ``depth`` is how far 0 is from that hull's faces:
# the hulls still meet if corners are off by that much.
#
# Source: Gilbert, Johnson, Keerthi, "A fast procedure for computing the distance between complex objects in three-
# dimensional space" (1988).

ROUNDS = wp.constant(32)  # of the search, at most; most pairs take 3 to 6
_CLOSE = wp.constant(wp.float64(1e-10))  # relative to the distance: the search ends when its bounds are this close
# The least height of the hull of four corners, relative to their longest difference L. Where every height is above
# 2^-12 L, a face has an area of 2^-25 L^2 or more. Then its normal, a cross product of edges, is off by 2^-25 at most,
# and the distance of 0 from its plane by less than 2^-24 L.
FLATTEST, CRUDE = 2.0**-12, 2.0**-20
_FLATTEST, _CRUDE = wp.constant(wp.float64(FLATTEST)), wp.constant(wp.float64(CRUDE))
_ZERO, _ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))
_INFINITY = wp.constant(wp.float64(float("inf")))
_TINY = wp.constant(wp.float64(2.0**-400))

Corners = wp.types.matrix(shape=(4, 3), dtype=wp.float64)


@wp.struct
class Bodies:
    """Rounded hulls in the frames of their links."""

    points: wp.array(dtype=wp.vec3d)
    first: wp.array(dtype=wp.int32)  # index of each body's first corner, and at the end the number of all corners
    link: wp.array(dtype=wp.int32)
    radius: wp.array(dtype=wp.float64)
    lanes: wp.array(dtype=wp.float64)  # corners, eight at a time; see native/hulls.h
    block: wp.array(dtype=wp.int32)  # where each body's groups of eight begin, and at the end where the last one ends
    center: wp.array(dtype=wp.vec3d)  # of a ball that holds the corners
    ball: wp.array(dtype=wp.float64)
    low: wp.array(dtype=wp.vec3d)  # of a box that holds the corners
    high: wp.array(dtype=wp.vec3d)


@wp.struct
class Place:
    """Where a link is."""

    turn: wp.mat33d
    at: wp.vec3d


@wp.struct
class Separation:
    """Bounds of the distance of two hulls."""

    normal: wp.vec3d  # of length about 1
    gap: wp.float64  # a lower bound, by ``normal`` (see above); minus infinity without a direction
    apart: wp.float64  # an upper bound: the distance of two points of the hulls
    depth: wp.float64  # above 0 where the hulls meet (see above)


@wp.func
def corner(bodies: Bodies, place: Place, i: int) -> wp.vec3d:
    """A corner where its link is."""
    return place.turn * bodies.points[i] + place.at


_TEXT = native_text("hulls.h")
Lanes = wp.array(dtype=wp.float64)


@named("arm_farthest").func_native(_TEXT.LANES + _TEXT.FARTHEST)
def _farthest(lanes: Lanes, begin: int, end: int, d: wp.vec3d) -> int: ...


@wp.func
def farthest(bodies: Bodies, body: int, place: Place, direction: wp.vec3d) -> wp.vec3d:
    """The corner that lies farthest in a direction."""
    d = wp.transpose(place.turn) * direction
    k = bodies.first[body] + _farthest(bodies.lanes, bodies.block[body], bodies.block[body + 1], d)
    return corner(bodies, place, k)


@wp.func
def _on_segment(a: wp.vec3d, b: wp.vec3d) -> wp.vec3d:
    """The point of a segment that is nearest to 0."""
    way = b - a
    square = wp.dot(way, way)
    if not square > _TINY:
        return a
    return a + way * wp.clamp(-wp.dot(a, way) / square, _ZERO, _ONE)


@wp.func
def _nearer(p: wp.vec3d, q: wp.vec3d) -> wp.vec3d:
    if wp.dot(q, q) < wp.dot(p, p):
        return q
    return p


@wp.func
def _on_triangle(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """The point of a triangle that is nearest to 0; triangles may be degenerate."""
    found = _nearer(_nearer(_on_segment(a, b), _on_segment(b, c)), _on_segment(c, a))
    normal = wp.cross(b - a, c - a)
    square = wp.dot(normal, normal)
    if square > _TINY:
        u, v, w = wp.dot(normal, wp.cross(b, c)), wp.dot(normal, wp.cross(c, a)), wp.dot(normal, wp.cross(a, b))
        if u >= _ZERO and v >= _ZERO and w >= _ZERO:
            found = _nearer(found, normal * (wp.dot(normal, a) / square))
    return found


@wp.func
def _inward(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, d: wp.vec3d, size: wp.float64) -> wp.float64:
    """Distance of 0 from the plane of a face, positive on the fourth corner's side.

    It is negative where the four corners are nearly in a plane.
    """
    normal = wp.cross(b - a, c - a)
    length = wp.length(normal)
    if not length > _TINY:
        return -size
    level = wp.dot(normal, a) / length
    height = wp.dot(normal, d) / length - level
    if height < _ZERO:
        level = -level
        height = -height
    if not height > _FLATTEST * size:
        return -size
    return -level


@wp.func
def _depth(s: Corners) -> wp.float64:
    """How far 0 is from the faces of the hull of four differences at least, where it is in it; 0 or less elsewhere."""
    size = wp.float64(0.0)
    for k in range(4):
        size = wp.max(size, wp.length(s[k] - s[(k + 1) % 4]))
        size = wp.max(size, wp.length(s[k] - s[(k + 2) % 4]))
    least = wp.min(
        wp.min(_inward(s[0], s[1], s[2], s[3], size), _inward(s[1], s[2], s[3], s[0], size)),
        wp.min(_inward(s[2], s[3], s[0], s[1], size), _inward(s[3], s[0], s[1], s[2], size)),
    )
    return least - _CRUDE * size


@wp.func
def separation(bodies: Bodies, one: int, at_one: Place, other: int, at_other: Place, enough: wp.float64) -> Separation:
    """Search for a direction that tells two hulls apart, the bodies a and b above; a gap beyond ``enough`` will do."""
    found = Separation()
    found.gap = -_INFINITY
    found.apart = _INFINITY
    found.depth = -_INFINITY
    s = Corners()
    count, rounds, last = wp.int32(0), wp.int32(ROUNDS), wp.int32(0)
    nearest = at_other.turn * bodies.center[other] + at_other.at - at_one.turn * bodies.center[one] - at_one.at
    while rounds > 0:
        rounds -= 1
        if count == 0 and not wp.length(nearest) > _TINY:  # any direction will do
            nearest = wp.vec3d(_ONE, _ZERO, _ZERO)
        length = wp.length(nearest)
        if count > 0:  # at first it is a guess: the way between centres, which may lie outside of the hulls
            found.apart = wp.min(found.apart, length)
        if not length > _TINY:
            break
        normal = nearest / length
        new = farthest(bodies, other, at_other, -normal) - farthest(bodies, one, at_one, normal)
        gap = wp.dot(normal, new)
        if gap > found.gap:
            found.gap = gap
            found.normal = normal
        if gap > enough or (count > 0 and length - gap <= _CLOSE * length):
            break
        if count < 4:
            last = count
            count += 1
        for k in range(3):
            s[last, k] = new[k]
        if count == 1:
            nearest = s[0]
        elif count == 2:
            nearest = _on_segment(s[0], s[1])
        elif count == 3:
            nearest = _on_triangle(s[0], s[1], s[2])
        else:
            found.depth = _depth(s)
            if found.depth > _ZERO:
                found.apart = _ZERO
                break
            # The corner that is not of the nearest face is the next to give way.
            least = wp.float64(wp.inf)
            for k in range(4):
                p = _on_triangle(s[(k + 1) % 4], s[(k + 2) % 4], s[(k + 3) % 4])
                square = wp.dot(p, p)
                if square < least:
                    least, last = square, k
                    nearest = p
    return found


# --- Where the links are ----------------------------------------------------------------------------------------------
#
# The forward kinematics of an arm in float64 kernels, and its rounding.
#
# Let u = 2^-53, n the number of joints, and S the largest distance from the origin that any corner, joint or obstacle
# can have. Sine and cosine are off by at most 4 u, an entry of a product of two rotations by 3 u. So a rotation is off
# by 32 u for each joint before it, in the operator norm, and a position by 40 n u S. The first derivatives of a corner
# are cross products of such numbers, off by 100 n u S at most. A linear bound over a box multiplies each by half the
# box's side, at most 1, and adds up to 2 n of them. With n up to 16 all that is under 2^13 u S. A configuration that
# is computed from weighted coordinates is off by 2^-50 of its numbers, up to ``FARTHEST``, which moves corners by no
# more than 16 times 2^-46 S. ``ALLOWANCE`` is far more than the sum, and far less than anything that matters.

ALLOWANCE = 2.0**-36  # times S: by how much a gap may be off


@wp.struct
class Chain:
    """The joints: the origin of each in the frame of its parent, whose z is the joint's axis, and its value."""

    parent: wp.array(dtype=wp.int32)  # the joint whose link carries it, a lower number; -1 of the base
    turn: wp.array(dtype=wp.mat33d)
    at: wp.array(dtype=wp.vec3d)
    slides: wp.array(dtype=wp.int32)
    coordinate: wp.array(dtype=wp.int32)  # value = factor * x[coordinate] + offset, by the weighted coordinates x
    factor: wp.array(dtype=wp.float64)
    offset: wp.array(dtype=wp.float64)


# --- Pairs of bodies --------------------------------------------------------------------------------------------------
#
# Bounds of the distance of a pair of bodies of an arm, at a configuration and over boxes of configurations, in float64.
#
# A *pair* is two bodies that may touch, here called A and B. Its *path* are the joints that move one against the other:
# from A's link towards the base down to the last link that carries both, and from there out to B's link. In the frame
# of A's link, a corner p of B depends on these joint values alone; those on the way towards the base count with a minus
# sign. If A is the base or carries B, the path only leads outwards.
#
# *First order.* If joint i differs from its value at the box's centre by d_i, ``|d_i| <= h_i``, then p has moved by at
# most ``sum_i rho_i 2 sin(h_i / 2)``. Here rho_i is the largest distance of B from the axis of joint i (``Arm.path``).
#
# *Second order.* Let n be the direction that separates the hulls at the centre, and p_c the corner there. ``n . p`` is
# ``n . p_c + sum_i c_i d_i``, ``c_i = n . dp/dq_i``, up to ``1/2 sum_ij |d_i| |d_j| |d2p/dq_i dq_j|``. The second
# derivative is ``z_i x (z_j x (p - o_j))`` for i before j, at most rho_j. So the gap is above one linear function for
# each corner of B. If all of them stay above the radii over a box, the box is free of this pair.
#
# *Third order.* Small boxes use the second derivatives at the centre: ``h_ij = ((n x z_i) x z_j) . (p - o_j)``, negated
# if i and j count with opposite signs. ``1/2 sum_ij h_ij d_i d_j`` is at least ``1/2 sum_i min(0, h_ii)
# h_i^2 - sum_(i<j) |h_ij| h_i h_j``. The remainder is at most a sixth of the sum over i, j, k of ``|d_i d_j d_k|``
# times rho of the latest of the three. The better of the two orders counts.
#
# Prismatic joints move corners along straight lines, as if they came first. All bounds above need rho only for values
# within the limits, since configurations collide only there.
#
# *Half-spaces.* If a box is not free, each of its colliding configurations has a corner whose linear function is at
# most 0. One linear function below all of them on the box, over all pairs that are left, gives a half-space.
#

OUTWARD, INWARD = 1 + 2.0**-40, 1 - 2.0**-40  # factors that cover the rounding of sums of a few products

_OUTWARD, _INWARD = wp.constant(wp.float64(OUTWARD)), wp.constant(wp.float64(INWARD))
_HALF, _TWO, _SIXTH = (wp.constant(wp.float64(each)) for each in (0.5, 2.0, 1 / 6))
_HALF_TURN = wp.constant(wp.float64(3.14159265358979))


@wp.struct
class Collisions:
    """An arm, what it may touch, and in which coordinates."""

    chain: Chain
    bodies: Bodies
    pairs: wp.array(dtype=wp.vec2i)  # bodies A and B
    first: wp.array(dtype=wp.int32)  # where the path of each pair begins, and at the end where the last one ends
    path: wp.array(dtype=wp.int32)  # joints
    sign: wp.array(dtype=wp.float64)  # of each joint of a path: 1, or -1 where it leads towards the base
    reach: wp.array(dtype=wp.float64)  # of each joint of a path: rho, the largest distance of B from its axis
    weights: wp.array(dtype=wp.float64)  # of coordinates
    lower: wp.array(dtype=wp.float64)  # limits, in the shape's coordinates
    upper: wp.array(dtype=wp.float64)
    safety: wp.float64  # metres: bodies that come closer count as touching
    allowance: wp.float64  # metres: by how much rounding may change a gap


# --- Answers ----------------------------------------------------------------------------------------------------------

OPEN, FREE, FULL = 0, 1, 2  # answers about a box: unknown, none of its configurations collides, all collide
HALVES = 3  # a question: whether a box is free, and if that is unknown its half-space

MOST_OPEN = 8  # pairs that a box's half-space is made of, at most; with more open pairs there is none
LARGEST_HALF = 1.0  # radians: boxes with a larger half side do not use the second order
LARGEST_SUM = 2.0  # radians: boxes with a larger sum of half sides do not use the third; the rounding relies on it
BLUR = 2.0**-50  # relative to a coordinate: by how much a box's computed centre and half sides may be off

_OPEN, _FREE, _FULL, _HALVES = wp.constant(OPEN), wp.constant(FREE), wp.constant(FULL), wp.constant(HALVES)
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_MOST_OPEN = wp.constant(MOST_OPEN)
_LARGEST_HALF, _LARGEST_SUM = wp.constant(wp.float64(LARGEST_HALF)), wp.constant(wp.float64(LARGEST_SUM))
_BLUR = wp.constant(wp.float64(BLUR))
Normals = wp.types.matrix(shape=(MOST_OPEN, 3), dtype=wp.float64)
Indices = wp.types.vector(length=MOST_OPEN, dtype=wp.int32)


class Kernels(NamedTuple):
    """The kernels for arms of one number of joints."""

    points: wp.Kernel  # truth of configurations
    boxes: wp.Kernel  # whether closed boxes are free, or all collide, and half-spaces


# These functions are for any number n of joints, which the types of their arguments tell. ``q``, ``half`` and ``slope``
# have a number for each joint, ``turn (3 n, 3)`` and ``at (n, 3)`` are where the links are. Results that Warp cannot
# name the type of are handed in as zeros: ``rates (n, 4)`` and ``second (n (n + 1) / 2, 4)``.


@wp.func
def rotation_of(turn: Any, i: int) -> wp.mat33d:
    """The rotation of a link; the base has number -1."""
    found = wp.identity(n=3, dtype=wp.float64)
    if i >= 0:
        for row in range(3):
            for column in range(3):
                found[row, column] = turn[3 * i + row, column]
    return found


@wp.func
def axis_of(turn: Any, i: int) -> wp.vec3d:
    """The axis of a joint: z of its link."""
    return wp.vec3d(turn[3 * i, 2], turn[3 * i + 1, 2], turn[3 * i + 2, 2])


@wp.func
def link(turn: Any, at: Any, i: int) -> Place:
    """Where a link is; the base has number -1."""
    found = Place()
    found.turn = rotation_of(turn, i)
    if i >= 0:
        found.at = at[i]
    return found


@wp.func
def placed(chain: Chain, q: Any, turn: Any, at: Any):
    """``turn`` and ``at`` of all links at joint values q."""
    for i in range(len(q)):
        parent = link(turn, at, chain.parent[i])
        own, origin = parent.turn * chain.turn[i], parent.at + parent.turn * chain.at[i]
        if chain.slides[i] == 0:
            c, s = wp.cos(q[i]), wp.sin(q[i])
            own = own * wp.mat33d(c, -s, _ZERO, s, c, _ZERO, _ZERO, _ZERO, _ONE)
        else:
            origin += wp.vec3d(own[0, 2], own[1, 2], own[2, 2]) * q[i]
        at[i] = origin
        for row in range(3):
            for column in range(3):
                turn[3 * i + row, column] = own[row, column]
    return turn, at


@wp.func
def center_of(c: Collisions, turn: Any, at: Any, body: int) -> wp.vec3d:
    """The centre of the ball around a hull, where its link is."""
    own = c.bodies.link[body]
    if own < 0:
        return c.bodies.center[body]
    place = link(turn, at, own)
    return place.turn * c.bodies.center[body] + place.at


@wp.func
def apart(c: Collisions, turn: Any, at: Any, pair: wp.vec2i, center: wp.vec3d) -> wp.float64:
    """How far the ball around the other hull, whose centre is given, is from ball and box around the one."""
    one, own = pair[0], c.bodies.link[pair[0]]
    p = center
    if own >= 0:
        place = link(turn, at, own)
        p = wp.transpose(place.turn) * (center - place.at)
    away = p - wp.max(wp.min(p, c.bodies.high[one]), c.bodies.low[one])
    ball = wp.length(p - c.bodies.center[one]) - c.bodies.ball[one]
    return wp.max(ball, wp.length(away)) - c.bodies.ball[pair[1]]


@wp.func
def arcs(chain: Chain, half: Any):
    """How far each joint of a box takes a point at most that is a metre from its axis."""
    found = type(half)()
    for i in range(len(half)):
        found[i] = half[i]
        if chain.slides[i] == 0:
            found[i] = _TWO * wp.sin(wp.min(half[i], _HALF_TURN) * _HALF)
    return found


@wp.func
def swept(c: Collisions, pair: int, arc: Any) -> wp.float64:
    """How far a pair comes nearer at most in a box, by its arcs; first order."""
    most = wp.float64(0.0)
    for k in range(c.first[pair], c.first[pair + 1]):
        most += c.reach[k] * arc[c.path[k]]
    return most * _OUTWARD


@wp.func
def bend(c: Collisions, pair: int, half: Any) -> wp.float64:
    """By how much a linear function of a pair may be off in a box; second order."""
    most = wp.float64(0.0)
    before = wp.float64(0.0)
    for k in range(c.first[pair], c.first[pair + 1]):
        part = half[c.path[k]]
        most += c.reach[k] * part * (before + _HALF * part)
        before += part
    return most * _OUTWARD


@wp.func
def twist(c: Collisions, pair: int, half: Any) -> wp.float64:
    """By how much a quadratic function of a pair may be off in a box; third order. Infinity in a large box."""
    most = wp.float64(0.0)
    before = wp.float64(0.0)
    for k in range(c.first[pair], c.first[pair + 1]):
        part = half[c.path[k]]
        most += c.reach[k] * part * (before * (before + part) * _HALF + part * part * _SIXTH)
        before += part
    return wp.where(before <= _LARGEST_SUM, most * _OUTWARD, _INFINITY)


@wp.func
def second_of(c: Collisions, turn: Any, at: Any, pair: int, normal: wp.vec3d, half: Any, second: Any):
    """What the second derivatives of ``normal . x`` weigh in a box, of corner p of the other: ``second . (p, 1)``.

    A row stands for two joints i and j of the path, i not after j: ``h_ij h_i h_j``, or half of that where i is j.
    """
    b, row = link(turn, at, c.bodies.link[c.pairs[pair][1]]), wp.int32(0)
    back = wp.transpose(b.turn)
    for k in range(c.first[pair], c.first[pair + 1]):
        i = c.path[k]
        if c.chain.slides[i] != 0:
            row += c.first[pair + 1] - k
            continue
        across = wp.cross(normal, axis_of(turn, i)) * half[i]
        for m in range(k, c.first[pair + 1]):
            j = c.path[m]
            weight = half[j]
            if m == k:
                weight *= _HALF
            if c.chain.slides[j] == 0:
                moment = wp.cross(across, axis_of(turn, j)) * weight
                way = back * moment
                for column in range(3):
                    second[row, column] = way[column]
                second[row, 3] = wp.dot(moment, b.at - at[j])
            else:
                second[row, 3] = wp.dot(across, axis_of(turn, j)) * weight
            row += 1
    return second


@wp.func
def rates_of(c: Collisions, turn: Any, at: Any, pair: int, normal: wp.vec3d, rates: Any):
    """How ``normal . x`` changes with each joint, of corner p of the other body: ``rates . (p, 1)``."""
    b = link(turn, at, c.bodies.link[c.pairs[pair][1]])
    for k in range(c.first[pair], c.first[pair + 1]):
        i = c.path[k]
        axis = axis_of(turn, i)
        way, level = wp.vec3d(), wp.dot(normal, axis)
        if c.chain.slides[i] == 0:  # n . (z x (x - o)) = (n x z) . (x - o)
            across = wp.cross(normal, axis)
            way = wp.transpose(b.turn) * across
            level = wp.dot(across, b.at - at[i])
        for row in range(3):
            rates[i, row] = c.sign[k] * way[row]
        rates[i, 3] = c.sign[k] * level
    return rates


@wp.func
def nearest(c: Collisions, turn: Any, at: Any, pair: int, normal: wp.vec3d) -> wp.vec4d:
    """``(p, 1)``, p being the corner of the other body that is nearest along the normal."""
    other = c.pairs[pair][1]
    b, block = link(turn, at, c.bodies.link[other]), c.bodies.block[other]
    d = -(wp.transpose(b.turn) * normal)
    p = c.bodies.points[c.bodies.first[other] + _farthest(c.bodies.lanes, block, c.bodies.block[other + 1], d)]
    return wp.vec4d(p[0], p[1], p[2], _ONE)


@named("arm_least").func_native(_TEXT.LANES + _TEXT.LEAST)
def _least(
    lanes: Lanes,
    begin: int,
    end: int,
    d: wp.vec3d,
    level: wp.float64,
    rates: Any,
    half: Any,
    second: Any,
    joints_of_path: int,
) -> wp.float64: ...


@wp.func
def bound(
    c: Collisions,
    turn: Any,
    at: Any,
    pair: int,
    normal: wp.vec3d,
    half: Any,
    slope: Any,
    rates: Any,
    second: Any,
) -> wp.float64:
    """A number under ``gap - slope . (q - center)`` in a box, of all corners."""
    a, other = c.pairs[pair][0], c.pairs[pair][1]
    b = link(turn, at, c.bodies.link[other])
    far = farthest(c.bodies, a, link(turn, at, c.bodies.link[a]), normal)
    level = wp.dot(normal, b.at - far) - room_of(c, c.pairs[pair])
    own = rates_of(c, turn, at, pair, normal, rates)
    for i in range(len(slope)):
        own[i, 3] -= slope[i]
    d, begin, end = wp.transpose(b.turn) * normal, c.bodies.block[other], c.bodies.block[other + 1]
    value = _least(c.bodies.lanes, begin, end, d, level, own, half, second, 0) - bend(c, pair, half)
    twisted = twist(c, pair, half)
    if value > _ZERO or twisted == _INFINITY:
        return value
    curved, joints = second_of(c, turn, at, pair, normal, half, second), c.first[pair + 1] - c.first[pair]
    return wp.max(value, _least(c.bodies.lanes, begin, end, d, level, own, half, curved, joints) - twisted)


@wp.func
def room_of(c: Collisions, pair: wp.vec2i) -> wp.float64:
    """The radii of a pair, and what may be off."""
    return (c.bodies.radius[pair[0]] + c.bodies.radius[pair[1]] + c.safety) * _OUTWARD + c.allowance


@wp.func
def middle(c: Collisions, lower: Any, upper: Any, q: Any):
    """The joints' values ``q`` in the middle of a box of coordinates."""
    for i in range(len(q)):
        k = c.chain.coordinate[i]
        q[i] = (lower[k] * _HALF + upper[k] * _HALF) / c.weights[k] * c.chain.factor[i] + c.chain.offset[i]
    return q


@wp.func
def half_sides(c: Collisions, lower: Any, upper: Any, half: Any):
    """Half of what each joint's value spans in a box of coordinates, rounded up."""
    for i in range(len(half)):
        k = c.chain.coordinate[i]
        size = wp.max(wp.abs(lower[k]), wp.abs(upper[k]))
        part = ((upper[k] * _HALF - lower[k] * _HALF) * _OUTWARD + size * _BLUR) / c.weights[k] * _OUTWARD
        half[i] = part * wp.abs(c.chain.factor[i])
    return half


@wp.func
def meets(c: Collisions, s: Separation, pair: wp.vec2i, way: wp.float64) -> bool:
    """Do two bodies touch for certain, even if they go apart by some way?"""
    radii = (c.bodies.radius[pair[0]] + c.bodies.radius[pair[1]] + c.safety) * _INWARD - c.allowance
    return s.apart + way <= radii or s.depth > way + c.allowance


@wp.func
def truth(c: Collisions, p: Any, joints: Any, turns: Any, places: Any) -> wp.uint8:
    """Truth of one configuration. All but the first two arguments are zeros, here and below."""
    for i in range(len(p)):
        if not (wp.abs(p[i]) < _INFINITY and p[i] >= c.lower[i] and p[i] <= c.upper[i]):
            return wp.uint8(_OUT)
    q, answer = middle(c, p, p, joints), wp.uint8(_OUT)
    turn, at = placed(c.chain, q, turns, places)
    moving, center = wp.int32(-1), wp.vec3d()
    for number in range(c.pairs.shape[0]):
        pair = c.pairs[number]
        room = room_of(c, pair)
        if pair[1] != moving:
            moving = pair[1]
            center = center_of(c, turn, at, moving)
        if apart(c, turn, at, pair, center) > room:
            continue
        a, b = link(turn, at, c.bodies.link[pair[0]]), link(turn, at, c.bodies.link[pair[1]])
        s = separation(c.bodies, pair[0], a, pair[1], b, room)
        if not s.gap > room:
            if meets(c, s, pair, wp.float64(0.0)):
                return wp.uint8(_IN)
            answer = wp.uint8(_UNDECIDED)
    return answer


@wp.func
def losses_of(
    c: Collisions,
    turn: Any,
    at: Any,
    pair: int,
    normal: wp.vec3d,
    half: Any,
    slope: Any,
    coordinates: Any,
    rates: Any,
    second: Any,
):
    """What a linear function of a pair loses by each coordinate of a box.

    That is what the second order takes, and what the corners' slopes differ by.
    """
    p, parts = nearest(c, turn, at, pair, normal), type(coordinates)()
    steps, whole = rates_of(c, turn, at, pair, normal, rates) * p, bend(c, pair, half)
    for i in range(len(half)):
        parts[c.chain.coordinate[i]] += wp.abs(steps[i] - slope[i]) * half[i]
    rest = twist(c, pair, half)
    if rest < whole:
        second = second_of(c, turn, at, pair, normal, half, second)
    row, share = wp.int32(0), wp.min(rest, whole) / wp.max(whole, _TINY)
    for j in range(c.first[pair], c.first[pair + 1]):
        i = c.path[j]
        for k in range(j, c.first[pair + 1]):
            part = c.reach[k] * half[i] * half[c.path[k]] * share
            twice = wp.dot(second[row], p)
            if k == j:
                part *= _HALF
                twice = -wp.min(twice, _ZERO)
            part = (part + wp.abs(twice)) * _HALF
            parts[c.chain.coordinate[i]] += part
            parts[c.chain.coordinate[c.path[k]]] += part
            row += 1
    return parts


@wp.func
def box_answer(
    c: Collisions,
    low: Any,
    high: Any,
    asked: int,
    joints: Any,
    turns: Any,
    places: Any,
    rates: Any,
    second: Any,
):
    """What is certain about a closed box: ``FREE``, ``FULL`` or ``OPEN``; and its half-space if ``HALVES`` is asked.

    That is level, line, the axis to halve and what halving that gains; by default one that holds everything.
    """
    level, line, axis, loss, within = wp.float64(1.0), type(low)(), wp.int32(0), wp.float64(0.0), wp.bool(True)
    for i in range(len(low)):
        if not (low[i] <= high[i] and wp.abs(low[i]) < _INFINITY and wp.abs(high[i]) < _INFINITY):
            return wp.int32(_OPEN), level, line, axis, loss
        within = within and low[i] >= c.lower[i] and high[i] <= c.upper[i]
    q, half, small = middle(c, low, high, joints), half_sides(c, low, high, joints), wp.bool(True)
    for i in range(len(half)):
        small = small and half[i] <= _LARGEST_HALF
    turn, at = placed(c.chain, q, turns, places)
    normals, left, count, known = Normals(), Indices(), wp.int32(0), wp.bool(True)
    lowest, slope, arc = wp.float64(wp.inf), type(joints)(), arcs(c.chain, half)
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
            way = swept(c, number, arc)
        if apart(c, turn, at, pair, center) > room + way:
            continue
        a, b = link(turn, at, c.bodies.link[pair[0]]), link(turn, at, c.bodies.link[pair[1]])
        s = separation(c.bodies, pair[0], a, pair[1], b, room + way)
        if asked == _FULL:
            if within and meets(c, s, pair, way):
                return wp.int32(_FULL), level, line, axis, loss
            continue
        if s.gap > room + way:
            continue
        value = -wp.float64(wp.inf)
        if small and s.gap > -_INFINITY:
            value = bound(c, turn, at, number, s.normal, half, joints, rates, second)
            if value > _ZERO:
                continue
        known = known and count < _MOST_OPEN and value > -_INFINITY
        if asked == _FREE or not known:
            return wp.int32(_OPEN), level, line, axis, loss
        normals[count] = s.normal
        left[count] = number
        count += 1
        if value < lowest:
            lowest = value
            slope = rates_of(c, turn, at, number, s.normal, rates) * nearest(c, turn, at, number, s.normal)
    if asked == _FULL:
        return wp.int32(_OPEN), level, line, axis, loss
    if count == 0:
        return wp.int32(_FREE), level, line, axis, loss
    worst, least = wp.int32(0), wp.float64(wp.inf)
    for k in range(count):
        value = bound(c, turn, at, left[k], normals[k], half, slope, rates, second)
        if value < least:
            least, worst = value, k
    for i in range(len(half)):
        line[c.chain.coordinate[i]] -= slope[i] * c.chain.factor[i] / c.weights[c.chain.coordinate[i]]
    parts = losses_of(c, turn, at, left[worst], normals[worst], half, slope, low, rates, second)
    most = wp.float64(-1.0)
    for i in range(len(parts)):
        loss += parts[i]
        if parts[i] > most:
            axis, most = i, parts[i]
    return wp.int32(_OPEN), -least, line, axis, loss


@cache
def kernels_of(n: int, coordinates: int) -> Kernels:
    """The kernels for arms of n joints and as many coordinates or fewer."""
    which = f"{n}" if coordinates == n else f"{n}_{coordinates}"
    values = wp.types.vector(length=n, dtype=wp.float64)
    numbers = wp.types.vector(length=coordinates, dtype=wp.float64)
    turns = wp.types.matrix(shape=(3 * n, 3), dtype=wp.float64)
    places = wp.types.matrix(shape=(n, 3), dtype=wp.float64)
    rates = wp.types.matrix(shape=(n, 4), dtype=wp.float64)
    second = wp.types.matrix(shape=(n * (n + 1) // 2, 4), dtype=wp.float64)

    @named(f"arm_points_{which}").kernel
    def points(
        first: int,
        # inputs
        c: Collisions,
        x: wp.array(dtype=numbers),
        # outputs
        answers: wp.array(dtype=wp.uint8),
    ):
        """Truth of configurations."""
        t, _ = wp.tid()
        t += first
        answers[t] = truth(c, x[t], values(), turns(), places())

    @named(f"arm_boxes_{which}").kernel
    def boxes(
        first: int,
        # inputs
        c: Collisions,
        lower: wp.array(dtype=numbers),
        upper: wp.array(dtype=numbers),
        asked: int,
        # outputs
        answers: wp.array(dtype=wp.uint8),
        levels: wp.array(dtype=wp.float64),
        lines: wp.array(dtype=numbers),
        axes: wp.array(dtype=wp.int32),
        losses: wp.array(dtype=wp.float64),
    ):
        """``box_answer`` of closed boxes within the limits; half-spaces are written where they are asked."""
        t, _ = wp.tid()
        t += first
        answer, level, line, axis, loss = box_answer(
            c, lower[t], upper[t], asked, values(), turns(), places(), rates(), second()
        )
        answers[t] = wp.uint8(answer)
        if asked == _HALVES:
            levels[t] = level
            lines[t] = line
            axes[t] = axis
            losses[t] = loss

    return Kernels(points, boxes)
