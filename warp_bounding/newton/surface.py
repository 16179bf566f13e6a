"""Newton's passes over whole faces and edges of soft bodies against meshes: what they need not look at.

With ``enable_rigid_soft_full_surface_contact`` Newton looks, for each corner, edge and face of each mesh, which edges
and faces of soft bodies come near it. For each particle it looks which faces of each mesh do.

Here a ball holds each soft face, and each soft edge without a face. It is tested as a particle of that radius. If the
ball is farther from the mesh than Newton looks, so are the face, its edges and its corners.

The other soft faces mark cells of a grid around the mesh, in the mesh's own coordinates. A bounder of distances first
denies pieces of them. A piece marks all cells that it meets, dilated by how far Newton looks and by half the size of
the mesh's largest face. A corner, edge or face of the mesh whose middle lies in an unmarked cell is far from all soft
faces. In a copy of Newton's tables its shape is replaced by one that does not collide, so Newton's thread returns at
once.

On a CPU even these threads take time. There Newton gets shorter tables, of the rows that are left, and the numbers of
rows in the contacts are mapped back.
"""

from copy import copy
from functools import cache, partial

import newton
import numpy as np
import warp as wp

from warp_bounding.bounders import Data
from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.newton.lists import maybe_func
from warp_bounding.newton.placing import Extent, Placed, coordinates_of
from warp_bounding.newton.shapes import Shapes
from warp_bounding.newton.sieve import sieve_of
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.launch import BlockLaunch, ready
from warp_bounding.runtime.native import named, unique_name

ALONG = 32  # cells along each axis of a mesh's box
_ALONG = wp.constant(ALONG)
_ROUNDING = wp.constant(1.0 + 16.0 * UNIT32)  # of a ball's radius: differences, squares, their sum, its root
_SLACK = wp.constant(2.0**-7)  # cells: more than float32 rounds in the number of one among ``ALONG``
NONE = -1  # the number of no bounder
# Newton's bits of a record's kind, and the kinds whose records name a corner, an edge, and a face of a mesh by its row
# in a table.
FAMILY, FAMILIES = 7, (1, 2, 3)
_FINITE = wp.constant(1.0e30)
PIECES = 16.0  # along a side of a face, at most


@wp.struct
class Cells:
    """The grid around a mesh, in its own coordinates."""

    lower: wp.vec3
    per_unit: wp.vec3  # cells; 0 where the mesh is flat
    reach: wp.vec3  # half the size of its largest face
    first: int  # the number of its first cell


@wp.kernel(enable_backward=False)
def place_faces(
    # inputs
    first: int,
    corners: wp.array(dtype=wp.vec3i),
    particle_q: wp.array(dtype=wp.vec3),
    particle_radius: wp.array(dtype=float),
    # outputs
    middles: wp.array(dtype=wp.vec3),
    radii: wp.array(dtype=float),
):
    """A ball around each face, as large as its particles are beyond it."""
    i = first + wp.tid()
    face = corners[i]
    middle = (particle_q[face[0]] + particle_q[face[1]] + particle_q[face[2]]) / 3.0
    farthest, radius = wp.float32(0.0), wp.float32(0.0)
    for k in range(3):
        farthest = wp.max(farthest, wp.length(particle_q[face[k]] - middle))
        radius = wp.max(radius, wp.abs(particle_radius[face[k]]))
    middles[i] = middle
    radii[i] = (farthest + radius) * _ROUNDING


@wp.func
def _mark_box(cells: Cells, lower: wp.vec3, upper: wp.vec3, marks: wp.array(dtype=wp.bool)):
    from_, to = wp.vec3i(), wp.vec3i()
    for k in range(3):
        low = (lower[k] - cells.lower[k]) * cells.per_unit[k] - _SLACK
        high = (upper[k] - cells.lower[k]) * cells.per_unit[k] + _SLACK
        from_[k] = int(wp.clamp(low, 0.0, float(_ALONG - 1)))
        to[k] = int(wp.clamp(high + 1.0, 0.0, float(_ALONG)))
    for a in range(from_[0], to[0]):
        for b in range(from_[1], to[1]):
            for c in range(from_[2], to[2]):
                marks[cells.first + (a * _ALONG + b) * _ALONG + c] = True


@wp.func
def _anywhere(data: Data, x: wp.vec3, way: float, dilated: float) -> bool:
    return True


