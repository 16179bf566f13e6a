"""Headers for C99, C++11 and CUDA: constant arrays and functions, whose names begin with one that the user gives."""

import os
import re
import textwrap
from collections.abc import Iterable, Iterator

from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.runtime.native import fill, native_text
from warp_bounding.runtime.whole_file import file_path, write_whole
from warp_bounding.version import __version__

MADE = "// Made by warp-bounding"  # how an export begins
WIDTH = 120
FOR_WARP = ("#pragma", "#line")  # lines that are for Warp's compiler


def write(path: str | os.PathLike, name: str | None, about: Iterable[str], parts: Iterable[str]) -> None:
    """Write a header of these parts, whose functions begin with ``name``, over no file but an earlier export.

    Args:
        path: File to write.
        name: That of the file, without its suffix, if ``None``.
        about: Paragraphs of the comment on top.
        parts: C text; ``$name`` stands for the name.

    Raises:
        BounderError: For a name that no function in C can begin with.
        FileFormatError: If the file cannot be written, or is something else.
    """
    path = file_path(path)
    name = path.stem if name is None else name
    if not (isinstance(name, str) and name.isidentifier() and name.isascii()):
        raise BounderError(f"name must be letters, digits and underscores, as C's names are, got {name!r}")
    if path.is_file() and path.stat().st_size and not path.read_bytes().startswith(MADE.encode()):
        raise FileFormatError(f"{path}: exists and is no header that was exported, so it is kept; expected a new name")
    comment = [f"{MADE[3:]} {__version__}, to be included as it is.", *about]
    lines = [line for text in comment for line in textwrap.wrap(text, WIDTH - 3) or [""]]
    top = "\n".join(f"// {line}".rstrip().replace("\\", "/") for line in lines)
    text = (
        "\n".join([native_text("export.h").HEAD, *parts, "#endif"])
        .replace("$name", name)
        .replace("$NAME", name.upper())
    )
    write_whole(path, f"{top}\n{''.join(_laid_out(text))}".encode())


def _laid_out(text: str) -> Iterator[str]:
    """The lines of C text, indented by their braces."""
    depth = 0
    for line in map(str.strip, text.splitlines()):
        if not line.startswith(FOR_WARP) and line:
            yield ("" if line.startswith("#") else "    " * (depth - line.startswith("}"))) + line + "\n"
            depth += line.count("{") - line.count("}")


def array(name: str, kind: str, values: Iterable[str]) -> str:
    """The C text of a function ``$name_name`` that gives constant numbers."""
    rows = textwrap.fill(", ".join(values), WIDTH - 8, break_long_words=False, break_on_hyphens=False)
    return fill(native_text("export.h").NUMBERS, what=name, kind=kind, numbers=rows, name="$name")


def private(text: str) -> str:
    """C text of which all functions, types and constants at file scope are called ``$name_private_...``.

    A function begins a line with ``static``, a type ends with ``} Type;``, constants stand in an ``enum`` on a line.
    ``WB_FUNCTION`` takes the place of ``static``. Functions that are named by ``$name`` keep their names.
    """
    functions = re.findall(r"^static .*?(?<![\w${])(\w+)\(", text, re.MULTILINE)
    others = re.findall(r"^} (\w+);", text, re.MULTILINE)
    for line in re.findall(r"^enum .*}", text, re.MULTILINE):
        others += re.findall(r"(\w+) =", line)
    names = "|".join([*(rf"{name}(?=\()" for name in functions), *(rf"{name}\b" for name in others)])
    text = re.sub(r"^static ", "WB_FUNCTION ", text, flags=re.MULTILINE)
    return re.sub(rf"\b({names})", r"$name_private_\1", text)
