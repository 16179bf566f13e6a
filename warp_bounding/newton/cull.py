"""A collision pipeline of Newton's that goes only through the particle-shape pairs that may touch.

A ``newton.CollisionPipeline`` tests every particle against every shape, one kernel thread a pair
(``soft_rigid_contact_pairs``). ``ParticleCull`` wraps one: before each pass it looks which pairs cannot touch, and
lets the pipeline go through the others, in the order that it had them. Contacts are then the same,
record by record, and so is every step that a solver makes.

A shape is a plane or another primitive, which has a test in closed form (``placing``); a mesh, of which at least the
box is tested; or a mesh with a bounder, which is asked about what its box leaves. Height fields and whatever else
keep all their pairs.

Why none is lost. For a mesh the pass asks for the closest point within ``reach = gap + (margin + radius) / scale`` of
the particle, in the mesh's own coordinates, and makes a contact only where there is one. A bounder of points is
accepted only if it is proven for this very mesh, dilated by ``reach`` and by what float32 does on the way
(``margin_for``). Where a particle is so far from the origin that its place relative to the shape is less certain than
that, or has a larger radius, the pair stays. A bounder of distances needs no margin: it is asked whether the mesh is
farther than that, so one fit serves every gap, radius and scale. Shapes may move, turn and be scaled.

In a captured graph nothing can be read back, so the pass goes through as many pairs as there are: those that are left,
and again and again one that was denied, at which the pass ends at once, or at least without a contact. It stands behind
them, or on a GPU between them (``lists``). There the cull runs beside the pipeline's rigid contacts, on a stream of its
own, and the particle-shape pass waits for both.

What this does not do: rigid contacts, self-contacts of cloth, and the passes over whole edges and faces
(``enable_rigid_soft_full_surface_contact``) are left as they are. A mesh whose points are moved in place has no true
box: it must be ``untested``.
"""

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache, partial

import newton
import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder
from warp_bounding.errors import BounderError, BoundingWarning
from warp_bounding.newton import kernels, lists
from warp_bounding.newton.kernels import BLOCKS, CPU_BLOCK, query_distances_in_lanes, query_hulls, runs_of
from warp_bounding.newton.placing import Hull, Placed, place_shapes
from warp_bounding.newton.shapes import Shapes, contact_gap
from warp_bounding.runtime.arrays import Compaction
from warp_bounding.runtime.launch import BlockLaunch, ready


@dataclass(frozen=True)
class Tally:
    """Pairs of one kind of shape.

    Attributes:
        pairs: All of them.
        culled: Those that the pass did not go through.
    """

    pairs: int
    culled: int

    def __str__(self) -> str:
        """Both, and the share."""
        share = 100.0 * self.culled / self.pairs if self.pairs else 0.0
        return f"{self.culled:,} of {self.pairs:,} ({share:.1f} %)"


MOST_RECORDED = 8  # sets of arrays whose launches are kept
# Of a GPU: warps of Newton's pass that run on a multiprocessor at a time, among which survivors are shared out; pairs
# from which on they are sorted by place; and whether the cull of a graph has a stream of its own.
WARPS, SORTED, BESIDE = 16, 100_000, True
THREADS = 2048  # of a multiprocessor at a time


