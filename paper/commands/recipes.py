"""``python -m paper recipes``: the paper's own training beside ours in the same time; rows for the page of ``table1``."""

from pathlib import Path
from typing import Annotated

import typer

from paper.commands.tables import Columns, Objects, Reporter, command_line, selected, words_of
from warp_bounding.cli.options import Json
from warp_bounding.cli.output import console, print_json, quiet_warp
from warp_bounding.errors import QueryError

__all__ = ["command"]


def command(
    data: Annotated[str, typer.Option(help="Folder with 2D/*.png, 3D/*.binvox, 4D/*.npy.")],
    table: Annotated[
        str, typer.Option(help="Folder of a `table1` run, whose page gets the rows; they are kept in it.")
    ],
    columns: Columns = None,
    objects: Objects = None,
    ways: Annotated[
        str | None,
        typer.Option(help="Among default,default+encoding,paper,paper+encoding (default: all)"),
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Time for each fit (default: 600)")] = None,
    samples: Annotated[
        int | None, typer.Option(help="Random queries that rates are measured on (default: 400000)")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed of the fits (default: 0)")] = None,
    json: Json = False,
) -> int:
    """Train the paper's network by its recipe and by ours in the same time, with its positional encoding and without.

    Kill it whenever you like: the same command goes on where it stopped. Planes have neither. Exit status 1: a fit
    failed or the run was stopped.
    """
    from paper.folder import open_folder, read_settings
    from paper.recipes.page import write_page
    from paper.recipes.rows import FOLDER, WAYS, RecipeRow
    from paper.recipes.run import POINTS, RecipeRun
    from paper.shapes import load_shapes
    from warp_bounding.bounders.mlp import Mlp

    read_settings(Path(table))
    chosen = words_of(ways) or list(WAYS)
    for way in chosen:
        if way not in WAYS:
            raise QueryError(f"ways must be among {', '.join(WAYS)}, got {way!r}")
    quiet_warp()
    about, given = {"columns": columns, "objects": objects}, {"seconds": seconds, "samples": samples, "seed": seed}
    line = command_line("recipes", {"data": data, "table": table, **about, "ways": ways, **given})
    named = columns or ",".join(c.name for c in POINTS)
    selection = selected(data, named, Mlp.method, objects, tuple(dict.fromkeys(chosen)))
    if any(not _takes_recipes(c) for c in selection.columns):
        raise QueryError(
            "columns must be of points, rays or boxes: networks of planes have neither recipe nor encoding"
        )
    grids = load_shapes(selection.shapes)
    with open_folder(Path(table) / FOLDER, given, create=True, kind=RecipeRow) as folder:
        reporter = _Reporter(folder)
        outcome = RecipeRun(folder, selection, grids, reporter).go(line)
        write_page(folder, outcome.failed)
    with open_folder(Path(table), {}, create=False) as whole:
        from paper.pages.markdown import write_page as write_table_page

        write_table_page(whole)
    if outcome.interrupted:
        reporter.say(f"interrupted: {outcome.done} of {outcome.total} networks are done")
    if json:
        done = {"total": outcome.total, "done": outcome.done, "failed": outcome.failed}
        print_json({"path": str(folder.path), **done, "interrupted": outcome.interrupted})
    else:
        console(False).print(f"{outcome.done} of {outcome.total} networks; the rows are in {whole.page}")
    return 1 if outcome.failed or outcome.interrupted else 0


def _takes_recipes(column) -> bool:
    from warp_bounding.bounders.mlp import RECIPE

    return RECIPE.queries is None or column.query in RECIPE.queries


class _Reporter(Reporter):
    """Prints a line for each network, and keeps the folder's page up to date."""

    def row(self, row) -> None:
        from paper.recipes.page import write_page

        write_page(self._folder)
        self.say(
            f"{self.done} {row.column.name} {row.object}: {row.way}: {row.steps:,} steps in {row.fit_seconds:.0f} s, "
            f"{row.fp_rate:.2f} % false positives"
        )
