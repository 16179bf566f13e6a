"""The contract of a distance's native source, and what float32 makes of it.

A method gives C text that computes a number ``f`` from local coordinates v (``DistanceDomain``), such that the exact
function F satisfies ``F(v) + threshold <= d(v)``: d is the local distance to the object, ``-threshold`` the *slack* of
the method and of its rounding. What is around it (``distances.h``) makes of it a number ``g(x) <= distance(x, object)``
for every float32 x:

* Where ``whole``, f is asked of v itself, and ``g' = f + threshold - share (|v|_1 + |f|)``.
* Else it is asked of p, the point of the domain that is nearest to v, and ``g' = r - share (|v|_1 + r)`` with
  ``r^2 = |v - p|^2 + max(f(p) + threshold, 0)^2`` (``queries.distance`` says why that bounds the distance).
* ``g = g' unit`` where ``g' > TINIEST``, else 0, also for NaN and infinity.

*Why no rounding can make g too large*, with u = 2^-24 and n coordinates. Let v be as computed, exact v off by at most
``u |v|_1`` in all (a difference rounds once and the scale is a power of two), and ``d`` the local distance at the
computed v: the true one is at least ``d - u |v|_1 (1 + u)``. The method proves ``f <= F + E + growth u (|v|_1 + |f|)``
for the computed f, growth 0 unless ``whole``, and ``threshold <= L - E`` where ``d - F >= L``; so ``f + threshold <= d
+ growth u (|v|_1 + |f|)``. The sum rounds by a factor 1 + u where it is positive, and else nothing is claimed. In the
second way the n differences, n + 1 squares, their sums and the root make r at most ``d (1 + (n + 8) u)``. A computed
``share (...)`` is at least ``1 - (n + 5) u`` times the exact one, and the last difference rounds by 1 + u. So g' stays
under the true distance if ``share (1 - (n + 5) u)`` is at least ``(n + 10 + growth) u`` for the part ``|f|`` or r, and
``(2 + growth) u`` for the part ``|v|_1``: ``share_of`` is ``(2 n + 32 + growth) u``. Fused operations round less often,
and any order of sums is covered. Where coordinate 0 is time it is off by ``u |v_0|`` at most. There d may jump, where a
hole closes, but F does not, and what holds of the computed v_0 is what F + threshold says there: it falls by ``rate``
times as much at most (``DistanceBounder``), which growth contains; outside the range of time g is 0. Results that are
subnormal, or set to zero, err by under ``(4 n + 8) TINY`` before the root, and so by under 2^-61 behind it: all of that
is under ``TINIEST``, which is added to E (``FLUSHED``). Where numbers overflow, ``|v|_1`` or f is infinite and g' is
NaN or minus infinity. ``unit`` is a power of two from 2^-61 to 2^61, so ``g' unit`` is exact.
"""

from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import warp as wp

from warp_bounding.kernels.functions import Data, Words, function_snippet, lanes_of
from warp_bounding.kernels.source import LABEL, TOOLS, Lanes, Source, aligned
from warp_bounding.queries.base import DIRECTION_LARGEST, DIRECTION_SMALLEST
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.native import Numbers, fill, literal, named, native_text, unique_name, vector_type

text = native_text("distances.h")

TINIEST = 2.0**-60  # local units: a smaller g' counts as 0
FLUSHED = 2.0**-60  # local units: more than what subnormal results make of f and of r; every E contains it
HEADER = 4  # numbers behind center and limit: scale, unit, threshold, share
HEADER_OF_TIME = 3  # and where coordinate 0 is time: its scale, the speed, and the pace
MOST_DIMENSIONS = 64  # sums then round by less than the argument above allows for


def share_of(ndim: int, growth: float) -> float:
    """The share of a query's size that rounding may take, and is taken off."""
    return (2 * ndim + 32 + growth) * UNIT32


# Parts of ``distances.h``: where there is time; where f is asked of v itself; where distances are written.
_CLOCK = {False: "", True: text.CLOCK}
_AXES = {False: {"scale": "scale", "free": "0"}, True: {"scale": "(k == 0 ? time_scale : scale)", "free": "k == 0"}}
_BEFORE = {True: text.BEFORE_WHOLE, False: text.BEFORE_NEAREST}
_AFTER = {True: text.AFTER_WHOLE, False: text.AFTER_NEAREST}
_THEN = {False: "", True: "g = wb_size_of(v[0]) > zero + limit[0] ? zero : g;"}
_STORE_ONE = {True: "\nanswer = g;", False: "\nanswer = !(g > radius[many * i]);"}
_STORE = {True: text.STORE_DISTANCES, False: text.STORE_ANSWERS}


