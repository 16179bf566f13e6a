"""Results on disk, which survive being killed at any moment, and the loop that measures what is not there yet.

A folder holds ``settings.json`` (what all its rows have in common, and the command lines that made it), a CSV, and
fitted bounders. The CSV grows by whole lines; one that was torn by an interruption is dropped and measured again.
Every other file is written whole. A folder of other settings, a foreign or a damaged one is refused, and nothing is
overwritten. ``README.md`` is a page of ``pages/`` with its tables.
"""

import csv
import io
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import write_whole
from warp_bounding.version import __version__

SETTINGS, PAGE, BOUNDERS, FORMAT = "settings.json", "README.md", "bounders", 1
TEXT = """object query method space protocol certificate hidden activation device indicator versions search found_by
    counterexample way device_name reference fitted""".split()  # columns of text; all others are numbers, or empty
LEAST = {"samples": 1, "queries": 1, "rounds": 1, "positives": 1, "seed": 0}  # settings that are whole numbers
POSITIVE = ("budget", "seconds", "length", "effort")
Rows = Sequence[Mapping[str, Any]]


class Folder:
    """A folder: ``settings``, ``commands`` that contributed, and ``rows`` in the order of their measurement."""

    def __init__(self, path: Path, name: str, columns: Sequence[str], settings: dict[str, Any], commands: list[str]):
        self.path, self.settings, self.commands, self.columns = path, settings, commands, tuple(columns)
        self.failed: list[str] = []  # a line for each cell that failed in this run
        self._table = path / f"{name}.csv"
        self.rows = read_rows(self._table, columns) if columns else []
        if columns:  # its header, if it is new; without a line that an interruption tore
            self._table.touch()
            whole = self._table.read_bytes()
            header = b"" if whole else ",".join(columns).encode() + b"\n"
            write_whole(self._table, header + whole[: whole.rfind(b"\n") + 1])

    def bounder(self, name: str) -> Path:
        """Where a fitted bounder lies."""
        return self.path / BOUNDERS / f"{name}.safetensors"

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow([row[name] for name in self.columns])
        with self._table.open("a") as file:
            file.write(text.getvalue())
        self.rows.append(dict(row))

    def remember(self, command: str) -> None:
        """Note a command line that is about to contribute."""
        if command not in self.commands:
            self.commands.append(command)
            _write_settings(self.path, self.settings, self.commands)

    def write(self, name: str, content: str | bytes) -> None:
        """Write another file of the folder, if it differs from what is there."""
        content = content.encode() if isinstance(content, str) else content
        if not (self.path / name).exists() or (self.path / name).read_bytes() != content:
            write_whole(self.path / name, content)

    def page(self, name: str, **values: Any) -> str:
        """A page of ``pages/``: ``{name}`` stands for a value, and for a list of lines; some names every page knows."""
        threads = " and ".join(sorted({str(r["threads"]) for r in self.rows if "threads" in r})) or "?"
        failed = ["**Failed**, and therefore missing below:", "", *(f"- {line}" for line in self.failed), ""]
        known = {"first": self.commands[0] if self.commands else "(no command yet)", "commands": self.commands}
        known |= {"threads": threads, "versions": sorted({f"- {r['versions']}" for r in self.rows if "versions" in r})}
        known |= {"failed": failed if self.failed else [], "count": len(self.rows), **self.settings}
        text = (Path(__file__).parent / "pages" / f"{name}.md").read_text()
        for key, value in (known | values).items():
            number = f"{value:g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else value
            text = text.replace(f"{{{key}}}", "\n".join(value) if isinstance(value, list) else str(number))
        while "\n\n\n" in text:  # where there was nothing to tell
            text = text.replace("\n\n\n", "\n\n")
        return text


def opened(path: Path, name: str, columns: Sequence[str], defaults: dict[str, Any], given: Mapping[str, Any],
           create: bool = True) -> Folder:  # fmt: skip
    """Read a folder's settings and rows, or begin it, if that is allowed (``create``).

    The name is that of the command, and of its CSV, if that has columns. Settings that are not ``given`` (or ``None``)
    are those of the folder, or the defaults. Raises ``BoundingError`` if it is not such a folder, damaged, of other
    settings, or cannot be written to.
    """
    given = {key: value for key, value in given.items() if value is not None}
    wanted = checked(defaults | given)
    if not (path / SETTINGS).exists():
        if not create:
            raise FileFormatError(f"{path}: no tables there yet; --data DIR is needed to make them")
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise FileFormatError(f"{path}: holds other files; choose another folder for --output")
        path.mkdir(parents=True, exist_ok=True)
        _write_settings(path, wanted | {"library": __version__}, [])
    stored, commands = read_settings(path)
    reported = [(key, stored.get(key, defaults[key]), value) for key, value in given.items()]
    if other := "; ".join(f"{key} {old} there, {new} now" for key, old, new in reported if old != new):
        raise FileFormatError(f"{path}: made with other settings: {other}. Use those, or another folder")
    return Folder(path, name, columns, defaults | stored, commands)


