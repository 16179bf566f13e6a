"""A mesh whose vertices move with a few pose numbers, as a shape over place and pose at once.

A bounder of it is asked about a place at a pose, and needs no refit when the pose changes. Coordinates are x, y, z,
and the pose numbers behind them. Poses beyond their limits are not in the shape: there are none. The limits are rounded
outwards to float32, so that a query at a limit is asked about.
"""

import hashlib
from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.errors import ShapeError
from warp_bounding.rounding import round_down, round_up
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.shapes.formula import Formula
from warp_bounding.shapes.shape import DETAILS, OUT, HalfSpaces, Shape
from warp_bounding.shapes.triangles.blends import FREE, FULL, Blends, kernels_of

# --- Patches ----------------------------------------------------------------------------------------------------------
#
# Faces of a mesh of blend shapes in patches of neighbours, and the boxes that hold them at every pose.

FACES = 8  # of a patch, at most


class Patches(NamedTuple):
    """Patches, each of some faces.

    Attributes:
        faces: ``(F, 3)`` int32, patch by patch.
        first: ``(C + 1,)`` int32: faces of patch i begin at the i-th number, and end before the next.
        low: ``(C, 3)``, least coordinates of a patch's vertices at pose 0.
        high: ``(C, 3)``, largest ones.
        low_deltas: ``(K, C, 3)``, least deltas of a patch's vertices, of each pose number.
        high_deltas: ``(K, C, 3)``, largest ones.
        part: ``(C,)`` int32, ascending: the part of the surface, connected along edges, that a patch belongs to.
    """

    faces: np.ndarray
    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    low_deltas: np.ndarray
    high_deltas: np.ndarray
    part: np.ndarray


