"""The C text around a method's ``body``, and its batch kernels and functions, made once for each source.

The compiler may fuse products and sums in all CPU text (``contract``), which the rounding bounds allow for, and may
change nothing else.
"""

from functools import cache

import warp as wp

from warp_bounding.kernels.source import DENIED, LABEL, Early, Lanes, Source, text
from warp_bounding.runtime.native import Numbers, fill, literal, named, unique_name, vector_type

_UNASKED = {False: text.UNASKED_ANSWERS, True: text.UNASKED_VALUES}


def _shared(source: Source, placed: bool, values: bool) -> dict[str, object]:
    """What all texts of a source have in common."""
    sizes = {"columns": source.columns, "coordinates": source.coordinates}
    return sizes | source.around(placed, values) | {"scalar_body": source.body(Lanes(vector=False))}


def _picked(vectors: list[str], lanes: int, at: list[int]) -> str:
    """A C expression: for each lane a number, the one at its place ``at`` in the concatenated vectors."""
    have = vectors[0]
    for b in range(1, len(vectors)):  # keep the lanes that are found, and take those of vector b
        known = [p if b == 1 else lane for lane, p in enumerate(at)]
        pick = [lanes + p % lanes if p // lanes == b else known[lane] % lanes for lane, p in enumerate(at)]
        have = f"__builtin_shufflevector({have}, {vectors[b]}, {', '.join(map(str, pick))})"
    return have


def _shuffles(columns: int, lanes: int) -> str:
    """C statements from the vectors ``r[]`` of rows of numbers to ``q[]``.

    An even number of columns goes in two steps, which takes fewer shuffles and, as both halves of the rows use the same
    ones, a quarter of the registers: pairs of columns first, ``p<half>[]``, then their evens and odds.
    """
    names = [f"r[{b}]" for b in range(columns)]
    if columns % 2:
        taken = (_picked(names, lanes, [lane * columns + k for lane in range(lanes)]) for k in range(columns))
        return "\n".join(f"q[{k}] = {text};" for k, text in enumerate(taken))
    pairs, lines = columns // 2, []
    for half in range(2):
        rows = names[half * pairs : (half + 1) * pairs]
        at = [[lane // 2 * columns + 2 * k + lane % 2 for lane in range(lanes)] for k in range(pairs)]
        lines.append(f"const V p{half}[] = {{{', '.join(_picked(rows, lanes, places) for places in at)}}};")
    for k in range(columns):
        halves = [f"p{half}[{k // 2}]" for half in range(2)]
        lines.append(f"q[{k}] = {_picked(halves, lanes, list(range(k % 2, 2 * lanes, 2)))};")
    return "\n".join(lines)


def _early(test: Early, values: bool) -> str:
    """The C text of an early test. Answers are *no* from the start, so a denial writes only where f is wanted."""
    denied = f"for (int l = 0; l < m; ++l) if (!passes[l]) out.data[where[g + l]] = {literal(DENIED)};"
    return fill(text.EARLY, test=test.code, bar=test.bar, answer=denied if values else "")


def read_rows(columns: int, width: dict[str, int]) -> str:
    """C statements that declare ``V q[N], v[M]`` and read the numbers of queries i to i + m - 1 into the lanes of q."""
    return fill(text.READ, **{name: _shuffles(columns, lanes) for name, lanes in width.items()})


def lanes_of(source: Source) -> str:
    """C declarations of the types of lanes, and of how many there are: ``L``."""
    return fill(text.LANES, **source.width).strip("\n")


def batch_snippet(source: Source, placed: bool, values: bool) -> str:
    """The body of a ``batch_kernel``: one block of queries on a CPU, one query on CUDA."""
    texts = _shared(source, placed, values)
    texts |= {"block": source.block, "lanes": lanes_of(source), "read": read_rows(source.columns, source.width)}
    if source.packed:
        texts["early"] = "\n".join(_early(test, values) for test in source.early())
        decision = "f[l]" if values else "!(f[l] < threshold)"
        own = {"body": source.body(Lanes(vector=True)), "lane_decision": decision}
        loop = fill(text.GATHERED, **texts, **own, unasked=_UNASKED[values])
    else:
        loop = fill(text.ALL, **texts, body=source.body(Lanes(vector=True)))
    if source.several == 1:
        return fill(text.BATCH, **texts, loop=loop, on_cuda=fill(text.ONE, **texts))
    texts |= {"several": source.several, "several_body": source.body(Lanes(vector=False, several=True))}
    texts |= {"query": fill(text.QUERY, **texts)}
    return fill(text.BATCH, **texts, loop=loop, on_cuda=fill(text.SEVERAL, **texts))


def function_snippet(source: Source) -> str:
    """The body of the function for other kernels: one query ``q``, or two vectors ``a`` and ``b`` of a region."""
    first, second = source.tag
    texts = _shared(source, placed=False, values=False) | {"function_body": source.function_body()}
    return fill(text.FUNCTION, **texts, label=LABEL, first=first, second=second)


# Warp functions and kernels around native source: made once for each source, whatever the values in it.

Words = wp.array(dtype=wp.uint32)


@wp.struct
class Data:
    """What a bounder's function needs in addition to the query; pass it to your kernel as an argument.

    A function answers *maybe* to data that were made for the function of another source, to a part of its own, and to
    empty ones.

    Attributes:
        parameters: The label (``Source.label``), the domain, the threshold and the method's numbers.
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

    Points: ``test(data: Data, q: vec_n) -> bool``. Regions: ``test(data: Data, a: vec_n, b: vec_n) -> bool`` with a
    ray's origin and direction, a plane's normal and point, a box's lower and upper corner.

    In a kernel, write ``wp.static(bounder.func)(data, q)``. Warp looks up a global name whenever it builds the module;
    if the name is bound to another function by then, all kernels of the module call that one. ``wp.static`` looks it up
    once, where the kernel is defined. Data of another source are answered with *maybe*.

    The proof is about the float32 numbers that the function gets, in IEEE arithmetic. The function keeps to IEEE
    arithmetic under all options of Warp modules, ``fast_math`` included (``TOOLS``); with the CPU compiler flag
    ``-ffast-math`` it does not compile (``native.STRICT``). Other flags that break IEEE arithmetic void the proof.
    """
    name = named(unique_name(source, "test"))
    vector = vector_type(source.ndim)
    if source.is_region:

        @name.func_native(function_snippet(source))
        def native_region(parameters: Numbers, words: Words, a: vector, b: vector) -> bool: ...

        @name.func
        def test_region(data: Data, a: vector, b: vector) -> bool:
            return native_region(data.parameters, data.words, a, b)

        return test_region

    @name.func_native(function_snippet(source))
    def native(parameters: Numbers, words: Words, q: vector) -> bool: ...

    @name.func
    def test(data: Data, q: vector) -> bool:
        return native(data.parameters, data.words, q)

    return test


@cache
def batch_kernel(source: Source, placed: bool, values: bool, body: str | None = None) -> wp.Kernel:
    """The kernel that answers many queries, one block a thread.

    It takes ``(x, count, block, parameters, words, placement, out)``. Where ``placed``, ``placement`` is read: a
    world-to-object map, or the radius of a distance, one or one per query. With ``values`` it writes ``f`` itself
    (float32; +inf where the answer is *maybe* without it, -inf outside), or the distance. ``body`` is for CUDA:
    statements from ``V v[]`` to ``V f`` that the 32 threads of a warp run together. The kernel then takes ``numbers``
    before ``out``, which the body reads, the threshold first; it is launched with whole blocks of threads.
    """
    role = f"{'_placed' * placed}{'_values' * values}"
    out_type = wp.float32 if values else wp.bool
    if body is None:

        @named(unique_name(source, f"batch{role}")).block_kernel(batch_snippet(source, placed, values))
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

    snippet = fill(text.WARP, **_shared(source, placed, values) | {"body": body})

    @named(unique_name(source, f"warp{role}")).block_kernel(snippet)
    def together(
        x: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: Words,
        placement: Numbers,
        numbers: Numbers,
        out: wp.array(dtype=out_type),
    ): ...

    return together
