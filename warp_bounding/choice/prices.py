"""Costs of broad phases as functions of the narrow phase's price: ``t + p * price`` (paper, Eq. 6), and which is the least where."""

import math
from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["Line", "Stretch", "cheapest", "duration"]


class Line(NamedTuple):
    """What one broad phase costs.

    Attributes:
        label: Of the broad phase.
        nanoseconds: It takes itself, a query.
        share: Of the queries that it leaves to the narrow phase.
    """

    label: str
    nanoseconds: float
    share: float

    def cost(self, price):
        """Nanoseconds a query, where the narrow phase takes ``price`` nanoseconds a call; of an array for each."""
        return self.nanoseconds + self.share * price


class Stretch(NamedTuple):
    """Prices of the narrow phase, nanoseconds a call, from which on one broad phase costs the least."""

    price: float
    label: str


def cheapest(lines: Sequence[Line]) -> list[Stretch]:
    """The least of some lines, price by price from 0 on: the first stretch begins at 0, each ends where the next begins."""
    if not lines:
        return []
    at, price = min(lines, key=lambda line: (line.nanoseconds, line.share)), 0.0
    found = [Stretch(price, at.label)]
    while True:
        # flatter lines meet this one farther on; of those that meet it first, the flattest goes on
        meets = [
            ((line.nanoseconds - at.nanoseconds) / (at.share - line.share), line.share, line)
            for line in lines
            if line.share < at.share
        ]
        if not meets:
            return found
        price, _, at = min(meets, key=lambda meeting: meeting[:2])
        if not math.isfinite(price):
            return found
        if price <= found[-1].price:
            found.pop()
        found.append(Stretch(max(price, 0.0) if found else 0.0, at.label))


def duration(nanoseconds: float) -> str:
    """A time in words, three digits and a unit.

    Example:
        >>> duration(0.8641), duration(999.7), duration(166_000.0)
        ('0.864 ns', '1 us', '166 us')
    """
    size, unit = next(
        (size, unit)
        for size, unit in ((1.0, "ns"), (1e3, "us"), (1e6, "ms"), (1e9, "s"))
        if nanoseconds < 999.5 * size or unit == "s"
    )
    return f"{nanoseconds / size:.3g} {unit}"
