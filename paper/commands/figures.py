"""``python -m paper figures``: the paper's figures, computed and drawn; resumable at any moment."""

import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from paper.commands.tables import command_line
from warp_bounding.cli.options import Json
from warp_bounding.cli.output import console, print_json, quiet_warp
from warp_bounding.errors import BoundingError

__all__ = ["command"]

SOLIDS = "paper.drawing.solids"  # draws in a process of its own


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Which figure, or all.")],
    quick: Annotated[bool, typer.Option("--quick", help="Small forms, all in some minutes.")] = False,
    data: Annotated[
        str | None,
        typer.Option(help="Folder with 2D/*.png, 3D/*.binvox, 4D/*.npy. Without it, shapes of our own are shown."),
    ] = None,
    out: Annotated[str, typer.Option(help="Folder for figures; an earlier run there is continued.")] = "out/figures",
    effort: Annotated[float | None, typer.Option(help="Multiplies the seconds of every fit (default: 1)")] = None,
    samples: Annotated[
        int | None, typer.Option(help="Random queries that rates are measured on (default: 200000)")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Random seed of the fits; the samples have the next one (default: 0)")
    ] = None,
    json: Json = False,
) -> int:
    """Make a figure of the paper, or all of them, with captions and numbers in README.md.

    Kill it whenever you like: the same command goes on where it stopped, and draws anew what is there. Exit status 1: a
    figure failed, a promise was found broken, or the run was stopped.
    """
    from paper.drawing.base import Tools, Work
    from paper.drawing.folder import open_figures
    from paper.drawing.page import write_page
    from paper.drawing.run import FigureRun, selected
    from paper.drawing.settings import OWN, PAPER, FigureSettings
    from paper.figures import FIGURES

    quiet_warp()
    if data is not None and not Path(data).is_dir():
        raise BoundingError(f"{data}: no such folder; it must hold 2D/*.png, 3D/*.binvox, 4D/*.npy")
    given = {"quick": quick, "objects": PAPER if data else OWN, "effort": effort, "samples": samples, "seed": seed}
    tools = Tools(_draw_solids, _run_demo)
    work = Work(FigureSettings.of(given), None if data is None else Path(data), tools)
    chosen, skipped = selected(name, FIGURES, work)
    told = {"data": data, "out": out, "effort": effort, "samples": samples, "seed": seed}
    line = command_line("figures", told, quick=quick).replace("figures", f"figures {name}", 1)
    with open_figures(Path(out), given, tuple(figure.name for figure in FIGURES)) as folder:
        work.settings = folder.settings
        with _Reporter() as reporter:
            for text in skipped:
                reporter.say(f"skipped: {text}")
            outcome = FigureRun(folder, work, reporter).go(chosen, line)
        write_page(folder, FIGURES)
    err, done = console(True), f"{len(outcome.done)} of {len(chosen)} figures"
    for text in outcome.broken:
        err.print(f"promise broken: {text}")
    if outcome.interrupted:
        err.print(f"interrupted: {done} are done; the same command goes on from there")
    if json:
        about = {"failed": outcome.failed, "skipped": skipped, "broken": outcome.broken}
        print_json({"path": out, "done": outcome.done, **about, "interrupted": outcome.interrupted})
    else:
        console(False).print(f"{done}; they are shown in {Path(out) / 'README.md'}")
    return 1 if outcome.failed or outcome.broken or outcome.interrupted else 0


def _draw_solids(scenes: list[dict[str, Any]]) -> list[bytes]:
    """Pictures of scenes, drawn off-screen in a process of its own."""
    import json

    import numpy as np

    from warp_bounding.views import draw_with

    with tempfile.TemporaryDirectory() as folder:
        drawn = draw_with(SOLIDS, Path(folder), {"scenes": np.array(json.dumps(scenes))})
        if len(drawn.paths) != len(scenes):
            raise BoundingError(drawn.problem)
        return [path.read_bytes() for path in drawn.paths]


def _run_demo(name: str, folder: Path, quick: bool) -> dict[str, Any]:
    """A demo's JSON; what it prints for people goes to standard error."""
    from importlib import import_module

    from sims.report import output

    return import_module(f"sims.{name}").run(folder, quick=quick, seed=0, device="cpu", console=output(stderr=True))


class _Reporter:
    """Shows on a terminal what is going on, and prints a line for each part elsewhere."""

    def __init__(self):
        self._err, self._part = console(True), ""
        self._status = self._err.status("") if self._err.is_terminal else None

    def __enter__(self) -> "_Reporter":
        if self._status:
            self._status.start()
        return self

    def __exit__(self, *_) -> None:
        if self._status:
            self._status.stop()

    def part(self, text: str) -> None:
        """A part begins."""
        self._part = text
        if self._status:
            self.within("")
        else:
            self._err.print(text)

    def within(self, note: str) -> None:
        """A part tells what it is doing."""
        if self._status:
            self._status.update(f"{self._part} {note}".strip())

    def say(self, text: str) -> None:
        """Print a line."""
        self._err.print(text)