@dataclass(frozen=True)
class DistanceSource(Source):
    """What a distance's native code depends on; a method adds its sizes.

    ``parameters`` begin with the label, then ``center[n] limit[n] scale unit threshold share``, and of a shape that
    moves ``time_scale speed pace``; the method's numbers follow from ``start`` on. Only methods that are queried in the
    domain know time.
    """

    query: str = field(default=DISTANCE.name, kw_only=True)

    packed: ClassVar[bool] = False
    whole: ClassVar[bool] = True  # f is asked of v wherever it is, not of the nearest point of the domain

    @property
    def start(self) -> int:
        return aligned(LABEL + 2 * self.ndim + HEADER + (HEADER_OF_TIME if self.time else 0))

    def around(self, placed: bool, values: bool) -> dict[str, str]:
        """See ``Source``: ``f`` becomes g (``after``), which is the answer or is compared with a radius."""
        texts = {
            "n": str(self.ndim),
            "tools": TOOLS + text.TOOLS,
            "parts": fill(
                text.PARTS, label=LABEL, n=self.ndim, start=self.start, clock=fill(_CLOCK[self.time], n=self.ndim)
            ),
            "place": "" if values else text.RADIUS,
            "locate": fill(_BEFORE[self.whole], **_AXES[self.time]),
            "after": fill(_AFTER[self.whole], tiniest=literal(TINIEST), then=_THEN[self.time]),
            "outside": "",
            "asked": "own",
            "unknown": "0.0f",
        }
        answer = texts["after"] + _STORE_ONE[values]
        return texts | {
            "answer": answer,
            "answers": texts["after"] + _STORE[values],
            "own_answer": f"{texts['after']}\nif (own){_STORE_ONE[values]}",
            "located": fill(text.LOCATED, **texts),
            "returned": f"{{ typedef float V;{texts['after']}\nreturn g; }}",
        }


# --- marching and halving ---------------------------------------------------------------------------------------------
#
# Warp functions of a distance, for any source: at a point, along a segment or a ray, over a box; and batches.
#
# ``distance_func`` is native text (``distances.h``), and all others ask it, so they are the same function in Warp's own
# Python for every source and device.
#
# *Marching.* A segment is ``a + t w``, ``0 <= t <= 1``. At a time t all points before which are proven to be farther
# than the radius, the point ``x = a + t w`` is computed; each of its numbers is off by at most ``u (2 t |w_k| + |x_k|)
# (1 + 3 u)``, or ``3 u`` more of ``|w_k|`` where w is a difference of float32 numbers, and ``(n + 6) u`` more where w
# is a direction that was scaled to a length; altogether by at most ``room = BLUR (|a|_1 + |w|_1) + LEAST``, ``BLUR = (n
# + 16) u``. Where ``g(x) > radius + room``, every point within ``g(x) - radius - room`` of the exact point at t is
# farther than the radius from the object. So t may grow by that over the length of the segment: the length is rounded
# up, the quotient and the new t down, by more than their operations round. A march begins where the segment enters the
# box that holds the object, and ends with *no* where t reaches the end of that (``span_func``), with *maybe* where
# nothing is gained, numbers are not finite, or the steps are over; t is then a lower bound of the time of first
# contact. Batches march in lanes (``lanes_kernel``), by the same steps.
#
# *Time.* Where coordinate 0 is time, the distance from a moving point to an object that moves, too, shrinks by no more
# than both ways together: ``|w|`` in space and the object's speed times ``|w_0|``. Their sum is what is called the
# length, and what rounds of ``a_0`` and ``w_0`` counts times the speed in the room. A segment that leaves the range of
# time is told nothing of: *maybe*, at 0. Contact is that with the faces as they move; a march passes by where a hole
# closes around a point and touches nothing.
#
# *Halving.* A box is clear where g at a point c of it exceeds the largest distance in it from c, rounded up. Otherwise
# it is halved along its longest side at c, which is a float32 number, so that the halves cover the box exactly; its
# sides in time count times the *pace*, which g falls by at most, since the object may enclose points that it does not
# touch, and g at a time tells of that time alone. Where g is 0 at c no halving can clear it, and the answer is *maybe*.
# The walk goes depth first without a stack: a path of bits tells which half was taken at each level. Only the part in
# the domain is asked, since the object lies there.

