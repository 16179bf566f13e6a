"""STL, text or binary: all facets of all solids. Normals and attributes do not count; the corners do.

A text must consist of whole solids, each with its end. A binary file must be as long as its count of facets says; bytes
behind the last facet are noted if they are zeros, a text or too few for a facet's corners; all others may be facets
that the count leaves out.
"""

import codecs
import re
import string
from pathlib import Path

import numpy as np

from warp_bounding.shapes.formats.reading import MeshData, as_numbers, joined

__all__ = ["read_stl"]

HEADER = 80  # bytes before the count of a binary file
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
VERTEX = b"vertex . . . "
TEXT = (b"facet normal . . . outer loop " + 3 * VERTEX + b"endloop endfacet").split()
CORNERS = 36  # bytes
SOLID = re.compile(rb"^[ \t]*(solid|endsolid)\b(.*)$", re.MULTILINE)


def read_stl(path: Path) -> MeshData:
    """Read an STL file; raises ``ValueError`` for one that is not whole."""
    content = path.read_bytes()
    text = content.removeprefix(codecs.BOM_UTF8).strip(b"\0" + string.whitespace.encode())
    is_text = text[:5].lower() == b"solid" and b"\0" not in text
    corners, notes = (_text(text), ()) if is_text else _binary(content)
    return joined([(corners, np.arange(len(corners)).reshape(-1, 3))], notes)


def _text(content: bytes) -> np.ndarray:
    """``(3 F, 3)`` corners."""
    before, *pieces = SOLID.split(re.sub(rb"\r\n?", b"\n", content).lower())
    found = [before.split()] if before.strip() else []
    for number, (keyword, name, body) in enumerate(zip(*(pieces[i::3] for i in range(3)), strict=True)):
        if (keyword == b"solid") != (number % 2 == 0):
            raise ValueError("expected 'endsolid' before the next 'solid'; the file may have been cut off")
        if re.search(rb"\bfacet\s+normal\b|\bendsolid\b", name):
            raise ValueError("expected a name behind 'solid', got facets in the same line")
        if keyword == b"endsolid" and body.strip():
            raise ValueError(f"expected 'solid' behind 'endsolid', got {body.split()[0][:40].decode('latin-1')!r}")
        found.append(body.split())
    if len(pieces) % 6:
        raise ValueError("expected 'endsolid' at the end of the last solid; the file may have been cut off")
    numbers = []
    for words in found:
        for place, word in enumerate(TEXT):
            if word != b"." and any(other != word for other in words[place :: len(TEXT)]):
                raise ValueError(
                    "expected 'facet normal', 'outer loop', three vertices, 'endloop', 'endfacet'; got a facet of "
                    "another kind"
                )
        if len(words) % len(TEXT):
            raise ValueError(f"expected whole facets of {len(TEXT)} words, got {len(words)} words in a solid")
        places = [place for place, word in enumerate(TEXT) if word == b"." and place > 4]
        numbers.append(np.stack([as_numbers(words[place :: len(TEXT)]) for place in places], axis=1).reshape(-1, 3))
    return np.concatenate(numbers)


def _binary(content: bytes) -> tuple[np.ndarray, tuple[str, ...]]:
    """``(3 F, 3)`` corners, and notes."""
    start = HEADER + 4
    if len(content) < start:
        raise ValueError(f"expected a header of {start} bytes, got {len(content)} bytes")
    count = int.from_bytes(content[HEADER:start], "little")
    end = start + count * FACET.itemsize
    if len(content) < end and b"facet" in _letters(content):
        raise ValueError(
            f"expected a text in ASCII that begins with 'solid', or a whole binary file, got {content[:20]!r}..."
        )
    if len(content) < end:
        raise ValueError(f"expected {end} bytes for {count} facets, got {len(content)}")
    rest = content[end:]
    if rest.strip(b"\0"):
        text = not rest.rstrip(b"\0").translate(None, string.printable.encode())
        solids = re.search(b"solid|facet", _letters(rest))
        if len(rest) % FACET.itemsize == 0 or solids or (len(rest) >= CORNERS and not text):
            raise ValueError(f"the header counts {count} facets, and {len(rest)} bytes behind them may be more facets")
    facets = np.frombuffer(content, FACET, count, start)
    if rest and facets["attribute"].any():
        raise ValueError(
            f"{len(rest)} bytes behind the facets, and attributes that may tell how many bytes follow each facet"
        )
    return facets["corners"].reshape(-1, 3), (f"{len(rest)} bytes behind the last facet were not read",) if rest else ()


def _letters(content: bytes) -> bytes:
    """Small letters of a text, also of one in UTF-16."""
    return content.replace(b"\0", b"").lower()
