"""Which bounder for these queries, this narrow phase and this machine: candidates are fitted, measured and priced."""

import contextlib
import hashlib
import io
import json
import math
import os
import re
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.bounders import DISTANCES, METHODS, Bounder, DistanceBounder, load
from warp_bounding.bounders.distance_grid import DistanceGrid
from warp_bounding.bounders.mlp import RECIPES, Mlp, check_hidden
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, FileFormatError
from warp_bounding.evaluation import ASKED, parts_of
from warp_bounding.indicators import IndicatorGrid, load_indicator
from warp_bounding.indicators.parts import SIDES
from warp_bounding.indicators.recentred import own_coordinates
from warp_bounding.indicators.shape import Shape
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
from warp_bounding.training import fit
from warp_bounding.training.fit import check_numbers, check_regions, is_number, trainer_of, warn_of_restriction
from warp_bounding.training.samples import CallersQueries
from warp_bounding.version import __version__

__all__ = [
    "DISTANCE_NETWORK",
    "FORMATS",
    "LEAST_SECONDS",
    "NETWORKS",
    "NONE",
    "NOT_TRIED",
    "OVERDRAWN",
    "ROUNDS",
    "ROUND_STEPS",
    "TIMES_SMALLER",
    "TURNS",
    "Attempts",
    "Batch",
    "Candidate",
    "Choice",
    "ClosedForms",
    "Kept",
    "Line",
    "Pace",
    "Row",
    "Spending",
    "Stretch",
    "TooSlowError",
    "Tried",
    "Watch",
    "Work",
    "candidates_of",
    "cheapest",
    "check_methods",
    "check_networks",
    "check_prices",
    "choose",
    "choose_among",
    "chosen",
    "cost_plot",
    "duration",
    "hardly_trained",
    "race",
    "starved",
    "times_of",
    "told_budget",
]

# --- prices ----------------------------------------------------------------------------------------------------------
#
# Costs of broad phases as functions of the narrow phase's price: ``t + p * price`` (paper, Eq. 6), and which is the least where.


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


# --- candidates ------------------------------------------------------------------------------------------------------
#
# What is tried: every method that can bound such queries, in several sizes where sizes differ, cascades, and distances that can be asked such queries.

NETWORKS = ((16, 16), (24, 24), (50, 50))  # hidden widths that are tried
PARTS = {(24, 24): 256, (50, 50): 1024}  # thresholds of the networks that have some
FRONT, BEHIND = "learned-kdop", (24, 24)  # of the cascade: what is asked first, and the widths of the network behind it
CLOSED_SIZES: dict[str, list[dict[str, Any]]] = {
    "bvh": [{"leaves": leaves} for leaves in (16, 64, 256, 1024, 4096)],
    "voxels": [{"resolution": cells} for cells in (16, 32, 64, 128)],
    "kdop": [{}, {"k": 26}],
}
DIMENSIONS_OF_K = 3  # where k-DOPs have such a k
DISTANCE_NETWORK = "distance"  # a network of the distance, among methods: "mlp" is the bounder's
# About how many times as long as an aabb's the fit and the proof of closed forms take: roughly the middle of what the bunny and a mesh of 29,572 triangles
# took, which differ (kdop 0.7 and 8.5 times). It says what is tried first, and what not without time for it; what takes longer is stopped.
TIMES_AABB = {
    "sphere": 1.2,
    "ellipsoid": 1.4,
    "oriented-ellipsoid": 1.5,
    "obb": 2.0,
    "kdop": 4.0,
    FRONT: 4.0,
    DistanceGrid.method: 3.0,
    "voxels": 0.05,
    "bvh": 0.1,
    "relu-field": 0.5,
}
TIMES_SMALLER = 2.0  # the same of a size and the one before it
NODES = {2: (32, 64, 128), 3: (16, 32), 4: (8, 16)}  # of distance grids, along the longest side, by dimension
BYTES = 4  # of a number


@dataclass(frozen=True)
class Candidate:
    """Something to fit.

    Attributes:
        method: As ``fit`` takes it.
        options: Of the method, and ``resolution``.
        network: Whether training pays by the second: it is tried with little time first.
        least_bytes: It will have so much memory at least, where that is known.
        distance: Whether the distance is fitted, and asked what the queries are.
        learns: Whether its fit takes the seconds that it is given, network or not.
    """

    method: str
    options: dict[str, Any] = field(default_factory=dict)
    network: bool = False
    least_bytes: int = 0
    distance: bool = False
    learns: bool = False

    @property
    def numbers(self) -> int:
        """About how many a network has; 0 for others."""
        return self.least_bytes // BYTES if self.network else 0

    @property
    def front(self) -> str:
        """The method of what is asked before a network, which is fitted first; empty where there is none."""
        return self.method.rpartition("+")[0]

    @property
    def times_aabb(self) -> float:
        """``TIMES_AABB`` of its method."""
        return TIMES_AABB.get(self.method, 1.0)

    @property
    def label(self) -> str:
        """For people, and for files."""
        words = {
            "hidden": lambda widths: "-".join(map(str, widths)),
            "thresholds": lambda count: f"{count} parts",
            "leaves": lambda count: f"{count} leaves",
            "resolution": lambda count: f"{count} cells",
            "k": lambda count: f"k {count}",
            "nodes": lambda count: f"{count} nodes",
        }
        name = DISTANCE_NETWORK if self.distance and self.network else self.method
        return " ".join([name, ", ".join(words.get(key, str)(value) for key, value in self.options.items())]).strip()


def _known(cls: type[Bounder], options: dict[str, Any], query: str) -> bool:
    """Whether a method has all of some options, for a kind of query."""
    names = {option.name for option in cls.options if query in option.queries}
    return all(name in names or name == "resolution" for name in options)


def check_methods(methods: Iterable[str] | None) -> frozenset[str]:
    """Names of methods that are to be tried; all of them for ``None``.

    Raises:
        BounderError: For a name that is none of them.
    """
    names = [*METHODS, DistanceGrid.method, DISTANCE_NETWORK, f"{FRONT}+{Mlp.method}"]
    wanted = frozenset(names if methods is None else [methods] if isinstance(methods, str) else methods)
    for name in wanted:
        if name not in names:
            raise BounderError(f"methods must be some of {', '.join(names)}, got {name!r}")
    return wanted


