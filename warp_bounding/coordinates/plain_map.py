"""The twin of ``native_map`` in Warp's own Python: from a query's numbers to the coordinates ``v``, one function a kind of query.

Each of them, and each that moves a query from the world first, is called with ``parameters``, ``place`` (``Placement.values``) and the
query ``q``. It returns the new numbers and ``finite`` (false: *maybe*, whatever else holds), a map ``inside`` as well (false: *no*).
"""

from functools import cache
from typing import Any

import warp as wp

from warp_bounding.coordinates.base import (
    FAR,
    FARTHEST,
    GUARD,
    LARGEST,
    LATER,
    PARALLEL,
    SMALLEST,
    SUMMED,
)
from warp_bounding.runtime.native import named

__all__ = ["plain_map", "vector_type"]

Numbers = wp.array(dtype=wp.float32)


@cache
def vector_type(length: int) -> Any:
    """A vector of so many float32 numbers, Warp's own where it has a name."""
    own = {2: wp.vec2, 3: wp.vec3, 4: wp.vec4}
    return own[length] if length in own else wp.types.vector(length=length, dtype=wp.float32)


@cache
def plain_map(query: str, space: str, n: int, time: bool, placed: bool, front: int) -> wp.Function:
    """The function ``(parameters, place, q) -> (v, finite, inside)``.

    Args:
        query: Kind of query.
        space: ``"geometric"`` or ``"parametric"``.
        n: Dimension of the indicator.
        time: Coordinate 0 is time.
        placed: ``q`` are in the world.
        front: Where ``center scale limit threshold extra`` begin in ``parameters``.
    """
    locate = _MAPS.get((space, query), _MAPS[query])(n, time, placed, front)
    move, columns = _MOVES[query](n), _COLUMNS[query] * n
    numbers = vector_type(columns)

    @named(f"wb_plain_map_{space}_{query}_{n}_{time:d}{placed:d}").func
    def located(parameters: Numbers, place: Numbers, q: numbers):
        known = wp.bool(True)
        for k in range(columns):
            known = known and wp.isfinite(q[k])
        x = q
        if placed:
            x, sized = move(place, q)
            known = known and sized
        v, finite, inside = locate(parameters, place, x)
        return v, known and finite, inside

    return located


@cache
def _sized(n: int) -> wp.Function:
    pair = vector_type(2 * n)

    @named(f"wb_plain_sized_{n}").func
    def sized(q: pair, first: int) -> bool:
        """Whether the direction at ``q[first]`` has a size that directions may have."""
        longest = wp.float32(0.0)
        for k in range(n):
            longest = wp.max(longest, wp.abs(q[first + k]))
        return longest >= SMALLEST and longest <= LARGEST

    return sized


@cache
def _unit(n: int) -> wp.Function:
    pair, vector = vector_type(2 * n), vector_type(n)

    @named(f"wb_plain_unit_{n}").func
    def unit(q: pair, first: int) -> vector:
        """The direction at ``q[first]`` with Euclidean length 1."""
        u, longest, norm = vector(), wp.float32(0.0), wp.float32(0.0)
        for k in range(n):
            longest = wp.max(longest, wp.abs(q[first + k]))
        for k in range(n):
            u[k] = q[first + k] / longest
            norm += u[k] * u[k]
        for k in range(n):
            u[k] = u[k] / wp.sqrt(norm)
        return u

    return unit


@cache
def _local(n: int, front: int) -> wp.Function:
    pair, vector = vector_type(2 * n), vector_type(n)

    @named(f"wb_plain_local_{n}_{front}").func
    def local(p: Numbers, q: pair, first: int):
        """The point at ``q[first]`` in local space, and the sum of its absolute values."""
        a, far = vector(), wp.float32(0.0)
        for k in range(n):
            a[k] = (q[first + k] - p[front + k]) * p[front + n + k]
            far += wp.abs(a[k])
        return a, far

    return local


def _move_point(n: int) -> wp.Function:
    vector = vector_type(n)

    @named(f"wb_plain_move_point_{n}").func
    def move(place: Numbers, q: vector):
        x = vector()
        for k in range(n):
            for j in range(n):
                x[k] += (q[j] - place[j]) * place[n + n * k + j]
        return x, True

    return move


