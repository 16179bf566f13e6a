"""A file for each row of the table of formats that is about meshes: a cube of half width 1, with something unusual
about it."""

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from format_cases import QUADS, Case, T, V, cubes, file, same

from warp_bounding import arms

NOTCHED = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], float)  # a U, which no fan cuts
PRISM = np.array([[x, y, z] for z in (0, 1) for x, y in NOTCHED])
WALLS = [(k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8) for k in range(8)]
U_CAPS = (tuple(range(7, -1, -1)), tuple(range(8, 16)))


def prism(shape) -> None:
    """A U is as large as a U: no triangle lies across its opening."""
    area = 2 * 7 + (3 + 3 + 1 + 2 + 1 + 2 + 1 + 3)
    corners = shape.vertices[shape.faces].astype(float)
    found = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert found == pytest.approx(area)
    assert abs(np.linalg.det(corners).sum() / 6) == pytest.approx(7)


# --- STL


def solid(name="a", shift=0.0, end="endsolid", lines: tuple[str, ...] = ()) -> str:
    out = [f"solid {name}"]
    for face in T:
        out += ["facet normal 0 0 0", "outer loop"]
        out += ["vertex {:g} {:g} {:g}".format(*(V[k] + [shift, 0, 0])) for k in face]
        out += [*lines, "endloop", "endfacet"]
    return "\n".join([*out, end, ""])


def binary_stl(header=b"", faces=T, normal=(0, 0, 0), attribute=0, count=None) -> bytes:
    facets = b"".join(struct.pack("<12fH", *normal, *V[face].ravel(), attribute) for face in faces)
    return header.ljust(80, b"\0") + struct.pack("<I", len(faces) if count is None else count) + facets


STL = {
    "stl/text": Case(file("a.stl", solid().replace("\n", "\r\n").upper()), check=cubes()),
    "stl/binary": Case(file("a.stl", binary_stl(normal=(9, np.nan, 1), attribute=7)), check=cubes()),
    "stl/solid-in-binary-header": Case(file("a.stl", binary_stl(b"solid facet normal")), check=cubes()),
    "stl/several-solids": Case(file("a.stl", solid() + "solid\nendsolid\n" + solid("b c", 5)), check=cubes((0, 0, 0),
        (5, 0, 0))),
    "stl/byte-order-mark": Case(file("a.stl", "\ufeff\n" + solid() + "\0\0"), check=cubes()),
    "stl/other-texts": Case(file("a.stl", solid().encode("utf-16")), "begins with 'solid'"),
    "stl/no-end": Case(file("a.stl", solid() + solid("b", 5, "")), "'endsolid' at the end"),
    "stl/cut": Case(file("a.stl", solid()[:-400]), "cut off"),
    "stl/other-facets": Case(file("a.stl", solid(lines=("vertex 0 0 0",))), "facet of another kind"),
    "stl/binary-cut": Case(file("a.stl", binary_stl()[:-50]), "684 bytes for 12 facets, got 634"),
    "stl/more-facets": Case(file("a.stl", binary_stl(count=11)), "may be more facets"),
    "stl/two-files": Case(file("a.stl", binary_stl() + binary_stl()), "may be more facets"),
    "stl/trailing-data": Case(file("a.stl", binary_stl(count=11)[:-10]), "may be more facets"),
    "stl/trailing-bytes": Case(file("a.stl", binary_stl() + b"made by hand"), "12 bytes behind the last facet",
        cubes()),
    "stl/bytes-behind-each-facet": Case(file("a.stl", binary_stl(attribute=2) + b"\7" * 24), "how many bytes follow"),
    "stl/not-finite": Case(file("a.stl", solid().replace("vertex 1", "vertex nan", 1)), "finite"),
}  # fmt: skip

# --- PLY


def ply(
    kind="ascii",
    faces=QUADS,
    vertex="",
    face="",
    index="int",
    name="vertex_indices",
    real="float",
    more="",
    rest=b"",
    before=b"",
    points=V,
    after="",
) -> bytes:
    """A cube; ``vertex`` and ``face`` are further properties of a byte each, ``more`` further lines of the header."""
    more_text, more_bytes = (" 1 7", b"\1\7") if "list" in face else (" 7" * bool(face), b"\7" * bool(face))
    code = {"int": "i", "uint": "I", "uchar": "B", "float": "f", "double": "d"}
    header = f"ply\nformat {kind} 1.0\ncomment a cube\n{more}element vertex {len(points)}\n"
    header += "".join(f"property {real} {axis}\n" for axis in "xyz") + vertex
    header += f"element face {len(faces)}\nproperty list uchar {index} {name}\n{face}{after}end_header\n"
    if kind == "ascii":
        rows = ["{:g} {:g} {:g}".format(*p) + " 7" * bool(vertex) for p in points]
        rows += [f"{len(f)} {' '.join(map(str, f))}" + more_text for f in faces]
        return header.encode() + before + "\n".join([*rows, ""]).encode() + rest
    order = "<" if "little" in kind else ">"
    body = b"".join(struct.pack(f"{order}3{code[real]}", *p) + b"\7" * bool(vertex) for p in points)
    return header.encode() + before + body + b"".join(struct.pack(f"{order}B{len(f)}{code[index]}", len(f), *f)
        + more_bytes for f in faces) + rest  # fmt: skip


