"""Warp functions of a pair: a lower bound of the distance between a placed mesh and a placed tree of balls.

Mesh A has a distance bounder, ``g(y) <= distance(y, A)``; mesh B lies in balls ``(c, r)``. Both are placed: a point x
of A is at ``p_a + R_a (s_a x)``, with the rotation R of a quaternion divided by its length, and a scale for each
axis. In A's coordinates a ball's centre is ``y = (R_a^T (R_b (s_b c) + p_b - p_a)) / s_a``. With ``least`` the
smallest size of s_a and ``most`` the largest of s_b, all of B in the ball is at least ``least distance(y, A) - most
r`` from A.

*Rounding*, with u = 2^-24. Let e be the error of the computed y in A's axes times s_a, in world units. Quaternions
whose squared length is within ``OFF`` of 1 are taken; their product is off by 5 u in each number, and so an entry of
its matrix by 34 u, and by ``4 OFF = 84 u`` since its length is not quite 1, what is computed of it included: 118 u in
all. ``M = R s_b / s_a`` rounds by 2 u more, and the sum of four products by 5 u. So the part of c in each coordinate
of e is under ``126 u |s_b c|_1``. A difference of places rounds by u, an entry of R_a by 5 u and ``2 OFF = 42 u``,
sums and the quotient by 9 u: its part is under ``58 u |p_b - p_a|_1``. The length of e is at most sqrt(3) times
these, and ``ROUNDING = 256 u`` of both outweighs that and what rounds in the sums themselves. Results that are set to
zero err by under 2^-84, as scales lie between ``SMALL`` and ``LARGE``; ``LEAST`` is more. So ``least g(y) - |e| -
most r`` is at most the true distance. Its two products and the difference round by at most three units each, which
``SHORTER`` and ``LONGER`` outweigh.

A node's ball holds those of its children, so what is known of it holds for them. A query ends with *maybe* at the
first leaf that is not farther than the gap, and with *no* when no ball is left; a distance is the least of all leaves
that could be the nearest. Other quaternions or scales, another source's data and numbers that are not finite:
*maybe*, 0.

*Moving* (``contact_func``): places move by constant velocities, rotations turn about constant axes in the world, so no
point of the two comes nearer to one of the other faster than ``|v_b - v_a| + |w_a| reach_a + |w_b| reach_b``. A march
begins at time 0 and goes on by (distance - gap) over that speed, which ``REST`` keeps above 0. Placements at a time are
computed in float64, also sine and cosine, which options of a module do not touch, and rounded once: by u of each
place's numbers, and by 4 u of what a mesh reaches from its origin; ``MOVED`` of both outweighs it.
"""

from functools import cache

import warp as wp

from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.kernels.functions import Data, Words, lanes_of
from warp_bounding.kernels.source import LABEL, Lanes
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.native import Numbers, fill, literal, named, native_text, unique_name

GROUP = 8  # balls that are asked together
STACK = 256  # groups that wait at most; more than ``balls.MOST`` balls can ask for, of which some go depth first
OFF = 1.0e-6  # by how much a quaternion's squared length may differ from 1
ROUNDING, LEAST = 256 * UNIT32, 2.0**-80
SHORTER, LONGER = 1.0 - 2.0**-20, 1.0 + 2.0**-20
SMALL, LARGE = 2.0**-40, 2.0**40  # sizes of scales
MOVED = 8 * UNIT32  # of places and reaches
REST = 2.0**-120  # added to speeds: more than what is set to zero
STEPS = 64  # of ``contact_time``, where no number is given

text = native_text("pairs.h")
_ALONE = (text.LANE, text.ALONE)
_CONSTANTS = {
    "off": OFF,
    "room": ROUNDING,
    "least": LEAST,
    "shorter": SHORTER,
    "longer": LONGER,
    "small": SMALL,
    "large": LARGE,
}
_PLACES = {
    "pa": "wp::transform_get_translation(xform_a)",
    "pb": "wp::transform_get_translation(xform_b)",
    **{f"q{s}": ", ".join(f"wp::transform_get_rotation(xform_{s}).{k}" for k in "xyzw") for s in "ab"},
}
Links = wp.array(dtype=wp.int32)


@wp.struct
class PairData:
    """What a pair's function needs in addition to the two placements; pass it to your kernel as an argument.

    Attributes:
        bounder: The data of the distance bounder.
        slots: The balls in groups of eight: all their x, y, z, then radii.
        links: The group of each ball's children, -1 for a leaf.
        reach_a: How far mesh A reaches from its origin at most, in its own units.
        reach_b: The same of the balls.

    Example:
        >>> wb.pairs.Pair(far, balls).data.links.dtype.__name__
        'int32'
    """

    bounder: Data
    slots: Numbers
    links: Links
    reach_a: float
    reach_b: float


def search_texts(source: DistanceSource, lanes: Lanes) -> dict[str, object]:
    """What the C texts of the search have in common; ``lanes`` are those of one ball alone."""
    texts = source.around(placed=False, values=True) | {"scalar_body": source.body(lanes), "rotation": text.ROTATION}
    return texts | {"group": GROUP, "stack": STACK} | {name: literal(value) for name, value in _CONSTANTS.items()}


def search_alone(source: DistanceSource) -> str:
    """C text of the search of one ball after another, in an export, from ``place_a`` to ``place_b``."""
    texts = search_texts(source, Lanes(vector=False, alone=True))
    places = {f"p{s}": f"place_{s}" for s in "ab"}
    places |= {f"q{s}": ", ".join(f"place_{s}[{k}]" for k in range(3, 7)) for s in "ab"}
    return fill(text.SEARCH, **texts, **places, types="", looked=fill(text.ALONE, **texts))


