"""Kernels of a picture with shadows: what a pixel shows, which face the sun, their rays, and which are stopped.

Each item writes to places of its own, so launches may be dealt out to several cores.
"""

import warp as wp

__all__ = ["Camera", "cast", "face_sun", "see_floor", "see_mesh", "stop"]

PIXEL = wp.constant(0.5)  # the middle of one


@wp.struct
class Camera:
    """A pinhole camera; ``right`` and ``up`` are half the picture's width and height at distance 1."""

    eye: wp.vec3
    forward: wp.vec3
    right: wp.vec3
    up: wp.vec3
    width: int
    height: int


@wp.func
def _towards(camera: Camera, pixel: int) -> wp.vec3:
    """Unit direction in which a pixel looks; pixel 0 is the upper left one."""
    column, row = pixel % camera.width, pixel // camera.width
    x = 2.0 * (float(column) + PIXEL) / float(camera.width) - 1.0
    y = 1.0 - 2.0 * (float(row) + PIXEL) / float(camera.height)
    return wp.normalize(camera.forward + camera.right * x + camera.up * y)


@wp.kernel(enable_backward=False)
def see_floor(
    # inputs
    first: int,
    camera: Camera,
    floor: float,
    farthest: float,
    # outputs
    depths: wp.array(dtype=float),
    things: wp.array(dtype=wp.int8),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    smooth: wp.array(dtype=wp.vec3),
):
    """Begin a picture: the floor, thing 0, or nothing, thing -1."""
    thread, _ = wp.tid()
    pixel = first + thread
    d = _towards(camera, pixel)
    depths[pixel] = farthest
    things[pixel] = wp.int8(-1)
    up = wp.vec3(0.0, 1.0, 0.0)
    normals[pixel] = up
    smooth[pixel] = up
    if d[1] < 0.0:
        t = (floor - camera.eye[1]) / d[1]
        if t < farthest:
            depths[pixel] = t
            things[pixel] = wp.int8(0)
            points[pixel] = wp.vec3(camera.eye[0] + t * d[0], floor, camera.eye[2] + t * d[2])


@wp.kernel(enable_backward=False)
def see_mesh(
    # inputs
    first: int,
    camera: Camera,
    mesh: wp.uint64,
    thing: int,
    corners: wp.array(dtype=wp.vec3),
    # outputs
    depths: wp.array(dtype=float),
    things: wp.array(dtype=wp.int8),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    smooth: wp.array(dtype=wp.vec3),
):
    """Add a mesh to a picture, where it is nearer than what is there.

    ``corners``: a normal for each corner of each face.
    """
    thread, _ = wp.tid()
    pixel = first + thread
    d = _towards(camera, pixel)
    hit = wp.mesh_query_ray(mesh, camera.eye, d, depths[pixel])
    if not hit.result:
        return
    n = wp.mesh_eval_face_normal(mesh, hit.face)
    s = corners[3 * hit.face] * hit.u + corners[3 * hit.face + 1] * hit.v
    s = wp.normalize(s + corners[3 * hit.face + 2] * (1.0 - hit.u - hit.v))
    if wp.dot(n, d) > 0.0:
        n = -n
        s = -s
    depths[pixel] = hit.t
    things[pixel] = wp.int8(thing)
    points[pixel] = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
    normals[pixel] = n
    smooth[pixel] = s


@wp.kernel(enable_backward=False)
def face_sun(
    # inputs
    first: int,
    sun: wp.vec3,
    normals: wp.array(dtype=wp.vec3),
    # outputs
    facing: wp.array(dtype=wp.bool),
):
    """Which surfaces face the sun; the others are dark without a ray."""
    thread, _ = wp.tid()
    i = first + thread
    facing[i] = wp.dot(normals[i], sun) > 0.0


@wp.kernel(enable_backward=False)
def cast(
    # inputs
    first: int,
    sun: wp.vec3,
    lift: float,
    chosen: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    # outputs
    rays: wp.array2d(dtype=float),
):
    """The shadow ray of a surface point: from a little above it, towards the sun."""
    thread, _ = wp.tid()
    i = first + thread
    o = points[chosen[i]] + normals[chosen[i]] * lift
    for k in range(3):
        rays[i, k] = o[k]
        rays[i, 3 + k] = sun[k]


@wp.kernel(enable_backward=False)
def stop(
    # inputs
    first: int,
    mesh: wp.uint64,
    rays: wp.array2d(dtype=float),
    reach: float,
    tolerance: float,
    candidates: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    # outputs
    stopped: wp.array(dtype=wp.bool),
):
    """Whether a mesh stops a ray: the narrow phase.

    A hit counts if the ray does pass the point of the face that was named.
    """
    thread, _ = wp.tid()
    item = first + thread
    if item >= count[0]:
        return
    i = candidates[item]
    o = wp.vec3(rays[i, 0], rays[i, 1], rays[i, 2])
    d = wp.vec3(rays[i, 3], rays[i, 4], rays[i, 5])
    hit = wp.mesh_query_ray(mesh, o, d, reach)
    if not hit.result:
        return
    u = wp.clamp(hit.u, 0.0, 1.0)
    v = wp.clamp(hit.v, 0.0, 1.0 - u)
    off = wp.mesh_eval_position(mesh, hit.face, u, v) - (o + d * hit.t)
    if wp.length(off) <= tolerance:
        stopped[i] = True