LITTLE, BIG = "binary_little_endian", "binary_big_endian"
MIXED = (*QUADS[:5], QUADS[5][:3], (QUADS[5][0], *QUADS[5][2:]))
CAMERA = "element camera 1\nproperty float fov\n"
GROUP = "element group 1\nproperty list uchar int members\n"
STRIPS = [0, 1, 2, 3, 6, 7, 4, 5, -1, 0, 4, 1, 5, 3, 7, -1, 0, 2, 4, 6]
PLY = {
    "ply/text": Case(file("a.ply", ply()), check=cubes()),
    "ply/little-endian": Case(file("a.ply", ply(LITTLE, index="uint", name="vertex_index")), check=cubes()),
    "ply/big-endian": Case(file("a.ply", ply(BIG, index="uchar")), check=cubes()),
    "ply/double": Case(file("a.ply", ply(BIG, real="double")), check=cubes()),
    "ply/mixed-polygons": Case(file("a.ply", ply(LITTLE, MIXED)), check=cubes()),
    "ply/concave-polygons": Case(file("a.ply", ply(BIG, (*U_CAPS, *WALLS), points=PRISM)), check=prism),
    "ply/other-properties": Case(file("a.ply", ply(LITTLE, MIXED, "property uchar red\n", "property uchar flags\n")),
        check=cubes()),
    "ply/several-lists": Case(file("a.ply", ply(LITTLE, MIXED, face="property list uchar uchar more\n")),
        check=cubes()),
    "ply/strips": Case(file("a.ply", ply(LITTLE, (),
        after="element tristrips 1\nproperty list int int vertex_indices\n", rest=struct.pack("<21i", 20, *STRIPS))),
        check=cubes()),
    "ply/other-elements": Case(file("a.ply", ply(LITTLE, more=CAMERA, before=b"\0\0\0\0")), "1 of camera", cubes()),
    "ply/other-lists": Case(file("a.ply", ply(more=GROUP, before=b"1 0\n")), "element group"),
    "ply/thin-faces": Case(file("a.ply", ply(LITTLE, (*QUADS, (0, 1)))), "1 faces of fewer than 3", cubes()),
    "ply/no-faces": Case(file("a.ply", ply(faces=())), "faces"),
    "ply/no-vertices": Case(file("a.ply", ply(points=V[:0])), "vertices of the faces, got none"),
    "ply/index-out-of-range": Case(file("a.ply", ply(LITTLE, (*QUADS, (0, 1, 8)))), "got vertex 8"),
    "ply/negative-index": Case(file("a.ply", ply(LITTLE, (*QUADS, (0, 1, -1)))), "got vertex -1"),
    "ply/wrong-count": Case(file("a.ply", ply().replace(b"4 0 2 6 4", b"2 0 2 6 4")), "one for each vertex"),
    "ply/fractional-index": Case(file("a.ply", ply(BIG, index="float")), "expected integers as vertex indices"),
    "ply/missing-bytes": Case(file("a.ply", ply(LITTLE)[:-1]), "got the end of the file"),
    "ply/trailing-bytes": Case(file("a.ply", ply(LITTLE, rest=b"\0\0")), "end of the file"),
    "ply/not-finite": Case(file("a.ply", ply().replace(b"\n1 1 1\n", b"\n1 1 inf\n")), "finite"),
}  # fmt: skip

# --- OBJ


def obj(faces=QUADS, face="{0}", points=V, head="", tail="", point="v {:g} {:g} {:g}", first=1) -> str:
    rows = [point.format(*p) for p in points]
    rows += ["f " + " ".join(face.format(k + first) for k in f) for f in faces]
    return head + "\n".join([*rows, ""]) + tail


HALVES = (
    obj(QUADS[:3], head="o one\n")
    + "g two\ns off\n"
    + "\n".join("f " + " ".join(str(k + 1) for k in q) for q in QUADS[3:])
)
OBJ = {
    "obj/polygons": Case(file("a.obj", obj()), check=cubes()),
    "obj/concave-polygons": Case(file("a.obj", obj((*U_CAPS, *WALLS), points=PRISM)), check=prism),
    "obj/objects-and-groups": Case(file("a.obj", HALVES), check=cubes()),
    "obj/negative-indices": Case(file("a.obj", obj(first=-8)), check=cubes()),
    "obj/texture-and-normals": Case(file("a.obj", obj(face="{0}/1/1", head="vt 0 0\nvn 0 0 1\n")), check=cubes()),
    "obj/line-continuation": Case(file("a.obj", obj().replace(" 1 ", " \\\n1 ")), check=cubes()),
    "obj/backslash": Case(file("a.obj", obj(QUADS[:5], tail="# C:\\models\\\nf 2 6 8 4\n")),
        "expected a backslash only" ),
    "obj/backslash-before-statement": Case(file("a.obj", obj(QUADS[:5], tail="p 1 \\\nf 2 6 8 4\n")),
        "expected numbers behind" ),
    "obj/byte-order-mark": Case(file("a.obj", "\ufeff" + obj()), check=cubes()),
    "obj/colours": Case(file("a.obj", obj(point="v {:g} {:g} {:g} 0.5 0.5 1")), check=cubes()),
    "obj/materials": Case(file("a.obj", obj(head="mtllib none.mtl\nusemtl red\n")), check=cubes()),
    "obj/lines-and-points": Case(file("a.obj", obj(tail="l 1 2\np 1\n")), "lines, points", cubes()),
    "obj/index-0": Case(file("a.obj", obj(first=0)), "counted from 1"),
    "obj/other-corners": Case(file("a.obj", obj(face="{0}/1/1f", head="vt 0 0\nvn 0 0 1\n")), "1/1/1f"),
    "obj/index-out-of-range": Case(file("a.obj", obj(first=2)), "got vertex 8"),
    "obj/index-before-first": Case(file("a.obj", obj(first=-9)), "got -9"),
    "obj/free-form": Case(file("a.obj", obj(tail="cstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\nend\n")), "free-form"),
    "obj/weights": Case(file("a.obj", obj(point="v {:g} {:g} {:g} 2")), "rational"),
    "obj/other-statements": Case(file("a.obj", obj(tail="call more.obj\n")), "'call more.obj'"),
    "obj/not-finite": Case(file("a.obj", obj(point="v nan {:g} {:g}")), "finite"),
}  # fmt: skip

# --- OFF


def off(head="OFF", counts="8 6 0", point="", face="", faces=QUADS, tail="") -> str:
    rows = ["{:g} {:g} {:g}".format(*p) + point for p in V]
    rows += [f"{len(f)} {' '.join(map(str, f))}" + face for f in faces]
    return f"{head}\n{counts}\n" + "\n".join([*rows, ""]) + tail


