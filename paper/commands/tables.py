"""What the commands that make the paper's tables have in common: how cells are selected, and what is told meanwhile."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from warp_bounding.cli.output import console

__all__ = ["Columns", "Objects", "Reporter", "command_line", "selected", "words_of"]

Columns = Annotated[
    str | None, typer.Option(help="Such as 2d-point,3d-ray; or 2d, or ray, for all of these (default: all)")
]
Objects = Annotated[
    str | None, typer.Option(help="Such as bunny (in all dimensions) or 2d/dragon1,3d/bunny (default: all)")
]


def selected(data: str, columns: str | None, methods: str | None, objects: str | None, protocols, **among: Any):
    """The ``Selection`` that words name, of the objects in a folder; ``among`` is for ``select_methods``.

    Raises:
        BoundingError: For a word that names nothing, or if there is nothing to measure.
    """
    from paper.columns import select_columns, select_methods
    from paper.plan import Selection, plan
    from paper.shapes import find_shapes, select_shapes

    wanted, variants = select_columns(words_of(columns)), select_methods(words_of(methods), **among)
    found = find_shapes(Path(data), dict.fromkeys(c.ndim for c in wanted))
    selection = Selection(wanted, variants, select_shapes(found, words_of(objects)), protocols)
    plan(selection)  # before a folder is made
    return selection


def words_of(text: str | None) -> list[str] | None:
    """Words between commas; ``None`` for no text."""
    return None if text is None else [word.strip() for word in text.split(",")]


def command_line(command: str, options: dict[str, Any], **flags: bool) -> str:
    """The command line that does the same on another machine: without the paths of this one."""
    paths = {name: Path(str(options[name])) for name in ("table", "out") if name in options}
    data = {"data": "DIR"} if options.get("data") is not None else {}
    options = options | data | {n: path.name if path.is_absolute() else path for n, path in paths.items()}
    words = [word for name, value in options.items() if value is not None for word in (f"--{name}", str(value))]
    return shlex.join(
        ["python", "-m", "paper", command, *words, *(f"--{name}" for name, given in flags.items() if given)]
    )


class Reporter:
    """Tells people what a run does, on standard error."""

    def __init__(self, folder):
        self._folder, self._err = folder, console(True)
        for note in folder.notes:
            self.say(note)

    def begin(self, run) -> None:
        """A run begins."""
        self._run = run

    def start(self, job) -> None:
        """A job begins."""

    def within(self, note: str) -> None:
        """A job tells what it is doing."""

    def row(self, row) -> None:
        """A cell is done, its row written."""

    def say(self, text: str) -> None:
        """Print a line."""
        self._err.print(text)

    @property
    def done(self) -> str:
        """How many cells are done."""
        return f"{self._run.outcome.done}/{self._run.outcome.total}"
