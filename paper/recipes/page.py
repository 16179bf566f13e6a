"""What is shown of the recipes: a section of Table 1's page, and the folder's own page, which is the same section."""

from collections.abc import Sequence

from paper.columns import COLUMNS
from paper.folder import Folder
from paper.pages.table import table
from paper.recipes.rows import WAYS, RecipeRow
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["section", "write_page"]

NONE = "–"
ROWS = {
    "default": "ours",
    "default+encoding": "ours, positional encoding",
    "paper": "the paper's recipe",
    "paper+encoding": "the paper's recipe and encoding",
}
HEADS = (
    None,
    "object",
    "training",
    "steps",
    "of at least",
    "which take",
    "FP %, threshold proven",
    "FP % at 0.5",
    "FN % at 0.5",
    "paper's mean FP %",
)


def section(rows: Sequence[RecipeRow]) -> list[str]:
    """Lines of Markdown under a heading; none where there are no rows."""
    if not rows:
        return []
    order = list(WAYS)
    rows = sorted(rows, key=lambda r: (COLUMNS.index(r.column), r.object, order.index(r.way)))
    seconds = " or ".join(sorted({f"{r.seconds:g} s" for r in rows}))
    hours = [r.hours_asked for r in rows if r.hours_asked is not None]
    told = ""
    if hours:
        told = f" That would be {_hours(min(hours))} to {_hours(max(hours))} a network." if len(hours) > 1 else ""
    commands = f"on {max(r.threads for r in rows)} CPU threads"
    return [
        "## The paper's recipe and its positional encoding",
        "",
        f"The same network in the same time, {seconds} {commands}, proof included: by our recipe and by the paper's "
        '(`recipe="paper"`: uniform batches of 200,000, Adam, weights that change every 10,000 steps, at least seven times), with its '
        "positional encoding (`octaves=4`) and without. The paper's recipe asks for a number of steps, not for a time: *of at least* says how many, and "
        f"*which take* how long that is at the pace measured here (by the clock: other work on the machine lengthens it).{told} What it has reached when the time is over is its row; it is not what the "
        "whole schedule reaches, for which the paper's own mean stands in the last column (sampled truth, all its objects).",
        "",
        "*FP %, threshold proven*: with the threshold that a proof has set, so that there is no false negative; *at 0.5*: as the paper asks its "
        "networks, without a proof, and then with the false negatives beside it. Both in per cent of all queries, exact truth.",
        "",
        *table(HEADS, [_line(r) for r in rows], left=(0, 1, 2)),
    ]


def _line(row: RecipeRow) -> list[str]:
    sign = "" if row.certificate == "proven" else "<sup>s</sup>" if row.certificate else "<sup>u</sup>"
    asked, hours = row.steps_asked, row.hours_asked
    column = row.column
    return [
        column.title,
        row.object,
        ROWS[row.way],
        f"{row.steps:,}",
        NONE if asked is None else f"{asked:,}",
        NONE if hours is None else _hours(hours),
        f"{row.fp_rate:.2f}{sign}",
        f"{row.fp_zero:.2f}",
        f"{100 * row.fn_zero / row.samples:.3f}",
        f"{row.variant.paper(column):g}",
    ]


def _hours(hours: float) -> str:
    return f"{hours:.1f} h" if hours >= 0.95 else f"{60 * hours:.0f} min"


def write_page(folder: Folder, failed: Sequence[str] = ()) -> None:
    """Write the folder's own page; ``failed`` are lines about networks that failed in this run."""
    rows = list(folder.rows.values())
    lines = ["# Recipes", "", "Made with", "", "```", *(folder.commands or ["(no command yet)"]), "```", ""]
    lines += [f"- {version}" for version in sorted({r.versions for r in rows})]
    if failed:
        lines += ["", "**Failed**, and therefore missing below:", "", *(f"- {line}" for line in failed)]
    lines += ["", *(section(rows) or ["Nothing has been measured yet."]), ""]
    write_whole(folder.page, "\n".join(lines).encode())
