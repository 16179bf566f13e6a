"""``README.md`` of a ``proofs`` run: what sampling would have shipped, and what a proof costs."""

from collections.abc import Callable, Iterable, Sequence

from paper.columns import COLUMNS
from paper.folder import Folder
from paper.pages.table import table
from paper.proofs import PROOF_COST
from paper.rows import ProofRow
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["proofs_page", "summary", "summary_text", "write_page"]

NONE = "–"


def summary(rows: Iterable[ProofRow]) -> dict[str, int]:
    """Counts over networks."""
    rows = list(rows)
    missed = [r for r in rows if r.missed_sampled]
    return {
        "networks": len(rows),
        "complete": sum(r.search == "complete" for r in rows),
        "missed_sampled": len(missed),
        "found_by_prover": sum(r.found_by == "prover" for r in missed),
        "with_output": sum(r.missed_zero is not None for r in rows),
        "missed_zero": sum(bool(r.missed_zero) for r in rows),
        "missed_proven": sum(r.fn_proven > 0 for r in rows),
    }


def summary_text(rows: Sequence[ProofRow]) -> str:
    """One sentence."""
    s = summary(rows)
    if not rows:
        return "No network has been measured yet."
    positives = min(r.hard_positives for r in rows)
    return (
        f"Of {s['networks']} networks thresholded at their minimum over at least {positives:,} hard positives, "
        f"{s['missed_sampled']} had a false negative that the search found ({s['found_by_prover']} from the prover's own lowest "
        f"points); of the {s['with_output']} with an output between 0 and 1, {s['missed_zero']} had one when thresholded at 0.5; at the proven threshold, "
        f"{s['missed_proven']}."
    )


def write_page(folder: Folder, failed: Sequence[str] = ()) -> None:
    """Write the page; ``failed`` are lines about networks that failed in this run."""
    write_whole(folder.page, proofs_page(folder, failed).encode())


def proofs_page(folder: Folder, failed: Sequence[str] = ()) -> str:
    """The whole page; see ``write_page``."""
    rows, s = list(folder.rows.values()), folder.settings
    lines = ["# What a proof is worth: networks thresholded by sampling and by proof", "", "Made with", "", "```"]
    lines += [*(folder.commands or ["(no command yet)"]), "```", ""]
    lines += [
        f"- sampled threshold: the least f over at least {s.positives:,} fresh hard positives (half uniform queries that meet the "
        "object, half grazing ones)",
        f"- rates over the same {s.samples:,} uniform queries at every threshold, exact truth",
        f"- at most {s.seconds:g} s for a proof: its threshold holds wherever the search ends; *complete* says that it came as near to "
        f"the least f as costs {PROOF_COST:.2%} of all queries, *cut short* that time or rounding kept it from that",
        f"- networks fitted with a budget of {s.fits.budget_text} s",
        *(f"- {version}" for version in sorted({r.versions for r in rows})),
    ]
    if failed:
        lines += ["", "**Failed**, and therefore missing below:", "", *(f"- {line}" for line in failed)]
    lines += ["", f"**{summary_text(rows)}**"]
    if not rows:
        return "\n".join([*lines, ""])
    lines += [
        "",
        "A false negative counts if a float32 query was found that the exact oracle affirms and the deployed kernel denies.",
    ]
    for method in sorted({r.method for r in rows}):
        own = [r for r in rows if r.method == method]
        lines += ["", f"## {method}: what sampling would have shipped", "", *_by_column(own, SHIPPED)]
        lines += ["", f"## {method}: what the proof costs", "", *_by_column(own, COSTS)]
    rows.sort(key=lambda r: (COLUMNS.index(r.column), r.object, r.method))
    left = [i for i, head in enumerate(EVERY) if head in WORDS]
    every = table(list(EVERY), ([cell(r) for cell in EVERY.values()] for r in rows), left)
    return "\n".join([*lines, "", "## Every network", "", *every, ""])


def _by_column(rows: Sequence[ProofRow], cells: dict[str, Callable[[Sequence[ProofRow]], str]]) -> list[str]:
    """A line for each column of Table 1 that has rows, a cell for each of some numbers."""
    groups = {c.title: [r for r in rows if r.column == c] for c in COLUMNS}
    groups = {title: group for title, group in groups.items() if group}
    groups |= {"*all*": rows} if len(groups) > 1 else {}
    return table(
        [None, *cells], ([title, *(cell(group) for cell in cells.values())] for title, group in groups.items())
    )


def _mean(values: Iterable[float | None], digits: int = 3, worst: bool = False) -> str:
    """Mean of what is known, and the largest where wanted."""
    known = [v for v in values if v is not None]
    text = f"{sum(known) / len(known):,.{digits}f}" if known else NONE
    return f"{text} ({max(known):,.{digits}f})" if known and worst else text


def _count(values: Iterable[int | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{sum(known)} of {len(known)}" if known else NONE


def _share(values: Iterable[tuple[int | None, int]]) -> str:
    """Mean of counts in per cent of their totals."""
    return _mean((None if v is None else 100 * v / total for v, total in values), 4)


SHIPPED = {
    "networks": lambda g: str(len(g)),
    "with a FN at output 0.5": lambda g: _count(r.missed_zero for r in g),
    "FN rate there, uniform, %": lambda g: _share((r.fn_zero, r.samples) for r in g),
    "FN rate there, hard positives, %": lambda g: _share((r.hard_fn_zero, r.hard_positives) for r in g),
    "with a FN at the sampled minimum": lambda g: f"**{sum(r.missed_sampled for r in g)}** of {len(g)}",
    "found from the prover's points": lambda g: str(sum(r.found_by == "prover" for r in g)),
    "depth, std of f, mean (worst)": lambda g: _mean((r.depth_std for r in g), worst=True),
    "depth, FP %, mean (worst)": lambda g: _mean((r.depth_fp for r in g), worst=True),
}
COSTS = {
    "searches complete": lambda g: f"{sum(r.search == 'complete' for r in g)} of {len(g)}",
    "FP % at output 0.5": lambda g: _mean(r.fp_zero for r in g),
    "FP % sampled": lambda g: _mean(r.fp_sampled for r in g),
    "FP % proven": lambda g: f"**{_mean(r.fp_proven for r in g)}**",
    "cost of the proof, FP %, mean (worst)": lambda g: _mean((r.fp_proven - r.fp_sampled for r in g), worst=True),
    "FN found at the proven threshold": lambda g: str(sum(r.fn_proven for r in g)),
    "gap, worst": lambda g: f"{max(r.gap for r in g):.2g}",
    "boxes, mean": lambda g: _mean((r.boxes for r in g), 0),
    "seconds, mean (worst)": lambda g: _mean((r.proof_seconds for r in g), 2, worst=True),
}
EVERY = {
    None: lambda r: r.column.title,
    "object": lambda r: r.object,
    "method": lambda r: r.method,
    "search": lambda r: r.search,
    "FP % sampled": lambda r: f"{r.fp_sampled:.3f}",
    "FP % proven": lambda r: f"{r.fp_proven:.3f}",
    "FN at 0.5": lambda r: NONE if r.missed_zero is None else "yes" if r.missed_zero else "none found",
    "FN at the sampled minimum": lambda r: f"yes, by the {r.found_by}" if r.missed_sampled else "none found",
    "depth, std": lambda r: "" if r.depth_std is None else f"{r.depth_std:.3g}",
    "boxes": lambda r: f"{r.boxes:,}",
    "s": lambda r: f"{r.proof_seconds:.2f}",
}
WORDS = (None, "object", "method", "search", "FN at 0.5", "FN at the sampled minimum")  # aligned to the left