@cache
def mark_kernel(source: DistanceSource | None) -> wp.Kernel:
    """The kernel that marks the cells which faces may touch, of the shapes with a bounder of this source, or of others.

    With a bounder a face is cut into pieces of about a cell; a piece that the bounder denies marks nothing.
    """
    most = wp.constant(PIECES if source else 1.0)
    near, called = _anywhere, "wb_newton_marks"
    if source is not None:
        near, called = maybe_func(source), unique_name(source, "newton_marks")

    @named(called).kernel
    def mark_cells(
        # inputs
        first: int,
        data: Data,
        number: int,
        dilated: float,
        numbers: wp.array(dtype=wp.int32),
        pairs: wp.array(dtype=wp.vec2i),
        keep: wp.array(dtype=wp.bool),
        corners: wp.array(dtype=wp.vec3i),
        particle_q: wp.array(dtype=wp.vec3),
        particle_radius: wp.array(dtype=float),
        placed: wp.array(dtype=Placed),
        hulls: wp.array(dtype=Extent),
        grids: wp.array(dtype=Cells),
        # outputs
        marks: wp.array(dtype=wp.bool),
        whole: wp.array(dtype=wp.bool),
    ):
        i = first + wp.tid()
        if not keep[i] or numbers[pairs[i][1]] != number:
            return
        face, shape = corners[pairs[i][0]], pairs[i][1]
        hull, place, cells = hulls[shape], placed[shape], grids[shape]
        at, way, sizes = wp.mat33(), wp.float32(0.0), wp.float32(0.0)
        for k in range(3):
            x = particle_q[face[k]]
            y = wp.cw_div(wp.transform_point(place.to_shape, x), place.scale)
            at[k] = y
            own = hull.per_radius * wp.abs(particle_radius[face[k]]) + hull.per_coordinate * coordinates_of(x)
            way = wp.max(way, hull.reach + own)
            sizes += coordinates_of(y) + own
        if not (way <= hull.margin and sizes < _FINITE):
            whole[shape] = True  # it is not known which
            return
        one_side, other_side = at[1] - at[0], at[2] - at[0]
        longest = wp.max(wp.abs(wp.cw_mul(one_side, cells.per_unit)))
        longest = wp.max(longest, wp.max(wp.abs(wp.cw_mul(other_side, cells.per_unit))))
        pieces = int(wp.clamp(longest + 1.0, 1.0, most))
        one, other = one_side / float(pieces), other_side / float(pieces)
        for p in range(pieces):
            for q in range(pieces - p):
                corner = at[0] + float(p) * one + float(q) * other
                lower = wp.min(corner, wp.min(corner + one, corner + other))
                upper = wp.max(corner, wp.max(corner + one, corner + other))
                if p + q + 1 < pieces:
                    lower = wp.min(lower, corner + one + other)
                    upper = wp.max(upper, corner + one + other)
                reach = (way + 0.5 * wp.length(upper - lower)) * _ROUNDING
                if pieces == 1 or near(data, 0.5 * (lower + upper), reach, dilated):  # a whole face stays
                    beyond = wp.vec3(way) + cells.reach
                    _mark_box(cells, lower - beyond, upper + beyond, marks)

    return mark_cells


@wp.kernel(enable_backward=False)
def mask_rows(
    # inputs
    first: int,
    shapes: wp.array(dtype=wp.int32),
    cells: wp.array(dtype=wp.int32),
    marks: wp.array(dtype=wp.bool),
    whole: wp.array(dtype=wp.bool),
    # outputs
    rows: wp.array2d(dtype=wp.int32),
):
    """The shape of each row of a table, or one that does not collide."""
    i = first + wp.tid()
    shape = shapes[i]
    if marks[cells[i]] or whole[shape]:
        rows[i, 0] = shape
    else:
        rows[i, 0] = whole.shape[0]


