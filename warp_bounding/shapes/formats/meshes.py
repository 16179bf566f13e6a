"""STL, PLY and glTF, read by trimesh; OBJ and OFF.

trimesh leaves out without a word what it does not know, and reads some files that are cut off. Each of its formats has
a check here, of the file's bytes and of what trimesh made of them: the file is refused, or a note names what is left
out. OBJ has a reader of its own, as trimesh counts negative indices from the end of the file and loses lines that begin
with a blank; OFF has one because it is as short as a check.
"""

import codecs
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formats.collada import read_collada
from warp_bounding.shapes.formats.reading import (
    MeshData,
    as_faces,
    as_numbers,
    import_optional,
    joined,
    placed,
    reading,
    triangulated,
)
from warp_bounding.shapes.mesh import Mesh, mesh_of
from warp_bounding.shapes.recentred import Recentred


def _read_by_trimesh(path: Path) -> MeshData:
    """All meshes of a file's scene, where the scene places them; raises ``ValueError`` for one that is not whole."""
    trimesh = import_optional("trimesh", "trimesh", path)
    suffix, content = path.suffix.lower(), path.read_bytes()
    beside = trimesh.resolvers.FilePathResolver(str(path))
    plain = beside.get
    beside.get = lambda name: plain(unquote(name))  # glTF writes a blank in a file's name as %20
    notes = _check_gltf(content) if suffix in GLTF else []
    facets = _check_stl(content) if suffix == ".stl" else 0
    if suffix == ".ply":
        _check_ply_header(content)
    scene = trimesh.load_scene(path, resolver=beside, process=False, **OPTIONS[suffix])
    parts, others = parts_of(scene)
    if suffix == ".stl" and sum(len(faces) for _, faces in parts) != facets:
        raise ValueError(f"expected {facets} facets, all of them in solids")
    if suffix == ".ply":
        notes += [note for part in scene.geometry.values() for note in _check_ply(content, part.metadata["_ply_raw"])]
    return joined(parts, others + notes)


def parts_of(scene: Any) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[str]]:
    """Vertices and faces of all meshes of trimesh's scene, where it places them, and a note of what else it has."""
    parts, others = [], set()
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        part = scene.geometry[name]
        if hasattr(part, "faces"):
            vertices = np.asarray(part.vertices, np.float64)
            parts.append(placed(vertices, as_faces(part.faces, len(vertices)), matrix))
        else:
            others.add(type(part).__name__)
    return parts, [f"not read, as they are not meshes: {', '.join(sorted(others))}"] if others else []


GLTF = (".glb", ".gltf")
OPTIONS: dict[str, dict[str, Any]] = {
    ".stl": {},
    ".ply": {"fix_texture": False, "skip_materials": True},
    **{suffix: {"skip_materials": True} for suffix in GLTF},
}

# --- STL --------------------------------------------------------------------------------------------------------------

