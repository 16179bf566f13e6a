"""The folder of a run, which survives being killed at any moment.

A CSV file grows by whole lines, each one write followed by fsync; a line that was torn all the same (a full disk, a power cut)
is the last one and has no end, so it is recognised, dropped and measured again. ``settings.json`` says what all rows have in common.
Fitted bounders lie in ``bounders/``. Every other file is written whole (written beside, then renamed). ``settled`` keeps
a second run out.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from paper.rows import Key, Line, Row
from paper.settings import Stored
from paper.settled import SETTINGS, settings_and_commands, settled_folder, write_settings
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["Folder", "open_folder", "read_settings"]

PAGE, BOUNDERS = "README.md", "bounders"


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
            write_settings(self.path / SETTINGS, self.settings, self.commands)

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
    if not create and not (path / SETTINGS).exists():
        raise FileFormatError(f"{path}: no tables there yet; --data DIR is needed to make them")
    names = (kind.table(), PAGE, *kind.PICTURES, BOUNDERS)
    with settled_folder(path, given, kind.COMMAND, kind.SETTINGS, names, lambda: _is_blank(path, kind)) as settled:
        for part in (path / BOUNDERS).glob(".*.safetensors.*"):
            part.unlink()  # what a killed run had begun to write
        yield Folder(path, kind, *settled)


def _is_blank(path: Path, kind: type[Line]) -> bool:
    """Whether nothing has been fitted or measured here."""
    table = path / kind.table()
    return (not table.exists() or table.read_bytes() == kind.header().encode()) and not any((path / BOUNDERS).glob("*"))


def read_settings(path: Path, kind: type[Line] = Row) -> Any:
    """Settings of a folder that somebody else may be at work in; nothing is locked or repaired.

    Raises:
        FileFormatError: If it is not such a folder.
    """
    if not (path / SETTINGS).is_file() or not (path / kind.table()).is_file():
        raise FileFormatError(f"{path}: not a folder of {kind.COMMAND}: no {SETTINGS} and {kind.table()} there")
    return settings_and_commands(path / SETTINGS, kind.SETTINGS)[0]
