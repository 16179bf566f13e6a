"""``choose``: fit what is plausible, measure it on the caller's own queries, and take what costs the least.

Closed forms are fitted first. Networks get little time in the first round, and the better half of them twice as much in the next one; what cannot
become the cheapest even if it left nothing but positives is given up. Half of the queries are for fitting, and what is told is measured on the other half. Times are
taken at the end, of all candidates in turns.
"""

import hashlib
import math
import time
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder
from warp_bounding.choice.candidates import NETWORKS, Candidate, candidates_of
from warp_bounding.choice.kept import Kept
from warp_bounding.choice.result import NONE, Choice, Row
from warp_bounding.coordinates.region_domain import SPACES, domain_of
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.parts.complement import SIDES
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import QUERIES, check_query, oracle, sample
from warp_bounding.runtime.devices import device_of
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.training import fit
from warp_bounding.training.checks import check_numbers, check_regions, is_number
from warp_bounding.training.samples.callers import CallersQueries

__all__ = ["choose"]

SAMPLES = 200_000  # random queries, where the caller has none
TIMED, TURNS = 200_000, 9  # queries of a timed launch, at least, and launches of each
LEAST_SECONDS = 3.0  # of a network's fit in the first round
# Of the budget, for what is no network; most of that are closed forms, found at once, and few learn, of which each may take this part of it.
QUICK_SHARE, QUICK_PART = 0.25, 1 / 3


@dataclass(frozen=True)
class _Tried:
    """A fitted candidate, and what it costs."""

    label: str
    bounder: Bounder
    row: Row


def choose(
    shape,
    query: str = "point",
    *,
    narrow_ns: float,
    queries=None,
    memory: int | None = None,
    device: str | None = None,
    budget: float = 120.0,
    seed: int = 0,
    margin: float = 0.0,
    length: float | None = None,
    networks: Iterable[tuple[int, ...]] = NETWORKS,
    bounders: Mapping[str, Bounder] | None = None,
    statistical: bool = False,
    folder=None,
    progress: Progress | bool | None = None,
) -> Choice:
    """Choose a broad phase: fit candidates of every method, in several sizes, measure them on your own queries, and take the cheapest.

    What counts is ``t + p * narrow_ns``: the nanoseconds that a bounder takes for a query, and the share of the queries that it
    leaves to a narrow phase of this price (paper, Eq. 6). No bounder at all is one of the answers.

    Args:
        shape: What ``load_indicator`` returns, or anything that it takes.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        narrow_ns: What your exact test takes for one query, nanoseconds.
        queries: ``(Q, m)`` numbers, object space, as your simulation asks them, in its order; random ones if ``None``. A few thousand at least; half of them are fitted to.
        memory: Most bytes that a query may read (``Bounder.nbytes``).
        device: Warp device where it is measured, and of the bounder; the default device if ``None``.
        budget: Seconds for all fits; compiling kernels, once for each size of network, is not counted.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        length: Length of a ray, object units; 1 if ``None``. Other queries have none.
        networks: Hidden widths of the networks that are tried; none of them for ``()``.
        bounders: Bounders of this very shape that you have already, by name; they are measured with the others.
        statistical: Whether a bounder that samples attest may be chosen, too; else only proven ones are.
        folder: Where candidates are kept as they are fitted; a call with the same settings goes on there. ``None`` keeps nothing.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends fitting; what was fitted is then compared.

    Returns:
        The choice, with rows of all candidates and the prices of the narrow phase at which another one is the best.

    Raises:
        IndicatorError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query, or queries that are none of it.
        BounderError: For a price, memory or budget that makes no sense, or memory that holds no candidate at all.
        FileFormatError: For a folder that holds something else.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, budget=5.0, networks=(), device="cpu", progress=False)
        >>> choice.rows[0].cost <= min(row.cost for row in choice.rows if not row.why_not)
        True
    """
    check_query(query)
    check_numbers(budget, seed, margin)
    _check(query, narrow_ns, memory, length, statistical)
    device = str(device_of(device, BounderError))
    shape, length = load_indicator(shape), length or 1.0
    bounded, rng = shape.dilated(margin) if margin else shape, np.random.default_rng(seed)
    x = sample(query, bounded, SAMPLES, rng) if queries is None else queries
    told = CallersQueries(x, bounded, domain_of(bounded, query, length, SPACES[0]), seed)
    learned, own = _halves(told.x, rng)
    options = {"margin": margin, "seed": int(seed)} | ({"length": length} if QUERIES[query].has_length else {})
    settings = {"shape": bounded.digest, "query": query, **options}
    settings["queries"] = hashlib.sha256(told.x.tobytes()).hexdigest() if queries is not None else None
    work = _Work(
        shape,
        query,
        options | {"queries": None if queries is None else learned},
        own,
        np.asarray(oracle(query, bounded, "cpu", length)(own), dtype=bool),
        float(narrow_ns),
        memory,
        device,
        statistical,
        Kept(folder, settings),
    )
    with reported(progress, "choose") as update:
        tried = work.all(candidates_of(query, shape, tuple(map(tuple, networks))), budget, bounders or {}, update)
    return work.chosen(tried, len(told.x))


