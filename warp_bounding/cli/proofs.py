"""``warp-bounding proofs``: what networks with a sampled threshold miss, and what a proof costs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from warp_bounding.cli.output import Json, console, print_json, quiet_warp
from warp_bounding.cli.table1 import command_line, words_of
from warp_bounding.errors import BounderError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["command"]


def command(
    data: Annotated[str, typer.Option(help="Folder with 2D/*.png, 3D/*.binvox, 4D/*.npy.")],
    table: Annotated[
        str, typer.Option(help="Folder of a `table1` run, with its bounders; what is missing is fitted anew.")
    ],
    out: Annotated[str, typer.Option(help="Folder for the results; an earlier run there is continued.")],
    columns: Annotated[str | None, typer.Option(help="Such as 2d-point,3d-ray; or 2d, or ray (default: all)")] = None,
    methods: Annotated[str | None, typer.Option(help="Among mlp,monotone-mlp (default: all)")] = None,
    objects: Annotated[str | None, typer.Option(help="Such as bunny or 2d/dragon1,3d/bunny (default: all)")] = None,
    positives: Annotated[
        int | None, typer.Option(help="Hard positives that a threshold is sampled from (default: 1000000)")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(help="Random queries that rates are measured on (default: 400000)")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Time for each proof (default: 60)")] = None,
    json: Json = False,
) -> int:
    """Find what networks thresholded by sampling would have missed, and what a proof costs instead.

    Kill it whenever you like: the same command goes on where it stopped. Exit status 1: a network failed, had a false
    negative at its proven threshold, or the run was stopped.
    """
    import warp_bounding.paper as tables
    from warp_bounding.bounders import supports
    from warp_bounding.indicators import load_indicator
    from warp_bounding.paper.folder import read_settings
    from warp_bounding.paper.pages.proofs_page import summary, summary_text
    from warp_bounding.paper.proofs import METHODS, run_proofs

    fits = read_settings(Path(table))
    quiet_warp(fits.device)
    names = words_of(methods) or list(METHODS)
    for name in names:
        if name not in METHODS:
            raise BounderError(f"methods must be among {', '.join(METHODS)}, got {name!r}")
    wanted, variants = tables.select_columns(words_of(columns)), tables.select_methods(names)
    found = tables.find_shapes(Path(data), dict.fromkeys(c.ndim for c in wanted))
    shapes = tables.select_shapes(found, words_of(objects))
    tables.plan(wanted, variants, shapes, ("exact",), supports, ())  # before a folder is made
    grids = tables.load_shapes(shapes, load_indicator)
    given = {"positives": positives, "samples": samples, "seconds": seconds}
    selected = {"columns": columns, "methods": methods, "objects": objects}
    table_name = Path(table).name if Path(table).is_absolute() else table
    line = command_line("proofs", {"data": data, "table": table_name, "out": out, **selected, **given})
    given["table"] = fits.to_dict()
    with tables.open_folder(Path(out), given, create=True, kind=tables.PROOFS) as folder:
        reporter = _Reporter(folder)
        outcome = run_proofs(folder, Path(table), wanted, variants, grids, command=line, reporter=reporter)
        reporter.write_page(outcome.failed)
        rows = list(folder.rows.values())
        counts, text, path, page = summary(rows), summary_text(rows), str(folder.path), folder.page
    if outcome.interrupted:
        reporter.say(f"interrupted: {outcome.done} of {outcome.total} networks are done")
    if json:
        done = {"total": outcome.total, "done": outcome.done, "failed": outcome.failed}
        print_json({"path": path, **done, "interrupted": outcome.interrupted, "summary": counts})
    else:
        console(False).print(text)
        console(False).print(f"{outcome.done} of {outcome.total} networks; the tables are {page}")
    return 1 if outcome.failed or outcome.interrupted or counts["missed_proven"] else 0


class _Reporter:
    """Prints a line for each network on standard error, and keeps ``README.md`` up to date."""

    def __init__(self, folder):
        self._folder = folder
        for note in folder.notes:
            self.say(note)

    def begin(self, outcome) -> None:
        """The run begins, and will keep its outcome up to date."""
        self._outcome = outcome

    def start(self, job) -> None:
        """A network begins."""

    def row(self, row) -> None:
        """A network is done, its row written."""
        self.write_page()
        missed = (
            f"a false negative by the {row.found_by}, {row.depth_std:.3g} std deep"
            if row.missed_sampled
            else "none found"
        )
        self.say(
            f"{self._outcome.done}/{self._outcome.total} {row.column.name} {row.object}: {row.method}: proof {row.search} in "
            f"{row.proof_seconds:.1f} s, {row.fp_sampled:.3f} -> {row.fp_proven:.3f} % false positives; "
            f"at the sampled minimum: {missed}"
        )

    def say(self, text: str) -> None:
        console(True).print(text)

    def write_page(self, failed: Sequence[str] = ()) -> None:
        """Write ``README.md``."""
        from warp_bounding.paper.pages.proofs_page import proofs_page

        write_whole(self._folder.page, proofs_page(self._folder, failed).encode())