OFF = {
    "off/polygons": Case(file("a.off", off()), check=cubes()),
    "off/counts-in-first-line": Case(file("a.off", off("OFF 8 6 0", "")), check=cubes()),
    "off/comments": Case(file("a.off", off("# a cube\n\nOFF # text", point=" # corner")), check=cubes()),
    "off/colours-and-normals": Case(file("a.off", off("STCNOFF", point=" 1 0 0 0.5 0.5 0.5 1 0 0")), check=cubes()),
    "off/colours-of-faces": Case(file("a.off", off(face=" 255 0 0")), check=cubes()),
    "off/points-and-lines": Case(file("a.off", off(counts="8 7 0", faces=(*QUADS, (0, 1)))), "1 points and lines",
        cubes() ),
    "off/colour-index": Case(file("a.off", off(face=" 3")), "expected a face"),
    "off/number-with-underscore": Case(file("a.off", off().replace("-1 -1 -1", "-1 -1 -0_1", 1)), "expected a number"),
    "off/four-numbers": Case(file("a.off", off("4OFF", point=" 1")), "vertices of 4 numbers"),
    "off/n-numbers": Case(file("a.off", off("nOFF", "3\n8 6 0")), "vertices of n numbers"),
    "off/binary": Case(file("a.off", off("OFF BINARY")), "binary data"),
    "off/counts": Case(file("a.off", off(counts="8 5 0")), "got 14 lines"),
    "off/index-out-of-range": Case(file("a.off", off(counts="8 7 0", faces=(*QUADS, (0, 1, 8)))), "got vertex 8"),
    "off/not-finite": Case(file("a.off", off().replace("-1 -1 -1", "-1 nan -1", 1)), "finite"),
}  # fmt: skip

# --- glTF

POINTS, INDICES, FLOAT, SHORT = V.tobytes(), T.tobytes(), 5126, 5123
QUARTER = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # about z


class Gltf:
    """A document that grows: a cube, unless it is changed."""

    def __init__(self, *, points=V, faces=T, node: dict | None = None, primitive: dict | None = None, **position):
        self.blob, self.views, self.accessors = b"", [], []
        attribute = self.add(points, "VEC3", **position)
        self.primitive = {"attributes": {"POSITION": attribute}}
        if faces is not None:
            self.primitive["indices"] = self.add(faces.reshape(-1, 1), "SCALAR")
        self.primitive |= primitive or {}
        self.document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, **(node or {})}],
                         "meshes": [{"primitives": [self.primitive]}]}  # fmt: skip

    def view(self, data: bytes, **more) -> int:
        self.views.append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more})
        self.blob += data + b"\0" * (-len(data) % 4)
        return len(self.views) - 1

    def add(self, values, kind: str, view: dict | None = None, **more) -> int:
        values = np.asarray(values)
        component = {"f4": FLOAT, "u2": SHORT, "i2": 5122, "u1": 5121, "i1": 5120, "u4": 5125}[values.dtype.str[1:]]
        self.accessors.append(
            {
                "bufferView": self.view(values.tobytes(), **(view or {})),
                "componentType": component,
                "count": len(values),
                "type": kind,
                **more,
            }
        )
        return len(self.accessors) - 1

    def whole(self, **changes) -> dict:
        self.document |= {
            "bufferViews": self.views,
            "accessors": self.accessors,
            "buffers": [{"byteLength": len(self.blob)}],
        } | changes
        return self.document

    def glb(self, **changes) -> bytes:
        text = json.dumps(self.whole(**changes)).encode()
        text += b" " * (-len(text) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.blob), b"BIN\0") + self.blob
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def glb(change: Callable[[Gltf], dict | None] = lambda made: None, **options) -> Callable[[Path], Path]:
    made = Gltf(**options)
    return file("a.glb", made.glb(**(change(made) or {})))


def gltf(uri: str | None, data: bytes | None = None) -> Callable[[Path], Path]:
    made = Gltf()
    uri = uri or "data:application/octet-stream;base64," + base64.b64encode(made.blob).decode()

    def write(folder: Path) -> Path:
        if data is not None:
            (folder / "a b.bin").write_bytes((made.blob + b"\0\0")[: len(made.blob) + 2 if data else -4])
        text = json.dumps(made.whole(buffers=[{"uri": uri, "byteLength": len(made.blob)}]))
        return file("a.gltf", text)(folder)

    return write


def extended(made: Gltf, name: str, where: dict, content: dict, required=True) -> dict:
    where.setdefault("extensions", {})[name] = content
    return {"extensionsUsed": [name]} | ({"extensionsRequired": [name]} if required else {})


def instanced(made: Gltf) -> dict:
    places = made.add(np.float32([[0, 0, 0], [10, 0, 0], [0, 10, 0]]), "VEC3")
    turns = made.add(np.int16([[0, 0, 0, 32767], [0, 0, 32767, 0], [32767, 0, 0, 0]]), "VEC4", normalized=True)
    content = {"attributes": {"TRANSLATION": places, "ROTATION": turns}}
    return extended(made, "EXT_mesh_gpu_instancing", made.document["nodes"][0], content)


def sparse(made: Gltf, base: bool = True) -> None:
    moved = {"count": 8, "indices": {"bufferView": made.view(np.arange(8, dtype=np.uint8).tobytes()),
        "componentType": 5121},
             "values": {"bufferView": made.view((V + np.float32([5, 0, 0])).tobytes())}}  # fmt: skip
    made.accessors[0]["sparse"] = moved
    if not base:
        del made.accessors[0]["bufferView"]


