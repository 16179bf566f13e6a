"""``warp-bounding bake``: a bounder for each shape of a folder, on many processes."""

import sys
import time
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from warp_bounding.baking.bake import LARGEST, SAMPLES, SHEET, Baked, SchedulerError, Settings, bake_with
from warp_bounding.baking.library import MANIFEST
from warp_bounding.cli import choose, fit
from warp_bounding.cli.options import Json, read_queries, shape_arguments, whole_number
from warp_bounding.cli.output import bar, console, print_json, quiet_warp, warn
from warp_bounding.errors import BoundingError

__all__ = ["command", "state_options"]

LINE_SECONDS = 30.0  # between two lines of progress, where standard error is no terminal


def command(
    folder: Annotated[str, typer.Argument(metavar="FOLDER", help="Folder with shapes, in folders inside it too.")],
    out: Annotated[str, typer.Option(help="Folder for bounders, manifest and contact sheet.")],
    jobs: Annotated[int | None, typer.Option(help="Worker processes of this machine (default: one a core).")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler, tcp://host:8786, whose workers see both folders."),
    ] = None,
    largest: Annotated[float, typer.Option(help="Files above so many megabytes are left out.")] = LARGEST,
    json: Json = False,
    **told: Any,
) -> int:
    """Fit a bounder to each shape of FOLDER, with the options of fit, or with --narrow-ns choose one for each.

    Results are named by a hash of shape, settings and version, and written whole: the same command goes on where one that was stopped or killed has
    ended. What is wrong with a shape is told and listed, and the others go on; exit status 1 where there was any. Ctrl-C keeps what is there.
    """
    quiet_warp(told["device"])
    settings = _settings(told)
    if jobs is not None and scheduler is not None:
        raise BoundingError("jobs is for workers of this machine, got --jobs and --scheduler")
    try:
        with bar("bake") as shown:
            update = shown if sys.stderr.isatty() else _lines()
            run = {"jobs": jobs, "scheduler": scheduler, "largest": largest}
            done = bake_with(settings, folder, out, progress=update, tell=lambda text: warn(text), **run)
    except SchedulerError as error:
        print(f"warp-bounding: {error}", file=sys.stderr)
        return 1
    _tell(done, out, json)
    return 1 if _failed(done) else 0


def _failed(done: Baked) -> list[str]:
    return [record.source for record in done.records if record.error]


def _tell(done: Baked, out: str, json: bool) -> None:
    failed = _failed(done)
    for path in done.too_large:
        warn(f"{path}: left out, it is above --largest")
    proven = sum(record.certificate == "proven" for record in done.records)
    if json:
        counts = {
            "shapes": len(done.records),
            "baked": done.baked,
            "kept": done.kept,
            "failed": len(failed),
            "proven": proven,
        }
        left_out = {"foreign": done.foreign, "too_large": done.too_large, "errors": failed}
        took = {"seconds": round(done.seconds, 3), "task_seconds": round(done.task_seconds, 3)}
        took |= {"running_seconds": round(done.running_seconds, 3), "workers": done.workers}
        where = {"out": out, "manifest": str(Path(out) / MANIFEST), "contact_sheet": str(Path(out) / SHEET)}
        print_json(counts | left_out | took | where)
        return
    text = console(False)
    kept = f", {done.kept:,} were there already" if done.kept else ""
    others = f"; {done.foreign:,} other files" if done.foreign else ""
    text.print(
        f"{len(done.records):,} shapes: {done.baked:,} baked{kept}, {len(failed):,} failed; {proven:,} proven{others}"
    )
    text.print(f"{done.seconds:.1f} s, {done.task_seconds:.1f} s of work; {Path(out) / MANIFEST}, {Path(out) / SHEET}")


def _lines():
    """Progress for logs: a line on standard error every ``LINE_SECONDS``."""
    last = [time.perf_counter()]

    def update(done: float, total: float, note: str = "") -> None:
        if (now := time.perf_counter()) - last[0] > LINE_SECONDS:
            last[0] = now
            print(f"bake: {note}", file=sys.stderr, flush=True)

    return update


def _settings(told: dict[str, Any]) -> Settings:
    """How each shape is baked, by the options of ``fit`` and ``choose``; ``BoundingError`` where these do not go together."""
    reading = shape_arguments(*(told[name] for name in ("threshold", "spacing", "origin", "unknown", "hollow")))
    samples, queries = whole_number("samples", told["samples"]), told["queries"]
    if queries is not None:
        read_queries(queries)
        queries = str(Path(queries).resolve())
    given = {name for name, parameter in _told_parameters().items() if told[name] != parameter.default}
    of_fit, of_choose = set(_parameters(fit)), set(_parameters(choose))
    if told["narrow_ns"] is None:
        for name in sorted((of_choose - of_fit) & given):
            raise BoundingError(
                f"{_option(name)} is for a choice, which --narrow-ns asks for; got {told[name]!r} without it"
            )
        return Settings(fit.fit_arguments(told), reading, queries, samples)
    for name in sorted((of_fit - of_choose - {"samples"}) & given):
        raise BoundingError(f"{_option(name)} is for a fit, and --narrow-ns asks for a choice; got {told[name]!r} too")
    return Settings(choose.choose_arguments(told), reading, queries, samples)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _parameters(module) -> dict[str, Parameter]:
    """The options of a command that makes one bounder, without its files and what it prints."""
    own = ("shape", "output", "folder", "json")
    return {name: parameter for name, parameter in signature(module.command).parameters.items() if name not in own}


def _told_parameters() -> dict[str, Parameter]:
    """All options of ``fit``, with fewer samples, and those that only ``choose`` has, none of which must be given."""
    found = _parameters(choose) | _parameters(fit)
    found["narrow_ns"] = _narrow_ns(found["narrow_ns"])
    found["samples"] = found["samples"].replace(default=f"{SAMPLES:g}")
    return {name: parameter.replace(kind=Parameter.KEYWORD_ONLY) for name, parameter in found.items()}


def _narrow_ns(parameter: Parameter) -> Parameter:
    text = "Choose a bounder for each shape: what your exact test takes for one query, nanoseconds."
    return parameter.replace(default=None, annotation=Annotated[float | None, typer.Option(help=text)])


def state_options() -> None:
    """Give ``command`` the options of ``fit`` and ``choose``."""
    command.__signature__ = _OWN.replace(
        parameters=[*list(_OWN.parameters.values())[:-1], *_told_parameters().values()]
    )


_OWN = signature(command)
