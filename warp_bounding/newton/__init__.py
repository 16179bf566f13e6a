"""A broad phase for Newton: its contact pass goes only through the particle-shape pairs that may touch.

A ``newton.CollisionPipeline`` tests every particle against every shape, one kernel thread a pair
(``soft_rigid_contact_pairs``). ``ParticleCull`` wraps one: before each pass it asks the bounders of the shapes, and
lets the pipeline go through the pairs that they do not deny, in the order that it had them. Contacts are then the same,
record by record, and so is every step that a solver makes.

Why none is lost. For a mesh the pass asks for the closest point within ``reach = gap + (margin + radius) / scale`` of
the particle, in the mesh's own coordinates, and makes a contact only where there is one. A bounder of points is accepted only if
it is proven for this very mesh, dilated by ``reach`` and by what float32 does on the way (``margin_for``). Where a
particle is so far from the origin that its place relative to the shape is less certain than that, or has a larger
radius, the pair stays. A bounder of distances needs no margin: it is asked whether the mesh is farther than that, so one fit serves every
gap, radius and scale. Shapes may move, turn and be scaled.

What this does not do: rigid contacts, self-contacts of cloth, and the passes over whole edges and faces
(``enable_rigid_soft_full_surface_contact``) are left as they are; so are shapes without a bounder. The number of pairs
is read back once a pass, so a pass cannot be captured in a CUDA graph.
"""

from collections.abc import Mapping
from functools import cache, lru_cache

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorMesh
from warp_bounding.newton import kernels
from warp_bounding.newton.distances import BLOCKS, ask_distances_in_lanes
from warp_bounding.newton.hulls import ask_hulls, runs_of
from warp_bounding.queries import QUERIES
from warp_bounding.runtime.compaction import Compaction
from warp_bounding.runtime.launch import launch_blocks

try:
    import newton
except ImportError as error:
    raise ImportError(
        "warp_bounding.newton needs Newton: pip install 'warp-bounding[newton]'", name="newton"
    ) from error

__all__ = ["ParticleCull", "margin_for"]

MESHES = (int(newton.GeoType.MESH), int(newton.GeoType.CONVEX_MESH))


def margin_for(mesh: newton.Mesh, reach: float, *, world: float, scale: float = 1.0) -> float:
    """The ``margin`` to fit a bounder with, so that ``ParticleCull`` takes it.

    Args:
        mesh: The shape's mesh.
        reach: Largest particle radius + shape margin + the pipeline's soft contact gap, world units; not divided by the
            scale, unlike the ``reach`` above.
        scale: The smallest scale that the mesh is used with.
        world: Largest coordinate of particles and shapes, world units; pairs farther out are not cut.

    Returns:
        The margin, in the mesh's own units.

    Raises:
        BounderError: For a negative reach or world, or a scale of 0.
    """
    scale = abs(float(scale))
    if not (reach >= 0 and world >= 0 and scale > 0):
        raise BounderError(
            f"reach and world must be at least 0 and scale not 0, got {reach:g}, {world:g} and {scale:g}"
        )
    coordinates = float(np.abs(np.asarray(mesh.vertices)).max())
    # In the mesh's units: gap + (margin + radius) / scale is at most reach / scale, and for scales above 1 at most
    # reach.
    way = reach / min(scale, 1.0)
    # The most that ``ask_hulls`` compares with the margin (``kernels.Hull``): how far the pass looks, and what float32
    # does in the mesh and in the world. There |x| + |y| + |z| counts, at most 3 world for the particle and, turned back
    # into the mesh's axes, as much for the shape's place. 1e-6 is more than ``_SUM_ROUNDING``, 8 units of 2^-24, and
    # the rounding of the margin to float32.
    in_mesh = kernels.IN_MESH * UNIT32 * (coordinates + way)
    in_world = kernels.IN_WORLD * UNIT32 * 6.0 * world / scale
    return (way + in_mesh + in_world) * (1 + 1e-6)