def check_networks(networks: Iterable[Iterable[int]]) -> tuple[tuple[int, ...], ...]:
    """Hidden widths of the networks that are to be tried.

    Raises:
        BounderError: For what is no such collection, or widths that no network can have.
    """
    networks = tuple(networks) if isinstance(networks, Iterable) else networks
    if not isinstance(networks, tuple) or not all(isinstance(widths, Iterable) for widths in networks):
        expected = f"widths of the hidden layers, one tuple for each network, such as {NETWORKS}"
        raise BounderError(f"networks must be {expected}, got {networks!r}")
    return tuple(check_hidden(widths) for widths in networks)


def candidates_of(
    query: str, shape: Shape, networks: tuple[tuple[int, ...], ...] = NETWORKS, methods: frozenset[str] | None = None
) -> list[Candidate]:
    """All that is tried for a kind of query about a shape, what takes no time first.

    Args:
        query: Kind of query.
        shape: What is to be bounded.
        networks: Hidden widths.
        methods: What ``check_methods`` has returned; all of them for ``None``.
    """
    every = [*_of_queries(query, shape, networks), *_of_distances(query, shape, networks)]
    wanted = check_methods(None) if methods is None else methods
    found = [each for each in every if each.label.split()[0] in wanted]
    return sorted(found, key=lambda each: each.network)  # what takes no time first, else as they are


def _of_distances(query: str, shape: Shape, networks: tuple[tuple[int, ...], ...]) -> list[Candidate]:
    """Distances that can be asked such queries: grids of any, networks of rays and boxes alone, since for points one that learns just their answers is tighter."""
    if query not in ASKED or (shape.time and QUERIES[query].is_region):
        return []
    found = []
    if DISTANCES[DistanceGrid.method].supports(shape.ndim) and (DistanceGrid.moving or not shape.time):
        found += [
            Candidate(DistanceGrid.method, {"nodes": nodes}, distance=True) for nodes in NODES.get(shape.ndim, ())
        ]
    if QUERIES[query].is_region and MlpDistance.supports(shape.ndim):
        found += [_network(Mlp.method, {"hidden": own}, shape.ndim, distance=True) for own in networks[-2:]]
    return found


def _of_queries(query: str, shape: Shape, networks: tuple[tuple[int, ...], ...]) -> list[Candidate]:
    """Bounders of these very queries."""
    own_cells, ndim = isinstance(shape, IndicatorGrid), shape.ndim
    closed, learned = [], []
    for name, cls in METHODS.items():
        if not (cls.conservative and cls.supports(query, ndim)):
            continue
        if trainer_of(cls).proves:
            # of all kinds of network but the plain one the largest size only: each size compiles kernels of its own
            widths = networks if cls is Mlp else networks[-1:]
            learned += [_network(name, {"hidden": own}, ndim) for own in widths]
            continue
        sizes = [own for own in CLOSED_SIZES.get(name, [{}]) if "k" not in own or ndim == DIMENSIONS_OF_K]
        known = [own for own in sizes if _known(cls, own, query) and not (own_cells and "resolution" in own)]
        learns = trainer_of(cls) is not trainer_of(Bounder)
        closed += [Candidate(name, own, learns=learns) for own in known or [{}]]
    if Mlp.supports(query, ndim):
        with_parts = [{"hidden": widths, "thresholds": PARTS[widths]} for widths in networks if widths in PARTS]
        learned += [_network(Mlp.method, own, ndim) for own in with_parts if _known(Mlp, own, query)]
        if BEHIND in networks and METHODS[FRONT].supports(query, ndim):
            learned.append(_network(f"{FRONT}+{Mlp.method}", {"hidden": BEHIND}, ndim))
    return closed + learned


def _network(method: str, options: dict[str, Any], ndim: int, *, distance: bool = False) -> Candidate:
    widths = options["hidden"]
    numbers = sum(k * h + h for k, h in pairwise((ndim, *widths, 1)))  # regions have more inputs
    return Candidate(method, options, True, BYTES * numbers, distance, learns=True)


# --- timing ----------------------------------------------------------------------------------------------------------
#
# What bounders, and distances that stand in for one, answer to queries in a batch, and what they take for it.

TIMED, TURNS = 200_000, 9  # queries of a timed launch, at least, and launches of each
MOST_SECONDS, FEWEST = 0.3, 1  # of all launches of one, after which no more are timed, and how many are in any case


class Batch:
    """Queries of one kind that all candidates are asked.

    Args:
        query: Kind of query.
        x: ``(N, m)`` float32, object space.
        length: Of rays.
    """

    def __init__(self, query: str, x: np.ndarray, length: float):
        self.query, self.x, self.length = query, x, length

    def asked_of(self, bounder: Bounder | DistanceBounder) -> Callable[[], wp.array]:
        """What asks a bounder all of them, again and again; they lie on its device before."""
        if not isinstance(bounder, DistanceBounder):
            return bounder.prepare(wp.array(self.x, dtype=wp.float32, device=bounder.device)).launch
        parts = [wp.array(x, dtype=wp.float32, device=bounder.device) for x in parts_of(self.query, self.x)]
        ask = ASKED[self.query](bounder, self.length, {})
        return lambda: ask(*parts)

    def maybe(self, bounder: Bounder | DistanceBounder) -> np.ndarray:
        """``(N,)`` bool: which ones it does not deny."""
        return self.asked_of(bounder)().numpy() == 1


def times_of(bounders: Mapping[str, Bounder | DistanceBounder], batch: Batch, turns: int) -> dict[str, float]:
    """Nanoseconds of one query of a batch, the fastest of some launches, which take turns: whatever else the machine does slows all alike."""
    many = Batch(batch.query, np.resize(batch.x, (max(len(batch.x), TIMED), batch.x.shape[1])), batch.length)
    asked = {label: many.asked_of(bounder) for label, bounder in bounders.items()}
    times, taken = dict.fromkeys(bounders, math.inf), dict.fromkeys(bounders, 0.0)
    for turn in range(turns + 1):
        for label, launch in asked.items():
            if turn > FEWEST and taken[label] > MOST_SECONDS:  # it is so slow that another turn would change little
                continue
            device = wp.get_device(bounders[label].device)
            wp.synchronize_device(device)
            start = time.perf_counter()
            launch()
            wp.synchronize_device(device)
            if turn:  # the first one loads kernels
                taken[label] += time.perf_counter() - start
                times[label] = min(times[label], time.perf_counter() - start)
    return {label: 1e9 * seconds / len(many.x) for label, seconds in times.items()}


