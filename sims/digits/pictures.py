"""Pictures of digits: the decoder's grey values, what is ink, and the border of what a bounder leaves."""

from pathlib import Path

import numpy as np

from sims.drawing import INK, with_palette

__all__ = ["draw", "draw_one"]

BORDER, LOST = "#1f6fb4", "#d1242f"
SHOWN = 10  # digits in a row
DPI, COLOURS = 110, 200  # dots an inch; of the picture's palette
SIDE = 0.95  # of a digit, inches


def draw(folder: Path, series: list[tuple[str, np.ndarray, np.ndarray]]) -> Path:
    """``digits.png``, ``digits.svg``: a row of random digits for each series, with the border its bounder leaves.

    Args:
        folder: Made if there is none.
        series: Title of a row; of at least ``SHOWN`` images ``(N, side, side)`` the decoder's values; and the same,
            minus infinity where the bounder spared the decoder.

    Returns:
        The PNG.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height = SIDE + 0.32
    figure = Figure(figsize=(SHOWN * SIDE + 0.2, len(series) * height + 0.1), layout=None, facecolor="white")
    FigureCanvasAgg(figure)
    width, total = SHOWN * SIDE + 0.2, len(series) * height + 0.1
    for row, (title, values, asked) in enumerate(series):
        top = total - row * height
        figure.text(0.1 / width, (top - 0.2) / total, title, color=INK, fontsize=9)
        for column in range(SHOWN):
            left, bottom = 0.1 + column * SIDE, top - height + 0.05
            ax = figure.add_axes((left / width, bottom / total, (SIDE - 0.06) / width, (SIDE - 0.06) / total))
            _digit(ax, values[column], asked[column])
    path = _save(figure, Path(folder), "digits.png")
    _save_lines(figure, Path(folder), "digits.svg")
    return path


def draw_one(folder: Path, values: np.ndarray, latent: int) -> Path:
    """``digits-LATENT.png``: digits ``(N, side, side)``, minus infinity where the decoder was not run."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = min(len(values), SHOWN)
    figure = Figure(figsize=(count * SIDE, SIDE), facecolor="white")
    FigureCanvasAgg(figure)
    for column in range(count):
        _digit(figure.add_axes((column / count, 0, 0.96 / count, 0.96)), values[column], values[column])
    return _save(figure, Path(folder), f"digits-{latent}.png")


def _digit(ax, values: np.ndarray, asked: np.ndarray) -> None:
    """Ink in grey, as dark as it is likely, in the border of the pixels for which the decoder was run."""
    size = len(values)
    likely = 1 / (1 + np.exp(-values.astype(np.float64)))
    ax.imshow(likely, cmap="Greys", vmin=0, vmax=1, extent=(0, size, size, 0), interpolation="nearest")
    run = np.pad(np.isfinite(asked), 1).astype(float)
    lost = np.pad((values >= 0) & ~np.isfinite(asked), 1).astype(float)
    centers = np.arange(-1, size + 1) + 0.5
    if 0 < run.sum() < size * size:
        ax.contour(centers, centers, run, levels=[0.5], colors=[BORDER], linewidths=1.4)
    if lost.any():
        ax.contourf(centers, centers, lost, levels=[0.5, 1.5], colors=[LOST])
    ax.set_xlim(0, size)
    ax.set_ylim(size, 0)
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_color("#d0d4d8")


def _save(figure, folder: Path, name: str) -> Path:
    from io import BytesIO

    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    data = BytesIO()
    figure.savefig(data, format="png", dpi=DPI)
    part = folder / f".{name}.part"
    with_palette(Image.open(data), COLOURS).save(part, format="PNG", optimize=True)
    return part.replace(folder / name)


def _save_lines(figure, folder: Path, name: str) -> None:
    """The same as lines and text; the digits themselves are small pictures in it."""
    from matplotlib import rc_context

    part = folder / f".{name}.part"
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(part, format="svg", metadata={"Date": None})
    part.replace(folder / name)
