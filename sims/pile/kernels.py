"""Kernels of rigid bodies in a box: which pairs boxes leave, contacts of a pair, and a step of a body.

A body meets another one where points of its surface are in the other's mesh, or nearer than ``CONTACT``. The force of a
pair, one way, is the mean over these points, weighted by depth, of a spring, a damper and friction; so it changes
without jumps as points come and go. Each pair's forces are kept in places of their own, and a body adds them up in the
order of its partners. A pair without contacts adds nothing, not even a zero. So a broad phase that denies such pairs
changes no bit of the result.
"""

from functools import cache

import warp as wp

import warp_bounding as wb

__all__ = ["CONTACT", "DT", "GAP", "Bodies", "apart_kernel", "meet", "move", "spheres", "turned"]

DT = wp.constant(1.0 / 240.0)  # seconds
CONTACT = wp.constant(0.01)  # how near surfaces touch; a bunny is 1 wide
GAP = 1.01 * CONTACT  # of broad phases: more than what rounds in a distance, which is under 2e-5
DEPTH = wp.constant(0.06)  # how deep a point may be to be pushed out
SPRING, DAMPER, FRICTION = wp.constant(2000.0), wp.constant(6.0), wp.constant(0.5)
STILL, PARALLEL = wp.constant(1.0e-9), wp.constant(1.0e-6)  # a speed, and a squared length, with no direction
DRAG, GRAVITY = wp.constant(0.6), wp.constant(9.8)


@wp.struct
class Bodies:
    """What is constant: the kind of each body, and of each kind what follows."""

    kinds: wp.array(dtype=int)
    meshes: wp.array(dtype=wp.uint64)
    points: wp.array2d(dtype=wp.vec3)
    middles: wp.array(dtype=wp.vec3)  # of its box
    halves: wp.array(dtype=wp.vec3)
    radii: wp.array(dtype=float)  # around the centre of mass, which is the origin
    masses: wp.array(dtype=float)
    inertias: wp.array(dtype=wp.mat33)  # inverse
    side: float  # of the box, half


@wp.kernel(enable_backward=False)
def spheres(first: int, bodies: Bodies, places: wp.array(dtype=wp.transform), near: wp.array2d(dtype=wp.bool)):
    """Which pairs of bodies i < j have bounding spheres within ``GAP``."""
    thread, _ = wp.tid()
    i = first + thread
    x, radius = wp.transform_get_translation(places[i]), bodies.radii[bodies.kinds[i]]
    for j in range(i + 1, places.shape[0]):
        away = wp.length(wp.transform_get_translation(places[j]) - x)
        near[i, j] = away <= radius + bodies.radii[bodies.kinds[j]] + wp.static(GAP)


@wp.func
def _apart(axis: wp.vec3, way: wp.vec3, a: wp.mat33, halves_a: wp.vec3, b: wp.mat33, halves_b: wp.vec3) -> bool:
    """Whether two boxes, axes in the columns of a and b, are apart along an axis."""
    reach = wp.static(GAP) * wp.length(axis)
    reach += wp.dot(halves_a, wp.abs(wp.transpose(a) * axis)) + wp.dot(halves_b, wp.abs(wp.transpose(b) * axis))
    return wp.abs(wp.dot(way, axis)) > reach


@wp.kernel(enable_backward=False)
def turned(
    # inputs
    first: int,
    bodies: Bodies,
    places: wp.array(dtype=wp.transform),
    pairs: wp.array(dtype=wp.vec2i),
    oriented: bool,
    # outputs
    near: wp.array(dtype=wp.bool),
):
    """Which pairs have boxes within ``GAP``: along the world's axes, or the bodies' own and their cross products."""
    thread, _ = wp.tid()
    i, j = pairs[first + thread][0], pairs[first + thread][1]
    k, m = bodies.kinds[i], bodies.kinds[j]
    a = wp.quat_to_matrix(wp.transform_get_rotation(places[i]))
    b = wp.quat_to_matrix(wp.transform_get_rotation(places[j]))
    way = wp.transform_point(places[j], bodies.middles[m]) - wp.transform_point(places[i], bodies.middles[k])
    own, other = bodies.halves[k], bodies.halves[m]
    world = wp.identity(n=3, dtype=float)
    apart = wp.bool(False)
    for u in range(3):
        if not oriented:
            apart = apart or _apart(world[u], way, a, own, b, other)
        else:
            across = wp.transpose(a)[u]
            apart = apart or _apart(across, way, a, own, b, other)
            apart = apart or _apart(wp.transpose(b)[u], way, a, own, b, other)
            for v in range(3):
                axis = wp.cross(across, wp.transpose(b)[v])
                if wp.length_sq(axis) > PARALLEL:
                    apart = apart or _apart(axis, way, a, own, b, other)
    near[first + thread] = not apart


@cache
def apart_kernel(bunny: wp.Function, ring: wp.Function) -> wp.Kernel:
    """Which pairs may be within ``GAP``, all in one launch.

    Args:
        bunny: ``wb.pairs.Pair.func`` where the first mesh is a bunny.
        ring: The same of a ring.
    """

    @wp.kernel(module="unique", enable_backward=False)
    def apart(
        # inputs
        first: int,
        bunnies: wb.pairs.PairData,
        mixed: wb.pairs.PairData,
        rings: wb.pairs.PairData,
        bodies: Bodies,
        places: wp.array(dtype=wp.transform),
        pairs: wp.array(dtype=wp.vec2i),
        # outputs
        near: wp.array(dtype=wp.bool),
    ):
        thread, _ = wp.tid()
        i, j = pairs[first + thread][0], pairs[first + thread][1]
        if bodies.kinds[i] > bodies.kinds[j]:
            i, j = j, i
        a, b, gap = places[i], places[j], float(wp.static(GAP))
        if bodies.kinds[i] == 1:
            near[first + thread] = ring(rings, a, b, gap)
        elif bodies.kinds[j] == 1:
            near[first + thread] = bunny(mixed, a, b, gap)
        else:
            near[first + thread] = bunny(bunnies, a, b, gap)

    return apart