# --- pace ------------------------------------------------------------------------------------------------------------
#
# What a choice has taken of its budget, and what networks need on this very shape to be judged: by what was measured on it.
#
# How long a network must be trained does not depend on the seconds but on its steps: with few of them it is no tighter than a box. What a step takes depends on
# the shape (its samples are labelled), the size of the network and the machine, so the first rounds of each training tell it (``Watch``).

LEAST_SECONDS = 3.0  # of a network's fit
ROUND_STEPS = 100  # steps between two refreshes of the samples, of all recipes: a round
# Rounds after which a network can be judged. Networks 24-24 of points had 7.5 % false positives after 5 rounds and 2.6 % after 15 on the bunny, and on a mesh
# of 29,572 triangles as many as a box after 2, and 3.0 % after 11.
ROUNDS = 8
RESERVED, REGION_RESERVED = (
    0.25,
    0.5,
)  # of a fit's seconds, for the searches of its prover, of points and of regions: about what trainers keep
GROWTH = 0.3  # a round takes so long as a network has numbers, to about this power: 24-24 and 50-50 on the bunny, on a busy machine
EARLY_ROUNDS = (1, 2)  # after which it is told whether a training will come to enough rounds, ...
PATIENCE = 1.6  # ... and what it needs to be stopped then, times the seconds it was given
OVERTIME, LEAST_EXTRA = (
    0.1,
    0.5,
)  # of a fit: a share of the seconds that it was given, and seconds at least, for what comes before and behind training


class TooSlowError(Exception):
    """A training that would end before the network can be judged."""


@dataclass
class Spending:
    """What a choice has taken of its budget, compiling kernels not counted.

    Attributes:
        budget: Seconds.
        charged: What fits took that are kept from before.
        started: When it began, ``working_seconds``.
    """

    budget: float
    charged: float = 0.0
    started: float = field(default_factory=working_seconds)

    @property
    def now(self) -> float:
        """Seconds since it began."""
        return working_seconds() - self.started

    @property
    def spent(self) -> float:
        """Seconds, those of fits from before included."""
        return self.charged + self.now

    @property
    def left(self) -> float:
        """Seconds; less than 0 where the budget is overdrawn."""
        return self.budget - self.spent


class Watch:
    """The progress of a network's fit, which tells the user's, and stops a training that is too slow for its seconds.

    Args:
        given: Seconds of the fit; infinity where it is not to be stopped.
        reserved: Share of them that is not for training.
        tell: The user's progress: called with a note.
    """

    def __init__(self, given: float, reserved: float, tell: Callable[[str], None]):
        self._given, self._reserved, self._tell = given, reserved, tell
        self._started, self._marks = working_seconds(), []

    def __call__(self, done: float, total: float, note: str) -> None:
        """See ``Progress``.

        Raises:
            TooSlowError: Where too few rounds fit into what is left.
        """
        self._marks.append(working_seconds())
        self._tell(note)
        if (
            len(self._marks) - 1 in EARLY_ROUNDS
            and needed(self.setup, self.round, self._reserved) > PATIENCE * self._given
        ):
            raise TooSlowError

    @property
    def setup(self) -> float:
        """Seconds before the first step; 0 where none was made."""
        return self._marks[0] - self._started if self._marks else 0.0

    @property
    def round(self) -> float:
        """Seconds of a round; 0 where there was none."""
        return float(np.median(np.diff(self._marks))) if len(self._marks) > 1 else 0.0


def needed(setup: float, round_: float, reserved: float) -> float:
    """Seconds of a fit that a network can be judged by."""
    return max((setup + ROUNDS * round_) / (1 - reserved), LEAST_SECONDS)


class Pace:
    """What networks need on this shape.

    Args:
        region: Whether queries are regions.
    """

    def __init__(self, region: bool):
        self.reserved = REGION_RESERVED if region else RESERVED
        self._known: dict[str, tuple[Candidate, float, float]] = {}
        self._extra = LEAST_EXTRA

    def learn(self, candidate: Candidate, setup: float, round_: float) -> None:
        """Take note of what a training took."""
        if setup > 0 and round_ > 0:
            self._known[candidate.label] = candidate, setup, round_

    def took(self, given: float, taken: float) -> None:
        """Take note of what a whole fit took that was given so many seconds."""
        self._extra = max(self._extra, taken - (1 + OVERTIME) * given)

    def needed(self, candidate: Candidate, front: float = 0.0) -> float | None:
        """Seconds of a fit after which it can be judged, by its own rounds or those of the network that is most like it; ``None`` where nothing is known.

        Args:
            candidate: A network.
            front: What is fitted before it takes so many seconds.
        """
        alike = [
            (
                candidate.label != label,
                candidate.method != each.method,
                abs(math.log(candidate.numbers / each.numbers)),
                label,
            )
            for label, (each, _, _) in self._known.items()
            if candidate.distance == each.distance
        ]
        if not alike:
            return None
        own, setup, round_ = self._known[min(alike)[-1]]
        return front + needed(setup, round_ * (candidate.numbers / own.numbers) ** GROWTH, self.reserved)

    def whole(self, seconds: float) -> float:
        """What a fit takes that is given so many seconds."""
        return (1 + OVERTIME) * seconds + self._extra

    def given(self, whole: float) -> float:
        """What a fit may be given that is to take no longer than that."""
        return (whole - self._extra) / (1 + OVERTIME)


# --- result ----------------------------------------------------------------------------------------------------------
#
# What ``choose`` found: rows of all candidates, the one that costs the least, and the prices at which that changes.

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


# --- starved ---------------------------------------------------------------------------------------------------------
#
# Whether a network had too little time to tell what its kind can do: too few steps, or a proof that was cut short.

ENOUGH = 0.6  # of ``ROUNDS``
LOST = 0.25  # of what it leaves beside positives: what the proof's gap may account for