def quantized(made: Gltf) -> dict:
    return {"extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]}


def skinned(made: Gltf) -> None:
    made.document["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"translation": [5, 0, 0], "children": [2]},
        {"translation": [0, 3, 0]},
    ]
    made.document["scenes"] = [{"nodes": [0, 1]}]
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[1, 3, :3] = 0, -1, 0  # stored by columns
    made.document["skins"] = [{"joints": [1, 2], "inverseBindMatrices": made.add(bind.reshape(2, 16), "MAT4")}]
    joints, weights = np.zeros((8, 4), np.uint8), np.zeros((8, 4), np.float32)
    joints[:4, 0], weights[:, 0] = 1, 1
    made.primitive["attributes"] |= {"JOINTS_0": made.add(joints, "VEC4"), "WEIGHTS_0": made.add(weights, "VEC4")}


def skinned_cube(shape) -> None:
    same(shape, V + np.where(np.arange(8)[:, None] < 4, [5, 2, 0], [5, 0, 0]), T)


def morphed(made: Gltf) -> None:
    made.primitive["targets"] = [{"POSITION": made.add(np.tile(np.float32([4, 0, 0]), (8, 1)), "VEC3")}]
    made.document["meshes"][0]["weights"] = [0.5]


def animated(made: Gltf) -> dict:
    times, values = made.add(np.float32([[0], [1]]), "SCALAR"), made.add(np.float32([[0, 0, 0], [1, 0, 0]]), "VEC3")
    return {"animations": [{"samplers": [{"input": times, "output": values}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}]}  # fmt: skip


def beside(made: Gltf, **more) -> dict:
    return {"nodes": [{"mesh": 0}, {"mesh": 0, "translation": [7, 0, 0]}], **more}


def family(made: Gltf) -> dict:
    nodes = [{"children": [1], "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 6, 0, 0, 1]}, {"mesh": 0,
        "translation": [1, 0, 0], "rotation": QUARTER, "scale": [-0.5, 0.5, 0.5]}]  # fmt: skip
    return {"nodes": nodes}


def looks(made: Gltf) -> dict:
    made.document["nodes"].append({"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}})
    made.document["scenes"][0]["nodes"].append(1)
    made.primitive["material"] = 0
    names = ["KHR_lights_punctual", "KHR_materials_unlit"]
    return {"cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}], "materials": [{}],
        "extensionsUsed": names, "extensionsRequired": names}  # fmt: skip


def strip(*order: int) -> np.ndarray:
    return np.array(order, np.uint16)


def padded(made: Gltf) -> None:
    """Positions 20 bytes apart, 4 bytes into their view."""
    data = b"".join(b"\1\2\3\4" + p.tobytes() + b"\5\6\7\x08" for p in V)
    made.accessors[0] |= {"bufferView": made.view(data, byteStride=20), "byteOffset": 4}


def fans(made: Gltf) -> None:
    made.primitive["mode"] = 6
    made.document["meshes"][0]["primitives"] = [
        {"attributes": {"POSITION": 0}, "mode": 6, "indices": made.add(np.array(q, np.uint8)[:, None], "SCALAR")}
        for q in QUADS
    ]


def compressed(made: Gltf) -> None:
    made.views[0]["extensions"] = {
        "EXT_meshopt_compression": {"buffer": 0, "byteLength": 8, "byteStride": 12, "count": 8, "mode": "ATTRIBUTES"}
    }


def draco(made: Gltf) -> None:
    made.primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}


def copied(made: Gltf) -> None:
    """Instances of a node without a mesh, which are not listed."""
    made.document["nodes"].append({"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}})
    made.document["scenes"][0]["nodes"].append(1)


def thin(made: Gltf) -> None:
    made.document["meshes"][0]["primitives"] += [{"attributes": {"POSITION": 0}, "mode": mode} for mode in range(4)]


def shared(made: Gltf) -> dict:
    return {"nodes": [{"children": [2]}, {"children": [2]}, {"mesh": 0}], "scenes": [{"nodes": [0, 1]}]}


TILED = np.int8([[127 if x > 0 else -128 for x in p] for p in V])
GLTF = {
    "gltf/glb": Case(glb(), check=cubes()),
    "gltf/buffer-files": Case(gltf("a%20b.bin", b"whole"), check=cubes()),
    "gltf/data-uris": Case(gltf(None), check=cubes()),
    "gltf/missing-buffer": Case(gltf("gone.bin"), "'gone.bin', which is missing"),
    "gltf/short-buffer": Case(gltf("a%20b.bin", b""), "bytes in buffer 0, got"),
    "gltf/cut": Case(file("a.glb", Gltf().glb()[:-4]), "bytes of glTF 2, got"),
    "gltf/out-of-bounds": Case(glb(lambda made: made.accessors[0].update(count=9)), "in the 96 of buffer view 0"),
    "gltf/index-out-of-range": Case(glb(points=V[:7]), "got vertex 7"),
    "gltf/primitive-restart": Case(glb(faces=strip(0, 1, 2, 65535, 3, 2, 1), primitive={"mode": 5}),
        "got vertex 65535"),
    "gltf/strides": Case(glb(padded), check=cubes()),
    "gltf/sparse": Case(glb(sparse), check=cubes((5, 0, 0))),
    "gltf/sparse-from-zero": Case(glb(lambda made: sparse(made, False)), check=cubes((5, 0, 0))),
    "gltf/quantized": Case(glb(quantized, points=(3 * V).astype(np.int16), node={"scale": [0.5] * 3}),
        check=cubes(half=1.5)),
    "gltf/normalized": Case(glb(quantized, points=TILED, normalized=True), check=cubes()),
    "gltf/instances": Case(glb(instanced), check=cubes((0, 0, 0), (10, 0, 0), (0, 10, 0))),
    "gltf/no-indices": Case(glb(points=V[T.ravel()], faces=None), check=cubes()),
    "gltf/strips": Case(glb(faces=strip(0, 1, 2, 3, 6, 7, 4, 5, 5, 0, 0, 4, 1, 5, 3, 7, 7, 0, 0, 2, 4, 6),
        primitive={"mode": 5}), check=cubes()),
    "gltf/fans": Case(glb(fans), check=cubes()),
    "gltf/points-and-lines": Case(glb(thin), "points and lines", cubes()),
    "gltf/node-transforms": Case(glb(family), check=cubes((8, 0, 0))),
    "gltf/cameras-lights-materials": Case(glb(looks), check=cubes()),
    "gltf/skin": Case(glb(skinned), "skinned: only the pose", skinned_cube),
    "gltf/morph-targets": Case(glb(morphed), "morph targets are not read", cubes()),
    "gltf/animation": Case(glb(animated), "animated: only the pose", cubes()),
    "gltf/several-scenes": Case(glb(lambda made: beside(made, scene=1, scenes=[{"nodes": [0]}, {"nodes": [1]}])),
        "1 meshes outside the scene", cubes((7, 0, 0))),
    "gltf/no-default-scene": Case(glb(lambda made: [made.document.pop("scene"), beside(made, scenes=[{"nodes": [0]},
        {"nodes": [1]}])][1]), "got 2 scenes"),
    "gltf/no-scene": Case(glb(lambda made: [made.document.pop("scene"), beside(made, scenes=[])][1]), check=cubes((0, 0,
        0), (7, 0, 0))),
    "gltf/outside-the-scene": Case(glb(beside), "1 meshes outside the scene", cubes()),
    "gltf/shared-nodes": Case(glb(shared), "below two others"),
    "gltf/required-extension": Case(glb(lambda made: extended(made, "VENDOR_new_shapes", made.primitive, {})),
        "VENDOR_new_shapes"),
    "gltf/used-extension": Case(glb(lambda made: extended(made, "VENDOR_new_shapes", made.primitive, {}, False)),
        "VENDOR_new_shapes", cubes()),
    "gltf/draco": Case(glb(draco), "KHR_draco_mesh_compression"),
    "gltf/unlisted-extension": Case(glb(node={"extensions": {"KHR_node_visibility": {"visible": False}}}),
        "KHR_node_visibility", cubes()),
    "gltf/instances-without-mesh": Case(glb(copied), "without a mesh", cubes()),
    "gltf/other-positions": Case(glb(points=(V + 1).astype(np.uint32)), "float32, or integers"),
    "gltf/no-object": Case(file("a.gltf", "[]"), "an object in JSON"),
    "gltf/later-version": Case(glb(lambda made: {"asset": {"version": "2.0", "minVersion": "2.1"}}), "minVersion 2.1"),
    "gltf/meshopt": Case(glb(compressed), "EXT_meshopt_compression"),
    "gltf/version-1": Case(glb(lambda made: {"asset": {"version": "1.0"}}), "version 1.0"),
    "gltf/not-finite": Case(glb(points=np.where(V == 1, np.float32(np.inf), V)), "finite"),
}  # fmt: skip

# --- COLLADA


def numbers(values) -> str:
    return " ".join(f"{x:g}" for x in np.ravel(values))


TRIANGLES = f'<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{numbers(T)}</p></triangles>'
SHOWN = '<instance_geometry url="#g"/>'


def mesh(polygons=TRIANGLES, points=V, ids="pavg", stride=3) -> str:
    p, a, v, g = ids
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    rows = np.column_stack([points, np.full((len(points), stride - 3), 7)])
    return f'''<geometry id="{g}"><mesh><source id="{p}">
<float_array id="{a}" count="{rows.size}">{numbers(rows)}</float_array><technique_common>
<accessor source="#{a}" count="{len(points)}" stride="{stride}">{params}</accessor></technique_common></source>
<vertices id="{v}"><input semantic="POSITION" source="#{p}"/></vertices>{polygons}</mesh></geometry>'''


def dae(
    geometry=None,
    node=SHOWN,
    asset="<up_axis>Z_UP</up_axis>",
    more="",
    scenes="",
    scene='<scene><instance_visual_scene url="#s"/></scene>',
) -> str:
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{asset}</asset>
<library_geometries>{mesh() if geometry is None else geometry}</library_geometries>{more}
<library_visual_scenes><visual_scene id="s"><node id="n">{node}</node></visual_scene>{scenes}</library_visual_scenes>
{scene}</COLLADA>"""


def polygons(tag: str, runs, more="", count=None) -> str:
    """Polygons whose corners have an index of their own for normals."""
    inputs = '<input semantic="NORMAL" source="#none" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/>'
    ps = "".join(f"<p>{' '.join(f'0 {k}' for k in run)}</p>" for run in runs)
    return f'<{tag} count="{len(runs) if count is None else count}">{inputs}{more}{ps}</{tag}>'


FOUR = f"<vcount>{' 4' * 6}</vcount>"
PLACED = (
    "<translate>5 0 0</translate><rotate>0 0 1 90</rotate><scale>2 2 -2</scale>"
    f"<node><matrix>0.5 0 0 1 0 0.5 0 0 0 0 0.5 0 0 0 0 1</matrix>{SHOWN}</node>"
)
TWICE = (
    '<node id="pair"><node><translate>3 0 0</translate><instance_geometry url="#g"/></node>'
    '<instance_geometry url="#g"/></node>'
)
STRIP = [0, 1, 2, 3, 6, 7, 4, 5, 5, 0, 0, 4, 1, 5, 3, 7, 7, 0, 0, 2, 4, 6]
SECOND = '<visual_scene id="t"><node><instance_geometry url="#g"/></node></visual_scene>'
DAE = {
    "dae/unit": Case(file("a.dae", dae(mesh(points=100 * V),
        asset='<unit meter="0.01" name="centimeter"/><up_axis>Z_UP</up_axis>')), check=cubes()),
    "dae/several-units": Case(file("a.dae", dae(mesh().replace('<mesh>', '<asset><unit meter="2"/></asset><mesh>'))),
        "one unit"),
    "dae/two-units": Case(file("a.dae", dae(asset='<unit meter="1"/><unit meter="0.01"/>')), "one unit, got 2"),
    "dae/two-scenes-shown": Case(file("a.dae", dae(scenes=SECOND,
        scene='<scene><instance_visual_scene url="#s"/><instance_visual_scene url="#t"/></scene>')), "got 2"),
    "dae/elements-in-numbers": Case(file("a.dae", dae(node="<translate>5 0 0<foo/> 9</translate>" + SHOWN)),
        "the element foo"),
    "dae/number-with-underscore": Case(file("a.dae", dae(asset='<unit meter="1_0"/>')), "got '1_0'"),
    "dae/other-up-axis": Case(file("a.dae", dae(asset="<up_axis>Y_UP</up_axis>")), "Y_UP"),
    "dae/no-up-axis": Case(file("a.dae", dae(asset="")), "taken as z up", cubes()),
    "dae/transforms": Case(file("a.dae", dae(node=PLACED)), check=cubes((5, 2, 0))),
    "dae/skew-and-lookat": Case(file("a.dae", dae(node="<skew>30 1 0 0 0 1 0</skew>" + SHOWN)), "got skew"),
    "dae/instances-of-nodes": Case(file("a.dae", dae(node='<instance_node url="#pair"/>',
        more=f"<library_nodes>{TWICE}</library_nodes>")), check=cubes((0, 0, 0), (3, 0, 0))),
    "dae/polylists": Case(file("a.dae", dae(mesh(polygons("polylist", [np.ravel(QUADS)], FOUR, 6)))), check=cubes()),
    "dae/polygons": Case(file("a.dae", dae(mesh(polygons("polygons", (*U_CAPS, *WALLS)), PRISM))), check=prism),
    "dae/holes": Case(file("a.dae", dae(mesh(polygons("polygons", QUADS,
        "<ph><p>0 0 0 1 0 2 0 3</p><h>0 0 0 1 0 2</h></ph>", 7)))), "got a hole"),
    "dae/strips-and-fans": Case(file("a.dae", dae(mesh(polygons("tristrips", [STRIP[:12]]) + polygons("tristrips",
        [STRIP[10:18]]) + polygons("trifans", [(0, 2, 6, 4)])))), check=cubes()),
    "dae/lines": Case(file("a.dae", dae(mesh(TRIANGLES + polygons("lines", [(0, 1)])))), "lines", cubes()),
    "dae/strided-sources": Case(file("a.dae", dae(mesh(stride=5))), check=cubes()),
    "dae/skins-and-morphs": Case(file("a.dae", dae(node='<instance_controller url="#c"/>')), "a skin or morph"),
    "dae/splines": Case(file("a.dae", dae(mesh().replace("mesh>", "spline>"))), "got spline"),
    "dae/other-files": Case(file("a.dae", dae(node='<instance_geometry url="other.dae#g"/>')), "geometry of this file"),
    "dae/several-scenes": Case(file("a.dae", dae(scenes=SECOND)), "1 scenes that the file does not show", cubes()),
    "dae/no-scene": Case(file("a.dae", dae(scene="")), "expected a scene"),
    "dae/not-shown": Case(file("a.dae", dae(mesh() + mesh("", ids="PAVG"))), "1 geometries", cubes()),
    "dae/animation": Case(file("a.dae", dae(more="<library_animations><animation/></library_animations>")), "animated",
        cubes()),
    "dae/counts": Case(file("a.dae", dae(mesh(TRIANGLES.replace('"12"', '"11"')))), "expected 11 triangles"),
    "dae/no-count": Case(file("a.dae", dae(mesh(TRIANGLES.replace(' count="12"', "")))),
        "expected a count of triangles"),
    "dae/index-out-of-range": Case(file("a.dae", dae(mesh(points=V[:7]))), "got vertex 7"),
    "dae/cut": Case(file("a.dae", dae()[:-20]), "expected XML"),
    "dae/not-finite": Case(file("a.dae", dae(mesh(points=np.where(V == 1, np.nan, V)))), "finite"),
}  # fmt: skip

# --- URDF


def arm(geometry: str = '<mesh filename="a.stl"/>', more="", more_collision="",
        files: tuple[tuple[str, str | bytes], ...] = (("a.stl", binary_stl()),), start="<robot name='r'>",
        more_link="", end="</robot>", more_joint="", origin="xyz='1 0 0'",
        own=("", "", "")) -> Callable[[Path], Path]:  # fmt: skip
    """An arm of one joint whose link is a cube of a file."""
    collision = f"<origin {origin}/><geometry>{geometry}</geometry>{more_collision}"
    moved = f"<link name='bar'{own[0]}>{more_link}<collision{own[1]}>{collision}</collision></link>"
    joint = f"<joint name='j' type='revolute'{own[2]}><parent link='base'/><child link='bar'/><axis xyz='0 0 1'/>"
    joint += f"<limit lower='-1' upper='1' effort='1' velocity='1'/>{more_joint}</joint>"
    whole = f"{start}<link name='base'/>{moved}{joint}{more}{end}"

    def write(folder: Path) -> Path:
        for name, content in files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            file(name, content)(folder)
        return file("a.urdf", whole)(folder)

    return write


def load_arm(path: Path) -> arms.ArmConfigurations:
    pytest.importorskip("yourdfpy", reason="reading URDF needs yourdfpy: pip install 'warp-bounding[arms]'")
    return arms.ArmConfigurations(arms.load_urdf(path), [arms.Body.sphere([9, 9, 9], 1)])


def bar(*half: float) -> Callable[[arms.ArmConfigurations], None]:
    def check(shape: arms.ArmConfigurations) -> None:
        (body,) = shape.arm.bodies
        assert sorted(body.points.tolist()) == pytest.approx(np.array(sorted((V * half + [1, 0, 0]).tolist())))

    return check


def urdf(words="", half=(1, 1, 1), **options) -> Case:
    return Case(arm(**options), words, bar(*half), load_arm)


VISUAL = (
    "<link name='extra'><visual><geometry><box size='1 1 1'/></geometry></visual></link>"
    "<joint name='k' type='fixed'><parent link='bar'/><child link='extra'/></joint>"
)
CENTIMETRES = dae(mesh(points=100 * V), asset='<unit meter="0.01"/><up_axis>Z_UP</up_axis>')
URDF = {
    "urdf/meshes": urdf(),
    "urdf/scale": urdf(geometry="<mesh filename='a.stl' scale='1 -2 3'/>", half=(1, 2, 3)),
    "urdf/scale-of-two": urdf("scale of 1 or 3 finite numbers", geometry="<mesh filename='a.stl' scale='1 2'/>"),
    "urdf/packages": urdf(geometry="<mesh filename='package://robot/meshes/a.stl'/>", files=(("robot/meshes/a.stl",
        binary_stl()),)),
    "urdf/package-xml": urdf(geometry="<mesh filename='package://robot/meshes/a.stl'/>", files=(("package.xml",
        "<package><name>robot</name></package>"), ("meshes/a.stl", binary_stl()))),
    "urdf/other-packages": urdf("is missing", geometry="<mesh filename='package://robot/meshes/a.stl'/>",
        files=(("meshes/a.stl", binary_stl()),)),
    "urdf/collada": urdf(geometry="<mesh filename='a.dae'/>", files=(("a.dae", CENTIMETRES),)),
    "urdf/missing-mesh": urdf("is missing", geometry="<mesh filename='gone.stl'/>"),
    "urdf/other-meshes": urdf("expected a mesh file", geometry="<mesh filename='a.3ds'/>", files=(("a.3ds", b"3ds"),)),
    "urdf/bad-mesh": urdf("12 facets, got", files=(("a.stl", binary_stl()[:-1]),)),
    "urdf/noted-mesh": urdf("a.stl: 4 bytes behind", files=(("a.stl", binary_stl() + b"text"),)),
    "urdf/gltf": urdf("taken as it stands", geometry="<mesh filename='a.glb'/>", files=(("a.glb", Gltf().glb()),)),
    "urdf/visual-only": urdf("so not bounded: extra", more=VISUAL),
    "urdf/two-shapes": urdf("one geometry of one shape", geometry="<sphere radius='1'/><box size='1 1 1'/>"),
    "urdf/two-geometries": urdf("one geometry of one shape",
        more_collision="<geometry><sphere radius='1'/></geometry>"),
    "urdf/doubled": urdf("joint j: expected one origin, got 2", more_joint="<origin/><origin xyz='5 0 0'/>"),
    "urdf/lacking": urdf("cylinder: expected length", geometry="<cylinder radius='1'/>"),
    "urdf/other-attributes": urdf("got quat_xyzw", origin="xyz='1 0 0' quat_xyzw='0 0 1 0'"),
    "urdf/attributes-of-links": urdf("attributes color of joint, drake_ignore of link, margin of collision",
        own=(" drake_ignore='0'", " margin='0.1'", " color='red'")),
    "urdf/negative-sizes": urdf("radius of 1 finite number from 0, got '-1'",
        geometry="<cylinder radius='-1' length='1'/>"),
    "urdf/counts": urdf("xyz of 3 finite numbers", origin="xyz='1 0 0 7'"),
    "urdf/not-numbers": urdf("radius of 1 finite number from 0, got '1_0'", geometry="<sphere radius='1_0'/>"),
    "urdf/comments": urdf(geometry="<!-- a cube --><mesh filename='a.stl'/>"),
    "urdf/other-shapes": urdf("cone", geometry="<cone radius='1' length='1'/>"),
    "urdf/double-names": urdf("two of base", more="<link name='base'/>"),
    "urdf/other-elements": urdf("elements drake, foo, verbose", more="<drake/>", more_joint="<foo/>",
        more_collision="<verbose/>"),
    "urdf/macros": urdf("macro include",
        start="<robot name='r' xmlns:xacro='http://wiki.ros.org/xacro'><xacro:include filename='b'/>"),
    "urdf/cut": urdf("no URDF that can be read", end=""),
}  # fmt: skip

# --- USD

PLAIN = 'uniform token subdivisionScheme = "none"\n'


def usd_mesh(more=PLAIN, name="m", quads=QUADS, points=V, meta="") -> str:
    places = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in points)
    counts, corners = [len(q) for q in quads], np.concatenate(quads).tolist()
    return f'''def Mesh "{name}" ({meta}) {{
    point3f[] points = [{places}]
    int[] faceVertexCounts = {counts}
    int[] faceVertexIndices = {corners}
    {more}
}}
'''


def moved(*shift: float, attribute="double3 xformOp:translate") -> str:
    return f'{attribute} = {shift}\nuniform token[] xformOpOrder = ["xformOp:translate"]\n'


def usd(words="", check=None, text="", head="", **others: str) -> Case:
    """A stage, by default of a cube and what is named ``text``; ``others`` are the contents of layers beside it."""

    def write(folder: Path) -> Path:
        pytest.importorskip("pxr", reason="usd-core is not installed")
        for name, content in others.items():
            (folder / f"{name}.usda").write_text("#usda 1.0\n" + content)
        return file("a.usda", f"#usda 1.0\n({head})\n{text}")(folder)

    return Case(write, words, check or cubes())


def usdz() -> Case:
    def write(folder: Path) -> Path:
        path = usd(text=usd_mesh()).write(folder)
        from pxr import Sdf, UsdUtils

        assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(path)), str(folder / "b.usdz"))
        return folder / "b.usdz"

    return Case(write, check=cubes())


def skeleton(mesh="", animation="") -> str:
    """A cube on two bones, which an animation puts elsewhere."""
    bind = "[((1,0,0,0),(0,1,0,0),(0,0,1,0),(0,0,0,1)), ((1,0,0,0),(0,1,0,0),(0,0,1,0),(0,1,0,1))]"
    bones = f"""prepend apiSchemas = ["SkelBindingAPI"]
) {{
        uniform token[] joints = ["j", "j/k"]
        uniform matrix4d[] bindTransforms = {bind}
        uniform matrix4d[] restTransforms = {bind}
        rel skel:animationSource = </r/s/a>
        def SkelAnimation "a" {{
            uniform token[] joints = ["j", "j/k"]
            float3[] translations.timeSamples = {{ 3: [(5,0,0),(0,3,0)], 4: [(7,0,0),(0,3,0)] }}
            quatf[] rotations = [(1,0,0,0),(1,0,0,0)]
            half3[] scales = [(1,1,1),(1,1,1)]
            {animation}
        }}
    }}"""
    bound = f"""{PLAIN}rel skel:skeleton = </r/s>
    int[] primvars:skel:jointIndices = [1,1,1,1,0,0,0,0] (
        interpolation = "vertex"
    )
    float[] primvars:skel:jointWeights = [1,1,1,1,1,1,1,1] (
        interpolation = "vertex"
    )
    {mesh}
"""
    skin = usd_mesh(bound + moved(100.0, 0, 0), meta='prepend apiSchemas = ["SkelBindingAPI"]')
    return f'def SkelRoot "r" {{\ndef Skeleton "s" (\n{bones}\n{skin}}}'


def raised(shape) -> None:
    same(shape, V + np.where(np.arange(8)[:, None] < 4, [5, 2, 9], [5, 0, 9]), T)


BLEND = """uniform token[] skel:blendShapes = ["b"]
rel skel:blendShapeTargets = </r/m/b>
def BlendShape "b" {
    uniform vector3f[] offsets = [(0,0,18),(0,0,18),(0,0,18),(0,0,18),(0,0,18),(0,0,18),(0,0,18),(0,0,18)]
}"""
FLAT = [[-1, -3, 0], [1, -3, 0], [1, 3, 0], [-1, 3, 0]]
CLASS = f'class Xform "proto" {{\n{usd_mesh()}}}\n'
COPIES = "".join(
    f'def Xform "{n}" (\ninstanceable = true\ninherits = </proto>\n) {{ {moved(x, 0, 0)} }}\n'
    for n, x in (("one", 0), ("two", 5))
)
VARIANTS = f"""def Xform "v" (
    variants = {{ string look = "cube" }}
    prepend variantSets = "look"
) {{
    variantSet "look" = {{
        "cube" {{
{usd_mesh()}        }}
        "none" {{ }}
    }}
}}"""
DEFAULT = 'defaultPrim = "m"\n'
USD = {
    "usd/meshes": usd(text=usd_mesh(name="a") + 'def Xform "x" {\n' + moved(5, 0, 0) + usd_mesh() + "}",
        check=cubes((0, 0, 0), (5, 0, 0))),
    "usd/usdz": usdz(),
    "usd/polygons": usd(text=usd_mesh(quads=(*QUADS[:5], QUADS[5][:3], (QUADS[5][0], *QUADS[5][2:])))),
    "usd/left-handed": usd(text=usd_mesh(PLAIN + 'uniform token orientation = "leftHanded"')),
    "usd/units-and-axes": usd(text=usd_mesh(), head='metersPerUnit = 0.01\nupAxis = "Z"\n'),
    "usd/layers": usd(text='def "x" (\npayload = @b.usda@\n) {}\n', head="subLayers = [@c.usda@]", b=f"({DEFAULT})\n"
        + usd_mesh(), c=usd_mesh(PLAIN + moved(5, 0, 0)), check=cubes((0, 0, 0), (5, 0, 0))),
    "usd/layers-of-other-units": usd("another metersPerUnit: b.usda", text='def "x" (\nreferences = @b.usda@\n) {}\n',
        b=f"({DEFAULT}metersPerUnit = 1)\n" + usd_mesh()),
    "usd/missing-layers": usd("complete USD stage", text=usd_mesh(), head="subLayers = [@gone.usda@]"),
    "usd/missing-payloads": usd("complete USD stage", text=usd_mesh() + 'def "x" (\npayload = @gone.usda@\n) {}\n'),
    "usd/missing-prims": usd("complete USD stage", text=usd_mesh() + 'def "x" (\nreferences = @b.usda@</gone>\n) {}\n',
        b=usd_mesh()),
    "usd/instances": usd(text=CLASS + COPIES, check=cubes((0, 0, 0), (5, 0, 0))),
    "usd/point-instancers": usd("a point instancer at /p", text=usd_mesh() + 'def PointInstancer "p" {}'),
    "usd/cubes": usd(text='def Cube "c" { ' + moved(5, 0, 0) + "}", check=cubes((5, 0, 0))),
    "usd/planes": usd(text='def Plane "p" {\ndouble width = 2\ndouble length = 6\nuniform token axis = "Z"\n}\n'
        + usd_mesh(),
                      check=lambda shape: same(shape, np.concatenate([V, FLAT]), [*T.tolist(), [8, 9, 10],
                          [8, 10, 11]]), words="surface only for 2 of 14"),
    "usd/other-surfaces": usd("a Sphere at /s", text=usd_mesh() + 'def Sphere "s" {}'),
    "usd/points-and-curves": usd("no surface: /c, /p", text=usd_mesh() + 'def BasisCurves "c" {}\ndef Points "p" {}'),
    "usd/unknown-types": usd("/f (Foo)", text=usd_mesh() + 'def Foo "f" {}'),
    "usd/subdivision": usd("control cage is bounded: /m", text=usd_mesh("")),
    "usd/holes": usd("read as faces: /m", text=usd_mesh(PLAIN + "int[] holeIndices = [0]")),
    "usd/skins-and-blend-shapes": usd("skinned: only the first pose", text=skeleton(BLEND,
        'uniform token[] blendShapes = ["b"]\nfloat[] blendShapeWeights = [0.5]'), check=raised),
    "usd/animation": usd("only its first pose is bounded: /m", text=usd_mesh(PLAIN
        + moved(0, 0, 0).replace("(0, 0, 0)", "{ 1: (5, 0, 0), 2: (9, 0, 0) }").replace("translate =",
        "translate.timeSamples =")), check=cubes((5, 0, 0))),
    "usd/variants": usd("/v look=cube", text=VARIANTS),
    "usd/invisible": usd("although it is invisible: /m", text=usd_mesh(PLAIN + 'token visibility = "invisible"')),
    "usd/purposes": usd("of purpose guide: /m", text=usd_mesh(PLAIN + 'uniform token purpose = "guide"')),
    "usd/inactive": usd("inactive: /x", text=usd_mesh() + 'def "x" (\nactive = false\n) {}'),
    "usd/overs": usd("nothing defines it: /x", text=usd_mesh() + 'over "x" {}'),
    "usd/no-points": usd("vertices of the faces, got none", text=usd_mesh(points=())),
    "usd/counts": usd("indices for 7 polygons", text=usd_mesh().replace("faceVertexCounts = [",
        "faceVertexCounts = [3, ")),
    "usd/index-out-of-range": usd("got vertex 8", text=usd_mesh(quads=(*QUADS, (0, 1, 8)))),
    "usd/cut": usd("USD stage", text=usd_mesh()[:-20]),
    "usd/not-finite": usd("finite", text=usd_mesh().replace("(-1, -1, -1)", "(nan, -1, -1)")),
}  # fmt: skip
MESH_CASES: dict[str, Case] = STL | PLY | OBJ | OFF | GLTF | DAE | URDF | USD
