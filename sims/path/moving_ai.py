"""Readers of Moving AI's ``.map`` and ``.scen`` files (Sturtevant 2012, "Benchmarks for grid-based pathfinding").

A map is a grid of characters: ``.``, ``G`` and ``S`` (ground, swamp) are free; ``@``, ``O``, ``T``, ``W`` (out of
bounds, trees, water) are obstacles. A scenario lists problems, from the centre of one cell to that of another. Both
readers are strict: whatever is not as the format says is refused in one line.

Coordinate 0 is the row, as in images. Cells are squares: the longer side spans [0, 1] between the centres of its first
and last cells.
"""

from pathlib import Path

import numpy as np

import warp_bounding as wb

__all__ = ["read_map", "read_scen", "scen_beside"]

FREE, BLOCKED = ".GS", "@OTW"
MOST_CELLS = 4096  # a side: up to here a grid tells exactly which points are in a cell
FIELDS = 9  # of a line of a scenario


def read_map(path: Path) -> wb.shapes.Grid:
    """The cells of a ``.map`` file.

    Raises:
        ShapeError: For anything that is not as the format says.
    """
    lines = _lines(path)
    while lines and not lines[-1]:
        lines.pop()
    if not lines or lines[0].split() != ["type", "octile"]:
        raise wb.ShapeError(f"{path}: line 1: expected 'type octile', got {_shown(lines, 0)}")
    height, width = (_size(path, lines, number, word) for number, word in ((1, "height"), (2, "width")))
    if len(lines) < 4 or lines[3].strip() != "map":
        raise wb.ShapeError(f"{path}: line 4: expected 'map', got {_shown(lines, 3)}")
    rows = lines[4:]
    if len(rows) != height:
        raise wb.ShapeError(f"{path}: expected {height} rows, got {len(rows)}")
    for number, row in enumerate(rows, start=5):
        if len(row) != width:
            raise wb.ShapeError(f"{path}: line {number}: expected {width} cells, got {len(row)}")
        unknown = set(row) - set(FREE + BLOCKED)
        if unknown:
            raise wb.ShapeError(f"{path}: line {number}: expected cells of {FREE}{BLOCKED}, got {min(unknown)!r}")
    occupancy = np.array([[cell in BLOCKED for cell in row] for row in rows])
    scale = np.full(2, max(height, width, 2) - 1.0)
    return wb.shapes.Grid(occupancy, cells_per_unit=scale, offset=np.zeros(2), name=path.name)


def scen_beside(path: Path) -> Path | None:
    """The scenario of a map: ``x.map.scen`` or ``x.scen`` in its folder, or ``None``."""
    choices = (path.with_name(path.name + ".scen"), path.with_suffix(".scen"))
    return next((choice for choice in choices if choice.is_file()), None)


def read_scen(path: Path, grid: wb.shapes.Grid) -> np.ndarray:
    """The problems of a ``.scen`` file.

    Args:
        path: The file.
        grid: Its map; the name of the map in the file is not looked at, but its size is.

    Returns:
        ``(P, 2, 2)`` float32: start and goal, object space.

    Raises:
        ShapeError: For anything that is not as the format says, or a problem of a map of another size.
    """
    lines = _lines(path)
    head = lines[0].split() if lines else []
    if len(head) != 2 or head[0] != "version" or head[1] not in ("1", "1.0"):
        raise wb.ShapeError(f"{path}: line 1: expected 'version 1', got {_shown(lines, 0)}")
    cells = []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        fields = line.split("\t") if "\t" in line else line.split()
        if len(fields) != FIELDS:
            raise wb.ShapeError(f"{path}: line {number}: expected {FIELDS} fields, got {len(fields)}")
        try:
            _, (width, height, x0, y0, x1, y1) = int(fields[0]), map(int, fields[2:8])
            optimal = float(fields[8])
        except ValueError as error:
            raise wb.ShapeError(f"{path}: line {number}: expected numbers, got {line.strip()!r}") from error
        if (height, width) != grid.shape:
            size = f"{grid.shape[1]} x {grid.shape[0]}"
            raise wb.ShapeError(f"{path}: line {number}: expected a map of {size} cells, got {width} x {height}")
        if not (min(x0, x1) >= 0 and max(x0, x1) < width and min(y0, y1) >= 0 and max(y0, y1) < height):
            raise wb.ShapeError(f"{path}: line {number}: expected cells of the map, got {(x0, y0)} to {(x1, y1)}")
        if not 0 <= optimal < np.inf:
            raise wb.ShapeError(f"{path}: line {number}: expected a length, got {fields[8].strip()!r}")
        cells.append(((y0, x0), (y1, x1)))
    if not cells:
        raise wb.ShapeError(f"{path}: expected at least one problem, got none")
    return grid.position(np.array(cells, dtype=np.float64)).astype(np.float32)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except UnicodeDecodeError as error:
        raise wb.ShapeError(f"{path}: expected plain text, got other bytes") from error
    except OSError as error:
        raise wb.ShapeError(f"{path}: cannot be read: {error.strerror}") from error


def _shown(lines: list[str], number: int) -> str:
    return repr(lines[number][:40]) if number < len(lines) else "the end of the file"


def _size(path: Path, lines: list[str], number: int, word: str) -> int:
    fields = lines[number].split() if number < len(lines) else []
    digits = fields[1] if len(fields) == 2 and fields[0] == word else ""
    if not (digits.isdecimal() and 1 <= int(digits) <= MOST_CELLS):
        expected = f"'{word}' and a number from 1 to {MOST_CELLS}"
        raise wb.ShapeError(f"{path}: line {number + 1}: expected {expected}, got {_shown(lines, number)}")
    return int(digits)
