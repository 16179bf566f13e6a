"""What is read: a bounder's numbers, a mesh's triangles."""

import hashlib
import json
from pathlib import Path

import numpy as np

TYPES = {"F32": "<f4", "F16": "<f2", "U8": "u1"}  # of a bounder's file
SIZES = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}  # of PLY


def read_bounder(path: Path) -> tuple[dict[str, np.ndarray], dict, str]:
    """Tensors in float64 by name, the description, and the file's SHA-256."""
    content = path.read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:end])
    about, tensors = json.loads(header.pop("__metadata__")["warp_bounding"])["bounder"], {}
    for name, entry in header.items():
        data = content[end:][slice(*entry["data_offsets"])]
        tensors[name] = np.frombuffer(data, TYPES[entry["dtype"]]).reshape(entry["shape"]).astype(float)
        if not np.isfinite(tensors[name]).all():
            raise ValueError(f"{name} has numbers that are not finite")
    return tensors, about, hashlib.sha256(content).hexdigest()


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ``(V, 3)``, rounded to float32 and held in float64, and triangles ``(F, 3)``."""
    readers = {".obj": _obj, ".stl": _stl, ".ply": _ply}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: expected a mesh as OBJ, STL or PLY; others are not read by this program")
    vertices, faces = readers[path.suffix.lower()](path.read_bytes())
    vertices, faces = np.float32(vertices).astype(float).reshape(-1, 3), np.array(faces, np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"{path}: faces are none, no triangles, or of vertices that are not there")
    return vertices, faces


def _obj(content: bytes):
    lines = [line.split() for line in content.decode().splitlines() if line.strip()]
    vertices = [[float(x) for x in rest[:3]] for word, *rest in lines if word == "v"]
    faces = [[int(x.split("/")[0]) - 1 for x in rest] for word, *rest in lines if word == "f"]
    return vertices, faces


def _stl(content: bytes):
    if len(content) != 84 + 50 * int.from_bytes(content[80:84], "little"):
        raise ValueError("an STL file in ASCII, or of a wrong length, is not read by this program")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    vertices = np.frombuffer(content, record, offset=84)["corners"]
    return vertices, np.arange(vertices.size // 3).reshape(-1, 3)


def _ply(content: bytes):
    head, _, body = content.partition(b"end_header\n")
    words = [line.split() for line in head.decode().splitlines() if not line.startswith(("comment", "obj_info"))]
    (_, vertex, vertices), (_, face, faces) = (line for line in words if line[0] == "element")
    *numbers, corners = (line[1:] for line in words if line[0] == "property")
    table = np.frombuffer(body, [(name, SIZES[size]) for size, name in numbers], int(vertices))
    row = [("count", SIZES[corners[1]]), ("corners", SIZES[corners[2]], 3)]
    rows = np.frombuffer(body, row, int(faces), table.nbytes)
    kind = words[1][1], vertex, face, corners[0]
    if kind != ("binary_little_endian", "vertex", "face", "list") or (rows["count"] != 3).any():
        raise ValueError("a PLY file of other than vertices and triangles, binary and little endian, is not read")
    return np.stack([table[axis] for axis in "xyz"], axis=1), rows["corners"]
