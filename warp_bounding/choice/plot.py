"""The picture of a choice: what each candidate costs, by the price of the narrow phase, and which is the best where.

matplotlib is imported when it is drawn, and draws without a display.
"""

import io

import numpy as np

from warp_bounding.choice.prices import duration
from warp_bounding.choice.result import NONE, Choice, Row
from warp_bounding.errors import BoundingError

__all__ = ["FORMATS", "cost_plot"]

FORMATS = {"png": "Software", "svg": "Date"}  # and what a file does not tell, so that the same rows make the same one
COLOURS = ("#1b5e9e", "#d1420a", "#00846b", "#8a1c5a", "#c58a00", "#43474b", "#4aa3df", "#a8323e")
INK, PALE, FAINT = "#22303c", "#dde2e6", "#b9c1c8"
SIZE, DPI = (7.6, 4.6), 130
PRICES = (1.0, 1e6)  # of the narrow phase, nanoseconds, at least
POINTS = 400
MOST_NAMED = len(COLOURS)


def cost_plot(choice: Choice) -> dict[str, bytes]:
    """Draw it.

    Returns:
        File content by format.

    Raises:
        BoundingError: If matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("the plot needs matplotlib: pip install 'warp-bounding[train]'") from error
    files = {kind: io.BytesIO() for kind in FORMATS}
    with matplotlib.rc_context({"font.size": 9, "font.family": "DejaVu Sans", "svg.hashsalt": "choice"}):
        figure = Figure(figsize=SIZE, layout="constrained")
        _draw(figure.subplots(), choice)
        for kind, content in files.items():
            figure.savefig(content, format=kind, dpi=DPI, metadata={FORMATS[kind]: None})
    return {kind: content.getvalue() for kind, content in files.items()}


def _draw(panel, choice: Choice) -> None:
    stretches, price = choice.prices, choice.narrow_ns
    low = min(PRICES[0], *(s.price / 3 for s in stretches if s.price > 0), price / 3 if price > 0 else PRICES[0])
    high = max(PRICES[1], 3 * price, *(3 * s.price for s in stretches))
    prices = np.geomspace(low, high, POINTS)
    rows = {row.label: row for row in choice.rows if not row.why_not}
    best = [stretch.label for stretch in stretches]
    for label, row in rows.items():
        if label not in best:
            panel.plot(prices, _costs(row, prices), color=FAINT, linewidth=0.7, zorder=1)
    named = best if len(best) <= MOST_NAMED else [*best[: MOST_NAMED - 1], best[-1]]
    edges = [*(max(stretch.price, low) for stretch in stretches), high]
    for number, label in enumerate(best):
        colour = COLOURS[named.index(label)] if label in named else INK
        costs = _costs(rows[label], prices)
        panel.plot(prices, costs, color=colour, linewidth=0.9, alpha=0.6, zorder=2)
        own = np.geomspace(edges[number], edges[number + 1], 50)
        told = f"{label}, from {duration(stretches[number].price)}" if stretches[number].price else label
        panel.plot(own, _costs(rows[label], own), color=colour, linewidth=3, zorder=3, label=told)
    panel.axvline(max(price, low), color=INK, linewidth=0.8, linestyle=(0, (4, 3)), zorder=2)
    chosen = choice.row
    panel.plot([max(price, low)], [_costs(chosen, np.array([max(price, low)]))[0]], "o", color=INK, zorder=4)
    panel.annotate(
        f"{chosen.label}\n{duration(chosen.cost)} a query",
        (max(price, low), max(chosen.cost, 1e-3)),
        xytext=(8, -8),
        textcoords="offset points",
        va="top",
        color=INK,
    )
    floor = max(choice.positives, 0.0) * prices
    if choice.positives > 0:
        panel.plot(prices, floor, color=INK, linewidth=0.9, linestyle=":", zorder=1, label="what meets the object")
    panel.set(xscale="log", yscale="log", xlim=(low, high))
    panel.set_ylim(
        bottom=max(0.5 * min(rows[label].nanoseconds for label in best if label != NONE), 1e-2)
        if len(best) > 1
        else None
    )
    panel.set_xlabel("price of the narrow phase, nanoseconds a call", color=INK)
    panel.set_ylabel("broad and narrow phase, nanoseconds a query", color=INK)
    panel.set_title("What each broad phase costs; thick: the cheapest", loc="left", color=INK, fontweight="bold")
    panel.grid(color=PALE, linewidth=0.6)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(loc="upper left", frameon=False, fontsize=8, labelcolor=INK)


def _costs(row: Row, prices: np.ndarray) -> np.ndarray:
    return row.line.cost(prices)