def checked(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings that make sense; ``BounderError`` for others, with the rule and the value."""
    for name, value in settings.items():
        if name in POSITIVE and not 0 < value < math.inf:
            raise BounderError(f"{name} must be positive, got {value}")
        if name in LEAST and not (isinstance(value, int) and LEAST[name] <= value < 2**63 - 2):
            raise BounderError(f"{name} must be a whole number of at least {LEAST[name]}, got {value}")
    return settings


def read_settings(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Settings and command lines of a folder; ``FileFormatError`` if they are damaged."""
    try:
        document = json.loads((path / SETTINGS).read_text())
        settings, commands = document["settings"], document["commands"]
        checked(settings)
    except (OSError, ValueError, KeyError, TypeError, BoundingError) as error:
        raise FileFormatError(f"{path / SETTINGS}: damaged or not the settings of a table ({error})") from error
    return settings, commands


def _write_settings(path: Path, settings: dict[str, Any], commands: list[str]) -> None:
    document = {"format": FORMAT, "settings": settings, "commands": commands}
    write_whole(path / SETTINGS, (json.dumps(document, indent=1) + "\n").encode())


def read_rows(table: Path, columns: Sequence[str]) -> list[dict[str, Any]]:
    """The rows of a CSV, without one at its end that an interruption tore; none where there is no file."""
    text = table.read_text() if table.exists() else ""
    rows = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
    if rows.fieldnames not in (None, list(columns)):
        raise FileFormatError(f"{table}: not a table of this version: its columns are others")
    try:
        return [{name: row[name] if name in TEXT else _number(row[name]) for name in columns} for row in rows]
    except ValueError as error:
        where = f"{table}: line {rows.line_num}"
        raise FileFormatError(f"{where} is damaged; delete it and it is measured again") from error


def _number(text: str | None) -> float | int | None:
    if text is None:
        raise ValueError("the line is too short")
    return None if not text else int(text) if text.lstrip("-").isdecimal() else float(text)


def markdown(heads: Sequence[str | None], lines: Iterable[Sequence[str | None]], left: int = 1) -> list[str]:
    """Lines of a Markdown table; the first ``left`` columns are text, others numbers; ``None`` is an empty cell."""
    rows = ("|" + "".join(f" {cell or ''} |" for cell in cells) for cells in (heads, *lines))
    first, *rest = (row.replace("  |", " |") for row in rows)
    return [first, "|" + "---|" * left + "---:|" * (len(heads) - left), *rest]


# --- runs -------------------------------------------------------------------------------------------------------------


def finished(bounder: Any) -> Any:
    """A fitted bounder; ``KeyboardInterrupt`` where Ctrl-C ended its fit early: that is no result."""
    if (bounder.info.get("training") or {}).get("interrupted"):
        raise KeyboardInterrupt
    return bounder


def work(folder: Folder, cells: Sequence[Any], measure: Callable[[Any], str], title: Callable[[Any], str]) -> bool:
    """Measure all cells; returns whether all succeeded. A cell that fails is reported, and the others go on.

    ``measure`` does one and returns what it has found, in a line for people. An interruption is never taken for a
    result; a result that cannot be written ends the run.
    """
    try:
        for number, cell in enumerate(cells, start=1):
            try:
                say(f"{number}/{len(cells)} {title(cell)}: {measure(cell)}")
            except FileFormatError:
                raise
            except Exception as error:  # whatever ends one cell of a long run is reported, and the others go on
                reason = " ".join(str(error).split())
                reason = reason if isinstance(error, BoundingError) else f"{type(error).__name__}: {reason}"
                folder.failed.append(f"{title(cell)}: {reason}")
                say(f"failed: {folder.failed[-1]}")
    except KeyboardInterrupt:
        say(f"interrupted: {number - 1} of {len(cells)} are done; the same command goes on from there")
        return False
    return not folder.failed


def say(text: str) -> None:
    """Print a line for people."""
    print(text, file=sys.stderr, flush=True)
