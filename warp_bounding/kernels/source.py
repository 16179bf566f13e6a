"""The native source of a bounding test, written once and compiled three ways.

A method gives the C text that computes ``f`` from the coordinates ``v[0..n-1]`` (its ``body``), in terms of a type
``V``. Around it this file puts what all methods share: reading queries, the test for NaN and infinity, the world-to-
object map, the domain test and the comparison ``not (f < threshold)``.

* CPU batch: ``V`` is a vector of queries, one per SIMD lane; a Warp thread works on a block of ``BLOCK`` queries.
  Costly bodies first gather the queries that lie inside the domain, so that no lane works on one that does not.
* CUDA batch: ``V`` is ``float``, one query per thread.
* Function for other kernels: ``V`` is ``float``; a method may give a CPU body of its own that uses the lanes for
  something else (a network: for its neurons).

Nothing here decides what is conservative: the bodies' rounding is bounded in the methods' ``rounding_bound``.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import warp as wp

from warp_bounding.coordinates.native_map import extra_count, locate
from warp_bounding.runtime.launch import BLOCK
from warp_bounding.runtime.native import identity

__all__ = ["DENIED", "FRONT", "TOOLS", "Lanes", "Source", "batch_snippet", "literal", "point_snippet"]

DENIED = -(2.0**127)  # f where an early test has said no
FRONT = 4  # numbers at the very beginning of ``parameters``, see ``Source.front``
FINITE = 0xBFFFFFFF  # bits of a float32 that are neither an infinity nor NaN, which a copy might change


@dataclass(frozen=True)
class Lanes:
    """Whether ``V`` is a vector of lanes or a single float: the few things that a body writes differently."""

    vector: bool


@dataclass(frozen=True)
class Source:
    """What a method's native code depends on: sizes, never values. Equal sources share one compiled function.

    ``parameters`` begin with what tells whose they are (``front``), ``center[n] scale[n] limit[n] threshold`` and what
    ``locate`` needs besides; the method's numbers follow from ``start`` on.

    Attributes:
        ndim: Dimension n of the indicator.
        time: Coordinate 0 is time.
        query: Kind of query.
        space: ``"geometric"``, or ``"parametric"``: the numbers of a query are the coordinates of a point to be bounded.
    """

    ndim: int
    time: bool
    query: str = field(default="point", kw_only=True)
    space: str = field(default="geometric", kw_only=True)

    packed: ClassVar[bool] = False  # gather the queries inside the domain first: pays for costly bodies
    width: ClassVar[dict[str, int]] = {"avx512": 16, "other": 8}  # float lanes of the batch path

    @property
    def name(self) -> str:
        """Prefix of generated function names."""
        return type(self).__name__.removesuffix("Source").lower()

    @property
    def start(self) -> int:
        """Index in ``parameters`` where the method's own numbers begin, a multiple of 16."""
        return -(-(FRONT + 3 * self.ndim + 1 + extra_count(self.query, self.ndim, self.time)) // 16) * 16

    @property
    def tag(self) -> tuple[int, int]:
        """Two 32-bit numbers that the data of a function carry, 62 bits that equal sources share and others do not."""
        bits = int(identity(self), 16)
        return bits >> 32 & FINITE, bits & FINITE

    def front(self, parameters: int, words: int) -> np.ndarray:
        """``(FRONT,)`` float32, bits of whole numbers: the tag, and how many parameters and words there are.

        A function compares them before it reads anything else, so the data of another source, or a part of its own, make it
        answer *maybe*.
        """
        return np.array([*self.tag, parameters, words], dtype=np.uint32).view(np.float32)

    @property
    def columns(self) -> int:
        """Numbers of a query."""
        return self.ndim if self.query == "point" else 2 * self.ndim

    @property
    def coordinates(self) -> int:
        """Numbers ``v`` that the body computes with: n, 2 n, or n + 1 (a plane's normal and offset)."""
        return self.ndim + 1 if self.query == "plane" and self.space == "geometric" else self.columns

    @property
    def tested_as_point(self) -> bool:
        """Whether ``v`` is one point of the space that is bounded, rather than a region in it."""
        return self.query == "point" or self.space == "parametric"

    def body(self, lanes: Lanes) -> str:
        """C statements that compute ``V f`` from ``V v[]``, ``const float* w`` (parameters + start) and ``words``."""
        raise TypeError(f"{type(self).__name__} does not define body")

    def early(self) -> list[tuple[str, str]]:
        """Cheaper tests that the CPU batch path (a ``packed`` one) asks before ``body``, which then sees their survivors only.

        Returns:
            For each, C statements that compute ``V f``, and the float that it must not fall short of.
        """
        return []

    def function_body(self) -> str:
        """C statements that declare and compute ``float f`` for one query on a CPU, from ``float v[]``."""
        return "typedef float V; V f;\n" + self.body(Lanes(vector=False))

    def plain(self) -> wp.Function:
        """The twin of ``body`` in Warp's own Python, ``f(w, words, at, v) -> float32``: the method's numbers begin at ``w[at]``."""
        raise TypeError(f"{type(self).__name__} does not define plain")


def literal(value: float) -> str:
    """A float32 constant, exactly."""
    return f"{float(value).hex()}f"


_VECTOR_TYPES = """
typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
typedef int I __attribute__((vector_size(4 * L)));
"""

# Square roots and quotients as IEEE 754 has them, of floats and of vectors. What ``sqrtf`` and ``/`` are on CUDA is up to the module:
# they are approximations under its option ``fast_math``, which leaves nothing else in a source to approximate.
TOOLS = """
#if !defined(__CUDA_ARCH__)
auto root = [](auto x) { return __builtin_elementwise_sqrt(x); }; auto over = [](auto a, auto b) { return a / b; };
#else
auto root = [](float x) { return __fsqrt_rn(x); }; auto over = [](float a, float b) { return __fdiv_rn(a, b); };
#endif
"""

_HEAD = """
const float* center = parameters.data + {front}; const float* scale = center + {n}; const float* limit = center + {n2};
const float threshold = center[{n3}]; const float* extra = center + {n3} + 1; const float* w = parameters.data + {start};
"""

_FOREIGN = """
auto bits = [](float x) {{ union {{ float f; unsigned int i; }} u; u.f = x; return u.i; }};
const float* front = parameters.data; const unsigned int numbers = parameters.shape[0], fields = words.shape[0];
if (numbers < {front} || parameters.strides[0] != sizeof(float) || words.strides[0] != sizeof(unsigned int)) return true;
if (bits(front[0]) != {first}u || bits(front[1]) != {second}u) return true;
if (numbers < bits(front[2]) || fields < bits(front[3])) return true;
"""

_CPU = (
    """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#if defined(__AVX512F__)
constexpr int L = {avx512};
#else
constexpr int L = {other};
#endif
"""
    + _VECTOR_TYPES
)


def _head(source: Source) -> str:
    """C statements that name the parts of ``parameters``."""
    n = source.ndim
    return _HEAD.format(front=FRONT, n=n, n2=2 * n, n3=3 * n, start=source.start)


def _locate(source: Source, placed: bool) -> str:
    """C statements from ``V q[]`` to ``v[]`` and the masks ``finite`` (else: maybe) and ``inside`` (else: no); V vector or float."""
    return locate(source.query, source.space, source.ndim, source.time, placed)


def batch_snippet(source: Source, placed: bool, values: bool) -> str:
    """The body of a batch function: one block of queries on a CPU, one query on CUDA."""
    m, columns = source.coordinates, source.columns
    head = _head(source)
    place = "const float* place = placement.data;" if placed else ""
    locate = _locate(source, placed)
    yes, no, decide = ("1", "0", "!(f < threshold)")
    if values:
        yes, no, decide = ("INFINITY", "-INFINITY", "f")
    cpu = [
        _CPU.format(**source.width),
        head,
        place,
        f"const int begin = block * {BLOCK}; const int end = begin + {BLOCK} < count ? begin + {BLOCK} : count;",
        TOOLS,
        "const V zero = {};",
        "typedef unsigned char B __attribute__((vector_size(L), aligned(1), may_alias));",
    ]
    if source.packed:
        cpu += [
            f"float held[{m}][{BLOCK} + L]; int where[{BLOCK} + L]; int kept = 0;",
            "for (int i = begin; i < end; i += L) {",
            _read(source),
            locate,
            "const I go = inside & finite; const int m = end - i < L ? end - i : L; int going = 0;",
            f"for (int l = 0; l < m; ++l) {{ out.data[i + l] = finite[l] ? {no} : {yes}; going -= go[l]; }}"
            if values
            else "const B maybe = __builtin_convertvector(~finite & 1, B); for (int l = 0; l < L; ++l) going -= go[l];\n"
            "if (m == L) { *(B*)(out.data + i) = maybe; } else { for (int l = 0; l < m; ++l) out.data[i + l] = maybe[l]; }",
            "if (going == L && m == L) {",  # all inside: no need to look at them one by one
            f"for (int l = 0; l < L; ++l) where[kept + l] = i + l; {_each(m, '*(V*)(held[{k}] + kept) = v[{k}];')} kept += L;",
            "} else if (going) { for (int l = 0; l < m; ++l) { where[kept] = i + l;",
            _each(m, "held[{k}][kept] = v[{k}][l];"),
            "kept -= go[l]; } } }",
            f"for (int l = kept; l < kept + L; ++l) {{ {_each(m, 'held[{k}][l] = 0.0f;')} }}",
            *(line for test, bar in source.early() for line in _sift(m, test, bar, values)),
            "for (int g = 0; g < kept; g += L) {",
            f"V v[{m}]; {_each(m, 'v[{k}] = *(const V*)(held[{k}] + g);')}",
            "V f;",
            source.body(Lanes(vector=True)),
            "const int m = kept - g < L ? kept - g : L;",
            f"for (int l = 0; l < m; ++l) out.data[where[g + l]] = {'f[l]' if values else '!(f[l] < threshold)'};",
            "}",
        ]
    else:
        cpu += [
            "for (int i = begin; i < end; i += L) {",
            _read(source),
            locate,
            "V f;",
            source.body(Lanes(vector=True)),
            "const int m = end - i < L ? end - i : L;",
        ]
        if values:
            cpu += [f"for (int l = 0; l < m; ++l) out.data[i + l] = finite[l] ? (inside[l] ? f[l] : {no}) : {yes}; }}"]
        else:
            cpu += [
                "const I answer = ~finite | (inside & ~(f < threshold));",
                "const B bytes = __builtin_convertvector(answer & 1, B);",
                "if (m == L) { *(B*)(out.data + i) = bytes; } else { for (int l = 0; l < m; ++l) out.data[i + l] = bytes[l]; } }",
            ]
    cuda = [
        "#else",
        "typedef float V;",
        head,
        place,
        "const int i = block; if (i >= count) return; const float zero = 0.0f;",
        TOOLS,
        f"V q[{columns}], v[{m}]; {_each(columns, 'q[{k}] = x.data[(long long)i * {n} + {k}];')}",
        locate,
        f"if (!finite) {{ out.data[i] = {yes}; return; }}",
        f"if (!inside) {{ out.data[i] = {no}; return; }}",
        "V f;",
        source.body(Lanes(vector=False)),
        f"out.data[i] = {decide};",
        "#endif",
    ]
    return "\n".join([*cpu, *cuda, ""])  # the last line break ends the directive


def _sift(m: int, test: str, bar: str, values: bool) -> list[str]:
    """C statements that ask an early test and move the queries that it does not deny together, in place."""
    return [
        "{ typedef int J __attribute__((vector_size(4 * L), aligned(4), may_alias)); int stay = 0;",
        "for (int g = 0; g < kept; g += L) {",
        f"V v[{m}]; {_each(m, 'v[{k}] = *(const V*)(held[{k}] + g);')}",
        "V f;",
        test,
        f"const I no = f < {bar}; const int m = kept - g < L ? kept - g : L;",
        "int passes[L], pick[L], n = 0; *(J*)passes = no + 1;",  # in memory: lanes of a vector are dear one by one
        f"for (int l = 0; l < m; ++l) if (!passes[l]) out.data[where[g + l]] = {literal(DENIED)};" if values else "",
        "for (int l = 0; l < m; ++l) { pick[n] = g + l; n += passes[l]; }",
        f"for (int l = 0; l < n; ++l) {{ const int from = pick[l]; where[stay + l] = where[from]; {_each(m, 'held[{k}][stay + l] = held[{k}][from];')} }}",
        "stay += n; }",
        f"kept = stay; for (int l = kept; l < kept + L; ++l) {{ {_each(m, 'held[{k}][l] = 0.0f;')} }} }}",
    ]


def _read(source: Source) -> str:
    """C statements that declare ``V q[n], v[n]`` and read queries i .. i + L - 1, the last one again behind the end.

    Rows of n numbers become n vectors by shuffles: number k of query l stands at ``l n + k``, in the vector of that over L.
    """
    n = source.columns
    lines = [
        f"V q[{n}], v[{source.coordinates}]; if (end - i >= L) {{ const float* rows = x.data + (long long)i * {n};"
    ]
    lines += [f"const V r{b} = *(const V*)(rows + {b} * L);" for b in range(n)]
    for directive, lanes in (("#if defined(__AVX512F__)", source.width["avx512"]), ("#else", source.width["other"])):
        lines.append(directive)
        for k in range(n):
            have = "r0"
            for b in range(1, n):  # keep what is there, take from vector b what stands in it
                at = [lane * n + k for lane in range(lanes)]
                known = [p if b == 1 else lane for lane, p in enumerate(at)]
                pick = [lanes + p % lanes if p // lanes == b else known[lane] % lanes for lane, p in enumerate(at)]
                have = f"__builtin_shufflevector({have}, r{b}, {', '.join(map(str, pick))})"
            lines.append(f"q[{k}] = {have};")
    tail = _each(n, "q[{k}][l] = x.data[(long long)j * {n} + {k}];")
    lines.append("#endif")
    lines.append(f"}} else {{ for (int l = 0; l < L; ++l) {{ const int j = i + l < end ? i + l : end - 1; {tail} }} }}")
    return "\n".join(lines)


def _each(n: int, statement: str) -> str:
    """``statement`` once per coordinate."""
    return " ".join(statement.format(k=k, n=n) for k in range(n))


def point_snippet(source: Source) -> str:
    """The body of the function for other kernels: one query ``q``, or two vectors ``a`` and ``b`` of a region; returns bool."""
    n = source.ndim
    region = source.query != "point"
    numbers = ", ".join([f"a[{k}]" for k in range(n)] + [f"b[{k}]" for k in range(n)])
    shared = [
        _FOREIGN.format(front=FRONT, first=source.tag[0], second=source.tag[1]),
        _head(source),
        f"float v[{source.coordinates}]; bool asked, held; {{ typedef float V; const float zero = 0.0f;",
        f"const float q[{2 * n}] = {{{numbers}}};" if region else "",
        _locate(source, placed=False),
        "asked = finite; held = inside; }",
        "if (!asked) return true;",
        "if (!held) return false;",
    ]
    return "\n".join(
        [
            *("#if !defined(__CUDA_ARCH__)", "#pragma clang fp contract(fast)", "#endif"),
            TOOLS,
            *shared,
            "#if !defined(__CUDA_ARCH__)",
            source.function_body(),
            "return !(f < threshold);",
            "#else",
            "typedef float V; V f;",
            source.body(Lanes(vector=False)),
            "return !(f < threshold);",
            "#endif",
            "",
        ]
    )
