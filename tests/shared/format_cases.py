"""Small files of all formats, each with something about it: what is read, and what is refused.

Meshes are a cube of half width 1. A content is that of a file, or a dictionary of several, of which the first is
loaded.
"""

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

V = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
T = np.array([[q[0], q[i], q[i + 1]] for q in QUADS for i in (1, 2)], np.uint16)
CUBE = trimesh.Trimesh(V, T, process=False)
MIXED = (*QUADS[:5], QUADS[5][:3], (QUADS[5][0], *QUADS[5][2:]))


def written(folder: Path, name: str, content: str | bytes | dict) -> Path:
    """The path of a file in a folder."""
    for other, own in (content if isinstance(content, dict) else {name: content}).items():
        (folder / other).parent.mkdir(parents=True, exist_ok=True)
        (folder / other).write_bytes(own if isinstance(own, bytes) else own.encode())
    return folder / name


def cubes(*shifts: tuple[float, float, float]) -> Callable[[Any], None]:
    """Check for cubes at these places, (0, 0, 0) by default: exact corners, area and volume, however faces are cut."""
    shifts = shifts or ((0, 0, 0),)
    corners = {tuple(corner) for shift in shifts for corner in (V + np.float32(shift)).tolist()}

    def check(shape) -> None:
        found = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
        assert {tuple(corner) for corner in shape.vertices[np.unique(shape.faces)].tolist()} == corners
        assert np.allclose([found.area, abs(found.volume)], [24 * len(shifts), 8 * len(shifts)], rtol=1e-6)

    return check


# --- Meshes -----------------------------------------------------------------------------------------------------------

AWAY = CUBE.copy().apply_translation([5, 0, 0]).export(file_type="stl_ascii")
STL, BINARY_STL, GLB = (CUBE.export(file_type=kind) for kind in ("stl_ascii", "stl", "glb"))
BINARY = "binary_little_endian"


def ply(kind="ascii", faces=QUADS, flags="", element="", rows="") -> bytes:
    """``flags`` is a further property of faces, of a byte; ``element`` is the header of another one."""
    header = f"ply\nformat {kind} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n{flags}{element}end_header\n"
    if kind == "ascii":
        lines = ["{:g} {:g} {:g}".format(*p) for p in V]
        lines += [f"{len(f)} {' '.join(map(str, f))}" + " 7" * bool(flags) for f in faces]
        return (header + "\n".join([*lines, rows])).encode()
    return header.encode() + V.tobytes() + b"".join(struct.pack(f"<B{len(f)}i", len(f), *f) for f in faces)


def obj(faces=QUADS, face="{0}", points=V, head="", tail="", point="v {:g} {:g} {:g}", first=1) -> str:
    rows = [point.format(*p) for p in points]
    rows += ["f " + " ".join(face.format(k + first) for k in f) for f in faces]
    return head + "\n".join([*rows, ""]) + tail


def off(head="OFF", counts="8 6 0", point="", face="", tail="") -> str:
    rows = ["{:g} {:g} {:g}".format(*p) + point for p in V] + [f"4 {' '.join(map(str, q))}{face}" for q in QUADS]
    return f"{head}\n{counts}\n" + "\n".join([*rows, tail])


def gltf(change: Callable[[dict], object] = lambda made: None, **files: bytes) -> dict[str, str | bytes]:
    """What trimesh writes, its document changed; ``files`` are written besides."""
    made = CUBE.export(file_type="gltf")
    document = json.loads(made.pop("model.gltf"))
    document["nodes"], document["scenes"] = [{"mesh": 0}], [{"nodes": [0]}]
    change(document)
    return {"a.gltf": json.dumps(document)} | made | files


def accessors(**changes) -> Callable[[dict], object]:
    return lambda made: [accessor.update(changes) for accessor in made["accessors"]]


def primitive(**changes) -> Callable[[dict], object]:
    return lambda made: made["meshes"][0]["primitives"][0].update(changes)


def nodes(*new: dict, **more) -> Callable[[dict], object]:
    return lambda made: made.update(nodes=list(new), **more)


def extended(name: str, required: bool = True) -> Callable[[dict], object]:
    listed = {"extensionsUsed": [name]} | ({"extensionsRequired": [name]} if required else {})
    return lambda made: [made.update(listed), made["nodes"][0].update(extensions={name: {}})]


