"""A choice in the making: candidates are fitted, as many as the budget has room for, and measured.

Of what is no network the fits that take the least time come first (``closed``); networks race (``races``). Whatever is not begun, or is stopped, has a row that tells the budget that it would need.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.choice.candidates import Candidate
from warp_bounding.choice.kept import Kept
from warp_bounding.choice.pace import Pace, Spending, TooSlowError, Watch
from warp_bounding.choice.result import NONE, Row
from warp_bounding.choice.starved import starved
from warp_bounding.choice.timing import TURNS, Batch, times_of
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning
from warp_bounding.evaluation.distances import ASKED
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.runtime.progress import Progress
from warp_bounding.runtime.working_time import OutOfTimeError, compile_seconds, limited, working_seconds
from warp_bounding.training import fit

__all__ = ["NOT_TRIED", "OVERDRAWN", "Tried", "Work", "told_budget"]

OVERDRAWN = (
    0.12  # of the budget, by which fits may exceed it before they are stopped, rather than lose what they have made
)
NOT_TRIED = "not tried: "
FINAL = 3.0  # times what measuring has taken so far: what times in turns take at the end


@dataclass(frozen=True)
class Tried:
    """A fitted candidate, and what it costs."""

    label: str
    bounder: Bounder | DistanceBounder
    row: Row


@dataclass
class Work:
    """One choice in the making.

    Attributes:
        shape: As it came.
        query: Kind of query.
        options: Of every fit.
        bounded: The shape, dilated.
        length: Of rays.
        own: ``(Q, m)`` queries to measure with.
        truth: ``(Q,)`` bool, which of them meet the object.
        narrow_ns: Price of the narrow phase.
        overhead_ns: Of asking any bounder at all.
        memory: Limit of bytes, or ``None``.
        device: Where it is measured.
        statistical: Whether what samples attest may be chosen.
        kept: The folder.
        spending: Of the budget.
        update: Of progress, or ``None``.
        passed: Rows of what was not fitted, with why not, by label.
        interrupted: Whether Ctrl-C has ended fitting.
        measuring: Seconds that measuring has taken.
        networks: Labels of the candidates that are networks.
        foreseen: Seconds that what was not tried would take, about, by label.
    """

    shape: Shape
    query: str
    options: dict
    bounded: Shape
    length: float
    own: np.ndarray
    truth: np.ndarray
    narrow_ns: float
    overhead_ns: float
    memory: int | None
    device: str
    statistical: bool
    kept: Kept
    spending: Spending
    update: Progress | None = None
    passed: dict[str, Row] = field(default_factory=dict)
    interrupted: bool = False
    measuring: float = 0.0
    foreseen: dict[str, float] = field(default_factory=dict)
    networks: frozenset[str] = frozenset()

    def __post_init__(self):
        self.compiled = compile_seconds()
        self.pace = Pace(QUERIES[self.query].is_region)

    @property
    def batch(self) -> Batch:
        """The queries to measure with."""
        return Batch(self.query, self.own, self.length)

    @property
    def positives(self) -> float:
        """Share of the queries that meet the object."""
        return float(self.truth.mean())

    @property
    def left(self) -> float:
        """Seconds for fits: what is left of the budget, less what the times at the end take."""
        return self.spending.left - FINAL * self.measuring

    def best(self, tried: list[Tried]) -> float:
        """The least cost so far, nanoseconds."""
        return min([self.narrow_ns, *(each.row.cost for each in tried if not each.row.why_not)])

    def measured_own(self, bounders: Mapping[str, Bounder | DistanceBounder]) -> list[Tried]:
        """What the caller has already."""
        for label, bounder in bounders.items():
            self._check_own(label, bounder)
        return [self._measured(label, bounder.to(self.device), 0.0) for label, bounder in bounders.items()]

    def from_before(self, candidates: list[Candidate]) -> dict[str, Tried]:
        """What the folder holds, the cheaper one where it has several fits; what they took is charged to the budget."""
        found = {}
        for each in candidates:
            attempts = self.kept.of(each.label)
            self.spending.charged += attempts.taken
            self.pace.learn(each, attempts.setup, attempts.round)
            self.tell(each.label)
            held = [
                self._measured(each.label, bounder, float(bounder.info["training"]["seconds"]))
                for _, bounder in self.kept.get(each.label, self.device)
            ]
            if held:
                found[each.label] = min(held, key=lambda one: one.row.cost)
            else:
                attempts.given.clear()
        return found

    def fitted(self, candidate: Candidate, seconds: float, limit: float) -> Tried | None:
        """The candidate, fitted in so many seconds; ``None`` where it is impossible, was stopped, or is too slow to be judged.

        Args:
            candidate: Not kept before.
            seconds: That ``fit`` is given.
            limit: Seconds after which it is stopped.
        """
        attempts, started = self.kept.of(candidate.label), working_seconds()
        watched = candidate.network and not candidate.front
        watch = Watch(
            seconds if watched else math.inf, self.pace.reserved, lambda note: self.tell(f"{candidate.label}: {note}")
        )
        self.tell(candidate.label)
        bounder = None
        try:
            with limited(limit), warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", BoundingWarning
                )  # of coarse cells: the row tells what they cost; choose has told the rest
                bounder = fit(
                    self.shape,
                    DISTANCE.name if candidate.distance else self.query,
                    candidate.method,
                    budget=seconds,
                    device=self.device,
                    progress=watch,
                    **self._options_of(candidate),
                )
        except OutOfTimeError:
            attempts.limit = limit
        except TooSlowError:
            pass
        except BoundingError as error:
            attempts.error = " ".join(str(error).split())
            self.pass_over(candidate.label, attempts.error)
        except KeyboardInterrupt:
            self.interrupted = True
        taken = working_seconds() - started
        attempts.taken += taken
        if watched:
            attempts.setup, attempts.round = watch.setup, watch.round
            self.pace.learn(candidate, watch.setup, watch.round)
        if bounder is None:
            self.kept.note()
            return None
        self.passed.pop(candidate.label, None)  # it was not tried, or stopped, before
        one = self._measured(candidate.label, bounder, float(bounder.info["training"]["seconds"]))
        if bounder.info["training"].get("interrupted"):
            self.interrupted = True
            return one
        if candidate.network:
            self.pace.took(seconds, taken)
            attempts.starved = starved(bounder, one.row.share - self.positives, self.own)
        self.kept.put(candidate.label, bounder, seconds)
        attempts.given.append(seconds)
        self.kept.note()
        return one

    def not_tried(self, candidate: Candidate, seconds: float, budget: float, begun: str = NOT_TRIED) -> None:
        """Make a row of what there was no time for, with the budget that it would need."""
        self.foreseen[candidate.label] = seconds
        budget = told_budget(max(budget, self.spending.budget))
        why = f"{begun}needs a budget of {'' if begun == NOT_TRIED else 'more than '}{budget:g} s"
        self.passed[candidate.label] = Row(
            candidate.label, candidate.least_bytes, math.nan, math.nan, math.nan, why_not=why, needs=budget
        )

    def front_seconds(self, candidate: Candidate) -> float:
        """What is fitted before a cascade's network takes, as far as that is known by itself; 0 for others."""
        return self.foreseen.get(candidate.front, self.kept.of(candidate.front).taken) if candidate.front else 0.0

    def fits(self, candidate: Candidate) -> bool:
        """Whether a network has no more numbers than memory holds; else it has its row."""
        if self.memory is None or candidate.least_bytes <= self.memory:
            return True
        self.pass_over(candidate.label, "over the memory limit", candidate.least_bytes)
        return False

    def tell(self, note: str) -> None:
        """Say what is being done, and how much of the budget is spent."""
        if self.update is not None:
            self.update(min(self.spending.spent, self.spending.budget), self.spending.budget, note)

    def _options_of(self, candidate: Candidate) -> dict:
        """Of its fit; a distance is of the shape alone."""
        common = self.options
        if candidate.distance:
            common = {name: common[name] for name in ("margin", "seed")}
        return common | candidate.options

    def pass_over(self, label: str, why: str, nbytes: int = 0) -> None:
        """Make a row of what cannot be fitted."""
        self.passed[label] = Row(label, nbytes, math.nan, math.nan, math.nan, why_not=why)

    def _check_own(self, label: str, bounder: Bounder | DistanceBounder) -> None:
        able = bounder.query_kind == self.query
        if isinstance(bounder, DistanceBounder):
            able = self.query in ASKED and not (bounder.domain.time and QUERIES[self.query].is_region)
        if not able or bounder.ndim != self.shape.ndim or label == NONE:
            expected = f"{self.query} queries in {self.shape.ndim}D"
            raise BounderError(f"bounders: expected ones of {expected}, got {label!r}: {bounder!r}")

    def _measured(self, label: str, bounder: Bounder | DistanceBounder, seconds: float) -> Tried:
        """A candidate with its row; its time is taken once more at the end."""
        started = working_seconds()
        maybe = self.batch.maybe(bounder)
        doubtful = self.own[self.truth & ~maybe]  # of a shape without cells some may be undecided, and not missed
        missed = int(QUERIES[self.query].certain(self.bounded, doubtful, self.length).sum()) if len(doubtful) else 0
        share = float(maybe.mean())
        kind = "" if bounder.certificate is None else bounder.certificate.kind
        nanoseconds = self.overhead_ns + times_of({label: bounder}, self.batch, TURNS // 3)[label]
        why = ""
        if missed:
            why = f"denies {missed:,} queries that meet the object"
        elif not bounder.conservative or not ((bounder.certificate and bounder.certificate.proven) or self.statistical):
            why = f"not proven ({kind or 'no certificate'})"
        elif self.memory is not None and bounder.nbytes > self.memory:
            why = "over the memory limit"
        cost = nanoseconds + share * self.narrow_ns
        self.measuring += working_seconds() - started
        return Tried(label, bounder, Row(label, bounder.nbytes, nanoseconds, share, cost, kind, missed, seconds, why))


def told_budget(seconds: float) -> float:
    """A budget as it is told: rounded up to two digits."""
    unit = 10 ** max(math.floor(math.log10(max(seconds, 1.0))) - 1, 0)
    return float(unit * math.ceil(seconds / unit))