class Surface:
    """The culls of Newton's passes over particles, faces and edges of soft bodies against meshes.

    Attributes:
        particles: The sieve of particles and meshes.
        faces: The sieve of soft faces, and edges without one, and meshes.
        data: A copy of Newton's tables, in this pass with what the launches have left.
        model: A copy of the model, with flags of one more shape, which does not collide.
    """

    def __init__(self, pipeline: newton.CollisionPipeline, shapes: Shapes):
        self._pipeline, self._model, self._shapes = pipeline, pipeline.model, shapes
        model, device = self._model, pipeline.model.device
        self._device = device
        self.model, self.data = model, pipeline._soft_mesh_contact_data
        self.particles = sieve_of(self.data.vertex_pairs, model.particle_count, shapes)
        corners = _corners_of(model)
        mesh_corners, _, mesh_edges, _ = self.data.rigid_features
        tables = [mesh_corners, mesh_edges, self.data.rigid_faces]
        meshes = np.unique(np.concatenate([self.data.vertex_pairs.numpy()[:, 1], *(t.numpy()[:, 0] for t in tables)]))
        self._corners = wp.array(corners, dtype=wp.vec3i, device=device)
        self._middles = wp.empty(len(corners), dtype=wp.vec3, device=device)
        self._radii = wp.empty(len(corners), dtype=wp.float32, device=device)
        pairs = _pairs_of(model, corners, meshes)
        self.faces = sieve_of(wp.array(pairs, dtype=wp.vec2i, device=device), len(corners), shapes)
        grids, cells = _grids(model.shape_count, meshes, tables, shapes)
        self._grids = wp.array(grids, dtype=Cells, device=device)
        self._marks = wp.zeros(max(len(meshes), 1) * ALONG**3, dtype=wp.bool, device=device)
        self._whole = wp.zeros(model.shape_count, dtype=wp.bool, device=device)
        flags = model.shape_flags
        self._flags = wp.zeros(len(flags) + 1, dtype=flags.dtype, device=device)  # the last shape does not collide
        # For each table: the shapes and the cells of its rows, and a copy of it, in which shapes are replaced.
        self._tables = [
            (*(wp.array(each, dtype=int, device=device) for each in (table.numpy()[:, 0].copy(), own)), wp.clone(table))
            for table, own in zip(tables, cells, strict=True)
        ]
        # What marks cells: kernel, numbers, place among the bounders, and margin of each; of shapes without, and of
        # bounders of points, whatever is left of a face does.
        self._marking = [
            (mark_kernel(each.source if each.of_distances else None), each.data, n, each.info.get("margin") or 0.0)
            for n, each in enumerate(shapes.bounders)
        ]
        self._marking.append((mark_kernel(None), Data(), NONE, 0.0))
        for kernel in (place_faces, mask_rows, *(marking[0] for marking in self._marking)):
            ready(kernel, device)

    def launches(self, state: newton.State) -> list[BlockLaunch]:
        """What fills the masks of both sieves and of the tables; ``begin`` comes before."""
        q, radius, device = state.particle_q, self._model.particle_radius, self._model.device
        launch = partial(BlockLaunch, device=device, first_index=0, block=1)
        found = self.particles.launches(q, radius)
        if not len(self.faces):
            return found
        where = [self._shapes.placed, self._shapes.hulls, self._grids]
        about = [self._shapes.bounder_of, self.faces.pairs, self.faces.keep, self._corners, q, radius, *where]
        marks = [self._marks, self._whole]
        return [
            *found,
            launch(place_faces, len(self._corners), [0, self._corners, q, radius], [self._middles, self._radii]),
            *self.faces.launches(self._middles, self._radii),
            *(launch(kernel, len(self.faces), [0, *own, *about], marks) for kernel, *own in self._marking),
            *(
                launch(mask_rows, len(rows), [0, shapes, cells, *marks], [_numbers(rows)])
                for shapes, cells, rows in self._tables
                if len(rows)
            ),
        ]

    def begin(self) -> None:
        """Forget what the last pass found, and read the pipeline and the model anew."""
        self.data, self.model = copy(self._pipeline._soft_mesh_contact_data), copy(self._model)
        self._alive: list[np.ndarray] = []  # the rows of each shorter table
        for sieve in (self.particles, self.faces):
            sieve.begin()
        self._marks.zero_()
        self._whole.zero_()

    def replace(self, state: newton.State, reads_back: bool) -> None:
        """Replace tables in ``data`` by what the launches have left."""
        data = self.data
        if len(self.particles):
            data.vertex_pairs = self.particles.kept(state.particle_q, reads_back)
        if not len(self.faces):
            return
        wp.copy(self._flags, self._model.shape_flags)
        self.model.shape_flags = self._flags
        face_offsets, corner_spans, edge_spans, edge_slots, neighbors, corner_normals, edge_normals = data.adjacency
        corners, edges, faces = tables = [rows for _, _, rows in self._tables]
        if reads_back and self._device.is_cpu and not self._device.is_capturing:
            self._alive = of_corners, of_edges, of_faces = [_alive(rows, self._model.shape_count) for rows in tables]
            corners, corner_normals = (_gathered(rows, of_corners) for rows in (corners, corner_normals))
            edges, edge_normals, edge_slots = (_gathered(rows, of_edges) for rows in (edges, edge_normals, edge_slots))
            faces = _gathered(faces, of_faces)
        data.rigid_features, data.rigid_faces = (corners, corner_normals, edges, edge_normals), faces
        data.adjacency = [face_offsets, corner_spans, edge_spans, edge_slots, neighbors, corner_normals, edge_normals]

    def end(self, contacts: newton.Contacts) -> None:
        """Let contacts name rows of Newton's own tables, not of those with the rows that were left."""
        contacts._soft_contact_mesh_data = self._pipeline._soft_mesh_contact_data
        if not self._alive:
            return
        last = min(int(contacts.soft_contact_count.numpy()[0]), contacts.soft_contact_max)
        features = contacts._soft_contact_mesh_features.numpy()[
            int(contacts._soft_contact_mesh_state.numpy()[0]) : last
        ]
        for family, rows in zip(FAMILIES, self._alive, strict=True):
            own = (features[:, 0] & FAMILY) == family
            features[own, 2] = rows[features[own, 2]]

    def rows(self) -> list[tuple[int, int]]:
        """Of corners, edges and faces of meshes: how many there are, and how many are left; waits for the device."""
        none = self._model.shape_count
        return [(len(rows), int((rows.numpy()[:, 0] != none).sum())) for _, _, rows in self._tables]