FAMILY = nodes(
    {"children": [1], "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 6, 0, 0, 1]},
    {"mesh": 0, "translation": [1, 0, 0], "rotation": [0, 0, 0.5**0.5, 0.5**0.5], "scale": [-0.5, 0.5, 0.5]},
)
APART = nodes({"mesh": 0}, {"mesh": 0, "translation": [7, 0, 0]}, scene=1, scenes=[{"nodes": [0]}, {"nodes": [1]}])


def numbers(values) -> str:
    return " ".join(f"{value:g}" for value in np.ravel(values))


TRIANGLES = f'<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{numbers(T)}</p></triangles>'
SHOWN = '<instance_geometry url="#g"/>'
ANIMATION = "<library_animations><animation/></library_animations>"


def polygons(tag: str, runs, more="", count=6) -> str:
    """Polygons whose corners have an index of their own for normals."""
    inputs = '<input semantic="NORMAL" source="#none" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/>'
    ps = "".join(f"<p>{' '.join(f'0 {k}' for k in run)}</p>" for run in runs)
    return f'<{tag} count="{count}">{inputs}{more}{ps}</{tag}>'


def dae(mesh=TRIANGLES, node=SHOWN, asset="<up_axis>Z_UP</up_axis>", points=V, more="", shown="#s", names="XYZ") -> str:
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in names)
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{asset}</asset><library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="{np.size(points)}">{numbers(points)}</float_array><technique_common>
<accessor source="#a" count="{len(points)}" stride="3">{params}</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{mesh}</mesh></geometry></library_geometries>{more}
<library_visual_scenes><visual_scene id="s"><node id="n">{node}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="{shown}"/></scene></COLLADA>"""


PLACED = (
    "<translate>5 0 0</translate><rotate>0 0 1 90</rotate><scale>2 2 -2</scale>"
    f"<node><matrix>0.5 0 0 1 0 0.5 0 0 0 0 0.5 0 0 0 0 1</matrix>{SHOWN}</node>"
)
TWICE = f'<library_nodes><node id="n2"><node><translate>3 0 0</translate>{SHOWN}</node>{SHOWN}</node></library_nodes>'
CENTIMETRES = dae(points=100 * V, asset='<unit meter="0.01"/><up_axis>Z_UP</up_axis>')
PLAIN = 'uniform token subdivisionScheme = "none"\n'


def usd(text="", head="", **layers: str) -> dict[str, str]:
    """A USD stage; ``layers`` are the contents of other files in its folder."""
    return {"a.usda": f"#usda 1.0\n({head})\n{text}"} | {f"{k}.usda": "#usda 1.0\n" + v for k, v in layers.items()}


def usd_mesh(more=PLAIN, quads=QUADS, points=V) -> str:
    places = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in points)
    indices = f"int[] faceVertexIndices = {np.concatenate(quads).tolist()}"
    counts = f"int[] faceVertexCounts = {[len(q) for q in quads]}"
    return f'def Mesh "m" {{\npoint3f[] points = [{places}]\n{counts}\n{indices}\n{more}}}\n'


def moved(x: float, samples="") -> str:
    value = f".timeSamples = {{ 1: ({x}, 0, 0), 2: (9, 0, 0) }}" if samples else f" = ({x}, 0, 0)"
    return f'double3 xformOp:translate{value}\nuniform token[] xformOpOrder = ["xformOp:translate"]\n'


COPIES = f'class Xform "proto" {{\n{usd_mesh()}}}\n' + "".join(
    f'def Xform "x{x}" (\ninstanceable = true\ninherits = </proto>\n) {{ {moved(x)} }}\n' for x in (0, 5)
)
PAYLOAD = 'def "x" (\npayload = @b.usda@\n) {}\n'
NEGATIVE = "".join("v {:g} {:g} {:g}\n" * 3 + "f -3 -2 -1\n" for _ in T).format(*V[T.ravel()].ravel())
ONE, TWO = cubes(), cubes((0, 0, 0), (5, 0, 0))

# --- Pictures, maps, voxels, arrays -----------------------------------------------------------------------------------

BITS = np.zeros((4, 6), bool)
BITS[1:3, 2:4] = True
GREY = np.where(BITS, 0, 254).astype(np.uint8)
RGBA = np.stack([GREY, GREY, GREY, np.where(BITS, 128, 127).astype(np.uint8)], axis=2)


def cells(expected=BITS) -> Callable[[Any], None]:
    """Check that exactly these cells are occupied."""
    return lambda shape: np.testing.assert_array_equal(getattr(shape, "local", shape).occupancy, expected)


def at(lower, upper) -> Callable[[Any], None]:
    """Check for the corners of the domain, to what float64 rounds."""
    return lambda shape: np.testing.assert_allclose([shape.lower, shape.upper], [lower, upper], rtol=1e-12, atol=1e-12)


def png(values, kind="png", **options) -> bytes:
    out = io.BytesIO()
    (values if isinstance(values, Image.Image) else Image.fromarray(np.asarray(values))).save(out, kind, **options)
    return out.getvalue()


def pgm(values: np.ndarray, kind: str = "P5", white: int = 255, comment: str = "") -> bytes:
    head = f"{kind}\n{comment}{values.shape[1]} {values.shape[0]}\n{white}\n".encode()
    data = values.astype(np.uint8 if white < 256 else ">u2").tobytes()
    return head + (data if kind == "P5" else (" ".join(map(str, values.ravel())) + "\n").encode())


def ppm(values: np.ndarray) -> bytes:
    return f"P6 {values.shape[1]} {values.shape[0]} 255\n".encode() + np.repeat(values, 3).tobytes()


def ros(picture=GREY, name="m.pgm", drop="-", **changes) -> dict[str, str | bytes]:
    """A map, by default of cells of 5 cm."""
    fields = {"image": name, "resolution": 0.05, "origin": [-2.03, -3.11, 0.0], "negate": 0, "occupied_thresh": 0.65}
    fields |= {"free_thresh": 0.196} | changes
    text = "---\n# here\n" + "".join(f"{key}: {value}\n" for key, value in fields.items() if key != drop)
    content = picture if isinstance(picture, bytes) else pgm(picture)
    return {"m.yaml": text} | ({name: content} if content else {})


def binvox(values: np.ndarray, head: str = "", version: int = 1) -> bytes:
    runs = b"".join(bytes([int(value), 1]) for value in values.transpose(0, 2, 1).ravel())
    x, y, z = values.shape
    return f"#binvox {version}\ndim {x} {z} {y}\n{head}data\n".encode() + runs


def npy(array: np.ndarray, **options) -> bytes:
    out = io.BytesIO()
    np.save(out, array, **options)
    return out.getvalue()


def npz(extra: bytes = b"", **arrays: np.ndarray) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, array in arrays.items():
            archive.writestr(f"{name}.npy", npy(array) + extra)
    return out.getvalue()


def hollow(inner: np.ndarray) -> str:
    """A cube, and another one in it that is inside out."""
    return obj() + obj([q[::-1] for q in QUADS], points=inner, first=9)


def hollowness(inside: bool) -> Callable[[Any], None]:
    def check(shape) -> None:
        assert shape.contains(np.array([[0.0, 0, 0], [0.75, 0, 0], [1.5, 0, 0]])).tolist() == [inside, True, False]

    return check


PALETTE = Image.fromarray(np.where(BITS, 3, 5).astype(np.uint8))
PALETTE.putpalette(list(range(256)) * 3)
LZW = png(GREY, "tiff", compression="tiff_lzw")
FRAMES = png(Image.fromarray(GREY), save_all=True, append_images=[Image.fromarray(254 - GREY)])
UNSEEN, HALF = (np.where(BITS, 0, value).astype(np.uint8) for value in (205, 200))
UNSEEN[:, 0] = HALF[:, 0] = 254
SEEN = np.ones_like(BITS)
SEEN[:, 0] = False
UP, SEEN_UP = cells(BITS[::-1].T), cells(SEEN[::-1].T)  # x to the right, y up
PLACE = at([-2.03, -3.11], [-2.03 + 6 * 0.05, -3.11 + 4 * 0.05])
VOXELS = np.zeros((3, 2, 3), bool)
VOXELS[1, 1, 0] = True
MOVED = binvox(VOXELS, "translate 1 2 3\nscale 6\n")
SIGNED = np.where(BITS, -0.5, 0.5)
ROBOT = np.where(BITS, 100, 0).astype(np.int8)
ROBOT[0, 0] = -1
KNOWN = cells(ROBOT != 0)
DARK, EMPTY = {"level": "<128"}, {"hollow": "empty"}
SURVEY = {"spacing": 0.3, "origin": (500000.13, 4649776.37)}
FAR = at([4649776.07] * 3, [4649776.67] * 3)

# Name, content, options of ``load_shape``, what is checked of the shape, and words of its message.
READ = [
    ("a.stl", STL.replace("\n", "\r\n").upper(), {}, ONE, ""),
    ("a.stl", b"solid facet" + BINARY_STL[11:], {}, ONE, ""),
    ("a.stl", "\ufeff" + STL + "solid\nendsolid\n" + AWAY, {}, cubes((0, 0, 0), (5, 0, 0)), ""),
    ("a.stl", STL.replace("facet normal", "facet normal x", 1), {}, ONE, ""),
    ("a.ply", ply(), {}, ONE, ""),
    ("a.ply", ply(faces=MIXED, flags="property uchar flags\n"), {}, ONE, ""),
    ("a.ply", ply(BINARY), {}, ONE, ""),
    ("a.ply", ply(BINARY).replace(b"ply\n", b"ply\ncomment TextureFile gone.png\nobj_info x\n", 1), {}, ONE, ""),
    ("a.ply", ply().replace(b"\n", b"\r\n"), {}, ONE, ""),
    ("a.ply", ply(element="element camera 1\nproperty float fov\n", rows="7\n"), {}, ONE, "elements camera"),
    ("a.obj", obj(MIXED, head="\ufeffmtllib gone.mtl\no one\ns off\n", tail="l 1 2\np 1\n# C:\\a\n"), {}, ONE, ""),
    ("a.obj", NEGATIVE, {}, ONE, ""),
    ("a.obj", obj(face="{0}/1/1", head="vt 0 0\nvn 0 0 1\n"), {}, ONE, ""),
    ("a.obj", obj(point="  v\t{:g} {:g} {:g} 0.5 0.5 1"), {}, ONE, ""),
    ("a.obj", obj(point="v {:g} {:g} {:g} 0.5 0.5 1 0.2"), {}, ONE, ""),
    ("a.off", off("# a cube\n\nOFF # text", point=" # corner"), {}, ONE, ""),
    ("a.off", off("OFF 8 6 0", "", face=" 255 0 0"), {}, ONE, ""),
    ("a.off", off("STCNOFF", point=" 1 0 0 0.5 0.5 0.5 1 0 0", face=" 3"), {}, ONE, ""),
    ("a.glb", GLB, {}, ONE, ""),
    ("a.gltf", gltf(FAMILY), {}, cubes((8, 0, 0)), ""),
    ("a.gltf", gltf(extended("KHR_materials_unlit")), {}, ONE, ""),
    ("a.gltf", gltf(extended("EXT_of_ours", False)), {}, ONE, "extensions EXT_of_ours"),
    ("a.gltf", gltf(primitive(targets=[{"POSITION": 0}])), {}, ONE, "not read: morph targets"),
    ("a.gltf", gltf(lambda made: made.update(animations=[{}])), {}, ONE, "animations"),
    ("a.gltf", gltf(nodes({"mesh": 0, "name": "world", "translation": [5, 0, 0]})), {}, cubes((5, 0, 0)), ""),
    ("a.gltf", gltf(APART), {}, cubes((7, 0, 0)), "scenes that the file does not show"),
    ("a.dae", CENTIMETRES, {}, ONE, ""),
    ("a.dae", dae(node=PLACED), {}, cubes((5, 2, 0)), ""),
    ("a.dae", dae(node='<instance_node url="#n2"/>', more=TWICE), {}, cubes((0, 0, 0), (3, 0, 0)), ""),
    ("a.dae", dae(polygons("polylist", [np.ravel(QUADS)], f"<vcount>{' 4' * 6}</vcount>")), {}, ONE, ""),
    ("a.dae", dae(polygons("polygons", QUADS)), {}, ONE, ""),
    ("a.dae", dae(asset=""), {}, ONE, "taken as z up"),
    ("a.dae", dae(TRIANGLES + polygons("lines", [(0, 1)], count=1)), {}, ONE, "lines"),
    ("a.dae", dae(more=ANIMATION), {}, ONE, "animated"),
    ("a.usda", usd(usd_mesh(quads=MIXED) + f'def Xform "x" {{\n{moved(5)}{usd_mesh()}}}'), {}, TWO, ""),
    ("a.usda", usd(usd_mesh(PLAIN + 'uniform token orientation = "leftHanded"\n')), {}, ONE, ""),
    ("a.usda", usd(PAYLOAD, b='(defaultPrim = "m")\n' + usd_mesh(PLAIN + moved(5))), {}, cubes((5, 0, 0)), ""),
    ("a.usda", usd(COPIES), {}, TWO, ""),
    ("a.usda", usd(f'def Cube "c" {{ {moved(5)} }}'), {}, cubes((5, 0, 0)), ""),
    ("a.usda", usd(usd_mesh() + 'def BasisCurves "c" {}\ndef Points "p" {}'), {}, ONE, "no surface"),
    ("a.usda", usd(usd_mesh() + 'def Foo "f" {}'), {}, ONE, "a Foo"),
    ("a.usda", usd(usd_mesh("")), {}, ONE, "control cage"),
    ("a.usda", usd(usd_mesh(PLAIN + moved(5, "samples"))), {}, cubes((5, 0, 0)), "only its first pose"),
    ("a.png", png(RGBA), {}, cells(), ""),
    ("a.png", png(PALETTE, transparency=5), {}, cells(), ""),
    ("a.png", png(GREY), DARK, cells(), ""),
    ("a.png", png(RGBA[..., :3]), DARK, cells(), ""),
    ("a.png", png(PALETTE), {"level": "<13"}, cells(), ""),
    ("a.png", png(np.where(BITS, 300, 299).astype(np.uint16)), {"level": ">=300"}, cells(), ""),
    ("a.png", png(Image.fromarray(BITS)), {"level": ">=128"}, cells(), ""),
    ("a.pgm", pgm(GREY, comment="# of me\n# 9 9\n"), DARK, cells(), ""),
    ("a.pgm", pgm(np.where(BITS, 40000, 50000), white=65535), {"level": "<45000"}, cells(), ""),
    ("a.pgm", pgm(GREY, "P2").replace(b"255\n", b"255\n# 7\n"), DARK, cells(), ""),
    ("a.pgm", pgm(GREY).replace(b"\n", b"\r\n"), DARK, cells(), ""),
    ("a.pgm", pgm(GREY, comment="# of me\n").replace(b"\n", b"\r", 3), DARK, cells(), ""),
    ("a.pgm", pgm(GREY).replace(b"255", b"255 # by hand"), DARK, cells(), ""),
    ("m.yaml", ros(), {}, UP, "x to the right, y up, metres"),
    ("m.yaml", ros(), {}, PLACE, "metres"),
    ("m.yaml", ros(origin=[-10, -5.5, 0]), {}, at([-10, -5.5], [-9.7, -5.3]), "metres"),
    ("m.yaml", ros(origin="\n  - 500000.13\n  - 4.64977637e6\n  - 0"), {}, UP, "metres"),
    ("m.yaml", ros(254 - GREY, negate=True), {}, UP, "metres"),
    ("m.yaml", ros(png(GREY), "m.png"), {}, UP, "metres"),
    ("m.yaml", ros(pgm(np.where(BITS, 0, 65535), white=65535)), {}, UP, "metres"),
    ("m.yaml", ros(ppm(GREY), "m.ppm"), {}, UP, "metres"),
    ("m.yaml", ros(LZW, "m.tif"), {}, UP, "metres"),
    ("m.yaml", ros(png(np.stack([GREY] * 3, axis=2)), "m.png"), {}, UP, "metres"),
    ("m.yaml", ros(UNSEEN), {}, SEEN_UP, "unknown cells count as occupied"),
    ("m.yaml", ros(UNSEEN), {"unknown": "free"}, UP, "unknown cells count as free"),
    ("m.yaml", ros(HALF, mode="scale"), {"unknown": "free"}, SEEN_UP, "scale"),
    ("m.yaml", ros(author="me"), {}, UP, "not read: author"),
    ("a.binvox", binvox(VOXELS), {}, cells(VOXELS), ""),
    ("a.binvox", MOVED, {}, cells(VOXELS), "spacing= and origin="),
    ("a.npy", npy(BITS), {}, cells(), ""),
    ("a.npy", npy(np.asfortranarray(BITS.astype(np.int32))), {}, cells(), ""),
    ("a.npy", npy(SIGNED.astype(">f4")), {"level": "<=0"}, cells(), ""),
    ("a.npy", npy(ROBOT), {"level": ">=65"}, KNOWN, "1 unknown cells count as occupied"),
    ("a.npy", npy(ROBOT / np.where(ROBOT > 0, 150, 1)), {"level": ">=0.65"}, KNOWN, "as occupied"),
    ("a.npy", npy(ROBOT), {"level": ">0", "unknown": "free"}, cells(), "1 unknown cells count as free"),
    ("a.npz", npz(cells=BITS), {}, cells(), ""),
    ("a.npz", npz(occupancy=BITS, spare=SIGNED), {}, cells(), "not read: spare"),
    ("a.npy", npy(BITS), {"spacing": 1.0, "origin": (7.5, -0.52)}, at([7.0, -1.02], [11, 4.98]), ""),
    ("a.npy", npy(BITS), SURVEY, cells(), ""),
    ("a.obj", obj(points=0.3 * np.float64(V) + 4649776.37, point="v {} {} {}"), {}, FAR, ""),
    ("a.obj", hollow(V / 2), {}, hollowness(True), "1 closed hollow filled"),
    ("a.obj", hollow(V / 2), EMPTY, hollowness(False), "1 closed hollow empty"),
]

# Name, content, options, and words of the error; none where it is another library's.
REFUSED = [
    ("a.stl", STL.encode("utf-16"), {}, "whole solids"),
    ("a.stl", STL + STL.replace("endsolid", ""), {}, "whole solids"),
    ("a.stl", STL.replace("endloop", "vertex 0 0 0\nendloop"), {}, ""),
    ("a.stl", BINARY_STL + b"made by hand", {}, ""),
    ("a.stl", STL.replace("vertex -1.0", "vertex", 1), {}, "whole solids"),
    ("a.ply", ply(BINARY, MIXED), {}, "faces of one size only"),
    ("a.ply", ply(BINARY).replace(b"\n", b"\r"), {}, "lines that end in LF"),
    ("a.ply", ply().replace(b"format", b"foremat"), {}, "got the line b'foremat ascii 1.0'"),
    ("a.ply", ply().replace(b"float x", b"real x"), {}, "got the line b'property real x'"),
    ("a.ply", ply().replace(b"list uchar", b"list"), {}, "got the line"),
    ("a.ply", ply(BINARY, (QUADS[0], (0, 1, 3), (0, 1, 3, 2, 4))), {}, "lists of one length"),
    ("a.ply", ply()[:-2], {}, "a line for each face"),
    ("a.ply", ply() + b"0 0 0\n", {}, "lines behind the header"),
    ("a.ply", ply().replace(b"4 0 2 6 4", b"2 0 2 6 4"), {}, "a line for each face"),
    ("a.ply", ply(BINARY, (*QUADS, (0, 1, 2, 8))), {}, "got vertex 8"),
    ("a.obj", obj(QUADS[:5], tail="# C:\\models\\\nf 2 6 8 4\n"), {}, "a backslash at the end"),
    ("a.obj", obj(first=0), {}, "counted from 1"),
    ("a.obj", obj(first=-9), {}, "got vertex -1"),
    ("a.obj", obj(face="{0}/1p"), {}, "7/1/3"),
    ("a.obj", obj(((0, 1),)), {}, "at least 3 vertices"),
    ("a.obj", obj(tail="cstype bezier\n"), {}, "'cstype bezier'"),
    ("a.obj", obj(point="v {:g} {:g} {:g} 2"), {}, "a polygon mesh"),
    ("a.obj", hollow(V / 2 + 0.75), EMPTY, "inside out"),
    ("a.off", off("4OFF", point=" 1"), {}, "vertices x y z"),
    ("a.off", off("OFF BINARY"), {}, ""),
    ("a.off", off().replace("-1 -1 -1", "-1 -1 -1 -1", 1), {}, "as the first one"),
    ("a.off", off(counts="8 5 0"), {}, "got 14 lines"),
    ("a.off", off(counts="8 7 0", tail="3 0 1\n"), {}, "got fewer"),
    ("a.gltf", gltf(lambda made: made["buffers"][0].update(uri="gone.bin")), {}, "gone.bin is missing"),
    ("a.gltf", gltf(**{"gltf_buffer_1.bin": b"short"}), {}, ""),
    ("a.gltf", gltf(accessors(byteOffset=10**6)), {}, ""),
    ("a.gltf", gltf(lambda made: made["bufferViews"][0].update(byteLength=1)), {}, ""),
    ("a.gltf", gltf(**{"gltf_buffer_0.bin": b"x"}), {}, "do not fit together"),
    ("a.gltf", gltf(accessors(sparse={})), {}, "sparse"),
    ("a.gltf", gltf(accessors(normalized=True)), {}, "normalized"),
    ("a.gltf", gltf(primitive(mode=6)), {}, "a fan"),
    ("a.gltf", gltf(nodes({"mesh": 0, "skin": 0})), {}, "without a skin"),
    ("a.gltf", gltf(nodes({"mesh": 0, "camera": 0})), {}, "cameras in nodes of their own"),
    ("a.gltf", gltf(nodes({"children": [2]}, {"children": [2]}, {"mesh": 0})), {}, "a tree"),
    ("a.gltf", gltf(extended("EXT_of_ours")), {}, "EXT_of_ours"),
    ("a.gltf", gltf(extended("KHR_draco_mesh_compression", False)), {}, "KHR_draco"),
    ("a.gltf", gltf(lambda made: made.update(asset={"version": "1.0"})), {}, "glTF 2.0"),
    ("a.dae", dae(asset="<up_axis>Y_UP</up_axis>"), {}, "Y_UP"),
    ("a.dae", dae(more='<extra><asset><unit meter="2"/></asset></extra>'), {}, "one unit for the whole file"),
    ("a.dae", dae(asset='<unit meter="-1"/>'), {}, "a positive unit"),
    ("a.dae", dae(shown="#gone"), {}, "a visual_scene of this file"),
    ("a.dae", dae(node="<translate>5 0 0<foo/> 9</translate>" + SHOWN), {}, "the element foo"),
    ("a.dae", dae(node="<translate>5 0</translate>" + SHOWN), {}, ""),
    ("a.dae", dae(node="<skew>30 1 0 0 0 1 0</skew>" + SHOWN), {}, "got skew"),
    ("a.dae", dae(node='<instance_controller url="#c"/>'), {}, "got instance_controller"),
    ("a.dae", dae(node='<instance_geometry url="other.dae#g"/>'), {}, "a geometry of this file"),
    ("a.dae", dae(node='<node id="x"><instance_node url="#x"/></node>'), {}, ""),
    ("a.dae", dae(polygons("polygons", QUADS, "<ph/>")), {}, "a hole"),
    ("a.dae", dae(polygons("tristrips", [(0, 1, 2)], count=1)), {}, "got tristrips"),
    ("a.dae", dae().replace("mesh>", "spline>"), {}, "expected a mesh"),
    ("a.dae", dae(names="YXZ"), {}, "an accessor of X, Y, Z"),
    ("a.dae", dae(TRIANGLES.replace('"12"', '"11"')), {}, "expected 11 triangles"),
    ("a.dae", dae(TRIANGLES.replace(' count="12"', "")), {}, "'count' is missing"),
    ("a.dae", dae(points=V[:7]), {}, "got vertex 7"),
    ("a.dae", dae(points=np.where(V == 1, np.nan, V)), {}, "finite"),
    ("a.usda", usd(usd_mesh(), head="subLayers = [@gone.usda@]"), {}, "complete USD stage"),
    ("a.usda", usd(usd_mesh() + PAYLOAD), {}, "complete USD stage"),
    ("a.usda", usd(usd_mesh() + 'def PointInstancer "p" {}'), {}, "got a PointInstancer at /p"),
    ("a.usda", usd(usd_mesh() + 'def Plane "p" {}'), {}, "got a Plane at /p"),
    ("a.usda", usd('def SkelRoot "r" {\n' + usd_mesh() + "}"), {}, "without a skin"),
    ("a.usda", usd(usd_mesh(points=())), {}, "vertices of the faces, got none"),
    ("a.usda", usd(usd_mesh().replace("Counts = [", "Counts = [3, ")), {}, "indices for 7 polygons"),
    ("a.usda", usd(usd_mesh()[:-20]), {}, "USD stage"),
    ("a.png", png(GREY), {}, "level='<128'"),
    ("a.png", png(RGBA), DARK, "opaque pixels"),
    ("a.png", png(GREY, transparency=0), DARK, "a transparent colour"),
    ("a.png", FRAMES, DARK, "animation"),
    ("a.png", png(np.full((4, 4), 254, np.uint8)), DARK, "all 16 cells are empty"),
    ("a.pgm", pgm(GREY)[:-1], DARK, "24 bytes after 255, got 24"),
    ("a.pgm", pgm(GREY) + b"\n", DARK, "24 bytes after 255, got 26"),
    ("a.pgm", pgm(GREY).replace(b"255\n", b"255 \n"), DARK, "24 bytes after 255, got 26"),
    ("a.pgm", pgm(GREY).replace(b"255\n", b"255\r"), DARK, "the end of a line and 24 bytes"),
    ("a.pgm", pgm(GREY, "P2") + b"254\n", DARK, "24 numbers from 0 to 255, got 25"),
    ("a.pgm", pgm(GREY.astype(int) + 1000, "P2"), DARK, "24 numbers from 0 to 255"),
    ("a.pgm", pgm(GREY, "P2") + b"x", DARK, ""),
    ("a.pgm", pgm(np.where(BITS, 1, 7), white=7), DARK, "white is 255"),
    ("a.pgm", ppm(GREY), DARK, "P2 or P5, got colours"),
    ("m.yaml", ros(b"P4\n8 1\n\x0f", "m.pbm"), {}, "a PGM or PPM file"),
    ("m.yaml", ros(pgm(GREY) + b"\n", "m.png"), {}, "24 bytes after 255"),
    ("m.yaml", ros(b"".join([LZW[:8], b"\xff" * 4, LZW[12:]]), "m.tif"), {}, ""),
    ("m.yaml", ros(png(RGBA), "m.png"), {}, "an opaque picture"),
    ("m.yaml", ros(mode="raw"), {}, "load its picture with a level"),
    ("m.yaml", ros(), DARK, "got a level"),
    ("m.yaml", ros(), {"spacing": 1.0}, "its own resolution"),
    ("m.yaml", ros(origin=[0, 0, 0.3]), {}, "turned (yaw 0.3)"),
    ("m.yaml", ros(negate=2), {}, "negate: 0 or 1"),
    ("m.yaml", ros(b"", "gone.png"), {}, "no such file"),
    ("m.yaml", ros(drop="origin"), {}, "got no origin"),
    ("m.yaml", ros(occupied_thresh=0.1), {}, "free_thresh <= occupied_thresh"),
    ("m.yaml", ros(more="{a"), {}, "cannot be read"),
    ("a.binvox", MOVED + b"x", {}, "pairs of bytes"),
    ("a.binvox", MOVED.replace(b"data", b"date"), {}, "binvox 1"),
    ("a.binvox", MOVED.replace(b"dim 3", b"dim 0"), {}, "1 to 2147483647 cells"),
    ("a.binvox", binvox(2 * VOXELS.astype(int)), {}, "voxel values 0 and 1"),
    ("a.binvox", binvox(VOXELS, version=2), {}, "binvox 1"),
    ("a.binvox", binvox(VOXELS, "scale 1 2\n"), {}, "binvox 1"),
    ("a.npy", npy(SIGNED), {}, "level='<=0'"),
    ("a.npy", npy(SIGNED), {"level": ">0", "unknown": "occupied"}, "unknown is for maps"),
    ("a.npy", npy(np.where(BITS, np.nan, 1.0)), {"level": ">0"}, "NaN in 4 of 24"),
    ("a.npy", npy(V), {}, "(vertices, faces)"),
    ("a.npy", npy(~BITS), {"hollow": "filled"}, "binary_fill_holes"),
    ("a.npy", npy(np.array([{}], object), allow_pickle=True), {}, "cannot be read"),
    ("a.npy", npy(np.eye(3, dtype=complex)), {}, "bool or real numbers"),
    ("a.npy", npy(BITS) + b"x", {}, "got more data"),
    ("a.npy", npy(np.zeros((4, 4))), {}, "nothing to bound"),
    ("a.npz", npz(a=BITS, b=BITS), {}, "one array or one named 'occupancy'"),
    ("a.npz", npz(b"x", a=BITS), {}, "got more data"),
    ("a.npz", npz(a=BITS).replace(BITS.tobytes(), (~BITS).tobytes()), {}, "cannot be read"),
    ("a.xyz", b"1 2 3", {}, "expected one of"),
    ("a", b"1 2 3", {}, "no extension"),
    ("a.safetensors", b"a bounder", {}, "expected a shape, got a bounder's file"),
]
