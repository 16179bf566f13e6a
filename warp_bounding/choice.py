"""Which bounder costs the least for these queries, this narrow phase and this machine?

A broad phase that takes ``t`` nanoseconds a query and leaves a share ``p`` of them to a narrow phase of ``N`` ns costs
``t + p N`` (paper, Eq. 6). ``choose`` fits candidates to one half of the queries and measures them on the other.

1. Closed forms have a third of the time, the quickest to fit first; one that takes longer than what is left is stopped.
2. Networks share the rest equally. Each is trained at least until its false positives say something about its size: the
   steps that others have made in their time show how long that is. Where there is no time for it, it is not begun.
3. The best network is trained again with what is left.
"""

import contextlib
import hashlib
import io
import json
import math
import re
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.bounders import DISTANCES, METHODS, Bounder, load
from warp_bounding.bounders.distance_grid import DistanceGrid
from warp_bounding.bounders.mlp import RECIPES, Mlp, check_hidden
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, FileFormatError
from warp_bounding.evaluation import ASKED, parts_of
from warp_bounding.queries import QUERIES, check_query, oracle, sample
from warp_bounding.queries.distance import DISTANCE
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
from warp_bounding.runtime.whole_file import write_whole
from warp_bounding.shapes import Grid, load_shape
from warp_bounding.shapes.parts import SIDES
from warp_bounding.shapes.recentred import own_coordinates
from warp_bounding.shapes.shape import Shape
from warp_bounding.training import fit
from warp_bounding.training.fit import check_asked, check_numbers, is_number, trainer_of, warn_of_restriction
from warp_bounding.training.samples import CallersQueries
from warp_bounding.version import __version__

__all__ = ["Choice", "Row", "Stretch", "choose", "choose_among", "cost_plot"]

NONE = "none"  # label of no broad phase

# --- candidates ------------------------------------------------------------------------------------------------------

NETWORKS = ((24, 24), (16, 16), (50, 50))  # hidden widths, in the order in which they are tried
PARTS = {(24, 24): 256, (50, 50): 1024}  # thresholds of the networks that also come with some
PREFILTER, BEHIND = "learned-kdop", (24, 24)  # of the cascade: its first method, and the network behind it
CASCADE, DISTANCE_NETWORK = f"{PREFILTER}+{Mlp.method}", "distance"
NODES = {2: (32, 64, 128), 3: (16, 32), 4: (8, 16)}  # of distance grids, along the longest side, by dimension
SIZES: dict[str, list[dict[str, Any]]] = {  # of closed forms, the quickest to fit first
    "voxels": [{"resolution": cells} for cells in (16, 32, 64, 128)],
    "bvh": [{"leaves": leaves} for leaves in (16, 64, 256, 1024, 4096)],
    **{name: [{}] for name in ("aabb", "sphere", "ellipsoid", "oriented-ellipsoid", "obb", PREFILTER, "relu-field")},
    "kdop": [{}, {"k": 26}],
}
UNITS = {"leaves": "{} leaves", "resolution": "{} cells", "nodes": "{} nodes", "parts": "{} parts", "k": "k {}"}


class Candidate(NamedTuple):
    """What ``fit`` is called with; the query is ``"distance"`` where a distance answers the caller's."""

    method: str
    options: dict[str, Any]
    query: str
    numbers: int = 0  # of a network, at least; 0 of closed forms

    @property
    def label(self) -> str:
        """Method and size."""
        sizes = ("-".join(map(str, v)) if k == "hidden" else UNITS[k].format(v) for k, v in self.options.items())
        network_of_distance = self.numbers and self.query == DISTANCE.name
        return f"{DISTANCE_NETWORK if network_of_distance else self.method} {', '.join(sizes)}".strip()


