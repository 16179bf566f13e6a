"""What the cull knows of a model's shapes: each one's hull and bounder, a number or vector on the device."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache

import newton
import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder
from warp_bounding.errors import BounderError, warn
from warp_bounding.newton import placing
from warp_bounding.newton.placing import IN_MESH, IN_WORLD, PRIMITIVES, Extent, Placed
from warp_bounding.queries import QUERIES
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.launch import BlockLaunch
from warp_bounding.shapes import Mesh

# --- Meshes -----------------------------------------------------------------------------------------------------------
#
# The triangles of a model's meshes as Newton's pass reads them: on the device, by ``shape_source_ptr``.
#
# ``shape_source`` holds objects of the host, whose points may have been changed, or which may have been replaced, since
# the model was finalised. What the cull says of a mesh must be true of the one that is asked.


@wp.kernel(enable_backward=False)
def _measure(
    # inputs
    mesh: wp.uint64,
    # outputs
    sizes: wp.array(dtype=int),
):
    m = wp.mesh_get(mesh)
    sizes[0] = m.points.shape[0]
    sizes[1] = m.indices.shape[0]


@wp.kernel(enable_backward=False)
def _copy(
    # inputs
    mesh: wp.uint64,
    # outputs
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
):
    i = wp.tid()
    m = wp.mesh_get(mesh)
    if i < points.shape[0]:
        points[i] = m.points[i]
    if i < indices.shape[0]:
        indices[i] = m.indices[i]


def triangles(mesh: int, device: wp.Device) -> tuple[np.ndarray, np.ndarray]:
    """Points ``(P, 3)`` float32 and corners ``(T, 3)`` int32 of a ``wp.Mesh`` by its id; waits for the device."""
    sizes = wp.zeros(2, dtype=int, device=device)
    wp.launch(_measure, dim=1, inputs=[wp.uint64(mesh)], outputs=[sizes], device=device)
    count, corners = (int(n) for n in sizes.numpy())
    points, indices = wp.empty(count, dtype=wp.vec3, device=device), wp.empty(corners, dtype=int, device=device)
    wp.launch(_copy, dim=max(count, corners), inputs=[wp.uint64(mesh)], outputs=[points, indices], device=device)
    return points.numpy(), indices.numpy().reshape(-1, 3)


# --- Which bounders are accepted --------------------------------------------------------------------------------------
#
# Which bounders the cull takes: proven, of the shape's own mesh, dilated as far as Newton's pass looks and float32 may
# err.

MESHES = (int(newton.GeoType.MESH), int(newton.GeoType.CONVEX_MESH))
CLOSED = 1  # Newton's bit of a mesh whose inside it tells by crossings of its faces, not by normals


def margin_for(mesh: newton.Mesh, reach: float, *, world: float, scale: float = 1.0) -> float:
    """The ``margin`` to fit a bounder with, so that ``Cull`` takes it.

    Args:
        mesh: The shape's mesh.
        reach: Largest particle radius + shape margin + the pipeline's soft contact gap, world units, not divided by the
            scale.
        world: Largest coordinate of particles and shapes, world units; pairs farther out are not cut.
        scale: The smallest scale that the mesh is used with.

    Returns:
        The margin, in the mesh's own units.

    Raises:
        BounderError: For a negative reach or world, or a scale of 0.
    """
    return _margin_for(float(np.abs(np.asarray(mesh.vertices)).max()), reach, world, scale)


def _margin_for(coordinates: float, reach: float, world: float, scale: float) -> float:
    """``margin_for`` of a mesh with this largest coordinate."""
    scale = abs(float(scale))
    if not (reach >= 0 and world >= 0 and scale > 0):
        got = f"{reach:g}, {world:g} and {scale:g}"
        raise BounderError(f"reach and world must be at least 0 and scale not 0, got {got}")
    # In the mesh's units: gap + (margin + radius) / scale is at most reach / scale, and for scales above 1 at most
    # reach.
    way = reach / min(scale, 1.0)
    # The most that ``query_hulls`` compares with the margin (``placing.Extent``): how far the pass looks, and what
    # float32 does in the mesh and in the world. There |x| + |y| + |z| counts, at most 3 world for the particle and,
    # turned back into the mesh's axes, as much for the shape's place. 1e-6 is more than ``_SUM_ROUNDING``, 8 units of
    # 2^-24, and the rounding of the margin to float32.
    in_mesh = IN_MESH * UNIT32 * (coordinates + way)
    in_world = IN_WORLD * UNIT32 * 6.0 * world / scale
    return (way + in_mesh + in_world) * (1 + 1e-6)


def check_index(model: newton.Model, shape: object) -> None:
    """Raise ``BounderError`` for what is no index of a shape."""
    whole = isinstance(shape, (int, np.integer)) and not isinstance(shape, bool)
    if not whole or not 0 <= shape < model.shape_count:
        raise BounderError(f"shape must be a whole number from 0 to {model.shape_count - 1}, got {shape!r}")


def check_proven(model: newton.Model, shape: int, bounder: Bounder, unproven: bool) -> None:
    """Raise ``BounderError`` for a bounder of another device, or one without a proof."""
    if str(bounder.device) != str(model.device):
        raise BounderError(f"shape {shape}: expected a bounder on {model.device}, got one on {bounder.device}")
    if not unproven and not (bounder.certificate and bounder.certificate.proven):
        raise BounderError(f"shape {shape}: expected a proven bounder, got {bounder!r}")


def check_bounder(
    pipeline: newton.CollisionPipeline,
    shape: int,
    bounder: Bounder,
    unproven: bool,
    mesh_of: Callable[[int], tuple[np.ndarray, np.ndarray]],
) -> None:
    """Refuse, with ``BounderError``, a bounder that is not one of a shape's mesh, as it is on the device.

    One of points needs margin enough for the pipeline's contact gap. ``unproven`` takes one without a proof, or with
    too small a margin, too; ``mesh_of`` reads points and triangles of a shape.
    """
    model = pipeline.model
    check_index(model, shape)
    if not isinstance(bounder, Bounder):
        raise BounderError(f"shape {shape}: expected a bounder, got {type(bounder).__name__}")
    if int(model.shape_type.numpy()[shape]) not in MESHES:
        raise BounderError(f"shape {shape}: expected a mesh, bounders of other shapes save nothing")
    of_distances = bounder.of_distances
    of_points = not of_distances and not QUERIES[bounder.query_kind].is_region
    if not (of_distances or of_points) or bounder.ndim != 3 or bounder.domain.time or bounder.domain.unbounded:
        got = f"{bounder.ndim}D {bounder.query_kind}s"
        raise BounderError(f"shape {shape}: expected a bounder of 3D points or distances, got one of {got}")
    bounder.expect_local("a cull")
    check_proven(model, shape, bounder, unproven)
    if unproven:
        return
    made_for, resolution, margin = (bounder.info.get(key) for key in ("indicator", "resolution", "margin"))
    vertices, indices = mesh_of(shape)
    given = vertices.tobytes(), indices.tobytes()
    if made_for is None or margin is None or _digest(*given, resolution, margin) != made_for:
        raise BounderError(f"shape {shape}: the bounder was made for another mesh, {bounder.info.get('name')}")
    if of_distances:
        return
    scale = float(np.abs(model.shape_scale.numpy()[shape]).min())
    radius = float(np.abs(model.particle_radius.numpy()).max(initial=0.0))
    reach = radius + abs(float(model.shape_margin.numpy()[shape])) + abs(contact_gap(pipeline))
    # World 0: what the coordinates in the world add is weighed pair by pair (``placing.Extent.per_coordinate``), and
    # where it is too much the pair stays.
    needed = _margin_for(float(np.abs(vertices).max()), reach, world=0.0, scale=scale)
    if not margin >= needed:
        raise BounderError(f"shape {shape}: expected a bounder with a margin of {needed:.6g} or more, got {margin:.6g}")


def contact_gap(pipeline: newton.CollisionPipeline) -> float:
    """The soft contact gap; before Newton 1.8 it was called a margin."""
    return float(pipeline.soft_contact_gap if hasattr(pipeline, "soft_contact_gap") else pipeline.soft_contact_margin)


@lru_cache(maxsize=64)
def _digest(vertices: bytes, indices: bytes, resolution: int | None, margin: float) -> str:
    """Digest of what a bounder of a mesh is made for: its cells, or without a resolution the dilated mesh itself."""
    vertices, faces = np.frombuffer(vertices, np.float32), np.frombuffer(indices, np.int32)
    mesh = Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), margin=margin)
    return mesh.digest if resolution is None else mesh.to_grid(resolution=resolution).digest


# --- Shapes -----------------------------------------------------------------------------------------------------------


class Shapes:
    """The shapes of a model, as ``place_shapes`` and the bounders' kernels read them.

    Attributes:
        bounders: Each once.
        roles: ``(S,)`` int, as in ``placing``.
        bounder_of: ``(S,)`` int32, which of the bounders; -1 for none.
        placed: ``(S,)`` ``Placed``, as the last pass has found them.
        hulls: ``(S,)`` ``Extent``, likewise.
    """

    def __init__(
        self,
        pipeline: newton.CollisionPipeline,
        bounders: Mapping[int, Bounder],
        unproven: bool,
        untested: Collection[int],
        surfaces: bool = False,
    ):
        """Check the bounders, and warn once of shapes that have no test; ``BounderError`` as in ``Cull``.

        For passes over whole ``surfaces`` hulls are farther, and meshes are tested only if their faces enclose them.
        """
        self._model = model = pipeline.model
        self._surfaces = surfaces
        count = model.shape_count
        for shape in untested:
            check_index(model, shape)
        if both := sorted(set(untested) & set(bounders)):
            raise BounderError(f"shape {both[0]}: it is both in bounders and in untested")
        self.bounders = list({id(bounder): bounder for bounder in bounders.values()}.values())
        self.roles, self._sizes = np.full(count, placing.UNTESTED, np.int32), np.zeros(count, np.float32)
        self._margins, self._grows = np.full(count, -np.inf, np.float32), np.zeros(count, np.float32)
        self._domains, numbers = np.zeros((count, 2, 3), np.float32), np.full(count, -1, np.int32)
        kinds, unknown = model.shape_type.numpy().tolist() if count else [], Counter()
        collides = model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_PARTICLES) if count else []
        self._ids = np.zeros(count, np.uint64) if not count else model.shape_source_ptr.numpy().astype(np.uint64)
        known: dict[int, tuple[np.ndarray, np.ndarray]] = {}

        def mesh_of(shape: int) -> tuple[np.ndarray, np.ndarray]:
            mesh = int(self._ids[shape])
            if mesh not in known:
                known[mesh] = triangles(mesh, model.device)
            return known[mesh]

        self.mesh_of = mesh_of
        for shape, bounder in bounders.items():
            check_bounder(pipeline, shape, bounder, unproven, mesh_of)
            if not (unproven or self._encloses(shape)):
                raise BounderError(f"shape {shape}: an edge has not two faces, so Newton tells the inside by normals")
            self._bound(shape, bounder, unproven, mesh_of(shape)[0])
            numbers[shape] = next(n for n, other in enumerate(self.bounders) if other is bounder)
        for shape, kind in enumerate(kinds):
            if shape in bounders or shape in untested:
                continue
            points = mesh_of(shape)[0] if kind in MESHES and self._ids[shape] else np.empty(0)
            if kind in PRIMITIVES:
                self.roles[shape] = placing.PRIMITIVE
            elif points.size and np.isfinite(points).all() and self._encloses(shape):
                self._enclose(shape, points)
                self.roles[shape], self._margins[shape], self._grows[shape] = placing.HULL, np.inf, 1.0
            elif collides[shape]:
                unknown[newton.GeoType(kind).name.lower()] += 1
        if unknown:
            reported = ", ".join(f"{name} ({number})" for name, number in sorted(unknown.items()))
            told = f"shapes that keep all their pairs, having no test: {reported}"
            warn(told)
        self.placed = wp.empty(count, dtype=Placed, device=model.device)
        self.hulls = wp.empty(count, dtype=Extent, device=model.device)
        on_device = [(self.roles, wp.int32), (self._ids, wp.uint64), (self._domains, wp.vec3)]
        on_device += [(values, wp.float32) for values in (self._margins, self._grows, self._sizes)]
        self._own = [wp.array(values, dtype=dtype, device=model.device) for values, dtype in on_device]
        self.bounder_of = wp.array(numbers, dtype=wp.int32, device=model.device)

    def read(self, state: newton.State) -> list[wp.array | None]:
        """The arrays of a state and of the model that ``place_shapes`` reads, as they are now."""
        m = self._model
        places = [state.body_q, m.shape_transform, m.shape_body, m.shape_scale, m.shape_margin]
        return [*places, m.shape_flags, m.shape_type, m.shape_source_ptr]

    def launch(self, state: newton.State, gap: float) -> BlockLaunch:
        """Places and hulls of a state, for this contact gap."""
        inputs = [0, *self.read(state), gap, int(self._surfaces), *self._own]
        outputs = [self.placed, self.hulls]
        count, device = self._model.shape_count, self._model.device
        return BlockLaunch(placing.place_shapes, count, inputs, outputs, device, first_index=0, block=1)

    def _encloses(self, shape: int) -> bool:
        """Whether Newton tells a mesh's inside by crossings of its faces, as the passes over surfaces must.

        By normals it may find an inside far away.
        """
        return not self._surfaces or bool(int(self._model._shape_mesh_properties.numpy()[shape]) & CLOSED)

    @property
    def names(self) -> list[str]:
        """``S`` words, by which pairs are counted: the shape's kind, and for a mesh whether it has a bounder."""
        with_bounder = {placing.BOUNDED: " with a bounder"}
        kinds = self._model.shape_type.numpy().tolist()
        return [
            newton.GeoType(kind).name.lower() + with_bounder.get(int(role), "")
            for kind, role in zip(kinds, self.roles, strict=True)
        ]

    def _enclose(self, shape: int, vertices: np.ndarray) -> None:
        """The middle and half widths of a mesh's box, and its largest coordinate."""
        vertices = vertices.astype(np.float64)
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        self._domains[shape] = (lower + upper) / 2, (upper - lower) / 2
        self._sizes[shape] = np.abs(vertices).max()

    def _bound(self, shape: int, bounder: Bounder, unproven: bool, vertices: np.ndarray) -> None:
        self._enclose(shape, vertices)
        self.roles[shape] = placing.BOUNDED
        if bounder.of_distances:
            # The hull grows by the way, from the mesh itself on; a domain has room around it.
            self._margins[shape], self._grows[shape] = np.inf, 1.0
            return
        self._margins[shape] = np.inf if unproven else bounder.info["margin"]
        lower, upper = bounder.domain.lower, bounder.domain.upper
        self._domains[shape] = (lower + upper) / 2, (upper - lower) / 2
