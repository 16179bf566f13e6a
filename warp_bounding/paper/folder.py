"""The folder of a run, which survives being killed at any moment.

A CSV file grows by whole lines, each one write followed by fsync; a line that was torn all the same (a full disk, a power cut)
is the last one and has no end, so it is recognised, dropped and measured again. ``settings.json`` says what all rows have in common.
Fitted bounders lie in ``bounders/``. Every other file is written whole (written beside, then renamed).

A lock (``flock`` on ``.lock``) keeps a second run out; the system releases it when its owner ends, however it ends. Where
there is no ``flock`` (Windows) nothing keeps two runs apart.
"""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.paper.rows import Key, Line, Row
from warp_bounding.paper.settings import Stored
from warp_bounding.runtime.whole_file import write_whole

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

__all__ = ["Folder", "open_folder", "read_settings"]

SETTINGS, PAGE, BOUNDERS, LOCK = "settings.json", "README.md", "bounders", ".lock"
FORMAT = 1


class Folder:
    """A locked folder and what is in it. Made by ``open_folder``.

    Attributes:
        path: Where.
        kind: Class of its rows.
        settings: Of all rows.
        commands: Command lines that contributed to it.
        rows: By key, in the order in which they were measured.
        notes: What was repaired, for people.
        table: The CSV.
        page: The Markdown page.
    """

    def __init__(self, path: Path, kind: type[Line], settings: Stored, commands: list[str]):
        self.path, self.kind, self.settings, self.commands = path, kind, settings, commands
        self.table, self.page = path / kind.table(), path / PAGE
        self.rows: dict[Key, Any] = {}
        self.notes: list[str] = []
        self._read()

    def bounder(self, name: str) -> Path:
        """Where a fitted bounder lies."""
        return self.path / BOUNDERS / f"{name}.safetensors"

    @property
    def fitted(self) -> set[str]:
        """Names of the fitted bounders."""
        return {path.stem for path in (self.path / BOUNDERS).glob("*.safetensors")}

    def append(self, row: Line) -> None:
        """Add a row to the table: once this returns, it is on the disk.

        Raises:
            FileFormatError: If it cannot be written.
        """
        try:
            with open(self.table, "r+b") as file:  # a table that was taken away is not begun again without its header
                file.seek(0, os.SEEK_END)
                file.write(row.line.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise FileFormatError(f"{self.table}: cannot be written ({error.strerror or error})") from error
        self.rows[row.key] = row

    def remember(self, command: str) -> None:
        """Note a command line that is about to contribute."""
        if command not in self.commands:
            self.commands.append(command)
            _write_settings(self.path, self.settings, self.commands)

    def _read(self) -> None:
        """Read the table, and repair what an interruption tore."""
        header = self.kind.header()
        content = self.table.read_bytes() if self.table.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        try:
            lines = whole.decode().split("\n")[:-1]
        except UnicodeDecodeError as error:
            raise FileFormatError(f"{self.table}: damaged, not text ({error.reason})") from None
        first = f"{lines[0]}\n" if lines else content.decode(errors="replace")
        if first != header and (lines or not header.startswith(first)):
            raise FileFormatError(
                f"{self.table}: not a table of this version: its first line is not {','.join(header.split(',')[:3])},..."
            )
        for number, line in enumerate(lines[1:], start=2):
            try:
                row = self.kind.parse(line)
                if not row.agrees(self.settings):
                    raise FileFormatError("it was measured with other settings")
                if row.key in self.rows:
                    raise FileFormatError("it is there twice")
            except BoundingError as error:
                raise FileFormatError(
                    f"{self.table}: line {number} is damaged ({error}); delete it and it is measured again"
                ) from None
            self.rows[row.key] = row
        if lines and whole != content:
            self.notes.append(f"{self.table}: the last line was torn by an interruption; dropped, to be measured again")
        if not lines or whole != content:
            write_whole(self.table, whole or header.encode())


@contextlib.contextmanager
def open_folder(path: Path, given: Mapping[str, Any], *, create: bool, kind: type[Line] = Row) -> Iterator[Folder]:
    """Lock a folder, and read or begin a table in it.

    Args:
        path: The folder.
        given: Settings that were asked for; the others (``None``) are those of the folder.
        create: Whether to begin one where there is none.
        kind: Class of its rows.

    Yields:
        The folder.

    Raises:
        BoundingError: If it is not such a folder, damaged, in use, of other settings, or cannot be written to; nothing is overwritten then.
    """
    file = path / SETTINGS
    if not file.exists():
        if not create:
            raise FileFormatError(f"{path}: no tables there yet; --data DIR is needed to make them")
        if path.exists() and not path.is_dir():
            raise FileFormatError(f"{path}: a file, expected a folder")
        strangers = [name for name in _names(kind) if (path / name).exists()]
        if strangers:
            raise FileFormatError(
                f"{path}: holds {', '.join(strangers)} but no {SETTINGS}; choose another folder for --out"
            )
        kind.SETTINGS.of(given)
    with _lock(path, kind):
        for part in (
            *(part for name in (*_names(kind), SETTINGS) for part in path.glob(f".{name}.*")),
            *(path / BOUNDERS).glob(".*.safetensors.*"),
        ):
            part.unlink()  # what a killed run had begun to write beside our files
        stored, commands = _read_settings(file, kind) if file.exists() else (None, [])
        if _is_blank(path, kind):  # an earlier run ended before it had anything: its settings bind nobody
            stored, commands = None, []
        try:
            settings = kind.SETTINGS.of(given, stored)
        except BoundingError as error:
            raise FileFormatError(f"{path}: {error}") from None
        if stored is None:
            _write_settings(path, settings, commands)  # before the table, which is nobody's without it
        yield Folder(path, kind, settings, commands)


@contextlib.contextmanager
def _lock(path: Path, kind: type[Line]) -> Iterator[None]:
    """Keep other runs out of the folder; made if there is none."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        file = os.open(path / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written to ({error.strerror or error})") from error
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        busy = f"another {kind.COMMAND} is at work there; wait for it or choose another --out"
        told = busy if isinstance(error, BlockingIOError) else f"cannot be locked ({error.strerror or error})"
        raise FileFormatError(f"{path}: {told}") from error
    try:
        yield
    finally:
        os.close(file)


def _names(kind: type[Line]) -> tuple[str, ...]:
    """Everything in a folder but the settings."""
    return (kind.table(), PAGE, *kind.PICTURES, BOUNDERS)


def _is_blank(path: Path, kind: type[Line]) -> bool:
    """Whether nothing has been fitted or measured here."""
    table = path / kind.table()
    return (not table.exists() or table.read_bytes() == kind.header().encode()) and not any((path / BOUNDERS).glob("*"))


def _write_settings(path: Path, settings: Stored, commands: list[str]) -> None:
    document = {"format": FORMAT, "settings": settings.to_dict(), "commands": commands}
    write_whole(path / SETTINGS, (json.dumps(document, indent=1) + "\n").encode())


def read_settings(path: Path, kind: type[Line] = Row) -> Any:
    """Settings of a folder that somebody else may be at work in; nothing is locked or repaired.

    Raises:
        FileFormatError: If it is not such a folder.
    """
    if not (path / SETTINGS).is_file() or not (path / kind.table()).is_file():
        raise FileFormatError(f"{path}: not a folder of {kind.COMMAND}: no {SETTINGS} and {kind.table()} there")
    return _read_settings(path / SETTINGS, kind)[0]


def _read_settings(path: Path, kind: type[Line]) -> tuple[Any, list[str]]:
    try:
        document = json.loads(path.read_text())
        version, settings, commands = (document[k] for k in ("format", "settings", "commands"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f"{path}: damaged or not the settings of a table") from error
    if version != FORMAT:
        raise FileFormatError(f"{path}: format {version}, this version of warp-bounding knows {FORMAT}")
    if not isinstance(commands, list) or not all(isinstance(c, str) for c in commands):
        raise FileFormatError(f"{path}: damaged: commands must be a list of texts")
    try:
        return kind.SETTINGS.from_dict(settings), commands
    except BoundingError as error:
        raise FileFormatError(f"{path}: {error}") from None