# From when to when may a segment meet the object at all? Only while it is in the box that holds the object, dilated by
# the radius.
#
# The exact point at a time t of [0, 1] is within ``room`` of ``a + t w`` in every
# coordinate, the radius contained. So where contact is possible, ``a_k + t w_k`` lies between ``center_k - far`` and
# ``center_k + far``, ``far = half_k + room`` and what these sums round, on every axis of space. A difference of
# float32 numbers and a quotient round by one unit each, which ``SHORTER`` and ``LONGER`` outweigh; the sign of both is
# exact. Numbers that are set to zero err by less than ``LEAST``, which is added to far once more.

LEAST = 2.0**-100  # object units: above what results that are set to zero take
LONGER = 1.0 + 2.0**-19  # outweighs the rounding of a length of up to 64 numbers
SHORTER = 1.0 - 2.0**-21  # outweighs the rounding of a difference, a quotient and a sum
FINITE = 3.0e38
SUMS = 16.0 * UNIT32  # of all numbers that are added up: more than six roundings


def _named(source: DistanceSource, role: str) -> named:
    return named(unique_name(source, role))


SEGMENT_STEPS = 32  # evaluations of a segment or a ray at most, where no number is given
BOX_STEPS = 64  # evaluations of a box
SHORTEST = 2.0**-58  # object units, added to a length: above what squares that are set to zero take
MOST_LEVELS = 62  # halvings of a box


@cache
def distance_func(source: DistanceSource) -> wp.Function:
    """``distance(data: Data, x: vec_n) -> float32``, g of one point; 0 for the data of another source."""
    name, vector = named(unique_name(source, "distance")), vector_type(source.ndim)

    @name.func_native(function_snippet(source))
    def native_distance(parameters: Numbers, words: Words, q: vector) -> float: ...

    @name.func
    def distance(data: Data, x: vector) -> float:
        return native_distance(data.parameters, data.words, x)

    return distance


# The functions below are for any number n of coordinates, which the types of their arguments tell; ``time`` is 1 where
# coordinate 0 is time, else 0. ``clock`` is the middle and half of the range of time, and the speed.


@wp.func
def owns(w: Numbers, tag: wp.vec2ui) -> bool:
    """Are these data of the source with this tag? Nothing is told of others, whose domain is another."""
    if w.shape[0] < LABEL:
        return False
    return (
        wp.cast(w[0], wp.uint32) == tag[0]
        and wp.cast(w[1], wp.uint32) == tag[1]
        and w.shape[0] >= wp.cast(w[2], wp.int32)
    )


@wp.func
def half_at(w: Numbers, n: int, k: int) -> float:
    """Half of a side of the box that holds the object, object units."""
    return float(w[LABEL + n + k] * w[LABEL + 2 * n + 1])


@wp.func
def clock_of(w: Numbers, n: int, time: int) -> wp.vec3:
    """See above; zeros of a shape at rest."""
    numbers, clock = LABEL + 2 * n, wp.vec3()
    if time > 0 and w.shape[0] > numbers + 5:
        clock = wp.vec3(float(w[LABEL]), float(w[LABEL + n] / w[numbers + 4]), float(w[numbers + 5]))
    return clock


def line_texts(source: DistanceSource) -> dict[str, str]:
    """The C texts of lines: ``way``, from the ends of a segment to its way and length, and ``span``; see above."""
    numbers = {"blur": (source.ndim + 16) * UNIT32, "sums": SUMS, "least": LEAST, "finite": FINITE}
    numbers |= {"longer": LONGER, "shorter": SHORTER, "shortest": SHORTEST}
    texts = {name: literal(value) for name, value in numbers.items()} | {"n": source.ndim, "first": int(source.time)}
    clocked = fill(text.WAY_OF_TIME, **texts) if source.time else ""
    speed = f"center[{2 * source.ndim + HEADER + 1}]" if source.time else "0.0f"
    return texts | {"way": fill(text.WAY, **texts, clocked=clocked), "span": fill(text.SPAN, **texts, speed=speed)}


