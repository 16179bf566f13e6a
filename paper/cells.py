"""A cell of the paper's tables: a method, a kind of query, an object; and how the bounder of one is fitted."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from paper.data import Object, grid_of, objects_in, select_objects
from paper.results import Folder, finished, say
from paper.table import DISTANCE, SPACES, VARIANTS, Column, Variant, budget_of, select_columns, select_methods
from sims.versions import versions
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.bounder import taken
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.runtime.launch import cpu_threads

DIGEST = 16  # characters of the SHA-256 of an object's cells
IDENTITY = ("dimension", "object", "query", "method", "space", "leaves")  # columns of a row that say whose it is


class Cell(NamedTuple):
    """A bounder of a method, for a kind of query, of an object."""

    thing: Object
    column: Column
    variant: Variant

    @property
    def file(self) -> str:
        """Name of its bounder's file; all kinds of query share a distance."""
        column = f"{self.column.ndim}d" if self.variant.method == DISTANCE else self.column.name
        return f"{column}.{self.thing.name}.{self.variant.name}"

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.column.name} {self.thing.name}: {self.variant.label}"

    @property
    def grid(self) -> Any:
        """Its object, as read."""
        return grid_of(self.thing)

    @property
    def identity(self) -> tuple:
        """The values of ``IDENTITY``."""
        space = self.variant.space_in(self.column)
        return self.column.ndim, self.thing.name, self.column.query, self.variant.method, space, self.variant.leaves


def select(source: str | Callable[[list[int]], list[Object]], columns: str | None, methods: str | None,
           objects: str | None, among: Sequence[Variant] = VARIANTS) -> list[Cell]:  # fmt: skip
    """The cells that words of a command line name, of a data folder or of a function of dimensions.

    The first object of every column comes first, and of these what is cheap: all columns show something soon, and what
    an interrupted run shows is the same objects for every method.
    """
    wanted, variants = select_columns(columns), select_methods(methods, among)
    dimensions = list(dict.fromkeys(c.ndim for c in wanted))
    found = objects_in(Path(source), dimensions) if isinstance(source, str) else source(dimensions)
    found = select_objects(found, objects)
    cells = [Cell(o, c, v) for c in wanted for v in variants if v.space_in(c) for o in found if o.ndim == c.ndim]
    if not cells:
        names, queries = (", ".join(dict.fromkeys(each.name for each in own)) for own in (variants, wanted))
        raise BounderError(f"nothing to measure: {names} cannot bound {queries} of these objects")
    for thing in dict.fromkeys(cell.thing for cell in cells):
        grid_of(thing)
    rank = {o: [other for other in found if other.ndim == o.ndim].index(o) for o in found}
    return sorted(cells, key=lambda cell: (rank[cell.thing], cell.variant.learned))


def missing(cells: Iterable[Cell], folder: Folder, column: str = "", kinds: Sequence[str] = ("",)) -> list:
    """What a folder lacks: pairs of a cell and the kind of row (protocol, device, ...), a column of the CSV."""
    there = set()
    for row in folder.rows:
        identity = (row.get(name, SPACES[0] if name == "space" else None) for name in IDENTITY)
        there.add((tuple(identity), row.get(column, "")))
    return [(cell, kind) for cell in cells for kind in kinds if (cell.identity, kind) not in there]


def about(cell: Cell, bounder: Any, settings: dict[str, Any]) -> dict[str, Any]:
    """The columns that several files have: whose row it is, and what it was made with."""
    certificate, seconds = bounder.certificate, None if bounder.certificate is None else bounder.certificate.seconds
    spent = (getattr(bounder, "info", None) or {}).get("training") or {}
    return {
        **dict(zip(IDENTITY, cell.identity, strict=True)),
        "certificate": certificate.kind if certificate else "",
        "fit_seconds": round(spent["seconds"], 3) if "seconds" in spent else None,
        "proof_seconds": None if seconds is None else round(float(seconds), 3),
        "nbytes": int(bounder.nbytes),
        "hidden": "-".join(map(str, cell.column.hidden)),
        "threads": cpu_threads(),
        "indicator": cell.grid.digest[:DIGEST],
        "versions": versions(),
        "budget": budget_of(settings, cell.column, cell.variant) if "budget" in settings else None,
        **{key: value for key, value in settings.items() if key not in ("budget", "budgets", "hidden", "library")},
    }


def load(path: Path, cell: Cell, settings: dict[str, Any]) -> Any | None:
    """The bounder that an earlier run kept. ``None``, with a message, if the file is damaged or another cell's."""
    from warp_bounding.bounders import load

    if not path.exists():
        return None
    try:
        bounder = load(path, device=settings.get("device", "cpu"))
    except BoundingError as error:
        say(f"{error}; fitted again")
        return None
    grid = replace(cell.grid, time=False) if bounder.of_distances else cell.grid  # time is one more coordinate
    if (bounder.info.get("indicator"), bounder.info.get("seed")) == (grid.digest, settings["seed"]):
        return bounder
    say(f"{path}: fitted to another object or with another seed; fitted again")
    return None


def fitted(folder: Folder, cell: Cell, settings: dict[str, Any]) -> Any:
    """The bounder of a cell: an earlier run's, or fitted and stored."""
    path, variant, query = folder.bounder(cell.file), cell.variant, cell.column.kind
    if (bounder := load(path, cell, settings)) is not None:
        return bounder
    from warp_bounding.bounders import save
    from warp_bounding.training import fit

    device, grid = settings.get("device", "cpu"), cell.grid
    reported = {"hidden": cell.column.hidden, "activation": settings.get("activation"), "leaves": variant.leaves}
    if variant.method == DISTANCE:
        known, grid = [option.name for option in MlpDistance.options], replace(grid, time=False)
        options = {"query": "distance", "method": MlpDistance.method}
    else:
        known = taken((METHODS[name] for name in variant.method.split("+")), query.name)
        options = {"query": query.name, "method": variant.method}
        options |= {"length": settings["length"]} if query.has_length else {}
    options |= {name: value for name, value in reported.items() if name in known and value is not None}
    options |= {"budget": budget_of(settings, cell.column, variant), "seed": settings["seed"], "device": device}
    bounder = finished(fit(grid, **options))
    path.parent.mkdir(exist_ok=True)
    save(bounder, path)
    return bounder
