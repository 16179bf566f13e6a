"""How far two hulls of points are apart, in float64: a direction that proves it, and two points that are so near.

For any vector n, however it was found, every point b of one hull and every point a of the other have ``n . (b - a) >= gap``, where the gap
is the least of ``n . b`` less the largest of ``n . a`` over the corners. So the gap over the length of n is a lower bound of the
distance that rests on nothing but two sums over corners. The search for a good n may be as careless as it likes. It is the algorithm
of Gilbert, Johnson and Keerthi: of the differences ``b - a`` it keeps up to four whose hull comes ever nearer to 0.

Where 0 lies inside of four differences, the hulls meet, and ``depth`` tells how far 0 is from their faces: by so much the corners may
be off and the hulls still meet.

Source: Gilbert, Johnson, Keerthi, "A fast procedure for computing the distance between complex objects in three-dimensional space" (1988).
"""

import warp as wp

__all__ = ["Bodies", "Place", "Separation", "corner", "farthest", "separation"]

ROUNDS = wp.constant(32)  # of the search; most pairs take 3 to 6
_CLOSE = wp.constant(wp.float64(1e-10))  # of the distance found: a search whose bounds are so close ends
# Of the longest difference L of four corners. Where every height of their hull is above 2^-12 L, a face has an area of 2^-25 L^2 or more, so that its
# normal, a cross product of edges, is off by 2^-25 at most, and what it tells of 0 by less than 2^-24 L.
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
    first: wp.array(dtype=wp.int32)  # corner of each body, and behind the last one their number
    link: wp.array(dtype=wp.int32)
    radius: wp.array(dtype=wp.float64)
    center: wp.array(dtype=wp.vec3d)  # of a ball that holds the corners
    ball: wp.array(dtype=wp.float64)


@wp.struct
class Place:
    """Where a link is."""

    turn: wp.mat33d
    at: wp.vec3d


@wp.struct
class Separation:
    """What is known of two hulls."""

    normal: wp.vec3d  # of length 1, about
    gap: wp.float64  # see module; minus infinity where no direction is known
    apart: wp.float64  # the hulls have points that are so far from each other
    depth: wp.float64  # above 0 where the hulls meet


@wp.func
def corner(bodies: Bodies, place: Place, i: int) -> wp.vec3d:
    """A corner where its link is."""
    return place.turn * bodies.points[i] + place.at


@wp.func
def farthest(bodies: Bodies, body: int, place: Place, direction: wp.vec3d) -> wp.vec3d:
    """The corner that lies farthest in a direction."""
    local = wp.transpose(place.turn) * direction
    begin, end = wp.int32(bodies.first[body]), wp.int32(bodies.first[body + 1])
    best, most = wp.int32(begin), wp.dot(local, bodies.points[begin])
    for i in range(begin + 1, end):
        value = wp.dot(local, bodies.points[i])
        if value > most:
            best, most = i, value
    return corner(bodies, place, best)


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
    """How far 0 is from the plane of a face, above 0 on the side of the fourth corner; below 0 where the four are nearly in a plane."""
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
    """Search for a direction that tells two hulls apart.

    Args:
        bodies: All of them.
        one: The body a of the module's text.
        at_one: Where its link is.
        other: The body b.
        at_other: Where its link is.
        enough: A gap beyond which no larger one is looked for.
    """
    found = Separation()
    found.gap = -_INFINITY
    found.apart = _INFINITY
    found.depth = -_INFINITY
    s = Corners()
    count, rounds, last = wp.int32(0), wp.int32(ROUNDS), wp.int32(0)
    nearest = corner(bodies, at_other, bodies.first[other]) - corner(bodies, at_one, bodies.first[one])
    while rounds > 0:
        rounds -= 1
        length = wp.length(nearest)
        found.apart = wp.min(found.apart, length)
        if not length > _TINY:
            break
        normal = nearest / length
        new = farthest(bodies, other, at_other, -normal) - farthest(bodies, one, at_one, normal)
        gap = wp.dot(normal, new)
        if gap > found.gap:
            found.gap = gap
            found.normal = normal
        if gap > enough or length - gap <= _CLOSE * length:
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
