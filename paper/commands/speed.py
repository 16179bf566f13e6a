"""``python -m paper speed``: the paper's Table 2 and its supplement's table of speeds, measured; resumable at any moment."""

from pathlib import Path
from typing import Annotated

import typer

from paper.commands.tables import Columns, Objects, Reporter, command_line, words_of
from warp_bounding.cli.options import Json, whole_number
from warp_bounding.cli.output import console, print_json, quiet_warp

__all__ = ["command"]


def command(
    out: Annotated[str, typer.Option(help="Folder for the results; an earlier run there is continued.")],
    data: Annotated[
        str | None,
        typer.Option(help="Folder with 2D/*.png, 3D/*.binvox, 4D/*.npy. Without it, generated shapes are raced."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="The paper's methods with short fits and few queries: under five minutes.")
    ] = False,
    columns: Columns = None,
    methods: Annotated[str | None, typer.Option(help="Such as aabb,bvh,mlp,mlp-early (default: all)")] = None,
    objects: Objects = None,
    devices: Annotated[
        str | None, typer.Option(help="Warp devices, such as cpu,cuda:0 (default: all that are there)")
    ] = None,
    budget: Annotated[
        str | None, typer.Option(help="Seconds for each learned fit, as table1 takes them (default: 20)")
    ] = None,
    queries: Annotated[str | None, typer.Option(help="Queries that are asked at a time (default: 2e6)")] = None,
    rounds: Annotated[int | None, typer.Option(help="Rounds of each race (default: 9)")] = None,
    samples: Annotated[
        str | None, typer.Option(help="Random queries that false positives are measured on (default: 4e5)")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed of the fits (default: 0)")] = None,
    json: Json = False,
) -> int:
    """Measure how fast every method answers, on every device, as in the paper's Table 2 and its supplement.

    Of each dimension one object is raced, the bunny where the data has one, or those that are named. Kill it whenever
    you like: the same command goes on where it stopped. Exit status 1: a cell failed, a method that promises to have no
    false negative had one, or the run was stopped.
    """
    from paper.folder import open_folder
    from paper.speed.race import devices_named
    from paper.speed.rows import SpeedRow
    from paper.speed.run import SpeedRun

    chosen = {"columns": columns, "methods": methods, "objects": objects, "devices": devices}
    told = {"budget": budget, "queries": queries, "rounds": rounds, "samples": samples, "seed": seed}
    line = command_line("speed", ({"data": data} if data else {}) | {"out": out} | chosen | told, quick=quick)
    given = _settings(told, quick, data)
    quiet_warp()
    selection, grids = _selection(data, quick, columns, methods, objects, devices_named(devices))
    with open_folder(Path(out), given, create=True, kind=SpeedRow) as folder:
        reporter = _Reporter(folder)
        outcome = SpeedRun(folder, selection, grids, reporter).go(line)
        return _end(folder, outcome, reporter, json)


def _settings(told: dict, quick: bool, data: str | None) -> dict:
    """What was asked for, as the folder's settings have it; ``None`` for what was not."""
    from paper.settings import parse_budget
    from paper.speed.rows import GENERATED, QUICK, SHAPES

    usual = QUICK._asdict() if quick else {}
    given = {name: usual.get(name) if value is None else value for name, value in told.items()}
    for name in ("queries", "samples"):
        if given[name] is not None:
            given[name] = whole_number(name, str(given[name]))
    given["shapes"] = GENERATED if data is None else SHAPES[0]
    if given["budget"] is not None:
        given["budget"], given["budgets"] = parse_budget(given["budget"])
    return given


def _selection(data: str | None, quick: bool, columns, methods, objects, devices: tuple[str, ...]):
    """What is to be raced, and the grids of its objects."""
    from paper.columns import PAPER, select_columns, select_methods
    from paper.plan import Selection, plan
    from paper.shapes import find_shapes, load_shapes, select_shapes
    from paper.speed.objects import generated, usual
    from paper.speed.run import METHODS

    wanted = select_columns(words_of(columns))
    variants = select_methods(words_of(methods)) if methods else select_methods(METHODS)
    variants = [v for v in variants if not v.parametric]  # those are NumPy
    if quick and methods is None:
        variants = [v for v in variants if v.method in PAPER]
    dimensions = dict.fromkeys(c.ndim for c in wanted)
    if data is None:
        grids = generated(dimensions)
        shapes = select_shapes(list(grids), words_of(objects))
    else:
        found = find_shapes(Path(data), dimensions)
        shapes = usual(found) if objects is None else select_shapes(found, words_of(objects))
        grids = load_shapes(shapes)
    selection = Selection(wanted, variants, shapes, devices)
    plan(selection)  # before a folder is made
    return selection, grids


def _end(folder, outcome, reporter: Reporter, json: bool) -> int:
    """Write the outputs, print the result, and return the exit status."""
    from paper.speed.page import summary, write_outputs
    from paper.speed.tables import by_device

    for note in write_outputs(folder, outcome.failed):
        reporter.say(f"note: {note}")
    found = by_device(folder.rows.values())
    missed = sum(on.missed() for on in found)
    if missed:
        reporter.say(f"promise broken: {missed:,} false negatives of methods that promise none")
    done = f"{outcome.done} of {outcome.total} cells"
    if outcome.interrupted:
        reporter.say(f"interrupted: {done} are done; the same command goes on from there")
    if json:
        counts = {"cells": outcome.total, "done": outcome.done, "failed": outcome.failed}
        print_json({"path": str(folder.path), **counts, "interrupted": outcome.interrupted, "devices": summary(found)})
    else:
        text = console(False)
        for on in found:
            gains = on.early_out()
            if gains:
                faster, mean = sum(e.gain > 1 for e in gains), 100 * (sum(e.gain for e in gains) / len(gains) - 1)
                told = f"mlp-early is faster than mlp in {faster} of {len(gains)} columns, by {mean:.1f} % on average"
                text.print(f"{on.device}: {told}")
        text.print(f"{done}; the tables are {folder.page}")
    return 1 if outcome.failed or missed or outcome.interrupted else 0


class _Reporter(Reporter):
    """Prints a line for each fit and each row, and keeps ``README.md`` up to date."""

    def begin(self, run) -> None:
        super().begin(run)
        if run.jobs:
            self.say(f"{run.outcome.total - run.outcome.done} of {run.outcome.total} cells to measure")
        self._column = None

    def start(self, job) -> None:
        if (job.column, job.shape) != self._column:
            self._column = job.column, job.shape
            self.say(f"{job.column.name} {job.shape.name}: fitting")

    def row(self, row) -> None:
        from paper.speed.page import write_outputs

        write_outputs(self._folder, pictures=False)
        self.say(
            f"{self.done} {row.column.name} {row.object} {row.device}: {row.variant.label}: {row.ns:.3g} ns a query, "
            f"{row.ratio:.3f} times as long as {row.reference}, {row.fp_rate:.2f} % false positives"
        )
