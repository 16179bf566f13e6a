"""Which bounder costs the least for these queries, this narrow phase and this machine?

A broad phase saves what the narrow phase would take for the queries that it denies, less ``t`` nanoseconds a query of
its own. With ``N`` ns a query on average, and a share ``w`` of the narrow phase's time that is left, a query costs
``t + w N``. Where all queries cost alike ``w`` is the share of the queries that are left (paper, Eq. 6); they seldom
do, since what is left is close to the object.

``choose`` fits candidates to one half of the queries and measures them on the other. Each has an equal share of the
time that is left, the quickest first: networks share what closed forms do not take. No closed form may take more than
half of what is left.
"""

import contextlib
import hashlib
import io
import json
import math
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.bounders import METHODS, Bounder, load
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, FileFormatError, warn
from warp_bounding.evaluation import ASKED, parts_of
from warp_bounding.kernels.functions import Data
from warp_bounding.queries import QUERIES, check_query, oracle, sample
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.arrays import compact
from warp_bounding.runtime.launch import (
    OutOfTimeError,
    compile_seconds,
    cpu_threads,
    device_of,
    limited,
    working_seconds,
)
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.shapes import Grid, load_shape
from warp_bounding.shapes.complement import SIDES
from warp_bounding.shapes.recentred import own_coordinates
from warp_bounding.shapes.shape import Shape
from warp_bounding.training import fit
from warp_bounding.training.fit import check_asked, check_numbers, is_number, trainer_of, warn_of_restriction
from warp_bounding.training.samples import CallersQueries
from warp_bounding.version import __version__

NONE = "none"  # label of no broad phase

# --- candidates ------------------------------------------------------------------------------------------------------

NETWORKS = ((24, 24), (16, 16), (50, 50))  # hidden widths, in the order in which they are tried
PREFILTER, BEHIND = "learned-kdop", (24, 24)  # of the cascade: its first method, and the network behind it
CASCADE = f"{PREFILTER}+{Mlp.method}"
SIZES: dict[str, list[dict[str, Any]]] = {  # of closed forms, the quickest to fit first
    "voxels": [{"resolution": cells} for cells in (16, 32, 64, 128)],
    "bvh": [{"leaves": leaves} for leaves in (16, 64, 256, 1024, 4096)],
    **{name: [{}] for name in ("aabb", "sphere", "ellipsoid", "oriented-ellipsoid", "obb")},
    "kdop": [{}, {"k": 26}],
    PREFILTER: [{}],  # from here on they learn
    "relu-field": [{}],
}
BYTES = 4  # of a network's number


class Candidate(NamedTuple):
    """What ``fit`` is called with."""

    label: str  # method and size
    method: str
    options: dict[str, Any]
    nbytes: int = 0  # of a network, at least; 0 of closed forms


def candidates_of(query: str, shape: Shape) -> Iterator[Candidate]:
    """All candidates for a kind of query about a shape, in the order in which they are tried."""
    able = {name: cls for name, cls in METHODS.items() if cls.conservative and cls.supports(query, shape.ndim)}
    neural = [name for name, cls in able.items() if trainer_of(cls).proves]
    for name in sorted(able.keys() - set(neural), key=[*SIZES, *able].index):
        known = {option.name for option in able[name].options if query in option.queries}
        known |= set() if isinstance(shape, Grid) else {"resolution"}
        known -= set() if shape.ndim == 3 else {"k"}
        for size in [size for size in SIZES.get(name, [{}]) if known >= set(size)] or [{}]:
            words = [name, *(f"{key} {value}" for key, value in size.items())]
            yield Candidate(" ".join(words), name, size)
    # of all but the plain ones one size, since each compiles kernels of its own
    named = [(name, hidden) for name in neural for hidden in (NETWORKS if able[name] is Mlp else NETWORKS[-1:])]
    if Mlp.method in neural and PREFILTER in able:
        named.append((CASCADE, BEHIND))
    for name, hidden in named:
        numbers = sum(k * h + h for k, h in pairwise((shape.ndim, *hidden, 1)))
        yield Candidate(f"{name} {'-'.join(map(str, hidden))}", name, {"hidden": hidden}, BYTES * numbers)


