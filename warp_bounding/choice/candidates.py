"""What is tried: every method that can bound such queries, in several sizes where sizes differ, and cascades."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from warp_bounding.bounders import METHODS, Bounder
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.training.trainers import trainer_of

__all__ = ["NETWORKS", "Candidate", "candidates_of"]

NETWORKS = ((16, 16), (24, 24), (50, 50))  # hidden widths that are tried
PARTS = {(24, 24): 256, (50, 50): 1024}  # thresholds of the networks that have some
FRONT, BEHIND = "learned-kdop", (24, 24)  # of the cascade: what is asked first, and the widths of the network behind it
CLOSED_SIZES: dict[str, list[dict[str, Any]]] = {
    "bvh": [{"leaves": leaves} for leaves in (16, 64, 256, 1024, 4096)],
    "voxels": [{"resolution": cells} for cells in (16, 32, 64, 128)],
    "kdop": [{}, {"k": 26}],
}
BYTES = 4  # of a number


@dataclass(frozen=True)
class Candidate:
    """Something to fit.

    Attributes:
        method: As ``fit`` takes it.
        options: Of the method, and ``resolution``.
        network: Whether training pays by the second: it is tried with little time first.
        least_bytes: It will have so much memory at least, where that is known.
    """

    method: str
    options: dict[str, Any] = field(default_factory=dict)
    network: bool = False
    least_bytes: int = 0

    @property
    def label(self) -> str:
        """For people, and for files."""
        words = {
            "hidden": lambda widths: "-".join(map(str, widths)),
            "thresholds": lambda count: f"{count} parts",
            "leaves": lambda count: f"{count} leaves",
            "resolution": lambda count: f"{count} cells",
            "k": lambda count: f"k {count}",
        }
        return " ".join(
            [self.method, ", ".join(words.get(key, str)(value) for key, value in self.options.items())]
        ).strip()


def _known(cls: type[Bounder], options: dict[str, Any], query: str) -> bool:
    """Whether a method has all of some options, for a kind of query."""
    names = {option.name for option in cls.options if query in option.queries}
    return all(name in names or name == "resolution" for name in options)


def candidates_of(query: str, shape: Shape, networks: tuple[tuple[int, ...], ...] = NETWORKS) -> list[Candidate]:
    """All that is tried for a kind of query about a shape, what takes no time first.

    Args:
        query: Kind of query.
        shape: What is to be bounded.
        networks: Hidden widths.
    """
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
        sizes = CLOSED_SIZES.get(name, [{}])
        known = [own for own in sizes if _known(cls, own, query) and not (own_cells and "resolution" in own)]
        closed += [Candidate(name, own) for own in known or [{}]]
    if Mlp.supports(query, ndim):
        with_parts = [{"hidden": widths, "thresholds": PARTS[widths]} for widths in networks if widths in PARTS]
        learned += [_network(Mlp.method, own, ndim) for own in with_parts if _known(Mlp, own, query)]
        if BEHIND in networks and METHODS[FRONT].supports(query, ndim):
            learned.append(_network(f"{FRONT}+{Mlp.method}", {"hidden": BEHIND}, ndim))
    return closed + learned


def _network(method: str, options: dict[str, Any], ndim: int) -> Candidate:
    widths = options["hidden"]
    numbers = sum(k * h + h for k, h in pairwise((ndim, *widths, 1)))  # regions have more inputs
    return Candidate(method, options, True, BYTES * numbers)
