"""The objects that are measured and shown: those of a data folder as the paper's authors lay it out, and our own.

Our own are drawn by code and stand in where the paper's are not given: grids of 32 cells a side, as the paper's are.
2D: star, fish, crescent; 3D: bunny (the mesh that comes with warp-lang), cup; 4D: the bunny and the cup, turned about
their first axis by a whole turn in ten steps.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper.table import words_of
from warp_bounding import shapes
from warp_bounding.errors import ShapeError
from warp_bounding.shapes import Grid

PATTERNS = {2: "2D/*.png", 3: "3D/*.binvox", 4: "4D/*.npy"}
CELLS, STEPS = 32, 10  # of our own: cells a side, and steps of time
BUNNY_CELLS = 26  # of the bunny's longest side, so that it stays in the domain when it turns
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
    """Every object of these dimensions in a data folder.

    Raises:
        ShapeError: If the folder, or a dimension in it, is missing, or a name cannot be written in a table.
    """
    if not data.is_dir():
        raise ShapeError(f"{data}: no such folder; it must hold {', '.join(PATTERNS.values())}")
    found = []
    for ndim in dict.fromkeys(dimensions):
        own = [Object(ndim, p.stem, p) for p in sorted(data.glob(PATTERNS[ndim])) if p.is_file()]
        if not own:
            raise ShapeError(
                f"{data}: no {PATTERNS[ndim]} there; add the {ndim}D objects, or choose --columns without {ndim}d"
            )
        found += own
    for each in found:
        if not each.name.isprintable() or "|" in each.name:
            raise ShapeError(f"{each.path}: the name of an object must be printable and without '|'")
    return found


def select_objects(objects: Sequence[Object], text: str | None) -> list[Object]:
    """The objects that words name: ``bunny`` in every dimension that has it, ``2d/dragon1`` in one; all for ``None``.

    Raises:
        ShapeError: For a word that names none of them.
    """
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
    """The cells of an object of a data folder, or of our own.

    Raises:
        ShapeError: If it cannot be read, or is of another dimension.
    """
    if thing.path == OWN:
        return own_shape(thing.label)
    grid = shapes.load_shape(thing.path)
    if grid.ndim != thing.ndim:
        raise ShapeError(f"{thing.path}: {grid.ndim}D, expected {thing.ndim}D")
    return grid


# --- our own ----------------------------------------------------------------------------------------------------------

OWN = Path("own")  # stands for a file


def own_objects(dimensions: Iterable[int]) -> list[Object]:
    """Our own objects of these dimensions."""
    return [
        Object(int(label[0]), label[3:], OWN)
        for n in dict.fromkeys(dimensions)
        for label in SHAPES
        if label[0] == str(n)
    ]


@cache
def own_shape(label: str) -> Grid:
    """One of our own; ``ShapeError`` if there is no such shape, or the mesh behind it is not installed."""
    if label not in SHAPES:
        raise ShapeError(f"shape must be one of {', '.join(SHAPES)}, got {label!r}")
    return Grid(SHAPES[label](), name=label.partition("/")[2], time=label.startswith("4d"))


def _centres(ndim: int) -> np.ndarray:
    """``(CELLS, ..., ndim)`` centres of the cells of a unit grid."""
    return np.stack(np.meshgrid(*[np.linspace(0, 1, CELLS)] * ndim, indexing="ij"), axis=-1)


def star(points: np.ndarray) -> np.ndarray:
    """A star with five slim, rounded arms, one of them up."""
    d = np.asarray(points) - (0.5, 0.47)
    angle, radius = np.arctan2(d[..., 0], d[..., 1]), np.hypot(d[..., 0], d[..., 1])
    return radius < 0.13 + 0.34 * np.abs(np.cos(2.5 * angle)) ** 5


def fish(points: np.ndarray, centre=(0.5, 0.5), size: float = 0.9, angle: float = 0.0) -> np.ndarray:
    """A fish that swims to the left, with a forked tail and two fins; ``size`` is its length, ``angle`` in radians."""
    d = (np.asarray(points, dtype=np.float64) - centre) / size
    c, s = np.cos(angle), np.sin(angle)
    x, y = c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0]
    t = np.clip((x + 0.5) / 0.82, 0, 1)
    body = (x > -0.5) & (x < 0.32) & (np.abs(y) < 0.17 * np.sin(np.pi * t**0.75) ** 0.9 + 0.03 * (t > 0.5))
    reach = np.clip((x - 0.22) / 0.28, 0, 1)
    tail = (x > 0.22) & (x < 0.5) & (np.abs(y) < 0.03 + 0.19 * reach**1.2) & (np.abs(y) > 0.34 * (reach - 0.5))
    back = (y > 0) & (y < 0.27 - 0.55 * np.abs(x + 0.02)) & (x > -0.2) & (x < 0.16)
    below = (y < 0) & (y > -0.26 + 1.1 * np.abs(x - 0.02)) & (np.abs(x - 0.02) < 0.12)
    return body | tail | back | below


def _crescent(points: np.ndarray) -> np.ndarray:
    """A disc without a smaller one."""
    d = np.asarray(points) - 0.5
    return (np.hypot(d[..., 0], d[..., 1]) < 0.44) & (np.hypot(d[..., 0] - 0.2, d[..., 1]) > 0.33)


def _cup(points: np.ndarray) -> np.ndarray:
    """A cup with a handle."""
    d = np.asarray(points) - (0.44, 0.5, 0.5)
    r = np.hypot(d[..., 0], d[..., 2])
    wall = (r < 0.28) & (np.abs(d[..., 1]) < 0.32) & ~((r < 0.21) & (d[..., 1] > -0.24))
    handle = (np.hypot(np.hypot(d[..., 0] - 0.27, d[..., 1]) - 0.17, d[..., 2]) < 0.05) & (d[..., 0] > 0.24)
    return wall | handle


def _bunny() -> np.ndarray:
    """The bunny of warp-lang's examples, in the middle of a grid."""
    import warp.examples

    path = Path(warp.examples.get_asset_directory()) / "bunny.usd"
    if not path.is_file():
        raise ShapeError(f"{path}: expected this mesh in the installed warp-lang; no such file")
    cells = shapes.load_shape(path).to_grid(resolution=BUNNY_CELLS).occupancy
    filled = np.zeros((CELLS,) * 3, dtype=bool)
    first = [(CELLS - size) // 2 for size in cells.shape]
    filled[tuple(slice(f, f + size) for f, size in zip(first, cells.shape, strict=True))] = cells
    return filled


def _turning(cells: np.ndarray) -> np.ndarray:
    """``(STEPS, CELLS, ...)``: cells turned about axis 0 by a whole turn, nearest cells."""
    centred = np.stack(np.meshgrid(*[np.arange(CELLS) - (CELLS - 1) / 2] * 3, indexing="ij"), axis=-1)
    frames = []
    for step in range(STEPS):
        c, s = np.cos(2 * np.pi * step / STEPS), np.sin(2 * np.pi * step / STEPS)
        back = np.rint(centred @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) + (CELLS - 1) / 2).astype(int)
        known = ((back >= 0) & (back < CELLS)).all(axis=-1)
        frames.append(cells[tuple(np.moveaxis(np.clip(back, 0, CELLS - 1), -1, 0))] & known)
    return np.stack(frames)


SHAPES: dict[str, Callable[[], np.ndarray]] = {
    "2d/star": lambda: star(_centres(2)),
    "2d/fish": lambda: fish(_centres(2)),
    "2d/crescent": lambda: _crescent(_centres(2)),
    "3d/bunny": _bunny,
    "3d/cup": lambda: _cup(_centres(3)),
    "4d/bunny": lambda: _turning(_bunny()),
    "4d/cup": lambda: _turning(_cup(_centres(3))),
}