class ParticleCull:
    """A collision pipeline whose particle-shape pass skips the pairs that bounders deny.

    Attributes:
        pipeline: The pipeline; ``pipeline.collide`` by itself goes through all pairs again.
        pairs: Number of all pairs.
        survivors: Number of pairs that the last pass went through.
    """

    def __init__(
        self,
        pipeline: newton.CollisionPipeline,
        bounders: Mapping[int, Bounder | DistanceBounder],
        *,
        unproven: bool = False,
    ):
        """Check that the bounders are those of the shapes.

        Args:
            pipeline: Its class is replaced by a subclass of it, in which the number of pairs is the length of their
                list.
            bounders: Per index of a shape a bounder of its mesh, in the mesh's own coordinates, 3D: of distances, or of points, with a
                margin of ``margin_for`` at least. One bounder may serve many shapes. Shapes without one keep all their
                pairs.
            unproven: Take bounders without a proof, and with too small a margin, too; contacts may then be missed.

        Raises:
            BounderError: For a bounder that is not of this mesh or has too small a margin, with both numbers, or no
                proof; for a shape that is no mesh; for a differentiable pipeline, or what is no pipeline at all.
        """
        if not isinstance(pipeline, newton.CollisionPipeline):
            raise BounderError(f"pipeline must be a newton.CollisionPipeline, got {type(pipeline).__name__}")
        if not isinstance(bounders, Mapping):
            got = type(bounders).__name__
            raise BounderError(f"bounders must be a mapping from indices of shapes to bounders, got {got}")
        self.pipeline, self.model = pipeline, pipeline.model
        if getattr(pipeline, "requires_grad", False):
            raise BounderError("a differentiable pipeline reads its pairs again when it goes backwards; they must stay")
        self._all = pipeline.soft_rigid_contact_pairs.contiguous()
        self.pairs = self.survivors = len(self._all)
        shape_count = self.model.shape_count
        margins, largest = np.full(shape_count, -np.inf, np.float32), np.zeros(shape_count, np.float32)
        domains, bounder_of = np.zeros((shape_count, 2, 3), np.float32), np.full(shape_count, -1, np.int32)
        grows = np.zeros(shape_count, np.float32)
        self._bounders = list({id(bounder): bounder for bounder in bounders.values()}.values())
        for shape, bounder in bounders.items():
            largest[shape] = self._check(shape, bounder, unproven)
            of_distances = isinstance(bounder, DistanceBounder)
            grows[shape] = of_distances
            margins[shape] = np.inf if unproven or of_distances else bounder.info["margin"]
            lower, upper = bounder.domain.lower, bounder.domain.upper
            if of_distances:  # the hull grows by the way, from the mesh itself on; a domain has room around it
                vertices = np.asarray(self.model.shape_source[shape].vertices, np.float64)
                lower, upper = vertices.min(axis=0), vertices.max(axis=0)
            domains[shape] = (lower + upper) / 2, (upper - lower) / 2
            bounder_of[shape] = next(n for n, other in enumerate(self._bounders) if other is bounder)
        # For each shape: the index of its bounder (-1 for none), the bounder's margin, whether it bounds distances, the mesh's largest
        # coordinate, the middle and half widths of the bounder's domain (of distances: of the mesh); and what ``place_shapes`` makes of them in each pass.
        self._bounder_of = wp.array(bounder_of, dtype=wp.int32, device=self._device)
        self._margins = wp.array(margins, dtype=wp.float32, device=self._device)
        self._grows = wp.array(grows, dtype=wp.float32, device=self._device)
        self._largest = wp.array(largest, dtype=wp.float32, device=self._device)
        self._domains = wp.array(domains, dtype=wp.vec3, device=self._device)
        self._placed = wp.empty(shape_count, dtype=kernels.Placed, device=self._device)
        self._hulls = wp.empty(shape_count, dtype=kernels.Hull, device=self._device)
        # The particles, row by row (``split_particles``), and which pairs follow each other, so that they are looked at together.
        self._rows = wp.empty(4 * self.model.particle_count, dtype=wp.float32, device=self._device)
        self._runs = wp.array(runs_of(self._all.numpy()), dtype=wp.uint8, device=self._device)
        # The pairs that the hulls leave to the bounders: their indices block by block, and how many each block has.
        blocks = -(-self.pairs // kernels.block_size(self._device))
        self._undecided = wp.empty(self.pairs, dtype=wp.int32, device=self._device)
        self._undecided_count = wp.empty(blocks, dtype=wp.int32, device=self._device)
        # The pairs that survive: which, compacted, and themselves; they hold for this contact gap.
        self._candidates_gap = _gap(pipeline)
        self._keep = wp.full(self.pairs, 1, dtype=wp.uint8, device=self._device)
        self._survivors = Compaction(self._keep)
        self._kept = wp.empty(self.pairs, dtype=wp.vec2i, device=self._device)
        pipeline.__class__ = _counting(type(pipeline))

    @property
    def _device(self) -> wp.Device:
        return self.model.device

    def collide(
        self, state: newton.State, contacts: newton.Contacts, *, candidates: wp.array | None = None, **options
    ) -> None:
        """``pipeline.collide``, with the pairs that may touch.

        Args:
            state: Places of particles and bodies.
            contacts: Written to: what ``pipeline.collide`` would have made of it.
            candidates: What ``candidates`` has returned for this very state; asked for if ``None``.
            options: The other options of ``pipeline.collide``.

        Raises:
            BounderError: If the candidates were asked for with another contact gap.
        """
        gap = options.get("soft_contact_margin")
        gap = _gap(self.pipeline) if gap is None else float(gap)
        if candidates is not None and gap != self._candidates_gap:
            raise BounderError(
                f"expected candidates for a contact gap of {gap:g}, got ones for {self._candidates_gap:g}"
            )
        kept = self.candidates(state, gap) if candidates is None else candidates
        self.survivors = len(kept)
        self.pipeline.soft_rigid_contact_pairs = kept
        try:
            self.pipeline.collide(state, contacts, **options)
        finally:
            self.pipeline.soft_rigid_contact_pairs = self._all

    def candidates(self, state: newton.State, gap: float | None = None) -> wp.array:
        """The pairs that may touch.

        Args:
            state: Places of particles and bodies.
            gap: Soft contact gap of this pass; the pipeline's if ``None``.

        Returns:
            ``(K,)`` ``vec2i``, particle and shape, in the pipeline's order; valid until the next call.
        """
        model, device = self.model, self._device
        self._candidates_gap = gap = _gap(self.pipeline) if gap is None else float(gap)
        if not self._bounders or not self.pairs or not state.particle_q:
            return self._all
        shapes = [model.shape_transform, model.shape_body, model.shape_scale, model.shape_margin]
        inputs = [state.body_q, *shapes, self._domains, self._margins, self._grows, self._largest, gap]
        outputs = [self._placed, self._hulls]
        wp.launch(kernels.place_shapes, dim=model.shape_count, inputs=inputs, outputs=outputs, device=device)
        block, count = kernels.block_size(device), model.particle_count
        inputs = [0, state.particle_q, model.particle_radius, count]
        launch_blocks(kernels.split_particles, count, inputs, [self._rows], device, first_index=0, block=1)
        inputs = [self._all, self.pairs, block, 0, self._runs, self._rows, self._hulls]
        found = [self._undecided, self._undecided_count]
        launch_blocks(ask_hulls, self.pairs, inputs, [*found, self._keep], device, first_index=3, block=block)
        for number, bounder in enumerate(self._bounders):
            self._ask(number, bounder, state)
        indices, total = self._survivors.launch()
        count = int(total.numpy()[0])
        wp.launch(kernels.gather_pairs, dim=count, inputs=[self._all, indices], outputs=[self._kept], device=device)
        return self._kept[:count]

    def _ask(self, number: int, bounder: Bounder | DistanceBounder, state: newton.State) -> None:
        """Ask a bounder about the pairs of its shapes that the hulls have left."""
        model, device, block = self.model, self._device, kernels.block_size(self._device)
        found, where = [self._undecided, self._undecided_count], [self._placed, self._hulls]
        if not isinstance(bounder, DistanceBounder):
            inputs = [0, block, bounder.data, number, self._bounder_of, self._all, state.particle_q, self._placed]
            kernel, items, first, share = kernels.ask_bounders(bounder.source), self.pairs, 0, block
        elif device.is_cpu:
            data, dilated = bounder.data, bounder.info.get("margin") or 0.0
            items, first, share = len(self._undecided_count), 3, BLOCKS
            inputs = [data.parameters, items, block, 0, data.words, number, dilated, self._bounder_of]
            inputs += [self._all, self._rows, *where]
            kernel = ask_distances_in_lanes(bounder.source)
        else:
            inputs = [0, block, bounder.data, number, bounder.info.get("margin") or 0.0, self._bounder_of, self._all]
            inputs += [state.particle_q, model.particle_radius, *where]
            kernel, items, first, share = kernels.ask_distances(bounder.source), self.pairs, 0, block
        launch_blocks(kernel, items, [*inputs, *found], [self._keep], device, first_index=first, block=share)

    def _check(self, shape: int, bounder: Bounder | DistanceBounder, unproven: bool) -> float:
        """Largest coordinate of a shape's mesh; refuse a bounder that is not one of it."""
        whole = isinstance(shape, (int, np.integer)) and not isinstance(shape, bool)
        if not whole or not 0 <= shape < self.model.shape_count:
            raise BounderError(f"shape must be a whole number from 0 to {self.model.shape_count - 1}, got {shape!r}")
        if not isinstance(bounder, (Bounder, DistanceBounder)):
            raise BounderError(f"shape {shape}: expected a bounder, got {type(bounder).__name__}")
        if int(self.model.shape_type.numpy()[shape]) not in MESHES:
            raise BounderError(f"shape {shape}: expected a mesh, bounders of other shapes save nothing")
        of_distances = isinstance(bounder, DistanceBounder)
        of_points = not of_distances and not QUERIES[bounder.query_kind].is_region
        if not (of_distances or of_points) or bounder.ndim != 3 or bounder.domain.time or bounder.domain.unbounded:
            got = f"{bounder.ndim}D {bounder.query_kind}s"
            raise BounderError(f"shape {shape}: expected a bounder of 3D points or distances, got one of {got}")
        if str(bounder.device) != str(self._device):
            raise BounderError(f"shape {shape}: expected a bounder on {self._device}, got one on {bounder.device}")
        mesh = self.model.shape_source[shape]
        size = float(np.abs(np.asarray(mesh.vertices)).max())
        if unproven:
            return size
        if bounder.certificate is None or not bounder.certificate.proven:
            raise BounderError(f"shape {shape}: expected a proven bounder, got {bounder!r}")
        made_for, resolution, margin = (bounder.info.get(key) for key in ("indicator", "resolution", "margin"))
        if made_for is None or margin is None or _digest(mesh, resolution, margin) != made_for:
            raise BounderError(f"shape {shape}: the bounder was made for another mesh, {bounder.info.get('name')}")
        if of_distances:
            return size
        scale = float(np.abs(self.model.shape_scale.numpy()[shape]).min())
        radius = float(self.model.particle_radius.numpy().max(initial=0.0))
        reach = radius + float(self.model.shape_margin.numpy()[shape]) + _gap(self.pipeline)
        # World 0: what the coordinates in the world add is weighed pair by pair (``kernels.Hull.per_coordinate``), and
        # where it is too much the pair stays.
        needed, given = margin_for(mesh, reach, world=0.0, scale=scale), bounder.info["margin"]
        if not given >= needed:
            raise BounderError(
                f"shape {shape}: expected a bounder with a margin of {needed:.6g} at least, got {given:.6g}"
            )
        return size


def _gap(pipeline: newton.CollisionPipeline) -> float:
    """The soft contact gap; before Newton 1.8 it was called a margin."""
    return float(pipeline.soft_contact_gap if hasattr(pipeline, "soft_contact_gap") else pipeline.soft_contact_margin)


def _digest(mesh: newton.Mesh, resolution: int | None, margin: float) -> str:
    """Digest of what a bounder of a mesh is made for: its cells, or without a resolution the mesh itself."""
    vertices, indices = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.indices, np.int32)
    return _digest_of(vertices.tobytes(), indices.tobytes(), resolution, margin)


@lru_cache(maxsize=64)
def _digest_of(vertices: bytes, indices: bytes, resolution: int | None, margin: float) -> str:
    vertices, faces = np.frombuffer(vertices, np.float32), np.frombuffer(indices, np.int32)
    indicator = IndicatorMesh(vertices.reshape(-1, 3), faces.reshape(-1, 3))
    return indicator.digest if resolution is None else indicator.to_grid(resolution=resolution, margin=margin).digest


@cache
def _counting(kind: type) -> type:
    """The subclass of a pipeline's class whose number of particle-shape pairs is the length of their list."""
    if hasattr(kind, "_counts"):
        return kind
    count = property(lambda self: len(self.soft_rigid_contact_pairs))
    both = dict.fromkeys(("soft_contact_pair_count", "soft_rigid_contact_pair_count"), count)
    return type(kind.__name__, (kind,), {**both, "_counts": True})