def hardly_trained(bounder: Bounder | DistanceBounder) -> str:
    """That a network has made too few steps by the default recipe to tell what its kind can do, in words; empty for others."""
    record, enough = _record(bounder), ROUNDS * ROUND_STEPS
    steps, usual = record.get("steps"), record.get("recipe", RECIPES[0]) == RECIPES[0]
    if steps is None or steps >= ENOUGH * enough or not usual:
        return ""
    return f"hardly trained: {steps:,} steps, about {enough:,} tell what it can do"


def starved(bounder: Bounder | DistanceBounder, spare: float, x: np.ndarray) -> str:
    """Why a network that has just been fitted tells little, in words; empty where it was trained and proven in peace.

    Args:
        bounder: With the record of its training.
        spare: Share of the queries that it leaves although they do not meet the object.
        x: ``(Q, m)`` queries.
    """
    if few := hardly_trained(bounder):
        return few
    record = _record(bounder)
    if record.get("complete", True) or spare <= 0:
        return ""
    if "thresholds" not in record and isinstance(bounder, Bounder):
        f = bounder.values(np.ascontiguousarray(x, dtype=np.float32)).numpy()
        threshold = float(bounder.threshold)
        if float(((f >= threshold) & (f < threshold + record["gap"])).mean()) <= LOST * spare:
            return ""
    return "its proof had too little time, so that it is looser than its kind"


def _record(bounder: Bounder | DistanceBounder) -> dict:
    """Of a network's training; a cascade's last part has it."""
    record = bounder.info["training"]
    if "steps" not in record:
        record = (getattr(bounder, "parts", None) or [bounder])[-1].info.get("training") or record
    return record


# --- kept ------------------------------------------------------------------------------------------------------------
#
# The folder of a choice: each fitted candidate with its record, written whole, so that a choice that was stopped goes on.

SETTINGS, ATTEMPTS = "choice.json", "attempts.json"
FORMAT = 2


@dataclass
class Attempts:
    """What has been tried of one candidate, and what that told.

    Attributes:
        taken: Seconds that all fits took, those among them that came to nothing.
        given: Seconds that fits were given which ended, as they came.
        limit: Seconds after which a fit was stopped; 0 where none was.
        error: Why there can be no such bounder; empty where there can be.
        setup: Seconds that a network's training took before its first step; 0 where that is not known.
        round: Seconds between two refreshes of its samples; 0 where that is not known.
        starved: Why what was trained last tells little of its kind; empty for others.
    """

    taken: float = 0.0
    given: list[float] = field(default_factory=list)
    limit: float = 0.0
    error: str = ""
    setup: float = 0.0
    round: float = 0.0
    starved: str = ""


class Kept:
    """A folder for one shape, one set of queries and one set of settings; nothing is kept where there is no folder.

    Args:
        folder: Where; made if it is not there.
        settings: JSON-ready, what all candidates have in common.

    Raises:
        FileFormatError: If it cannot be written to, or holds something else: it is then left as it is.
    """

    def __init__(self, folder: str | os.PathLike | None, settings: dict[str, Any]):
        self.folder = None if folder is None else Path(folder)
        self._attempts: dict[str, Attempts] = {}
        if self.folder is None:
            return
        wanted = {"format": FORMAT, "version": __version__, **settings}
        file = self.folder / SETTINGS
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            found = json.loads(file.read_text(encoding="utf-8")) if file.exists() else None
            foreign = found is None and any(self.folder.iterdir())
        except (OSError, ValueError) as error:
            raise FileFormatError(f"{self.folder}: cannot be used for a choice ({error})") from error
        if foreign:
            raise FileFormatError(f"{self.folder}: holds other files, expected a new folder or one of a choice")
        if found is None:
            write_whole(file, json.dumps(wanted, indent=1).encode())
        elif found != wanted:
            differs = next(
                (key for key in wanted if not isinstance(found, dict) or found.get(key) != wanted[key]), "it"
            )
            got = found.get(differs) if isinstance(found, dict) else found
            raise FileFormatError(
                f"{self.folder}: holds a choice with another {differs}, {got!r} and not {wanted.get(differs)!r}; give another folder"
            )
        self._attempts = self._read()

    def _path(self, label: str, seconds: float) -> Path:
        name = re.sub(r"[^a-z0-9+]+", "-", label.lower()).strip("-")
        return self.folder / f"{name} {seconds:.3g} s.safetensors"

    def of(self, label: str) -> Attempts:
        """What has been tried of a candidate."""
        return self._attempts.setdefault(label, Attempts())

    def get(self, label: str, device: str | None) -> list[tuple[float, Bounder | DistanceBounder]]:
        """The candidate as it was fitted, with the seconds that each fit was given; what somebody damaged or removed is left out."""
        found = []
        for seconds in self.of(label).given if self.folder is not None else ():
            with contextlib.suppress(BoundingError):  # it is fitted anew, and replaced
                found.append((seconds, load(self._path(label, seconds), device=device)))
        return found

    def put(self, label: str, bounder: Bounder | DistanceBounder, seconds: float) -> None:
        """Keep a candidate that was fitted in so many seconds; ``note`` then keeps what is known of it."""
        if self.folder is not None:
            bounder.save(self._path(label, seconds))

    def note(self) -> None:
        """Write down what ``of`` tells of all candidates."""
        if self.folder is not None:
            told = {label: asdict(each) for label, each in self._attempts.items()}
            write_whole(self.folder / ATTEMPTS, json.dumps(told, indent=1).encode())

    def _read(self) -> dict[str, Attempts]:
        file = self.folder / ATTEMPTS
        try:
            return {label: Attempts(**each) for label, each in json.loads(file.read_text(encoding="utf-8")).items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}  # none yet, or damaged: all is fitted anew


# --- work ------------------------------------------------------------------------------------------------------------
#
# A choice in the making: candidates are fitted, as many as the budget has room for, and measured.
#
# Of what is no network the fits that take the least time come first (``closed``); networks race (``races``). Whatever is not begun, or is stopped, has a row that tells the budget that it would need.

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


# --- closed ----------------------------------------------------------------------------------------------------------
#
# What is no network, what takes the least time first: in a share of the budget, and at the end in what the networks have left.
#
# How long a fit and its proof take depends on the shape. What the first ones took tells what others will; a fit that takes longer than is left for it is stopped.

