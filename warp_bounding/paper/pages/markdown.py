"""What shows a run of ``table1``, made from the table alone: Table 1 as Markdown, ours beside the paper's, and the rank plot."""

from collections.abc import Sequence

from warp_bounding.activations import activation_of
from warp_bounding.errors import BoundingError
from warp_bounding.paper.columns import COLUMNS, Column, Supports, Variant
from warp_bounding.paper.folder import Folder
from warp_bounding.paper.pages.means import Mean, Means
from warp_bounding.paper.pages.rank_plot import rank_plot
from warp_bounding.paper.rows import PROTOCOLS, Row
from warp_bounding.paper.settings import Settings
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["against_the_paper", "page", "write_outputs", "write_page"]

PICTURE = "rank"

NO_METHOD, NOT_YET, SAME = "–", "…", "="
GROUPS = (
    ("Classic volumes", lambda v: v.classic),
    ("Learned", lambda v: v.learned and v.ranked),
    ("Not conservative, shown for comparison", lambda v: not v.conservative),
    ("Exact on its own grid, at the price of its memory: outside the ranking", lambda v: v.method == "voxels"),
)
HEADLINES = {
    "exact": "Truth is exact: any query that touches a cell of the object counts, however thin the touch.",
    "sampled": "Truth as the paper finds it: a query counts if one of some hundred random samples of it hits the object. Thin hits are missed, "
    "so more queries count as *no*, and false positives are more.",
}


def write_page(folder: Folder, supports: Supports, failed: Sequence[str] = ()) -> None:
    """Write the Markdown page; see ``write_outputs``."""
    picture = f"{PICTURE}.png"
    there = picture if (folder.path / picture).exists() else None
    write_whole(folder.page, page(folder, supports, failed, there).encode())


def write_outputs(folder: Folder, supports: Supports, failed: Sequence[str] = ()) -> list[str]:
    """Write the page and the rank plot.

    Args:
        folder: Whose rows to show.
        supports: Which bounders exist at all.
        failed: Lines about cells that failed.

    Returns:
        What could not be drawn and why, for people.

    Raises:
        FileFormatError: If a file cannot be written.
    """
    notes = []
    try:
        pictures = rank_plot(folder.rows.values())
    except BoundingError as error:
        pictures = {}
        notes.append(str(error))
    for kind, content in pictures.items():
        write_whole(folder.path / f"{PICTURE}.{kind}", content)
    write_page(folder, supports, failed)
    return notes


