"""Files that are written whole or not at all, and never over a file of another kind."""

import os
import tempfile
from pathlib import Path
from typing import NamedTuple

from warp_bounding.errors import FileFormatError

__all__ = [
    "ARRAY_FILE",
    "BOUNDER_FILE",
    "PAGE_FILE",
    "PICTURE_FILE",
    "FileKind",
    "check_writable",
    "file_path",
    "write_whole",
]


class FileKind(NamedTuple):
    """A kind of file, known by its suffix or by bytes of its content."""

    suffix: str
    at: int  # where in the content these bytes are
    start: bytes


BOUNDER_FILE = FileKind(".safetensors", 8, b"{")
ARRAY_FILE = FileKind(".npy", 0, b"\x93NUMPY")
PICTURE_FILE = FileKind(".png", 0, b"\x89PNG\r\n\x1a\n")
PAGE_FILE = FileKind(".html", 0, b"<!DOCTYPE html>")


def file_path(path: str | os.PathLike) -> Path:
    """The path; raises ``FileFormatError`` for what is neither text nor a path."""
    if not isinstance(path, str | os.PathLike):
        raise FileFormatError(f"path must be a file name, got {type(path).__name__}")
    return Path(os.fsdecode(path))


def write_whole(path: str | os.PathLike, content: bytes, kind: FileKind | None = None) -> None:
    """Write a file so that nobody ever sees half of it, even after a crash or on a full disk.

    A symbolic link is kept, and the file that it points to is written. ``kind`` is that of ``check_writable``. Raises
    ``FileFormatError`` if it cannot be written; an existing file is then untouched.
    """
    check_writable(path, kind=kind)
    given, path, temporary = file_path(path), Path(os.path.realpath(path)), None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            temporary = Path(file.name)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.umask(mask := os.umask(0))  # the only way to read it
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, path)
    except OSError as error:
        raise FileFormatError(f"{given}: cannot be written ({error.strerror or error})") from error
    finally:  # whatever ended it, Ctrl-C too
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike, *inputs: str | os.PathLike, kind: FileKind | None = None) -> None:
    """Find out before long work whether its result can be written at the end; changes nothing.

    An existing file is replaced only if it has the suffix or content of the ``kind``: a shape, or whatever else a slip
    of the hand names, is kept. Raises ``FileFormatError`` for such a file, a path that is a folder or a device or
    cannot be written to, and one of the ``inputs``.
    """
    given = file_path(path)
    if not os.fspath(path) or "\0" in str(given):
        raise FileFormatError(f"path must be a file name, got {os.fsdecode(path)!r}")
    path = Path(os.path.realpath(given))
    try:
        if any(path.exists() and Path(own).exists() and path.samefile(own) for own in inputs):
            raise FileFormatError(f"{given}: is read here, expected another file to write")
        if path.is_dir():
            raise FileFormatError(f"{given}: is a folder, expected a file name")
        if path.exists():
            if not path.is_file():
                raise FileFormatError(f"{given}: is a device or a pipe, expected a file name")
            if not os.access(path, os.W_OK):
                raise FileFormatError(f"{given}: exists and may not be written to")
            if kind is not None and given.suffix.lower() != kind.suffix and not _holds(path, kind):
                expected = f"expected a new name, or a {kind.suffix} file to replace"
                raise FileFormatError(f"{given}: exists and is no {kind.suffix} file, so it is kept; {expected}")
        folder = path.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
    except OSError as error:
        raise FileFormatError(f"{given}: cannot be written ({error.strerror or error})") from error
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise FileFormatError(f"{given}: {folder} is not a folder that can be written to")


def _holds(path: Path, kind: FileKind) -> bool:
    """Whether a file is of this kind by its content, or empty."""
    with path.open("rb") as file:
        content = file.read(kind.at + len(kind.start))
    return not content or content[kind.at :] == kind.start
