"""What shows a run of ``table1``, made from the table alone: Table 1 as Markdown, ours beside the paper's, and the rank plot."""

from collections.abc import Iterable, Sequence

from paper.columns import (
    CLASSIC,
    COLUMNS,
    DISTANCE,
    DISTANCE_STEPS,
    EXACT,
    LOCAL,
    LOCAL_PARTS,
    TREE,
    TREE_LEAVES,
    Column,
    Variant,
)
from paper.folder import Folder
from paper.pages.made_with import made_with
from paper.pages.means import Mean, Means
from paper.pages.rank_plot import rank_plot
from paper.pages.table import table
from paper.recipes.page import section
from paper.recipes.rows import read_rows
from paper.rows import PROTOCOLS, Row
from paper.settings import Settings
from warp_bounding.activations import activation_of
from warp_bounding.errors import BoundingError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["NOT_YET", "NO_METHOD", "against_the_paper", "page", "write_outputs", "write_page"]

PICTURE = "rank"

NO_METHOD, NOT_YET, SAME = "–", "…", "="
GROUPS = (
    ("Classic volumes", lambda v: v.method in CLASSIC),
    ("Learned", lambda v: v.learned and v.ranked),
    ("Not conservative, shown for comparison", lambda v: not v.conservative),
    (
        "Exact on the grid that all of them bound, at the price of memory or time: outside the ranking",
        lambda v: v.method in EXACT,
    ),
)
TOLD = {
    LOCAL: f"{LOCAL}: an mlp with a threshold for each of up to {LOCAL_PARTS} parts of its domain, a byte each",
    TREE: f"{TREE}: {TREE_LEAVES} boxes with a network in each, which together hold about what one mlp does",
    DISTANCE: f"{DISTANCE}: one network of the distance an object, which points, rays and boxes of it are asked; a ray by "
    f"{DISTANCE_STEPS['ray']} evaluations at most, a box by {DISTANCE_STEPS['box']}",
}  # of rows that are not named after their method
HEADLINES = {
    "exact": "Truth is exact: any query that touches a cell of the object counts, however thin the touch.",
    "sampled": "Truth as the paper finds it: a query counts if one of some hundred random samples of it hits the object. Thin hits are missed, "
    "so more queries count as *no*, and false positives are more.",
}


def write_page(folder: Folder, failed: Sequence[str] = ()) -> None:
    """Write the Markdown page; see ``write_outputs``."""
    picture = f"{PICTURE}.png"
    there = picture if (folder.path / picture).exists() else None
    write_whole(folder.page, page(folder, failed, there).encode())


def write_outputs(folder: Folder, failed: Sequence[str] = ()) -> list[str]:
    """Write the page and the rank plot.

    Args:
        folder: Whose rows to show.
        failed: Lines about cells that failed.

    Returns:
        What could not be drawn and why, for people.

    Raises:
        FileFormatError: If a file cannot be written.
    """
    pictures, notes = {}, []
    try:
        pictures = rank_plot(folder.rows.values())
    except BoundingError as error:
        notes.append(str(error))
    for kind, content in pictures.items():
        write_whole(folder.path / f"{PICTURE}.{kind}", content)
    write_page(folder, failed)
    return notes


def page(folder: Folder, failed: Sequence[str] = (), picture: str | None = None) -> str:
    """The whole page.

    Args:
        folder: Rows, settings, commands.
        failed: Lines about cells that failed in this run.
        picture: Name of the rank plot in the folder, if there is one.
    """
    rows = list(folder.rows.values())
    tables = [m for m in (Means(rows, p) for p in PROTOCOLS) if m.cells]
    lines = ["# Table 1 of *Neural Bounding*, measured with warp-bounding", ""]
    lines += _made_with(folder, rows)
    if failed:
        lines += ["", "**Failed**, and therefore missing below:", "", *(f"- {line}" for line in failed)]
    if not tables:
        return "\n".join([*lines, "", "Nothing has been measured yet.", ""])
    lines += ["", *_legend(tables)]
    for means in tables:
        lines += ["", f"## False positives, {means.protocol} protocol", "", HEADLINES[means.protocol], ""]
        lines += [*_table(means), "", against_the_paper(means)]
    if picture:
        lines += ["", "## Every object", "", f"![False positives of every object, by method, sorted]({picture})", ""]
        lines += [
            "One panel a dimension. Each method's false-positive rates over all test cases (object × query), sorted: a line that "
            "stays low to the right is tight on the hard cases, too. Where volumes were fitted in both spaces, the upper panels "
            "have those around the object and the lower ones those around query parameters, against the same networks. Lines of methods that exist for fewer queries "
            "are shorter; `bvh-16` and the like, `occupancy` and `voxels` are not drawn. Also as [SVG](rank.svg)."
        ]
    if recipes := section(read_rows(folder.path)):
        lines += ["", *recipes]
    lines += ["", "## Details", "", "False positives in per cent by object; memory and seconds are means over objects."]
    for means in tables:
        for column in means.objects:
            lines += ["", "<details>", f"<summary>{column.title}, {means.protocol}</summary>", ""]
            lines += [*_details(means, column), "", "</details>"]
    return "\n".join([*lines, ""])


