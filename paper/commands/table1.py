"""``python -m paper table1``: the paper's Table 1, measured; resumable at any moment."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from typer.core import TyperCommand

from paper.commands.tables import Columns, Objects, Reporter, command_line, selected
from warp_bounding.cli.options import Json
from warp_bounding.cli.output import console, print_json, quiet_warp
from warp_bounding.errors import QueryError

__all__ = ["Help", "command"]

PRESETS_DO = "Budgets, samples and both protocols for the whole table"
PAGE_SECONDS = 2.0  # between two writings of README.md, where each cell takes less


def command(
    out: Annotated[str, typer.Option(help="Folder for the table; an earlier run there is continued.")],
    data: Annotated[
        str | None,
        typer.Option(
            help="Folder with 2D/*.png, 3D/*.binvox, 4D/*.npy. Without it, README.md and plots are written anew."
        ),
    ] = None,
    protocol: Annotated[
        str | None, typer.Option(help="Truth: exact, sampled as in the paper, or both (default: exact)")
    ] = None,
    preset: Annotated[str | None, typer.Option(help=PRESETS_DO)] = None,  # and how long they take, where help is shown
    budget: Annotated[
        str | None,
        typer.Option(
            help="Seconds for each learned fit; others by column or method, as in 20,3d=40,3d-ray=90,occupancy=5 (default: 60)"
        ),
    ] = None,
    columns: Columns = None,
    methods: Annotated[str | None, typer.Option(help="Such as aabb,bvh,bvh-64,mlp (default: all)")] = None,
    objects: Objects = None,
    seed: Annotated[
        int | None, typer.Option(help="Random seed of the fits; the samples have the next one (default: 0)")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(help="Random queries that rates are measured on (default: 1000000)")
    ] = None,
    length: Annotated[float | None, typer.Option(help="Length of a ray (default: 1)")] = None,
    device: Annotated[str | None, typer.Option(help="Warp device (default: cpu)")] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Only say what there is to do and how long it will take.")
    ] = False,
    json: Json = False,
) -> int:
    """Measure the false positives of every method on every object and query, as in the paper's Table 1.

    Kill it whenever you like: the same command goes on where it stopped. Columns, methods, objects and protocols can be
    added to a folder later; budgets, samples, seed, length and device are those of its first run. Exit status 1: a cell
    failed or the run was stopped.
    """
    from paper.folder import open_folder
    from paper.run import Outcome, TableRun
    from paper.settings import parse_budget
    from paper.shapes import load_shapes

    given = {"budget": budget, "samples": samples, "seed": seed, "length": length, "device": device}
    chosen = {"columns": columns, "methods": methods, "objects": objects}
    told = {"data": data, "out": out, "protocol": protocol, **chosen, "preset": preset, **given}
    line = command_line("table1", told)
    given, protocol = _with_preset(preset, given, protocol)
    if given["budget"] is not None:  # it is whole: what it does not name has the number without a name
        given["budget"], given["budgets"] = parse_budget(given["budget"])
    quiet_warp(device)
    if data is None:
        for name in ("protocol", *chosen, "plan"):
            if (told | {"plan": plan or None})[name] is not None:
                raise QueryError(f"--{name} needs --data DIR, the folder of the objects")
        with open_folder(Path(out), given, create=False) as folder:
            Reporter(folder)  # says what was repaired
            return _end(folder, Outcome(len(folder.rows), len(folder.rows)), json)
    selection = selected(data, **chosen, protocols=_protocols(protocol))
    if plan:
        return _plan(Path(out), given, selection, json)
    grids = load_shapes(selection.shapes)
    with open_folder(Path(out), given, create=True) as folder:
        with _Reporter(folder) as reporter:
            outcome = TableRun(folder, selection, grids, reporter).go(line)
        return _end(folder, outcome, json)


class Help(TyperCommand):
    """Adds to the help how long each preset takes. That takes too long to compute whenever a command begins."""

    def format_help(self, ctx, formatter) -> None:
        from paper.plan import duration, preset_seconds
        from paper.settings import PRESETS

        (option,) = (parameter for parameter in self.params if parameter.name == "preset")
        takes = [f"{name} ({duration(preset_seconds(preset))})" for name, preset in PRESETS.items()]
        option.help = f"{PRESETS_DO}: {' or '.join(takes)} on two cores."
        super().format_help(ctx, formatter)


def _with_preset(preset: str | None, given: dict[str, Any], protocol: str | None) -> tuple[dict[str, Any], str | None]:
    """Settings and protocol: those that were given, and those of the preset for the rest."""
    from paper.settings import PRESETS

    if preset is None:
        return given, protocol
    if preset not in PRESETS:
        raise QueryError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
    chosen = PRESETS[preset]._asdict()
    filled = {name: chosen.get(name) if value is None else value for name, value in given.items()}
    return filled, chosen["protocol"] if protocol is None else protocol


def _plan(out: Path, given: dict, selection, json: bool) -> int:
    """Say what there is to do; nothing is written."""
    from paper.folder import open_folder
    from paper.plan import duration, plan, shares
    from paper.settings import Settings

    settings, done, fitted = Settings.of(given), (), ()
    if (out / "settings.json").exists():
        with open_folder(out, given, create=False) as folder:
            settings, done, fitted = folder.settings, folder.rows, folder.fitted
    jobs, total = plan(selection, done)
    parts = shares(jobs, settings, fitted)
    seconds, cells = sum(p.seconds for p in parts), sum(p.cells for p in parts)
    if json:
        columns = {
            p.column.name: {
                "learned_fits": [{"seconds": s, "fits": n} for s, n in sorted(p.fits.items())],
                "closed_forms": p.classic,
                "cells": p.cells,
                "seconds": round(p.seconds, 1),
            }
            for p in parts
        }
        about = {"budget": settings.budget_text, "samples": settings.samples, "cells": total, "missing": cells}
        print_json({"path": str(out), **about, "seconds": round(seconds, 1), "columns": columns})
    else:
        fits = sum(sum(p.fits.values()) for p in parts)
        learned = f"{fits} learned fits, {cells} of {total} cells to measure on {settings.samples:,} queries each"
        for text in (*(p.text for p in parts), f"{learned}: {duration(seconds)} on two cores"):
            console(False).print(text)
    return 0


def _protocols(protocol: str | None) -> tuple[str, ...]:
    from paper.rows import PROTOCOLS

    if protocol == "both":
        return PROTOCOLS
    if protocol is not None and protocol not in PROTOCOLS:
        raise QueryError(f"protocol must be one of {', '.join(PROTOCOLS)}, both, got {protocol!r}")
    return (protocol or PROTOCOLS[0],)


def _end(folder, outcome, json: bool) -> int:
    """Write the outputs, print the result, and return the exit status."""
    from paper.pages.markdown import against_the_paper, write_outputs
    from paper.pages.means import Means
    from paper.rows import PROTOCOLS

    err, text = console(True), console(False)
    notes = write_outputs(folder, outcome.failed)
    means = [m for m in (Means(folder.rows.values(), p) for p in PROTOCOLS) if m.cells]
    broken = [line for m in means for line in m.broken_promises()]
    for what, lines in (("note", notes), ("failed", outcome.failed), ("promise broken", broken)):
        for line in lines:
            err.print(f"{what}: {line}")
    done = f"{outcome.done} of {outcome.total} cells"
    if outcome.interrupted:
        err.print(f"interrupted: {done} are done; the same command goes on from there")
    if json:
        columns: dict[str, dict] = {}
        for m in means:
            for column, values in m.to_dict().items():
                columns.setdefault(column, {})[m.protocol] = values
        cells = {"cells": outcome.total, "done": outcome.done, "failed": outcome.failed}
        print_json({"path": str(folder.path), **cells, "interrupted": outcome.interrupted, "columns": columns})
    else:
        for m in means:
            if line := against_the_paper(m, plain=True):
                text.print(f"{m.protocol} protocol: {line}")
        text.print(f"{done}; the table is {folder.page}")
    return 1 if outcome.failed or broken or outcome.interrupted else 0


class _Reporter(Reporter):
    """Shows a bar on a terminal, or prints a line for each cell, and keeps ``README.md`` up to date."""

    def __init__(self, folder):
        super().__init__(folder)
        texts = (TextColumn("{task.fields[left]}"), TextColumn("{task.fields[note]}", markup=False))
        cells = TextColumn("{task.fields[cells]} cells")
        columns = (TextColumn("table1"), BarColumn(bar_width=28), cells, TimeElapsedColumn(), *texts)
        self._bar = Progress(*columns, console=self._err, transient=True, disable=not self._err.is_terminal)
        self._stale, self._written = False, time.monotonic()

    def __enter__(self) -> "_Reporter":
        return self

    def __exit__(self, *_) -> None:
        self._bar.stop()

    def begin(self, run) -> None:
        super().begin(run)
        missing = run.outcome.total - run.outcome.done
        self._task = self._bar.add_task("", total=run.outcome.total, cells=self.done, left="", note="")
        if missing:
            self.say(f"{missing} of {run.outcome.total} cells to measure, {run.left.text}")
        self._bar.start()

    def start(self, job) -> None:
        self._job = job
        self.within("")
        if self._stale and (job.variant.learned or time.monotonic() - self._written > PAGE_SECONDS):
            from paper.pages.markdown import write_page

            write_page(self._folder, self._run.outcome.failed)
            self._stale, self._written = False, time.monotonic()

    def within(self, note) -> None:
        text = f"{self._job.title}{f': {note}' if note else ''}"
        about = {"cells": self.done, "left": self._run.left.text, "note": text}
        self._bar.update(self._task, completed=self._run.outcome.done, **about)

    def row(self, row) -> None:
        self._stale = True
        if not self._err.is_terminal:
            rate = (
                f"{row.variant.label} ({row.protocol}): {row.fp_rate:.3f} % false positives, {row.fn} false negatives"
            )
            known = f"{row.certificate or 'no certificate'}; {self._run.left.text}"
            self.say(f"{self.done} {row.column.name} {row.object}: {rate}, {known}")