def _move_ray(n: int) -> wp.Function:
    return _move_pair(n, 0, n, n)


def _move_plane(n: int) -> wp.Function:
    return _move_pair(n, n, 0, 2 * n + n * n)


@cache
def _move_pair(n: int, point: int, turn: int, matrix: int) -> wp.Function:
    pair, sized = vector_type(2 * n), _sized(n)

    @named(f"wb_plain_move_{point}_{n}").func
    def move(place: Numbers, q: pair):
        """The point at ``q[point]``, and the direction at ``q[turn]`` by the matrix at ``place[matrix]``."""
        x, finite = pair(), wp.bool(True)
        for k in range(n):
            for j in range(n):
                x[point + k] += (q[point + j] - place[j]) * place[n + n * k + j]
                x[turn + k] += q[turn + j] * place[matrix + n * k + j]
        for k in range(2 * n):
            finite = finite and wp.isfinite(x[k])
        return x, finite and sized(q, turn) and sized(x, turn)

    return move


def _move_box(n: int) -> wp.Function:
    pair = vector_type(2 * n)

    @named(f"wb_plain_move_box_{n}").func
    def move(place: Numbers, q: pair):
        """The box around the moved one."""
        x, finite = pair(), wp.bool(True)
        for k in range(n):
            finite = finite and q[k] <= q[n + k]
            for j in range(n):
                low, high = (q[j] - place[j]) * place[n + n * k + j], (q[n + j] - place[j]) * place[n + n * k + j]
                x[k] += wp.min(low, high)
                x[n + k] += wp.max(low, high)
        for k in range(n):
            finite = finite and wp.isfinite(q[k] - place[k]) and wp.isfinite(q[n + k] - place[k])
            finite = finite and wp.isfinite(x[k]) and wp.isfinite(x[n + k])
        return x, finite

    return move


def _point(n: int, time: bool, placed: bool, front: int) -> wp.Function:
    vector = vector_type(n)

    @named(f"wb_plain_point_{n}_{time:d}_{front}").func
    def locate(p: Numbers, place: Numbers, q: vector):
        v, finite, inside = vector(), wp.bool(True), wp.bool(True)
        for k in range(n):
            v[k] = (q[k] - p[front + k]) * p[front + n + k]
            inside = inside and v[k] <= p[front + 2 * n + k] and v[k] >= -p[front + 2 * n + k]
        if time:  # outside its range of time the object may be anywhere
            finite = v[0] <= p[front + 2 * n] and v[0] >= -p[front + 2 * n]
        return v, finite, inside

    return locate


def _ray(n: int, time: bool, placed: bool, front: int) -> wp.Function:
    pair, sized, unit, local = vector_type(2 * n), _sized(n), _unit(n), _local(n, front)
    limit, extra, drift = front + 2 * n, front + 3 * n + 1, n + n * n

    @named(f"wb_plain_ray_{n}_{time:d}{placed:d}_{front}").func
    def locate(p: Numbers, place: Numbers, q: pair):
        a, far = local(p, q, 0)
        u, finite = unit(q, n), sized(q, n)
        v, enter, leave = pair(), wp.float32(0.0), wp.float32(1.0)
        for k in range(n):
            speed = u[k] * p[extra + k]
            v[n + k] = speed
            room = p[limit + k] + wp.abs(a[k]) * GUARD
            if placed and far > FAR:
                room += far * place[drift + k]
            if wp.abs(speed) > PARALLEL:
                first, last = (-room - a[k]) / speed, (room - a[k]) / speed
                enter = wp.max(enter, wp.min(first, last))
                leave = wp.min(leave, wp.max(first, last))
            elif wp.abs(a[k]) > room:  # it never enters
                enter = wp.max(enter, 2.0)
                leave = wp.min(leave, -1.0)
        enter *= 1.0 - GUARD
        leave *= 1.0 + GUARD
        finite = finite and far <= FARTHEST and (far <= FAR or enter > leave)
        for k in range(n):
            v[k] = wp.clamp(a[k] + enter * v[n + k], -p[limit + k], p[limit + k])
        if time:
            top, end = p[extra + n] - wp.abs(a[0]) * LATER, a[0] + v[n]
            finite = finite and (a[0] <= top or end <= top) and (a[0] >= -top or end >= -top)
        return v, finite, enter <= leave

    return locate


