"""``python -m paper proofs``: what networks with a sampled threshold miss, and what a proof costs."""

from pathlib import Path
from typing import Annotated

import typer

from paper.commands.tables import Columns, Objects, Reporter, command_line, selected
from warp_bounding.cli.options import Json
from warp_bounding.cli.output import console, print_json, quiet_warp

__all__ = ["command"]


def command(
    data: Annotated[str, typer.Option(help="Folder with 2D/*.png, 3D/*.binvox, 4D/*.npy.")],
    table: Annotated[
        str, typer.Option(help="Folder of a `table1` run, with its bounders; what is missing is fitted anew.")
    ],
    out: Annotated[str, typer.Option(help="Folder for the results; an earlier run there is continued.")],
    columns: Columns = None,
    methods: Annotated[str | None, typer.Option(help="Among mlp,monotone-mlp (default: all)")] = None,
    objects: Objects = None,
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
    from paper.folder import open_folder, read_settings
    from paper.pages.proofs_page import summary, summary_text, write_page
    from paper.proofs import METHODS, ProofsRun
    from paper.rows import PROTOCOLS, ProofRow
    from paper.shapes import load_shapes

    fits = read_settings(Path(table))
    quiet_warp(fits.device)
    chosen = {"columns": columns, "methods": methods, "objects": objects}
    given = {"positives": positives, "samples": samples, "seconds": seconds}
    line = command_line("proofs", {"data": data, "table": table, "out": out, **chosen, **given})
    selection = selected(data, **chosen, protocols=PROTOCOLS[:1], among=METHODS)
    grids = load_shapes(selection.shapes)
    with open_folder(Path(out), given | {"table": fits.to_dict()}, create=True, kind=ProofRow) as folder:
        reporter = _Reporter(folder)
        outcome = ProofsRun(Path(table), folder, selection, grids, reporter).go(line)
        write_page(folder, outcome.failed)
        rows = list(folder.rows.values())
    counts = summary(rows)
    if outcome.interrupted:
        reporter.say(f"interrupted: {outcome.done} of {outcome.total} networks are done")
    if json:
        done = {"total": outcome.total, "done": outcome.done, "failed": outcome.failed}
        print_json({"path": str(folder.path), **done, "interrupted": outcome.interrupted, "summary": counts})
    else:
        console(False).print(summary_text(rows))
        console(False).print(f"{outcome.done} of {outcome.total} networks; the tables are {folder.page}")
    return 1 if outcome.failed or outcome.interrupted or counts["missed_proven"] else 0


class _Reporter(Reporter):
    """Prints a line for each network, and keeps ``README.md`` up to date."""

    def row(self, row) -> None:
        from paper.pages.proofs_page import write_page

        write_page(self._folder)
        missed = f"a false negative by the {row.found_by}, {row.depth_std:.3g} std deep" if row.missed_sampled else ""
        self.say(
            f"{self.done} {row.column.name} {row.object}: {row.method}: proof {row.search} in "
            f"{row.proof_seconds:.1f} s, {row.fp_sampled:.3f} -> {row.fp_proven:.3f} % false positives; "
            f"at the sampled minimum: {missed or 'none found'}"
        )
