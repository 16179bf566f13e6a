"""The paper's rank plot: false-positive rates of every test case (object x query), sorted, a line a method, a panel a dimension.

Where a table shows means, this shows whether a method is tight always or only on average. Classic volumes are cool and grey, what
is learned is warm; markers tell lines apart without colours. Volumes that were fitted in both spaces have two lines of
panels, with the networks in both. matplotlib is imported when a plot is drawn, and draws without a display.
"""

import io
from collections.abc import Iterable

import numpy as np

from paper.columns import COLUMNS, LEARNED
from paper.rows import PROTOCOLS, Row
from warp_bounding.errors import BoundingError

__all__ = ["FORMATS", "rank_plot"]

FORMATS = {"png": "Software", "svg": "Date"}  # and what a file does not tell, so that the same rows make the same one
STYLES = {  # colour and marker, in the legend's order; lightness and marker differ for the colour-blind, too
    "mlp": ("#d1420a", "o"),
    "mlp-early": ("#f0a30a", "d"),
    "monotone-mlp": ("#a8323e", ">"),
    "mlp-local": ("#c77f4f", "8"),
    "hierarchy": ("#e8b48c", "p"),
    "learned-kdop+mlp": ("#7a2f00", "*"),
    "distance": ("#5f8a1e", "<"),
    "relu-field": ("#d97bb6", "X"),
    "learned-kdop": ("#8a1c5a", "P"),
    "aabb": ("#1b5e9e", "s"),
    "obb": ("#4aa3df", "D"),
    "sphere": ("#a0a4a8", "o"),
    "ellipsoid": ("#75797d", "h"),
    "oriented-ellipsoid": ("#43474b", "p"),
    "kdop": ("#00846b", "^"),
    "bvh": ("#5ec4a8", "v"),
}
HEADINGS = {"learned": True, "classic": False}
CAPTIONS = {"geometric": "volumes around the object", "parametric": "volumes around query parameters,\nas in the paper"}
MARKERS = 12  # of a line, at most
TICKS = (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100)  # per cent; what is less than the first is drawn there
MOST = TICKS[-1]
INK, PALE = "#22303c", "#dde2e6"
PANEL, GAP = (3.1, 2.7), (0.25, 0.55)  # width and height, inches; fixed, since a layout engine draws everything twice
LEFT, RIGHT, BOTTOM, TOP = 0.95, 2.0, 0.65, 0.65  # inches around the panels; the legend is at the right
DPI = 130


def rank_plot(rows: Iterable[Row]) -> dict[str, bytes]:
    """Draw it.

    Args:
        rows: Of any protocols; the exact ones are drawn if there are any. What stands outside the ranking, and hierarchies of a
            stated number of leaves, are not.

    Returns:
        File content by format; nothing if there are no rows to draw.

    Raises:
        BoundingError: If matplotlib is not installed.
    """
    rows = [r for r in rows if r.method in STYLES and r.leaves is None]
    protocol = next((p for p in PROTOCOLS if any(r.protocol == p for r in rows)), None)
    if protocol is None:
        return {}
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("the rank plot needs matplotlib: pip install 'warp-bounding[train]'") from error
    rows = [r for r in rows if r.protocol == protocol]
    with matplotlib.rc_context({"font.size": 10, "font.family": "DejaVu Sans", "svg.hashsalt": "rank"}):
        figure, files = Figure(), {kind: io.BytesIO() for kind in FORMATS}
        _draw(figure, rows, protocol)
        for kind, content in files.items():
            figure.savefig(content, format=kind, dpi=DPI, metadata={FORMATS[kind]: None})
    return {kind: content.getvalue() for kind, content in files.items()}


def _draw(figure, rows: list[Row], protocol: str) -> None:
    dimensions, spaces = _panels(rows)
    panels = _place(figure, len(dimensions), len(spaces))
    least = max([t for t in TICKS if t <= min(r.fp_rate for r in rows)], default=TICKS[0])
    lines: dict[str, object] = {}
    for line_of_panels, space in zip(panels, spaces, strict=True):
        for panel, ndim in zip(line_of_panels, dimensions, strict=True):
            own = [r for r in rows if r.dimension == ndim]
            for method in (m for m in STYLES if any(r.method == m and _brings(r, space) for r in own)):
                rates = np.sort([r.fp_rate for r in own if r.method == method and _belongs(r, space)])
                lines[method] = _line(panel, method, np.maximum(rates, least))
            cases = {(r.object, r.query) for r in own}
            _panel(panel, len(cases), least, last=space == spaces[-1])
            queries = ", ".join(dict.fromkeys(c.query for c in COLUMNS if any(c.query == query for _, query in cases)))
            panel.set_title(f"{ndim}D", loc="left", fontweight="bold", color=INK)
            panel.set_title(queries, loc="right", fontsize=8.5, color=INK)
        caption = f"{CAPTIONS[space]}\n" if len(spaces) > 1 else ""
        line_of_panels[0].set_ylabel(f"{caption}false positives, % (log scale)", color=INK, fontsize=9)
    _legend(figure, lines, panels[0, -1].get_position().x1)
    title = f"False positives of every method on every test case, {protocol} truth: lower is tighter"
    height = figure.get_size_inches()[1]
    figure.suptitle(title, x=0.01, y=1 - 0.1 / height, ha="left", va="top", fontsize=12, color=INK)


