"""OBJ (Wavefront's): vertices and polygons of all objects and groups.

Materials, normals and texture coordinates do not count.

Points and lines are noted; free-form curves and surfaces, and what calls other files, are refused, as is every
statement that is not known. An OBJ file does not say how much it holds: of one that was cut off between two lines
nobody can tell.
"""

import codecs
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from warp_bounding.shapes.formats.reading import MeshData, as_numbers, joined, triangulated

__all__ = ["read_obj"]

# Statements that do not change the surface: names, materials, shading, and how it is displayed.
IGNORED = frozenset(
    b"vt vn g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj".split()
)
CONTINUED = frozenset(b"v vt vn f l p".split())  # numbers, which may go on in another line
THIN = {b"p": "points", b"l": "lines"}
FREE_FORM = frozenset(
    b"vp cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con ctech stech bzp bsp cdc cdp res".split()
)


def read_obj(path: Path) -> MeshData:
    """Read an OBJ file; raises ``ValueError`` for what is no polygon, or faces of vertices that are not there."""
    points: list[bytes] = []  # words of vertices
    sizes: list[int] = []
    before: list[int] = []  # vertices so far, of each face
    corners: list[bytes] = []  # words of faces
    thin: set[str] = set()
    for line in _lines(path.read_bytes().removeprefix(codecs.BOM_UTF8)):
        words = line.split(b"#")[0].split()
        if not words:
            continue
        keyword = words[0]
        if keyword == b"f":
            if len(words) < 4:
                raise ValueError(f"expected faces of at least 3 vertices, got {_shown(line)}")
            sizes.append(len(words) - 1)
            before.append(len(points) // 3)
            corners += words[1:]
        elif keyword == b"v":
            if len(words) not in (4, 5, 7):
                raise ValueError(f"expected vertices x y z, and a weight or a colour, got {_shown(line)}")
            if len(words) == 5 and as_numbers(words[4:]) != 1:
                raise ValueError(f"expected vertices of weight 1, got the rational vertex {_shown(line)}")
            points += words[1:4]
        elif keyword in THIN:
            thin.add(THIN[keyword])
        elif keyword in FREE_FORM:
            raise ValueError(f"expected polygons, got a free-form curve or surface: {_shown(line)}")
        elif keyword not in IGNORED:
            raise ValueError(f"expected a statement of a polygon mesh, got {_shown(line)}")
    vertices, counts = as_numbers(points).reshape(-1, 3), np.array(sizes, np.int64)
    indices = _indices(corners, np.repeat(np.array(before, np.int64), counts))
    notes = [f"not read, as they have no surface: {', '.join(sorted(thin))}"] if thin else []
    return joined([(vertices, triangulated(vertices, counts, indices))], notes)


def _lines(content: bytes) -> Iterator[bytes]:
    """Lines, joined where they end in a backslash; raises ``ValueError`` where programs disagree about that."""
    begun: list[bytes] = []
    for line in content.splitlines():
        if begun and line.lstrip()[:1].isalpha():
            raise ValueError(f"expected numbers behind a line that ends with a backslash, got {_shown(line)}")
        begun.append(line)
        if line.endswith(b"\\") or (b"\\" in line and line.rstrip().endswith(b"\\")):
            if b"#" in line or begun[0].split()[0] not in CONTINUED:
                raise ValueError(f"expected a backslash only at the end of a line of numbers, got {_shown(line)}")
            begun[-1] = line.rstrip()[:-1]
            continue
        yield b" ".join(begun)
        begun = []
    if begun:
        raise ValueError("expected another line behind a backslash; the file may have been cut off")


def _indices(words: list[bytes], before: np.ndarray) -> np.ndarray:
    """Vertices, counted from 0, of words such as ``7/1/3``; negative ones count back from the vertices ``before``."""
    if odd := set(b"".join(words).translate(None, b"0123456789-/")):
        raise ValueError(f"expected corners such as 7 or 7/1/3, got {_shown(next(w for w in words if odd & set(w)))}")
    numbers = as_numbers([word.split(b"/")[0] for word in words])
    if wrong := np.flatnonzero(numbers == 0).tolist():
        raise ValueError(f"expected vertices counted from 1, or backwards from -1, got {_shown(words[wrong[0]])}")
    if wrong := np.flatnonzero(numbers < -before).tolist():
        raise ValueError(f"expected a vertex from -1 to -{before[wrong[0]]}, got {numbers[wrong[0]]:.15g}")
    return np.where(numbers > 0, numbers - 1, before + numbers)


def _shown(text: bytes) -> str:
    return repr(text[:60].decode("latin-1"))