PART = 1 / 20  # of the budget: what a fit is given that learns, and what one may take of which nothing is known
LONGER = 2.0  # times what it is expected to take: when a fit is stopped, though there be time
AFTER_STOP = 2.0  # times the seconds after which a fit was stopped: what it would take, for all that is known


class ClosedForms:
    """Candidates that are no networks.

    Args:
        work: The choice.
        candidates: All of them.
        held: Labels of those that were fitted before.
    """

    def __init__(self, work: Work, candidates: list[Candidate], held: Set[str]):
        self.work, self.part = work, PART * work.spending.budget
        self._waiting = [each for each in candidates if each.label not in held]
        self._largest: dict[str, float] = {}  # what the largest size of a method took, seconds
        self._unit: float | None = None  # seconds that an aabb takes here
        self.used = 0.0
        for each in candidates:
            taken = work.kept.of(each.label).taken
            self.used += taken
            if each.label in held and taken:
                self._learn(each, taken)

    def fit(self, pot: float) -> list[Tried]:
        """Fit those that are not fitted yet, as long as all of them together have taken no more than so many seconds."""
        found, waiting, self._waiting = [], self._waiting, []
        while waiting and not self.work.interrupted:
            each = min(waiting, key=self._order)
            waiting.remove(each)
            if one := self._tried(each, pot):
                found.append(one)
        self._waiting += waiting
        return found

    def _tried(self, each: Candidate, pot: float) -> Tried | None:
        work, attempts = self.work, self.work.kept.of(each.label)
        left, needs = min(pot - self.used, work.left), max(self._expected(each), AFTER_STOP * attempts.limit)
        if attempts.error:
            work.pass_over(each.label, attempts.error)
            return None
        if left <= 0 or needs > left:
            self._leave(each, needs or self.part, left)
            return None
        first = each.times_aabb == 1 and self._unit is None  # it tells what others take
        limit = left if first else min(left, max(self.part, LONGER * needs))
        before = work.spending.now
        one = work.fitted(each, self.part, limit)
        taken = work.spending.now - before
        self.used += taken
        self._learn(each, taken)
        if one is None and not attempts.error and not work.interrupted:
            self._leave(each, AFTER_STOP * attempts.limit, pot - self.used)
        return one

    def _leave(self, each: Candidate, needs: float, left: float) -> None:
        self._waiting.append(each)
        stopped = self.work.kept.of(each.label).limit
        begun = f"stopped after {stopped:.0f} s: " if stopped else NOT_TRIED
        self.work.not_tried(each, needs, self.work.spending.budget + needs - max(min(left, self.work.left), 0.0), begun)

    def _learn(self, each: Candidate, taken: float) -> None:
        self._largest[each.method] = taken
        if each.times_aabb == 1:
            self._unit = taken

    def _expected(self, each: Candidate) -> float:
        """Seconds that a fit will take, as far as that can be told; 0 where nothing is known."""
        if each.method in self._largest:
            return TIMES_SMALLER * self._largest[each.method]
        return each.times_aabb * (self._unit or 0.0) + self.part * each.learns

    def _order(self, each: Candidate) -> tuple[float, float]:
        """The least time first; as long as no aabb has told how long it takes, as if it had taken a part."""
        known = each.method in self._largest or self._unit is not None
        return self._expected(each) if known else each.times_aabb * self.part, each.times_aabb


# --- races -----------------------------------------------------------------------------------------------------------
#
# The race of networks: as many as there is time to train until each can be judged, then the better ones longer.
#
# How long that takes is asked of the pace, as far as anything is known of it; before, the first of them is given what a race of all would give it, and is stopped
# after a round or two, and begun anew, where that is too little. Those for which there is no time are not begun.

LONGER_OF_RACES = 1.5  # times the seconds before: with less a network is not trained again
DOUBTS = 0.8  # of the seconds that it needs: with so many it is judged all the same


def race(work: Work, rivals: list[Candidate], others: list[Tried], held: Mapping[str, Tried]) -> dict[str, Tried]:
    """Train and measure networks.

    Args:
        work: The choice.
        rivals: Networks.
        others: What is no network.
        held: Networks that were trained before, by label.

    Returns:
        The cheapest of each network's fits, by label.
    """
    found = dict(held)
    able = [each for each in rivals if work.fits(each)]
    rounds = math.ceil(math.log2(len(able))) + 1 if able else 0  # in the last one, one is left
    share = work.pace.given(work.left / rounds / len(able)) if able else 0.0
    waiting = [each for each in able if each.label not in held or _starved_before(work, each)]
    while (waiting := [each for each in waiting if _may_win(work, None, others, found)]) and not work.interrupted:
        each = _next(work, waiting, found)
        waiting.remove(each)
        _judge(work, each, share, found)
    if not work.interrupted:
        _longer(work, able, others, found, rounds)
    return found


def _judge(work: Work, each: Candidate, share: float, found: dict[str, Tried]) -> None:
    """Train a network until it can be judged, or say that there is no time for it."""
    for _ in range(2):  # the second time with the pace that the first one has told
        needed = _needed(work, each)
        seconds = max(share, needed or LEAST_SECONDS)
        if work.pace.whole(seconds) > work.left:
            seconds = work.pace.given(work.left)
        if seconds < DOUBTS * (needed or LEAST_SECONDS) or work.kept.of(each.label).error:
            break
        if _train(work, each, seconds, found) or work.interrupted or work.kept.of(each.label).error:
            return
    if each.label not in found and not work.kept.of(each.label).error:
        whole = work.pace.whole(_needed(work, each) or LEAST_SECONDS)
        work.not_tried(each, whole, work.spending.budget + whole - max(work.left, 0.0))


def _needed(work: Work, each: Candidate) -> float | None:
    """Seconds that it must be trained: more than what has left it starved before, or was not enough to end."""
    attempts, front = work.kept.of(each.label), work.front_seconds(each)
    needed = work.pace.needed(each, front)
    if attempts.starved and attempts.given:
        needed = max(needed or 0.0, LONGER_OF_RACES * max(attempts.given))
    return needed


def _starved_before(work: Work, each: Candidate) -> bool:
    return bool(work.kept.of(each.label).starved)


