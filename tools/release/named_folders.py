"""Where a file names a folder of the machine that it was made on, in texts, pictures, bounders and notebooks."""

import base64
import json
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

__all__ = ["TOPS", "folders"]

# Put together from parts, so that this file does not hold what it looks for.
TOPS = ("home", "root", "Users", "tmp", "work", "workspace", "var", "mnt", "media", "opt", "srv", "builds", "private")
FOLDERS = [
    rf"(?<![\w.~-])/(?:{'|'.join(TOPS)})/",
    r"\b[A-Za-z]:[\\/]+(?:Users|Documents|Temp)\b",
    r"(?:site|dist)-packages/",
]
FOLDER = re.compile("|".join(FOLDERS))
PNG = b"\x89PNG\r\n\x1a\n"


def of_png(content: bytes) -> Iterator[str]:
    """Everything in a PNG file that is not the picture."""
    assert content.startswith(PNG)
    at = len(PNG)
    while at < len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        data = content[at + 8 : at + 8 + length]
        at += 12 + length
        if kind == b"zTXt":
            key, _, rest = data.partition(b"\0")
            data = key + b" " + zlib.decompress(rest[1:])
        elif kind == b"iTXt":
            key, _, rest = data.partition(b"\0")
            text = rest[2:].split(b"\0", 2)[2]
            data = key + b" " + (zlib.decompress(text) if rest[0] else text)
        if kind not in (b"IDAT", b"PLTE"):
            yield data.decode("latin-1")


def of_safetensors(content: bytes) -> Iterator[str]:
    """The description in front of the tensors."""
    (length,) = struct.unpack_from("<Q", content)
    yield content[8 : 8 + length].decode()


def of_notebook(content: bytes) -> Iterator[str]:
    """Every text, outputs too; of pictures what is beside the picture."""

    def walk(value, key="") -> Iterator[str]:
        if isinstance(value, dict):
            for name, inner in value.items():
                yield name
                yield from walk(inner, name)
        elif isinstance(value, list):
            for inner in value:
                yield from walk(inner, key)
        elif key == "image/png":
            yield from of_png(base64.b64decode(value))
        elif isinstance(value, str):
            yield value

    yield from walk(json.loads(content))


def of_webp(content: bytes) -> Iterator[str]:
    """All bytes: what is no picture is plain text."""
    yield content.decode("latin-1")


READERS = {".png": of_png, ".webp": of_webp, ".safetensors": of_safetensors, ".ipynb": of_notebook}


def folders(name: str, content: bytes) -> list[str]:
    """Folders of a machine that a file names, with a little of what is around them."""
    texts = READERS.get(Path(name).suffix, lambda c: [c.decode()])(content)
    return [text[max(found.start() - 30, 0) : found.end() + 50] for text in texts for found in FOLDER.finditer(text)]