def against_the_paper(means: Means, *, plain: bool = False) -> str:
    """Our best network of each column beside the paper's best, in one sentence; empty where there is none.

    Args:
        means: Of one protocol.
        plain: Without Markdown.
    """
    parts, lower, complete = [], 0, 0
    for column, names in means.objects.items():
        found = means.best_network(column)
        if found is None:
            continue
        variant, mean = found
        below = mean.fp_rate < column.paper_network
        lower += below
        complete += len(names) == column.paper_objects
        text = f"**{mean.fp_rate:.2f}**" if below and not plain else f"{mean.fp_rate:.2f}"
        sign = "" if plain else _sign(variant, mean, len(names))
        parts.append(f"{column.title} {text}{sign} ({column.paper_network}, {variant.name})")
    if not parts:
        return ""
    whole = "" if complete == len(parts) else f", {complete} of them over all of the paper's objects"
    head = "Our best network against the paper's best network (in brackets, with the name of ours), mean false positives %: "
    return f"{head}{'; '.join(parts)}. Lower in {lower} of {len(parts)} columns{whole}."


def _made_with(folder: Folder, rows: Sequence[Row]) -> list[str]:
    s = folder.settings
    dimensions = sorted({r.dimension for r in rows})
    counts = ", ".join(f"{len({r.object for r in rows if r.dimension == n})} in {n}D" for n in dimensions) or "none"
    sizes = ", ".join(f"{c.ndim}D {c.hidden}" for c in COLUMNS if not c.kind.is_region)
    monotone = activation_of(s.activation).monotone.name
    replaced = monotone != s.activation and any(r.method == "monotone-mlp" for r in rows)
    facts = [
        f"{_budgets(s)}, its proof included; sizes as in the paper's supplement ({sizes}), activation {s.activation}, seed {s.seed}",
        f"rates over {s.samples:,} random queries (seed {s.sample_seed}), rays of length {s.length:g}",
        *([f"networks that are monotone by construction have {monotone} as their activation"] if replaced else []),
        *(told for method, told in TOLD.items() if any(r.method == method for r in rows)),
        f"device {s.device}",
    ]
    return made_with(folder, f"{len(rows):,} cells in [table1.csv](table1.csv), objects: {counts}", facts)


def _budgets(settings: Settings) -> str:
    others = settings.budgets.replace("=", " ").replace(",", " s, ")
    text = f"{settings.budget:g} s for each learned fit"
    return f"{text}; where others are named, the last that fits: {others} s" if others else text


def _legend(tables: Sequence[Means]) -> list[str]:
    """How to read a cell; only the signs that occur."""
    cells = [(v, m) for t in tables for (v, _), m in t.cells.items()]
    parametric = any(v.parametric for v, _ in cells)
    lines = [
        "A cell is **our** mean false-positive rate over objects, in per cent of all queries, and in brackets the paper's (sampled truth, "
        "all its objects). Lower is better. **Bold**: the tightest conservative bounder of the column.",
        "Every row but `occupancy` promises to have no false negative; the column of these counts those that were found.",
        "Memory: what a query can read, the mean of all bounders of a row in a dimension. On so coarse a grid the object itself is small: `voxels` is one bit a "
        "cell, and is asked about points only.",
    ]
    if parametric:
        lines.append(
            "`(parametric)`: a volume around the parameters of the queries (a ray's origin and direction), as in the paper, whose figures stand "
            "there (where there is no such row, beside the other); without: around the object, met by the query as an engineer would test it."
        )
    signs = {
        f"`{SAME}` the same as the row above: a point is its own parameters": parametric,
        f"`{NO_METHOD}` there is no such bounder": True,
        f"`{NOT_YET}` not measured (yet)": True,
        "<sup>s</sup> a statistical bound on false negatives instead of a proof; without it: proven": any(
            "statistical" in m.kinds for _, m in cells
        ),
        "<sup>2s</sup> proven for all objects but 2, for example": any(
            v.conservative and 0 < m.unproven < m.objects for v, m in cells
        ),
        "<sup>u</sup> neither proven nor bounded": any(v.conservative and not m.certified for v, m in cells),
        "<sup>1/9</sup> a mean over 1 of the column's 9 objects, for example": any(not m.complete for _, m in cells),
    }
    lines.append("; ".join(sign for sign, occurs in signs.items() if occurs) + ".")
    return [f"- {line}" for line in lines]


