"""The paper's early-out plot: time of the network over that of the one with exits, every column, sorted; theirs and ours.

A bar over 1 is a gain. matplotlib is imported when a plot is drawn, and draws without a display.
"""

import io
from collections.abc import Sequence

import numpy as np

from paper.pages.rank_plot import FORMATS, INK, PALE
from paper.speed.figures import PAPER_DEVICE, paper_early_out
from paper.speed.tables import OnDevice
from warp_bounding.errors import BoundingError

__all__ = ["early_plot"]

COLOURS = ("#d1420a", "#f0a30a", "#a8323e", "#7a2f00")  # of ours, by device
THEIRS = "#8a939b"
SIZE, DPI = (8.6, 4.2), 130  # inches, dots an inch


def early_plot(devices: Sequence[OnDevice]) -> dict[str, bytes]:
    """Draw it.

    Args:
        devices: Those without a column in which both networks were raced are left out.

    Returns:
        File content by format; nothing if there is nothing to draw.

    Raises:
        BoundingError: If matplotlib is not installed.
    """
    series = {f"ours, {each.device}": {e.column: e.gain for e in each.early_out()} for each in devices}
    series = {name: gains for name, gains in series.items() if gains}
    if not series:
        return {}
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("the early-out plot needs matplotlib: pip install 'warp-bounding[train]'") from error
    with matplotlib.rc_context({"font.size": 10, "font.family": "DejaVu Sans", "svg.hashsalt": "early"}):
        figure, files = Figure(figsize=SIZE, layout="constrained"), {kind: io.BytesIO() for kind in FORMATS}
        _draw(figure.subplots(), series)
        for kind, content in files.items():
            figure.savefig(content, format=kind, dpi=DPI, metadata={FORMATS[kind]: None})
    return {kind: content.getvalue() for kind, content in files.items()}


def _draw(panel, series: dict[str, dict]) -> None:
    first = next(iter(series.values()))
    columns = sorted(first, key=first.__getitem__)
    theirs = paper_early_out()
    series = {f"the paper's, {PAPER_DEVICE}": {c: theirs[c] for c in columns}} | series
    width, places = 0.8 / len(series), np.arange(len(columns))
    for number, (name, gains) in enumerate(series.items()):
        values = np.array([gains.get(c, np.nan) for c in columns])
        mean = f"{name} (mean gain {100 * (np.nanmean(values) - 1):+.0f} %)"
        colour = COLOURS[(number - 1) % len(COLOURS)] if number else THEIRS
        at = places + (number + 0.5) * width - 0.4
        panel.bar(at, values, width * 0.92, color=colour, label=mean)
        for x, value in zip(at, values, strict=True):
            if np.isfinite(value):
                panel.annotate(
                    f"{value:.2f}",
                    (x, value),
                    xytext=(0, 2),
                    textcoords="offset points",
                    ha="center",
                    fontsize=7,
                    color=INK,
                    rotation=90 if len(series) > 2 else 0,
                    bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"},
                )
    panel.axhline(1.0, color=INK, linewidth=1, zorder=0.9)
    panel.set_xticks(places, [c.title.replace(" ", "\n") for c in columns])
    panel.set_ylabel("time without exits / time with exits", color=INK)
    panel.set_title("Early exits: how many times as fast, by column (over 1 is a gain)", loc="left", color=INK)
    panel.grid(axis="y", color=PALE, linewidth=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(color=PALE, labelcolor=INK)
    panel.legend(frameon=False, labelcolor=INK)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(PALE)