# --- result ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One candidate, measured on the caller's queries."""

    label: str  # method and size; ``"none"`` is no broad phase
    nbytes: int  # of memory that a query can read
    nanoseconds: float = math.nan  # of a query, as ``how`` says, overhead included
    share: float = math.nan  # of the queries that it leaves to the narrow phase
    work: float = math.nan  # of the narrow phase's time that it leaves; ``share`` where all queries cost alike
    cost: float = math.nan  # ``nanoseconds + work * narrow_ns``
    certificate: str = ""  # its kind, if it has one
    missed: int = 0  # queries that meet the object and that it denied: none where it is proven
    seconds: float = 0.0  # that its fit took
    why_not: str = ""  # why it cannot be chosen


class Stretch(NamedTuple):
    """Mean prices of the narrow phase, nanoseconds a query, from which on one broad phase costs the least."""

    price: float
    label: str


def cheapest(rows: Iterable[Row]) -> list[Stretch]:
    """The lower envelope of the lines ``nanoseconds + work * price``, from price 0 on."""
    rows = list(rows)
    at = min(rows, key=lambda row: (row.nanoseconds, row.work))
    found = [Stretch(0.0, at.label)]
    while flatter := [row for row in rows if row.work < at.work]:
        # the one that is met first goes on; of several the flattest
        meets = [((row.nanoseconds - at.nanoseconds) / (at.work - row.work), row.work, row) for row in flatter]
        price, _, at = min(meets, key=lambda meeting: meeting[:2])
        if price <= found[-1].price:
            found.pop()
        found.append(Stretch(price if found else 0.0, at.label))
    return found


def duration(nanoseconds: float) -> str:
    """A time in words, with three digits and a unit."""
    units = ((1.0, "ns"), (1e3, "us"), (1e6, "ms"), (1e9, "s"))
    size, unit = next((size, unit) for size, unit in units if nanoseconds < 999.5 * size or unit == "s")
    return f"{nanoseconds / size:.3g} {unit}"


@dataclass(frozen=True)
class Choice:
    """The broad phase that costs the least, with all that it was compared with; ``print`` shows a table.

    Attributes:
        bounder: The bounder, or distance; ``None`` where none pays.
        rows: Of all candidates, the cheapest first.
        narrow_ns: What the narrow phase takes for a query where there is no broad phase, nanoseconds, the mean of all.
        positives: Share of the queries that meet the object: no broad phase leaves less.
        queries: How many queries there were; ``choose`` measures on half of them.
        about: How it was found: prices, queries far away, ``how``, memory, device, threads of a CPU, budget, seconds.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, methods=("aabb", "obb"), device="cpu", progress=False)
        >>> choice.bounder.certificate.proven, choice.label == choice.rows[0].label
        (True, True)
    """

    bounder: Bounder | None
    rows: tuple[Row, ...]
    narrow_ns: float
    positives: float
    queries: int
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def row(self) -> Row:
        """The chosen row, which is the first."""
        return self.rows[0]

    @property
    def label(self) -> str:
        """That of the chosen row; ``"none"`` where none pays."""
        return self.row.label

    @property
    def prices(self) -> list[Stretch]:
        """The best at other prices of the narrow phase: each from its price on, up to the next one's."""
        return cheapest(row for row in self.rows if not row.why_not)

    @property
    def times(self) -> float:
        """How many times as fast a query is, predicted: without a broad phase over with this one."""
        return self.narrow_ns / self.row.cost if self.row.cost else 1.0

    @property
    def why(self) -> str:
        """In a sentence, why this one."""
        row, narrow = self.row, duration(self.narrow_ns)
        if row.label == NONE:
            return f"none pays: the narrow phase takes {narrow}, and no candidate that can be chosen costs less"
        leaves = f"it takes {duration(row.nanoseconds)} and leaves {100 * row.share:.3g} % of the queries"
        must = f"of which {100 * self.positives:.3g} % must be left, and {100 * row.work:.3g} % of {narrow} of testing"
        return f"{row.label}: {duration(row.cost)} a query in all, {self.times:.3g} times as fast; {leaves}, {must}"

    def __str__(self) -> str:
        """A table: the candidates that can be chosen, the cheapest first, and then the others, with the reason."""
        wide = max(len(row.label) for row in self.rows)
        about = [f"{self.queries:,} queries: {100 * self.positives:.3g} % meet the object"]
        lines = [", ".join(filter(None, [*about, *map(self.about.get, ("far", "priced", "how", "device"))])), ""]
        lines += [f"{'':{wide}} {'bytes':>11} {'test ns':>8} {'left %':>7} {'time %':>7} {'ns in all':>9} {'times':>6}"]
        for row in self.rows:
            shares, times = f"{100 * row.share:7.3g} {100 * row.work:7.3g}", self.narrow_ns / (row.cost or math.nan)
            numbers = f"{row.nanoseconds:8.3g} {shares} {row.cost:9.4g} {times:6.2f}" if row.share >= 0 else " " * 41
            lines.append(f"{row.label:{wide}} {row.nbytes:11,} {numbers}  {row.why_not or row.certificate}".rstrip())
        legend = "test: the bounder; left: queries, and time of the narrow phase; in all: both, and times as fast"
        return "\n".join([*lines, "", legend])

    def to_dict(self) -> dict[str, Any]:
        """All but the bounder, JSON-ready."""
        names = ("label", "narrow_ns", "times", "positives", "queries", "why")
        lists = {"prices": [each._asdict() for each in self.prices], "rows": [asdict(row) for row in self.rows]}
        return {name: getattr(self, name) for name in names} | lists | self.about


