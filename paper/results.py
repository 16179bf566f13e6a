"""Results on disk, which survive being killed at any moment, and the loop that measures what is not there yet.

A folder holds ``settings.json`` (what all its rows have in common, and the command lines that made it), a CSV, and
fitted bounders. The CSV grows by whole lines; one that was torn by an interruption is the last and has no end: it is
dropped and measured again. Every other file is written whole. A lock keeps a second run out. A folder of other
settings, a foreign or a damaged one is refused, and nothing is overwritten. ``README.md`` is a page of ``pages/``
with its tables.
"""

import contextlib
import csv
import io
import json
import math
import os
import platform
import shlex
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import write_whole
from warp_bounding.version import __version__

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def names(text: str) -> list[str]:
    """Words between blanks."""
    return text.split()


SETTINGS, PAGE, BOUNDERS, FORMAT = "settings.json", "README.md", "bounders", 1
TEXT = frozenset(
    names("""object query method space protocol certificate hidden activation device indicator versions search found_by
    counterexample way device_name reference fitted""")
)  # columns of text; all others are numbers, or empty
POSITIVE = ("budget", "seconds", "length", "effort")  # settings that must be above 0 ...
COUNTS = ("samples", "queries", "rounds", "positives")  # ... and at least 1
SAME = ("samples", "queries", "rounds", "seed", "length", "seconds")  # columns that are settings
Rows = Sequence[Mapping[str, Any]]


