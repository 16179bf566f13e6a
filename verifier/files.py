"""What is read: a bounder's numbers, a mesh's triangles."""

import hashlib
import json
from pathlib import Path

import numpy as np

SIZES = {"float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "uchar": "u1", "uint8": "u1"}  # of PLY
ENDS = {"binary_little_endian": "<", "binary_big_endian": ">"}
SIZES |= {"int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "short": "i2", "ushort": "u2"}


def read_bounder(path: Path) -> tuple[dict[str, np.ndarray], dict, str]:
    """Tensors in float64 by name, the description, and the file's SHA-256."""
    content = path.read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:end])
    about, tensors = json.loads(header.pop("__metadata__")["warp_bounding"])["bounder"], {}
    for name, entry in header.items():
        data = content[end:][slice(*entry["data_offsets"])]
        tensors[name] = np.frombuffer(data, {"F32": "<f4"}[entry["dtype"]]).reshape(entry["shape"]).astype(float)
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
    lines, vertices, faces = [line.split() for line in content.decode().splitlines() if line.strip()], [], []
    for word, *rest in lines:
        if word == "v":
            vertices.append([float(x) for x in rest[:3]])
        elif word == "f":
            corners = [int(x.split("/")[0]) for x in rest]
            faces.append([x - 1 if x > 0 else len(vertices) + x for x in corners])
    return vertices, faces


def _stl(content: bytes):
    words = content.split()
    if len(content) == 84 + 50 * int.from_bytes(content[80:84], "little"):
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        vertices = np.frombuffer(content, record, offset=84)["corners"]
    else:
        vertices = np.array([words[i + 1 : i + 4] for i, word in enumerate(words) if word == b"vertex"], float)
    return vertices, np.arange(vertices.size // 3).reshape(-1, 3)


def _ply(content: bytes):
    head, _, body = content.partition(b"end_header\n")
    words = [line.split() for line in head.decode().splitlines() if not line.startswith(("comment", "obj_info"))]
    if words[1][1] not in ENDS:
        raise ValueError(f"expected a binary PLY file, got one in {words[1][1]}, which is not read by this program")
    end = ENDS[words[1][1]]
    (_, vertex, vertices), (_, face, faces) = (line for line in words if line[0] == "element")
    *numbers, corners = (line[1:] for line in words if line[0] == "property")
    table = np.frombuffer(body, [(name, end + SIZES[size]) for size, name in numbers], int(vertices))
    row = [("count", end + SIZES[corners[1]]), ("corners", end + SIZES[corners[2]], 3)]
    rows = np.frombuffer(body, row, int(faces), table.nbytes)
    if (vertex, face, corners[0]) != ("vertex", "face", "list") or (rows["count"] != 3).any():
        raise ValueError("a PLY file of other elements than vertices and triangles is not read by this program")
    return np.stack([table[axis] for axis in "xyz"], axis=1), rows["corners"]
