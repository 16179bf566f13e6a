"""Which bounder costs the least for these queries, this narrow phase and this machine?

A broad phase that takes ``t`` nanoseconds a query and leaves a share ``p`` of them to a narrow phase of ``N`` ns costs
``t + p N`` (paper, Eq. 6). ``choose`` fits candidates to one half of the queries and measures them on the other. Each
has an equal share of the time that is left, the quickest first: networks share what closed forms do not take. No closed
form may take more than half of what is left.
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
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.bounders import METHODS, Bounder, load
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, FileFormatError
from warp_bounding.evaluation import ASKED, parts_of
from warp_bounding.queries import QUERIES, check_query, oracle, sample
from warp_bounding.queries.region_domain import domain_of
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
from warp_bounding.shapes.parts import SIDES
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
        numbers = sum(k * h + h for k, h in pairwise((shape.ndim, *hidden, 1)))  # regions have more inputs
        yield Candidate(f"{name} {'-'.join(map(str, hidden))}", name, {"hidden": hidden}, BYTES * numbers)


# --- result ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One candidate, measured on the caller's queries."""

    label: str  # method and size; ``"none"`` is no broad phase
    nbytes: int  # of memory that a query can read
    nanoseconds: float = math.nan  # of a query in a batch, overhead included
    share: float = math.nan  # of the queries that it leaves to the narrow phase
    cost: float = math.nan  # ``nanoseconds + share * narrow_ns``
    certificate: str = ""  # its kind, if it has one
    missed: int = 0  # queries that meet the object and that it denied: none where it is proven
    seconds: float = 0.0  # that its fit took
    why_not: str = ""  # why it cannot be chosen


class Stretch(NamedTuple):
    """Prices of the narrow phase, nanoseconds a call, from which on one broad phase costs the least."""

    price: float
    label: str


