"""Files that are written whole or not at all, and never over a file of another kind."""

import os
import tempfile
from pathlib import Path

from warp_bounding.errors import FileFormatError

BOUNDER = ".safetensors"  # suffix of a bounder's file


def file_path(path: str | os.PathLike) -> Path:
    """The path; raises ``FileFormatError`` for what is neither text nor a path."""
    if not isinstance(path, str | os.PathLike):
        raise FileFormatError(f"path must be a file name, got {type(path).__name__}")
    return Path(os.fsdecode(path))


def write_whole(path: str | os.PathLike, content: bytes, suffix: str | None = None) -> None:
    """Write a file so that nobody ever sees half of it, even after a crash or on a full disk.

    A symbolic link is kept, and the file that it points to is written. ``suffix`` is that of ``check_writable``. Raises
    ``FileFormatError`` if it cannot be written; an existing file is then untouched.
    """
    check_writable(path, suffix=suffix)
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


def check_writable(path: str | os.PathLike, *inputs: str | os.PathLike, suffix: str | None = None) -> None:
    """Find out before long work whether its result can be written at the end; changes nothing.

    An existing file is replaced only if it has the ``suffix`` or is empty: a shape, or whatever else a slip of the hand
    names, is kept. Raises ``FileFormatError`` for such a file, a path that is a folder or a device or cannot be written
    to, and one of the ``inputs``.
    """
    given = file_path(path)
    try:
        path = Path(os.path.realpath(given))
        there = path.exists()
        if there and any(Path(own).exists() and path.samefile(own) for own in inputs):
            raise FileFormatError(f"{given}: is read here, expected another file to write")
        if there and not path.is_file():
            what = "a folder" if path.is_dir() else "a device or a pipe"
            raise FileFormatError(f"{given}: is {what}, expected a file name")
        if there and suffix and given.suffix.lower() != suffix and path.stat().st_size:
            expected = f"expected a new name, or a {suffix} file to replace"
            raise FileFormatError(f"{given}: exists and is no {suffix} file, so it is kept; {expected}")
        place = path if there else next(folder for folder in path.parents if folder.exists())
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{given}: cannot be written ({getattr(error, 'strerror', None) or error})") from error
    if not os.access(place, os.W_OK) or not (there or place.is_dir()):
        raise FileFormatError(f"{given}: {place} is not a {'file' if there else 'folder'} that can be written to")
