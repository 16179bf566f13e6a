"""What a dilated motion answers, in kernels: about points and closed boxes of time and space."""

import warp as wp

from warp_bounding.indicators.moving.hierarchy import Ways, span_between, span_of
from warp_bounding.indicators.moving.sides import Pieces, outside_in, side_in
from warp_bounding.indicators.moving.walks import moving_box_is_free, moving_holds
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED
from warp_bounding.indicators.triangles.answers import LIMIT, OUTWARD, half_of, is_box
from warp_bounding.indicators.triangles.arithmetic import largest
from warp_bounding.indicators.triangles.sides import ENCLOSED, OUTSIDE

__all__ = ["Motion", "decide_moments", "find_empty_spans", "find_inside_spans", "is_empty", "key_at", "place_of"]

_LIMIT = wp.constant(wp.float64(LIMIT))
_OUTWARD = wp.constant(wp.float64(OUTWARD))
_HALF = wp.constant(wp.float64(0.5))
_IN, _OUT, _UNDECIDED = wp.constant(IN), wp.constant(OUT), wp.constant(UNDECIDED)
_ENCLOSED, _OUTSIDE = wp.constant(ENCLOSED), wp.constant(OUTSIDE)


@wp.struct
class Motion:
    """A motion that is dilated. Faces may be elsewhere by the rounding."""

    lower: wp.vec4d  # the box that holds the dilated object, time first
    upper: wp.vec4d
    rounding: wp.float64
    reach: wp.float64  # the margin and the rounding: what is farther from a face is not within the margin of it
    hold: wp.float64  # the margin less the rounding, maybe below 0: what is nearer is within the margin
    faces: Ways  # all of them
    closed: Ways  # those of closed parts
    pieces: Pieces


@wp.func
def place_of(x: wp.vec4d) -> wp.vec3d:
    """All but the time."""
    return wp.vec3d(x[1], x[2], x[3])


@wp.func
def key_at(times: wp.array(dtype=wp.float64), time: wp.float64) -> int:
    """The last keyframe but one, or the last one before that which is not after a time."""
    low, high = wp.int32(0), times.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= time:
            low = middle
        else:
            high = middle
    return low


@wp.func
def _point(m: Motion, x: wp.vec4d) -> int:
    for k in range(4):
        if not (x[k] >= m.lower[k] and x[k] <= m.upper[k]):  # NaN is nowhere
            return _OUT
    place, zero = place_of(x), wp.vec3d()
    if not largest(place) < _LIMIT:
        return _UNDECIDED
    span = span_between(m.faces.times, key_at(m.faces.times, x[0]), x[0], x[0])
    if moving_box_is_free(m.faces, span, place, zero, m.reach):
        side = side_in(m.closed, m.pieces, span, place)
        if side == _OUTSIDE:
            return _OUT
        if side == _ENCLOSED:
            return _IN
        return _UNDECIDED
    if moving_holds(m.faces, span, place, wp.float64(0.0), m.hold):
        return _IN
    if moving_box_is_free(m.closed, span, place, zero, m.rounding):  # noqa: SIM102 (a kernel's ``and`` would not wait)
        if side_in(m.closed, m.pieces, span, place) == _ENCLOSED:
            return _IN
    return _UNDECIDED


@wp.kernel(enable_backward=False)
def decide_moments(
    first: int,
    # inputs
    m: Motion,
    x: wp.array(dtype=wp.vec4d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is a point in the object at its time?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_point(m, x[i]))


@wp.func
def is_empty(m: Motion, lower: wp.vec4d, upper: wp.vec4d) -> bool:
    """Is it certain that a closed box of time and space holds no point of the object?"""
    for k in range(4):
        if not lower[k] <= upper[k]:
            return False
    for k in range(4):
        if upper[k] < m.lower[k] or lower[k] > m.upper[k]:
            return True
    low, high = place_of(lower), place_of(upper)
    if not is_box(low, high):
        return False
    begin, end = wp.max(lower[0], m.lower[0]), wp.min(upper[0], m.upper[0])
    centre = low * _HALF + high * _HALF
    half = half_of(low, high, centre)
    key = key_at(m.faces.times, begin)
    while key < m.faces.times.shape[0] - 1 and m.faces.times[key] <= end:
        span = span_between(m.faces.times, key, begin, end)
        if not moving_box_is_free(m.faces, span, centre, half, m.reach):
            return False
        if not outside_in(m.closed, m.pieces, span, centre):
            return False
        key += 1
    return True


@wp.kernel(enable_backward=False)
def find_empty_spans(
    first: int,
    # inputs
    m: Motion,
    lower: wp.array(dtype=wp.vec4d),
    upper: wp.array(dtype=wp.vec4d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box of time and space holds no point of the object?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(is_empty(m, lower[i], upper[i]))


@wp.func
def _inside(m: Motion, lower: wp.vec4d, upper: wp.vec4d) -> bool:
    low, high = place_of(lower), place_of(upper)
    begin, end = lower[0], upper[0]
    if not (is_box(low, high) and begin <= end and begin >= m.lower[0] and end <= m.upper[0]):
        return False
    centre = low * _HALF + high * _HALF
    half = half_of(low, high, centre)
    radius = wp.length(half) * _OUTWARD
    key = key_at(m.faces.times, begin)
    while key < m.faces.times.shape[0] - 1 and m.faces.times[key] <= end:
        span = span_between(m.faces.times, key, begin, end)
        if not moving_holds(m.faces, span, centre, radius, m.hold):
            instant = span_of(key, span.begin, span.begin)
            if not (
                moving_box_is_free(m.closed, span, centre, half, m.rounding)
                and side_in(m.closed, m.pieces, instant, centre) == _ENCLOSED
            ):
                return False
        key += 1
    return True


@wp.kernel(enable_backward=False)
def find_inside_spans(
    first: int,
    # inputs
    m: Motion,
    lower: wp.array(dtype=wp.vec4d),
    upper: wp.array(dtype=wp.vec4d),
    # outputs
    answers: wp.array(dtype=wp.uint8),
):
    """Is it certain that a closed box of time and space lies in the object whole?"""
    i, _ = wp.tid()
    i += first
    answers[i] = wp.uint8(_inside(m, lower[i], upper[i]))