@cache
def way_func(source: DistanceSource) -> wp.Function:
    """``way(data, a: vec_n, b: vec_n) -> vec_{n + 1}``: a segment's displacement and length, rounded up.

    The length is infinite where it leaves the range of time.
    """
    name, n, tag = _named(source, "way"), source.ndim, wp.vec2ui(source.tag)
    vector, longer = vector_type(n), vector_type(n + 1)
    texts = line_texts(source) | source.around(placed=False, values=True)

    @name.func_native(fill(text.WAY_FUNCTION, **texts))
    def native_way(parameters: Numbers, a: vector, b: vector) -> longer: ...

    @name.func
    def way(data: Data, a: vector, b: vector) -> longer:
        if owns(data.parameters, tag):
            return native_way(data.parameters, a, b)
        return longer()

    return way


@cache
def span_func(source: DistanceSource) -> wp.Function:
    """``span(data, a: vec_n, w: vec_n, length, radius) -> vec3``: what g must exceed, and two times.

    The first number, for radius and rounding, is infinite for numbers that cannot be marched. Contact is possible
    between the two times only; never if they fall.
    """
    name, vector, tag = _named(source, "span"), vector_type(source.ndim), wp.vec2ui(source.tag)
    texts = line_texts(source) | source.around(placed=False, values=True)

    @name.func_native(fill(text.SPAN_FUNCTION, **texts))
    def native_span(parameters: Numbers, a: vector, w_: vector, length: float, radius: float) -> wp.vec3: ...

    @name.func
    def span(data: Data, a: vector, w_: vector, length: float, radius: float) -> wp.vec3:
        if owns(data.parameters, tag):
            return native_span(data.parameters, a, w_, length, radius)
        return wp.vec3(wp.inf, 0.0, 1.0)

    return span


@wp.func
def ray_line(direction: Any, length: float):
    """A ray's displacement and length, rounded up; infinite if unusable."""
    largest, square, finite = wp.float32(0.0), wp.float32(0.0), wp.bool(True)
    for k in range(len(direction)):
        largest = wp.max(largest, wp.abs(direction[k]))
        finite = finite and direction[k] - direction[k] == 0.0
    way, long = type(direction)(), wp.float32(wp.inf)
    if finite and largest >= DIRECTION_SMALLEST and largest <= DIRECTION_LARGEST and length >= 0.0:
        d = direction / largest
        for k in range(len(direction)):
            square += d[k] * d[k]
        way = d * (length / wp.sqrt(square))
        long = length * LONGER + SHORTEST
    return way, long


@wp.func
def known_part(w: Numbers, lower: Any, upper: Any, time: int):
    """``(real, empty, low, high)``: may a box be asked, and which part of it is in the domain?"""
    low, high, clock = type(lower)(), type(lower)(), clock_of(w, len(lower), time)
    empty, real = wp.bool(False), wp.bool(True)
    for k in range(len(lower)):
        real = real and lower[k] <= upper[k] and lower[k] > -FINITE and upper[k] < FINITE
        if k < time:
            low[k] = lower[k]
            high[k] = upper[k]
            real = real and lower[k] >= clock[0] - clock[1] and upper[k] <= clock[0] + clock[1]
        else:
            # rounded outwards: three operations
            at, half = float(w[LABEL + k]), half_at(w, len(lower), k)
            room = (wp.abs(at) + half) * (4.0 * UNIT32) + LEAST
            low[k] = wp.max(lower[k], at - half - room)
            high[k] = wp.min(upper[k], at + half + room)
            empty = empty or low[k] > high[k]
    return real, empty, low, high


@wp.func
def part_of(low: Any, high: Any, path: wp.uint64, level: int, pace: float, time: int):
    """The corners of the part of a box to which a path of halvings leads."""
    first, last = low + type(low)(), high + type(low)()  # copies
    for turn in range(level):
        axis, longest = wp.int32(0), wp.float32(-1.0)
        for k in range(len(low)):
            side = last[k] - first[k]
            if k < time:
                side = side * pace
            if side > longest:
                axis, longest = k, side
        middle = first[axis] * 0.5 + last[axis] * 0.5
        if (path >> wp.uint64(level - 1 - turn)) & wp.uint64(1) == wp.uint64(0):
            last[axis] = middle
        else:
            first[axis] = middle
    return first, last


@wp.func
def reach_of(first: Any, last: Any, c: Any, pace: float, time: int) -> float:
    """The largest distance in a box from a point c of it, rounded up; time counts by the pace."""
    square, moved = wp.float32(0.0), wp.float32(0.0)
    for k in range(len(c)):
        reach = wp.max(last[k] - c[k], c[k] - first[k])
        if k < time:
            moved = pace * reach * LONGER
        else:
            square += reach * reach
    return (wp.sqrt(square) * LONGER + SHORTEST + moved) * LONGER


