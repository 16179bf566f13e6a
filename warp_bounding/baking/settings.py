"""What all shapes of a bake have in common: how a file is read, how a bounder is made of it, on how many samples it is measured.

Settings travel to the workers with every task, and enter the names of what is baked (``digest``). There are two kinds: a bake fits one method to
all shapes, or chooses a bounder for each.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from warp_bounding.baking.names import short_digest
from warp_bounding.bounders import METHODS, Bounder, DistanceBounder, distance_class, method_class
from warp_bounding.bounders.options import arguments_of, meant, settled
from warp_bounding.errors import BounderError
from warp_bounding.queries import check_query
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.runtime.devices import device_of
from warp_bounding.version import __version__

__all__ = ["SAMPLES", "ChooseSettings", "FitSettings", "Settings", "file_digest"]

SAMPLES = 100_000  # random queries of a shape that false positives are counted on


@dataclass(frozen=True)
class Settings(ABC):
    """How each shape is baked.

    Attributes:
        arguments: Keyword arguments of ``fit`` or ``choose``, JSON-ready; neither shape nor queries, folder or progress.
        reading: Keyword arguments of ``load_indicator``, JSON-ready.
        queries: A ``.npy`` file of the caller's own queries, absolute, which every worker can read; ``None`` for none.
        samples: Random queries that false positives are counted on.
    """

    arguments: Mapping[str, Any] = field(default_factory=dict)
    reading: Mapping[str, Any] = field(default_factory=dict)
    queries: str | None = None
    samples: int = SAMPLES

    engine: ClassVar[str]  # the name of the function that makes the bounders

    @abstractmethod
    def bounder(self, shape) -> Bounder | DistanceBounder | None:
        """Make the bounder of a shape; ``None`` where none is the best choice.

        Raises:
            BoundingError: As ``fit`` and ``choose`` do.
        """

    @abstractmethod
    def check(self, *callers: Callable) -> None:
        """Refuse what would be wrong for every shape, before any of them is read.

        Args:
            *callers: Functions that hand on the arguments, whose own ones may have been meant by an unknown one.

        Raises:
            BoundingError: As ``fit`` and ``choose`` do.
        """

    def to_dict(self) -> dict[str, Any]:
        """All that makes a difference to what is baked, JSON-ready; of a file of queries its content."""
        asked = None if self.queries is None else file_digest(Path(self.queries))
        about = {"version": __version__, "engine": self.engine, "arguments": dict(self.arguments)}
        about |= {"reading": dict(self.reading), "queries": asked, "samples": self.samples}
        try:
            return json.loads(json.dumps(about))
        except (TypeError, ValueError) as error:
            raise BounderError(f"options of a bake must be numbers, texts and lists of them: {error}") from error

    @property
    def digest(self) -> str:
        """A hash of the settings and the library's version."""
        return short_digest(self.to_dict())

    def _own_queries(self) -> np.ndarray | None:
        return None if self.queries is None else np.load(self.queries, allow_pickle=False)


@dataclass(frozen=True)
class FitSettings(Settings):
    """The same method is fitted to each shape."""

    engine = "fit"

    def bounder(self, shape) -> Bounder | DistanceBounder:
        from warp_bounding.training import fit

        return fit(shape, queries=self._own_queries(), progress=False, **self.arguments)

    def check(self, *callers: Callable) -> None:
        from warp_bounding.training import fit
        from warp_bounding.training.checks import check_distance, check_numbers, check_regions
        from warp_bounding.training.distance import check_distance_options

        told, own = _told(fit, self.arguments)
        query, method = told["query"], told["method"]
        check_query(query, DISTANCE.name)
        check_numbers(told["budget"], told["seed"], told["margin"])
        device_of(told["device"])
        if query == DISTANCE.name:
            check_distance(method, told["length"], told["side"], None, self.queries)
            check_distance_options(distance_class(method), own, [fit, *callers])
            return
        check_regions(query, method, told["length"], told["side"])
        names = method.split("+")
        for name in names:
            if name not in METHODS:
                method_class(name)  # says which there are
        settled([METHODS[name] for name in names], query, own, [fit, *callers])


@dataclass(frozen=True)
class ChooseSettings(Settings):
    """The bounder that costs the least is chosen for each shape; its nanoseconds are measured while other workers are busy."""

    engine = "choose"

    def bounder(self, shape) -> Bounder | DistanceBounder | None:
        from warp_bounding.choice import choose

        return choose(shape, queries=self._own_queries(), progress=False, **self.arguments).bounder

    def check(self, *callers: Callable) -> None:
        from warp_bounding.choice import choose
        from warp_bounding.choice.candidates import check_methods, check_networks
        from warp_bounding.choice.choose import check_prices
        from warp_bounding.training.checks import check_numbers

        told, other = _told(choose, self.arguments)
        if other:
            unknown = next(iter(other))
            near = meant(unknown, [name for function in (choose, *callers) for name in arguments_of(function)])
            hint = f"there is no option {unknown!r}; did you mean {near!r}?"
            raise BounderError(hint if near else f"choose takes no option {unknown!r}")
        check_query(told["query"])
        check_numbers(told["budget"], told["seed"], told["margin"])
        prices = ("narrow_ns", "overhead_ns", "memory", "length", "statistical")
        check_prices(told["query"], *(told[name] for name in prices))
        check_methods(told["methods"])
        device_of(told["device"])
        check_networks(told["networks"])


def _told(function, arguments: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The named arguments of a function, as they are given or by default, and those that have no name there."""
    named = {p.name: p.default for p in signature(function).parameters.values() if p.kind != Parameter.VAR_KEYWORD}
    own = {name: value for name, value in arguments.items() if name not in named}
    return named | {name: value for name, value in arguments.items() if name in named}, own


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes; raises ``OSError`` where it cannot be read."""
    sha = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            sha.update(block)
    return sha.hexdigest()
