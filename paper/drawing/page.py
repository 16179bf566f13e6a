"""``README.md`` of a folder of figures: every figure that is there, with its caption and what was measured."""

from collections.abc import Sequence

from paper.drawing.base import Figure
from paper.drawing.folder import PAGE, FigureFolder
from paper.drawing.settings import PAPER
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["write_page"]


def write_page(folder: FigureFolder, figures: Sequence[Figure]) -> None:
    """Write the page.

    Raises:
        FileFormatError: If it cannot be written.
    """
    lines = ["# The figures of *Neural Bounding*, made with warp-bounding", ""]
    lines += _made_with(folder)
    for figure in figures:
        pictures, found = folder.pictures(figure.name), folder.read(figure.name)
        parts = found["parts"]
        if not pictures or not parts:
            continue
        shown = pictures.get("png") or next(iter(pictures.values()))
        also = f" Also as [SVG]({figure.name}.svg)." if "svg" in pictures and shown.suffix != ".svg" else ""
        lines += ["", f"## {figure.title}", "", f"![{figure.title}]({shown.name})", ""]
        lines += [f"`{figure.name}`: {figure.paper}. {figure.caption}{also}"]
        try:
            facts = figure.facts(parts)
        except KeyError:  # parts of a run that has not ended
            facts = []
        seconds = sum(part.get("seconds", 0.0) for part in parts.values())
        facts += [
            f"Computed in {seconds:,.0f} s by {'; '.join(found['versions'])}; numbers: [{figure.name}.json]({figure.name}.json)."
        ]
        lines += ["", *(f"- {fact}" for fact in facts)]
    write_whole(folder.path / PAGE, ("\n".join(lines) + "\n").encode())


def _made_with(folder: FigureFolder) -> list[str]:
    s = folder.settings
    whose = "the paper's objects" if s.objects == PAPER else "shapes of our own, since the paper's data was not given"
    forms = ["the quick forms (`--quick`)"] if s.quick else []
    forms += [f"every fit for {s.effort:g} times its usual seconds"] if s.effort != 1 else []
    made = f" In {' and '.join(forms)}." if forms else ""
    return [
        f"Shown are {whose}.{made} Rates are over {s.samples:,} random queries, seed {s.seed + 1}; fits have seed {s.seed}. FP and FN, false "
        "positives and negatives, are in per cent of all queries. Every bounder but `occupancy`, and what a caption names, holds a certificate.",
        "",
        "```",
        *folder.commands,
        "```",
    ]
