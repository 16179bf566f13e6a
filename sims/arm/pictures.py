"""Pictures of arms that plan: the proven network's path, the unproven one's, and a slice of configuration space.

Runs are those of ``demo``. Arms in a plane are seen from above. Drawn with matplotlib, without a display.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np

import warp_bounding as wb
from sims.arm.workplace import Workplace
from sims.drawing import INK, heading, save_figure
from sims.planning.roadmap import Roadmap

__all__ = ["along", "draw", "draw_one", "longest_path", "shapes_at", "slice_of"]

STONE, LINK = "#c9bfb2", "#b9cbdc"
PROVEN, UNPROVEN, COLLISION = "#1f6fb4", "#e08a00", "#d1242f"
WIDTH, DPI, COLOURS = 4.6, 110, 160  # of a panel, inches; dots an inch; of the picture's palette
CORNERS = 24  # of a circle
POSES = 9  # that are drawn along a path, with its ends
FINE = 0.001  # between those that are asked whether they collide, in the place's coordinates: for drawing only
TIPS = 25  # of these between points of the tip's path
RESOLUTION = 300  # of a slice, along a side
REACH = 1.08  # of a picture around the base, metres


def draw(
    folder: Path,
    pairs: list[tuple[Roadmap, Roadmap]],
    bounders: list[dict[str, wb.Bounder]],
    names: tuple[str, str],
) -> Path:
    """``arm.png``: a row per cell.

    Args:
        folder: Made if there is none.
        pairs: Per cell the two runs, finished.
        bounders: Per cell, by name.
        names: Of the two broad phases.

    Returns:
        The file.
    """
    figure, axes = _canvas(len(pairs), 3)
    for row, (pair, own) in enumerate(zip(pairs, bounders, strict=True)):
        problem = longest_path(pair[1], pair[0])
        for column, (example, colour) in enumerate(zip(pair, (PROVEN, UNPROVEN), strict=True)):
            ax = axes[row][column]
            _cell(ax, example.world)
            _path(ax, example, problem, colour)
            collided, solved = int(example.collisions().sum()), example.solved
            heading(ax, names[column], f"{collided} of {solved} paths collide")
        axes[row][0].set_ylabel(pair[0].world.name)
        middle = pair[0].states[0] if problem is None else _middle(pair[0].paths[problem])
        _slice(axes[row][2], pair[0].world, own, names, middle)
    _legend(figure, names)
    return save_figure(figure, Path(folder) / "arm.png", DPI, COLOURS)


def draw_one(example: Roadmap, folder: Path) -> Path:
    """``arm-NAME.png``: one run's cell, and the arm along its longest path."""
    figure, axes = _canvas(1, 1)
    _cell(axes[0][0], example.world)
    _path(axes[0][0], example, longest_path(example, example), PROVEN)
    heading(axes[0][0], example.world.name, f"{example.solved} of {len(example.problems)} problems solved")
    return save_figure(figure, Path(folder) / f"{example.world.scene}.png", DPI, COLOURS)


def longest_path(example: Roadmap, other: Roadmap) -> int | None:
    """The problem, solved in both runs, with the longest path; one that collides in the first run, if any."""
    both = np.flatnonzero(np.isfinite(example.lengths) & np.isfinite(other.lengths))
    if not len(both):
        return None
    collided = both[example.collisions()[both]]
    chosen = collided if len(collided) else both
    return int(chosen[np.argmax(example.lengths[chosen])])


def shapes_at(place: Workplace, x: np.ndarray) -> list[np.ndarray]:
    """Outlines ``(K, 2)``, metres, of the arm's bodies seen from above, at one configuration ``(n,)``."""
    arm = place.shape.arm
    frames = arm.frames(place.joint_values(x[None]))[0]
    return [_outline(body, frames[body.link]) for body in arm.bodies if body.link != wb.arms.WORLD]


def _outline(body: wb.arms.Body, frame: np.ndarray | None = None) -> np.ndarray:
    """The outline of a body seen from above."""
    from scipy.spatial import ConvexHull

    points = body.points if frame is None else body.points @ frame[:3, :3].T + frame[:3, 3]
    turn = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) * max(body.radius, 1e-6)
    around = (points[:, None, :2] + circle).reshape(-1, 2)
    return around[ConvexHull(around).vertices]