@wp.func
def _push(depth: float, normal: wp.vec3, speed: wp.vec3) -> wp.vec3:
    """Force on a point that is so deep behind a surface and moves against it so fast."""
    outwards = wp.dot(speed, normal)
    pressure = wp.max(SPRING * depth - DAMPER * outwards, 0.0)
    along = speed - outwards * normal
    slip = wp.length(along)
    force = pressure * normal
    if slip > STILL:
        force -= along * (wp.min(FRICTION * pressure, DAMPER * slip) / slip)
    return force


@wp.kernel(enable_backward=False)
def meet(
    # inputs
    first: int,
    bodies: Bodies,
    places: wp.array(dtype=wp.transform),
    linear: wp.array(dtype=wp.vec3),
    angular: wp.array(dtype=wp.vec3),
    pairs: wp.array(dtype=wp.vec2i),
    # outputs
    touch: wp.array2d(dtype=wp.bool),
    forces: wp.array2d(dtype=wp.vec3),
    torques: wp.array2d(dtype=wp.vec3),
    back: wp.array2d(dtype=wp.vec3),
):
    """The narrow phase: points of one body against the mesh of the other; two items a pair, one each way.

    ``touch[i, j]`` says whether points of body i meet body j; then ``forces`` and ``torques`` act on i, and the
    opposite force and the torque ``back`` on j.
    """
    thread, _ = wp.tid()
    item = first + thread
    own = item % 2
    i, j = pairs[item // 2][own], pairs[item // 2][1 - own]
    mesh, at, into = bodies.meshes[bodies.kinds[j]], places[i], wp.transform_inverse(places[j])
    x, other = wp.transform_get_translation(at), wp.transform_get_translation(places[j])
    force, torque, opposite, weight = wp.vec3(), wp.vec3(), wp.vec3(), wp.float32(0.0)
    for k in range(bodies.points.shape[1]):
        p = wp.transform_point(at, bodies.points[bodies.kinds[i], k])
        y = wp.transform_point(into, p)
        query = wp.mesh_query_point_sign_parity(mesh, y, DEPTH)
        if query.result:
            away = y - wp.mesh_eval_position(mesh, query.face, query.u, query.v)
            far = wp.length(away)
            depth = CONTACT - query.sign * far
            if depth > 0.0 and far > 0.0:
                normal = wp.transform_vector(places[j], away * (query.sign / far))
                speed = linear[i] + wp.cross(angular[i], p - x) - linear[j] - wp.cross(angular[j], p - other)
                f = depth * _push(depth, normal, speed)
                force += f
                torque += wp.cross(p - x, f)
                opposite -= wp.cross(p - other, f)
                weight += depth
    touch[i, j] = weight > 0.0
    if weight > 0.0:
        forces[i, j] = force / weight
        torques[i, j] = torque / weight
        back[i, j] = opposite / weight


@wp.kernel(enable_backward=False)
def move(
    # inputs
    first: int,
    bodies: Bodies,
    touch: wp.array2d(dtype=wp.bool),
    forces: wp.array2d(dtype=wp.vec3),
    torques: wp.array2d(dtype=wp.vec3),
    back: wp.array2d(dtype=wp.vec3),
    # outputs
    places: wp.array(dtype=wp.transform),
    linear: wp.array(dtype=wp.vec3),
    angular: wp.array(dtype=wp.vec3),
):
    """A step of a body: all that pushes it, in the order of its partners, then floor and walls."""
    thread, _ = wp.tid()
    i = first + thread
    kind, x, q = bodies.kinds[i], wp.transform_get_translation(places[i]), wp.transform_get_rotation(places[i])
    mass, v, w = bodies.masses[kind], linear[i], angular[i]
    force, torque = wp.vec3(0.0, 0.0, -GRAVITY * mass), wp.vec3()
    for j in range(touch.shape[0]):
        if touch[i, j]:
            force += forces[i, j]
            torque += torques[i, j]
        if touch[j, i]:
            force -= forces[j, i]
            torque += back[j, i]
    for plane in range(5):
        normal = wp.vec3(0.0, 0.0, 1.0)
        beyond = wp.float32(0.0)
        if plane < 4:
            beyond = -bodies.side
            normal[2] = 0.0
            normal[plane // 2] = float(1 - 2 * (plane % 2))
        if wp.dot(x, normal) - beyond < bodies.radii[kind] + CONTACT:
            pushed, twist, weight = wp.vec3(), wp.vec3(), wp.float32(0.0)
            for k in range(bodies.points.shape[1]):
                arm = wp.quat_rotate(q, bodies.points[kind, k])
                depth = CONTACT + beyond - wp.dot(x + arm, normal)
                if depth > 0.0:
                    f = depth * _push(depth, normal, v + wp.cross(w, arm))
                    pushed += f
                    twist += wp.cross(arm, f)
                    weight += depth
            if weight > 0.0:
                force += pushed / weight
                torque += twist / weight
    turns = wp.quat_to_matrix(q)
    slower = 1.0 - DT * DRAG
    moving = (v + DT * force / mass) * slower
    turning = (w + DT * (turns * (bodies.inertias[kind] * (wp.transpose(turns) * torque)))) * slower
    turn = wp.quat(turning[0], turning[1], turning[2], 0.0) * q
    places[i] = wp.transform(x + DT * moving, wp.normalize(q + 0.5 * DT * turn))
    linear[i] = moving
    angular[i] = turning
