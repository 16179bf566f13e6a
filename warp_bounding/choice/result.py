"""What ``choose`` found: rows of all candidates, the one that costs the least, and the prices at which that changes."""

from dataclasses import asdict, dataclass, field
from typing import Any

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.choice.prices import Line, Stretch, cheapest, duration

__all__ = ["NONE", "Choice", "Row"]

NAMED = 3  # candidates that ``Choice.more`` names
NONE = "none"  # label of no broad phase at all


@dataclass(frozen=True)
class Row:
    """One candidate, measured on the caller's queries.

    Attributes:
        label: Method and size; ``"none"`` is no broad phase.
        nbytes: Of memory that a query can read.
        nanoseconds: A query takes, in a batch, the overhead of asking included.
        share: Of the queries that it leaves to the narrow phase.
        cost: ``nanoseconds + share * narrow_ns``.
        certificate: Its kind; ``"by construction"`` for no broad phase, and empty where there is none.
        missed: Queries that meet the object and that it denied: 0 for whatever is proven.
        seconds: That its fit took.
        why_not: Why it cannot be chosen, in words; empty for those that can.
        note: What is to be known of a row that can be, such as that training had little time; empty for most.
        needs: The budget that would leave room for what was not tried or had too little time, about, seconds; 0 for others.
    """

    label: str
    nbytes: int
    nanoseconds: float
    share: float
    cost: float
    certificate: str = ""
    missed: int = 0
    seconds: float = 0.0
    why_not: str = ""
    note: str = ""
    needs: float = 0.0

    @property
    def line(self) -> Line:
        """Its cost as a function of the narrow phase's price."""
        return Line(self.label, self.nanoseconds, self.share)


@dataclass(frozen=True)
class Choice:
    """The broad phase that costs the least, with all that it was compared with.

    Attributes:
        bounder: The bounder, ``None`` where none pays; where its label says so a distance, which answers by ``query``, ``rays`` or ``boxes``.
        label: Of its row.
        rows: Of all candidates, the cheapest first.
        narrow_ns: Price of the narrow phase, nanoseconds a call.
        positives: Share of the queries that meet the object: no broad phase leaves less.
        queries: How many queries there were; ``choose`` measures on half of them.
        memory: Limit of ``nbytes``; ``None`` for none.
        device: Where they were asked.
        threads: Of a CPU; 0 elsewhere.
        about: More of how it was found, for files.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, budget=5.0, networks=(), device="cpu", progress=False)
        >>> choice.bounder.certificate.proven, choice.label == choice.rows[0].label
        (True, True)
    """

    bounder: Bounder | DistanceBounder | None
    label: str
    rows: tuple[Row, ...]
    narrow_ns: float
    positives: float
    queries: int
    memory: int | None
    device: str
    threads: int
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def row(self) -> Row:
        """The chosen row."""
        return next(row for row in self.rows if row.label == self.label)

    @property
    def prices(self) -> list[Stretch]:
        """What would be chosen at other prices of the narrow phase: each from its price on, up to the next one's.

        Example:
            >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
            >>> choice = wb.choose(ball, narrow_ns=50.0, budget=5.0, networks=(), device="cpu", progress=False)
            >>> choice.prices[0]
            Stretch(price=0.0, label='none')
        """
        return cheapest([row.line for row in self.rows if not row.why_not])

    @property
    def why(self) -> str:
        """In a sentence, why this one."""
        none, own = next(row for row in self.rows if row.label == NONE), self.row
        if own.label == NONE:
            others = [row for row in self.rows if row.label != NONE and not row.why_not]
            if not others:
                return "no candidate can be chosen, so every query goes to the narrow phase"
            best = min(others, key=lambda row: row.cost)
            return (
                f"none pays: the narrow phase takes {duration(self.narrow_ns)}, and the best, {best.label}, would cost "
                f"{duration(best.cost)} a query in all"
            )
        return (
            f"{own.label}: {duration(own.cost)} a query in all, {none.cost / own.cost:.3g} times less than with no broad phase; it takes {duration(own.nanoseconds)} and leaves "
            f"{100 * own.share:.3g} % of the queries, of which {100 * self.positives:.3g} % must be left"
        )

    @property
    def more(self) -> str:
        """In a sentence, what a larger budget would do, and how large it should be; empty where nothing was left out for want of time.

        Example:
            >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
            >>> wb.choose(ball, narrow_ns=50.0, budget=60.0, methods="aabb", device="cpu", progress=False).more
            ''
        """
        larger = self.about.get("larger_budget")
        if larger is None:
            return ""
        labels = larger["labels"]
        named = ", ".join(labels[:NAMED]) + (f" and {len(labels) - NAMED} more" if len(labels) > NAMED else "")
        would = "would probably change the answer" if larger["probably"] else "might change the answer, but hardly"
        return f"A budget of about {larger['seconds']:g} s {would}: it has room for {named}"

    def to_dict(self) -> dict[str, Any]:
        """All but the bounder, JSON-ready.

        Example:
            >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
            >>> choice = wb.choose(ball, narrow_ns=50.0, budget=5.0, networks=(), device="cpu", progress=False)
            >>> sorted(choice.to_dict()["rows"][0])[:3]
            ['certificate', 'cost', 'label']
        """
        told = {name: getattr(self, name) for name in ("label", "narrow_ns", "positives", "queries", "memory")}
        told |= {"device": self.device, "threads": self.threads, "why": self.why, "more": self.more}
        prices = [stretch._asdict() for stretch in self.prices]
        return told | {"prices": prices, "rows": [asdict(row) for row in self.rows]} | self.about
