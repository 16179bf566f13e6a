"""OFF (Geomview's): vertices and polygons of a text. Normals, colours and texture coordinates are left aside.

Vertices of four or of n numbers, and the binary form, are refused.
"""

import re
from pathlib import Path

import numpy as np

from warp_bounding.shapes.formats.reading import MeshData, as_numbers, joined, triangulated

__all__ = ["read_off"]

HEADER = re.compile(rb"(ST)?(CN?|NC?)?(4)?(n)?OFF")
COLOURS = (0, 3, 4)  # how many numbers a colour may have


def read_off(path: Path) -> MeshData:
    """Read an OFF file; raises ``ValueError`` for one that is not whole, or of another form."""
    lines = [words for line in path.read_bytes().splitlines() if (words := line.split(b"#")[0].split())]
    first = lines.pop(0) if lines else [b""]
    kind = HEADER.fullmatch(first[0])
    if not kind:
        raise ValueError(f"expected a file that begins with 'OFF', got {first[0][:40].decode('latin-1')!r}")
    texture, more, four, many = kind.groups(default=b"")
    if four or many or b"BINARY" in first:
        what = "binary data" if b"BINARY" in first else "vertices of 4 numbers" if four else "vertices of n numbers"
        raise ValueError(f"expected a text of vertices x y z, got {what} ({b' '.join(first).decode('latin-1')})")
    if len(first) > 1:
        lines.insert(0, first[1:])
    if not lines or len(lines[0]) not in (2, 3) or not all(word.isdigit() for word in lines[0]):
        raise ValueError("expected the numbers of vertices, faces and edges behind 'OFF'")
    count, polygons = (int(word) for word in lines[0][:2])
    lines = lines[1:]
    if len(lines) != count + polygons:
        raise ValueError(f"expected {count} vertices and {polygons} faces, one a line, got {len(lines)} lines")
    fixed = 3 + 3 * (b"N" in more) + 2 * bool(texture)
    widths = {fixed + c for c in (COLOURS[1:] if b"C" in more else COLOURS if first[0] == b"OFF" else COLOURS[:1])}
    if wrong := [line for line in lines[:count] if len(line) not in widths]:
        raise ValueError(f"expected {' or '.join(map(str, sorted(widths)))} numbers a vertex, got {len(wrong[0])}")
    vertices = as_numbers([word for line in lines[:count] for word in line[:3]]).reshape(-1, 3)
    sizes, corners, thin = [], [], 0
    for line in lines[count:]:
        size = int(line[0]) if line[0].isdigit() else -1
        if len(line) - 1 - size not in COLOURS or size < 0 or not all(word.isdigit() for word in line[1 : size + 1]):
            raise ValueError(
                f"expected a face as n and n indices (and a colour), got {b' '.join(line)[:60].decode('latin-1')!r}"
            )
        if size < 3:
            thin += 1
            continue
        sizes.append(size)
        corners += map(int, line[1 : size + 1])
    faces = triangulated(vertices, np.array(sizes, np.int64), np.array(corners, np.int64))
    return joined([(vertices, faces)], [f"not read, as they have no surface: {thin} points and lines"] if thin else [])
