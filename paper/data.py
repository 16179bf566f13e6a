"""The objects that are measured and shown: those of a data folder, as the paper's authors lay it out."""

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from paper.table import words_of
from warp_bounding import shapes
from warp_bounding.errors import ShapeError

PATTERNS = {2: "2D/*.png", 3: "3D/*.binvox", 4: "4D/*.npy"}
USUAL = "bunny"  # what is raced where nothing is named


class Object(NamedTuple):
    """An object of a dimension by its name; with the file of a data folder."""

    ndim: int
    name: str
    path: Path

    @property
    def label(self) -> str:
        """As the command line takes it, such as ``2d/dragon1``."""
        return f"{self.ndim}d/{self.name}"


def objects_in(data: Path, dimensions: Iterable[int]) -> list[Object]:
    """Every object of these dimensions in a data folder; ``ShapeError`` if that, or a dimension in it, is missing."""
    if not data.is_dir():
        raise ShapeError(f"{data}: no such folder; it must hold {', '.join(PATTERNS.values())}")
    found = []
    for ndim in dict.fromkeys(dimensions):
        own = [Object(ndim, p.stem, p) for p in sorted(data.glob(PATTERNS[ndim])) if p.is_file()]
        if not own:
            cure = f"add the {ndim}D objects, or choose --columns without {ndim}d"
            raise ShapeError(f"{data}: no {PATTERNS[ndim]} there; {cure}")
        found += own
    return found


def select_objects(objects: Sequence[Object], text: str | None) -> list[Object]:
    """The objects that words name: ``bunny`` in every dimension that has it, ``2d/dragon1`` in one; all for none."""
    if text is None:
        return list(objects)
    chosen: dict[Object, None] = {}
    for word in words_of(text):
        dimension, slash, name = word.rpartition("/")
        found = [o for o in objects if o.name == name and (not slash or f"{o.ndim}d" == dimension.lower())]
        if not found:
            names = ", ".join(o.label for o in objects)
            raise ShapeError(f"objects must be among {names} (for the chosen columns), got {word!r}")
        chosen |= dict.fromkeys(found)
    return list(chosen)


def usual(objects: Sequence[Object]) -> list[Object]:
    """One object of each dimension: the default one, or the first if that is missing."""
    own = [[o for o in objects if o.ndim == ndim] for ndim in dict.fromkeys(o.ndim for o in objects)]
    return [next((o for o in group if o.name == USUAL), group[0]) for group in own]


@cache
def grid_of(thing: Object) -> Any:
    """The cells of an object; ``ShapeError`` if it cannot be read, or is of another dimension."""
    grid = shapes.load_shape(thing.path)
    if grid.ndim != thing.ndim:
        raise ShapeError(f"{thing.path}: {grid.ndim}D, expected {thing.ndim}D")
    return grid
