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
from typing import ClassVar

from warp_bounding.kernels.source import LABEL, TOOLS, Source, aligned, fill
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.native import literal, native_text

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
_AXES = {
    False: {"scale": "scale", "free": "false"},
    True: {"scale": "(k == 0 ? time_scale : scale)", "free": "k == 0"},
}
_BEFORE = {True: text.BEFORE_WHOLE, False: text.BEFORE_NEAREST}
_AFTER = {True: text.AFTER_WHOLE, False: text.AFTER_NEAREST}
_THEN = {False: "", True: "g = size_of(v[0]) > zero + limit[0] ? zero : g;"}
_STORE_ONE = {True: "\nout.data[i] = g;", False: "\nout.data[i] = !(g > radius[many * i]);"}
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

    @property
    def columns(self) -> int:
        return self.ndim

    @property
    def coordinates(self) -> int:
        return self.ndim

    @property
    def is_region(self) -> bool:
        return False

    @property
    def tested_kind(self) -> str:
        return self.query

    @property
    def tested_ndim(self) -> int:
        return self.ndim

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
            "own_answer": f"const float threshold = tensor[0];{texts['after']}\nif (own){_STORE_ONE[values]}",
            "located": fill(text.LOCATED, **texts),
            "returned": f"{{ typedef float V;{texts['after']}\nreturn g; }}",
        }