class ParticleCull:
    """A collision pipeline whose particle-shape pass skips the pairs that cannot touch.

    Attributes:
        pipeline: The pipeline; ``pipeline.collide`` by itself goes through all pairs again.
        pairs: Number of all pairs.
        survivor_count: ``(1,)`` int32 on the model's device, the number of pairs that the last pass had to go through.
    """

    def __init__(
        self,
        pipeline: newton.CollisionPipeline,
        bounders: Mapping[int, Bounder] | None = None,
        *,
        unproven: bool = False,
        untested: Collection[int] = (),
        reads_back: bool = True,
    ):
        """Check that the bounders are those of the shapes, and load all kernels, so that a graph can be captured.

        Args:
            pipeline: Its class is replaced by a subclass of it, in which the number of pairs is the length of their
                list.
            bounders: Per index of a shape a bounder of its mesh, in the mesh's own coordinates, 3D: of distances, or of
                points, with a margin of ``margin_for`` at least. One bounder may serve many shapes. Of shapes without
                one the closed form is tested, or the mesh's box.
            unproven: Take bounders without a proof, and with too small a margin, too; contacts may then be missed.
            untested: Indices of shapes that keep all their pairs.
            reads_back: Let the host read how many pairs are left, once a pass, so that Newton launches no more threads.
                Without, and always while the device captures a graph, Newton launches one for each pair, and nothing is
                read.

        Raises:
            BounderError: For a bounder that is not of this mesh or has too small a margin, with both numbers, or no
                proof; for a shape that is no mesh; for a differentiable pipeline, or what is no pipeline at all.

        Warns:
            BoundingWarning: Once, of shapes that have no test, and of a pipeline with full-surface soft contacts.
        """
        if not isinstance(pipeline, newton.CollisionPipeline):
            raise BounderError(f"pipeline must be a newton.CollisionPipeline, got {type(pipeline).__name__}")
        bounders = {} if bounders is None else bounders
        if not isinstance(bounders, Mapping):
            got = type(bounders).__name__
            raise BounderError(f"bounders must be a mapping from indices of shapes to bounders, got {got}")
        self.pipeline, self.model = pipeline, pipeline.model
        if getattr(pipeline, "requires_grad", False):
            raise BounderError("a differentiable pipeline reads its pairs again when it goes backwards; they must stay")
        if getattr(pipeline, "enable_rigid_soft_full_surface_contact", False):
            reported = "only particle-shape pairs are culled; full-surface soft contacts test every edge and face"
            warnings.warn(reported, BoundingWarning, stacklevel=2)
        self._reads_back = reads_back
        self._all = pipeline.soft_rigid_contact_pairs.contiguous()
        self.pairs = len(self._all)
        self._shapes = Shapes(pipeline, bounders, unproven, untested)
        self._device = device = self.model.device
        shape_count = self.model.shape_count
        self._placed = wp.empty(shape_count, dtype=Placed, device=device)
        self._hulls = wp.empty(shape_count, dtype=Hull, device=device)
        # The pairs that survive: which, and themselves; they hold for this contact gap.
        self._candidates_gap = contact_gap(pipeline)
        self._keep = wp.full(self.pairs, 1, dtype=wp.uint8, device=device)
        self._kept = wp.empty(self.pairs, dtype=wp.vec2i, device=device)
        # The pairs that the hulls leave to the bounders.
        self._undecided = wp.empty(self.pairs, dtype=wp.int32, device=device)
        self._in_lists = _in_lists(device)
        if self._in_lists:
            self._listed = wp.empty(self.pairs, dtype=wp.vec2i, device=device)
            self._counts = wp.zeros(4, dtype=wp.int32, device=device)  # see ``lists``
            self.survivor_count = self._counts[:1]
            if self.pairs >= SORTED:
                self._ordered = wp.empty(self.pairs, dtype=wp.vec2i, device=device)
                self._cells = wp.empty(self.pairs, dtype=wp.vec2i, device=device)
                self._sizes, self._ends = (wp.zeros(lists.CELLS, dtype=wp.int32, device=device) for _ in range(2))
            self._threads = max(1, min(self.pairs, THREADS * max(device.sm_count, 1)))  # that share a list
            self._stream = wp.Stream(device) if device.is_cuda else None
        else:
            # The particles, row by row (``split_particles``), and which pairs follow each other, so that they are
            # looked at together; how many undecided pairs each block has.
            self._rows = wp.empty(4 * self.model.particle_count, dtype=wp.float32, device=device)
            self._runs = wp.array(runs_of(self._all.numpy()), dtype=wp.uint8, device=device)
            self._undecided_count = wp.empty(-(-self.pairs // CPU_BLOCK), dtype=wp.int32, device=device)
            self._survivors = Compaction(self._keep)
            self.survivor_count = self._survivors.count
            inputs = [self._all, self._survivors.indices, self._survivors.count]
            gather = partial(wp.launch, kernels.gather_or_repeat, self.pairs, inputs, [self._kept], device=device)
            self._gather = gather(record_cmd=True) if self.pairs else None
        self.survivor_count.fill_(self.pairs)
        # What is made when it is first needed is made now: a graph would hold the copy of a bounder's numbers to the
        # device, from memory that is not kept.
        for kernel in self._kernels():
            ready(kernel, device)
        self._data = [bounder.data for bounder in self._shapes.bounders]
        self._recorded: dict[tuple, list[BlockLaunch]] = {}  # by the arrays that they read, oldest first
        pipeline.__class__ = _counting(type(pipeline))

    @property
    def survivors(self) -> int:
        """Number of pairs of the last pass, which may be that of a graph; waits for the device."""
        return int(self.survivor_count.numpy()[0])

    @property
    def culled(self) -> int:
        """Number of pairs that the last pass skipped; waits for the device."""
        return self.pairs - self.survivors

    def tally(self) -> dict[str, Tally]:
        """What the last pass skipped, by kind of shape; waits for the device.

        Returns:
            One tally for each kind of shape, under its name, as ``"plane"`` or ``"mesh with a bounder"``.
        """
        shapes, names = self._all.numpy().reshape(-1, 2)[:, 1], self._shapes.names
        pairs = np.bincount(shapes, minlength=len(names))
        culled = np.bincount(shapes[self._keep.numpy() == 0], minlength=len(names))
        order = {name: [s for s, own in enumerate(names) if own == name] for name in names}
        return {name: Tally(int(pairs[own].sum()), int(culled[own].sum())) for name, own in order.items()}

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
        gap = contact_gap(self.pipeline) if gap is None else float(gap)
        if candidates is not None and gap != self._candidates_gap:
            raise BounderError(f"expected candidates for contact gap {gap:g}, got ones for {self._candidates_gap:g}")
        if candidates is None:
            candidates = self._candidates_beside(state, gap)
        self.pipeline.soft_rigid_contact_pairs = candidates
        try:
            self.pipeline.collide(state, contacts, **options)
        finally:
            _wait_for_pairs(self.pipeline)  # where the pass had nothing to do
            self.pipeline.soft_rigid_contact_pairs = self._all

    def _candidates_beside(self, state: newton.State, gap: float) -> wp.array:
        """``candidates``, on a stream of its own where nothing is read back; ``_wait_for_pairs`` waits for it."""
        device = self._device
        if not (BESIDE and device.is_cuda and (device.is_capturing or not self._reads_back)):
            return self.candidates(state, gap)
        stream, own = device.stream, self._stream
        own.wait_stream(stream)
        self.pipeline.__dict__["_wait"] = partial(stream.wait_stream, own)
        with wp.ScopedStream(own, sync_enter=False):
            return self.candidates(state, gap)

    def candidates(self, state: newton.State, gap: float | None = None) -> wp.array:
        """The pairs that may touch.

        Args:
            state: Places of particles and bodies.
            gap: Soft contact gap of this pass; the pipeline's if ``None``. A graph keeps the one that it was captured
                with.

        Returns:
            ``(K,)`` ``vec2i``, particle and shape; valid until the next call. On a CPU they are in the pipeline's
            order. Where nothing is read back, K is the number of all pairs, and one denied pair stands behind the
            first ``survivor_count``, or on a GPU in all places that are left.
        """
        self._candidates_gap = gap = contact_gap(self.pipeline) if gap is None else float(gap)
        if not self.pairs or not state.particle_q:
            return self._all
        if self._in_lists:
            return self._candidates_in_lists(state, gap)
        if self._device.is_capturing:
            for launch in self._launches(state, gap):
                launch.launch_whole()
            return self._padded()
        for launch in self._prepared(state, gap):
            launch.launch()
        if not self._reads_back:
            return self._padded()
        left = int(self._survivors.launch()[1].numpy()[0])
        if left:
            self._gather.set_dim(left)
            self._gather.launch()
        return self._kept[:left]

    def _prepared(self, state: newton.State, gap: float) -> list[BlockLaunch]:
        """The launches for these arrays, cached, since a simulation queries the same two states again and again."""
        key = (gap, id(state.particle_q), id(self.model.particle_radius))
        key += tuple(map(id, self._shapes.read(state)))
        if key not in self._recorded:
            while len(self._recorded) >= MOST_RECORDED:
                del self._recorded[next(iter(self._recorded))]
            self._recorded[key] = self._launches(state, gap)
        return self._recorded[key]

    def _launches(self, state: newton.State, gap: float) -> list[BlockLaunch]:
        """What fills the mask of the pairs, in this order."""
        model, device = self.model, self._device
        shapes, particles = model.shape_count, model.particle_count
        places = [0, *self._shapes.read(state), gap, *self._shapes.own]
        launch = partial(BlockLaunch, device=device)
        placing = launch(place_shapes, shapes, places, [self._placed, self._hulls], first_index=0, block=1)
        asking = [self._query(number, bounder, state) for number, bounder in enumerate(self._shapes.bounders)]
        if self._in_lists:
            inputs = [0, self._all, state.particle_q, model.particle_radius, self._hulls]
            outputs = [self._keep, self._undecided, self._listed, self._counts]
            return [placing, launch(lists.sift, self.pairs, inputs, outputs, first_index=0, block=1), *asking]
        rows = [0, state.particle_q, model.particle_radius, particles]
        hulls = [self._all, self.pairs, CPU_BLOCK, 0, self._runs, self._rows, self._hulls]
        left = [self._undecided, self._undecided_count, self._keep]
        return [
            placing,
            launch(kernels.split_particles, particles, rows, [self._rows], first_index=0, block=1),
            launch(query_hulls, self.pairs, hulls, left, first_index=3, block=CPU_BLOCK),
            *asking,
        ]

    def _padded(self) -> wp.array:
        """As many pairs as there are: those that are left, and a denied one."""
        device = self._device
        indices, total = self._survivors.launch_recorded() if device.is_capturing else self._survivors.launch()
        inputs = [self._all, indices, total]
        wp.launch(kernels.gather_or_repeat, dim=self.pairs, inputs=inputs, outputs=[self._kept], device=device)
        return self._kept

    def _candidates_in_lists(self, state: newton.State, gap: float) -> wp.array:
        """``candidates`` on a GPU; see ``lists``."""
        device, capturing = self._device, self._device.is_capturing
        self._counts.zero_()
        for launch in self._launches(state, gap) if capturing else self._prepared(state, gap):
            if capturing or device.is_cpu:  # threads of a CPU would count over each other
                launch.launch_whole()
            else:
                launch.launch()
        if self._reads_back and not capturing:
            return self._listed[: int(self.survivor_count.numpy()[0])]
        listed = self._listed if self.pairs < SORTED else self._by_place(state)
        warps = max(1, min(self.pairs // lists.WARP, WARPS * max(device.sm_count, 1)))
        inputs = [self._all, listed, self._counts, warps]
        wp.launch(lists.arrange, dim=self.pairs, inputs=inputs, outputs=[self._kept], device=device)
        return self._kept

    def _by_place(self, state: newton.State) -> wp.array:
        """The listed pairs, sorted by their places."""
        threads, launch = self._threads, partial(wp.launch, dim=self._threads, device=self._device)
        self._sizes.zero_()
        inputs = [threads, self._listed, self._counts, state.particle_q, self._hulls]
        launch(lists.count_cells, inputs=inputs, outputs=[self._cells, self._sizes])
        wp.utils.array_scan(self._sizes, self._ends, inclusive=True)
        inputs = [threads, self._listed, self._counts, self._cells, self._ends, self._sizes]
        launch(lists.sort_by_cells, inputs=inputs, outputs=[self._ordered])
        return self._ordered

    def _asking(self, bounder: Bounder) -> wp.Kernel:
        """The kernel that asks a bounder."""
        if self._in_lists:
            return lists.ask_listed(bounder.source)
        return (query_distances_in_lanes if bounder.of_distances else kernels.query_bounders)(bounder.source)

    def _kernels(self) -> list[wp.Kernel]:
        if self._in_lists:
            own = [lists.sift, lists.arrange, lists.count_cells, lists.sort_by_cells]
        else:
            own = [kernels.split_particles, kernels.gather_or_repeat, query_hulls]
        return [place_shapes, *own, *map(self._asking, self._shapes.bounders)]

    def _query(self, number: int, bounder: Bounder, state: newton.State) -> BlockLaunch:
        """Ask a bounder about the pairs of its shapes that the hulls have left."""
        model, device, data = self.model, self._device, bounder.data
        where, dilated = [self._placed, self._hulls], bounder.info.get("margin") or 0.0
        of = self._shapes.bounder_of
        found, outputs = [self._undecided], [self._keep]
        items, first, share = self.pairs, 0, CPU_BLOCK
        if self._in_lists:
            items, share, outputs = self._threads, 1, [self._keep, self._listed, self._counts]
            inputs = [0, items, data, number, dilated, of, self._all, state.particle_q, model.particle_radius, *where]
        elif not bounder.of_distances:
            inputs = [0, CPU_BLOCK, data, number, of, self._all, state.particle_q, self._placed]
            found += [self._undecided_count]
        else:
            items, first, share = len(self._undecided_count), 3, BLOCKS
            inputs = [data.parameters, items, CPU_BLOCK, 0, data.words, number, dilated, of, self._all, self._rows]
            inputs, found = [*inputs, *where], [*found, self._undecided_count]
        options = {"first_index": first, "block": share}
        return BlockLaunch(self._asking(bounder), items, [*inputs, *found], outputs, device, **options)


def _in_lists(device: wp.Device) -> bool:
    """Whether the kernels of ``lists`` are used, and not those for a CPU."""
    return device.is_cuda


def _wait_for_pairs(pipeline: newton.CollisionPipeline) -> None:
    """Let the device's stream wait for the cull that fills the list of pairs, if it runs on its own."""
    wait = pipeline.__dict__.pop("_wait", None)
    if wait is not None:
        wait()


@cache
def _counting(kind: type) -> type:
    """The subclass of a pipeline's class whose number of particle-shape pairs is the length of their list.

    Newton asks for it right before its particle-shape pass, which is where that has to wait for the cull.
    """
    if hasattr(kind, "_counts"):
        return kind

    def count(pipeline: newton.CollisionPipeline) -> int:
        _wait_for_pairs(pipeline)
        return len(pipeline.soft_rigid_contact_pairs)

    both = dict.fromkeys(("soft_contact_pair_count", "soft_rigid_contact_pair_count"), property(count))
    return type(kind.__name__, (kind,), {**both, "_counts": True})