class Folder:
    """A locked folder: ``settings``, ``commands`` that contributed, and ``rows`` in the order of their measurement."""

    def __init__(self, path: Path, name: str, columns: Sequence[str], settings: dict[str, Any], commands: list[str]):
        self.path, self.settings, self.commands, self.columns = path, settings, commands, tuple(columns)
        self.rows: list[dict[str, Any]] = []
        self.failed: list[str] = []  # a line for each cell that failed in this run
        self._table = path / f"{name}.csv"
        if columns:
            self.rows, repaired = read_rows(self._table, columns, settings)
            if repaired is not None:
                write_whole(self._table, repaired)

    def bounder(self, name: str) -> Path:
        """Where a fitted bounder lies."""
        return self.path / BOUNDERS / f"{name}.safetensors"

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row: once this returns, it is on the disk."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow([row[name] for name in self.columns])
        try:
            with open(self._table, "r+b") as file:  # a table that was taken away is not begun again without its header
                file.seek(0, os.SEEK_END)
                file.write(text.getvalue().encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise FileFormatError(f"{self._table}: cannot be written ({error.strerror or error})") from error
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
            number = (
                f"{value:g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)
            )
            shown = "\n".join(value) if isinstance(value, list) else number
            text = text.replace(f"{{{key}}}", shown)
        while "\n\n\n" in text:  # where there was nothing to tell
            text = text.replace("\n\n\n", "\n\n")
        return text


@contextlib.contextmanager
def opened(path: Path, name: str, columns: Sequence[str], defaults: dict[str, Any], given: Mapping[str, Any],
           *, create: bool = True, owned: Sequence[str] = ()) -> Iterator[Folder]:  # fmt: skip
    """Lock a folder, made if there is none, and read its settings and rows, or begin them.

    Args:
        path: The folder.
        name: Of the command whose folder it is, and of its CSV.
        columns: Of the CSV; none where the command keeps its results in other files.
        defaults: All settings, with the values that they have where nothing is said.
        given: Settings that were requested; the others (``None``) are those of the folder, or the defaults.
        create: Whether to begin a folder where there is none.
        owned: Names of further files that the command writes.

    Raises:
        BoundingError: If it is not such a folder, damaged, in use, of other settings, or cannot be written to.
    """
    given = {key: value for key, value in given.items() if value is not None}
    wanted = checked(defaults | given)
    if not (path / SETTINGS).exists():
        strangers = [own for own in (f"{name}.csv", PAGE, BOUNDERS, *owned) if (path / own).exists()]
        if not create:
            raise FileFormatError(f"{path}: no tables there yet; --data DIR is needed to make them")
        if strangers:
            reported = f"holds {', '.join(strangers)} but no {SETTINGS}"
            raise FileFormatError(f"{path}: {reported}; choose another folder for --output")
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = open(path / ".lock", "ab")  # noqa: SIM115  closed below
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written to ({error.strerror or error})") from error
    with lock:
        try:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            busy = f"another {name} is at work there; wait for it or choose another --output"
            raise FileFormatError(f"{path}: {busy}") from None
        if not (path / SETTINGS).exists():
            _write_settings(path, wanted | {"library": __version__}, [])
        stored, commands = read_settings(path)
        reported = [(key, stored.get(key, defaults[key]), value) for key, value in given.items()]
        if other := "; ".join(f"{key} {old} there, {new} now" for key, old, new in reported if old != new):
            raise FileFormatError(f"{path}: made with other settings: {other}. Use those, or another folder")
        yield Folder(path, name, columns, defaults | stored, commands)


def checked(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings that make sense; ``BounderError`` for others, with the rule and the value."""
    for name, value in settings.items():
        if name in POSITIVE and not (isinstance(value, (int, float)) and 0 < value < math.inf):
            raise BounderError(f"{name} must be positive, got {value}")
        if name in COUNTS and not (isinstance(value, int) and value >= 1):
            raise BounderError(f"{name} must be at least 1, got {value}")
        if name == "seed" and not (isinstance(value, int) and 0 <= value < 2**63 - 2):
            raise BounderError(f"seed must be a whole number from 0 to 2^63 - 3, got {value}")
    return settings


def read_settings(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Settings and command lines of a folder, without a lock; ``FileFormatError`` if they are damaged."""
    try:
        document = json.loads((path / SETTINGS).read_text())
        version, settings, commands = (document[key] for key in ("format", "settings", "commands"))
        settings, commands = checked(dict(settings)), [str(command) for command in commands]
    except (OSError, ValueError, KeyError, TypeError, BoundingError) as error:
        raise FileFormatError(f"{path / SETTINGS}: damaged or not the settings of a table ({error})") from error
    if version != FORMAT:
        raise FileFormatError(f"{path / SETTINGS}: format {version}, this version of warp-bounding knows {FORMAT}")
    return settings, commands


def _write_settings(path: Path, settings: dict[str, Any], commands: list[str]) -> None:
    document = {"format": FORMAT, "settings": settings, "commands": commands}
    write_whole(path / SETTINGS, (json.dumps(document, indent=1) + "\n").encode())


def read_rows(table: Path, columns: Sequence[str], settings: Mapping[str, Any]) -> tuple[list[dict], bytes | None]:
    """The rows of a CSV, and what it should hold instead where it is new, or its end was torn by an interruption.

    Raises:
        FileFormatError: If it is not such a table, or damaged.
    """
    header, content = ",".join(columns) + "\n", table.read_bytes() if table.exists() else b""
    whole, rows = content[: content.rfind(b"\n") + 1], []
    lines = whole.decode(errors="replace").split("\n")[:-1]
    first = f"{lines[0]}\n" if lines else content.decode(errors="replace")
    if first != header and (lines or not header.startswith(first)):
        raise FileFormatError(f"{table}: not a table of this version: its first line is not {header[:30]}...")
    for number, line in enumerate(lines[1:], start=2):
        try:
            rows.append(_row(line, columns, settings))
        except (ValueError, csv.Error) as error:
            damage = f"line {number} is damaged ({error}); delete it and it is measured again"
            raise FileFormatError(f"{table}: {damage}") from None
    if lines and whole != content:
        say(f"{table}: the last line was torn by an interruption; dropped, to be measured again")
    return rows, None if lines and whole == content else whole or header.encode()


def _row(line: str, columns: Sequence[str], settings: Mapping[str, Any]) -> dict[str, Any]:
    """A line of a CSV; ``ValueError`` with what is wrong with it."""
    (cells,) = csv.reader([line], strict=True)
    row: dict[str, Any] = dict(zip(columns, cells, strict=True))
    for name in row.keys() - TEXT:
        text = row[name]
        row[name] = None if not text else int(text) if text.lstrip("-").isdecimal() else float(text)
        if isinstance(row[name], float) and not math.isfinite(row[name]):
            raise ValueError(f"{name} is {text}")
    for name in SAME:
        if name in row and row[name] != settings.get(name, row[name]):
            raise ValueError(f"it was measured with another {name}")
    if not 0 <= (row.get("fp_rate") or 0) <= 100:
        raise ValueError(f"fp_rate must be from 0 to 100 per cent, got {row['fp_rate']}")
    return row


def markdown(heads: Sequence[str | None], lines: Iterable[Sequence[str | None]], left: int = 1) -> list[str]:
    """Lines of a Markdown table; the first ``left`` columns are text, others numbers; ``None`` is an empty cell."""
    rows = ("|" + "".join(f" {cell or ''} |" for cell in cells) for cells in (heads, *lines))
    first, *rest = (row.replace("  |", " |") for row in rows)
    return [first, "|" + "---|" * left + "---:|" * (len(heads) - left), *rest]


# --- runs -------------------------------------------------------------------------------------------------------------

_STOPPED = threading.Event()


def heed() -> None:
    """End the run if it was interrupted: a callee, as ``fit``, may have swallowed that and returned early."""
    if _STOPPED.is_set():
        raise KeyboardInterrupt


def work(folder: Folder, cells: Sequence[Any], measure: Callable[[Any], str], title: Callable[[Any], str]) -> bool:
    """Do all cells; one that fails is told and the others go on. An interruption is never taken for a result.

    Args:
        folder: Where the results go.
        cells: What is missing.
        measure: Does one; returns what it has found, in a line for people.
        title: Of a cell, for people.

    Returns:
        Whether everything was done.

    Raises:
        FileFormatError: If a result cannot be written: it is no use going on then.
    """
    with _interruptions():
        try:
            for number, cell in enumerate(cells, start=1):
                try:
                    say(f"{number}/{len(cells)} {title(cell)}: {measure(cell)}")
                except FileFormatError:
                    raise
                except Exception as error:  # whatever ends one cell of a long run is reported, and the others go on
                    folder.failed.append(f"{title(cell)}: {_reason(error)}")
                    say(f"failed: {folder.failed[-1]}")
        except KeyboardInterrupt:
            say(f"interrupted: {number - 1} of {len(cells)} are done; the same command goes on from there")
            return False
    return not folder.failed


@contextlib.contextmanager
def _interruptions() -> Iterator[None]:
    """Ctrl-C sets ``_STOPPED``, besides raising ``KeyboardInterrupt``."""
    _STOPPED.clear()
    before = signal.getsignal(signal.SIGINT)

    def handler(number, frame):
        _STOPPED.set()
        raise KeyboardInterrupt

    heard = before != signal.SIG_IGN and threading.current_thread() is threading.main_thread()
    if heard:  # unlike in a shell's background jobs
        signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        if heard:
            signal.signal(signal.SIGINT, before)


def say(text: str) -> None:
    """Print a line for people."""
    print(text, file=sys.stderr, flush=True)


def _reason(error: BaseException) -> str:
    """A failure in one line; of what is no error of ours, also its type and where it was raised."""
    reason = " ".join(str(error).split()) or type(error).__name__
    frame = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{type(error).__name__}: {reason} ({Path(frame.filename).name}, line {frame.lineno})"
    return reason if isinstance(error, BoundingError) else where


def command_line(command: str, **options: Any) -> str:
    """The command line that does the same on another machine: without the paths of this one; ``True`` is a flag."""
    words = ["python", "-m", "paper", *command.split()]
    for name, value in options.items():
        option = "--output" if name == "out" else f"--{name}"
        if name == "data" and value is not None:
            value = "DIR"
        elif name in ("table", "out") and Path(value).is_absolute():
            value = Path(value).name
        if value is not None and value is not False:
            words += [option] if value is True else [option, str(value)]
    return shlex.join(words)


@cache
def versions() -> str:
    """Versions of this library (with its commit, where it is run from a checkout) and of what it stands on."""
    root, commit = Path(__file__).parents[1], ""
    with contextlib.suppress(OSError, subprocess.SubprocessError):  # no git there
        git = ["git", "rev-parse", "--short=9", "HEAD"]
        found = subprocess.run(git, cwd=root, capture_output=True, text=True, timeout=10, check=True)
        commit = f" ({found.stdout.strip()})"
    others = []
    for name, package in (("warp", "warp-lang"), ("torch", "torch")):
        try:
            others.append(f"{name} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            others.append(f"{name} none")
    return f"warp-bounding {__version__}{commit}, {', '.join(others)}, Python {platform.python_version()}"
