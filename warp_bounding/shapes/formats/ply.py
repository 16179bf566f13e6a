"""PLY, text or binary of either byte order: vertices, and faces or strips of triangles (``tristrips``).

The whole file is read by its header, elements of all names, so that nothing is left at its end. What has a list of its
own beside faces and strips is refused, as it may be geometry; other elements (edges, cameras, materials) are noted.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.shapes.formats.reading import MeshData, as_faces, as_numbers, joined, triangulated

__all__ = ["read_ply"]

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
        "double": "f8", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
FORMATS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
INDICES = ("vertex_indices", "vertex_index")  # names of the list of a face's corners


class _Property(NamedTuple):
    name: str
    kind: str  # of NumPy, without byte order
    counts: str | None  # of the numbers of entries, for a list


class _Element(NamedTuple):
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path) -> MeshData:
    """Read a PLY file; raises ``ValueError`` for one that is not whole, or holds faces in another way."""
    content = path.read_bytes()
    order, elements, start = _header(content)
    columns, rest = _text(elements, content[start:]) if order is None else _body(elements, content[start:], order)
    if rest:
        raise ValueError(f"expected the end of the file behind the last element, got {rest} bytes of numbers more")
    vertices, parts, notes = np.zeros((0, 3)), [], []
    if "vertex" in columns:
        missing = [name for name in "xyz" if not isinstance(columns["vertex"].get(name), np.ndarray)]
        if missing:
            raise ValueError(f"expected vertices with numbers x, y, z, got none of {', '.join(missing)}")
        vertices = np.stack([columns["vertex"][name].astype(np.float64) for name in "xyz"], axis=1)
    for element in elements:
        lists = {p.name: columns[element.name][p.name] for p in element.properties if p.counts}
        corners = [lists[name] for name in INDICES if name in lists]
        if element.name in ("face", "tristrips") and element.count:
            if len(corners) != 1:
                raise ValueError(f"expected one list of vertex_indices for {element.name}, got {len(corners)}")
            make = _faces if element.name == "face" else _strips
            faces, note = make(vertices, *corners[0])
            parts.append((vertices, faces))
            notes += note
        elif element.name != "vertex" and element.count:
            if lists:
                raise ValueError(
                    f"expected lists for face and tristrips only, got the element {element.name} with "
                    f"{', '.join(lists)}"
                )
            notes.append(f"not read: {element.count} of {element.name}")
        elif element.name == "vertex" and corners:
            raise ValueError("expected vertices without lists of vertices")
    return joined(parts, notes)


def _faces(vertices: np.ndarray, sizes: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, list[str]]:
    thin = sizes < 3
    faces = triangulated(vertices, sizes[~thin], corners[~np.repeat(thin, sizes)])
    as_faces(corners, len(vertices))
    return faces, [
        f"not read, as they have no surface: {thin.sum()} faces of fewer than 3 vertices"
    ] if thin.any() else []


def _strips(vertices: np.ndarray, sizes: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Triangles of strips that end with -1."""
    found = []
    for strip in np.split(corners, np.cumsum(sizes)[:-1]):
        for run in np.split(strip, np.flatnonzero(strip == -1)):
            run = run[run != -1]
            triples = np.lib.stride_tricks.sliding_window_view(run, 3) if len(run) > 2 else np.zeros((0, 3), np.int64)
            found += [triples[::2], triples[1::2, ::-1]]
    return as_faces(np.concatenate(found), len(vertices)), []