@cache
def march_func(source: DistanceSource) -> wp.Function:
    """``(maybe, t)`` along ``start + t way``; ``length`` is at least ``|way|``, ``span`` what ``span_func`` gives."""
    vector, distance = vector_type(source.ndim), distance_func(source)

    @_named(source, "march").func
    def march(data: Data, start: vector, way: vector, length: float, span: wp.vec3, steps: int):
        room, t, last, maybe, going = span[0], span[1], span[2], wp.bool(True), wp.int32(steps)
        if t > last:
            t, maybe, going = wp.float32(1.0), wp.bool(False), wp.int32(0)
        while going > 0:
            going -= 1
            free = distance(data, start + way * t) - room
            after = (t + free * SHORTER / length) * SHORTER
            if not (free > 0.0 and after > wp.max(t, LEAST)):
                going = wp.int32(0)
            else:
                t = after
                if after >= last:
                    t, maybe = wp.float32(1.0), wp.bool(False)
                    going = wp.int32(0)
        return maybe, t

    return march


@cache
def segment_func(source: DistanceSource) -> wp.Function:
    """``segment(data, start: vec_n, end: vec_n, radius: float, steps: int = 32)``: ``(maybe: bool, t: float)``."""
    vector, n, way_of, span_of, march = (
        vector_type(source.ndim),
        source.ndim,
        way_func(source),
        span_func(source),
        march_func(source),
    )

    @_named(source, "segment").func
    def segment(data: Data, start: vector, end: vector, radius: float, steps: int = SEGMENT_STEPS):
        line, way = way_of(data, start, end), vector()
        for k in range(n):
            way[k] = line[k]
        maybe, t = march(data, start, way, line[n], span_of(data, start, way, line[n], radius), steps)
        return maybe, t

    return segment


@cache
def ray_func(source: DistanceSource) -> wp.Function:
    """``ray(data, origin: vec_n, direction: vec_n, length: float, radius: float, steps: int = 32)``: ``(maybe, t)``."""
    vector, span_of, march = vector_type(source.ndim), span_func(source), march_func(source)

    @_named(source, "ray").func
    def ray(data: Data, origin: vector, direction: vector, length: float, radius: float, steps: int = SEGMENT_STEPS):
        way, long = ray_line(direction, length)
        maybe, t = march(data, origin, way, long, span_of(data, origin, way, long, radius), steps)
        return maybe, t

    return ray


@cache
def box_func(source: DistanceSource) -> wp.Function:
    """``box(data, lower: vec_n, upper: vec_n, steps: int = 64) -> bool``: may the closed box meet the object?"""
    vector, time, tag, distance = (
        vector_type(source.ndim),
        int(source.time),
        wp.vec2ui(source.tag),
        distance_func(source),
    )
    pace_at = LABEL + 2 * source.ndim + HEADER + HEADER_OF_TIME - 1

    @_named(source, "box").func
    def box(data: Data, lower: vector, upper: vector, steps: int = BOX_STEPS) -> bool:
        if not owns(data.parameters, tag):
            return True
        real, empty, low, high = known_part(data.parameters, lower, upper, time)
        if not real:
            return True
        if empty:
            return False
        pace = wp.float32(0.0)
        if time > 0:
            pace = float(data.parameters[pace_at])
        path, level, left = wp.uint64(0), wp.int32(0), wp.int32(steps)
        while left > 0:
            left -= 1
            first, last = part_of(low, high, path, level, pace, time)
            c = first * 0.5 + last * 0.5
            g = distance(data, c)
            if g > reach_of(first, last, c, pace, time):
                while level > 0 and path & wp.uint64(1) == wp.uint64(1):
                    path = path >> wp.uint64(1)
                    level -= 1
                if level == 0:
                    return False
                path = path | wp.uint64(1)
            elif g > 0.0 and level < MOST_LEVELS:
                path = path << wp.uint64(1)
                level += 1
            else:
                left = wp.int32(0)
        return True

    return box


