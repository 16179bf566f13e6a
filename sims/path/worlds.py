"""Worlds to plan in: two generated ones, and whatever image, array or map a user has.

The generated worlds are always the same, so that bounders of them can come with the demo: ``rooms``, a building with
furniture in an open yard, and ``maze``, a maze with a few loops. Neither can be bounded well by anything convex.

What this does not do: worlds in 3D, or robots that are more than a point.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import warp_bounding as wb
from sims.path.moving_ai import read_map, read_scen, scen_beside
from sims.planning.planner import Place

__all__ = ["World", "generated", "maze", "problems_of", "random_states", "rooms", "worlds_at"]

READABLE = (".map", ".png", ".npy", ".npz")
YARD, WALL, DOOR = 6, 2, 5  # cells: around the building; thickness; width
SMALLEST_ROOM = 13  # cells; larger ones are divided
LANE, HEDGE, LANES = 6, 2, 8  # cells and a number: the maze
LOOPS = 6  # openings of the maze beyond those of a tree


@dataclass(frozen=True)
class World(Place):
    """A named 2D world.

    Attributes:
        name: For people.
        grid: Its cells; obstacles are occupied.
        scene: Name under which its bounders lie.
        fitted: Whether they come with the demo.
        problems: ``(P, 2, 2)`` float32, start and goal, object space; ``None`` where they are to be drawn at random.
    """

    name: str
    grid: wb.shapes.Grid
    scene: str
    fitted: bool = False
    problems: np.ndarray | None = None

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return random_states(self.grid, count, rng)

    def problems_of(self, count: int, seed: int) -> np.ndarray:
        return problems_of(self, count, seed)

    def measured(self, x: np.ndarray) -> np.ndarray:
        """In cells."""
        return self.grid.cell_coordinate(x)


def generated() -> list[World]:
    """The worlds that the demo brings."""
    return [World(make.__name__, make(), f"path-{make.__name__}", fitted=True) for make in (rooms, maze)]


def rooms(cells: int = 64, seed: int = 5) -> wb.shapes.Grid:
    """A building of rooms with doors, columns and furniture, in an open yard.

    Args:
        cells: A side.
        seed: Of walls, doors and furniture.
    """
    rng = np.random.default_rng(seed)
    occupied = np.zeros((cells, cells), dtype=bool)
    low, high = YARD, cells - YARD
    occupied[low:high, low:high] = True
    occupied[low + WALL : high - WALL, low + WALL : high - WALL] = False
    inside: list[tuple[int, int, int, int]] = []
    _divide(occupied, (low + WALL, high - WALL, low + WALL, high - WALL), inside, rng)
    for side in range(4):  # a way out on each side
        at = int(rng.integers(low + WALL + 2, high - WALL - DOOR - 2))
        wall = slice(low, low + WALL) if side < 2 else slice(high - WALL, high)
        _open(occupied, wall, slice(at, at + DOOR), rows=side % 2 == 0)
    for top, bottom, left, right in inside:
        row, column = rng.uniform((top + 4, left + 4), (max(top + 5, bottom - 4), max(left + 5, right - 4)))
        _disc(occupied, row, column, rng.uniform(1.2, 2.2))
    return wb.shapes.Grid(occupied, name="rooms")


def _divide(occupied: np.ndarray, room: tuple[int, int, int, int], inside: list, rng: np.random.Generator) -> None:
    """Divide a room by a wall with one door, and its halves again, until they are small."""
    top, bottom, left, right = room
    tall = bottom - top >= right - left
    first, last = (top, bottom) if tall else (left, right)
    if last - first < 2 * SMALLEST_ROOM - 4:
        inside.append(room)
        return
    wall = int(rng.integers(first + SMALLEST_ROOM - 4, last - SMALLEST_ROOM + 4 - WALL))
    across = (left, right) if tall else (top, bottom)
    door = int(rng.integers(across[0] + 1, across[1] - DOOR))
    _fill(occupied, slice(wall, wall + WALL), slice(*across), rows=tall, value=True)
    _open(occupied, slice(wall, wall + WALL), slice(door, door + DOOR), rows=tall)
    halves = ((first, wall), (wall + WALL, last))
    for half in halves:
        _divide(occupied, (*half, left, right) if tall else (top, bottom, *half), inside, rng)


def _fill(occupied: np.ndarray, along: slice, across: slice, *, rows: bool, value: bool) -> None:
    occupied[(along, across) if rows else (across, along)] = value


def _open(occupied: np.ndarray, wall: slice, door: slice, *, rows: bool) -> None:
    """A door, and the floor before and behind it: no other wall may end in a doorway."""
    free = slice(wall.start - WALL, wall.stop + WALL)
    _fill(occupied, free, door, rows=rows, value=False)


def _disc(occupied: np.ndarray, row: float, column: float, radius: float) -> None:
    rows, columns = np.ogrid[: occupied.shape[0], : occupied.shape[1]]
    occupied |= (rows - row) ** 2 + (columns - column) ** 2 <= radius**2


def maze(lanes: int = LANES, seed: int = 3) -> wb.shapes.Grid:
    """A maze, by a random walk that goes back where it is stuck, and a few more openings.

    Args:
        lanes: Along a side.
        seed: Of the walk.
    """
    rng, pitch = np.random.default_rng(seed), LANE + HEDGE
    occupied = np.ones((lanes * pitch + HEDGE,) * 2, dtype=bool)
    seen, way = {(0, 0)}, [(0, 0)]
    _carve(occupied, (0, 0), (0, 0))
    while way:
        here = way[-1]
        ahead = [there for there in _next(here, lanes) if there not in seen]
        if not ahead:
            way.pop()
            continue
        there = ahead[int(rng.integers(len(ahead)))]
        _carve(occupied, here, there)
        seen.add(there)
        way.append(there)
    for _ in range(LOOPS):
        here = tuple(int(v) for v in rng.integers(0, lanes, 2))
        _carve(occupied, here, _next(here, lanes)[0])
    return wb.shapes.Grid(occupied, name="maze")


def _next(here: tuple[int, int], lanes: int) -> list[tuple[int, int]]:
    around = ((here[0] + r, here[1] + c) for r, c in ((0, 1), (1, 0), (0, -1), (-1, 0)))
    return [(r, c) for r, c in around if 0 <= r < lanes and 0 <= c < lanes]


def _carve(occupied: np.ndarray, here: tuple[int, int], there: tuple[int, int]) -> None:
    """Free two neighbouring places of the maze and the way between them."""
    pitch = LANE + HEDGE
    low = [HEDGE + pitch * min(pair) for pair in zip(here, there, strict=True)]
    high = [HEDGE + pitch * max(pair) + LANE for pair in zip(here, there, strict=True)]
    occupied[low[0] : high[0], low[1] : high[1]] = False


def worlds_at(path: str | Path) -> list[World]:
    """The worlds that a user names.

    Args:
        path: An image or array file of 2 dimensions (as ``warp_bounding.load_shape`` takes it), a ``.map`` file, or
            a folder of such. A map's problems come from the ``.scen`` file beside it, if there is one.

    Raises:
        ShapeError: If there is nothing, or something that is no 2D world.
    """
    path = Path(path)
    if not path.is_dir():
        return [_world(path)]
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in READABLE and file.is_file())
    if not files:
        raise wb.ShapeError(f"{path}: expected a folder with {' '.join(READABLE)} files, got none")
    return [_world(file) for file in files]


def _world(path: Path) -> World:
    problems = None
    if path.exists() and path.suffix.lower() not in READABLE:
        got = repr(path.suffix) if path.suffix else "no extension"
        raise wb.ShapeError(f"{path}: expected a world, one of {' '.join(READABLE)}, got {got}")
    if path.suffix.lower() == ".map":
        grid = read_map(path)
        scenario = scen_beside(path)
        problems = None if scenario is None else read_scen(scenario, grid)
    else:
        grid = wb.load_shape(path)
    if grid.ndim != 2 or grid.time:
        raise wb.ShapeError(f"{path}: expected a 2D world, got {grid.ndim} dimensions")
    name = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in path.stem)
    return World(path.name, grid, f"path-{name}-{grid.digest[:8]}", problems=problems)


def problems_of(world: World, count: int, seed: int) -> np.ndarray:
    """Problems to solve: from the world's own list, evenly chosen, or between random free states.

    Args:
        world: Where.
        count: At most so many.
        seed: Of random ones.

    Returns:
        ``(P, 2, 2)`` float32: start and goal, object space.
    """
    if world.problems is not None:
        chosen = np.unique(np.linspace(0, len(world.problems) - 1, min(count, len(world.problems))).round().astype(int))
        return world.problems[chosen]
    rng, free = np.random.default_rng([seed, 1]), np.zeros((0, 2), dtype=np.float32)
    while len(free) < 2 * count:  # there is an empty cell in every grid
        x = random_states(world.grid, 4 * count, rng)
        free = np.concatenate([free, x[~world.grid.contains(x)]])
    return free[: 2 * count].reshape(count, 2, 2)


def random_states(grid: wb.shapes.Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, 2)`` float32, uniform in the world's domain, obstacles and all."""
    x = (grid.lower + rng.random((count, 2)) * (grid.upper - grid.lower)).astype(np.float32)
    inside = np.nextafter(grid.lower.astype(np.float32), np.float32(np.inf))
    return np.clip(x, inside, np.nextafter(grid.upper.astype(np.float32), np.float32(-np.inf)))