def _table(means: Means) -> list[str]:
    columns, lines = list(means.objects), []
    dimensions = sorted({c.ndim for c in columns})
    counts = (
        str(len(names)) if len(names) == c.paper_objects else f"{len(names)} (of {c.paper_objects})"
        for c, names in means.objects.items()
    )
    lines.append(["*objects*", *counts, None, None])
    for heading, belongs in GROUPS:
        variants = [v for v in means.variants if belongs(v)]
        if variants:
            lines.append([f"*{heading}*", *[None] * (len(columns) + 2)])
        for variant in variants:
            missed, samples = means.missed(variant)
            text = f"{missed:,} of {samples:,}"
            if variant.conservative:
                text = f"**{missed:,}** of {samples:,}, **promise broken**" if missed else f"0 of {samples:,}"
            lines.append(
                [
                    variant.label,
                    *(_cell(means, variant, column) for column in columns),
                    text,
                    _memory(means, variant, dimensions),
                ]
            )
            if not variant.conservative:
                rates = [f"{m.fn_rate:.3f}" if (m := means.cells.get((variant, c))) else NO_METHOD for c in columns]
                lines.append([f"{variant.label}, **false negatives %**", *rates, None, None])
    memory = f"memory, {' / '.join(f'{n}D' for n in dimensions)}"
    return table([None, *(c.title for c in columns), "false negatives", memory], lines)


def _memory(means: Means, variant: Variant, dimensions: Sequence[int]) -> str:
    """Mean bytes of a row's bounders, by dimension."""
    held = {n: [r.nbytes for r in means.rows if r.variant == variant and r.dimension == n] for n in dimensions}
    return " / ".join(_size(sum(found) / len(found)) if found else NO_METHOD for found in held.values())


def _cell(means: Means, variant: Variant, column: Column) -> str:
    mean, paper = means.cells.get((variant, column)), variant.paper(column)
    if mean is not None:
        text = f"{mean.fp_rate:.2f}"
        text = f"**{text}**" if variant in means.best(column) else text
        text += _sign(variant, mean, len(means.objects[column]))
    elif variant.parametric and not column.kind.is_region:
        text = SAME
    else:
        text = NOT_YET if variant.space_in(column) else NO_METHOD
    return text if paper is None else f"{text} ({paper})"


def _sign(variant: Variant, mean: Mean, objects: int) -> str:
    signs = []
    if variant.conservative and not mean.proven:
        count = "" if mean.unproven == mean.objects else f"{mean.unproven}"
        signs.append(f"{count}s" if mean.certified else f"{count}u")
    if not mean.complete:
        signs.append(f"{mean.objects}/{objects}")
    return f"<sup>{' '.join(signs)}</sup>" if signs else ""


def _details(means: Means, column: Column) -> list[str]:
    """One column of the table, object by object."""
    objects = means.objects[column]
    rows = {(r.variant, r.object): r for r in means.rows if r.column == column}
    positives = {name: f"{r.positives:.2f}" for (_, name), r in reversed(rows.items())}
    lines = [["*positives %*", *(positives[o] for o in objects), None, None, None]]
    for variant in means.variants:
        found = {o: rows[variant, o] for o in objects if (variant, o) in rows}
        if found:
            cells = (_detail(found[o]) if o in found else NOT_YET for o in objects)
            memory = _size(sum(r.nbytes for r in found.values()) / len(found))
            seconds = (_seconds(getattr(r, name) for r in found.values()) for name in ("fit_seconds", "proof_seconds"))
            lines.append([variant.label, *cells, memory, *seconds])
    return table([None, *objects, "memory", "fit s", "proof s"], lines)


def _detail(row: Row) -> str:
    sign = {"proven": "", "statistical": "<sup>s</sup>"}.get(row.certificate, "<sup>u</sup>")
    missed = f" **({row.fn:,} FN)**" if row.fn else ""
    return f"{row.fp_rate:.3f}{sign if row.variant.conservative else ''}{missed}"


def _size(nbytes: float) -> str:
    return f"{nbytes:.0f} B" if nbytes < 1024 else f"{nbytes / 1024:.1f} kB"


def _seconds(values: Iterable[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{sum(known) / len(known):.2f}" if known else NO_METHOD
