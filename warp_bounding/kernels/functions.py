"""Warp functions and kernels around native source: made once for each source, whatever the values in it."""

from functools import cache

import warp as wp

from warp_bounding.coordinates.base import Numbers, vector_type
from warp_bounding.kernels.assemble import batch_snippet, point_snippet, warp_snippet
from warp_bounding.kernels.source import Source
from warp_bounding.runtime.native import named, unique_name

__all__ = ["Data", "Words", "batch_kernel", "point_func", "warp_kernel"]

Words = wp.array(dtype=wp.uint32)


@wp.struct
class Data:
    """What a bounder's function needs besides the query; pass it to your kernel as an argument.

    A function answers *maybe* to data that were made for the function of another source, to a part of its own, and to empty ones.

    Attributes:
        parameters: Whose they are, domain, threshold and the method's numbers (see ``Source``).
        words: Bit field of ``voxels``; empty for other methods.

    Example:
        >>> data = bounder.data
        >>> data.parameters.dtype.__name__, data.words.dtype.__name__
        ('float32', 'uint32')
    """

    parameters: Numbers
    words: Words


@cache
def point_func(source: Source) -> wp.Function:
    """The ``wp.Function`` for use in any kernel, object space.

    Points: ``test(data: Data, q: vec_n) -> bool``. Regions: ``test(data: Data, a: vec_n, b: vec_n) -> bool`` with a ray's
    origin and direction, a plane's normal and point, a box's lower and upper corner.

    In a kernel, write ``wp.static(bounder.func)(data, q)``. Warp looks a global name up again whenever it builds the module, and a name
    that is bound to another function by then brings that one into all kernels of the module; ``wp.static`` does so once, where the
    kernel is defined. Data of another source are answered with *maybe*.

    What is proven is proven of the float32 numbers that the function gets, in IEEE arithmetic. It keeps to that in a module of any options
    of Warp's, ``fast_math`` too (``assemble.TOOLS``); a CPU compiler that is told ``-ffast-math`` refuses it (``native.STRICT``). Other flags
    that give up IEEE arithmetic are outside the claim.
    """
    name = named(unique_name(source, "test"))
    vector = vector_type(source.ndim)
    if source.is_region:

        @name.func_native(point_snippet(source))
        def native_region(parameters: Numbers, words: Words, a: vector, b: vector) -> bool: ...

        @name.func
        def test_region(data: Data, a: vector, b: vector) -> bool:
            return native_region(data.parameters, data.words, a, b)

        return test_region

    @name.func_native(point_snippet(source))
    def native(parameters: Numbers, words: Words, q: vector) -> bool: ...

    @name.func
    def test(data: Data, q: vector) -> bool:
        return native(data.parameters, data.words, q)

    return test


@cache
def batch_kernel(source: Source, placed: bool, values: bool) -> wp.Kernel:
    """The kernel that tests many queries: ``(x, count, block, parameters, words, placement, out)``, one block a thread.

    Where ``placed``, a world-to-object map is applied. Where ``values``, it writes ``f`` itself (float32; +inf where the
    answer is *maybe* without it, -inf outside) instead of 0 and 1.
    """
    name = named(unique_name(source, f"batch{'_placed' * placed}{'_values' * values}"))
    out_type = wp.float32 if values else wp.uint8

    @name.block_kernel(batch_snippet(source, placed, values))
    def batch(
        x: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        placement: Numbers,
        out: wp.array(dtype=out_type),
    ): ...

    return batch


@cache
def warp_kernel(source: Source, placed: bool, values: bool, body: str) -> wp.Kernel:
    """A ``batch_kernel`` for CUDA whose ``body`` the 32 threads of a warp run together.

    Besides it takes ``numbers``, which the body reads, the threshold first. It is launched with whole blocks of threads.
    """
    name, snippet = f"warp{'_placed' * placed}{'_values' * values}", warp_snippet(source, placed, values, body)
    out_type = wp.float32 if values else wp.uint8

    @named(unique_name(source, name)).block_kernel(snippet)
    def batch(
        x: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        placement: Numbers,
        numbers: Numbers,
        out: wp.array(dtype=out_type),
    ): ...

    return batch
