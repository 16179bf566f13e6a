"""``warp-bounding table1``: the paper's Table 1, measured; resumable at any moment."""

import shlex
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from typer.core import TyperCommand

from warp_bounding.cli.output import Json, console, print_json, quiet_warp
from warp_bounding.errors import QueryError

__all__ = ["Help", "command", "command_line", "words_of"]

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
    preset: Annotated[
        str | None,
        typer.Option(help=PRESETS_DO),  # and how long they take, where help is shown
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            help="Seconds for each learned fit; others by column or method, as in 20,3d=40,3d-ray=90,occupancy=5 (default: 60)"
        ),
    ] = None,
    columns: Annotated[
        str | None, typer.Option(help="Such as 2d-point,3d-ray; or 2d, or ray, for all of these (default: all)")
    ] = None,
    methods: Annotated[str | None, typer.Option(help="Such as aabb,bvh,bvh-64,mlp (default: all)")] = None,
    objects: Annotated[
        str | None, typer.Option(help="Such as bunny (in all dimensions) or 2d/dragon1,3d/bunny (default: all)")
    ] = None,
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
    import warp_bounding.paper as tables
    from warp_bounding.bounders import supports
    from warp_bounding.indicators import load_indicator

    given = {"budget": budget, "samples": samples, "seed": seed, "length": length, "device": device}
    selected = {"protocol": protocol, "columns": columns, "methods": methods, "objects": objects}
    line = command_line("table1", {"data": data, "out": out, **selected, "preset": preset, **given})
    given, protocol = _with_preset(preset, given, protocol)
    if given["budget"] is not None:  # it is whole: what it does not name has the number without a name
        given["budget"], given["budgets"] = tables.parse_budget(given["budget"])
    quiet_warp(device)
    if data is None:
        useless = [f"--{name}" for name, value in (selected | {"plan": plan or None}).items() if value is not None]
        if useless:
            raise QueryError(f"{useless[0]} needs --data DIR, the folder of the objects")
        with tables.open_folder(Path(out), given, create=False) as folder:
            cells = len(folder.rows)
            _Reporter(folder, supports)  # says what was repaired
            return _end(folder, tables.Outcome(cells, cells), supports, json)
    protocols = _protocols(protocol)
    wanted = tables.select_columns(words_of(columns))
    variants = tables.select_methods(words_of(methods))
    found = tables.find_shapes(Path(data), dict.fromkeys(c.ndim for c in wanted))
    shapes = tables.select_shapes(found, words_of(objects))
    tables.plan(wanted, variants, shapes, protocols, supports, ())  # before a folder is made
    if plan:
        return _plan(Path(out), given, (wanted, variants, shapes, protocols, supports), json)
    grids = tables.load_shapes(shapes, load_indicator)
    with tables.open_folder(Path(out), given, create=True) as folder, _Reporter(folder, supports) as reporter:
        outcome = tables.run(folder, wanted, variants, grids, protocols, command=line, reporter=reporter)
        reporter.stop()
        return _end(folder, outcome, supports, json)


class Help(TyperCommand):
    """Adds to the help how long each preset takes. That takes too long to compute whenever a command begins."""

    def format_help(self, ctx, formatter) -> None:
        from warp_bounding.bounders import supports
        from warp_bounding.paper import PRESETS, duration, preset_seconds

        (option,) = (parameter for parameter in self.params if parameter.name == "preset")
        takes = [f"{name} ({duration(preset_seconds(preset, supports))})" for name, preset in PRESETS.items()]
        option.help = f"{PRESETS_DO}: {' or '.join(takes)} on two cores."
        super().format_help(ctx, formatter)


def words_of(text: str | None) -> list[str] | None:
    """The words of an option, or ``None``."""
    return None if text is None else [word.strip() for word in text.split(",")]


def _with_preset(preset: str | None, given: dict[str, Any], protocol: str | None) -> tuple[dict[str, Any], str | None]:
    """Settings and protocol: those that were given, and those of the preset for the rest."""
    from warp_bounding.paper import PRESETS

    if preset is None:
        return given, protocol
    if preset not in PRESETS:
        raise QueryError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
    chosen = PRESETS[preset]._asdict()
    filled = {name: chosen.get(name) if value is None else value for name, value in given.items()}
    return filled, chosen["protocol"] if protocol is None else protocol


def _plan(out: Path, given: dict, selection: tuple, json: bool) -> int:
    """Say what there is to do; nothing is written."""
    from warp_bounding.paper import Settings, duration, open_folder, plan, shares

    settings, done, fitted = Settings.of(given), (), ()
    if (out / "settings.json").exists():
        with open_folder(out, given, create=False) as folder:
            settings, done = folder.settings, folder.rows
            jobs, total = plan(*selection, done)
            fitted = {j.name for j in jobs if folder.bounder(j.name).exists()}
    else:
        jobs, total = plan(*selection, done)
    parts = shares(jobs, settings, fitted)
    seconds, cells = sum(p.seconds for p in parts), sum(p.cells for p in parts)
    fits = sum(sum(p.fits.values()) for p in parts)
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
        text = console(False)
        for p in parts:
            text.print(p.text)
        learned = f"{fits} learned fits, {cells} of {total} cells to measure on {settings.samples:,} queries each"
        text.print(f"{learned}: {duration(seconds)} on two cores")
    return 0