# --- batches ---------------------------------------------------------------------------------------------------------
#
# Marching in lanes: segments and rays of a batch, one in each lane of a vector, and a new one in a lane whenever one
# has ended.
#
# A first kernel, in Warp's own Python, makes of each query what a march needs (``way_func``): a, w, its
# length, the room that rounding needs with the radius, and from when to when contact is possible (``clip``): a
# query that passes the object's box takes no lane at all. The second one, native, marches: the same steps as
# ``march`` with the same rounding, but for what sums in another order round, which the room covers.
# Lanes ask g together; those that have ended are written out and filled again, so that a vector is full until the
# block runs out of queries. On CUDA it is a query a thread.


@cache
def lanes_kernel(source: DistanceSource, body: str | None = None) -> wp.Kernel:
    """``(lines, count, block, parameters, words, steps, maybe, times)``.

    Each thread takes a block of lines ``(count, 2 n + 4)``. With a ``body`` it is for CUDA, as
    ``batch_kernel`` is, and takes ``numbers`` behind ``steps``.
    """
    texts = {"shorter": literal(SHORTER), "least": literal(LEAST), "block": source.block, "lanes": lanes_of(source)}
    texts |= source.around(placed=False, values=True) | {"scalar_body": source.body(Lanes(vector=False))}
    if body is None:
        step = _step(texts, source.body(Lanes(vector=True)))
        alone = fill(text.MARCH_ALONE, **texts, scalar_step=_step(texts, texts["scalar_body"]))

        @_named(source, "lines").block_kernel(fill(text.MARCH, **texts, step=step, march_alone=alone))
        def march(
            lines: Numbers,
            count: int,
            block: int,
            parameters: Numbers,
            words: Words,
            steps: int,
            maybe: wp.array(dtype=wp.bool),
            times: wp.array(dtype=wp.float32),
        ): ...

        return march

    step = _step(texts, body)

    @_named(source, "warp_lines").block_kernel(fill(text.TOGETHER, **texts, step=step))
    def together(
        lines: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        steps: int,
        numbers: Numbers,
        maybe: wp.array(dtype=wp.bool),
        times: wp.array(dtype=wp.float32),
    ): ...

    return together


def _step(texts: dict[str, str], body: str) -> str:
    """C text of one step of a march: g, and how far that leads."""
    return fill(text.STEP, **texts, value=fill(text.VALUE, **texts, body=body))


@cache
def lines_kernel(source: DistanceSource, ray: bool) -> wp.Kernel:
    """``(first, data, a, b, length, lengths, radius, radii, lines)``.

    Writes what ``lanes_kernel`` marches along: a row of 2 n + 4 numbers a query.
    """
    n, vector, way_of, span_of = source.ndim, vector_type(source.ndim), way_func(source), span_func(source)

    def lines_of(
        first: int,
        # inputs
        data: Data,
        a: Numbers,
        b: Numbers,
        length: Numbers,
        lengths: int,
        radius: Numbers,
        radii: int,
        # outputs
        lines: Numbers,
    ):
        i, _ = wp.tid()
        i += first
        start, end = vector(), vector()
        for k in range(n):
            if ray:
                start[k] = a[2 * n * i + k]
                end[k] = a[2 * n * i + n + k]
            else:
                start[k] = a[i * n + k]
                end[k] = b[i * n + k]
        w, long = vector(), wp.float32(0.0)
        if ray:
            w, long = ray_line(end, length[lengths * i])
        else:
            line = way_of(data, start, end)
            for k in range(n):
                w[k] = line[k]
            long = line[n]
        row, span = i * (2 * n + 4), span_of(data, start, w, long, radius[radii * i])
        for k in range(n):
            lines[row + k] = start[k]
            lines[row + n + k] = w[k]
        lines[row + 2 * n] = long
        for k in range(3):
            lines[row + 2 * n + 1 + k] = span[k]

    return _named(source, "ray_lines" if ray else "segment_lines").kernel(lines_of)


@cache
def box_kernel(source: DistanceSource) -> wp.Kernel:
    """``(first, data, lower, upper, steps, maybe)``, one box a thread."""
    box, n, vector = box_func(source), source.ndim, vector_type(source.ndim)

    def boxes(
        first: int,
        # inputs
        data: Data,
        lower: Numbers,
        upper: Numbers,
        steps: int,
        # outputs
        maybe: wp.array(dtype=wp.bool),
    ):
        i, _ = wp.tid()
        i += first
        low, high = vector(), vector()
        for k in range(n):
            low[k] = lower[i * n + k]
            high[k] = upper[i * n + k]
        maybe[i] = box(data, low, high, steps)

    return _named(source, "boxes").kernel(boxes)
