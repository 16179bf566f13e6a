"""What happens to a particle: it falls; where it meets the mesh it is pushed out and slides, or seeps through.

The narrow phase writes to a particle only where it finds a contact, and it is the same compiled kernel in all runs:
leaving out a particle without a contact changes nothing. Of a porous mesh it says of each particle whether it is in
contact, and nothing else: a particle of which that is known need not be asked about.
"""

import warp as wp

__all__ = ["DT", "RADIUS", "Rain", "box_mask", "box_of", "collide", "integrate", "seep", "split", "touch", "with_time"]

RADIUS = 0.01  # of a particle: the contact distance, object units (the bunny is 1.6 of them high)
DT = 1.0 / 120.0
GRAVITY = 9.81
DRAG = 2.8  # per second: rain falls at GRAVITY / DRAG
SEEPING = 20.0  # per second: more drag, at what is in or touches a porous mesh
WIND = 0.45  # along x
FRICTION = 0.2
RESTITUTION = 0.25
LONGEST_LIFE = 180  # steps; what comes to rest in a hollow begins again, too
RAYS = 3  # that confirm an inside sign


@wp.struct
class Rain:
    """The box that the rain falls through, upper face shifted into the wind."""

    lower: wp.vec3
    upper: wp.vec3
    shift: float
    speed: float


@wp.kernel(enable_backward=False)
def integrate(
    # inputs
    first: int,
    rain: Rain,
    seed: int,
    # outputs
    positions: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
    ages: wp.array(dtype=wp.int32),
    lives: wp.array(dtype=wp.int32),
    contacts: wp.array(dtype=wp.bool),
):
    """Move one particle, as if there were no bunny.

    A new life begins at a place that depends on seed, particle and life only.
    """
    thread, _ = wp.tid()
    i = first + thread
    x = wp.vec3(positions[i])
    v = wp.vec3(velocities[i])
    age = ages[i] + 1
    if x[1] < rain.lower[1] or age > LONGEST_LIFE:
        life = lives[i] + 1
        lives[i] = life
        age = 0
        state = wp.rand_init(seed + 7919 * life, i)
        x = wp.vec3(
            rain.lower[0] + wp.randf(state) * (rain.upper[0] - rain.lower[0]) - rain.shift,
            rain.upper[1] + wp.randf(state) * rain.speed * DT,
            rain.lower[2] + wp.randf(state) * (rain.upper[2] - rain.lower[2]),
        )
        v = wp.vec3(WIND, -rain.speed, 0.0)
    v = v + (wp.vec3(0.0, -GRAVITY, 0.0) - DRAG * (v - wp.vec3(WIND, 0.0, 0.0))) * DT
    positions[i] = x + v * DT
    velocities[i] = v
    ages[i] = age
    contacts[i] = False


@wp.func
def closest(mesh: wp.uint64, x: wp.vec3, reach: float):
    """The closest point of the mesh within reach, and on which side of it x is."""
    query = wp.mesh_query_point_sign_parity(mesh, x, reach)
    if query.result and query.sign < 0.0:  # seldom, and a wrong one would do harm: let more rays confirm it
        query = wp.mesh_query_point_sign_parity(mesh, x, reach, RAYS)
    return query


@wp.kernel(enable_backward=False)
def collide(
    # inputs
    first: int,
    mesh: wp.uint64,
    reach: float,
    candidates: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    # outputs
    positions: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
    contacts: wp.array(dtype=wp.bool),
):
    """Push a candidate out to the contact distance, with friction and a little bounce; write only in contact."""
    thread, _ = wp.tid()
    item = first + thread
    if item >= count[0]:
        return
    i = candidates[item]
    x = positions[i]
    query = closest(mesh, x, reach)
    if not query.result:
        return
    away = x - wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    distance = wp.length(away) * query.sign
    if distance >= RADIUS:
        return
    n = wp.mesh_eval_face_normal(mesh, query.face)  # for a particle that lies in the surface itself
    if wp.length(away) > 0.0:
        n = wp.normalize(away) * query.sign
    surface = wp.mesh_eval_velocity(mesh, query.face, query.u, query.v)
    v = velocities[i] - surface
    into = wp.dot(v, n)
    if into < 0.0:
        along = v - n * into
        sliding = wp.length(along)
        kept = 0.0
        if sliding > 0.0:
            kept = wp.max(0.0, 1.0 + FRICTION * into / sliding)
        velocities[i] = surface + along * kept - n * (RESTITUTION * into)
    positions[i] = x + n * (RADIUS - distance)
    contacts[i] = True


@wp.kernel(enable_backward=False)
def touch(
    # inputs
    first: int,
    mesh: wp.uint64,
    reach: float,
    candidates: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    positions: wp.array(dtype=wp.vec3),
    # outputs
    contacts: wp.array(dtype=wp.bool),
):
    """Whether one candidate is in contact, by the same numbers as in ``collide``."""
    thread, _ = wp.tid()
    item = first + thread
    if item >= count[0]:
        return
    i = candidates[item]
    x = positions[i]
    query = closest(mesh, x, reach)
    if not query.result:
        return
    away = x - wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    if wp.length(away) * query.sign < RADIUS:
        contacts[i] = True


@wp.kernel(enable_backward=False)
def seep(
    # inputs
    first: int,
    contacts: wp.array(dtype=wp.bool),
    # outputs
    velocities: wp.array(dtype=wp.vec3),
):
    """Slow a particle down that is in contact."""
    thread, _ = wp.tid()
    i = first + thread
    if contacts[i]:
        velocities[i] = velocities[i] * (1.0 - SEEPING * DT)


@wp.kernel(enable_backward=False)
def split(
    # inputs
    first: int,
    answers: wp.array(dtype=wp.uint8),
    # outputs
    maybe: wp.array(dtype=wp.bool),
    certain: wp.array(dtype=wp.bool),
):
    """What a two-sided bounder has answered (``warp_bounding.two_sided``), as two masks."""
    thread, _ = wp.tid()
    i = first + thread
    maybe[i] = answers[i] == wp.uint8(1)
    certain[i] = answers[i] == wp.uint8(2)


@wp.kernel(enable_backward=False)
def with_time(
    # inputs
    first: int,
    time: float,
    positions: wp.array(dtype=wp.vec3),
    # outputs
    queries: wp.array(dtype=wp.vec4),
):
    """What a bounder of the motion is asked: time and place."""
    thread, _ = wp.tid()
    i = first + thread
    x = positions[i]
    queries[i] = wp.vec4(time, x[0], x[1], x[2])


@wp.kernel(enable_backward=False)
def box_of(
    # inputs
    points: wp.array(dtype=wp.vec3),
    # outputs
    box: wp.array(dtype=wp.vec3),
):
    """The box around all vertices; ``box`` holds infinity and minus infinity before."""
    thread, _ = wp.tid()
    x = points[thread]
    wp.atomic_min(box, 0, x)
    wp.atomic_max(box, 1, x)


@wp.kernel(enable_backward=False)
def box_mask(
    # inputs
    first: int,
    box: wp.array(dtype=wp.vec3),
    margin: float,
    positions: wp.array(dtype=wp.vec3),
    # outputs
    mask: wp.array(dtype=wp.bool),
):
    """True where a particle lies in the box, dilated by the margin."""
    thread, _ = wp.tid()
    i = first + thread
    x = positions[i]
    inside = wp.bool(True)
    for k in range(3):
        if x[k] < box[0][k] - margin or x[k] > box[1][k] + margin:
            inside = wp.bool(False)
    mask[i] = inside
