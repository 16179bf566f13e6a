"""COLLADA (``.dae``) 1.4 and 1.5, as robots' meshes come: the polygons of the scene, in metres.

Coordinates are those of a file with z up. Programs disagree whether one with another axis up is to be turned, so such
files are refused. Skins, morphs, polygons with holes, splines and references to other files are refused as well; lines
are noted. What an element may hold is listed here, and whatever else is found where geometry may be is refused.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from warp_bounding.shapes.formats.reading import MeshData, as_faces, as_numbers, joined, triangulated

__all__ = ["read_collada"]

Element = ElementTree.Element
THIN = ("lines", "linestrips")
POLYGONS = ("triangles", "polylist", "polygons", "tristrips", "trifans")
TRANSFORMS = ("matrix", "translate", "rotate", "scale")
UNPLACED = {"asset", "extra", "instance_camera", "instance_light"}  # in a node; no geometry
MOST_INSTANCES = 1_000_000


def read_collada(path: Path) -> MeshData:
    """Read a COLLADA file; raises ``ValueError`` for one that is not whole, or holds geometry of another kind."""
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        raise ValueError(f"expected XML, got an error: {error}") from error
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    if root.tag != "COLLADA":
        raise ValueError(f"expected an element COLLADA, got {root.tag[:40]}")
    return _File(root).read()


class _File:
    """A document, its elements by their ids, and notes of what is read."""

    def __init__(self, root: Element):
        self.root, self.notes, self.placed = root, [], 0
        self.named: dict[str, list[Element]] = {}
        for element in root.iter():
            self.named.setdefault(element.get("id", ""), []).append(element)
        self.geometries: dict[Element, list[tuple[np.ndarray, np.ndarray]]] = {}

    def read(self) -> MeshData:
        """All that the scene shows."""
        units, axes = list(self.root.iter("unit")), list(self.root.iter("up_axis"))
        own = self.root.find("asset")
        for element in units + axes:
            if own is None or element not in list(own):
                raise ValueError(f"expected one {element.tag} for the whole file, got another inside an element")
        for tag, found in (("unit", units), ("up_axis", axes)):
            if len(found) > 1:
                raise ValueError(f"expected one {tag}, got {len(found)}")
        axis = axes[0].text.strip() if axes and axes[0].text else ""
        if axis not in ("Z_UP", ""):
            raise ValueError(
                f"expected up_axis Z_UP, got {axis[:20]}: programs disagree whether it is to be turned, so write it "
                "with z up"
            )
        self.notes += ["no up_axis: taken as z up"] * (not axis)
        meter = as_numbers([units[0].get("meter", "1").encode()])[0] if units else 1.0
        if not 0 < meter < np.inf:
            raise ValueError(f"expected a positive unit, got {meter} metres")
        scenes = self.root.findall("scene/instance_visual_scene")
        if len(scenes) != 1:
            raise ValueError(f"expected a scene to show, got {len(scenes) or 'none'}")
        shown = self.target(scenes[0].get("url"), "visual_scene")
        others = len(list(self.root.iter("visual_scene"))) - 1
        self.notes += [f"not read: {others} scenes that the file does not show"] * bool(others)
        animated = self.root.find("library_animations/animation") is not None
        self.notes += ["animated: only the pose that the file stores is bounded"] * animated
        parts = [
            part for node in self._nodes(shown) for part in self._node(node, np.diag([meter, meter, meter, 1.0]), ())
        ]
        unseen = len(self.root.findall("library_geometries/geometry")) - len(self.geometries)
        self.notes += [f"not read: {unseen} geometries that the scene does not show"] * bool(unseen)
        return joined(parts, self.notes)

    def target(self, url: str | None, tag: str) -> Element:
        """The element that a url of this file names; raises ``ValueError`` for another."""
        if url is None or not url.startswith("#"):
            raise ValueError(f"expected a {tag} of this file, got {url}")
        found = self.named.get(url[1:], [])
        if len(found) != 1 or found[0].tag != tag:
            raise ValueError(f"expected one {tag} {url}, got {', '.join(element.tag for element in found) or 'none'}")
        return found[0]

    def _nodes(self, scene: Element) -> Iterator[Element]:
        for child in scene:
            if child.tag == "node":
                yield child
            elif child.tag not in ("asset", "evaluate_scene", "extra"):
                raise ValueError(f"expected nodes in a scene, got {child.tag}")

    def _node(
        self, node: Element, above: np.ndarray, path: tuple[Element, ...]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices in the world and faces of all below a node."""
        self.placed += 1
        if node in path or self.placed > MOST_INSTANCES:
            raise ValueError("expected nodes that do not hold themselves")
        matrix, path = above, (*path, node)
        for child in node:
            if child.tag in TRANSFORMS:
                matrix = matrix @ _transform(child)
        for child in node:
            if child.tag == "node":
                yield from self._node(child, matrix, path)
            elif child.tag == "instance_node":
                yield from self._node(self.target(child.get("url"), "node"), matrix, path)
            elif child.tag == "instance_geometry":
                geometry = self.target(child.get("url"), "geometry")
                if geometry not in self.geometries:
                    self.geometries[geometry] = list(self._geometry(geometry))
                for vertices, faces in self.geometries[geometry]:
                    mirrored = np.linalg.det(matrix[:3, :3]) < 0
                    yield vertices @ matrix[:3, :3].T + matrix[:3, 3], faces[:, ::-1] if mirrored else faces
            elif child.tag not in UNPLACED and child.tag not in TRANSFORMS:
                what = "a skin or morph (instance_controller)" if child.tag == "instance_controller" else child.tag
                raise ValueError(f"expected meshes in a node, got {what}")

    def _geometry(self, geometry: Element) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices and faces of the polygons of a mesh."""
        for mesh in geometry:
            if mesh.tag in ("asset", "extra"):
                continue
            if mesh.tag != "mesh":
                raise ValueError(f"expected a mesh, got {mesh.tag}")
            for part in mesh:
                if part.tag in THIN:
                    self.notes.append("not read, as they have no surface: lines")
                elif part.tag in POLYGONS:
                    yield self._polygons(part)
                elif part.tag not in ("source", "vertices", "extra"):
                    raise ValueError(f"expected polygons in a mesh, got {part.tag}")

    def _polygons(self, part: Element) -> tuple[np.ndarray, np.ndarray]:
        if part.find("ph") is not None:
            raise ValueError("expected polygons without holes, got a hole (ph)")
        inputs = part.findall("input")
        corners = [one for one in inputs if one.get("semantic") == "VERTEX"]
        if len(corners) != 1:
            raise ValueError(f"expected one input of semantic VERTEX, got {len(corners)}")
        vertices = self._positions(self.target(corners[0].get("source"), "vertices"))
        stride = 1 + max(_attribute(one, "offset", 0) for one in inputs)
        runs = []
        for p in part.findall("p"):
            numbers = _integers(p)
            if len(numbers) % stride:
                raise ValueError(f"expected {stride} indices a corner, got {len(numbers)} in all")
            runs.append(numbers.reshape(-1, stride)[:, _attribute(corners[0], "offset", 0)])
        count = _attribute(part, "count", -1)
        if part.tag in ("triangles", "polylist"):
            if part.tag == "triangles":
                sizes = np.full(sum(map(len, runs)) // 3, 3)
            else:
                sizes = np.concatenate([np.zeros(0, np.int64), *map(_integers, part.findall("vcount"))])
            faces = triangulated(vertices, sizes, np.concatenate([np.zeros(0, np.int64), *runs]))
        elif part.tag == "polygons":
            sizes = np.array([len(run) for run in runs], np.int64)
            faces = triangulated(vertices, sizes, np.concatenate([np.zeros(0, np.int64), *runs]))
        else:
            sizes, strips = np.array([len(run) for run in runs], np.int64), [np.zeros((0, 3), np.int64)]
            for run in runs:
                k = np.arange(max(len(run) - 2, 0))
                odd = (k % 2 == 1) & (part.tag == "tristrips")
                first = run[np.zeros_like(k) if part.tag == "trifans" else k] if len(k) else run[:0]
                strips.append(np.stack([first, run[k + 1 + odd], run[k + 2 - odd]], axis=1))
            faces = as_faces(np.concatenate(strips), len(vertices))
        if len(sizes) != count:
            raise ValueError(
                f"expected {'a count of' if count < 0 else count} {part.tag}, got "
                f"{len(sizes)}{' without one' * (count < 0)}"
            )
        return vertices, faces

    def _positions(self, vertices: Element) -> np.ndarray:
        """``(V, 3)`` float64."""
        inputs = [one for one in vertices.findall("input") if one.get("semantic") == "POSITION"]
        if len(inputs) != 1:
            raise ValueError(f"expected one input of semantic POSITION, got {len(inputs)}")
        accessors = self.target(inputs[0].get("source"), "source").findall("technique_common/accessor")
        if len(accessors) != 1:
            raise ValueError(f"expected one accessor of a source, got {len(accessors)}")
        accessor = accessors[0]
        array = self.target(accessor.get("source"), "float_array")
        numbers = _numbers(array)
        if len(numbers) != _attribute(array, "count", -1):
            raise ValueError(f"expected {array.get('count')} numbers in float_array, got {len(numbers)}")
        count, stride, offset = (
            _attribute(accessor, key, default) for key, default in (("count", 0), ("stride", 1), ("offset", 0))
        )
        names = [one.get("name") for one in accessor.findall("param")]
        named = [k for k, name in enumerate(names) if name]  # a nameless one is passed over
        if [names[k].upper() for k in named] != list("XYZ") or named[-1] >= stride:
            raise ValueError(f"expected an accessor of X, Y, Z, got {names} and a stride of {stride}")
        if count and offset + stride * (count - 1) + named[-1] >= len(numbers):
            raise ValueError(f"expected {count} points in float_array, got {len(numbers)} numbers")
        return numbers[(offset + stride * np.arange(count))[:, None] + np.array(named)]


def _numbers(element: Element) -> np.ndarray:
    if len(element):
        raise ValueError(f"expected numbers in {element.tag}, got the element {element[0].tag}")
    return as_numbers((element.text or "").encode().split())


def _integers(element: Element) -> np.ndarray:
    numbers = _numbers(element)
    if not (np.floor(numbers) == numbers).all():
        raise ValueError(f"expected integers in {element.tag}, got something else")
    return numbers.astype(np.int64)


def _attribute(element: Element, name: str, default: int) -> int:
    """An attribute that counts, 0 or more."""
    word = element.get(name, "").strip()
    if name in element.attrib and not (word.isascii() and word.isdigit()):
        raise ValueError(f"expected a number of 0 or more as {name} of {element.tag}, got {word[:40]!r}")
    return int(word or default)


def _transform(element: Element) -> np.ndarray:
    """``(4, 4)`` of a matrix, a translation, a rotation in degrees or a scale."""
    numbers = _numbers(element)
    if len(numbers) != {"matrix": 16, "rotate": 4}.get(element.tag, 3):
        raise ValueError(f"expected another count of numbers in {element.tag}, got {len(numbers)}")
    matrix = np.eye(4)
    if element.tag == "matrix":
        matrix = numbers.reshape(4, 4)
        if (matrix[3] != [0, 0, 0, 1]).any():
            raise ValueError(f"expected an affine matrix, got the last row {matrix[3].tolist()}")
    elif element.tag == "translate":
        matrix[:3, 3] = numbers
    elif element.tag == "scale":
        matrix[:3, :3] = np.diag(numbers)
    else:
        axis, angle = numbers[:3], np.deg2rad(numbers[3])
        length = np.linalg.norm(axis)
        if length == 0 and angle:
            raise ValueError("expected an axis of rotate, got 0 0 0")
        x, y, z = axis / (length or 1.0)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        matrix[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix
