"""The objects of a data folder: ``2D/*.png``, ``3D/*.binvox``, ``4D/*.npy``, as the paper's authors lay them out."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from warp_bounding import indicators
from warp_bounding.errors import IndicatorError

__all__ = ["Shape", "find_shapes", "load_shapes", "select_shapes"]

PATTERNS = {2: "2D/*.png", 3: "3D/*.binvox", 4: "4D/*.npy"}


class Shape(NamedTuple):
    """A file of the data folder."""

    ndim: int
    name: str
    path: Path

    @property
    def label(self) -> str:
        """As the command line takes it, such as ``2d/dragon1``."""
        return f"{self.ndim}d/{self.name}"


def find_shapes(data: Path, dimensions: Iterable[int]) -> list[Shape]:
    """Every object of these dimensions.

    Raises:
        IndicatorError: If the folder, or a dimension in it, is missing, or a name cannot be written in a table.
    """
    if not data.is_dir():
        raise IndicatorError(f"{data}: no such folder; it must hold {', '.join(PATTERNS.values())}")
    shapes = []
    for ndim in dimensions:
        paths = sorted(p for p in data.glob(PATTERNS[ndim]) if p.is_file())
        if not paths:
            raise IndicatorError(
                f"{data}: no {PATTERNS[ndim]} there; add the {ndim}D objects, or choose --columns without {ndim}d"
            )
        shapes += [Shape(ndim, p.stem, p) for p in paths]
    for shape in shapes:
        if not shape.name.isprintable() or "|" in shape.name:
            raise IndicatorError(f"{shape.path}: the name of an object must be printable and without '|'")
    return shapes


def select_shapes(shapes: Sequence[Shape], words: Sequence[str] | None) -> list[Shape]:
    """The objects that words name: ``bunny`` in every dimension that has it, ``2d/dragon1`` in one; all for ``None``.

    Raises:
        IndicatorError: For a word that names none of them.
    """
    if words is None:
        return list(shapes)
    chosen = []
    for word in words:
        dimension, slash, name = word.rpartition("/")
        found = [s for s in shapes if s.name == name and (not slash or f"{s.ndim}d" == dimension.lower())]
        if not found:
            names = ", ".join(s.label for s in shapes)
            raise IndicatorError(f"objects must be among {names} (for the chosen columns), got {word!r}")
        chosen += [s for s in found if s not in chosen]
    return chosen


def load_shapes(shapes: Iterable[Shape]) -> dict[Shape, Any]:
    """Read objects.

    Returns:
        Grids, by object.

    Raises:
        IndicatorError: If one cannot be read, or is of another dimension.
    """
    grids = {shape: indicators.load_indicator(shape.path) for shape in shapes}
    for shape, grid in grids.items():
        if grid.ndim != shape.ndim:
            raise IndicatorError(f"{shape.path}: {grid.ndim}D, expected {shape.ndim}D")
    return grids