def _middle(path: np.ndarray) -> np.ndarray:
    return path[len(path) // 2]


def along(path: np.ndarray, spacing: float) -> np.ndarray:
    """Configurations along a path, its ends included."""
    found = [path[:1].astype(np.float64)]
    for a, b in pairwise(path.astype(np.float64)):
        count = max(1, round(np.linalg.norm(b - a) / spacing))
        found.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(found)


def _canvas(rows: int, columns: int):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH * columns, WIDTH * rows + 0.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _polygons(ax, outlines: list[np.ndarray], **style) -> None:
    from matplotlib.collections import PolyCollection

    ax.add_collection(PolyCollection(outlines, **style))


def _cell(ax, place: Workplace) -> None:
    """What stands around the arm."""
    _polygons(ax, [_outline(body) for body in place.shape.obstacles], facecolors=STONE, edgecolors="none", zorder=1)
    ax.set_xlim(-REACH, REACH)
    ax.set_ylim(-REACH, REACH)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    for side in ax.spines.values():
        side.set_color(INK)


def _path(ax, example: Roadmap, problem: int | None, colour: str) -> None:
    """The arm along a path: where it begins in white, where it ends in black, and in red where it collides."""
    place = example.world
    if problem is None or example.paths[problem] is None:
        return
    fine = along(example.paths[problem], FINE)
    poses = fine[np.linspace(0, len(fine) - 1, POSES).astype(int)]
    for number, pose in enumerate(poses):
        first, last = number == 0, number == len(poses) - 1
        ends = first or last
        face = "white" if first else INK if last else LINK
        style = {"edgecolors": INK if ends else "white", "linewidths": 0.8, "zorder": 6 if ends else 2}
        _polygons(ax, shapes_at(place, pose), facecolors=face, alpha=1.0 if ends else 0.7, **style)
    tips = np.array([shapes_at(place, pose)[-1].mean(axis=0) for pose in fine[::TIPS]])
    ax.plot(*tips.T, color=colour, linewidth=2.0, zorder=5)
    hit = np.flatnonzero(place.shape.contains(fine))
    for stretch in np.split(hit, np.flatnonzero(np.diff(hit) > 1) + 1) if len(hit) else ():
        middle = fine[stretch[len(stretch) // 2]]
        _polygons(ax, shapes_at(place, middle), facecolors=COLLISION, edgecolors="none", alpha=0.9, zorder=7)
    ax.plot(0, 0, "o", color=INK, ms=5, zorder=8)


def slice_of(place: Workplace, middle: np.ndarray, count: int = RESOLUTION) -> tuple[np.ndarray, np.ndarray]:
    """Configurations ``(count^2, n)`` float32 over joints 0 and 1, the others as in ``middle``.

    And the values ``(2, count)`` in degrees.
    """
    lower, upper = place.shape.lower, place.shape.upper
    values = np.linspace(lower[:2], upper[:2], count).T
    x = np.tile(np.asarray(middle, dtype=np.float32), (count * count, 1))
    x[:, :2] = np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, 2)
    return x, np.degrees(values / place.shape.weights[:2, None])


def _slice(ax, place: Workplace, bounders: dict[str, wb.Bounder], names: tuple[str, str], middle: np.ndarray) -> None:
    """Configurations that collide, and where bounders of points begin to say maybe."""
    from matplotlib.colors import ListedColormap

    x, (first, second) = slice_of(place, middle)
    held = place.shape.contains(x.astype(np.float64)).reshape(RESOLUTION, RESOLUTION)
    box = (first[0], first[-1], second[0], second[-1])
    ax.imshow(held.T, cmap=ListedColormap(["white", STONE]), origin="lower", extent=box, aspect="auto")
    for name, colour in zip(names, (PROVEN, UNPROVEN), strict=True):
        maybe = bounders[name].query(x).numpy().reshape(RESOLUTION, RESOLUTION)
        ax.contour(first, second, maybe.T, levels=[0.5], colors=colour, linewidths=1.0)
    ax.set_xlabel("joint 0, degrees")
    ax.set_ylabel("joint 1, degrees")
    if place.shape.ndim > 2:
        others = ", ".join(f"{value:.0f}" for value in np.degrees(place.joint_values(middle[None])[0, 2:]))
        heading(ax, "configurations", f"the other joints at {others}")


def _legend(figure, names: tuple[str, str]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=STONE, label="obstacles, colliding configurations"),
        Patch(facecolor="white", edgecolor=INK, label="start"),
        Patch(facecolor=INK, label="goal"),
        Line2D([], [], color=PROVEN, linewidth=1.6, label=f"{names[0]}: path of the tip, bound"),
        Line2D([], [], color=UNPROVEN, linewidth=1.6, label=f"{names[1]}: path, bound"),
        Patch(facecolor=COLLISION, label="collision"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