def _plane(n: int, time: bool, placed: bool, front: int) -> wp.Function:
    pair, numbers, vector, local = vector_type(2 * n), vector_type(n + 1), vector_type(n), _local(n, front)
    limit, extra, drift = front + 2 * n, front + 3 * n + 1, n + n * n

    @named(f"wb_plain_plane_{n}_{time:d}{placed:d}_{front}").func
    def locate(p: Numbers, place: Numbers, q: pair):
        a, far = local(p, q, n)
        e, pivot, longest, widest, still = vector(), wp.float32(0.0), wp.float32(0.0), wp.float32(1.0), wp.bool(True)
        for k in range(n):
            e[k] = q[k] * p[extra + k]
            widest = wp.max(widest, p[extra + k])
            if wp.abs(e[k]) > longest:
                pivot = e[k]
                longest = wp.abs(e[k])
            if k > 0:
                still = still and e[k] == 0.0
        v, offset, summed, reach = numbers(), wp.float32(0.0), wp.float32(0.0), wp.float32(0.0)
        for k in range(n):
            v[k] = e[k] / pivot
            offset += v[k] * a[k]
            summed += wp.abs(v[k] * a[k])
            reach += wp.abs(v[k]) * p[limit + k]
        v[n] = offset
        room = reach * (1.0 + GUARD) + summed * SUMMED
        if placed and far > FAR:
            room += far * place[drift]
        finite = longest >= SMALLEST * widest and longest <= LARGEST
        finite = finite and far <= FARTHEST and (far <= FAR or wp.abs(offset) > room)
        if time:  # a plane of constant time, outside the range
            finite = finite and (not still or wp.abs(a[0]) <= p[extra + n])
        return v, finite, wp.abs(offset) <= room

    return locate


def _plane_parameters(n: int, time: bool, placed: bool, front: int) -> wp.Function:
    pair, sized, unit, local = vector_type(2 * n), _sized(n), _unit(n), _local(n, front)
    limit, extra = front + 2 * n, front + 3 * n + 1

    @named(f"wb_plain_plane_parameters_{n}_{time:d}_{front}").func
    def locate(p: Numbers, place: Numbers, q: pair):
        a, _ = local(p, q, n)
        u, finite, v = unit(q, 0), sized(q, 0), pair()
        for k in range(n):
            finite = finite and wp.abs(a[k]) <= p[limit + k]
            v[k] = u[k]
            v[n + k] = a[k]
        if time:
            finite = finite and wp.abs(a[0]) <= p[extra + n]
        return v, finite, True

    return locate


def _box(n: int, time: bool, placed: bool, front: int) -> wp.Function:
    pair, local = vector_type(2 * n), _local(n, front)
    limit, extra = front + 2 * n, front + 3 * n + 1

    @named(f"wb_plain_box_{n}_{time:d}_{front}").func
    def locate(p: Numbers, place: Numbers, q: pair):
        low, _ = local(p, q, 0)
        high, _ = local(p, q, n)
        v, finite, inside = pair(), wp.bool(True), wp.bool(True)
        for k in range(n):
            top = p[limit + k]
            finite = finite and q[k] <= q[n + k]
            inside = inside and low[k] <= top and high[k] >= -top
            v[k] = wp.clamp(low[k], -top, top)
            v[n + k] = wp.clamp(high[k], -top, top)
        if time:
            finite = finite and low[0] <= p[extra] and high[0] >= -p[extra]
        return v, finite, inside

    return locate


_COLUMNS = {"point": 1, "ray": 2, "plane": 2, "box": 2}
_MAPS = {"point": _point, "ray": _ray, "plane": _plane, "box": _box, ("parametric", "plane"): _plane_parameters}
_MOVES = {"point": _move_point, "ray": _move_ray, "plane": _move_plane, "box": _move_box}
