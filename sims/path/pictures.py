"""Pictures of planning: left the proven network's path; right the unproven one's, and where it collides.

Runs are those of ``planner``. After the top of Fig. 9 of *Neural Bounding* (Liu et al. 2024). Drawn with matplotlib,
without a display.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np

import warp_bounding as wb
from sims.base import Example
from sims.drawing import INK, heading, save_figure

__all__ = ["draw", "draw_one", "worst_path"]

STONE, ROADMAP = "#c9bfb2", "#9fb4c4"
PROVEN, UNPROVEN, COLLISION = "#1f6fb4", "#e08a00", "#d1242f"
WIDTH = 5.2  # of a world, inches
ASPECTS = (0.3, 2.5)  # least and largest height of a world over its width
DPI, COLOURS = 110, 160  # dots an inch; of the picture's palette
RESOLUTION = 700  # of outlines, along a side
SAMPLES = 400  # of a path's edge, where it is asked for the part that collides: for drawing only
MOST_WORLDS = 3
CLOSE_UP = 0.05  # of the world, half a side
INSET = 0.27  # of a picture, a side


def draw(
    folder: Path,
    pairs: list[tuple[Example, Example]],
    bounders: list[tuple[wb.Bounder, wb.Bounder]],
    names: tuple[str, str],
) -> Path:
    """``path.png``: a row per world, the proven run on the left and the other one on the right.

    Args:
        folder: Made if there is none.
        pairs: Per world the two runs, finished.
        bounders: Per world the two bounders of points that they asked.
        names: Of the two broad phases.

    Returns:
        The file.
    """
    rows = min(len(pairs), MOST_WORLDS)
    figure, axes = _canvas([pair[0].world.grid.shape for pair in pairs[:rows]], 2)
    for row, (pair, both) in enumerate(zip(pairs[:rows], bounders, strict=False)):
        problem = worst_path(pair[1], pair[0])
        for column, (example, bounder) in enumerate(zip(pair, both, strict=True)):
            ax, colour = axes[row][column], (PROVEN, UNPROVEN)[column]
            _world(ax, example)
            _outline(ax, example, bounder, colour)
            _path(ax, example, problem, colour)
            collided, solved = int(example.collisions().sum()), example.solved
            heading(ax, names[column], f"{example.world.name}: {collided} of {solved} paths collide")
            if problem is not None and column == 1 and collided:
                _close_up(ax, example, bounder, problem)
    _legend(figure, names)
    return save_figure(figure, Path(folder) / "path.png", DPI, COLOURS)


def draw_one(example: Example, folder: Path) -> Path:
    """``path-NAME.png``: one run's world, roadmap and its longest path.

    Returns:
        The file.
    """
    figure, axes = _canvas([example.world.grid.shape], 1)
    ax = axes[0][0]
    _world(ax, example)
    solved = np.flatnonzero(np.isfinite(example.lengths))
    _path(ax, example, solved[np.argmax(example.lengths[solved])] if len(solved) else None, PROVEN)
    heading(ax, example.world.name, f"{example.solved} of {len(example.problems)} problems solved")
    return save_figure(figure, Path(folder) / f"{example.world.scene}.png", DPI, COLOURS)


def worst_path(example: Example, other: Example) -> int | None:
    """The problem, solved in both runs, whose first path is longest in obstacles, or longest without any."""
    both = np.flatnonzero(np.isfinite(example.lengths) & np.isfinite(other.lengths))
    if not len(both):
        return None
    collided = both[example.collisions()[both]]
    if not len(collided):
        return int(both[np.argmax(example.lengths[both])])
    through = [
        sum(np.linalg.norm(np.diff(part, axis=0), axis=1).sum() for part in _inside(example, p)) for p in collided
    ]
    return int(collided[np.argmax(through)])


def _inside(example: Example, problem: int) -> list[np.ndarray]:
    """The parts of a path in obstacles, in cells, as polylines of samples."""
    path, grid = example.paths[problem].astype(np.float64), example.world.grid
    t = np.linspace(0.0, 1.0, SAMPLES, endpoint=False)[:, None]
    x = np.concatenate([a + t * (b - a) for a, b in pairwise(path)])
    hit = np.concatenate([[False], grid.contains(x), [False]])
    first, last = np.flatnonzero(hit[1:] & ~hit[:-1]), np.flatnonzero(hit[:-1] & ~hit[1:])
    return [grid.cell_coordinate(x[i:j]) for i, j in zip(first, last, strict=True)]


def _canvas(shapes: list[tuple[int, int]], columns: int):
    """A figure with a row per world, as high as the world is."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    heights = [WIDTH * min(max(rows / across, ASPECTS[0]), ASPECTS[1]) for rows, across in shapes]
    size = (WIDTH * columns, sum(heights) + 0.15 * len(shapes) + 0.5)
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(len(shapes), columns, squeeze=False, height_ratios=heights)


