"""What is tried: every method that can bound such queries, in several sizes where sizes differ, cascades, and distances that can be asked such queries."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from warp_bounding.bounders import DISTANCES, METHODS, Bounder
from warp_bounding.bounders.distances.grid import DistanceGrid
from warp_bounding.bounders.distances.mlp import MlpDistance
from warp_bounding.bounders.neural.mlp import Mlp, check_hidden
from warp_bounding.errors import BounderError
from warp_bounding.evaluation.distances import ASKED
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import QUERIES
from warp_bounding.training.trainers import trainer_of

__all__ = [
    "DISTANCE_NETWORK",
    "NETWORKS",
    "TIMES_SMALLER",
    "Candidate",
    "candidates_of",
    "check_methods",
    "check_networks",
]

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