def _header(content: bytes) -> tuple[str | None, list[_Element], int]:
    """Byte order (``None``: a text), the elements, and where they begin."""
    first = next((end for end in (b"\r\n", b"\n", b"\r") if content.startswith(b"ply" + end)), None)
    if first is None:
        raise ValueError(f"expected a file that begins with 'ply', got {content[:8]!r}")
    order, elements, position = "", [], 0
    while True:
        end = content.find(first, position)
        if end < 0:
            raise ValueError("expected a header that ends with 'end_header', got none")
        words, position = content[position:end].decode("latin-1").split(), end + len(first)
        match words:
            case ["ply"] | ["comment" | "obj_info", *_] | []:
                pass
            case ["format", kind, "1.0"] if kind in FORMATS and order == "":
                order = FORMATS[kind]
            case ["element", name, count] if count.isdigit() and name not in [e.name for e in elements]:
                elements.append(_Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append(_Property(name, TYPES[kind], None))
            case ["property", "list", count, kind, name] if (
                elements and kind in TYPES and TYPES.get(count, "f")[0] in "iu"
            ):
                elements[-1].properties.append(_Property(name, TYPES[kind], TYPES[count]))
            case ["end_header"]:
                break
            case _:
                raise ValueError(f"expected a line of a PLY 1.0 header, got {' '.join(words)[:80]!r}")
    if order == "":
        raise ValueError("expected a line 'format' in the header, got none")
    for element in elements:
        names = [p.name for p in element.properties]
        if len(set(names)) < len(names):
            raise ValueError(f"expected properties of different names, got {', '.join(names)} for {element.name}")
        if any(p.counts and p.kind[0] == "f" and p.name in INDICES for p in element.properties):
            raise ValueError(f"expected integers as vertex indices of {element.name}, got floating-point numbers")
    return order, elements, position


Columns = dict[str, dict[str, Any]]  # by element and property: an array, or a list's sizes and entries


def _body(elements: list[_Element], content: bytes, order: str) -> tuple[Columns, int]:
    """Read element by element, and how many bytes are left."""
    position, found = 0, {}
    for element in elements:
        lists = [p for p in element.properties if p.counts]
        size = 0  # of the first row's list: rows that are all alike are read at once
        if len(lists) == 1 and element.count:
            before = sum(np.dtype(p.kind).itemsize for p in element.properties[: element.properties.index(lists[0])])
            size = _size(_take(content, order + lists[0].counts, 1, position + before)[0], len(content))
        fields: list[tuple] = []
        for p in element.properties:
            fields += (
                [("#", order + p.counts), (p.name, order + p.kind, (size,))] if p.counts else [(p.name, order + p.kind)]
            )
        row = np.dtype(fields) if len(lists) < 2 else None
        if row is not None and position + row.itemsize * element.count <= len(content):
            table = np.frombuffer(content, row, element.count, position) if row.itemsize else np.zeros(0, row)
            if not lists or (table["#"] == size).all():
                found[element.name] = {
                    p.name: table[p.name] if not p.counts else (np.full(len(table), size), table[p.name].ravel())
                    for p in element.properties
                }
                position += table.nbytes
                continue
        if element.count * max(1, len(element.properties)) > len(content) - position:
            raise ValueError(f"expected {element.count} of {element.name}, got the end of the file")
        found[element.name], position = _rows(element, content, order, position)
    return found, len(content) - position


def _rows(element: _Element, content: bytes, order: str, position: int) -> tuple[dict[str, Any], int]:
    """Read an element row by row, and where it ends."""
    values: list[list[np.ndarray]] = [[np.zeros(0, p.kind)] for p in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    for _ in range(element.count):
        for p, value, size in zip(element.properties, values, sizes, strict=True):
            count = 1
            if p.counts:
                head = _take(content, order + p.counts, 1, position)
                count, position = _size(head[0], len(content)), position + head.nbytes
            data = _take(content, order + p.kind, count, position)
            position += data.nbytes
            value.append(data)
            size.append(count)
    columns = [np.concatenate(value) for value in values]
    return {p.name: (np.array(size, np.int64), column) if p.counts else column
            for p, size, column in zip(element.properties, sizes, columns, strict=True)}, position  # fmt: skip


def _take(content: bytes, kind: str, count: int, position: int) -> np.ndarray:
    if position + np.dtype(kind).itemsize * count > len(content):
        raise ValueError("expected more numbers, got the end of the file")
    return np.frombuffer(content, kind, count, position) if count else np.zeros(0, kind)


def _size(number: np.generic, most: int) -> int:
    if not (0 <= number <= most and int(number) == number):
        raise ValueError(f"expected a list that fits into the file, got one of {number} entries")
    return int(number)


def _text(elements: list[_Element], content: bytes) -> tuple[Columns, int]:
    """Read a text as if it were binary doubles; integers must be whole, and a line is a row."""
    whole = [
        e._replace(properties=[_Property(p.name, "f8", p.counts and "f8") for p in e.properties]) for e in elements
    ]
    columns, rest = _body(whole, as_numbers(content.split()).astype("<f8").tobytes(), "<")
    widths = [np.zeros(0, np.int64)]
    for element in elements:
        widths.append(np.zeros(element.count, np.int64))
        for p in element.properties:
            column = columns[element.name][p.name]
            widths[-1] += 1 + column[0] if p.counts else 1
            entries = column[1] if p.counts else column
            if p.kind[0] in "iu":
                if not (np.floor(entries) == entries).all():
                    raise ValueError(f"expected integers for {p.name} of {element.name}, got another number")
                columns[element.name][p.name] = (column[0], entries.astype(np.int64)) if p.counts else entries
    found = np.array([count for line in content.splitlines() if (count := len(line.split()))], np.int64)
    wanted = np.concatenate(widths)
    if not np.array_equal(wanted[wanted > 0], found):
        raise ValueError(
            f"expected {(wanted > 0).sum()} lines, one for each vertex, face or other element, got {len(found)} of "
            "other lengths"
        )
    return columns, rest