def candidates_of(query: str, shape: Shape, networks: tuple[tuple[int, ...], ...], methods: frozenset[str]):
    """All candidates for a kind of query about a shape, in the order in which they are tried."""
    ndim, region, found = shape.ndim, QUERIES[query].is_region, []

    def network(method: str, hidden: tuple[int, ...], kind: str = query, **more) -> None:
        numbers = sum(k * h + h for k, h in pairwise((ndim, *hidden, 1)))  # regions have more inputs
        found.append(Candidate(method, {"hidden": hidden, **more}, kind, numbers))

    able = [name for name, cls in METHODS.items() if cls.conservative and cls.supports(query, ndim)]
    neural = [name for name in able if trainer_of(METHODS[name]).proves]
    for name in sorted(set(able) - set(neural), key=lambda name: [*SIZES, *able].index(name)):
        known = {option.name for option in METHODS[name].options if query in option.queries}
        known |= set() if isinstance(shape, Grid) else {"resolution"}
        known -= set() if ndim == 3 else {"k"}
        sizes = [size for size in SIZES.get(name, [{}]) if known >= set(size)]
        found += [Candidate(name, size, query) for size in sizes or [{}]]
    as_distance = query in ASKED and not (shape.time and region)
    if (
        as_distance
        and DISTANCES[DistanceGrid.method].supports("distance", ndim)
        and (DistanceGrid.moving or not shape.time)
    ):
        found += [Candidate(DistanceGrid.method, {"nodes": nodes}, DISTANCE.name) for nodes in NODES.get(ndim, ())]
    for name in neural:  # of all but the plain ones one size, since each compiles kernels of its own
        for hidden in networks if METHODS[name] is Mlp else networks[-1:]:
            network(name, hidden)
    if Mlp.method in neural and PREFILTER in able and BEHIND in networks:
        network(CASCADE, BEHIND)
    if any(option.name == "parts" and query in option.queries for option in Mlp.options):
        for hidden in networks if Mlp.method in neural else ():
            if hidden in PARTS:
                network(Mlp.method, hidden, parts=PARTS[hidden])
    # of points, a network of just the answers is tighter
    if as_distance and region and MlpDistance.supports("distance", ndim):
        for hidden in networks[-2:]:
            network(Mlp.method, hidden, DISTANCE.name)
    return [each for each in found if each.label.split()[0] in methods]


def check_methods(methods: Iterable[str] | None) -> frozenset[str]:
    """Names of methods, all of them for ``None``; ``BounderError`` for a name that is none."""
    names = [*METHODS, DistanceGrid.method, DISTANCE_NETWORK, CASCADE]
    wanted = frozenset(names if methods is None else [methods] if isinstance(methods, str) else methods)
    for name in wanted - set(names):
        raise BounderError(f"methods must be some of {', '.join(names)}, got {name!r}")
    return wanted


def check_networks(networks: Iterable[Iterable[int]]) -> tuple[tuple[int, ...], ...]:
    """Hidden widths of networks; ``BounderError`` for what no network can have."""
    widths = list(networks) if isinstance(networks, Iterable) else [networks]
    if not all(isinstance(each, Iterable) for each in widths):
        raise BounderError(f"networks must be tuples of widths of hidden layers, such as {NETWORKS}, got {networks!r}")
    return tuple(check_hidden(each) for each in widths)


def check_prices(query: str, narrow_ns, overhead_ns=0.0, memory=None, length=None, statistical=False) -> None:
    """Refuse what makes no sense for any shape, with ``BounderError``."""
    for name, value in (("narrow_ns", narrow_ns), ("overhead_ns", overhead_ns)):
        if not is_number(value) or value < 0:
            raise BounderError(f"{name} must be a number of nanoseconds of at least 0, got {value!r}")
    if memory is not None and not (isinstance(memory, int | np.integer) and memory is not True and memory > 0):
        raise BounderError(f"memory must be a whole number of bytes of at least 1, got {memory!r}")
    check_asked(query, NONE, length, SIDES[0])
    if not isinstance(statistical, bool):
        raise BounderError(f"statistical must be True or False, got {statistical!r}")


# --- result ----------------------------------------------------------------------------------------------------------

