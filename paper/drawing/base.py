"""The protocol of a figure, and what it is given to compute and draw with."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from paper.drawing.masks import packed
from paper.drawing.settings import PAPER, FigureSettings
from paper.drawing.shapes import own_shape
from paper.shapes import PATTERNS, Shape, load_shapes
from warp_bounding.errors import IndicatorError

__all__ = ["Figure", "Object", "Tools", "Work", "objects_named"]

Parts = Mapping[str, dict[str, Any]]

# Which way is up, for pictures: our own shapes have y up, the paper's z, but for these.
OWN_UP, PAPER_UP = (0, 1, 0), (0, 0, 1)
OTHER_UPS = {"3d/armchair": (0, -1, 0), "3d/car": (0, -1, 0), "3d/sofa": (0, -1, 0), "3d/teddy": (0, 1, 0)}


class Object(NamedTuple):
    """What a figure shows: an object of the paper's data, and what stands in for it where that is not given."""

    label: str  # such as ``2d/star1``
    own: str | None = None  # a name in ``shapes``; ``None``: there is no such stand-in


def objects_named(text: str) -> tuple[Object, ...]:
    """Objects from words such as ``2d/star1=star``: the paper's, and our own in its place."""
    pairs = (word.partition("=") for word in text.split())
    return tuple(Object(label, own or None) for label, _, own in pairs)


@dataclass(frozen=True)
class Tools:
    """What draws and runs outside this package; the command line brings it along.

    Attributes:
        draw_solids: Called with a list of scenes (``solids``): returns a PNG of each, or raises ``BoundingError`` where
            there is nothing to draw with.
        run_demo: Called with a demo's name, a folder, and whether in its quick form: returns the demo's JSON.
    """

    draw_solids: Callable[[list[dict[str, Any]]], list[bytes]]
    run_demo: Callable[[str, Path, bool], dict[str, Any]]


@dataclass
class Work:
    """What parts are computed with.

    Attributes:
        settings: Of the folder.
        data: The data folder, if one was given.
        tools: For what lies outside the package.
        note: Called with what is going on.
        heed: Called after each fit; ends the run if it was interrupted.
        used: Digests of the objects that were read, by label.
    """

    settings: FigureSettings
    data: Path | None
    tools: Tools
    note: Callable[[str], None] = lambda text: None
    heed: Callable[[], None] = lambda: None
    used: dict[str, str] = field(default_factory=dict)
    _shapes: dict[str, Any] = field(default_factory=dict)

    def choose(self, full: Any, quick: Any) -> Any:
        """One of two values, by whether small forms are wanted."""
        return quick if self.settings.quick else full

    def missing(self, thing: Object) -> str | None:
        """The file or the stand-in that an object lacks; ``None`` if it is there."""
        if self.settings.objects != PAPER:
            return None if thing.own else thing.label
        return None if self.data is not None and _file(self.data, thing.label).is_file() else thing.label

    def shape(self, thing: Object):
        """An object's cells.

        Raises:
            IndicatorError: If it is missing or cannot be read.
        """
        if thing.label not in self._shapes:
            if absent := self.missing(thing):
                raise IndicatorError(f"{absent} of the paper's data is missing")
            ndim, name = int(thing.label[0]), thing.label.partition("/")[2]
            if self.settings.objects == PAPER:
                shape = Shape(ndim, name, _file(self.data, thing.label))
                self._shapes[thing.label] = load_shapes([shape])[shape]
            else:
                self._shapes[thing.label] = own_shape(thing.own)
        found = self._shapes[thing.label]
        self.used[thing.label] = found.digest
        return found

    def up(self, thing: Object) -> list[int]:
        """The direction that is up in pictures of an object in space."""
        return list(OTHER_UPS.get(thing.label, PAPER_UP) if self.settings.objects == PAPER else OWN_UP)

    def fit(self, shape, seconds: float, query: str = "point", **options):
        """``warp_bounding.fit`` with the folder's seed and effort; this imports torch."""
        from warp_bounding.training import fit

        about = {"query": query, "budget": seconds * self.settings.effort, "seed": self.settings.seed}
        bounder = fit(shape, device="cpu", progress=self.tell, **about, **options)
        self.heed()
        return bounder

    def measured(self, shape, seconds: float, points: np.ndarray | None = None, **options) -> dict[str, Any]:
        """``rates`` of a ``fit`` with these options; with points, what it answers there, packed, as ``"maybe"``."""
        bounder = self.fit(shape, seconds, **options)
        found = self.rates(bounder, shape)
        return found if points is None else found | {"maybe": packed(bounder, points)}

    def tell(self, done: float, total: float = 1.0, text: str = "") -> None:
        """What a fit takes as ``progress``."""
        self.note(text)

    def rates(self, bounder, shape) -> dict[str, Any]:
        """False positives, in per cent of random queries, false negatives, a count, and what the bounder is."""
        from warp_bounding.evaluation import evaluate

        found = evaluate(bounder, shape, self.settings.samples, seed=self.settings.seed + 1)
        self.heed()
        return {
            "fp": round(float(found.fp_rate), 4),
            "fn": int(found.fn),
            "positives": round(float(found.positives), 4),
            "samples": int(found.samples),
            "certificate": bounder.certificate.kind if bounder.certificate else "",
            "nbytes": int(bounder.nbytes),
            "numbers": int(sum(np.size(t) for t in bounder.tensors.values())),
        }


def _file(data: Path, label: str) -> Path:
    """Where an object's file lies in the data folder."""
    ndim, name = int(label[0]), label.partition("/")[2]
    return data / PATTERNS[ndim].replace("*", name)


class Figure(ABC):
    """One figure: what it needs, what it computes, part by part, and how it is drawn from that.

    Attributes:
        name: As the command line takes it, and its files are called.
        title: Its heading.
        caption: A paragraph below it: what is seen.
        paper: What of the paper this is, in words: its numbers of figures differ between text and supplement.
        objects: Which objects of the paper's data it shows.
        few: How many of them in the quick form; ``None`` for all.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    caption: ClassVar[str]
    paper: ClassVar[str]
    objects: ClassVar[tuple[Object, ...]] = ()
    few: ClassVar[int | None] = None

    def wanted(self, settings: FigureSettings) -> tuple[Object, ...]:
        """The objects that it shows under these settings: those with a stand-in, where the paper's are not shown."""
        own = tuple(thing for thing in self.objects if thing.own)
        found = self.objects if settings.objects == PAPER or not own else own
        return found[: self.few] if settings.quick else found

    @abstractmethod
    def parts(self, work: Work) -> dict[str, Callable[[], dict[str, Any]]]:
        """What is computed, by name, in this order: functions that return JSON. Each is kept once it is done.

        They are made anew in every run, quickly, and called only where their results are missing.
        """

    @abstractmethod
    def draw(self, parts: Parts, tools: Tools) -> dict[str, bytes]:
        """The pictures, by file ending (``png``, ``svg``), from what the parts returned.

        Raises:
            BoundingError: If there is nothing to draw with.
        """

    def facts(self, parts: Parts) -> list[str]:
        """Sentences with what was measured, for the page."""
        return []

    def broken(self, parts: Parts) -> list[str]:
        """Parts that break a promise: a bounder with a certificate and false negatives."""
        return [
            f"{name}: {part['fn']:,} false negatives"
            for name, part in parts.items()
            if part.get("certificate") and part.get("fn")
        ]