def _train(work: Work, each: Candidate, seconds: float, found: dict[str, Tried]) -> bool:
    """Train a network once; whether it came to an end."""
    limit = work.left + OVERDRAWN * work.spending.budget
    one = work.fitted(each, seconds, limit)
    if one is None:
        return False
    before = found.get(each.label)
    if before is None or one.row.cost <= before.row.cost:
        found[each.label] = one
    return True


def _longer(work: Work, able: list[Candidate], others: list[Tried], found: dict[str, Tried], rounds: int) -> None:
    """Train the better half of the networks that there are again, then the better half of these, with all that is left."""
    count = sum(each.label in found for each in able)
    for number in range(1, rounds):
        count = math.ceil(count / 2)
        alive = [each for each in able if each.label in found and _may_win(work, found[each.label], others, found)]
        alive = sorted(alive, key=lambda each: found[each.label].row.cost)[:count]
        while alive:
            seconds = work.pace.given(work.left / (rounds - number) / len(alive))
            if seconds >= LONGER_OF_RACES * max(_longest(work, each) for each in alive):
                break
            if len(alive) == 1:
                seconds = work.pace.given(work.left)  # the last one has all that is left
                if seconds < LONGER_OF_RACES * _longest(work, alive[0]):
                    return
                break
            alive = alive[: len(alive) // 2]
        for each in alive:
            if work.interrupted:
                return
            _train(work, each, seconds, found)
        count = max(len(alive), 1)


def _longest(work: Work, each: Candidate) -> float:
    return max(work.kept.of(each.label).given, default=LEAST_SECONDS)


def _next(work: Work, waiting: list[Candidate], found: Mapping[str, Tried]) -> Candidate:
    """Which network is most promising: one of middle size first, and then larger ones as long as what is left in vain costs more than asking."""
    plain = [each for each in waiting if not each.front]
    pool = plain or waiting
    if not found:
        sizes = sorted(each.numbers for each in pool)
        return min(pool, key=lambda each: abs(each.numbers - sizes[(len(sizes) - 1) // 2]))
    best = min(found.values(), key=lambda one: one.row.cost).row
    larger = (best.share - work.positives) * work.narrow_ns > best.nanoseconds
    return (max if larger else min)(
        waiting, key=lambda each: (not each.front, each.numbers) if larger else (bool(each.front), each.numbers)
    )


def _may_win(work: Work, one: Tried | None, others: list[Tried], found: Mapping[str, Tried]) -> bool:
    """Whether a network could become the cheapest if it left nothing but the positives."""
    if one is not None and work.memory is not None and one.bounder.nbytes > work.memory:
        return False
    nanoseconds = 0.0 if one is None else one.row.nanoseconds
    return nanoseconds + work.positives * work.narrow_ns < work.best([*others, *found.values()]) or (
        one is not None and one.row.cost <= work.best([*others, *found.values()])
    )


# --- verdict ---------------------------------------------------------------------------------------------------------
#
# The verdict: times in turns, the cheapest, what is to be known of the others, and what a larger budget would have room for.

WORTH = 0.1  # of the least cost: what there must be to gain, at the most, for a larger budget to be probably worth it
MORE_TRAINING = (
    2.0  # times the seconds that left a network starved: with so many it would not be, for all that is known
)


def chosen(work: Work, tried: list[Tried], queries: int) -> Choice:
    """The choice among what was fitted, with times taken in turns.

    Raises:
        BounderError: If nothing is small enough.
    """
    untried = any(row.needs > 0 for row in work.passed.values())  # a larger budget may find what is small enough
    if work.memory is not None and not untried and not any(each.bounder.nbytes <= work.memory for each in tried):
        sizes = [(each.bounder.nbytes, each.label) for each in tried]
        nearest = f"; the nearest is {min(sizes)[1]} with {min(sizes)[0]:,}" if sizes else ""
        raise BounderError(f"memory: no candidate has {work.memory:,} bytes or less{nearest}")
    work.tell("times, in turns")
    times = times_of({each.label: each.bounder for each in tried}, work.batch, TURNS)
    rows = [Row(NONE, 0, 0.0, 1.0, work.narrow_ns, "by construction")]
    for each in tried:
        nanoseconds = work.overhead_ns + times[each.label]
        cost = nanoseconds + each.row.share * work.narrow_ns
        rows.append(replace(each.row, nanoseconds=nanoseconds, cost=cost, **_doubts(work, each.label)))
    rows.sort(key=lambda row: (bool(row.why_not), row.cost))
    best = rows[0].label
    bounder = next((each.bounder for each in tried if each.label == best), None)
    labels = {each.label for each in tried}
    others = [row for row in work.passed.values() if row.label not in labels]
    on_cpu = wp.get_device(work.device).is_cpu
    return Choice(
        bounder,
        best,
        (*rows, *others),
        work.narrow_ns,
        work.positives,
        queries,
        work.memory,
        work.device,
        cpu_threads() if on_cpu else 0,
        {
            "shape": work.shape.name,
            "query": work.query,
            "interrupted": work.interrupted,
            "budget": work.spending.budget,
            "seconds": round(work.spending.now, 3),
            "seconds_before": round(work.spending.charged, 3),
            "compile_seconds": round(compile_seconds() - work.compiled, 3),
            "larger_budget": None if work.interrupted else _larger(work, [*rows, *others]),
        },
    )


def _doubts(work: Work, label: str) -> dict[str, str | float]:
    """What a row says of a network that had too little time; what it would take is noted in ``work.foreseen``."""
    attempts = work.kept.of(label)
    if not attempts.starved:
        return {}
    work.foreseen[label] = work.pace.whole(MORE_TRAINING * max(attempts.given, default=1.0))
    needs = work.spending.budget + work.foreseen[label] - max(work.spending.left, 0.0)
    return {"note": attempts.starved, "needs": told_budget(needs)}


def _larger(work: Work, rows: list[Row]) -> dict[str, Any] | None:
    """The budget that would let in what this one had no room for, and whether that would probably change the answer."""
    missing = [row for row in rows if row.needs]
    if not missing:
        return None
    best, least = min(row.cost for row in rows if not row.why_not), work.positives * work.narrow_ns
    promising = [row for row in missing if row.label in work.networks and best - least > WORTH * best]
    more = sum(work.foreseen[row.label] for row in promising or missing) - max(work.spending.left, 0.0)
    return {
        "seconds": told_budget(work.spending.budget + more),
        "labels": [row.label for row in promising or missing],
        "probably": bool(promising),
    }


# --- choose ----------------------------------------------------------------------------------------------------------
#
# ``choose``: fit what is plausible, measure it on the caller's own queries, and take what costs the least.
#
# The budget is a limit for all that is done, and what there is no room for is not begun (``work``). Closed forms are fitted first. Of networks as many are trained as
# can be judged in that time, and then the better ones longer (``races``); what cannot become the cheapest even if it left nothing but positives is given up. Half of the
# queries are for fitting, and what is told is measured on the other half. Times are taken at the end, of all candidates in turns.

CLOSED_SHARE = 1 / 3  # of the budget, for what is no network, where there are networks
SAMPLES = 200_000  # random queries, where the caller has none


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
    methods: Iterable[str] | None = None,
    networks: Iterable[tuple[int, ...]] = NETWORKS,
    bounders: Mapping[str, Bounder | DistanceBounder] | None = None,
    overhead_ns: float = 0.0,
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
        budget: Seconds that fits and measurements take together, up to an eighth more; what ``folder`` holds is charged with what it took. What there is no room for is not
            begun, and its row tells the budget that it would need. Compiling kernels, once for each size of network, is not counted.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        length: Length of a ray, object units; 1 if ``None``. Other queries have none.
        methods: Names of methods that are tried: those in ``METHODS``, ``"learned-kdop+mlp"``, and of distances ``"distance-grid"`` and ``"distance"``,
            a network; all of them if ``None``, only ``bounders`` for ``()``.
        networks: Hidden widths of the networks that are tried; none of them for ``()``.
        bounders: Bounders of this very shape that you have already, by name; they are measured with the others. Distances are
            asked points, rays or boxes.
        overhead_ns: What your step takes for a query if any bounder is asked, beside the bounder itself, such as for lists of what is left.
        statistical: Whether a bounder that samples attest may be chosen, too; else only proven ones are.
        folder: Where candidates are kept as they are fitted; a call with the same settings goes on there. ``None`` keeps nothing.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends fitting; what was fitted is then compared.

    Returns:
        The choice, with rows of all candidates and the prices of the narrow phase at which another one is the best.

    Raises:
        IndicatorError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query, or queries that are none of it.
        BounderError: For a price, memory or budget that makes no sense, an unknown method, or memory that holds no candidate at all.
        FileFormatError: For a folder that holds something else.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, budget=5.0, networks=(), device="cpu", progress=False)
        >>> choice.rows[0].cost <= min(row.cost for row in choice.rows if not row.why_not)
        True
    """
    check_query(query)
    check_numbers(budget, seed, margin)
    check_prices(query, narrow_ns, overhead_ns, memory, length, statistical)
    wanted = check_methods(methods)
    device = str(device_of(device))
    spending = Spending(float(budget))
    shape, length = own_coordinates(load_indicator(shape), "choose"), length or 1.0
    warn_of_restriction(shape)
    bounded, rng = shape.dilated(margin) if margin else shape, np.random.default_rng(seed)
    x = sample(query, bounded, SAMPLES, rng) if queries is None else queries
    told = CallersQueries(x, bounded, domain_of(bounded, query, length), seed)
    sizes = check_networks(networks)
    learned, own = _halves(told.x, rng)
    options = {"margin": margin, "seed": int(seed)} | ({"length": length} if QUERIES[query].has_length else {})
    settings = {"shape": bounded.digest, "query": query, **options}
    settings["queries"] = hashlib.sha256(told.x.tobytes()).hexdigest() if queries is not None else None
    work = Work(
        shape=shape,
        query=query,
        options=options | {"queries": None if queries is None else learned},
        bounded=bounded,
        length=length,
        own=own,
        truth=np.asarray(oracle(query, bounded, "cpu", length)(own), dtype=bool),
        narrow_ns=float(narrow_ns),
        overhead_ns=float(overhead_ns),
        memory=memory,
        device=device,
        statistical=statistical,
        kept=Kept(folder, settings),
        spending=spending,
    )
    candidates = candidates_of(query, shape, sizes, wanted)
    closed, rivals = ([each for each in candidates if each.network == network] for network in (False, True))
    work.networks = frozenset(each.label for each in rivals)
    with reported(progress, "choose") as work.update:
        others, held = work.measured_own(bounders or {}), work.from_before(candidates)
        others += [held.pop(each.label) for each in closed if each.label in held]
        forms = ClosedForms(work, closed, {each.label for each in others})
        others += forms.fit(CLOSED_SHARE * spending.budget if rivals else math.inf)
        networks = race(work, rivals, others, held)
        others += forms.fit(math.inf)  # with what is left
        return chosen(work, [*others, *networks.values()], len(told.x))


def _halves(x: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Queries to fit to, in any order, and queries to measure with, in the caller's order; one alone is both."""
    if len(x) < 2:
        return x, x
    first = np.zeros(len(x), dtype=bool)
    first[rng.permutation(len(x))[: len(x) // 2]] = True
    return x[first], x[~first]


def check_prices(query: str, narrow_ns, overhead_ns, memory, length, statistical) -> None:
    """Refuse what makes no sense for any shape, with ``BounderError``."""
    for name, value in (("narrow_ns", narrow_ns), ("overhead_ns", overhead_ns)):
        if not is_number(value) or value < 0:
            raise BounderError(f"{name} must be a number of nanoseconds of at least 0, got {value!r}")
    whole = isinstance(memory, (int, np.integer)) and not isinstance(memory, bool)
    if memory is not None and not (whole and memory > 0):
        raise BounderError(f"memory must be a whole number of bytes of at least 1, got {memory!r}")
    check_regions(query, NONE, length, SIDES[0])
    if not isinstance(statistical, bool):
        raise BounderError(f"statistical must be True or False, got {statistical!r}")


# --- among -----------------------------------------------------------------------------------------------------------
#
# ``choose_among``: the cheapest of broad phases that one's own code asks, whatever they are made of.

TURNS_OF_AMONG = 5  # calls of each that are timed


def choose_among(
    asked: Mapping[str, Callable[[], Any]], queries: int, *, narrow_ns: float, turns: int = TURNS_OF_AMONG
) -> Choice:
    """Choose among broad phases as they are asked in one's own code: what a query costs there is what counts, all overhead included.

    Where ``choose`` fits and asks bounders of one kind of query, this takes anything that answers: a planner's edges by boxes of their pieces or by
    marching, two bounders one after another, code without a bounder. Whether an answer is proven is for the caller to know.

    Args:
        asked: By label, called without arguments; each asks the same queries and returns ``(queries,)`` answers, not zero where the narrow phase is needed.
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
    if not is_number(narrow_ns) or narrow_ns < 0:
        raise BounderError(f"narrow_ns must be a number of nanoseconds of at least 0, got {narrow_ns!r}")
    if isinstance(queries, bool) or not isinstance(queries, (int, np.integer)) or queries < 1:
        raise BounderError(f"queries must be a whole number of at least 1, got {queries!r}")
    best, shares = dict.fromkeys(asked, math.inf), {}
    for turn in range(max(int(turns), 1) + 1):
        for label, ask in asked.items():
            start = time.perf_counter()
            answers = ask()
            seconds = time.perf_counter() - start
            if turn:
                best[label] = min(best[label], seconds)
            else:
                shares[label] = _share(label, answers, queries)
    rows = [Row(NONE, 0, 0.0, 1.0, float(narrow_ns), "by construction")]
    for label, seconds in best.items():
        nanoseconds = 1e9 * seconds / queries
        rows.append(Row(label, 0, nanoseconds, shares[label], nanoseconds + shares[label] * narrow_ns))
    rows.sort(key=lambda row: row.cost)
    least = min(shares.values(), default=1.0)
    return Choice(None, rows[0].label, tuple(rows), float(narrow_ns), least, int(queries), None, "cpu", cpu_threads())


def _share(label: str, answers, queries: int) -> float:
    """Of the queries that are left."""
    found = np.asarray(answers.numpy() if hasattr(answers, "numpy") else answers)
    if found.shape != (queries,):
        raise BounderError(f"{label}: expected ({queries},) answers, got {found.shape}")
    return float(np.count_nonzero(found)) / queries


# --- plot ------------------------------------------------------------------------------------------------------------
#
# The picture of a choice: what each candidate costs, by the price of the narrow phase, and which is the best where.
#
# matplotlib is imported when it is drawn, and draws without a display.

FORMATS = {"png": "Software", "svg": "Date"}  # and what a file does not tell, so that the same rows make the same one
COLOURS = ("#1b5e9e", "#d1420a", "#00846b", "#8a1c5a", "#c58a00", "#43474b", "#4aa3df", "#a8323e")
INK, PALE, FAINT = "#22303c", "#dde2e6", "#b9c1c8"
SIZE, DPI = (7.6, 4.6), 130
PRICES = (1.0, 1e6)  # of the narrow phase, nanoseconds, at least
POINTS = 400
MOST_NAMED = len(COLOURS)


def cost_plot(choice: Choice) -> dict[str, bytes]:
    """Draw it.

    Returns:
        File content by format.

    Raises:
        BoundingError: If matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("the plot needs matplotlib: pip install 'warp-bounding[train]'") from error
    files = {kind: io.BytesIO() for kind in FORMATS}
    with matplotlib.rc_context({"font.size": 9, "font.family": "DejaVu Sans", "svg.hashsalt": "choice"}):
        figure = Figure(figsize=SIZE, layout="constrained")
        _draw(figure.subplots(), choice)
        for kind, content in files.items():
            figure.savefig(content, format=kind, dpi=DPI, metadata={FORMATS[kind]: None})
    return {kind: content.getvalue() for kind, content in files.items()}


def _draw(panel, choice: Choice) -> None:
    stretches, price = choice.prices, choice.narrow_ns
    low = min(PRICES[0], *(s.price / 3 for s in stretches if s.price > 0), price / 3 if price > 0 else PRICES[0])
    high = max(PRICES[1], 3 * price, *(3 * s.price for s in stretches))
    prices = np.geomspace(low, high, POINTS)
    rows = {row.label: row for row in choice.rows if not row.why_not}
    best = [stretch.label for stretch in stretches]
    for label, row in rows.items():
        if label not in best:
            panel.plot(prices, _costs(row, prices), color=FAINT, linewidth=0.7, zorder=1)
    named = best if len(best) <= MOST_NAMED else [*best[: MOST_NAMED - 1], best[-1]]
    edges = [*(max(stretch.price, low) for stretch in stretches), high]
    for number, label in enumerate(best):
        colour = COLOURS[named.index(label)] if label in named else INK
        costs = _costs(rows[label], prices)
        panel.plot(prices, costs, color=colour, linewidth=0.9, alpha=0.6, zorder=2)
        own = np.geomspace(edges[number], edges[number + 1], 50)
        told = f"{label}, from {duration(stretches[number].price)}" if stretches[number].price else label
        panel.plot(own, _costs(rows[label], own), color=colour, linewidth=3, zorder=3, label=told)
    panel.axvline(max(price, low), color=INK, linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
    chosen = choice.row
    panel.plot([max(price, low)], [_costs(chosen, np.array([max(price, low)]))[0]], "o", color=INK, zorder=4)
    panel.annotate(
        f"{chosen.label}\n{duration(chosen.cost)} a query",
        (max(price, low), max(chosen.cost, 1e-3)),
        xytext=(8, -8),
        textcoords="offset points",
        va="top",
        color=INK,
    )
    floor = max(choice.positives, 0.0) * prices
    if choice.positives > 0:
        panel.plot(prices, floor, color=INK, linewidth=0.9, linestyle=":", zorder=1, label="what meets the object")
    panel.set(xscale="log", yscale="log", xlim=(low, high))
    panel.set_ylim(
        bottom=max(0.5 * min(rows[label].nanoseconds for label in best if label != NONE), 1e-2)
        if len(best) > 1
        else None
    )
    panel.set_xlabel("price of the narrow phase, nanoseconds a call", color=INK)
    panel.set_ylabel("broad and narrow phase, nanoseconds a query", color=INK)
    panel.set_title("What each broad phase costs; thick: the cheapest", loc="left", color=INK, fontweight="bold")
    panel.grid(color=PALE, linewidth=0.6)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(loc="upper left", frameon=False, fontsize=8, labelcolor=INK)


def _costs(row: Row, prices: np.ndarray) -> np.ndarray:
    return row.line.cost(prices)
