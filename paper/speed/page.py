"""``README.md``, ``speed.json`` and the pictures of a run of ``speed``, from its rows alone."""

import json
import math
from collections.abc import Sequence
from typing import Any

from paper.folder import Folder
from paper.pages.made_with import made_with
from paper.pages.markdown import NO_METHOD, NOT_YET
from paper.pages.table import table
from paper.speed.early_plot import early_plot
from paper.speed.figures import (
    PAPER_DEVICE,
    PAPER_MEAN_GAIN,
    PAPER_RATIO,
    QUERIES,
    TABLE_2,
    BreakEven,
    paper_early_out,
    paper_ms,
)
from paper.speed.rows import GENERATED
from paper.speed.run import REFERENCE
from paper.speed.tables import EARLY, MOST_LOSS, OnDevice, by_device
from warp_bounding.errors import BoundingError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["page", "summary", "write_outputs"]

PICTURE = "early_out"
FEW = 3.0  # milliseconds: below, two digits are shown that count
SMALL = 0.1  # a ratio below is shown with three decimals


def write_outputs(folder: Folder, failed: Sequence[str] = (), *, pictures: bool = True) -> list[str]:
    """Write the page, the summary and the pictures.

    Args:
        folder: Whose rows to show.
        failed: Lines about cells that failed.
        pictures: Whether to draw; without, those that are there are shown.

    Returns:
        What could not be drawn and why, for people.

    Raises:
        FileFormatError: If a file cannot be written.
    """
    devices, notes = by_device(folder.rows.values()), []
    try:
        drawn = early_plot(devices) if pictures else {}
    except BoundingError as error:
        drawn = {}
        notes.append(str(error))
    for kind, content in drawn.items():
        write_whole(folder.path / f"{PICTURE}.{kind}", content)
    shown = (folder.path / f"{PICTURE}.png").exists()
    write_whole(folder.page, page(folder, devices, failed, picture=shown).encode())
    write_whole(folder.path / f"{folder.kind.COMMAND}.json", (json.dumps(summary(devices), indent=1) + "\n").encode())
    return notes


def summary(devices: Sequence[OnDevice]) -> dict[str, Any]:
    """For programs: every cell, the gains of early exits, and the break-evens of Table 2, by device."""
    return {each.device: _device(each) for each in devices}


def _device(on: OnDevice) -> dict[str, Any]:
    columns: dict[str, dict] = {}
    for (variant, column), cell in on.cells.items():
        about = {"ns": cell.ns, "ms": cell.ms, "ratio": cell.ratio, "fp_rate": cell.fp_rate, "objects": cell.objects}
        paper = {"paper_ms": paper_ms(variant.method, column) if variant.is_papers(column) else None}
        columns.setdefault(column.name, {})[variant.label] = about | paper
    gains = {e.column.name: {"gain": e.gain, "fp_mlp": e.fp_whole, "fp_early": e.fp_early} for e in on.early_out()}
    even = {}
    for variant in on.variants:
        found = on.break_even(variant) if variant != EARLY else None
        if found is not None:
            most = None if math.isinf(found.most) else found.most
            even[variant.label] = {"least_ms": found.least, "most_ms": most, "factor": found.factor}
    about = {"name": on.name, "columns": columns, "early_out": gains}
    return about | {"mean_gain": _mean_gain(on), "break_even": even, "false_negatives": on.missed()}


def _mean_gain(on: OnDevice) -> float | None:
    gains = [each.gain for each in on.early_out()]
    return sum(gains) / len(gains) - 1 if gains else None


def page(folder: Folder, devices: Sequence[OnDevice], failed: Sequence[str] = (), *, picture: bool = False) -> str:
    """The whole page; see ``write_outputs``."""
    lines = ["# Speed of *Neural Bounding*'s tests, measured with warp-bounding", "", *_made_with(folder)]
    if failed:
        lines += ["", "**Failed**, and therefore missing below:", "", *(f"- {line}" for line in failed)]
    if not devices:
        return "\n".join([*lines, "", "Nothing has been measured yet.", ""])
    lines += ["", *_legend(folder)]
    for on in devices:
        lines += ["", f"## {on.device}: {on.name}", ""]
        if TABLE_2 in on.columns:
            lines += [f"### {TABLE_2.title}s (the paper's Table 2)", "", *_table_2(on), ""]
        lines += ["### Every column: milliseconds for 10 million queries", "", *_every(on, relative=False), ""]
        lines += [f"### Every column: time over that of `{REFERENCE.name}`", "", *_every(on, relative=True), ""]
        if on.early_out():
            lines += ["### Early exits", "", *_early_out(on), ""]
        if missed := on.missed():
            lines += [f"**{missed:,} false negatives of methods that promise none: a promise is broken.**", ""]
    if picture:
        lines += [
            "## The early-out plot",
            "",
            f"![Time without exits over time with exits, by column]({PICTURE}.png)",
            "",
        ]
        lines += [
            f"One pair of bars a column, sorted by ours. Over 1 the network with exits is the faster one. The paper states a mean gain of "
            f"{PAPER_MEAN_GAIN} %; its bars are what its supplement's table says. Also as [SVG]({PICTURE}.svg)."
        ]
    return "\n".join([*lines, ""]).replace("\n\n\n", "\n\n")


def _made_with(folder: Folder) -> list[str]:
    s, rows = folder.settings, list(folder.rows.values())
    objects = ", ".join(f"{name} in {n}D" for n, name in sorted({(r.dimension, r.object) for r in rows})) or "none"
    where = "generated shapes" if s.shapes == GENERATED else "objects of the paper's data"
    first = f"{len(rows):,} cells in [speed.csv](speed.csv), means in [speed.json](speed.json); {where}: {objects}"
    facts = [
        f"{s.queries:,} random queries at a time, {s.rounds} rounds; rates over {s.samples:,} others, exact truth; rays of length {s.length:g}",
        f"{s.fits.budget_text} s for a learned fit, its proof included; where others are named, the last that fits; sizes as in the "
        f"paper's supplement, seed {s.seed}",
    ]
    return made_with(folder, first, facts)


