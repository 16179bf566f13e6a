"""COLLADA (``.dae``) 1.4 and 1.5, as robots' meshes come: triangles and polygons of the scene, in metres.

The reader is our own: pycollada takes NaN for 0, rotates about every axis as if its length were 1, leaves the faces of
what is mirrored inside out, and rounds placements to float32. Coordinates are those of a file with z up. Programs
disagree whether one with another axis up is to be turned, so the caller says, or it is refused. So is whatever else is
found where geometry may be: skins, strips, polygons with holes, splines, references to other files.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from warp_bounding.rigid import lengths, matmul, sine_cosine
from warp_bounding.shapes.formats.reading import MeshData, joined, placed, triangulated

Element = ElementTree.Element
TRANSFORMS = ("matrix", "translate", "rotate", "scale")
# What turns a file until z is up, by the axis that it says is.
TURNS = {"X_UP": [[0, -1, 0], [0, 0, -1], [1, 0, 0]], "Y_UP": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "Z_UP": np.eye(3)}
UNPLACED = {"asset", "extra", "instance_camera", "instance_light"}  # in a node; no geometry


def read_collada(path: Path, upright: bool | None = None) -> MeshData:
    """Read a COLLADA file; raises ``ValueError`` for one that is not whole, or holds geometry of another kind.

    ``upright`` is whether a file whose up axis is not z is turned until it is; ``None`` refuses it.
    """
    root = ElementTree.fromstring(path.read_bytes())
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return _File(root).read(upright)


class _File:
    """A document, its elements by their ids, and notes of what is read."""

    def __init__(self, root: Element):
        self.root, self.notes = root, []
        self.named = {element.get("id"): element for element in root.iter()}

    def read(self, upright: bool | None) -> MeshData:
        """All that the scene shows; see ``read_collada``."""
        axis = (self.root.findtext("asset/up_axis") or "").strip()
        if axis not in ("Z_UP", "") and (upright is None or axis not in TURNS):
            say = "write it so, or say which to load_urdf: upright=True (turned) or False"
            raise ValueError(f"expected up_axis Z_UP, as programs turn others or do not, got {axis[:20]}; {say}")
        self.notes += ["no up_axis: taken as z up"] * (not axis)
        unit = self.root.find("asset/unit")
        meter = 1.0 if unit is None else float(unit.get("meter", "1"))
        if not 0 < meter < np.inf:
            raise ValueError(f"expected a positive unit, got {meter} metres")
        for tag in ("unit", "up_axis"):
            if list(self.root.iter(tag)) != self.root.findall(f"asset/{tag}")[:1]:
                raise ValueError(f"expected one {tag} for the whole file, got another")
        scene = self.root.find("scene/instance_visual_scene")
        if scene is None:
            raise ValueError("expected a scene to show, got none")
        if self.root.find("library_animations/animation") is not None:
            self.notes.append("animated: only the pose that the file stores is bounded")
        shown, scale = self.target(scene, "visual_scene"), np.diag([meter, meter, meter, 1.0])
        if axis and upright:
            scale[:3, :3] = meter * np.array(TURNS[axis])
        return joined([part for node in shown.findall("node") for part in self._node(node, scale)], self.notes)

    def target(self, element: Element, tag: str) -> Element:
        """The element of this file that another one refers to."""
        url = element.get("url") or element.get("source") or ""
        found = self.named.get(url[1:]) if url.startswith("#") else None
        if found is None or found.tag != tag:
            raise ValueError(f"expected a {tag} of this file, got {url}")
        return found

    def _node(self, node: Element, above: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices in the world and faces of all below a node."""
        matrix = above
        for child in node:
            if child.tag in TRANSFORMS:
                matrix = matmul(matrix, _transform(child))
        for child in node:
            if child.tag == "node":
                yield from self._node(child, matrix)
            elif child.tag == "instance_node":
                yield from self._node(self.target(child, "node"), matrix)
            elif child.tag == "instance_geometry":
                for vertices, faces in self._geometry(self.target(child, "geometry")):
                    yield placed(vertices, faces, matrix)
            elif child.tag not in UNPLACED and child.tag not in TRANSFORMS:
                raise ValueError(f"expected meshes in a node, got {child.tag}")

    def _geometry(self, geometry: Element) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices and faces of the polygons of a mesh."""
        if (mesh := geometry.find("mesh")) is None:
            raise ValueError("expected a mesh as a geometry, got another kind")
        for part in mesh:
            if part.tag in ("triangles", "polylist", "polygons"):
                yield self._polygons(part)
            elif part.tag in ("lines", "linestrips"):
                self.notes.append("not read, as they have no surface: lines")
            elif part.tag not in ("source", "vertices", "extra"):
                raise ValueError(f"expected triangles and polygons in a mesh, got {part.tag}")

    def _polygons(self, part: Element) -> tuple[np.ndarray, np.ndarray]:
        if part.find("ph") is not None:
            raise ValueError("expected polygons without holes, got a hole (ph)")
        inputs = {one.get("semantic"): one for one in part.findall("input")}
        vertices = self._positions(self.target(inputs["VERTEX"], "vertices"))
        stride = 1 + max(int(one.get("offset", 0)) for one in part.findall("input"))
        runs = [
            _numbers(p, int).reshape(-1, stride)[:, int(inputs["VERTEX"].get("offset", 0))] for p in part.findall("p")
        ]
        indices = np.concatenate([np.zeros(0, np.int64), *runs])
        if part.tag == "triangles":
            sizes = np.full(len(indices) // 3, 3)
        elif part.tag == "polylist":
            sizes = np.concatenate([np.zeros(0, np.int64), *(_numbers(n, int) for n in part.findall("vcount"))])
        else:
            sizes = np.array([len(run) for run in runs], np.int64)
        if len(sizes) != int(part.attrib["count"]):
            raise ValueError(f"expected {part.get('count')} {part.tag}, got {len(sizes)}")
        return vertices, triangulated(sizes, indices, len(vertices))

    def _positions(self, vertices: Element) -> np.ndarray:
        """``(V, 3)`` float64."""
        inputs = {one.get("semantic"): one for one in vertices.findall("input")}
        accessor = self.target(inputs["POSITION"], "source").find("technique_common/accessor")
        array = self.target(accessor, "float_array")
        numbers = _numbers(array)
        if len(numbers) != int(array.attrib["count"]):
            raise ValueError(f"expected {array.get('count')} numbers in float_array, got {len(numbers)}")
        names = [one.get("name") for one in accessor.findall("param")]
        if names != list("XYZ") or accessor.get("stride") != "3" or accessor.get("offset", "0") != "0":
            raise ValueError(f"expected an accessor of X, Y, Z, 3 apart, got {names} and {accessor.get('stride')}")
        return numbers.reshape(int(accessor.attrib["count"]), 3)


def _numbers(element: Element, kind: type = float) -> np.ndarray:
    if len(element):
        raise ValueError(f"expected numbers in {element.tag}, got the element {element[0].tag}")
    return np.array([kind(word) for word in (element.text or "").encode().split()], kind)


def _transform(element: Element) -> np.ndarray:
    """``(4, 4)`` of a matrix, a translation, a rotation in degrees or a scale."""
    numbers = _numbers(element).reshape({"matrix": (4, 4), "rotate": (4,)}.get(element.tag, (3,)))
    matrix = np.eye(4)
    if element.tag == "matrix":
        if (numbers[3] != [0, 0, 0, 1]).any():
            raise ValueError(f"expected an affine matrix, got the last row {numbers[3].tolist()}")
        matrix = numbers
    elif element.tag == "translate":
        matrix[:3, 3] = numbers
    elif element.tag == "scale":
        matrix[:3, :3] = np.diag(numbers)
    elif numbers[3]:
        axis, (sine, cosine) = numbers[:3], sine_cosine(np.deg2rad(numbers[3]))
        x, y, z = axis / lengths(axis)  # not finite without an axis, which is refused
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        matrix[:3, :3] = np.eye(3) + sine * cross + (1 - cosine) * matmul(cross, cross)
    return matrix
