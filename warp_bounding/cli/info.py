"""``warp-bounding info``: what a bounder file holds, and what is proven of it."""

from rich.console import Console
from rich.table import Table

from warp_bounding.cli.options import BounderFile, Json
from warp_bounding.cli.output import certificate_summary, print_json, quiet_warp

__all__ = ["command"]

WIDEST = 110  # columns: longer lines are hard to read
MOST_SIZES = 90  # characters of the line ``sizes``; the rest is left out


def command(file: BounderFile, json: Json = False) -> int:
    """Describe FILE: method, sizes, what is proven and what is not. Exit status 1 if it holds no proof."""
    from warp_bounding.bounders import load
    from warp_bounding.bounders.voxels import Voxels
    from warp_bounding.certificates.statement import statement
    from warp_bounding.indicators.parts import SIDES

    quiet_warp()
    bounder = load(file, device="cpu")
    certificate, info, words = bounder.certificate, bounder.info, statement(bounder)
    proven = certificate is not None and certificate.proven
    if json:
        kept = ("name", "indicator", "grid_shape", "margin", "resolution", "seed", "note", "library")
        sizes = {} if isinstance(bounder, Voxels) else bounder.sizes
        print_json(
            {
                "path": file,
                "method": bounder.method,
                "query": bounder.query_kind,
                "dimension": bounder.ndim,
                "side": SIDES[bounder.domain.unbounded],
                "length": bounder.domain.length,
                "conservative": bounder.conservative,
                "bytes": bounder.nbytes,
                "threshold": float(bounder.threshold),
                **sizes,
                **{name: info.get(name) for name in (*kept, "training", "rates")},
                "certificate": certificate_summary(bounder, certificate),
                "statement": words,
            }
        )
        return 0 if proven else 1
    out = Console(highlight=False, markup=False, emoji=False)
    out.width = min(WIDEST, out.width) if out.is_terminal else WIDEST
    table = Table(show_header=False, box=None, pad_edge=False, expand=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    sizes = ", ".join(f"{key} {value}" for key, value in bounder.sizes.items())
    side = " from the inside" if bounder.domain.unbounded else ""
    about = f"{bounder.ndim}D {bounder.query_kind} queries{side}, {bounder.nbytes:,} bytes"
    table.add_row("method", f"{bounder.method}, {about}")
    if sizes:
        table.add_row("sizes", sizes if len(sizes) <= MOST_SIZES else sizes[:MOST_SIZES] + " ...")
    if bounder.tightness:
        table.add_row("tightness", bounder.tightness)
    styles = {"certificate": "green" if proven else "yellow", "note": "yellow"}
    for key, value in words.items():
        table.add_row(key, value, style=styles.get(key))
    if not certificate:
        table.add_row("threshold", f"{float(bounder.threshold):.9g}")
    out.print(table)
    return 0 if proven else 1