def page(folder: Folder, supports: Supports, failed: Sequence[str] = (), picture: str | None = None) -> str:
    """The whole page.

    Args:
        folder: Rows, settings, commands.
        supports: Which bounders exist at all.
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
        lines += [*_table(means, supports), "", against_the_paper(means)]
    if picture:
        lines += ["", "## Every object", "", f"![False positives of every object, by method, sorted]({picture})", ""]
        lines += [
            "One panel a dimension. Each method's false-positive rates over all test cases (object × query), sorted: a line that "
            "stays low to the right is tight on the hard cases, too. Where volumes were fitted in both spaces, the upper panels "
            "have those around the object and the lower ones those around query parameters, against the same networks. Lines of methods that exist for fewer queries "
            "are shorter; `bvh-16` and the like, `occupancy` and `voxels` are not drawn. Also as [SVG](rank.svg)."
        ]
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
    objects = {n: len({r.object for r in rows if r.dimension == n}) for n in sorted({r.dimension for r in rows})}
    threads = sorted({str(r.threads) for r in rows}) or ["?"]
    monotone = activation_of(s.activation).monotone.name
    replaced = monotone != s.activation and any(r.method == "monotone-mlp" for r in rows)
    commands, versions = folder.commands or ["(no command yet)"], sorted({r.versions for r in rows})
    counts = ", ".join(f"{count} in {n}D" for n, count in objects.items()) or "none"
    lines = [
        f"{len(rows):,} cells in [table1.csv](table1.csv), objects: {counts}; made with `{commands[0]}`.",
        "",
        "<details>",
        "<summary>Commands, settings and versions</summary>",
        "",
        "```",
        *commands,
        "```",
        "",
    ]
    lines += [
        f"- {_budgets(s)}, its proof included; sizes as in the paper's supplement "
        f"({', '.join(f'{c.ndim}D {c.hidden}' for c in COLUMNS if not c.kind.is_region)}), activation {s.activation}, seed {s.seed}",
        f"- rates over {s.samples:,} random queries (seed {s.sample_seed}), rays of length {s.length:g}",
        *([f"- networks that are monotone by construction have {monotone} as their activation"] if replaced else []),
        f"- device {s.device}, CPU threads {' and '.join(threads)}",
    ]
    return [*lines, *(f"- {version}" for version in versions), "", "</details>"]


def _budgets(settings: Settings) -> str:
    others = settings.budgets.replace("=", " ").replace(",", " s, ")
    text = f"{settings.budget:g} s for each learned fit"
    return f"{text}; where others are named, the last that fits: {others} s" if others else text


def _legend(tables: Sequence[Means]) -> list[str]:
    """How to read a cell; only the signs that occur."""
    cells = [(v, m) for t in tables for (v, _), m in t.cells.items()]
    lines = [
        "A cell is **our** mean false-positive rate over objects, in per cent of all queries, and in brackets the paper's (sampled truth, "
        "all its objects). Lower is better. **Bold**: the tightest conservative bounder of the column.",
        "Every row but `occupancy` promises to have no false negative; the last column counts those that were found.",
    ]
    if any(v.parametric for v, _ in cells):
        lines.append(
            "`(parametric)`: a volume around the parameters of the queries (a ray's origin and direction), as in the paper, whose figures stand "
            "there (where there is no such row, beside the other); without: around the object, met by the query as an engineer would test it."
        )
    signs = {
        f"`{SAME}`": ("the same as the row above: a point is its own parameters", any(v.parametric for v, _ in cells))
    }
    signs["`–`"] = ("there is no such bounder", True)
    signs["`…`"] = ("not measured (yet)", True)
    signs["<sup>s</sup>"] = (
        "a statistical bound on false negatives instead of a proof; without it: proven",
        any("statistical" in m.kinds for _, m in cells),
    )
    signs["<sup>2s</sup>"] = (
        "proven for all objects but 2, for example",
        any(v.conservative and 0 < m.unproven < m.objects for v, m in cells),
    )
    signs["<sup>u</sup>"] = ("neither proven nor bounded", any(v.conservative and not m.certified for v, m in cells))
    signs["<sup>1/9</sup>"] = (
        "a mean over 1 of the column's 9 objects, for example",
        any(not m.complete for _, m in cells),
    )
    lines.append("; ".join(f"{sign} {meaning}" for sign, (meaning, occurs) in signs.items() if occurs) + ".")
    return [f"- {line}" for line in lines]


def _table(means: Means, supports: Supports) -> list[str]:
    columns = list(means.objects)
    lines = [
        "| | " + " | ".join(c.title for c in columns) + " | false negatives |",
        "|---|" + "---:|" * (len(columns) + 1),
    ]
    counts = [
        str(len(names)) if len(names) == c.paper_objects else f"{len(names)} (of {c.paper_objects})"
        for c, names in means.objects.items()
    ]
    lines.append(f"| *objects* | {' | '.join(counts)} | |")
    for heading, belongs in GROUPS:
        variants = [v for v in means.variants if belongs(v)]
        if not variants:
            continue
        lines.append(f"| *{heading}* |" + " |" * (len(columns) + 1))
        for variant in variants:
            cells = [_cell(means, variant, column, supports) for column in columns]
            missed, samples = means.missed(variant)
            if not variant.conservative:
                lines.append(f"| {variant.label} | {' | '.join(cells)} | {missed:,} of {samples:,} |")
                rates = [f"{m.fn_rate:.3f}" if (m := means.cells.get((variant, c))) else NO_METHOD for c in columns]
                lines.append(f"| {variant.label}, **false negatives %** | {' | '.join(rates)} | |")
                continue
            text = f"**{missed:,}** of {samples:,}, **promise broken**" if missed else f"0 of {samples:,}"
            lines.append(f"| {variant.label} | {' | '.join(cells)} | {text} |")
    return lines


def _cell(means: Means, variant: Variant, column: Column, supports: Supports) -> str:
    mean, paper = means.cells.get((variant, column)), variant.paper(column, supports)
    if mean is not None:
        text = f"{mean.fp_rate:.2f}"
        text = f"**{text}**" if variant in means.best(column) else text
        text += _sign(variant, mean, len(means.objects[column]))
    elif variant.parametric and not column.kind.is_region:
        text = SAME
    else:
        text = NOT_YET if variant.space_in(column, supports) else NO_METHOD
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
    positives = [next(r.positives for (_, name), r in rows.items() if name == o) for o in objects]
    lines = [
        f"| | {' | '.join(objects)} | memory | fit s | proof s |",
        "|---|" + "---:|" * (len(objects) + 3),
        f"| *positives %* | {' | '.join(f'{p:.2f}' for p in positives)} | | | |",
    ]
    for variant in means.variants:
        own = [rows.get((variant, o)) for o in objects]
        found = [r for r in own if r is not None]
        if not found:
            continue
        cells = [_detail(r) if r is not None else NOT_YET for r in own]
        memory = _size(sum(r.nbytes for r in found) / len(found))
        seconds = [_seconds([r.fit_seconds for r in found]), _seconds([r.proof_seconds for r in found])]
        lines.append(f"| {variant.label} | {' | '.join([*cells, memory, *seconds])} |")
    return lines


def _detail(row: Row) -> str:
    sign = {"proven": "", "statistical": "<sup>s</sup>"}.get(row.certificate, "<sup>u</sup>")
    missed = f" **({row.fn:,} FN)**" if row.fn else ""
    return f"{row.fp_rate:.3f}{sign if row.variant.conservative else ''}{missed}"


def _size(nbytes: float) -> str:
    return f"{nbytes:.0f} B" if nbytes < 1024 else f"{nbytes / 1024:.1f} kB"


def _seconds(values: Sequence[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"{sum(known) / len(known):.2f}" if known else NO_METHOD