def cheapest(rows: Iterable[Row]) -> list[Stretch]:
    """The lower envelope of the lines ``nanoseconds + share * price``, from price 0 on."""
    rows = list(rows)
    at = min(rows, key=lambda row: (row.nanoseconds, row.share))
    found = [Stretch(0.0, at.label)]
    while flatter := [row for row in rows if row.share < at.share]:
        # the one that is met first goes on; of several the flattest
        meets = [((row.nanoseconds - at.nanoseconds) / (at.share - row.share), row.share, row) for row in flatter]
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
    """The broad phase that costs the least, with all that it was compared with.

    Attributes:
        bounder: The bounder, or distance; ``None`` where none pays.
        rows: Of all candidates, the cheapest first.
        narrow_ns: Price of the narrow phase, nanoseconds a call.
        positives: Share of the queries that meet the object: no broad phase leaves less.
        queries: How many queries there were; ``choose`` measures on half of them.
        about: How it was found: memory, device, threads of a CPU, budget, seconds.

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
    def why(self) -> str:
        """In a sentence, why this one."""
        row, narrow = self.row, duration(self.narrow_ns)
        if row.label == NONE:
            return f"none pays: the narrow phase takes {narrow}, and no candidate that can be chosen costs less"
        leaves = f"it takes {duration(row.nanoseconds)} and leaves {100 * row.share:.3g} % of the queries"
        must = f"of which {100 * self.positives:.3g} % must be left to a narrow phase of {narrow}"
        return f"{row.label}: {duration(row.cost)} a query in all; {leaves}, {must}"

    def to_dict(self) -> dict[str, Any]:
        """All but the bounder, JSON-ready."""
        names = ("label", "narrow_ns", "positives", "queries", "why")
        lists = {"prices": [each._asdict() for each in self.prices], "rows": [asdict(row) for row in self.rows]}
        return {name: getattr(self, name) for name in names} | lists | self.about


# --- measuring -------------------------------------------------------------------------------------------------------

TIMED, TURNS = 200_000, 9  # queries of a timed launch, at least, and launches of each candidate
# On a GPU, where a launch takes as long as some 300,000 queries of a network: so many, and launches in a row.
TIMED_GPU, IN_A_ROW = 4_000_000, 5
MOST_SECONDS = 0.3  # of one candidate's launches, after which no more are timed


def launch_of(bounder: Bounder, query: str, x: np.ndarray, length: float) -> Callable[[], wp.array]:
    """A function that queries a bounder, or a distance in its place; the queries lie on its device before."""
    parts = [wp.array(part, dtype=wp.float32, device=bounder.device) for part in parts_of(query, x)]
    if bounder.of_distances:
        ask = ASKED[query](bounder, length)
        return lambda: ask(*parts)
    return bounder.prepare(wp.array(x, dtype=wp.float32, device=bounder.device)).launch


def nanoseconds_of(
    bounders: Mapping[str, Bounder], query: str, x: np.ndarray, length: float, device: str
) -> dict[str, float]:
    """Of a query: the fastest of launches in turns, so that what else the machine does slows all alike."""
    queries, calls = (TIMED_GPU, IN_A_ROW) if wp.get_device(device).is_cuda else (TIMED, 1)
    many = np.resize(x, (max(len(x), queries), x.shape[1]))
    launches = {label: launch_of(bounder, query, many, length) for label, bounder in bounders.items()}
    taken: dict[str, list[float]] = {label: [] for label in launches}
    for turn in range(TURNS + 1):
        for label, launch in launches.items():
            if sum(taken[label]) <= MOST_SECONDS:
                wp.synchronize_device(device)
                start = time.perf_counter()
                for _ in range(calls):
                    launch()
                wp.synchronize_device(device)
                if turn:  # the first one loads kernels
                    taken[label].append((time.perf_counter() - start) / calls)
    return {label: 1e9 * min(seconds) / len(many) for label, seconds in taken.items()}


def why_not_of(bounder: Bounder, missed: int, memory: int | None, statistical: bool) -> str:
    """Why a bounder cannot be chosen; empty if it can."""
    certificate = bounder.certificate
    if missed:
        return f"denies {missed:,} queries that meet the object"
    if not bounder.conservative or not ((certificate and certificate.proven) or statistical):
        return f"not proven ({certificate.kind if certificate else 'no certificate'})"
    return "over the memory limit" if memory is not None and bounder.nbytes > memory else ""


# --- choose ----------------------------------------------------------------------------------------------------------

SAMPLES = 200_000  # random queries, where the caller has none
OVERDRAWN = 0.12  # of the budget, by which a network's fit may exceed it before it is stopped
LEAST_SECONDS = 5.0  # of a network's fit: with less it says little, and is not begun


def choose(
    shape,
    query: str = "point",
    *,
    narrow_ns: float,
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
    statistical: bool = False,
    checkpoint=None,
    progress: Progress | bool | None = None,
) -> Choice:
    """Fit candidates of every method, in several sizes, measure them on your own queries, and take the cheapest.

    What counts is ``t + p * narrow_ns``: the nanoseconds that a bounder takes for a query, and the share of the queries
    that it leaves to a narrow phase of this price (paper, Eq. 6). No bounder at all is one of the answers.

    Args:
        shape: What ``load_shape`` returns, or anything that it takes.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        narrow_ns: What your exact test takes for one query, nanoseconds.
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
            lists of what is left.
        statistical: Whether a bounder that samples attest may be chosen, too; else only proven ones are.
        checkpoint: Folder where candidates are stored as they are fitted; a call with the same settings fits only what
            is not there, and files of other settings are left alone. ``None`` keeps nothing.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends fitting; what was fitted is then compared.

    Raises:
        ShapeError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query, or queries that are none of it.
        BounderError: For a price, memory or budget that makes no sense, or an unknown method.
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
    for name, value in (("narrow_ns", narrow_ns), ("overhead_ns", overhead_ns)):
        if not is_number(value) or value < 0:
            raise BounderError(f"{name} must be a number of nanoseconds of at least 0, got {value!r}")
    if memory is not None and (not isinstance(memory, int | np.integer) or memory < 1):
        raise BounderError(f"memory must be a whole number of bytes of at least 1, got {memory!r}")
    methods = [*METHODS, CASCADE] if methods is None else [methods] if isinstance(methods, str) else list(methods)
    for name in set(methods) - {*METHODS, CASCADE}:
        raise BounderError(f"methods must be some of {', '.join([*METHODS, CASCADE])}, got {name!r}")
    shape, length, device = own_coordinates(load_shape(shape), "choose"), float(length or 1.0), str(device_of(device))
    for label, bounder in (bounders or {}).items():
        able = bounder.query_kind == query
        if bounder.of_distances:
            able = query in ASKED and not (bounder.domain.time and QUERIES[query].is_region)
        if not able or bounder.ndim != shape.ndim or label == NONE:
            expected = f"{query} queries in {shape.ndim}D"
            raise BounderError(f"bounders: expected ones of {expected}, got {label!r}: {bounder!r}")
    warn_of_restriction(shape)
    bounded, rng = shape.dilated(margin) if margin else shape, np.random.default_rng(seed)
    given = sample(query, bounded, SAMPLES, rng) if workload is None else workload
    x = CallersQueries(given, bounded, domain_of(bounded, query, length), seed).x
    half = np.zeros(len(x), dtype=bool)
    half[rng.permutation(len(x))[: len(x) // 2]] = True
    fit_to, measured = (x[half], x[~half]) if len(x) > 1 else (x, x)  # what is measured is in the caller's order
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
    truth = np.asarray(oracle(query, bounded, "cpu", length)(measured), dtype=bool)
    taken = nanoseconds_of(fitted, query, measured, length, device)
    rows = [Row(NONE, 0, 0.0, 1.0, float(narrow_ns), "by construction")]
    for label, bounder in fitted.items():
        maybe = launch_of(bounder, query, measured, length)().numpy()
        doubtful = measured[truth & ~maybe]  # of a shape without cells some may be undecided, and not missed
        missed = int(QUERIES[query].certain(bounded, doubtful, length).sum()) if len(doubtful) else 0
        kind = bounder.certificate.kind if bounder.certificate else ""
        own, share = overhead_ns + taken[label], float(maybe.mean())
        cost, seconds = own + share * narrow_ns, (bounder.info.get("training") or {}).get("seconds", 0.0)
        why_not = why_not_of(bounder, missed, memory, statistical)
        rows.append(Row(label, bounder.nbytes, own, share, cost, kind, missed, seconds, why_not))
    rows.sort(key=lambda row: (bool(row.why_not), row.cost))
    about = {"shape": shape.name, "query": query, "memory": memory, "device": device, "interrupted": interrupted}
    about |= {"threads": cpu_threads() if wp.get_device(device).is_cpu else 0, "budget": budget}
    about |= {"seconds": working_seconds() - started, "compile_seconds": compile_seconds() - compiled}
    positives = float(truth.mean())
    return Choice(fitted.get(rows[0].label), (*rows, *missing), float(narrow_ns), positives, len(x), about)


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
        panel.plot(prices, row.nanoseconds + row.share * prices, color="silver", linewidth=0.7)
    for stretch, end in zip(best, [*(stretch.price for stretch in best[1:]), high], strict=True):
        row, own = rows[stretch.label], np.geomspace(max(stretch.price, low), max(end, low), 50)
        label = f"{row.label}, from {duration(stretch.price)}" if stretch.price else row.label
        panel.plot(own, row.nanoseconds + row.share * own, linewidth=3, label=label)
    if choice.positives > 0:
        panel.plot(prices, choice.positives * prices, "k:", linewidth=0.9, label="what meets the object")
    panel.plot([here], [choice.row.nanoseconds + choice.row.share * here], "ko", label=f"chosen: {choice.label}")
    panel.set(xscale="log", yscale="log", xlim=(low, high), title="What each broad phase costs; thick: the cheapest")
    panel.set_xlabel("price of the narrow phase, nanoseconds a call")
    panel.set_ylabel("broad and narrow phase, nanoseconds a query")
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(loc="upper left", frameon=False, fontsize=8)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=130)
    return file.getvalue()
