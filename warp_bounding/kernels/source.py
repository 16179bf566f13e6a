"""The contract of a method's native source: C text of ``f``, written once and compiled three ways.

A method gives the C text that computes ``f`` from the coordinates ``v[0..n-1]`` (its ``body``), in terms of a type
``V``. ``kernels.functions`` puts around it what all methods share: reading queries, the test for NaN and infinity, the
world-to-object map, the domain test and the comparison ``not (f < threshold)``.

* CPU batch: ``V`` is a vector of queries, one per SIMD lane; a Warp thread works on a block of ``BLOCK`` queries.
  Costly bodies first gather the queries that lie inside the domain, so that no lane works on one that does not.
* CUDA batch: ``V`` is ``float``, one query per thread; or L floats, so that each number that a thread loads serves as
  many queries (``several``).
* Function for other kernels: ``V`` is ``float``; a method may give a CPU body of its own that uses the lanes for
  something else (a network: for its neurons).

Soundness does not depend on this file: the methods' ``rounding_bound`` covers the rounding of their bodies.
"""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from warp_bounding.queries import QUERIES, described, locate
from warp_bounding.runtime.launch import BLOCK
from warp_bounding.runtime.native import fill, identity, native_text
from warp_bounding.shapes.joints import NUMBERS

text = native_text("batch.h")

DENIED = -(2.0**127)  # f where an early test has said no
ALIGN = 16  # floats: the numbers of a bounder, or of one of its members, begin at a multiple of this
LABEL = 4  # numbers at the very beginning of ``parameters``, see ``Source.label``
FINITE = 0xBFFFFFFF  # a mask: float32 bits under it are never infinity or NaN, whose bits a copy might change
SEVERAL_DIM = 128  # threads of a block that take several queries each: blocks of so many registers fit more closely
TOOLS = text.TOOLS

_ANSWERS = {True: ("INFINITY", "-INFINITY", "f"), False: ("1", "0", "!(f < threshold)")}  # maybe without f, no, by f
_STORE = {
    False: text.STORE_ANSWERS,
    True: "for (int l = 0; l < m; ++l) out.data[i + l] = testable[l] ? (inside[l] ? f[l] : -INFINITY) : INFINITY;",
}


@dataclass(frozen=True)
class Lanes:
    """Whether ``V`` is a vector of lanes or a single float: the few things that a body writes differently."""

    vector: bool
    several: bool = False  # on CUDA: whether ``V`` is ``Floats``, L of them (``batch.h``)
    alone: bool = False  # in an export: one query, and the compiler's own vectors


class Early(NamedTuple):
    """A cheaper test that the CPU batch path runs before ``body``: it may answer *no* at once."""

    code: str  # C statements that compute ``V f``
    bar: str  # C text of a float: f below it denies