@dataclass
class _Work:
    """One choice in the making.

    Attributes:
        shape: As it came.
        query: Kind of query.
        options: Of every fit.
        own: ``(Q, m)`` queries to measure with.
        truth: ``(Q,)`` bool, which of them meet the object.
        narrow_ns: Price of the narrow phase.
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
    own: np.ndarray
    truth: np.ndarray
    narrow_ns: float
    memory: int | None
    device: str
    statistical: bool
    kept: Kept
    passed: list[Row] = field(default_factory=list)
    interrupted: bool = False

    @property
    def positives(self) -> float:
        """Share of the queries that meet the object."""
        return float(self.truth.mean())

    def all(self, candidates: list[Candidate], budget: float, bounders: Mapping[str, Bounder], update) -> list[_Tried]:
        """Everything fitted that is worth it."""
        tried = []
        for label, bounder in bounders.items():
            self._check_own(label, bounder)
            tried.append(self._measured(label, bounder.to(self.device), 0.0))
        quick = [each for each in candidates if not each.network]
        for number, each in enumerate(quick):
            if self.interrupted:
                break
            _tell(update, QUICK_SHARE * number / max(len(quick), 1), each.label)
            tried += self._fitted(each, QUICK_PART * QUICK_SHARE * budget)
        rivals = [each for each in candidates if each.network and self._fits(each)]
        return tried + self._races(rivals, tried, (1 - QUICK_SHARE) * budget, update)

    def _races(self, rivals: list[Candidate], tried: list[_Tried], budget: float, update) -> list[_Tried]:
        """Networks: all of them with little time, then the better half with twice as much, and so on."""
        # seconds depend on no clock, so that a choice that goes on finds what it has fitted
        count, found = len(rivals), {}
        rounds = max(math.ceil(math.log2(count)), 1) if rivals else 0
        for number in range(rounds):
            best = min([self.narrow_ns, *(each.row.cost for each in tried if not each.row.why_not)])
            rivals = [each for each in rivals if self._may_win(found.get(each.label), best)]
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

    def _may_win(self, found: _Tried | None, best: float) -> bool:
        """Whether a network could become the cheapest if it left nothing but the positives."""
        nanoseconds = 0.0 if found is None else found.row.nanoseconds
        return nanoseconds + self.positives * self.narrow_ns < best

    def _fits(self, candidate: Candidate) -> bool:
        if self.memory is None or candidate.least_bytes <= self.memory:
            return True
        self._pass(candidate.label, "over the memory limit", candidate.least_bytes)
        return False

    def _fitted(self, candidate: Candidate, seconds: float) -> list[_Tried]:
        """The candidate, fitted with so many seconds or taken from the folder; none where it is impossible."""
        bounder = self.kept.get(candidate.label, seconds, self.device)
        if bounder is None:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter(
                        "ignore", BoundingWarning
                    )  # of cells that are coarse: the row tells what it costs
                    bounder = fit(
                        self.shape,
                        self.query,
                        candidate.method,
                        budget=seconds,
                        device=self.device,
                        progress=False,
                        **self.options,
                        **candidate.options,
                    )
            except BoundingError as error:
                self._pass(candidate.label, " ".join(str(error).split()))
                return []
            except KeyboardInterrupt:
                self.interrupted = True
                return []
            if (bounder.info.get("training") or {}).get("interrupted"):
                self.interrupted = True
            else:
                self.kept.put(candidate.label, seconds, bounder)
        return [
            self._measured(candidate.label, bounder, float((bounder.info.get("training") or {}).get("seconds") or 0))
        ]

    def _pass(self, label: str, why: str, nbytes: int = 0) -> None:
        self.passed.append(Row(label, nbytes, math.nan, math.nan, math.nan, why_not=why))

    def _check_own(self, label: str, bounder: Bounder) -> None:
        if bounder.query_kind != self.query or bounder.ndim != self.shape.ndim or label == NONE:
            expected = f"{self.query} queries in {self.shape.ndim}D"
            raise BounderError(f"bounders: expected ones of {expected}, got {label!r}: {bounder!r}")

    def _measured(self, label: str, bounder: Bounder, seconds: float) -> _Tried:
        """A candidate with its row; its time is taken once more at the end."""
        maybe = bounder.query(self.own).numpy() == 1
        missed, share = int((self.truth & ~maybe).sum()), float(maybe.mean())
        kind = "" if bounder.certificate is None else bounder.certificate.kind
        nanoseconds = _nanoseconds({label: bounder}, self.own, TURNS // 3)[label]
        why = ""
        if missed:
            why = f"denies {missed:,} queries that meet the object"
        elif not bounder.conservative or not ((bounder.certificate and bounder.certificate.proven) or self.statistical):
            why = f"not proven ({kind or 'no certificate'})"
        elif self.memory is not None and bounder.nbytes > self.memory:
            why = "over the memory limit"
        cost = nanoseconds + share * self.narrow_ns
        return _Tried(label, bounder, Row(label, bounder.nbytes, nanoseconds, share, cost, kind, missed, seconds, why))

    def chosen(self, tried: list[_Tried], queries: int) -> Choice:
        """The choice, with times taken in turns."""
        if self.memory is not None and not any(each.bounder.nbytes <= self.memory for each in tried):
            sizes = [(each.bounder.nbytes, each.label) for each in tried] + [
                (r.nbytes, r.label) for r in self.passed if r.nbytes
            ]
            nearest = f"; the nearest is {min(sizes)[1]} with {min(sizes)[0]:,}" if sizes else ""
            raise BounderError(f"memory: no candidate has {self.memory:,} bytes or less{nearest}")
        times = _nanoseconds({each.label: each.bounder for each in tried}, self.own, TURNS)
        rows = [Row(NONE, 0, 0.0, 1.0, self.narrow_ns, "by construction")]
        for each in tried:
            nanoseconds = times[each.label]
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


def _halves(x: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Queries to fit to, in any order, and queries to measure with, in the caller's order; one alone is both."""
    if len(x) < 2:
        return x, x
    first = np.zeros(len(x), dtype=bool)
    first[rng.permutation(len(x))[: len(x) // 2]] = True
    return x[first], x[~first]


def _nanoseconds(bounders: Mapping[str, Bounder], x: np.ndarray, turns: int) -> dict[str, float]:
    """Of one query in a batch of these, the fastest of some launches, which take turns: whatever else the machine does slows all alike."""
    x = np.resize(x, (max(len(x), TIMED), x.shape[1]))
    asked = {}
    for label, bounder in bounders.items():
        queries = wp.array(x, dtype=wp.float32, device=bounder.device)
        asked[label] = bounder.prepare(queries)
    times = dict.fromkeys(bounders, math.inf)
    for turn in range(turns + 1):
        for label, prepared in asked.items():
            device = wp.get_device(bounders[label].device)
            wp.synchronize_device(device)
            start = time.perf_counter()
            prepared.launch()
            wp.synchronize_device(device)
            if turn:  # the first one loads kernels
                times[label] = min(times[label], time.perf_counter() - start)
    return {label: 1e9 * seconds / len(x) for label, seconds in times.items()}


def _tell(update: Progress | None, done: float, note: str) -> None:
    if update is not None:
        update(done, 1.0, note)


def _check(query: str, narrow_ns, memory, length, statistical) -> None:
    if not is_number(narrow_ns) or narrow_ns < 0:
        raise BounderError(f"narrow_ns must be a number of nanoseconds of at least 0, got {narrow_ns!r}")
    whole = isinstance(memory, (int, np.integer)) and not isinstance(memory, bool)
    if memory is not None and not (whole and memory > 0):
        raise BounderError(f"memory must be a whole number of bytes of at least 1, got {memory!r}")
    check_regions(query, NONE, length, None, SIDES[0])
    if not isinstance(statistical, bool):
        raise BounderError(f"statistical must be True or False, got {statistical!r}")
