"""``README.md`` of a ``proofs`` run: what sampling would have shipped, and what a proof costs."""

from collections.abc import Callable, Iterable, Sequence

from warp_bounding.paper.columns import COLUMNS
from warp_bounding.paper.folder import Folder
from warp_bounding.paper.proofs import PROOF_COST
from warp_bounding.paper.rows import ProofRow

__all__ = ["proofs_page", "summary", "summary_text"]

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


def proofs_page(folder: Folder, failed: Sequence[str] = ()) -> str:
    """The whole page.

    Args:
        folder: Rows, settings, commands.
        failed: Lines about networks that failed in this run.
    """
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
    for method in dict.fromkeys(r.method for r in sorted(rows, key=lambda r: r.method)):
        own = [r for r in rows if r.method == method]
        lines += ["", f"## {method}: what sampling would have shipped", "", *_shipped(own)]
        lines += ["", f"## {method}: what the proof costs", "", *_proofs(own)]
    lines += ["", "## Every network", "", *_every(rows)]
    return "\n".join([*lines, ""])


def _shipped(rows: Sequence[ProofRow]) -> list[str]:
    return _table(
        rows,
        {
            "networks": lambda g: str(len(g)),
            "with a FN at output 0.5": lambda g: _count([r.missed_zero for r in g]),
            "FN rate there, uniform, %": lambda g: _known([r.fn_zero for r in g], [r.samples for r in g]),
            "FN rate there, hard positives, %": lambda g: _known(
                [r.hard_fn_zero for r in g], [r.hard_positives for r in g]
            ),
            "with a FN at the sampled minimum": lambda g: f"**{sum(r.missed_sampled for r in g)}** of {len(g)}",
            "found from the prover's points": lambda g: str(sum(r.found_by == "prover" for r in g)),
            "depth, std of f, mean (worst)": lambda g: _worst([r.depth_std for r in g]),
            "depth, FP %, mean (worst)": lambda g: _worst([r.depth_fp for r in g]),
        },
    )


def _proofs(rows: Sequence[ProofRow]) -> list[str]:
    return _table(
        rows,
        {
            "searches complete": lambda g: f"{sum(r.search == 'complete' for r in g)} of {len(g)}",
            "FP % at output 0.5": lambda g: _known([r.fp_zero for r in g], digits=3),
            "FP % sampled": lambda g: f"{_mean(r.fp_sampled for r in g):.3f}",
            "FP % proven": lambda g: f"**{_mean(r.fp_proven for r in g):.3f}**",
            "cost of the proof, FP %, mean (worst)": lambda g: _worst([r.fp_proven - r.fp_sampled for r in g]),
            "FN found at the proven threshold": lambda g: str(sum(r.fn_proven for r in g)),
            "gap, worst": lambda g: f"{max(r.gap for r in g):.2g}",
            "boxes, mean": lambda g: f"{_mean(r.boxes for r in g):,.0f}",
            "seconds, mean (worst)": lambda g: _worst([r.proof_seconds for r in g], 2),
        },
    )


def _every(rows: Sequence[ProofRow]) -> list[str]:
    lines = [
        "| | object | method | search | FP % sampled | FP % proven | FN at 0.5 | FN at the sampled minimum | depth, std | boxes | s |",
        "|---|---|---|---|---:|---:|---|---|---:|---:|---:|",
    ]
    for r in sorted(rows, key=lambda r: (COLUMNS.index(r.column), r.object, r.method)):
        missed = f"yes, by the {r.found_by}" if r.missed_sampled else "none found"
        zero = NONE if r.missed_zero is None else "yes" if r.missed_zero else "none found"
        depth = f"{r.depth_std:.3g}" if r.depth_std is not None else ""
        lines.append(
            f"| {r.column.title} | {r.object} | {r.method} | {r.search} | {r.fp_sampled:.3f} | {r.fp_proven:.3f} | "
            f"{zero} | {missed} | {depth} | {r.boxes:,} | {r.proof_seconds:.2f} |"
        )
    return lines


def _table(rows: Sequence[ProofRow], cells: dict[str, Callable[[list[ProofRow]], str]]) -> list[str]:
    """A line for each column that has rows, a cell for each of some numbers."""
    lines = [f"| | {' | '.join(cells)} |", "|---|" + "---:|" * len(cells)]
    groups = {c.title: [r for r in rows if r.column == c] for c in COLUMNS}
    if len({r.column for r in rows}) > 1:
        groups["*all*"] = list(rows)
    for title, group in groups.items():
        if group:
            lines.append(f"| {title} | {' | '.join(cell(group) for cell in cells.values())} |")
    return lines


def _mean(values: Iterable[float]) -> float:
    values = list(values)
    return sum(values) / len(values)


def _count(values: Sequence[int | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{sum(known)} of {len(known)}" if known else NONE


def _known(values: Sequence[float | None], totals: Sequence[int] = (), digits: int = 4) -> str:
    """Mean of what is known, or of its per cent of totals."""
    if totals:
        values = [None if v is None else 100 * v / t for v, t in zip(values, totals, strict=True)]
    known = [v for v in values if v is not None]
    return f"{_mean(known):.{digits}f}" if known else NONE


def _worst(values: Sequence[float | None], digits: int = 3) -> str:
    known = [v for v in values if v is not None]
    return f"{_mean(known):.{digits}f} ({max(known):.{digits}f})" if known else NONE