def _place(figure, columns: int, lines: int):
    """Panels of a fixed size, with room around them."""
    width, height = (n * p + (n - 1) * g for n, p, g in zip((columns, lines), PANEL, GAP, strict=True))
    full = LEFT + max(width, 2 * PANEL[0]) + RIGHT, BOTTOM + height + TOP  # the title needs room
    figure.set_size_inches(full)
    edges = {"left": LEFT / full[0], "right": (LEFT + width) / full[0], "bottom": BOTTOM / full[1]}
    edges |= {"top": 1 - TOP / full[1], "wspace": GAP[0] / PANEL[0], "hspace": GAP[1] / PANEL[1]}
    return figure.subplots(lines, columns, sharey=True, squeeze=False, gridspec_kw=edges)


def _panels(rows: list[Row]) -> tuple[list[int], list[str]]:
    """Dimensions and spaces that there are panels for."""
    spaces = ["geometric", *(["parametric"] if any(r.variant.parametric for r in rows) else [])]
    return sorted({r.dimension for r in rows}), spaces


def _brings(row: Row, space: str) -> bool:
    """Whether a row is a reason to draw its method's line in this space's panels: points alone are none in the parametric ones."""
    return space == "geometric" or not row.variant.in_both_spaces or row.space == space


def _belongs(row: Row, space: str) -> bool:
    """Whether a line in this space's panels holds the row: points, and what has no space, are in both."""
    return not row.variant.in_both_spaces or not row.column.kind.is_region or row.space == space


def _line(panel, method: str, rates: np.ndarray):
    colour, marker = STYLES[method]
    learned = method in LEARNED
    (line,) = panel.plot(
        np.arange(1, len(rates) + 1),
        rates,
        color=colour,
        linewidth=2.4 if learned else 1.5,
        marker=marker,
        markersize=6.5 if learned else 5,
        markeredgecolor="white",
        markeredgewidth=0.6,
        markevery=max(1, -(-len(rates) // MARKERS)),
        zorder=5 if method == "mlp" else 4 if learned else 3,
    )
    return line


def _panel(panel, cases: int, least: float, last: bool) -> None:
    panel.set_yscale("log")
    panel.set_ylim(least * 0.9, MOST * 1.1)
    ticks = [t for t in TICKS if t >= least]
    panel.set_yticks(ticks, [f"{t:g}" for t in ticks])
    panel.set_xlim(0.5, cases + 0.5)
    if cases == 1:
        panel.set_xticks([1])
    else:
        panel.xaxis.get_major_locator().set_params(integer=True)
    if last:
        label = f"{cases} test cases (object × query),\nsorted for each method: easy to hard"
        panel.set_xlabel(label if cases > 1 else "one test case", fontsize=9, color=INK)
    panel.minorticks_off()
    panel.grid(axis="y", color=PALE, linewidth=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(color=PALE, labelcolor=INK)
    for side, spine in panel.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(PALE)


def _legend(figure, lines: dict[str, object], right: float) -> None:
    from matplotlib.lines import Line2D

    space = Line2D([], [], linestyle="none")
    handles, labels = [], []
    for heading, learned in HEADINGS.items():
        own = [m for m in STYLES if m in lines and (m in LEARNED) == learned]
        if own:
            handles += [*([space] if handles else []), space, *(lines[m] for m in own)]
            labels += [*([""] if labels else []), heading, *own]
    width, height = figure.get_size_inches()
    legend = figure.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(right + 0.1 / width, 1 - (TOP - 0.3) / height),
        frameon=False,
        fontsize=9,
        handlelength=2.6,
    )
    for text in legend.get_texts():
        text.set_color(INK)
        if text.get_text() in HEADINGS:
            text.set_fontweight("bold")