# --- measuring -------------------------------------------------------------------------------------------------------

# Queries of a timed launch, at least, and launches in a row; more on a GPU (True), where a launch takes as long as some
# 300,000 queries of a network.
TIMED = {False: (200_000, 1), True: (4_000_000, 5)}
TURNS, ROUGH = 15, 3  # launches of each candidate, and where no more than about so long is of interest
MOST_SECONDS = 0.3  # of one candidate's launches, after which no more are timed
# Queries of the caller's exact test to begin with, which grow until they take so many seconds, and in how many calls:
# of short ones the least is hardly slowed by what else the machine does.
FEW, LONG, PARTS = 100, 0.02, 20
CHECKED, UNLIKE = (
    5000,
    1e-3,
)  # queries whose answers are checked, and share of them, more than is rounded, for a warning


def batch_of(bounder: Bounder, query: str, x: np.ndarray, length: float) -> Callable[[], tuple[wp.array, wp.array]]:
    """A launch that lists what a bounder, or a distance in its place, leaves; the queries lie on its device before."""
    parts = [wp.array(part, dtype=wp.float32, device=bounder.device) for part in parts_of(query, x)]
    if bounder.of_distances:
        ask = ASKED[query](bounder, length)
        return lambda: compact(ask(*parts))
    return bounder.prepare(wp.array(x, dtype=wp.float32, device=bounder.device), candidates=True).launch


def function_of(bounder: Bounder, query: str, x: np.ndarray, length: float) -> Callable[[], None]:
    """A launch of a kernel such as users write, which calls the bounder's function; Warp runs it on one core."""
    func, vec, region = bounder.func, wp.types.vector(bounder.ndim, wp.float32), QUERIES[query].is_region
    parts = [wp.array(part, dtype=vec, device=bounder.device) for part in np.split(x, 1 + region, axis=1)]

    @wp.kernel(enable_backward=False, module="unique")
    def ask(data: Data, a: wp.array(dtype=vec), b: wp.array(dtype=vec), out: wp.array(dtype=wp.bool)):
        i = wp.tid()
        if wp.static(region):
            out[i] = wp.static(func)(data, a[i], b[i])
        else:
            out[i] = wp.static(func)(data, a[i])

    inputs = [bounder.data, parts[0], parts[-1], wp.empty(len(x), dtype=wp.bool, device=bounder.device)]
    return wp.launch(ask, len(x), inputs, device=bounder.device, record_cmd=True).launch


HOW = {"batch": batch_of, "function": function_of}  # how a bounder is queried where it is timed


