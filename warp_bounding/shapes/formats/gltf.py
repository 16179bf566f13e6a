"""glTF 2.0 (``.glb``, or ``.gltf`` with buffers): triangles of the scene that is shown, in metres, y up.

A mesh is bounded as the file leaves it: without its morph targets, skins in the pose of their
joints' nodes; the notes say so. Extensions that the file requires and that are not in ``READ`` or ``HARMLESS`` are
refused, as is compressed geometry. What it merely uses, listed or not, may be left out, says the standard: its other
data are read, and a note names the extension.
"""

import base64
import binascii
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from warp_bounding.shapes.formats.reading import MeshData, as_faces, joined

__all__ = ["read_gltf", "referred_buffers"]

READ = {"EXT_mesh_gpu_instancing", "KHR_mesh_quantization"}
HARMLESS = re.compile(
    r"(KHR|EXT|MSFT|ADOBE)_(materials?|textures?|lights?|xmp)_.+|KHR_xmp|EXT_mesh_features|EXT_structural_metadata"
)  # how a surface looks, and what is told of it
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
POINTS_AND_LINES, TRIANGLES, STRIP, FAN = (0, 1, 2, 3), 4, 5, 6  # modes of a primitive
COMPRESSED = re.compile(r".*(draco|meshopt).*")  # of a primitive, or of a buffer view
MOST_ZEROS = 2**26  # elements of an accessor without data of its own
UNIT = 1e-2  # by how much the length of a rotation's quaternion may miss 1
INSTANCING = "EXT_mesh_gpu_instancing"


def read_gltf(path: Path) -> MeshData:
    """Read a glTF file; raises ``ValueError`` for one that is not whole, or needs what is not read."""
    document, chunk = _document(path.read_bytes())
    return _Asset(path.parent, document, chunk).read()


def referred_buffers(path: Path) -> set[Path]:
    """The files beside a ``.gltf`` that hold its buffers; raises ``ValueError`` or ``KeyError`` if it is damaged."""
    uris = [buffer.get("uri", "data:") for buffer in json.loads(path.read_text("utf-8")).get("buffers", [])]
    return {path.parent / unquote(uri) for uri in uris if not uri.startswith("data:")}