HEADER, FACET = 84, 50  # bytes of a binary file: before the first facet, and of each
LINES = [b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet"]


def _check_stl(content: bytes) -> int:
    """The number of facets; raises ``ValueError`` for a text other than of whole solids and triangles."""
    count = int.from_bytes(content[HEADER - 4 : HEADER], "little")
    if len(content) == HEADER + FACET * count:
        return count  # trimesh takes it for binary by the same rule
    text = content.removeprefix(codecs.BOM_UTF8).lower()
    solids, ends = (len(re.findall(rb"(?m)^\s*" + word, text)) for word in (rb"solid\b", rb"endsolid\b"))
    lines = re.findall(rb"(?m)^\s*(facet|outer|vertex(?=(?:[ \t]+\S+){3}\s*$)|endloop|endfacet)\b", text)
    if not lines or solids != ends or lines != LINES * (len(lines) // len(LINES)):
        raise ValueError("expected a binary file as long as it says, or whole solids of triangles in ASCII")
    return len(lines) // len(LINES)


# --- PLY --------------------------------------------------------------------------------------------------------------

NUMBER = rb"(?:char|uchar|short|ushort|u?int(?:8|16|32)?|float(?:32|64)?|double)"
PLY_LINE = re.compile(
    rb"|(comment|obj_info)( .*)?|format (ascii|binary_(little|big)_endian) 1\.0|element \S+ \d+"
    rb"|property (list %b )?%b \S+" % (NUMBER, NUMBER)
)


def _check_ply_header(content: bytes) -> None:
    """Raise ``ValueError`` for a header that trimesh would fail at without words."""
    header, end, _ = content.partition(b"\nend_header")
    first, *lines = (b" ".join(line.split()) for line in header.split(b"\n"))
    if first != b"ply" or not end:
        what = "a header from 'ply' to 'end_header', of lines that end in LF or CR LF"
        raise ValueError(f"expected {what}, got {content[:40]!r}")
    for line in lines:
        if not PLY_LINE.fullmatch(line):
            raise ValueError(f"expected a header of format, elements and properties, got the line {line[:60]!r}")


def _check_ply(content: bytes, elements: dict[str, dict]) -> list[str]:
    """Notes of elements that are left out.

    Raises ``ValueError`` for lines of a text that are not as many or as long as they say, and for lists of a binary
    file that trimesh took to be as long as the first one.
    """
    if re.search(rb"(?m)^format ascii", content):
        lines = [words for line in content.partition(b"end_header")[2].splitlines() if (words := line.split())]
        counts = [element["length"] for element in elements.values()]
        if len(lines) != sum(counts):
            raise ValueError(f"expected {sum(counts)} lines behind the header, got {len(lines)}")
        for name, element in elements.items():
            rows, lines = lines[: element["length"]], lines[element["length"] :]
            properties = list(element["properties"].values())
            lists = ["$LIST" in kind for kind in properties]
            simple = name == "face" and lists[0] and sum(lists) == 1
            if simple and any(int(words[0]) + len(properties) != len(words) for words in rows):
                raise ValueError("expected a line for each face, of as many numbers as it says")
    for name in ("vertex", "face"):
        data = elements.get(name, {}).get("data")
        for field in getattr(getattr(data, "dtype", None), "names", None) or ():
            if data[field].dtype.names and (data[field]["f0"] != np.prod(data[field]["f1"].shape[1:])).any():
                raise ValueError(f"expected lists of one length for {field}, as the file is binary; write a text")
    others = [name for name, element in elements.items() if name not in ("vertex", "face") and element["length"]]
    return [f"not read: elements {', '.join(others)}"] if others else []


# --- glTF -------------------------------------------------------------------------------------------------------------
#
# Coordinates are metres, y up, as they stand. Extensions that change the surface are refused. What a file merely uses
# may be left out, says the standard: a note names it.

GEOMETRY = re.compile(r".*(draco|meshopt|instancing).*", re.IGNORECASE)
HARMLESS = re.compile(
    r"(KHR|EXT|MSFT|ADOBE)_(materials?|textures?|lights?|xmp)_.+|KHR_xmp|EXT_mesh_features|EXT_structural_metadata"
    r"|KHR_mesh_quantization"
)  # how a surface looks, and what is told of it; and integers as coordinates, which trimesh reads
FAN, TRIANGLES = 6, 4


def referred_buffers(path: Path) -> set[Path]:
    """The files beside a ``.gltf`` that hold its buffers; raises ``ValueError`` or ``KeyError`` if it is damaged."""
    uris = [buffer.get("uri", "data:") for buffer in json.loads(path.read_text("utf-8")).get("buffers", [])]
    return {path.parent / unquote(uri) for uri in uris if not uri.startswith("data:")}


def _check_gltf(content: bytes) -> list[str]:
    """Notes of what is left out; raises ``ValueError`` for what trimesh would read otherwise than it is meant."""
    if content[:4] == b"glTF":
        length, size = (int.from_bytes(content[at : at + 4], "little") for at in (8, 12))
        if length != len(content):
            raise ValueError(f"expected {length} bytes, got {len(content)}")
        content = content[20 : 20 + size]
    names: set[str] = set()  # of extensions, wherever they are
    document = json.loads(content, object_hook=lambda item: names.update(item.get("extensions", ())) or item)
    if not str(document["asset"]["version"]).startswith("2.") or document["asset"].get("minVersion", "2.0") != "2.0":
        raise ValueError(f"expected glTF 2.0, got {document['asset']}")
    required = {*document.get("extensionsRequired", ())}
    wrong = [n for n in names | required if GEOMETRY.fullmatch(n) or (n in required and not HARMLESS.match(n))]
    if wrong:
        raise ValueError(f"expected a plain mesh, got extensions that are not read: {', '.join(sorted(wrong))}")
    nodes, scenes = document.get("nodes", ()), document.get("scenes", ())
    primitives = [primitive for mesh in document.get("meshes", ()) for primitive in mesh["primitives"]]
    below = [child for node in nodes for child in node.get("children", ())]
    below += document["scenes"][document.get("scene", 0)].get("nodes", ())
    if len(set(below)) < len(below):
        raise ValueError("expected a tree of nodes, got a node below two others")
    if any("camera" in node and node.keys() & {"mesh", "children"} for node in nodes):
        raise ValueError("expected cameras in nodes of their own, got one with a mesh or with nodes below it")
    if any("skin" in node for node in nodes):
        raise ValueError("expected a mesh without a skin, which is not read; write it in the pose to be bounded")
    for primitive in primitives:
        if primitive.get("mode", TRIANGLES) == FAN:
            raise ValueError("expected triangles or strips, got a fan")
        used = [primitive["attributes"]["POSITION"], primitive.get("indices")]
        for accessor in (document["accessors"][index] for index in used if index is not None):
            if "sparse" in accessor or accessor.get("normalized") or "bufferView" not in accessor:
                raise ValueError("expected plain numbers as positions and indices, got sparse or normalized ones")
    unknown = sorted(name for name in names | {*document.get("extensionsUsed", ())} if not HARMLESS.match(name))
    found = {
        f"extensions {', '.join(unknown)}": unknown,
        "animations": document.get("animations"),
        "morph targets": any(primitive.get("targets") for primitive in primitives),
        "scenes that the file does not show": len(scenes) > 1,
    }
    left_out = ", ".join(what for what, there in found.items() if there)
    return [f"not read: {left_out}"] if left_out else []


# --- OBJ --------------------------------------------------------------------------------------------------------------
#
# Vertices and polygons of all objects and groups. An OBJ file does not say how much it holds: of one that was cut off
# between two lines nobody can tell. Of lines that end in a backslash programs disagree: they are refused.

# Statements that do not change the surface: names, materials, shading, how it is displayed; points and lines.
IGNORED = frozenset(b"vt vn g o s mg usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj l p".split())


def _read_obj(path: Path) -> MeshData:
    points: list[bytes] = []  # words of vertices
    sizes: list[int] = []
    before: list[int] = []  # vertices so far, of each face
    corners: list[bytes] = []  # words of faces, such as 7/1/3
    for line in path.read_bytes().removeprefix(codecs.BOM_UTF8).splitlines():
        if line.rstrip().endswith(b"\\"):
            raise ValueError(f"expected statements of one line, got a backslash at the end of {line[:60]!r}")
        keyword, *words = line.split(b"#")[0].split() or [b"o"]
        if keyword == b"f":
            sizes.append(len(words))
            before.append(len(points) // 3)
            corners += words
        elif keyword == b"v" and (len(words) in (3, 6, 7) or (len(words) == 4 and float(words[3]) == 1)):
            points += words[:3]  # others are a colour
        elif keyword not in IGNORED:
            raise ValueError(f"expected a statement of a polygon mesh, got {line[:60]!r}")
    vertices, counts = as_numbers(points).reshape(-1, 3), np.array(sizes, np.int64)
    if odd := set(b"".join(corners)) - set(b"0123456789-/"):
        raise ValueError(f"expected corners such as 7 or 7/1/3, got some with {bytes(sorted(odd))[:20]!r}")
    numbers = np.array([int(word.split(b"/")[0]) for word in corners], np.int64)
    if (numbers == 0).any():
        raise ValueError("expected vertices counted from 1, or backwards from -1, got 0")
    indices = np.where(numbers > 0, numbers - 1, np.repeat(np.array(before, np.int64), counts) + numbers)
    return joined([(vertices, triangulated(counts, indices, len(vertices)))])


# --- OFF --------------------------------------------------------------------------------------------------------------


def _read_off(path: Path) -> MeshData:
    """Vertices and polygons of a text, one a line. Normals, colours and texture coordinates do not count."""
    lines = [words for line in path.read_bytes().splitlines() if (words := line.split(b"#")[0].split())]
    if not re.fullmatch(rb"(ST)?[CN]*OFF", lines[0][0]):
        raise ValueError(f"expected a text that begins with OFF, of vertices x y z, got {lines[0][0][:40]!r}")
    sizes, *rows = [lines[0][1:], *lines[1:]] if lines[0][1:] else lines[1:]
    count, polygons = map(int, sizes[:2])
    if len(rows) != count + polygons:
        raise ValueError(f"expected {count} vertices and {polygons} faces, one a line, got {len(rows)} lines")
    if len({len(row) for row in rows[:count]}) > 1:
        raise ValueError("expected vertices of as many numbers as the first one")
    vertices = as_numbers([word for row in rows[:count] for word in row[:3]]).reshape(count, 3)
    faces = [row[1 : int(row[0]) + 1] for row in rows[count:]]
    counts = np.array([len(face) for face in faces], np.int64)
    if counts.tolist() != [int(row[0]) for row in rows[count:]]:
        raise ValueError("expected faces of a number n and n indices, got fewer")
    indices = np.array([int(word) for face in faces for word in face], np.int64)
    return joined([(vertices, triangulated(counts, indices, count))])


# --- All formats ------------------------------------------------------------------------------------------------------

MESH_READERS: dict[str, Callable[..., MeshData]] = {
    ".obj": _read_obj,
    ".off": _read_off,
    ".dae": read_collada,
    **dict.fromkeys(OPTIONS, _read_by_trimesh),
}


def read_mesh_data(path: Path, upright: bool | None = None) -> MeshData:
    """Read the vertices and faces of a mesh file; ``ShapeError`` for one that is damaged or not read.

    ``upright`` is what ``read_collada`` takes.
    """
    suffix = path.suffix.lower()
    if suffix not in MESH_READERS:
        raise ShapeError(f"{path}: expected a mesh file of {' '.join(MESH_READERS)}, got {suffix or 'no extension'!r}")
    expected = f"a {suffix} mesh{', in binary with faces of one size only' if suffix == '.ply' else ''}"
    with reading(path, expected), np.errstate(all="ignore"):  # vertices that are not finite are refused
        return MESH_READERS[suffix](path, **{"upright": upright} if suffix == ".dae" else {})


def read_mesh(path: Path) -> Mesh | Recentred:
    """Read a mesh file as ``read_mesh_data`` does; ``ShapeError`` also for what ``Mesh`` refuses."""
    vertices, faces, notes = read_mesh_data(path)
    return mesh_of(vertices, faces, name=path.name, note="; ".join(notes))