def fastest(calls: Mapping[Any, Callable[[], Any]], device: str, turns: int = TURNS) -> dict[Any, float]:
    """Seconds of each call: the least of calls in turns, so that what else the machine does slows all alike."""
    in_a_row = TIMED[wp.get_device(device).is_cuda][1]
    taken: dict[Any, list[float]] = {label: [] for label in calls}
    for turn in range(turns + 1):
        for label, call in calls.items():
            if sum(taken[label]) <= MOST_SECONDS:
                wp.synchronize_device(device)
                start = time.perf_counter()
                for _ in range(in_a_row):
                    call()
                wp.synchronize_device(device)
                if turn:  # the first one loads kernels
                    taken[label].append((time.perf_counter() - start) / in_a_row)
    return {label: min(seconds) for label, seconds in taken.items()}


def resized(x: np.ndarray, count: int) -> np.ndarray:
    """So many queries, in their order: spread over all, or all of them again and again."""
    return x[np.linspace(0, len(x) - 1, count).astype(int)] if count < len(x) else np.resize(x, (count, x.shape[1]))


def call_of(test: Callable, x: np.ndarray, device: str) -> Callable[[], Any]:
    """A call of the caller's exact test."""
    return partial(test, wp.array(x, dtype=wp.types.vector(x.shape[1], wp.float32), device=device))


def check_test(test: Callable, x: np.ndarray, truth: np.ndarray, device: str) -> None:
    """Refuse a test that does not answer these queries; warn of one that is about another object."""
    answers = call_of(test, x, device)()
    if (got := getattr(answers, "shape", type(answers).__name__)) != (len(x),):
        raise BounderError(f"narrow_ns: expected {len(x)} answers of the function to as many queries, got {got}")
    hits = np.asarray(answers.numpy() if hasattr(answers, "numpy") else answers).astype(bool)
    if (others := float((hits & ~truth).mean())) > UNLIKE:
        of = "of the queries meet the object, and the shape does not: is margin= missing, or another object meant?"
        warn(f"narrow_ns: your test says that {100 * others:.3g} % {of}")


def measured_works(test: Callable, kinds: Mapping[str, np.ndarray], device: str) -> tuple[float, dict[str, float]]:
    """``works_of`` of the caller's exact test: by kind of queries the share of its time that they take.

    One of the kinds, ``NONE``, is all queries. Calls take as long for each kind.
    """
    kinds, counts = {label: x for label, x in kinds.items() if len(x)}, dict.fromkeys(kinds, FEW)

    def seconds(turns: int) -> dict[str, float]:
        parts = {label: np.array_split(resized(x, counts[label]), PARTS) for label, x in kinds.items()}
        calls = {(label, k): call_of(test, parts[label][k], device) for k in range(PARTS) for label in parts}
        taken = fastest(calls, device, turns)
        return {label: sum(taken[label, k] for k in range(PARTS)) for label in kinds}

    most = TIMED[wp.get_device(device).is_cuda][0]
    while short := [label for label, taken in seconds(ROUGH).items() if taken < LONG and counts[label] < most]:
        counts |= {label: 2 * counts[label] for label in short}
    ns = {label: 1e9 * taken / counts[label] for label, taken in seconds(TURNS).items()}
    return ns[NONE], {label: len(x) / len(kinds[NONE]) * ns[label] / ns[NONE] for label, x in kinds.items()}


def why_not_of(bounder: Bounder, missed: int, memory: int | None, statistical: bool) -> str:
    """Why a bounder cannot be chosen; empty if it can."""
    certificate = bounder.certificate
    if missed:
        return f"denies {missed:,} queries that meet the object"
    if not bounder.conservative or not ((certificate and certificate.proven) or statistical):
        return f"not proven ({certificate.kind if certificate else 'no certificate'})"
    return "over the memory limit" if memory is not None and bounder.nbytes > memory else ""


def works_of(rows: list[Row], denied: float, left: float, positives: float) -> tuple[float, dict[str, float]]:
    """The mean price of a query, and the work of rows, where those that are denied have one price, those left another.

    A candidate saves ``denied`` for each query that it denies. What the best one leaves costs ``left``.
    """
    able = [(row.nanoseconds + row.share * denied, row.share) for row in rows if not row.why_not]
    mean = denied + min(able, default=(0.0, positives))[1] * (left - denied)
    per_denied = denied / mean if mean else 1.0
    return mean, {row.label: max(1 - (1 - row.share) * per_denied, 0.0) for row in rows}