def _legend(folder: Folder) -> list[str]:
    return [
        f"- Methods are asked for the same queries in turn, round by round. A time is the median of {folder.settings.rounds} rounds, for 10 million "
        f"queries; a ratio is the median of ratios to `{REFERENCE.name}` within a round, so that it holds on a busy machine, too.",
        f"- In brackets the paper's figure, on an {PAPER_DEVICE}, from Table 2 and its supplement. Its milliseconds are another machine's: compare ratios.",
        "- `(parametric)`: a volume around the parameters of the queries, as in the paper, whose figures stand there.",
        f"- `{NO_METHOD}` there is no such bounder; `{NOT_YET}` not measured (yet).",
    ]


def _table_2(on: OnDevice) -> list[str]:
    heads = (
        None,
        "ms for 10 million",
        "billions a second",
        f"time / {REFERENCE.name}",
        "FP %",
        "pays from, ms",
        "pays from, × a query",
    )
    lines = []
    whole = paper_ms(REFERENCE.method, TABLE_2)
    for variant in on.variants:
        cell = on.cells.get((variant, TABLE_2))
        if cell is None:
            continue
        ms = paper_ms(variant.method, TABLE_2) if variant.is_papers(TABLE_2) else None
        texts = (_ms(cell.ms, 1), f"{cell.billions:.3f}", f"{cell.ratio:.3f}", f"{cell.fp_rate:.2f}")
        theirs = (None, None, None, None)
        if ms is not None:
            theirs = (f"{ms:g}", f"{QUERIES / ms / 1e6:.2f}", f"{ms / whole:.3f}", f"{variant.paper(TABLE_2):g}")
        even = on.break_even(variant) if variant != EARLY else None
        ratio = PAPER_RATIO.get(variant.method) if ms is not None else None
        price, factor = (_price(even), _factor(even)) if even else (NO_METHOD, NO_METHOD)
        price = price if ratio is None else f"{price} ({ratio:.2f})"
        own = (a if b is None else f"{a} ({b})" for a, b in zip(texts, theirs, strict=True))
        lines.append([variant.label, *own, price, factor])
    return [
        *table(heads, lines),
        "",
        f"*Pays from* (Eq. 6): `{EARLY.name}` is the better choice than the row's method where 10 million tests of the geometry itself take more than "
        "so many milliseconds; as a multiple of one query of the row's method in the last column. *below*: where they take less, since the row's "
        "method is the tighter and the slower one; *never*: it is both faster and tighter; *always*: neither. The paper's column *Ratio* is the same time in milliseconds, on its machine.",
    ]


def _price(even: BreakEven) -> str:
    if even.always:
        return "always"
    if even.never:
        return "never"
    return _ms(even.least, 1) if math.isinf(even.most) else f"below {_ms(even.most, 1)}"


def _factor(even: BreakEven) -> str:
    return f"{even.factor:.1f}" if even.least > 0 and not even.never else NO_METHOD


def _times(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio >= SMALL else f"{ratio:.3f}"


def _ms(ms: float, digits: int = 0) -> str:
    """With so many digits behind the point; a GPU's fractions of a millisecond with more."""
    return f"{ms:.{digits}f}" if ms >= FEW else f"{ms:.2g}"


def _every(on: OnDevice, *, relative: bool) -> list[str]:
    lines = []
    for variant in on.variants:
        cells = []
        for column in on.columns:
            cell = on.cells.get((variant, column))
            if cell is None:
                cells.append(NOT_YET if variant.space_in(column) else NO_METHOD)
                continue
            text, ms = _times(cell.ratio) if relative else _ms(cell.ms), None
            if variant.is_papers(column):
                ms = paper_ms(variant.method, column)
            theirs = (
                ""
                if ms is None
                else f" ({_times(ms / paper_ms(REFERENCE.method, column))})"
                if relative
                else f" ({ms:g})"
            )
            cells.append(text + theirs)
        lines.append([variant.label, *cells])
    return table([None, *(c.title for c in on.columns)], lines)


def _early_out(on: OnDevice) -> list[str]:
    gains, theirs, lines = on.early_out(), paper_early_out(), []
    for each in gains:
        gain = f"**{each.gain:.2f}**" if each.pays else f"{each.gain:.2f}"
        rates = (f"{each.fp_whole:.2f}", f"{each.fp_early:.2f}")
        times = f"{each.fp_early / each.fp_whole:.2f}" if each.fp_whole else NO_METHOD
        lines.append([each.column.title + " †" * (not each.trained), gain, f"{theirs[each.column]:.2f}", *rates, times])
    heads = (None, "times as fast", "the paper's", f"FP % `{REFERENCE.name}`", f"FP % `{EARLY.name}`", "FP, ratio")
    faster = sum(e.gain > 1 for e in gains)
    untrained = sum(not e.trained for e in gains)
    note = f"\n† `{REFERENCE.name}` has hardly fewer false positives than a box: the fit was too short, and the gain says little."
    return [
        f"`{EARLY.name}` is the faster one in {faster} of {len(gains)} columns, mean gain {100 * _mean_gain(on):.1f} % (the paper states "
        f"{PAPER_MEAN_GAIN} %); in {sum(e.pays for e in gains)} of them (bold) with at most {MOST_LOSS:g} times as many false positives.",
        "",
        *table(heads, lines),
        *([note] if untrained else []),
    ]