@dataclass(frozen=True)
class Source:
    """What a method's native code depends on: sizes, never values.

    Equal sources share one compiled function. ``parameters`` begin with what identifies them (``label``), ``center[n]
    scale[n] limit[n] threshold`` and what ``locate`` needs in addition; the method's numbers follow from ``start`` on.
    ``ndim`` is the dimension n of the shape; where ``unbounded``, the answer outside the domain is *maybe*, as it is
    outside a range of time. ``space`` is constant; it is kept because the names and tags of functions depend on it.
    ``joints`` says that coordinates are values of joints.
    """

    ndim: int
    time: bool
    query: str = field(default="point", kw_only=True)
    space: str = field(default="geometric", kw_only=True, init=False)
    unbounded: bool = field(default=False, kw_only=True)
    joints: bool = field(default=False, kw_only=True, repr=False)

    block: ClassVar[int] = BLOCK  # queries of a block of the CPU batch path
    packed: ClassVar[bool] = False  # gather the queries inside the domain first: pays for costly bodies
    several: ClassVar[int] = 1  # queries of a thread of the CUDA batch path
    width: ClassVar[dict[str, int]] = {"avx512": 16, "other": 8}  # float lanes of the batch path

    @property
    def name(self) -> str:
        """Prefix of generated function names."""
        return type(self).__name__.removesuffix("Source").lower()

    def threads(self, count: int) -> int:
        """How many threads answer so many queries on CUDA; whole warps where each answers several."""
        return count if self.several == 1 else -(-count // (32 * self.several)) * 32

    @property
    def start(self) -> int:
        """Index in ``parameters`` where the method's own numbers begin, a multiple of ``ALIGN``."""
        extra = QUERIES[self.query].extra_count(self.ndim, self.time) + NUMBERS * self.ndim * self.joints
        return aligned(LABEL + 3 * self.ndim + 1 + extra)

    @property
    def free(self) -> int:
        """How many axes, from the first on, have an outside that is answered with *maybe*."""
        return self.ndim if self.unbounded else int(self.time)

    @property
    def tag(self) -> tuple[int, int]:
        """Two 32-bit numbers, 62 bits of a hash: a function's data carry that of its source, and no other source's."""
        bits = int(identity(self), 16)
        return bits >> 32 & FINITE, bits & FINITE

    def label(self, parameters: int, words: int) -> np.ndarray:
        """``(LABEL,)`` float32, bits of whole numbers: the tag, and how many parameters and words there are.

        A function compares them before it reads anything else, so the data of another source, or a part of its own,
        make it answer *maybe*.
        """
        return np.array([*self.tag, parameters, words], dtype=np.uint32).view(np.float32)

    @property
    def columns(self) -> int:
        """Numbers of a query."""
        return described(self.query).columns(self.ndim)

    @property
    def coordinates(self) -> int:
        """Numbers ``v`` that the body computes with: n, 2 n, or n + 1 (a plane's normal and offset)."""
        return described(self.query).coordinates(self.ndim)

    @property
    def is_region(self) -> bool:
        """Whether a query is more than one point of the object's space."""
        return described(self.query).is_region

    def around(self, placed: bool, values: bool) -> dict[str, str]:
        """The C text around ``f``, by its names in ``batch.h``: from a query to v, and from f to what is answered.

        If ``placed``, queries are in the world and first mapped to object space; with ``values`` the answer is ``f``
        itself. Here f is compared with the threshold; ``kernels.distances`` compares a distance with a radius.
        """
        yes, no, decision = _ANSWERS[values]
        texts = {
            "tools": TOOLS,
            "parts": fill(text.PARTS, label=LABEL, n=self.ndim, start=self.start),
            "place": "const float* place = placement.data;" if placed else "",
            # from V q[] to v[] and the masks ``testable`` (else: maybe) and ``inside`` (else: no)
            "locate": locate(self.query, self.ndim, self.free, placed, self.joints),
            "outside": f"if (!testable) {{ answer = {yes}; return; }}\nif (!inside) {{ answer = {no}; return; }}",
            "answer": f"answer = {decision};",
            "answers": _STORE[values],
            "asked": "own & testable & inside",
            "own_answer": f"if (own) answer = !testable ? {yes} : !inside ? {no} : {decision};",
        }
        given = [f"{name}[{k}]" for name in ("a", "b") for k in range(self.ndim)]
        numbers = f"const float q[{self.columns}] = {{{', '.join(given)}}};" if self.is_region else ""
        located = fill(text.LOCATED, **texts, numbers=numbers, coordinates=self.coordinates).strip("\n")
        return texts | {"located": located, "unknown": "true", "returned": "return !(f < threshold);"}

    def body(self, lanes: Lanes) -> str:
        """C statements that compute ``V f`` from ``V v[]``, ``const float* w`` (parameters + start) and ``words``."""
        raise TypeError(f"{type(self).__name__} does not define body")

    def early(self) -> list[Early]:
        """Cheaper tests that the CPU batch path (a ``packed`` one) runs before ``body``, which sees the rest only."""
        return []

    def function_body(self) -> str:
        """C statements that declare and compute ``float f`` for one query on a CPU, from ``float v[]``."""
        return "typedef float V; typedef int Mask; V f;\n" + self.body(Lanes(vector=False))


def aligned(count: int) -> int:
    """The first multiple of ``ALIGN`` that is not below a count."""
    return -(-count // ALIGN) * ALIGN


def words_at(whole: str, place: int | str) -> str:
    """A C declaration of ``words`` for a member's text: they begin at a place of those at the pointer ``whole``."""
    return f"const struct {{ const unsigned int* data; }} words = {{{whole} + {place}}}; (void)words;"
