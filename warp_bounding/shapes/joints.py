"""Coordinates that are joint values: *maybe* beyond limits; values of endless joints are turned back into one turn.

A query q is turned back before it is mapped to v (``TEXT``), by three float32 operations on numbers of the joint alone,
in native text and on every device alike:

    k = round(q / P),    x = (q - k head) - k tail,    P = head + tail the period.

*What that rounds*, with ``u = 2^-24`` and ``|q| <= TURNS P``, which is compared exactly: ``q / P``, as the product with
a rounded inverse, is off by ``2 TURNS u``, so that k is a whole number of at most ``TURNS`` and ``|q - k P| <= P / 2 +
2^-13 P``. ``head`` has ``HEAD_BITS`` bits, so that ``k head`` is exact, fused with the difference or not. That
difference is at most ``1.01 P`` and ``k tail`` at most ``P / 2``, so that both differences, the product and the
rounding of tail sum up to less than ``3 u P``; that of P itself, a float64, and subnormals to less than ``u P``. A
float64 query has been rounded by ``u TURNS P`` before. All of it is in ``reach``, which the proof's delta counts
(``Domain``). So a shape of such joints must say what it is over ``WIDER`` times one turn, whose ends are the same
place. Farther away than ``TURNS`` the answer is *maybe*.

Other joints have limits, float32 numbers that q is compared with as it is; what is rounded to a limit lies on it, and a
shape must say what it is a little beyond (``BEYOND``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from warp_bounding.rounding import round_down

TURNS = 1024  # from 0, either way: farther away the answer is maybe
TURNS64 = 2**20  # the same of float64, where only the truth is asked
WIDER = 1 + 2.0**-10  # of one turn: what a query that is turned back may be; see above
# Of the largest coordinate within limits: how far the shape must be known beyond these, for queries that are rounded.
BEYOND = 2.0**-21
HEAD_BITS, HEAD_BITS64 = 12, 30  # times a number of turns exact in float32, in float64
LARGEST_TURN = 2.0**60  # coordinates: of a period
MAGIC = 1.5 * 2**23  # a sum with it is a whole number, to nearest, for any rounding of ties
FAR = 4  # ranges of a joint: what lies farther beyond its limits is of another unit
PER_JOINT = "; it has a value for each joint that is not held: of a whole robot's configurations q[:, shape.columns]"
NUMBERS = 5  # float32 of each joint that kernels read

# Reads q, the NUMBERS of each joint at ``extra``; what follows is told of ``turned`` instead of q.
TEXT = f"""
V turned[AXES];
for (int k = 0; k < AXES; ++k) {{
    const float* joint = extra + {NUMBERS} * k;  // lower, upper, 1 / P, head, tail; the last three are 0 of a joint with limits
    testable = testable & (q[k] >= joint[0]) & (q[k] <= joint[1]);
    const V about = q[k] * joint[2] + {MAGIC.hex()}f, turns = about - {MAGIC.hex()}f;
    turned[k] = (q[k] - turns * joint[3]) - turns * joint[4];
}}
"""  # noqa: E501


@dataclass(frozen=True)
class Joints:
    """Each coordinate's limits and period.

    Attributes:
        lower: Least values that are asked about, float32.
        upper: Largest values.
        period: One turn, float64; 0 of a joint with limits.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    period: tuple[float, ...]

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray, period: np.ndarray) -> "Joints":
        """Joints with limits ``(n,)``, float32 numbers, which count where the period is 0."""
        turns, most = period > 0, round_down(TURNS * period).astype(np.float64)
        numbers = np.where(turns, -most, lower), np.where(turns, most, upper), period
        return cls(*(tuple(each.tolist()) for each in numbers))

    def fault(self) -> str | None:
        """What is wrong with these numbers; ``None`` if ``TEXT`` does what it should."""
        lower, upper, period = (np.array(each, dtype=np.float64) for each in (self.lower, self.upper, self.period))
        with np.errstate(over="ignore"):
            single = [each.astype(np.float32) for each in (lower, upper)]
        fine = (single[0] == lower) & (single[1] == upper) & np.isfinite(lower) & np.isfinite(upper) & (lower < upper)
        turns = (period >= 1 / LARGEST_TURN) & (period <= LARGEST_TURN) & (upper <= TURNS * period) & (lower == -upper)
        return None if (fine & (turns | (period == 0))).all() else "the limits or periods of its joints are none"

    @property
    def reach(self) -> np.ndarray:
        """``(n,)`` float64, in UNIT32: what turning a query back rounds, with a float64 query's rounding.

        It is 0 for joints with limits.
        """
        return (TURNS + 5) * np.array(self.period)

    @property
    def numbers(self) -> np.ndarray:
        """``(NUMBERS n,)`` float32, for kernels."""
        period = np.array(self.period)
        inverse = np.divide(1.0, period, out=np.zeros_like(period), where=period > 0)
        heads, tails = np.transpose([_split(Fraction(each), HEAD_BITS) for each in self.period])
        return np.stack([self.lower, self.upper, inverse, heads, tails], axis=1).astype(np.float32).reshape(-1)

    def within(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: queries ``(N, n)`` that are asked about."""
        return ((x >= np.array(self.lower)) & (x <= np.array(self.upper))).all(axis=1)

    @property
    def usual(self) -> tuple[np.ndarray, np.ndarray]:
        """``(n,)`` each: least and largest values that could be meant; infinite where a joint turns without end."""
        lower, upper, turns = np.array(self.lower), np.array(self.upper), np.array(self.period) > 0
        room = np.where(turns, np.inf, FAR * (upper - lower))
        return lower - room, upper + room

    def other_units(self, x: np.ndarray) -> str | None:
        """A message for configurations ``(N, n)`` of which some have values that cannot be meant, such as degrees."""
        low, high = self.usual
        if not len(found := np.argwhere(np.isfinite(x) & ((x < low) | (x > high)))):
            return None
        row, k = found[0]
        limits = f"{self.lower[k]:.4g} to {self.upper[k]:.4g}"
        return f"expected radians, and metres of what slides, times weights; got {x[row, k]:g}, limits are {limits}"

    def turned_back(self, x: np.ndarray) -> np.ndarray:
        """Queries ``(N, n)`` float64, each in the turn around 0."""
        return turned_back(x, [Fraction(each) for each in self.period])

    def to_dict(self) -> dict[str, list[float]]:
        """JSON-ready."""
        return {name: list(getattr(self, name)) for name in ("lower", "upper", "period")}

    @classmethod
    def from_dict(cls, values: dict, number) -> "Joints":
        """Inverse of ``to_dict``; ``number(value, name)`` checks each."""
        return cls(*(tuple(number(each, name) for each in values[name]) for name in ("lower", "upper", "period")))


def _split(period: Fraction, bits: int) -> tuple[float, float]:
    """The first ``bits`` bits of a period as a float, and the rest."""
    mantissa, exponent = np.frexp(float(period))
    head = float(np.ldexp(np.floor(mantissa * 2.0**bits), exponent - bits))
    return head, float(period - Fraction(head))


def turned_back(x: np.ndarray, periods: Sequence[Fraction]) -> np.ndarray:
    """Coordinates ``(N, n)`` in the turn around 0, as exact as float64 is; NaN beyond ``TURNS64``.

    Where the period is 0 they stay.
    """
    found = np.array(x, dtype=np.float64)
    for axis, period in enumerate(periods):
        if period:
            head, tail = _split(period, HEAD_BITS64)
            with np.errstate(invalid="ignore", over="ignore"):
                turns = np.rint(found[:, axis] / float(period))
                turns[~(np.abs(turns) <= TURNS64)] = np.nan
                found[:, axis] = (found[:, axis] - turns * head) - turns * tail
    return found