# --- choose ----------------------------------------------------------------------------------------------------------

SAMPLES = 200_000  # random queries, where the caller has none
OVERDRAWN = 0.12  # of the budget, by which a network's fit may exceed it before it is stopped
LEAST_SECONDS = 5.0  # of a network's fit: with less it says little, and is not begun


def choose(
    shape,
    query: str = "point",
    *,
    narrow_ns: float | tuple[float, float] | Callable[[wp.array], Any],
    workload=None,
    memory: int | None = None,
    device: str | None = None,
    budget: float = 120.0,
    seed: int = 0,
    margin: float = 0.0,
    length: float | None = None,
    methods: Iterable[str] | None = None,
    bounders: Mapping[str, Bounder] | None = None,
    overhead_ns: float = 0.0,
    how: str = "batch",
    statistical: bool = False,
    checkpoint=None,
    progress: Progress | bool | None = None,
) -> Choice:
    """Fit candidates of every method, in several sizes, measure them on your own queries, and take the cheapest.

    A bounder saves what your exact test takes for the queries that it denies, less the time that it takes itself. No
    bounder at all is one of the answers.

    Args:
        shape: What ``load_shape`` returns, or anything that it takes.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        narrow_ns: What your exact test takes for one query, nanoseconds. ``(denied, left)``: for one that a bounder
            denies, and for one that it leaves, which often takes ten times as long. Or the test itself, a function: it
            gets a ``wp.array`` ``(N,)`` of ``vec_m`` on ``device``, returns ``(N,)`` answers (not 0: meets the object),
            and is timed on all queries and on those that each candidate leaves. One number is too hopeful where
            queries that are far from the object are cheap.
        workload: ``(Q, m)`` numbers, object space, as your simulation asks them, in its order; random ones if ``None``.
            A few thousand at least: candidates are fitted to half of them and measured on the others.
        memory: Most bytes that a query may read (``Bounder.nbytes``).
        device: Warp device where it is measured, and of the bounder; the default device if ``None``.
        budget: Seconds that all fits take together, up to an eighth more. What there is no time for is not begun, or
            stopped, and listed. Compiling kernels, once for each size of network, is not counted.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        length: Length of a ray, object units; 1 if ``None``. Other queries have none.
        methods: Names of methods that are tried: those in ``METHODS``, and ``"learned-kdop+mlp"``; all of them if
            ``None``, only ``bounders`` for ``()``.
        bounders: Bounders of this very shape that you have already, by name; they are measured with the others.
            Distances answer points, rays and boxes.
        overhead_ns: What your step takes for a query if there is any bounder, without the bounder itself, such as for
            gathering the queries.
        how: ``"batch"``: a bounder is timed in large batches, on all cores, with the list of what it leaves
            (``prepare(candidates=True)``). ``"function"``: as ``Bounder.func`` in a kernel of Warp's, on one core of a
            CPU, with Warp's loop over the queries.
        statistical: Whether a bounder that samples attest may be chosen, too; else only proven ones are.
        checkpoint: Folder where candidates are stored as they are fitted; a call with the same settings fits only what
            is not there, and files of other settings are left alone; not for functions, whose digest does not tell
            them apart. ``None`` keeps nothing.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends fitting; what was fitted is then compared.

    Raises:
        ShapeError: If the shape cannot be read or bounded, or is a function and there is a checkpoint.
        QueryError: For an unknown kind of query, or queries that are none of it.
        BounderError: For a price, memory or budget that makes no sense, an unknown method or ``how``, a test that does
            not answer, or distances where ``how`` is ``"function"``.
        FileFormatError: For a folder that cannot be written to.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, methods=("aabb", "obb"), device="cpu", progress=False)
        >>> choice.rows[0].cost <= min(row.cost for row in choice.rows if not row.why_not)
        True
    """
    check_query(query)
    check_numbers(budget, seed, margin)
    check_asked(query, NONE, length, SIDES[0])
    _check_prices(narrow_ns, overhead_ns, how, memory)
    methods = _checked_methods(methods)
    shape, length, device = own_coordinates(load_shape(shape), "choose"), float(length or 1.0), str(device_of(device))
    _check_bounders(bounders or {}, query, shape, how)
    warn_of_restriction(shape)
    if checkpoint is not None:
        shape.expect_identified("a checkpoint")
    bounded = shape.dilated(margin) if margin else shape
    fit_to, measured, count, far = _halves(workload, bounded, query, length, seed)
    truth = np.asarray(oracle(query, bounded, "cpu", length)(measured), dtype=bool)
    if callable(narrow_ns):
        check_test(narrow_ns, measured[:CHECKED], truth[:CHECKED], device)
    options = {"margin": float(margin), "seed": int(seed)}
    options |= {"length": length} if QUERIES[query].has_length else {}
    queried = None if workload is None else hashlib.sha256(fit_to.tobytes()).hexdigest()
    settings = json.dumps([__version__, bounded.digest, query, float(budget), options, queried])
    key = hashlib.sha256(settings.encode()).hexdigest()[:12]
    options |= {"workload": None if workload is None else fit_to, "device": device}

    def file(label: str) -> Path | None:
        name = f"{re.sub(r'[^a-z0-9+]+', '-', label)}-{key}.safetensors"
        return None if checkpoint is None else Path(checkpoint) / name

    candidates = [each for each in candidates_of(query, shape) if each.method in methods]
    started, compiled = working_seconds(), compile_seconds()
    with reported(progress, "choose") as update:
        fitted, missing, interrupted = fit_all(candidates, shape, query, options, budget, memory, file, update)
    fitted |= {label: bounder.to(device) for label, bounder in (bounders or {}).items()}
    many = resized(measured, max(len(measured), TIMED[wp.get_device(device).is_cuda][0]))
    launches = {label: HOW[how](bounder, query, many, length) for label, bounder in fitted.items()}
    taken, rows, kinds = fastest(launches, device), [], {NONE: measured}
    for label, bounder in fitted.items():
        row, kinds[label] = _row(label, bounder, query, measured, truth, bounded, length)
        reason = why_not_of(bounder, row.missed, memory, statistical)
        rows.append(replace(row, nanoseconds=overhead_ns + 1e9 * taken[label] / len(many), why_not=reason))
    positives = float(truth.mean())
    mean, works, priced = _priced(narrow_ns, rows, kinds, positives, device)
    rows = [replace(row, work=(work := works.get(row.label, 0.0)), cost=row.nanoseconds + work * mean) for row in rows]
    rows.insert(0, Row(NONE, 0, 0.0, 1.0, 1.0, mean, "by construction"))
    rows.sort(key=lambda row: (bool(row.why_not), row.cost))
    about = {"shape": shape.name, "query": query, "memory": memory, "device": device, "how": how, "far": far}
    about |= {"threads": cpu_threads() if wp.get_device(device).is_cpu else 0, "budget": budget}
    about |= {"interrupted": interrupted, "priced": priced}
    about |= {"seconds": working_seconds() - started, "compile_seconds": compile_seconds() - compiled}
    return Choice(fitted.get(rows[0].label), (*rows, *missing), float(mean), positives, count, about)