def _world(ax, example: Example) -> None:
    """Obstacles and, lightly, the roadmap; in cells, rows downwards."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap

    grid = example.world.grid
    ax.imshow(grid.occupancy, cmap=ListedColormap(["white", STONE]), interpolation="nearest", zorder=0)
    ax.set_autoscale_on(False)
    edges = grid.cell_coordinate(example.nodes)[example.roadmap][..., ::-1]
    ax.add_collection(LineCollection(edges, colors=ROADMAP, linewidths=0.25, alpha=0.45, zorder=1))
    ax.set_xticks([])
    ax.set_yticks([])
    for side in ax.spines.values():
        side.set_color(INK)


def _outline(ax, example: Example, bounder: wb.Bounder, colour: str) -> None:
    """Where the bounder begins to say maybe."""
    grid = example.world.grid
    axes = [np.linspace(grid.lower[k], grid.upper[k], RESOLUTION) for k in range(2)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
    maybe = bounder.query(points).numpy().reshape(RESOLUTION, RESOLUTION)
    rows, columns = (axis * grid.cells_per_unit[k] - grid.offset[k] for k, axis in enumerate(axes))
    ax.contour(columns, rows, maybe, levels=[0.5], colors=colour, linewidths=0.9, alpha=0.9, zorder=2)


def _path(ax, example: Example, problem: int | None, colour: str, *, rings: bool = True) -> None:
    """A path, its ends, and in red where it collides, with rings around that."""
    if problem is None or example.paths[problem] is None:
        return
    cells = example.world.grid.cell_coordinate(example.paths[problem])
    ax.plot(cells[:, 1], cells[:, 0], color="white", linewidth=4.2, solid_capstyle="round", zorder=3)
    ax.plot(cells[:, 1], cells[:, 0], color=colour, linewidth=2.4, solid_capstyle="round", zorder=4)
    for part in _inside(example, problem):
        ax.plot(part[:, 1], part[:, 0], color=COLLISION, linewidth=3.6, solid_capstyle="round", zorder=5)
        if rings:
            middle = part[len(part) // 2]
            ax.plot(middle[1], middle[0], "o", mfc="none", mec=COLLISION, ms=15, mew=1.8, zorder=6)
    for place, face in ((cells[0], "white"), (cells[-1], INK)):
        ax.plot(place[1], place[0], "o", mfc=face, mec=INK, ms=7.5, mew=1.6, zorder=7)


def _close_up(ax, example: Example, bounder: wb.Bounder, problem: int) -> None:
    """An inset with the longest collision of a path, in the corner that is farthest from the path."""
    from matplotlib.patches import Rectangle

    parts = _inside(example, problem)
    if not parts:
        return
    part = max(parts, key=lambda p: np.linalg.norm(np.diff(p, axis=0), axis=1).sum())
    row, column = part[len(part) // 2]
    shape = np.array(example.world.grid.shape)
    reach = CLOSE_UP * shape.max()
    cells = example.world.grid.cell_coordinate(example.paths[problem]) / shape
    size = INSET
    corners = [(r, c) for r in (0.0, 1.0) for c in (0.0, 1.0)]
    far = max(
        corners,
        key=lambda corner: np.linalg.norm(cells - [abs(corner[0] - size / 2), abs(corner[1] - size / 2)], axis=1).min(),
    )
    place = (0.01 if far[1] == 0 else 0.99 - size, 0.99 - size if far[0] == 0 else 0.01, size, size)
    inset = ax.inset_axes(place, zorder=20)
    _world(inset, example)
    _outline(inset, example, bounder, UNPROVEN)
    _path(inset, example, problem, UNPROVEN, rings=False)
    inset.set_xlim(column - reach, column + reach)
    inset.set_ylim(row + reach, row - reach)
    for side in inset.spines.values():
        side.set(color=COLLISION, linewidth=1.6)
    frame = {"fill": False, "edgecolor": COLLISION, "linewidth": 1.2, "zorder": 8}
    ax.add_patch(Rectangle((column - reach, row - reach), 2 * reach, 2 * reach, **frame))
    middle = np.array([place[0] + size / 2, 1 - place[1] - size / 2]) * shape[::-1] - 0.5
    way = middle - [column, row]
    start = np.array([column, row]) + way * reach / np.abs(way).max()
    ax.plot(*zip(start, middle, strict=True), color=COLLISION, linewidth=1.0, zorder=8)  # ends behind the inset


def _legend(figure, names: tuple[str, str]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=STONE, label="obstacles"),
        Line2D([], [], color=ROADMAP, linewidth=1, label="roadmap"),
        Line2D([], [], color=PROVEN, linewidth=2.4, label=f"path with {names[0]}"),
        Line2D([], [], color=UNPROVEN, linewidth=2.4, label=f"path with {names[1]}"),
        Line2D([], [], color=INK, linewidth=0.9, label="thin outline: bound"),
        Line2D([], [], color=COLLISION, linewidth=3.6, label="collision"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
