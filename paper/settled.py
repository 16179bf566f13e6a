"""A locked folder whose settings every run in it agrees with: ``settings.json``, which also remembers the command lines.

A lock (``flock`` on ``.lock``) keeps a second run out; the system releases it when its owner ends, however it ends. Where
there is no ``flock`` (Windows) nothing keeps two runs apart.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from paper.settings import Stored
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import write_whole

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

__all__ = ["SETTINGS", "settings_and_commands", "settled_folder", "write_settings"]

SETTINGS, LOCK = "settings.json", ".lock"
FORMAT = 1


@contextlib.contextmanager
def settled_folder(
    path: Path,
    given: Mapping[str, Any],
    command: str,
    kind: type[Stored],
    names: tuple[str, ...],
    is_blank: Callable[[], bool],
) -> Iterator[tuple[Any, list[str]]]:
    """Lock a folder, made if there is none, and read or begin its settings.

    Args:
        path: The folder.
        given: Settings that were asked for; the others (``None``) are those of the folder.
        command: Whose folder it is.
        kind: Class of its settings.
        names: Everything that the command may write there, but for the settings.
        is_blank: Tells whether an earlier run ended before it had anything: its settings bind nobody then.

    Yields:
        The settings, and the command lines that contributed so far.

    Raises:
        BoundingError: If it is not such a folder, damaged, in use, of other settings, or cannot be written to; nothing is overwritten then.
    """
    file = path / SETTINGS
    if not file.exists():
        if path.exists() and not path.is_dir():
            raise FileFormatError(f"{path}: a file, expected a folder")
        strangers = [name for name in names if (path / name).exists()]
        if strangers:
            raise FileFormatError(
                f"{path}: holds {', '.join(strangers)} but no {SETTINGS}; choose another folder for --out"
            )
        kind.of(given)
    with _lock(path, command):
        for part in (part for name in (*names, SETTINGS) for part in path.glob(f".{name}.*")):
            part.unlink()  # what a killed run had begun to write beside our files
        stored, commands = settings_and_commands(file, kind) if file.exists() else (None, [])
        if is_blank():
            stored, commands = None, []
        try:
            settings = kind.of(given, stored)
        except BoundingError as error:
            raise FileFormatError(f"{path}: {error}") from None
        if stored is None:
            write_settings(file, settings, commands)  # before all else, which is nobody's without it
        yield settings, commands


@contextlib.contextmanager
def _lock(path: Path, command: str) -> Iterator[None]:
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
        busy = f"another {command} is at work there; wait for it or choose another --out"
        told = busy if isinstance(error, BlockingIOError) else f"cannot be locked ({error.strerror or error})"
        raise FileFormatError(f"{path}: {told}") from error
    try:
        yield
    finally:
        os.close(file)


def write_settings(file: Path, settings: Stored, commands: list[str]) -> None:
    """Write the settings of a folder, and the command lines that contributed to it."""
    document = {"format": FORMAT, "settings": settings.to_dict(), "commands": commands}
    write_whole(file, (json.dumps(document, indent=1) + "\n").encode())


def settings_and_commands(file: Path, kind: type[Stored]) -> tuple[Any, list[str]]:
    """Inverse of ``write_settings``.

    Raises:
        FileFormatError: If they are damaged, or not those of this version.
    """
    try:
        document = json.loads(file.read_text())
        version, settings, commands = (document[k] for k in ("format", "settings", "commands"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f"{file}: damaged or not the settings of a table") from error
    if version != FORMAT:
        raise FileFormatError(f"{file}: format {version}, this version of warp-bounding knows {FORMAT}")
    if not isinstance(commands, list) or not all(isinstance(c, str) for c in commands):
        raise FileFormatError(f"{file}: damaged: commands must be a list of texts")
    try:
        return kind.from_dict(settings), commands
    except BoundingError as error:
        raise FileFormatError(f"{file}: {error}") from None