def _corners_of(model: newton.Model) -> np.ndarray:
    """``(F, 3)`` int32, the particles of faces, and of edges that belong to none (their last twice)."""
    none = np.empty((0, 3), np.int32)
    faces = model.tri_indices.numpy().reshape(-1, 3) if model.tri_count else none
    if not len(faces) or not model.edge_count:  # without faces Newton looks at no edge
        return faces
    edges = model.edge_indices.numpy()[:, 2:4]
    first, last = np.sort(np.concatenate([edges, *(faces[:, [k, (k + 1) % 3]] for k in range(3))]), axis=1).T
    keys = first.astype(np.int64) * model.particle_count + last
    lone = ~np.isin(keys[: len(edges)], keys[len(edges) :])
    return np.concatenate([faces, edges[lone][:, [0, 1, 1]]]).astype(np.int32)


def _alive(rows: wp.array, none: int) -> np.ndarray:
    """The numbers of rows whose shape collides; at least one, since Newton leaves its passes if there is none."""
    found = np.flatnonzero(rows.numpy()[:, 0] != none)
    return found if len(found) else np.zeros(1, np.int64)


def _gathered(rows: wp.array, which: np.ndarray) -> wp.array:
    """Some rows of a table on a CPU; none of an empty one."""
    return wp.array(rows.numpy()[which], dtype=rows.dtype, device=rows.device) if len(rows) else rows


def _numbers(rows: wp.array) -> wp.array:
    """The same rows, each a row of whole numbers."""
    return wp.array(ptr=rows.ptr, dtype=wp.int32, shape=(len(rows), rows.dtype._length_), device=rows.device)


def _pairs_of(model: newton.Model, corners: np.ndarray, meshes: np.ndarray) -> np.ndarray:
    """``(N, 2)`` int32, faces and meshes of worlds that meet, mesh by mesh."""
    if not len(corners):
        return np.empty((0, 2), np.int32)
    world, of_shape = model.particle_world.numpy()[corners], model.shape_world.numpy()
    found = []
    for shape in meshes:
        own = of_shape[shape]
        meet = np.flatnonzero(((world < 0) | (world == own) | (own < 0)).any(axis=1))
        found.append(np.column_stack([meet, np.full(len(meet), shape)]))
    return np.concatenate(found).astype(np.int32) if found else np.empty((0, 2), np.int32)


def _grids(
    count: int, meshes: np.ndarray, tables: list[wp.array], shapes: Shapes
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The ``Cells`` of each of ``count`` shapes, and of each row of each table the number of its cell."""
    grids = np.zeros(count, Cells.numpy_dtype())
    rows = [table.numpy() for table in tables]
    cells = [np.zeros(len(own), np.int32) for own in rows]
    for number, shape in enumerate(meshes):
        points, faces = shapes.mesh_of(int(shape))
        corners = points[faces.reshape(-1)].astype(np.float64)
        if not np.isfinite(corners).all():
            continue  # never tested, so its mesh is marked whole
        lower, width = corners.min(axis=0), np.ptp(corners, axis=0)
        per_unit = np.divide(ALONG, width, out=np.zeros(3), where=width > 0).astype(np.float32)
        reach, first = np.zeros(3), number * ALONG**3
        for own, cell in zip(rows, cells, strict=True):
            here = np.flatnonzero(own[:, 0] == shape)
            at = own[here, 1:]
            if own is rows[2]:
                at = 3 * at + np.arange(3)
            boxes = corners[at]
            low, high = boxes.min(axis=1), boxes.max(axis=1)
            reach = np.maximum(reach, ((high - low) / 2).max(axis=0, initial=0.0))
            place = np.clip(((low + high) / 2 - lower) * per_unit, 0, ALONG - 1).astype(np.int64)
            cell[here] = first + (place[:, 0] * ALONG + place[:, 1]) * ALONG + place[:, 2]
        grids[shape]["lower"], grids[shape]["per_unit"] = lower, per_unit
        grids[shape]["reach"], grids[shape]["first"] = np.nextafter(reach.astype(np.float32), np.inf), first
    return grids, cells