def _halves(workload, bounded: Shape, query: str, length: float, seed: int) -> tuple[np.ndarray, np.ndarray, int, str]:
    """The queries that candidates are fitted to, those they are measured on, how many there are, and how many are far.

    The latter in words. What is measured is in the caller's order.
    """
    rng = np.random.default_rng(seed)
    given = sample(query, bounded, SAMPLES, rng) if workload is None else workload
    domain = domain_of(bounded, query, length)
    x = CallersQueries(given, bounded, domain, seed).x
    outside = (np.abs(domain.to_local(x)) > domain.limit).any(axis=1).mean() if domain.tested_as_point else 0
    if outside == 1:
        words = "all queries lie outside of the object's box; are they in the units and the space of the shape?"
        warn(f"workload: {words}")
    half = np.zeros(len(x), dtype=bool)
    half[rng.permutation(len(x))[: len(x) // 2]] = True
    fit_to, measured = (x[half], x[~half]) if len(x) > 1 else (x, x)
    return fit_to, measured, len(x), f"{100 * outside:.3g} % lie outside of its box" if outside else ""


def _row(
    label: str, bounder: Bounder, query: str, x: np.ndarray, truth: np.ndarray, bounded: Shape, length: float
) -> tuple[Row, np.ndarray]:
    """A candidate's row, without its time, from queries and their truth; and the queries that it leaves."""
    indices, count = batch_of(bounder, query, x, length)()
    left = indices.numpy()[: count.numpy()[0]]
    doubtful = x[np.setdiff1d(np.flatnonzero(truth), left)]
    # of a shape without cells some may be undecided, and not missed
    missed = int(QUERIES[query].certain(bounded, doubtful, length).sum()) if len(doubtful) else 0
    seconds = (bounder.info.get("training") or {}).get("seconds", 0.0)
    kind = bounder.certificate.kind if bounder.certificate else ""
    known = {"share": len(left) / len(x), "certificate": kind, "missed": missed, "seconds": seconds}
    return Row(label, bounder.nbytes, **known), x[left]


def _priced(
    narrow_ns, rows: list[Row], kinds: dict[str, np.ndarray], positives: float, device: str
) -> tuple[float, dict[str, float], str]:
    """The mean price of a query, the share of the narrow phase's time that each row leaves, and in words from what."""
    if callable(narrow_ns):
        return *measured_works(narrow_ns, kinds, device), "the exact test was timed on them, and on what each leaves"
    if isinstance(narrow_ns, tuple | list):
        return *works_of(rows, *narrow_ns, positives), "{:g} ns if denied, {:g} ns if left".format(*narrow_ns)
    words = f"{narrow_ns:g} ns for each: too hopeful where what is denied costs less"
    return *works_of(rows, narrow_ns, narrow_ns, positives), words


def _check_prices(narrow_ns, overhead_ns: float, how: str, memory: int | None) -> None:
    """Refuse prices, ``how`` and a memory that make no sense, with ``BounderError``."""
    narrow = narrow_ns if isinstance(narrow_ns, tuple | list) else (narrow_ns, narrow_ns)
    if not callable(narrow_ns) and (len(narrow) != 2 or not all(is_number(each) and each >= 0 for each in narrow)):
        expected = "nanoseconds of at least 0, two of them (denied, left), or a function of queries"
        raise BounderError(f"narrow_ns must be {expected}, got {narrow_ns!r}")
    if not is_number(overhead_ns) or overhead_ns < 0:
        raise BounderError(f"overhead_ns must be a number of nanoseconds of at least 0, got {overhead_ns!r}")
    if how not in HOW:
        raise BounderError(f"how must be one of {', '.join(HOW)}, got {how!r}")
    if memory is not None and (not isinstance(memory, int | np.integer) or memory < 1):
        raise BounderError(f"memory must be a whole number of bytes of at least 1, got {memory!r}")


def _checked_methods(methods: Iterable[str] | None) -> list[str]:
    """Names of the methods to try; ``BounderError`` for one that there is not."""
    known = [*METHODS, CASCADE]
    methods = known if methods is None else [methods] if isinstance(methods, str) else list(methods)
    for name in set(methods) - set(known):
        raise BounderError(f"methods must be some of {', '.join(known)}, got {name!r}")
    return methods


def _check_bounders(bounders: Mapping[str, Bounder], query: str, shape: Shape, how: str) -> None:
    """Refuse bounders of the caller's that do not answer these queries, with ``BounderError``."""
    for label, bounder in bounders.items():
        able = bounder.query_kind == query
        if bounder.of_distances:
            able = query in ASKED and not (bounder.domain.time and QUERIES[query].is_region)
            if HOW[how] is function_of:
                raise BounderError(f"bounders: how={how!r} needs ones with func, got a distance, {label!r}")
        if not able or bounder.ndim != shape.ndim or label == NONE:
            expected = f"{query} queries in {shape.ndim}D"
            raise BounderError(f"bounders: expected ones of {expected}, got {label!r}: {bounder!r}")


def fit_all(
    candidates: list[Candidate],
    shape: Shape,
    query: str,
    options: dict[str, Any],
    budget: float,
    memory: int | None,
    file: Callable[[str], Path | None],
    update: Progress | None,
) -> tuple[dict[str, Bounder], list[Row], bool]:
    """Load or fit candidates: bounders by label, rows of what is not fitted, and whether Ctrl-C ended it."""
    fitted, missing, waiting, started, interrupted = {}, [], [], working_seconds(), False
    for each in candidates:
        path = file(each.label)
        if memory is not None and each.nbytes > memory:
            missing.append(Row(each.label, each.nbytes, why_not="over the memory limit"))
        else:
            with contextlib.suppress(FileFormatError):  # what is damaged is fitted anew
                if path is not None and path.exists():
                    fitted[each.label] = load(path, device=options["device"])
            waiting += [] if each.label in fitted else [each]
    for number, each in enumerate(waiting):
        left = budget - (working_seconds() - started)
        seconds, limit = left / (len(waiting) - number), left / 2
        if each.nbytes:
            seconds, limit = max(seconds, LEAST_SECONDS), left + OVERDRAWN * budget
        if interrupted or left <= 0 or seconds > left:
            missing.append(Row(each.label, each.nbytes, why_not="no time was left"))
            continue
        if update is not None:
            update(budget - left, budget, each.label)
        own = options | each.options | {"budget": seconds, "progress": False}
        try:
            with limited(limit), warnings.catch_warnings():
                warnings.simplefilter("ignore", BoundingWarning)  # of coarse cells: the row shows what they cost
                bounder = fit(shape, query, each.method, **own)
        except OutOfTimeError:
            missing.append(Row(each.label, each.nbytes, seconds=limit, why_not=f"stopped after {limit:.0f} s"))
        except BoundingError as error:
            missing.append(Row(each.label, 0, why_not=" ".join(str(error).split())))
        except KeyboardInterrupt:
            interrupted = True
        else:
            fitted[each.label], interrupted = bounder, bool(bounder.info["training"].get("interrupted"))
            if file(each.label) is not None and not interrupted:
                bounder.save(file(each.label))
    return fitted, missing, interrupted


# --- plot ------------------------------------------------------------------------------------------------------------

PRICES = (1.0, 1e6)  # of the narrow phase, nanoseconds, that are shown at least


def cost_plot(choice: Choice) -> bytes:
    """Draw what each candidate costs, by the price of the narrow phase: a PNG file. Needs matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("the plot needs matplotlib: pip install 'warp-bounding[train]'") from error
    best, rows = choice.prices, {row.label: row for row in choice.rows if not row.why_not}
    low, high = PRICES[0], 3 * max(PRICES[1], choice.narrow_ns, *(stretch.price for stretch in best))
    prices, here = np.geomspace(low, high, 400), max(choice.narrow_ns, low)
    figure = Figure(figsize=(7.6, 4.6), layout="constrained")
    panel = figure.subplots()
    for row in rows.values():
        panel.plot(prices, row.nanoseconds + row.work * prices, color="silver", linewidth=0.7)
    for stretch, end in zip(best, [*(stretch.price for stretch in best[1:]), high], strict=True):
        row, own = rows[stretch.label], np.geomspace(max(stretch.price, low), max(end, low), 50)
        label = f"{row.label}, from {duration(stretch.price)}" if stretch.price else row.label
        panel.plot(own, row.nanoseconds + row.work * own, linewidth=3, label=label)
    if choice.positives > 0:
        panel.plot(prices, choice.positives * prices, "k:", linewidth=0.9, label="what meets the object")
    panel.plot([here], [choice.row.nanoseconds + choice.row.work * here], "ko", label=f"chosen: {choice.label}")
    panel.set(xscale="log", yscale="log", xlim=(low, high), title="What each broad phase costs; thick: the cheapest")
    panel.set_xlabel("price of the narrow phase, nanoseconds a query, mean of all")
    panel.set_ylabel("broad and narrow phase, nanoseconds a query")
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(loc="upper left", frameon=False, fontsize=8)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=130)
    return file.getvalue()
