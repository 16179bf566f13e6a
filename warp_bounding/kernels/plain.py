"""The plain twin of a bounding test: Warp functions and kernels in Warp's own Python, for any source, whatever its method.

It reads the same data as the native function, takes the same way from a query to an answer and shows it in a page: is it the data's
own function, is the query testable, where is it in the object's space, is it inside the domain, what is f there. ``Source.plain`` gives f
itself; each family has a ``plain.py`` for that. It answers as the native text does but for rounding, which what is proven leaves
room for in any order of sums, fused or not. It is an oracle of the native text, and runs where there is no compiler for that.

It is slower, one query at a time and without lanes: see ``Bounder.to``. And quotients and roots are what the module says: of a module with ``fast_math``
nothing is claimed, other than of the native text.
"""

from functools import cache

import warp as wp

from warp_bounding.coordinates.base import Numbers, vector_type
from warp_bounding.coordinates.maps import plain_map
from warp_bounding.kernels.functions import Data, Words
from warp_bounding.kernels.source import DENIED, GRANTED, LABEL, Source
from warp_bounding.runtime.native import named, unique_name

__all__ = ["DENIED", "GRANTED", "Numbers", "Words", "plain_func", "plain_kernel", "plain_value", "twin", "vector_type"]


def twin(source: Source, role: str = "value"):
    """``wp.func`` for a function of a source, under a name of its own."""
    return named(unique_name(source, f"plain_{role}")).func


@cache
def plain_value(source: Source) -> wp.Function:
    """``f(w, words, at, v) -> float32``: the method's numbers begin at ``w[at]``."""
    return source.plain()


@cache
def _asked(source: Source, placed: bool) -> wp.Function:
    """``(parameters, words, place, q) -> (testable, inside, f)``: f where both are true."""
    locate = plain_map(source.query, source.space, source.ndim, source.free, placed, LABEL)
    f, start, numbers = plain_value(source), source.start, vector_type(source.columns)

    @twin(source, f"asked{'_placed' * placed}")
    def asked(parameters: Numbers, words: Words, place: Numbers, q: numbers):
        v, testable, inside = locate(parameters, place, q)
        value = wp.float32(0.0)
        if testable and inside:
            value = f(parameters, words, start, v)
        return testable, inside, value

    return asked


@cache
def plain_func(source: Source) -> wp.Function:
    """``test(data, q)`` or ``test(data, a, b)``, as ``point_func`` has it."""
    asked, n, bar = _asked(source, False), source.ndim, LABEL + 3 * source.ndim
    first, second = (wp.uint32(bits) for bits in source.tag)
    vector, numbers = vector_type(n), vector_type(source.columns)

    @twin(source, "test_numbers")
    def test_numbers(data: Data, q: numbers) -> bool:
        w = data.parameters
        if w.shape[0] < LABEL:
            return True
        if wp.cast(w[0], wp.uint32) != first or wp.cast(w[1], wp.uint32) != second:  # another function's data
            return True
        if w.shape[0] < wp.cast(w[2], wp.int32) or data.words.shape[0] < wp.cast(w[3], wp.int32):
            return True
        testable, inside, value = asked(w, data.words, w, q)
        return not testable or (inside and not value < w[bar])

    @twin(source, "test")
    def test_region(data: Data, a: vector, b: vector) -> bool:
        q = numbers()
        for k in range(n):
            q[k] = a[k]
            q[n + k] = b[k]
        return test_numbers(data, q)

    return test_numbers if source.columns == n else test_region


@cache
def plain_kernel(source: Source, placed: bool, values: bool) -> wp.Kernel:
    """The kernel that tests many queries, arguments as of ``batch_kernel``; one query a thread."""
    asked, columns, bar = _asked(source, placed), source.columns, LABEL + 3 * source.ndim
    numbers, out_type = vector_type(columns), wp.float32 if values else wp.uint8

    def batch(
        # inputs
        x: Numbers,
        count: int,
        first: int,
        parameters: Numbers,
        words: Words,
        placement: Numbers,
        # outputs
        out: wp.array(dtype=out_type),
    ):
        i = first + wp.tid()
        q = numbers()
        for k in range(columns):
            q[k] = x[i * columns + k]
        testable, inside, value = asked(parameters, words, placement, q)
        if values:
            out[i] = wp.where(testable, wp.where(inside, value, -wp.inf), wp.inf)
        else:
            out[i] = wp.uint8(not testable or (inside and not value < parameters[bar]))

    return named(unique_name(source, f"plain_batch{'_placed' * placed}{'_values' * values}")).kernel(batch)