WORTH = 0.1  # of the least cost: what a larger budget must be able to save so that it is probably worth it


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
    note: str = ""  # that a network is hardly trained
    needs: float = 0.0  # the budget with room for what was not tried or is hardly trained, about; 0 for others


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
        memory: Limit of ``nbytes``; ``None`` for none.
        device: Where they were measured.
        threads: Of a CPU; 0 elsewhere.
        about: More of how it was found, for files.

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
    memory: int | None = None
    device: str = "cpu"
    threads: int = field(default_factory=cpu_threads)
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
        row, others = self.row, [row for row in self.rows if row.label != NONE and not row.why_not]
        if row.label != NONE:
            less = f"{self.narrow_ns / row.cost:.3g} times less than with no broad phase"
            leaves = f"it takes {duration(row.nanoseconds)} and leaves {100 * row.share:.3g} % of the queries"
            must = f"of which {100 * self.positives:.3g} % must be left"
            return f"{row.label}: {duration(row.cost)} a query in all, {less}; {leaves}, {must}"
        if not others:
            return "no candidate can be chosen, so every query goes to the narrow phase"
        best = min(others, key=lambda row: row.cost)
        cost = f"the best, {best.label}, would cost {duration(best.cost)} a query in all"
        return f"none pays: the narrow phase takes {duration(self.narrow_ns)}, and {cost}"

    @property
    def more(self) -> str:
        """In a sentence, what a larger budget has room for; empty where there was time for everything."""
        missing = [row for row in self.rows if row.needs]
        if not missing or self.about["interrupted"]:
            return ""
        saves = self.row.cost - self.positives * self.narrow_ns > WORTH * self.row.cost
        would = "would probably change the answer" if saves else "might change the answer, but hardly"
        named = ", ".join(row.label for row in missing[:3]) + (f" and {len(missing) - 3} more" if missing[3:] else "")
        return f"A budget of about {max(row.needs for row in missing):g} s {would}: it has room for {named}"

    def to_dict(self) -> dict[str, Any]:
        """All but the bounder, JSON-ready."""
        names = ("label", "narrow_ns", "positives", "queries", "memory", "device", "threads", "why", "more")
        lists = {"prices": [each._asdict() for each in self.prices], "rows": [asdict(row) for row in self.rows]}
        return {name: getattr(self, name) for name in names} | lists | self.about


# --- search ----------------------------------------------------------------------------------------------------------

TIMED, TURNS = 200_000, 9  # queries of a timed launch, at least, and launches of each candidate
# On a GPU, where a launch takes as long as some 300,000 queries of a network: so many, and launches in a row.
TIMED_GPU, IN_A_ROW = 4_000_000, 5
MOST_SECONDS = 0.3  # of one candidate's launches, after which no more are timed
CLOSED_SHARE, PART = 1 / 3, 1 / 20  # of the time, for closed forms; of the budget, for one of them that learns
OVERDRAWN = 0.12  # of the budget, by which a network's fit may exceed it before it is stopped
LAST = 3  # shares that are reserved for training the best network again
LEAST_SECONDS, LONGER = 3.0, 1.5  # of a network's fit; and times the seconds before, to train it again
DOUBT = 0.8  # of the seconds that a fit needs: with less it is not begun
# Steps after which a network can be judged. Those of 24-24 neurons had 7.5 % false positives after 500 steps and 2.6 %
# after 1,500 on the bunny; on a mesh of 29,572 triangles as many as a box after 200, and 3.0 % after 1,100.
STEPS, FEW = 800, 0.6  # and the share of them with less of which it is hardly trained
BYTES = 4  # of a network's number
RECORD, FORMAT = "choice.json", 3


def steps_of(bounder: Bounder) -> int | None:
    """Steps that a network, or the last part of a cascade, was trained by the default recipe; ``None`` for others."""
    last = (getattr(bounder, "parts", None) or (bounder,))[-1]
    record = last.info.get("training") or bounder.info["training"]
    network = isinstance(last, Mlp | MlpDistance) and last.conservative
    return record.get("steps") if network and record.get("recipe", RECIPES[0]) == RECIPES[0] else None


def hardly_trained(bounder: Bounder) -> str:
    """That a network has made few steps, in words; empty for others."""
    steps = steps_of(bounder)
    few = steps is not None and steps < FEW * STEPS
    return f"hardly trained: {steps:,} steps, about {STEPS:,} tell what it can do" if few else ""


def seconds_needed(bounder: Bounder) -> float:
    """Seconds of training after which a network like this can be judged, by its own pace; 0 for others."""
    steps = steps_of(bounder)
    return 0.0 if steps is None else bounder.info["training"]["seconds"] * STEPS / max(steps, 1)


