"""Shapes of our own, drawn by code, for figures where the paper's data is not given: grids of 32 cells a side, as the paper's are.

2D: star, fish, crescent. 3D: bunny (the mesh that comes with warp-lang), ring, cup. 4D: the bunny and the cup, turned about their
first axis by a whole turn in ten steps.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from warp_bounding import indicators
from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import IndicatorGrid

__all__ = ["CELLS", "fish", "own_shape", "star"]

CELLS, STEPS = 32, 10  # cells a side, and steps of time
BUNNY_CELLS = 26  # of the bunny's longest side, so that it stays in the domain when it turns


def _centres(ndim: int) -> np.ndarray:
    """``(CELLS, ..., ndim)`` centres of the cells of a unit grid."""
    return np.stack(np.meshgrid(*[np.linspace(0, 1, CELLS)] * ndim, indexing="ij"), axis=-1)


def star(points: np.ndarray) -> np.ndarray:
    """A star with five slim, rounded arms, one of them up."""
    d = np.asarray(points) - (0.5, 0.47)
    angle, radius = np.arctan2(d[..., 0], d[..., 1]), np.hypot(d[..., 0], d[..., 1])
    return radius < 0.13 + 0.34 * np.abs(np.cos(2.5 * angle)) ** 5


def fish(points: np.ndarray, centre=(0.5, 0.5), size: float = 0.9, angle: float = 0.0) -> np.ndarray:
    """A fish that swims to the left: a body, a forked tail, a fin on its back and one below; ``size`` is its length, ``angle`` in radians."""
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


def _ring(points: np.ndarray) -> np.ndarray:
    """A tilted torus with a bar across."""
    d = np.asarray(points) - 0.5
    y = 0.85 * d[..., 1] + 0.5 * d[..., 2]
    z = -0.5 * d[..., 1] + 0.85 * d[..., 2]
    return (np.hypot(np.hypot(d[..., 0], z) - 0.34, y) < 0.09) | ((np.hypot(y, z) < 0.06) & (np.abs(d[..., 0]) < 0.36))


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
        raise IndicatorError(f"{path}: expected this mesh in the installed warp-lang; no such file")
    cells = indicators.load_indicator(path).to_grid(resolution=BUNNY_CELLS).occupancy
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
        back = np.clip(back, 0, CELLS - 1)
        frames.append(cells[tuple(np.moveaxis(back, -1, 0))] & known)
    return np.stack(frames)


def _drawn(inside: Callable[[np.ndarray], np.ndarray], ndim: int) -> Callable[[], np.ndarray]:
    return lambda: inside(_centres(ndim))


_SHAPES: dict[str, Callable[[], np.ndarray]] = {
    "2d/star": _drawn(star, 2),
    "2d/fish": _drawn(fish, 2),
    "2d/crescent": _drawn(_crescent, 2),
    "3d/bunny": _bunny,
    "3d/ring": _drawn(_ring, 3),
    "3d/cup": _drawn(_cup, 3),
    "4d/bunny": lambda: _turning(_bunny()),
    "4d/cup": lambda: _turning(_drawn(_cup, 3)()),
}


@cache
def own_shape(name: str) -> IndicatorGrid:
    """A shape of our own.

    Raises:
        IndicatorError: If there is no such shape, or the mesh behind it is not installed.
    """
    if name not in _SHAPES:
        raise IndicatorError(f"shape must be one of {', '.join(_SHAPES)}, got {name!r}")
    return IndicatorGrid(_SHAPES[name](), name=name.partition("/")[2], time=name.startswith("4d"))