def _protocols(protocol: str | None) -> tuple[str, ...]:
    from warp_bounding.paper import PROTOCOLS

    if protocol == "both":
        return PROTOCOLS
    if protocol is not None and protocol not in PROTOCOLS:
        raise QueryError(f"protocol must be one of {', '.join(PROTOCOLS)}, both, got {protocol!r}")
    return (protocol or PROTOCOLS[0],)


def command_line(command: str, options: dict[str, object]) -> str:
    """The command line that does the same on another machine: without the paths of this one."""
    out = Path(str(options["out"]))
    options = options | {"data": "DIR", "out": out.name if out.is_absolute() else str(out)}
    words = [word for name, value in options.items() if value is not None for word in (f"--{name}", str(value))]
    return shlex.join(["warp-bounding", command, *words])


def _end(folder, outcome, supports, json: bool) -> int:
    """Write the outputs, print the result, and return the exit status."""
    from warp_bounding.paper import PROTOCOLS, Means, against_the_paper, write_outputs

    err, text = console(True), console(False)
    notes = write_outputs(folder, supports, outcome.failed)
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
            for column, values in m.to_dict(supports).items():
                columns.setdefault(column, {})[m.protocol] = values
        cells = {"cells": outcome.total, "done": outcome.done, "failed": outcome.failed}
        print_json({"path": str(folder.path), **cells, "interrupted": outcome.interrupted, "columns": columns})
    else:
        for m in means:
            line = against_the_paper(m, plain=True)
            if line:
                text.print(f"{m.protocol} protocol: {line}")
        text.print(f"{done}; the table is {folder.page}")
    return 1 if outcome.failed or broken or outcome.interrupted else 0


class _Reporter:
    """Shows a bar on a terminal, or prints a line for each cell, and keeps ``README.md`` up to date."""

    def __init__(self, folder, supports):
        self._folder, self._supports = folder, supports
        self._err = console(True)
        done = TextColumn("{task.fields[cells]} cells")
        texts = [TextColumn("{task.fields[left]}"), TextColumn("{task.fields[note]}", markup=False)]
        columns = (TextColumn("table1"), BarColumn(bar_width=28), done, TimeElapsedColumn(), *texts)
        self._bar = Progress(*columns, console=self._err, transient=True, disable=not self._err.is_terminal)
        self._total = self._done = 0
        self._failed: list[str] = []
        self._stale, self._written = False, time.monotonic()
        for note in folder.notes:
            self.say(note)

    def __enter__(self) -> "_Reporter":
        return self

    def __exit__(self, *_) -> None:
        self.stop()

    def begin(self, total, done, left) -> None:
        """The run begins: cells in all, cells done before, and how long the rest takes."""
        self._total, self._done, self._left = total, done, left
        self._task = self._bar.add_task("", total=total, cells=f"{done}/{total}", left="", note="")
        if done < total:
            self.say(f"{total - done} of {total} cells to measure, {left.text}")
        self._bar.start()

    def start(self, job) -> None:
        """A job begins."""
        self._job = job
        self._show("")
        if self._stale and (job.variant.learned or time.monotonic() - self._written > PAGE_SECONDS):
            from warp_bounding.paper import write_page

            write_page(self._folder, self._supports, self._failed)
            self._stale, self._written = False, time.monotonic()

    def within(self, note) -> None:
        """A job tells what it is doing."""
        self._show(note)

    def row(self, row) -> None:
        """A cell is done, its row written."""
        self._done += 1
        certificate = row.certificate or "no certificate"
        text = (
            f"{row.column.name} {row.object}: {row.variant.label} ({row.protocol}): {row.fp_rate:.3f} % false positives"
        )
        if not self._err.is_terminal:
            self.say(f"{self._done}/{self._total} {text}, {row.fn} false negatives, {certificate}; {self._left.text}")
        self._stale = True

    def fail(self, job, reason) -> None:
        """A job has failed."""
        self._failed += [f"{job.title} ({p}): {reason}" for p in job.protocols]
        self.say(f"failed: {job.title}: {reason}")

    def say(self, text) -> None:
        self._err.print(text)

    def stop(self) -> None:
        """Take the bar away."""
        self._bar.stop()

    def _show(self, note: str) -> None:
        text = f"{self._job.title}{f': {note}' if note else ''}"
        self._bar.update(
            self._task, completed=self._done, cells=f"{self._done}/{self._total}", left=self._left.text, note=text
        )