def _document(content: bytes) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a file, and the binary chunk of a ``.glb``."""
    chunk = None
    if content[:4] == b"glTF":
        version, length = (int.from_bytes(content[at : at + 4], "little") for at in (4, 8))
        if version != 2 or length != len(content):
            raise ValueError(f"expected {length} bytes of glTF 2, got {len(content)} bytes of glTF {version}")
        chunks, position = [], 12
        while position < length:
            size, kind = (
                int.from_bytes(content[position : position + 4], "little"),
                content[position + 4 : position + 8],
            )
            chunks.append((kind, content[position + 8 : position + 8 + size]))
            if len(chunks[-1][1]) != size:
                raise ValueError(f"expected a chunk of {size} bytes, got {len(chunks[-1][1])}")
            position += 8 + size
        kinds = [kind for kind, _ in chunks]
        if kinds[:1] != [b"JSON"] or kinds[1:2] not in ([], [b"BIN\0"]) or len(kinds) > 2:
            raise ValueError(f"expected a chunk of JSON and one of binary data, got {kinds}")
        content, chunk = chunks[0][1], chunks[1][1] if len(chunks) > 1 else None
    document = json.loads(content.rstrip(b"\0").decode("utf-8-sig"), object_pairs_hook=_without_doubles)
    if not isinstance(document, dict):
        raise ValueError(f"expected an object in JSON, got {str(document)[:40]!r}")
    version, least = (str(document["asset"].get(key)) for key in ("version", "minVersion"))
    if not version.startswith("2.") or least not in ("None", "2.0"):
        raise ValueError(f"expected glTF 2.0, got version {version[:20]}, minVersion {least[:20]}")
    return document, chunk


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError(f"expected each name once in an object, got {', '.join(key for key, _ in pairs)[:80]}")
    return found


def _whole(value: object, what: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"expected a number of 0 or more for {what}, got {value!r}")
    return value


def _reals(values: object, what: str) -> np.ndarray:
    """Finite numbers of JSON."""
    found = np.asarray(values)
    if found.dtype.kind not in "iuf" or not np.isfinite(found).all():
        raise ValueError(f"expected numbers as {what}, got {str(values)[:60]}")
    return found.astype(np.float64)


def _check_compression(item: dict[str, Any]) -> None:
    if names := [name for name in item.get("extensions", ()) if COMPRESSED.fullmatch(name)]:
        raise ValueError(f"it is compressed by an extension that is not read: {', '.join(names)}")


class _Asset:
    """A document and its data."""

    def __init__(self, folder: Path, document: dict[str, Any], chunk: bytes | None):
        self.folder, self.document, self.chunk = folder, document, chunk
        self.notes: list[str] = []
        self._buffers: dict[int, bytes] = {}

    def item(self, kind: str, index: object) -> dict[str, Any]:
        """``document[kind][index]``; raises ``ValueError`` if there is none."""
        items = self.document.get(kind, [])
        if _whole(index, f"an index of {kind}") >= len(items):
            raise ValueError(f"expected one of {len(items)} {kind}, got number {index}")
        return items[index]

    def read(self) -> MeshData:
        """All that the scene shows."""
        used = {*self._extensions(), *self.document.get("extensionsRequired", ())}
        unknown = sorted(name for name in used - READ if not HARMLESS.fullmatch(name))
        required = [name for name in unknown if name in self.document.get("extensionsRequired", ())]
        if required:
            raise ValueError(f"it requires extensions that are not read: {', '.join(required)}")
        self.notes += [f"extensions were not applied: {', '.join(unknown)}"] * bool(unknown)
        self.notes += ["animated: only the pose that the file stores is bounded"] * bool(
            self.document.get("animations")
        )
        self.matrices = {}
        nodes = self.document.get("nodes", [])
        children = {child for node in nodes for child in node.get("children", ())}
        roots = set(range(len(nodes))) - children
        for root in roots:
            self._place(root)
        if len(self.matrices) < len(nodes):
            raise ValueError("expected a forest of nodes, got nodes that are their own ancestors")
        shown = self._shown(roots)
        left_out = sum("mesh" in node for number, node in enumerate(nodes) if number not in shown)
        self.notes += [f"not read: {left_out} meshes outside the scene that the file shows"] * bool(left_out)
        return joined((part for number in sorted(shown) for part in self._parts(number)), self.notes)

    def _extensions(self) -> set[str]:
        """Names of all that are listed as used, or are there where geometry is."""
        kinds = ("scenes", "nodes", "meshes", "skins", "accessors", "bufferViews", "buffers")
        items = [self.document, *(item for kind in kinds for item in self.document.get(kind, ()))]
        items += [primitive for mesh in self.document.get("meshes", ()) for primitive in mesh["primitives"]]
        return {
            *self.document.get("extensionsUsed", ()),
            *(name for item in items for name in item.get("extensions", ())),
        }

    def _place(self, root: int) -> None:
        """World matrices of a node and of all below it."""
        waiting = [(root, np.eye(4))]
        while waiting:
            number, above = waiting.pop()
            if number in self.matrices:
                raise ValueError(f"expected a forest of nodes, got node {number} below two others")
            node = self.item("nodes", number)
            self.matrices[number] = above @ _matrix(node)
            waiting += [(child, self.matrices[number]) for child in node.get("children", ())]

    def _shown(self, roots: set[int]) -> set[int]:
        """Numbers of the nodes of the scene that the file shows; of all, if it has no scenes."""
        scenes = self.document.get("scenes", [])
        if not scenes:
            return set(self.matrices)
        if "scene" not in self.document and len(scenes) > 1:
            raise ValueError(f"expected the number of the scene to show, got {len(scenes)} scenes")
        found, waiting = set(), list(self.item("scenes", self.document.get("scene", 0)).get("nodes", ()))
        if any(number not in roots for number in waiting):
            raise ValueError("expected a scene of nodes that are below no other, got another node")
        while waiting:
            number = waiting.pop()
            waiting += self.item("nodes", number).get("children", ())
            found.add(number)
        return found

    def _parts(self, number: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices in the world and faces of a node's mesh."""
        node = self.item("nodes", number)
        instances = node.get("extensions", {}).get(INSTANCING)
        if "mesh" not in node:
            self.notes += ["instances of a node without a mesh were not read"] * (instances is not None)
            return
        mesh = self.item("meshes", node["mesh"])
        places = self.matrices[number][None]
        if instances is not None:
            places = places @ self._instances(instances["attributes"])
        for primitive in mesh["primitives"]:
            faces = self._faces(primitive)
            if faces is None:
                self.notes.append("not read, as they have no surface: points and lines")
                continue
            vertices = self._vertices(primitive)
            faces = as_faces(np.arange(len(vertices)) if faces is None else faces, len(vertices))
            poses = places[:, None]
            if "skin" in node:
                if instances is not None:
                    raise ValueError("expected a skin or instances of a mesh, got both")
                self.notes.append("skinned: only the pose that the file stores is bounded")
                poses = self._pose(node["skin"], primitive["attributes"], len(vertices))[None]
            for pose in poses:
                moved = (pose[..., :3, :3] @ vertices[..., None])[..., 0] + pose[..., :3, 3]
                mirrored = "skin" not in node and np.linalg.det(pose[0, :3, :3]) < 0
                yield moved, faces[:, ::-1] if mirrored else faces

    def _faces(self, primitive: dict[str, Any]) -> np.ndarray | None:
        """Triangles ``(F, 3)`` of a primitive; ``None`` for points and lines."""
        _check_compression(primitive)
        mode = _whole(primitive.get("mode", TRIANGLES), "mode")
        if mode in POINTS_AND_LINES:
            return None
        if mode not in (TRIANGLES, STRIP, FAN):
            raise ValueError(f"expected a primitive of mode 0 to 6, got {mode!r}")
        if "indices" in primitive:
            indices = self.accessor(primitive["indices"], ("SCALAR",), "u").ravel()
        else:
            indices = np.arange(
                _whole(self.item("accessors", primitive["attributes"].get("POSITION"))["count"], "count")
            )
        if mode == TRIANGLES:
            if len(indices) % 3:
                raise ValueError(f"expected three indices a triangle, got {len(indices)}")
            return indices.reshape(-1, 3)
        if len(indices) < 3:
            return np.zeros((0, 3), np.int64)
        first = np.zeros(len(indices) - 2, np.int64) if mode == FAN else np.arange(len(indices) - 2)
        second = np.arange(1, len(indices) - 1)
        turned = (mode == STRIP) & (first % 2 == 1)
        return indices[
            np.stack([first, np.where(turned, second + 1, second), np.where(turned, second, second + 1)], axis=1)
        ]

    def _vertices(self, primitive: dict[str, Any]) -> np.ndarray:
        """``(V, 3)`` float64 in the mesh's own coordinates."""
        vertices = self.accessor(primitive["attributes"].get("POSITION"), ("VEC3",))
        if primitive.get("targets"):
            self.notes.append("morph targets are not read")
        return vertices

    def _pose(self, skin: int, attributes: dict[str, int], count: int) -> np.ndarray:
        """``(V, 4, 4)``: what a skin makes of each vertex, in the world; the node's own matrix does not count."""
        found = self.item("skins", skin)
        joints = found["joints"]
        if any(joint not in self.matrices for joint in joints):
            raise ValueError(f"expected joints that are nodes, got {joints}")
        bones = np.stack([self.matrices[joint] for joint in joints])
        if "inverseBindMatrices" in found:
            inverse = self.accessor(found["inverseBindMatrices"], ("MAT4",)).reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(inverse) < len(joints):
                raise ValueError(f"expected {len(joints)} inverse bind matrices, got {len(inverse)}")
            bones = bones @ inverse[: len(joints)]
        pose, sums = np.zeros((count, 4, 4)), np.zeros(count)
        for number in range(len([key for key in attributes if key.startswith("JOINTS_")])):
            chosen = self.accessor(attributes[f"JOINTS_{number}"], ("VEC4",), "u").astype(np.int64)
            weights = self.accessor(attributes[f"WEIGHTS_{number}"], ("VEC4",))
            if not len(chosen) == len(weights) == count or chosen.max() >= len(joints):
                raise ValueError(f"expected joints 0 to {len(joints) - 1} and weights for {count} vertices")
            pose += (weights[..., None, None] * bones[chosen]).sum(axis=1)
            sums += weights.sum(axis=1)
        if not (np.abs(sums - 1) < UNIT).all():
            raise ValueError("expected weights of a skin that add up to 1")
        return pose

    def _instances(self, attributes: dict[str, int]) -> np.ndarray:
        """``(N, 4, 4)``, the places of instances."""
        kinds = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}
        found = {name: self.accessor(attributes[name], (kinds[name],)) for name in kinds if name in attributes}
        counts = {len(values) for values in found.values()}
        if len(counts) != 1:
            raise ValueError(
                f"expected instances with as many translations as rotations and scales, got {sorted(counts)}"
            )
        keys = [name.lower() for name in found]
        rows = zip(*found.values(), strict=True)
        return (
            np.stack([_matrix(dict(zip(keys, row, strict=True))) for row in rows])
            if counts != {0}
            else np.zeros((0, 4, 4))
        )

    def buffer(self, index: object) -> bytes:
        """The bytes of a buffer, all of them."""
        found = self.item("buffers", index)
        if index not in self._buffers:
            uri = found.get("uri")
            if uri is None:
                if index or self.chunk is None:
                    raise ValueError(f"buffer {index} has no data (of an extension that is not read?)")
                data = self.chunk
            elif uri.startswith("data:"):
                head, comma, text = uri.partition(",")
                if not head.endswith(";base64") or not comma:
                    raise ValueError(f"expected a data URI of base64, got {uri[:40]!r}")
                try:
                    data = base64.b64decode(unquote(text), validate=True)
                except binascii.Error as error:
                    raise ValueError(f"expected base64 in buffer {index}: {error}") from error
            else:
                path = self.folder / unquote(uri)
                if not path.is_file():
                    raise ValueError(f"it refers to {uri!r}, which is missing")
                data = path.read_bytes()
            if len(data) < _whole(found["byteLength"], "byteLength"):
                raise ValueError(f"expected {found['byteLength']} bytes in buffer {index}, got {len(data)}")
            self._buffers[index] = data[: found["byteLength"]]
        return self._buffers[index]

    def _view(self, index: object, offset: object, count: int, kind: np.dtype, width: int, strided: bool) -> np.ndarray:
        """``(count, width)`` numbers of a buffer view."""
        view = self.item("bufferViews", index)
        _check_compression(view)
        data = self.buffer(view["buffer"])
        start, length = _whole(view.get("byteOffset", 0), "byteOffset"), _whole(view["byteLength"], "byteLength")
        offset, size = _whole(offset, "byteOffset"), kind.itemsize * width
        stride = _whole(view.get("byteStride", size), "byteStride") if strided else size
        if start + length > len(data):
            raise ValueError(
                f"expected buffer view {index} within {len(data)} bytes, got it to end at {start + length}"
            )
        if stride < size or (count and offset + stride * (count - 1) + size > length):
            raise ValueError(
                f"expected {count} times {size} bytes, {stride} apart, in the {length} of buffer view {index}"
            )
        return np.ndarray((count, width), kind, data, start + offset if count else 0, (stride, kind.itemsize)).copy()

    def accessor(self, index: object, types: tuple[str, ...], kinds: str = "iuf") -> np.ndarray:
        """``(count, width)`` numbers: float64, normalised where it says so, or integers if ``kinds`` is ``"u"``."""
        found = self.item("accessors", index)
        if found["type"] not in types or found["componentType"] not in COMPONENTS:
            raise ValueError(
                f"expected an accessor of {' or '.join(types)}, got {found['type']} of {found['componentType']}"
            )
        kind, width, count = (
            np.dtype(COMPONENTS[found["componentType"]]),
            WIDTHS[found["type"]],
            _whole(found["count"], "count"),
        )
        if kind.kind not in kinds or (kinds != "u" and found["componentType"] == 5125):
            wanted = "unsigned integers" if kinds == "u" else "float32, or integers of 8 or 16 bits"
            raise ValueError(f"expected {wanted} in accessor {index}, got {kind}")
        if "bufferView" in found:
            values = self._view(found["bufferView"], found.get("byteOffset", 0), count, kind, width, True)
        elif "sparse" in found and count <= MOST_ZEROS:
            values = np.zeros((count, width), kind)
        else:
            raise ValueError(f"accessor {index} has no data (of an extension that is not read?)")
        if "sparse" in found:
            sparse = found["sparse"]
            number, at, new = _whole(sparse["count"], "count"), sparse["indices"], sparse["values"]
            where = np.dtype(COMPONENTS[at["componentType"]])
            places = self._view(at["bufferView"], at.get("byteOffset", 0), number, where, 1, False)[:, 0].astype(
                np.int64
            )
            if where.kind != "u" or (np.diff(places) <= 0).any() or (number and places[-1] >= count):
                raise ValueError(f"expected ascending indices below {count} in a sparse accessor")
            values[places] = self._view(new["bufferView"], new.get("byteOffset", 0), number, kind, width, False)
        if kinds == "u":
            return values
        values = values.astype(np.float64)
        if found.get("normalized", False) and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """``(4, 4)`` of a node's matrix, or of its translation, rotation and scale."""
    parts = {
        "translation": (3, [0, 0, 0]),
        "rotation": (4, [0, 0, 0, 1]),
        "scale": (3, [1, 1, 1]),
        "matrix": (16, np.eye(4).ravel()),
    }
    if "matrix" in node and parts.keys() & node.keys() != {"matrix"}:
        raise ValueError("expected a node's matrix, or its translation, rotation and scale; got both")
    found = {}
    for key, (size, default) in parts.items():
        found[key] = _reals(node.get(key, default), f"{key} of a node")
        if found[key].shape != (size,):
            raise ValueError(f"expected {size} numbers as {key} of a node, got {node[key]!r}")
    if "matrix" in node:
        matrix = found["matrix"].reshape(4, 4).T
        if (matrix[3] != [0, 0, 0, 1]).any():
            raise ValueError(f"expected an affine matrix of a node, got the last row {matrix[3].tolist()}")
        return matrix
    length = np.linalg.norm(found["rotation"])
    if abs(length - 1) > UNIT:
        raise ValueError(f"expected a unit quaternion as rotation, got one of length {length:.6g}")
    x, y, z, w = found["rotation"] / length
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * found["scale"], found["translation"]
    return matrix