def patches_of(vertices: np.ndarray, deltas: np.ndarray, faces: np.ndarray) -> Patches:
    """Halve the faces of each connected part by the middles of where they lie until there are ``FACES`` at most."""
    connected, middles, parts = _connected(faces), vertices[faces].mean(axis=1), []
    waiting = [np.flatnonzero(connected == number) for number in np.unique(connected)[::-1]]
    while waiting:
        part = waiting.pop()
        if len(part) <= FACES:
            parts.append(part)
            continue
        part = part[np.argsort(middles[part, np.argmax(np.ptp(middles[part], axis=0))], kind="stable")]
        waiting += [part[len(part) // 2 :], part[: len(part) // 2]]
    own = [np.unique(faces[part]) for part in parts]

    def ends(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.stack([x[i].min(axis=0) for i in own]), np.stack([x[i].max(axis=0) for i in own])

    moved = [ends(delta) for delta in deltas]
    first = np.cumsum([0, *map(len, parts)]).astype(np.int32)
    low_deltas, high_deltas = (np.stack([pair[side] for pair in moved]) for side in (0, 1))
    part = np.array([connected[own[0]] for own in parts], dtype=np.int32)
    return Patches(faces[np.concatenate(parts)], first, *ends(vertices), low_deltas, high_deltas, part)


def _connected(faces: np.ndarray) -> np.ndarray:
    """``(F,)`` int, the same number for faces that edges join: the least number of a face among them."""
    edges = np.sort(np.concatenate([faces[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    edge = edge.reshape(3, -1).T
    found, before = np.arange(len(faces)), None
    while before is None or (found != before).any():
        before, least = found, np.full(edge.max() + 1, len(faces))
        np.minimum.at(least, edge, found[:, None])
        found = least[edge].min(axis=1)
        found = found[found]
    return found


# --- The shape --------------------------------------------------------------------------------------------------------

PLACE = 3  # coordinates of space
MOST_POSES = 5  # pose numbers
# of the size of all: by how much a gap may be off; each number of it goes through some tens of roundings of 2^-53
ALLOWANCE = 2.0**-38
DEVICE = "cpu"


class BlendShapes(Formula):
    """A closed mesh with vertices ``vertices + sum_k p_k deltas[k]``; the object is its inside at each pose.

    Args:
        vertices: ``(V, 3)``, at pose 0, object units.
        deltas: ``(K, V, 3)``, by how much each pose number moves them, per unit of it.
        faces: ``(F, 3)`` int, triangles; the mesh must be closed. Its sides may pass through each other, and its
            connected parts may be turned either way: what one
            of these winds around is in the object. What is enclosed and not wound around, as a hollow between parts, is
            not; in a mesh it is.
        lower: ``(K,)``, least pose numbers; 0 for ``None``.
        upper: ``(K,)``, largest pose numbers; 1 for ``None``.
        margin: The object is dilated by this length, in space.
        name: For people.

    Attributes:
        poses: K.

    Raises:
        ShapeError: For arrays that do not fit together, numbers that are none, or a mesh that is not closed.

    Example:
        >>> import trimesh
        >>> ball = trimesh.creation.icosphere(subdivisions=1)
        >>> wide = wb.shapes.BlendShapes(ball.vertices, [ball.vertices * [1.0, 0.0, 0.0]], ball.faces)
        >>> wide.contains(np.array([[1.5, 0.0, 0.0, 0.0], [1.5, 0.0, 0.0, 1.0]]))
        array([False,  True])
    """

    def __init__(
        self,
        vertices,
        deltas,
        faces,
        *,
        lower: Sequence[float] | None = None,
        upper: Sequence[float] | None = None,
        margin: float = 0.0,
        name: str = "blend shapes",
    ):
        self.name = name
        try:
            self.vertices, self.deltas = (np.array(each, dtype=np.float64) for each in (vertices, deltas))
            self.faces = np.array(faces)
        except (TypeError, ValueError) as error:
            raise ShapeError(f"{name}: expected arrays of numbers ({error})") from error
        count = len(self.vertices)
        self._check_arrays(count)
        self.poses = len(self.deltas)
        ends = (np.zeros(self.poses) if lower is None else lower, np.ones(self.poses) if upper is None else upper)
        self._limits = np.array(ends, dtype=np.float64) if all(np.shape(end) == (self.poses,) for end in ends) else None
        if self._limits is None or not (np.isfinite(self._limits).all() and (self._limits[0] < self._limits[1]).all()):
            raise ShapeError(f"{name}: expected {self.poses} least and largest pose numbers, got {lower} and {upper}")
        with np.errstate(over="ignore"):
            self._queried_limits = np.stack([round_down(self._limits[0]), round_up(self._limits[1])]).astype(np.float64)
        if not np.isfinite(self._queried_limits).all():
            raise ShapeError(f"{name}: pose numbers beyond float32, got {lower} and {upper}")
        self.faces = self.faces.astype(np.int32)
        self._check_closed()
        for array in (self.vertices, self.deltas, self.faces, self._limits):
            array.setflags(write=False)
        self.margin = self._new_margin(margin) or 0.0

    def _check_arrays(self, count: int) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1:] != (PLACE,) or not np.isfinite(self.vertices).all():
            raise ShapeError(f"{self.name}: expected finite vertices (V, 3), got {self.vertices.shape}")
        shape = self.deltas.shape
        if len(shape) != 3 or shape[1:] != (count, PLACE) or not 1 <= shape[0] <= MOST_POSES:
            raise ShapeError(f"{self.name}: expected deltas (1 to {MOST_POSES}, {count}, 3), got {shape}")
        if not np.isfinite(self.deltas).all():
            raise ShapeError(f"{self.name}: deltas are not finite")
        whole = self.faces.dtype.kind in "iu"
        if self.faces.ndim != 2 or self.faces.shape[1:] != (3,) or not len(self.faces) or not whole:
            raise ShapeError(f"{self.name}: expected faces (F, 3) of whole numbers, got {self.faces.shape}")
        if self.faces.min() < 0 or self.faces.max() >= count:
            raise ShapeError(f"{self.name}: a face names a vertex that is not there")

    def _check_closed(self) -> None:
        """Every edge must be passed as often one way as the other, or a winding number is none."""
        edges = np.concatenate([self.faces[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]).astype(np.int64)
        sign = np.where(edges[:, 0] < edges[:, 1], 1, -1)
        _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
        if np.bincount(edge.reshape(-1), weights=sign).any():
            raise ShapeError(f"{self.name}: the mesh is not closed")

    # --- where it is -------------------------------------------------------------------------------------------------

    @property
    def ndim(self) -> int:
        return PLACE + self.poses

    @cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box that holds all vertices at all poses, and the poses."""
        ends = self._queried_limits[:, :, None, None] * self.deltas
        low, high = (getattr(np, side)(ends, axis=0).sum(axis=0) + self.vertices for side in ("min", "max"))
        room = ALLOWANCE * self._size + self.margin * (1 + 2.0**-50)
        return tuple(
            np.append(end, pose)
            for end, pose in zip((low.min(axis=0) - room, high.max(axis=0) + room), self._queried_limits, strict=True)
        )

    @property
    def _size(self) -> float:
        """How far from the origin anything can be."""
        moved = (np.abs(self._queried_limits).max(axis=0)[:, None, None] * np.abs(self.deltas)).sum(axis=0)
        return float((np.abs(self.vertices) + moved).sum(axis=1).max()) + self.margin

    @property
    def lower(self) -> np.ndarray:
        return self._box[0]

    @property
    def upper(self) -> np.ndarray:
        return self._box[1]

    @property
    def details_per_unit(self) -> np.ndarray:
        size = self.upper - self.lower
        size[:PLACE] = size[:PLACE].max()
        return DETAILS / size

    @property
    def _padding(self) -> np.ndarray:
        return np.append(np.full(PLACE, 0.1 * (self.upper - self.lower)[:PLACE].max()), np.zeros(self.poses))

    @cached_property
    def geometry(self) -> str:
        """SHA-256 of vertices, deltas, faces and limits; margin and name do not enter."""
        sha = hashlib.sha256(b"warp-bounding blend shapes 1")
        for array in (self.vertices, self.deltas, self.faces, self._limits):
            sha.update(np.asarray(array, dtype="<f8").tobytes() + b";")
        return sha.hexdigest()

    # --- what it is --------------------------------------------------------------------------------------------------

    @cached_property
    def _blends(self) -> Blends:
        found = Blends()
        patches = patches_of(self.vertices, self.deltas, self.faces)
        for name, values in {**patches._asdict(), "vertices": self.vertices, "deltas": self.deltas}.items():
            dtype = {"faces": wp.vec3i, "first": wp.int32, "part": wp.int32}.get(name, wp.vec3d)
            setattr(found, name, wp.array(values, dtype=dtype, device=DEVICE))
        found.margin = self.margin
        found.allowance = ALLOWANCE * (self._size + float(np.abs(self._box[0][:PLACE]).max()))
        return found

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, dtype=np.float64)
        answers = wp.empty(len(x), dtype=wp.uint8, device=DEVICE)
        launch_on_cores(kernels_of(self.ndim).points, len(x), [self._blends, self._array(x)], [answers], DEVICE)
        pose = x[:, PLACE:]
        known = ((pose >= self.lower[PLACE:]) & (pose <= self.upper[PLACE:])).all(axis=1)
        return np.where(known, answers.numpy(), OUT).astype(np.uint8)

    def _array(self, x: np.ndarray) -> wp.array:
        dtype = wp.types.vector(length=self.ndim, dtype=wp.float64)
        return wp.array(
            np.ascontiguousarray(x, dtype=np.float64), dtype=dtype, shape=(len(x),), device=DEVICE, copy=False
        )

    def _query_boxes(self, lower: np.ndarray, upper: np.ndarray, asked: int) -> np.ndarray:
        answers = wp.empty(len(lower), dtype=wp.uint8, device=DEVICE)
        inputs = [self._blends, self._array(lower), self._array(upper), asked]
        launch_on_cores(kernels_of(self.ndim).boxes, len(lower), inputs, [answers], DEVICE)
        return answers.numpy() == asked

    def _to_query(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Which boxes miss the object's, which need a look, and the corners of the relevant part of the latter."""
        lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
        real = (np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
        apart = real & ((lower > self.upper) | (upper < self.lower)).any(axis=1)
        asked = np.flatnonzero(real & ~apart)
        return apart, asked, *(np.clip(x[asked], self.lower, self.upper) for x in (lower, upper))

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        found, asked, low, high = self._to_query(lower, upper)
        found[asked] = self._query_boxes(low, high, FREE)
        return found

    def half_spaces(self, lower: np.ndarray, upper: np.ndarray) -> HalfSpaces:
        found, asked, low, high = self._to_query(lower, upper)
        known, own = HalfSpaces.blank(*map(np.asarray, (lower, upper))), HalfSpaces.blank(low, high)
        boxes = [self._array(side) for side in (low, high)]
        launch_on_cores(kernels_of(self.ndim).half_spaces, len(asked), [self._blends, *boxes], own.arrays(), DEVICE)
        known.empty[:] = found
        for all_of_them, of_queried in zip(known, own, strict=True):
            all_of_them[asked] = of_queried
        return known

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        lower, upper = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            known = ((lower >= self.lower) & (upper <= self.upper))[:, PLACE:].all(axis=1)
        return known & self._query_boxes(lower, upper, FULL)

    def landmarks(self) -> np.ndarray:
        """Vertices at the ends of all poses."""
        ends = np.stack(np.meshgrid(*self._limits.T, indexing="ij"), axis=-1).reshape(-1, self.poses)
        placed = [np.column_stack([self.at(pose), np.tile(pose, (len(self.vertices), 1))]) for pose in ends]
        return np.concatenate(placed)

    def at(self, pose: Sequence[float]) -> np.ndarray:
        """``(V, 3)`` vertices at a pose."""
        return self.vertices + np.tensordot(np.asarray(pose, dtype=np.float64), self.deltas, axes=1)

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random places on the surface at random poses."""
        poses = rng.uniform(*self._limits, (count, self.poses))
        faces, weights = rng.integers(len(self.faces), size=count), rng.dirichlet(np.ones(3), count)
        corners = self.faces[faces]
        moved = self.vertices[corners] + np.einsum("nk,knci->nci", poses, self.deltas[:, corners])
        x = np.column_stack([np.einsum("nc,nci->ni", weights, moved), poses])
        return x[self.decide(x) != OUT]

    # --- what can be made of it --------------------------------------------------------------------------------------

    def dilated(self, margin: float) -> Shape:
        """The object dilated in space."""
        margin = self._new_margin(margin)
        if margin is None:
            return self
        found = copy(self)
        for name in ("_box", "_blends"):
            found.__dict__.pop(name, None)
        found.margin = margin
        return found
