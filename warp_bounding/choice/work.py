"""A choice in the making: candidates are fitted, the best networks with more and more time, and measured."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.choice.candidates import Candidate
from warp_bounding.choice.kept import Kept
from warp_bounding.choice.result import NONE, Choice, Row
from warp_bounding.choice.timing import TURNS, Batch, times_of
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning
from warp_bounding.evaluation.distances import ASKED
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import QUERIES
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.runtime.progress import Progress
from warp_bounding.training import fit

__all__ = ["Tried", "Work"]

LEAST_SECONDS = 1.0  # of a network's fit in the first round
# Of the budget, for what is no network; most of that are closed forms, found at once, and few learn, of which each may take this part of it.
QUICK_SHARE, QUICK_PART = 0.25, 1 / 3


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
        passed: Rows of what was not fitted, with why not.
        interrupted: Whether Ctrl-C has ended fitting.
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
    passed: list[Row] = field(default_factory=list)
    interrupted: bool = False

    @property
    def batch(self) -> Batch:
        """The queries to measure with."""
        return Batch(self.query, self.own, self.length)

    @property
    def positives(self) -> float:
        """Share of the queries that meet the object."""
        return float(self.truth.mean())

    def all(
        self, candidates: list[Candidate], budget: float, bounders: Mapping[str, Bounder | DistanceBounder], update
    ) -> list[Tried]:
        """Everything fitted that is worth it."""
        tried = []
        for label, bounder in bounders.items():
            self._check_own(label, bounder)
            tried.append(self._measured(label, bounder.to(self.device), 0.0))
        quick, part, late = [each for each in candidates if not each.network], QUICK_PART * QUICK_SHARE * budget, set()
        for number, each in enumerate(quick):
            if self.interrupted:
                break
            if each.method in late:  # sizes come in order, and each takes several times as long as the one before
                self._pass(each.label, "a smaller one took longer than its part of the budget")
                continue
            _tell(update, QUICK_SHARE * number / max(len(quick), 1), each.label)
            found = self._fitted(each, part)
            late |= {each.method for one in found if one.row.seconds > part}
            tried += found
        rivals = [each for each in candidates if each.network]
        return tried + self._races(rivals, tried, (1 - QUICK_SHARE) * budget, update)

    def _races(self, rivals: list[Candidate], tried: list[Tried], budget: float, update) -> list[Tried]:
        """Networks: all of them with little time, then the better half with twice as much, and so on."""
        # seconds depend on no clock and no limit, so that a choice that goes on, or has other ones, finds what it has fitted
        count, found = len(rivals), {}
        rounds = math.ceil(math.log2(count)) + 1 if rivals else 0  # in the last one, one is left
        for number in range(rounds):
            best = min([self.narrow_ns, *(each.row.cost for each in tried if not each.row.why_not)])
            rivals = [each for each in rivals if self._fits(each) and self._may_win(found.get(each.label), best)]
            if number:  # the better half by what they cost so far
                order = sorted(rivals, key=lambda each: found[each.label].row.cost)
                rivals = order[: math.ceil(count / 2**number)]
            seconds = max(budget / rounds / math.ceil(count / 2**number), LEAST_SECONDS)
            for place, each in enumerate(rivals):
                if self.interrupted:
                    break
                done = QUICK_SHARE + (1 - QUICK_SHARE) * (number + place / max(len(rivals), 1)) / rounds
                _tell(update, done, f"{each.label}, {seconds:.0f} s")
                for fitted in self._fitted(each, seconds):
                    before = found.get(each.label)
                    if before is None or fitted.row.cost <= before.row.cost:
                        found[each.label] = fitted
            rivals = [each for each in rivals if each.label in found]
        return list(found.values())

    def _may_win(self, found: Tried | None, best: float) -> bool:
        """Whether a network could become the cheapest if it left nothing but the positives."""
        if found is not None and self.memory is not None and found.bounder.nbytes > self.memory:
            return False
        nanoseconds = 0.0 if found is None else found.row.nanoseconds
        return nanoseconds + self.positives * self.narrow_ns < best

    def _fits(self, candidate: Candidate) -> bool:
        if self.memory is None or candidate.least_bytes <= self.memory:
            return True
        self._pass(candidate.label, "over the memory limit", candidate.least_bytes)
        return False

    def _fitted(self, candidate: Candidate, seconds: float) -> list[Tried]:
        """The candidate, fitted with so many seconds or taken from the folder; none where it is impossible."""
        bounder = self.kept.get(candidate.label, seconds, self.device)
        if bounder is None:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter(
                        "ignore", BoundingWarning
                    )  # of coarse cells the row tells what they cost; choose has told the rest
                    bounder = fit(
                        self.shape,
                        DISTANCE.name if candidate.distance else self.query,
                        candidate.method,
                        budget=seconds,
                        device=self.device,
                        progress=False,
                        **self._options_of(candidate),
                    )
            except BoundingError as error:
                self._pass(candidate.label, " ".join(str(error).split()))
                return []
            except KeyboardInterrupt:
                self.interrupted = True
                return []
            if bounder.info["training"].get("interrupted"):
                self.interrupted = True
            else:
                self.kept.put(candidate.label, seconds, bounder)
        return [self._measured(candidate.label, bounder, float(bounder.info["training"]["seconds"]))]

    def _options_of(self, candidate: Candidate) -> dict:
        """Of its fit; a distance is of the shape alone."""
        common = self.options
        if candidate.distance:
            common = {name: common[name] for name in ("margin", "seed")}
        return common | candidate.options

    def _pass(self, label: str, why: str, nbytes: int = 0) -> None:
        self.passed.append(Row(label, nbytes, math.nan, math.nan, math.nan, why_not=why))

    def _check_own(self, label: str, bounder: Bounder | DistanceBounder) -> None:
        able = bounder.query_kind == self.query
        if isinstance(bounder, DistanceBounder):
            able = self.query in ASKED and not (bounder.domain.time and QUERIES[self.query].is_region)
        if not able or bounder.ndim != self.shape.ndim or label == NONE:
            expected = f"{self.query} queries in {self.shape.ndim}D"
            raise BounderError(f"bounders: expected ones of {expected}, got {label!r}: {bounder!r}")

    def _measured(self, label: str, bounder: Bounder | DistanceBounder, seconds: float) -> Tried:
        """A candidate with its row; its time is taken once more at the end."""
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
        return Tried(label, bounder, Row(label, bounder.nbytes, nanoseconds, share, cost, kind, missed, seconds, why))

    def chosen(self, tried: list[Tried], queries: int) -> Choice:
        """The choice, with times taken in turns."""
        if self.memory is not None and not any(each.bounder.nbytes <= self.memory for each in tried):
            sizes = [(each.bounder.nbytes, each.label) for each in tried]
            nearest = f"; the nearest is {min(sizes)[1]} with {min(sizes)[0]:,}" if sizes else ""
            raise BounderError(f"memory: no candidate has {self.memory:,} bytes or less{nearest}")
        times = times_of({each.label: each.bounder for each in tried}, self.batch, TURNS)
        rows = [Row(NONE, 0, 0.0, 1.0, self.narrow_ns, "by construction")]
        for each in tried:
            nanoseconds = self.overhead_ns + times[each.label]
            rows.append(replace(each.row, nanoseconds=nanoseconds, cost=nanoseconds + each.row.share * self.narrow_ns))
        rows.sort(key=lambda row: (bool(row.why_not), row.cost))
        best = rows[0].label
        bounder = next((each.bounder for each in tried if each.label == best), None)
        on_cpu = wp.get_device(self.device).is_cpu
        return Choice(
            bounder,
            best,
            (*rows, *self.passed),
            self.narrow_ns,
            self.positives,
            queries,
            self.memory,
            self.device,
            cpu_threads() if on_cpu else 0,
            {"shape": self.shape.name, "query": self.query, "interrupted": self.interrupted},
        )


def _tell(update: Progress | None, done: float, note: str) -> None:
    if update is not None:
        update(done, 1.0, note)