@dataclass
class Search:
    """Fits candidates and measures them; see ``choose`` for what has no comment."""

    shape: Shape
    query: str
    options: dict[str, Any]  # of every fit
    bounded: Shape  # the shape, dilated
    x: np.ndarray  # queries to measure with
    length: float
    narrow_ns: float
    overhead_ns: float
    memory: int | None
    statistical: bool
    device: str
    budget: float
    folder: Path | None
    update: Progress | None = None
    fitted: dict[str, tuple[Any, Row]] = field(default_factory=dict)  # bounder and row by label
    missing: dict[str, Row] = field(default_factory=dict)  # rows of what is not fitted
    before: float = 0.0  # seconds that the folder's fits took
    postponed: float = 0.0  # seconds of what there was no time for
    interrupted: bool = False
    settings: dict[str, Any] = field(default_factory=dict)  # what all fits in the folder have in common

    def __post_init__(self):
        self.started, self.compiled = working_seconds(), compile_seconds()
        self.truth = np.asarray(oracle(self.query, self.bounded, "cpu", self.length)(self.x), dtype=bool)
        self.least = float(self.truth.mean()) * self.narrow_ns  # cost of what takes no time and leaves what it must

    @property
    def spent(self) -> float:
        """Seconds of the budget."""
        return self.before + working_seconds() - self.started

    @property
    def left(self) -> float:
        """Seconds for fits."""
        return self.budget - self.spent

    @property
    def best(self) -> float:
        """The least cost so far."""
        return min([self.narrow_ns, *(row.cost for _, row in self.fitted.values() if not row.why_not)])

    def tell(self, note: str) -> None:
        """Report progress."""
        if self.update is not None:
            self.update(min(self.spent, self.budget), self.budget, note)

    def check(self, label: str, bounder: Bounder) -> None:
        """Refuse a bounder of the caller's that does not answer these queries."""
        able = bounder.query_kind == self.query
        if bounder.of_distances:
            able = self.query in ASKED and not (bounder.domain.time and QUERIES[self.query].is_region)
        if not able or bounder.ndim != self.shape.ndim or label == NONE:
            expected = f"{self.query} queries in {self.shape.ndim}D"
            raise BounderError(f"bounders: expected ones of {expected}, got {label!r}: {bounder!r}")

    def open(self, settings: dict[str, Any]) -> None:
        """Begin in the folder, or go on there; ``FileFormatError`` where it holds something else."""
        self.settings, file = {"format": FORMAT, "version": __version__, **settings}, self.folder / RECORD
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = [path.name for path in self.folder.iterdir()]
            found = json.loads(file.read_text(encoding="utf-8")) if RECORD in names else self.settings
        except (OSError, ValueError) as error:
            raise FileFormatError(f"{self.folder}: cannot be used for a choice ({error})") from error
        if names and RECORD not in names:
            raise FileFormatError(f"{self.folder}: holds other files, expected a new folder or one of a choice")
        for name, value in self.settings.items():
            held = found.get(name) if isinstance(found, dict) else None
            if held != value:
                got = f"{held!r} and not {value!r}"
                raise FileFormatError(f"{self.folder}: holds a choice with another {name}, {got}; give another folder")
        try:
            self.before = float(found.get("seconds", 0.0))
            self.missing = {label: Row(**row) for label, row in found.get("missing", {}).items()}
        except (TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(f"{file}: damaged ({error}); give another folder") from error
        self.keep()

    def keep(self) -> None:
        """Write down what the fits so far took, and what came to nothing."""
        if self.folder is not None:
            found = {"seconds": self.spent, "missing": {label: asdict(row) for label, row in self.missing.items()}}
            write_whole(self.folder / RECORD, json.dumps(self.settings | found, indent=1).encode())

    def file(self, label: str) -> Path:
        """Of a candidate."""
        return self.folder / f"{re.sub(r'[^a-z0-9+]+', '-', label)}.safetensors"

    def run(self, candidates: list[Candidate]) -> None:
        """Load and fit what there is time for, then train the best network again."""
        for label in (each.label for each in candidates if self.folder and self.file(each.label).exists()):
            with contextlib.suppress(FileFormatError):  # what is damaged is fitted anew
                self.measure(label, load(self.file(label), device=self.device))
        self.missing = {each.label: self.missing[each.label] for each in candidates if each.label in self.missing}
        impossible = {row.label for row in self.missing.values() if not row.needs}
        done = {label for label, (_, row) in self.fitted.items() if not row.note}
        waiting = [each for each in candidates if each.label not in impossible | done]
        networks = [each for each in waiting if each.numbers]
        end = self.left * (1 - CLOSED_SHARE if networks else 0)
        for each in waiting:
            if not each.numbers:
                self.fit(each, PART * self.budget, self.left - end, self.left - end)
        for number, each in enumerate(networks):
            if self.least < self.best:  # else it would cost more even if it left nothing but what must be left
                needed = [seconds_needed(bounder) for bounder, row in self.fitted.values() if row.seconds]
                share = self.left / (len(networks) - number + LAST)
                self.fit(each, max(share, LEAST_SECONDS, *needed), self.left, self.left + OVERDRAWN * self.budget)
        networks = [each for each in candidates if each.numbers and each.label in self.fitted]
        if networks:
            best = min(networks, key=lambda each: self.fitted[each.label][1].cost)
            row, seconds = self.fitted[best.label][1], self.left / (1 + OVERDRAWN)
            if seconds > LONGER * row.seconds and row.nanoseconds + self.least < self.best:
                self.fit(best, seconds, self.left, self.left + OVERDRAWN * self.budget)

    def fit(self, each: Candidate, seconds: float, left: float, limit: float) -> None:
        """Fit a candidate in so many seconds, of those that are left, and measure it; it is stopped at the limit."""

        def tell(done: float, total: float, note: str) -> None:
            self.tell(f"{each.label}: {note}")

        stopped = self.missing[each.label].seconds if each.label in self.missing else 0.0
        if self.interrupted:
            return
        if DOUBT * (expected := max(seconds, 2 * stopped)) >= left:
            self.no_time(each, expected, stopped)
            return
        common = self.options if each.query == self.query else {k: self.options[k] for k in ("margin", "seed")}
        options = common | each.options | {"budget": min(seconds, left), "device": self.device, "progress": tell}
        self.tell(each.label)
        try:
            with limited(limit), warnings.catch_warnings():
                warnings.simplefilter("ignore", BoundingWarning)  # of coarse cells: the row shows what they cost
                bounder = fit(self.shape, each.query, each.method, **options)
        except OutOfTimeError:
            self.no_time(each, 2 * limit, limit)
        except BoundingError as error:
            self.missing[each.label] = Row(each.label, 0, why_not=" ".join(str(error).split()))
        except KeyboardInterrupt:
            self.interrupted = True
        else:
            self.interrupted = bool(bounder.info["training"].get("interrupted"))
            held = self.fitted.get(each.label)
            self.measure(each.label, bounder)
            if held is not None and held[1].cost < self.fitted[each.label][1].cost:
                self.fitted[each.label] = held
            elif self.folder is not None and not self.interrupted:
                bounder.save(self.file(each.label))
        self.keep()

    def no_time(self, each: Candidate, seconds: float, stopped: float) -> None:
        """Add a row of what takes about so many seconds, for which there is no time; or it was stopped."""
        if each.label not in self.fitted:
            self.postponed += seconds if each.numbers else seconds / CLOSED_SHARE
            budget = self.larger(-max(self.left, 0.0) if each.numbers else 0.0)  # of closed forms their share is spent
            begun = f"stopped after {stopped:.0f} s" if stopped else "not tried"
            why, nbytes = f"{begun}: needs a budget of about {budget:g} s", BYTES * each.numbers
            self.missing[each.label] = Row(each.label, nbytes, seconds=stopped, why_not=why, needs=budget)

    def larger(self, more: float) -> float:
        """A budget that has room for what has been postponed and so many seconds more, rounded up to two digits."""
        budget = self.budget + self.postponed + more
        unit = 10 ** max(math.floor(math.log10(max(budget, 1.0))) - 1, 0)
        return float(unit * math.ceil(budget / unit))

    def measure(self, label: str, bounder: Bounder, own: bool = False) -> None:
        """Add a bounder with its row; its time is taken once more at the end."""
        maybe = self.launch(bounder, self.x)().numpy() == 1
        doubtful = self.x[self.truth & ~maybe]  # of a shape without cells some may be undecided, and not missed
        missed = int(QUERIES[self.query].certain(self.bounded, doubtful, self.length).sum()) if len(doubtful) else 0
        certificate, why_not = bounder.certificate, ""
        kind = "" if certificate is None else certificate.kind
        if missed:
            why_not = f"denies {missed:,} queries that meet the object"
        elif not bounder.conservative or not ((certificate and certificate.proven) or self.statistical):
            why_not = f"not proven ({kind or 'no certificate'})"
        elif self.memory is not None and bounder.nbytes > self.memory:
            why_not = "over the memory limit"
        row = Row(label, bounder.nbytes, share=float(maybe.mean()), certificate=kind, missed=missed, why_not=why_not)
        row = row if own else replace(row, seconds=bounder.info["training"]["seconds"], note=hardly_trained(bounder))
        self.fitted[label] = bounder, row
        self.missing.pop(label, None)
        self.time([label], TURNS // 3)

    def launch(self, bounder: Bounder, x: np.ndarray) -> Callable[[], wp.array]:
        """A function that queries a bounder, or a distance in its place; the queries lie on its device before."""
        parts = [wp.array(part, dtype=wp.float32, device=bounder.device) for part in parts_of(self.query, x)]
        if bounder.of_distances:
            ask = ASKED[self.query](bounder, self.length, {})
            return lambda: ask(*parts)
        return bounder.prepare(wp.array(x, dtype=wp.float32, device=bounder.device)).launch

    def time(self, labels: Iterable[str], turns: int) -> None:
        """Time some rows: the fastest of launches in turns, so that what else the machine does slows all alike."""
        queries, calls = (TIMED_GPU, IN_A_ROW) if wp.get_device(self.device).is_cuda else (TIMED, 1)
        many = np.resize(self.x, (max(len(self.x), queries), self.x.shape[1]))
        launches = {label: self.launch(self.fitted[label][0], many) for label in labels}
        taken: dict[str, list[float]] = {label: [] for label in launches}
        for turn in range(turns + 1):
            for label, launch in launches.items():
                if sum(taken[label]) <= MOST_SECONDS:
                    wp.synchronize_device(self.device)
                    start = time.perf_counter()
                    for _ in range(calls):
                        launch()
                    wp.synchronize_device(self.device)
                    if turn:  # the first one loads kernels
                        taken[label].append((time.perf_counter() - start) / calls)
        for label, seconds in taken.items():
            bounder, row = self.fitted[label]
            nanoseconds = self.overhead_ns + 1e9 * min(seconds) / len(many)
            cost = nanoseconds + row.share * self.narrow_ns
            self.fitted[label] = bounder, replace(row, nanoseconds=nanoseconds, cost=cost)

    def choice(self, queries: int) -> Choice:
        """The cheapest, with times taken in turns; ``BounderError`` if nothing is small enough."""
        rows = [row for _, row in self.fitted.values()]
        small = any(row.nbytes <= (self.memory or math.inf) for row in rows)
        if not small and self.memory is not None and not any(row.needs for row in self.missing.values()):
            near = min(rows, key=lambda row: row.nbytes, default=None)
            nearest = f"; the nearest is {near.label} with {near.nbytes:,}" if near else ""
            raise BounderError(f"memory: no candidate has {self.memory:,} bytes or less{nearest}")
        self.tell("times, in turns")
        self.time(self.fitted, TURNS)
        rows = [Row(NONE, 0, 0.0, 1.0, self.narrow_ns, "by construction")]
        for bounder, row in self.fitted.values():
            rows.append(
                replace(row, needs=self.larger(seconds_needed(bounder) - max(self.left, 0.0))) if row.note else row
            )
        rows.sort(key=lambda row: (bool(row.why_not), row.cost))
        bounder, _ = self.fitted.get(rows[0].label, (None, None))
        seconds, compiling = self.spent - self.before, compile_seconds() - self.compiled
        about = {"shape": self.shape.name, "query": self.query, "interrupted": self.interrupted, "budget": self.budget}
        about |= {"seconds": seconds, "seconds_before": self.before, "compile_seconds": compiling}
        threads = cpu_threads() if wp.get_device(self.device).is_cpu else 0
        rows, positives = (*rows, *self.missing.values()), float(self.truth.mean())
        return Choice(bounder, rows, self.narrow_ns, positives, queries, self.memory, self.device, threads, about)


# --- choose ----------------------------------------------------------------------------------------------------------

SAMPLES = 200_000  # random queries, where the caller has none


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
    networks: Iterable[tuple[int, ...]] = NETWORKS,
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
        budget: Seconds that fits and measurements take together, up to an eighth more; what ``checkpoint`` holds is
            charged with what it took. What there is no time for is not begun, or stopped, and its row shows the budget
            that it needs. Compiling kernels, once for each size of network, is not counted.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        length: Length of a ray, object units; 1 if ``None``. Other queries have none.
        methods: Names of methods that are tried: those in ``METHODS``, ``"learned-kdop+mlp"``, and of distances
            ``"distance-grid"`` and ``"distance"``, a network; all of them if ``None``, only ``bounders`` for ``()``.
        networks: Hidden widths of the networks that are tried, in this order; none of them for ``()``.
        bounders: Bounders of this very shape that you have already, by name; they are measured with the others.
            Distances answer points, rays and boxes.
        overhead_ns: What your step takes for a query if there is any bounder, without the bounder itself, such as for
            lists of what is left.
        statistical: Whether a bounder that samples attest may be chosen, too; else only proven ones are.
        checkpoint: Folder where candidates are stored as they are fitted; a call with the same settings goes on there.
            ``None`` keeps nothing.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends fitting; what was fitted is then compared.

    Raises:
        ShapeError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query, or queries that are none of it.
        BounderError: For a price, memory or budget that makes no sense, an unknown method, or too little memory.
        FileFormatError: For a folder that holds something else.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, methods=("aabb", "obb"), device="cpu", progress=False)
        >>> choice.rows[0].cost <= min(row.cost for row in choice.rows if not row.why_not)
        True
    """
    check_query(query)
    check_numbers(budget, seed, margin)
    check_prices(query, narrow_ns, overhead_ns, memory, length, statistical)
    methods, device, budget = check_methods(methods), str(device_of(device)), float(budget)
    networks = check_networks(networks)
    shape, length = own_coordinates(load_shape(shape), "choose"), length or 1.0
    warn_of_restriction(shape)
    candidates = candidates_of(query, shape, networks, methods)
    bounded, rng = shape.dilated(margin) if margin else shape, np.random.default_rng(seed)
    given = sample(query, bounded, SAMPLES, rng) if workload is None else workload
    x = CallersQueries(given, bounded, domain_of(bounded, query, length), seed).x
    half = np.zeros(len(x), dtype=bool)
    half[rng.permutation(len(x))[: len(x) // 2]] = True
    fit_to, x = (x[half], x[~half]) if len(x) > 1 else (x, x)  # what is measured is in the caller's order
    options = {"margin": float(margin), "seed": int(seed)}
    options |= {"length": float(length)} if QUERIES[query].has_length else {}
    given = None if workload is None else hashlib.sha256(fit_to.tobytes()).hexdigest()
    settings = {"shape": bounded.digest, "query": query, **options, "queries": given}
    options["workload"] = None if workload is None else fit_to
    folder = None if checkpoint is None else Path(checkpoint)
    limits = (float(narrow_ns), float(overhead_ns), memory, statistical, device, budget, folder)
    search, own = Search(shape, query, options, bounded, x, length, *limits), bounders or {}
    for label, bounder in own.items():
        search.check(label, bounder)
    if folder is not None:
        search.open(settings)
    with reported(progress, "choose") as search.update:
        for label, bounder in own.items():
            search.measure(label, bounder.to(device), own=True)
        large = [each for each in candidates if memory is not None and BYTES * each.numbers > memory]
        search.run([each for each in candidates if each not in large])
        for label, nbytes in ((each.label, BYTES * each.numbers) for each in large):
            search.missing[label] = Row(label, nbytes, why_not="over the memory limit")
        return search.choice(len(half))


def choose_among(asked: Mapping[str, Callable[[], Any]], queries: int, *, narrow_ns: float, turns: int = 5) -> Choice:
    """Time broad phases in your own code, all overhead included, and take the cheapest.

    This takes anything that answers: a planner's edges by boxes of their pieces or by marching, two bounders one after
    another, code without a bounder. Whether an answer is proven is for the caller to know.

    Args:
        asked: Functions without arguments by label; each answers the same queries and returns ``(queries,)`` numbers,
            not zero where the narrow phase is needed.
        queries: How many these are.
        narrow_ns: What the narrow phase takes for one query, nanoseconds.
        turns: Calls of each that are timed, after one that is not; they take turns, and the fastest counts.

    Returns:
        The choice; its ``bounder`` is ``None``, its ``label`` says which. No broad phase is one of the answers.

    Raises:
        BounderError: For a price that makes no sense, or answers that are not so many.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> box, x = wb.fit(ball, method="aabb", device="cpu"), np.random.rand(10_000, 3).astype(np.float32)
        >>> wb.choose_among({"box": lambda: box.query(x).numpy()}, len(x), narrow_ns=0.0).label
        'none'
    """
    check_prices("point", narrow_ns)
    if isinstance(queries, bool) or not isinstance(queries, (int, np.integer)) or queries < 1:
        raise BounderError(f"queries must be a whole number of at least 1, got {queries!r}")
    taken, shares = dict.fromkeys(asked, math.inf), {}
    for turn in range(max(int(turns), 1) + 1):
        for label, ask in asked.items():
            start = time.perf_counter()
            answers = ask()
            seconds = time.perf_counter() - start
            if turn:
                taken[label] = min(taken[label], seconds)
                continue
            answers = np.asarray(answers.numpy() if hasattr(answers, "numpy") else answers)
            if answers.shape != (queries,):
                raise BounderError(f"{label}: expected ({queries},) answers, got {answers.shape}")
            shares[label] = float(np.count_nonzero(answers)) / queries
    lines = [(NONE, 0.0, 1.0), *((label, 1e9 * taken[label] / queries, share) for label, share in shares.items())]
    rows = sorted((Row(label, 0, t, p, t + p * narrow_ns) for label, t, p in lines), key=lambda row: row.cost)
    return Choice(None, tuple(rows), float(narrow_ns), min(shares.values(), default=1.0), int(queries))


# --- plot ------------------------------------------------------------------------------------------------------------

PRICES = (1.0, 1e6)  # of the narrow phase, nanoseconds, that are shown at least


def cost_plot(choice: Choice) -> bytes:
    """Draw what each candidate costs, by the price of the narrow phase: a PNG file. Needs matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("the plot needs matplotlib: pip install 'warp-bounding[train]'") from error
    best, rows = choice.prices, {row.label: row for row in choice.rows if not row.why_not}
    edges = [choice.narrow_ns, *(stretch.price for stretch in best)]
    low = min([PRICES[0], *(edge / 3 for edge in edges if edge > 0)])
    high = max(PRICES[1], 3 * max(edges))
    prices, here = np.geomspace(low, high, 400), max(choice.narrow_ns, low)
    figure = Figure(figsize=(7.6, 4.6), layout="constrained")
    panel = figure.subplots()
    for row in rows.values():
        panel.plot(prices, row.nanoseconds + row.share * prices, color="silver", linewidth=0.7)
    for stretch, end in zip(best, [*(stretch.price for stretch in best[1:]), high], strict=True):
        row, own = rows[stretch.label], np.geomspace(max(stretch.price, low), end, 50)
        label = f"{row.label}, from {duration(stretch.price)}" if stretch.price else row.label
        panel.plot(own, row.nanoseconds + row.share * own, linewidth=3, label=label)
    if choice.positives > 0:
        panel.plot(prices, choice.positives * prices, "k:", linewidth=0.9, label="what meets the object")
    panel.axvline(here, color="black", linestyle="--", linewidth=0.8)
    panel.plot([here], [choice.row.nanoseconds + choice.row.share * here], "ko", label=f"chosen: {choice.label}")
    fastest = min((row.nanoseconds for row in rows.values() if row.nanoseconds > 0), default=low)
    panel.set(xscale="log", yscale="log", xlim=(low, high), title="What each broad phase costs; thick: the cheapest")
    panel.set_ylim(bottom=max(0.5 * fastest, 1e-2))
    panel.set_xlabel("price of the narrow phase, nanoseconds a call")
    panel.set_ylabel("broad and narrow phase, nanoseconds a query")
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(loc="upper left", frameon=False, fontsize=8)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=130)
    return file.getvalue()