@cache
def closest_func(source: DistanceSource) -> wp.Function:
    """``closest(data, xform_a, xform_b, scale_a, scale_b, gap, exact) -> float``.

    Where ``exact``, the lower bound of the distance, for an infinite gap. Else a number above the gap where the two are
    certainly farther apart, and one that is not otherwise.
    """
    first, second = source.tag
    texts = search_texts(source, Lanes(vector=False)) | {"body": source.body(Lanes(vector=True))}
    texts |= {"lanes": lanes_of(source), "label": LABEL, "first": first, "second": second}
    cpu, cuda = ([fill(part, **texts) for part in parts] for parts in ((text.LANES, text.TOGETHER), _ALONE))
    types, looked = (f"#if !defined(__CUDA_ARCH__)\n{a}\n#else\n{b}\n#endif" for a, b in zip(cpu, cuda, strict=True))
    search = fill(text.SEARCH, **texts, **_PLACES, types=types, looked=looked)
    name = named(unique_name(source, "pair"))

    @name.func_native(fill(text.CHECK, **texts) + search)
    def native_closest(
        parameters: Numbers,
        words: Words,
        slots: Numbers,
        links: Links,
        xform_a: wp.transform,
        xform_b: wp.transform,
        scale_a: wp.vec3,
        scale_b: wp.vec3,
        gap: float,
        exact: bool,
    ) -> float: ...

    @name.func
    def closest(
        data: PairData,
        xform_a: wp.transform,
        xform_b: wp.transform,
        scale_a: wp.vec3,
        scale_b: wp.vec3,
        gap: float,
        exact: bool,
    ) -> float:
        own = data.bounder
        return native_closest(
            own.parameters, own.words, data.slots, data.links, xform_a, xform_b, scale_a, scale_b, gap, exact
        )

    return closest


_SPEED, _LATER, _MOVED = wp.constant(1.0 + 2.0**-18), wp.constant(1.0 - 2.0**-18), wp.constant(MOVED)
_REST = wp.constant(REST)


@wp.func
def _size(v: wp.vec3) -> float:
    return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])


@wp.func
def _length(v: wp.vec3) -> float:
    """Above what is set to zero; in float64, which holds the square of any float32 number."""
    return float(wp.length(wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2])))) + _REST


@wp.func
def moved(xform: wp.transform, linear: wp.vec3, angular: wp.vec3, t: float) -> wp.transform:
    """A placement after a time, computed in float64."""
    p, q, at = wp.transform_get_translation(xform), wp.transform_get_rotation(xform), wp.float64(t)
    place = wp.vec3()
    for k in range(3):
        place[k] = float(wp.float64(p[k]) + wp.float64(linear[k]) * at)
    w = wp.vec3d(wp.float64(angular[0]), wp.float64(angular[1]), wp.float64(angular[2]))
    speed = wp.length(w)
    turn = wp.quatd(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
    if speed > wp.float64(0.0):
        half = speed * at * wp.float64(0.5)
        axis = w * (wp.sin(half) / speed)
        turn = wp.quatd(axis[0], axis[1], axis[2], wp.cos(half))
    found = turn * wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3]))
    return wp.transform(place, wp.quat(float(found[0]), float(found[1]), float(found[2]), float(found[3])))


@cache
def contact_func(source: DistanceSource) -> wp.Function:
    """``contact(data, xform_a, xform_b, scale_a, scale_b, velocity_a, velocity_b, gap, duration, steps)``.

    Velocities are ``(linear, angular)`` vectors, ``wp.vec3`` each, in the order v_a, w_a, v_b, w_b. Returns
    ``(maybe: bool, t: float)``: the two are farther apart than the gap before t.
    """
    closest = closest_func(source)

    @named(unique_name(source, "pair_contact")).func
    def contact(
        data: PairData,
        xform_a: wp.transform,
        xform_b: wp.transform,
        scale_a: wp.vec3,
        scale_b: wp.vec3,
        linear_a: wp.vec3,
        angular_a: wp.vec3,
        linear_b: wp.vec3,
        angular_b: wp.vec3,
        gap: float,
        duration: float,
        steps: int,
    ):
        reach_a = data.reach_a * wp.max(wp.abs(scale_a)) * _SPEED
        reach_b = data.reach_b * wp.max(wp.abs(scale_b)) * _SPEED
        turning = _length(angular_a) * reach_a + _length(angular_b) * reach_b
        speed = (_length(linear_b - linear_a) + turning) * _SPEED
        t, maybe, left = wp.float32(0.0), wp.bool(True), wp.int32(steps)
        while left > 0:
            left -= 1
            a, b = moved(xform_a, linear_a, angular_a, t), moved(xform_b, linear_b, angular_b, t)
            places = _size(wp.transform_get_translation(a)) + _size(wp.transform_get_translation(b))
            places += t * (_size(linear_a) + _size(linear_b)) + reach_a + reach_b
            free = (closest(data, a, b, scale_a, scale_b, wp.inf, True) - gap) - _MOVED * places
            later = (t + free * _LATER / speed) * _LATER
            if not (free > 0.0 and later > t):
                left = wp.int32(0)
            else:
                t = later
                if later >= duration:
                    t, maybe = duration, wp.bool(False)
                    left = wp.int32(0)
        return maybe, t

    return contact
