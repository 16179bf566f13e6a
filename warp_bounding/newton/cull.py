"""A collision pipeline of Newton's that goes only through what may touch.

A ``newton.CollisionPipeline`` tests every particle against every shape, one kernel thread a pair
(``soft_rigid_contact_pairs``). ``Cull`` wraps one: before each pass it looks which pairs cannot touch, and
lets the pipeline go through the others, in the order that it had them. Contacts are then the same,
record by record, and so is every step that a solver makes. Whole faces and edges of soft bodies (``surface``) and pairs
of meshes (``rigid``) are culled likewise.

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

What this does not do: self-contacts of cloth, and whole edges and faces against shapes that are no meshes, are left as
they are. A mesh whose points are moved in place has no true box: it must be ``untested``.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache

import newton
import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder
from warp_bounding.errors import BounderError
from warp_bounding.newton.placing import place_shapes
from warp_bounding.newton.rigid import PairFilter
from warp_bounding.newton.shapes import Shapes, contact_gap
from warp_bounding.newton.sieve import sieve_of
from warp_bounding.newton.surface import Surface
from warp_bounding.pairs import Balls
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


MOST_RECORDED = 16  # sets of arrays whose launches are kept
BESIDE = True  # whether the cull of a graph has a stream of its own on a GPU


class Cull:
    """A collision pipeline whose passes skip what cannot touch.

    Attributes:
        pipeline: The pipeline; ``pipeline.collide`` by itself goes through everything again.
        pairs: Number of all pairs of particles and shapes.
    """

    def __init__(
        self,
        pipeline: newton.CollisionPipeline,
        bounders: Mapping[int, Bounder] | None = None,
        *,
        balls: Mapping[int, Balls] | None = None,
        unproven: bool = False,
        untested: Collection[int] = (),
        reads_back: bool = True,
    ):
        """Check that the bounders are those of the shapes, and load all kernels, so that a graph can be captured.

        Args:
            pipeline: It stays as it is; ``collide`` runs it with other pairs.
            bounders: Per index of a shape a bounder of its mesh, in the mesh's own coordinates, 3D: of distances, or of
                points, with a margin of ``margin_for`` at least. One bounder may serve many shapes. Of shapes without
                one the closed form is tested, or the mesh's box.
            balls: Per index of a shape the balls that hold its mesh: pairs of meshes of which one has these and the
                other a bounder of distances are culled before the narrow phase (``rigid``).
            unproven: Take bounders without a proof, with too small a margin, and of what is refused, too; contacts may
                then be missed.
            untested: Indices of shapes that keep all their pairs with particles.
            reads_back: Let the host read how many pairs are left, once a pass, so that Newton launches no more threads.
                Without, and always while the device captures a graph, Newton launches one for each pair, and nothing is
                read.

        Raises:
            BounderError: For a bounder or balls that are not of this mesh; for too small a margin, with both numbers,
                or no proof; for a shape that is no mesh; for a differentiable pipeline, or what is no pipeline at all.

        Warns:
            BoundingWarning: Once, of shapes that have no test.
        """
        if not isinstance(pipeline, newton.CollisionPipeline):
            raise BounderError(f"pipeline must be a newton.CollisionPipeline, got {type(pipeline).__name__}")
        bounders, balls = {} if bounders is None else bounders, {} if balls is None else balls
        for name, given in (("bounders", bounders), ("balls", balls)):
            if not isinstance(given, Mapping):
                got = type(given).__name__
                raise BounderError(f"{name} must be a mapping from indices of shapes to {name}, got {got}")
        self.pipeline, self.model = pipeline, pipeline.model
        if getattr(pipeline, "requires_grad", False):
            raise BounderError("a differentiable pipeline reads its pairs again when it goes backwards; they must stay")
        self._reads_back = reads_back
        self._all = pipeline.soft_rigid_contact_pairs.contiguous()
        surfaces = getattr(pipeline, "_soft_mesh_contact_data", None) is not None
        self._shapes = Shapes(pipeline, bounders, unproven, untested, surfaces)
        self._device = device = self.model.device
        self._particles = sieve_of(self._all, self.model.particle_count, self._shapes)
        self._surface = Surface(pipeline, self._shapes) if surfaces else None
        self._sieves = [self._particles, *([self._surface.particles] if surfaces else [])]
        self.pairs = sum(map(len, self._sieves))
        self._rigid = PairFilter(pipeline, bounders, balls, unproven) if balls else None
        self._candidates_gap = contact_gap(pipeline)  # for which pairs were found
        self._stream = wp.Stream(device) if device.is_cuda else None
        ready(place_shapes, device)
        self._recorded: dict[tuple, list[BlockLaunch]] = {}  # by the arrays that they read, oldest first
        self._beside = False  # whether the candidates are being found on that stream
        self._view = _view_of(type(pipeline))(self)

    @property
    def survivors(self) -> int:
        """Number of pairs that the last pass left, which may be that of a graph; waits for the device."""
        return sum(sieve.left for sieve in self._sieves)

    @property
    def culled(self) -> int:
        """Number of pairs that the last pass skipped; waits for the device."""
        return self.pairs - self.survivors

    def tally(self) -> dict[str, Tally]:
        """What the last pass skipped; waits for the device.

        Returns:
            Pairs of particles and shapes by the kind of shape, under its name, as ``"plane"`` or ``"mesh with a
            bounder"``; of the passes over surfaces ``"soft faces"``, in pairs with meshes, and the ``"corners"``,
            ``"edges"`` and ``"faces"`` of meshes; and ``"pairs of meshes"`` that the broad phase has found.
        """
        names = self._shapes.names
        shapes = np.concatenate([sieve.pairs.numpy().reshape(-1, 2)[:, 1] for sieve in self._sieves])
        gone = np.concatenate([~sieve.keep.numpy() for sieve in self._sieves])
        pairs, culled = (np.bincount(own, minlength=len(names)) for own in (shapes, shapes[gone]))
        order = {name: [s for s, own in enumerate(names) if own == name] for name in names}
        found = {name: Tally(int(pairs[own].sum()), int(culled[own].sum())) for name, own in order.items()}
        if self._surface is not None:
            keep = self._surface.faces.keep.numpy()
            found["soft faces"] = Tally(len(keep), int((~keep).sum()))
            rows = zip(("corners", "edges", "faces"), self._surface.rows(), strict=True)
            found |= {name: Tally(count, count - left) for name, (count, left) in rows}
        if self._rigid is not None:
            before, left = self._rigid.counts()
            found["pairs of meshes"] = Tally(before, before - left)
        return found

    def collide(
        self, state: newton.State, contacts: newton.Contacts, *, candidates: wp.array | None = None, **options
    ) -> None:
        """``pipeline.collide``, with what may touch.

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
        self._kept, surface = candidates, self._surface
        if surface is not None:
            self._wait()
            surface.begin()
            if state.particle_q:
                self._run(("surface", gap), state, lambda: surface.launches(state))
                surface.replace(state, self._reads_back)
        try:
            self._view.collide(state, contacts, **options)
        finally:
            self._wait()  # where the pass had nothing to do
        if surface is not None:
            surface.end(contacts)

    def _wait(self) -> None:
        """Let the device's stream wait for the candidates, if they are found on another one."""
        if self._beside:
            self._device.stream.wait_stream(self._stream)
        self._beside = False

    def _candidates_beside(self, state: newton.State, gap: float) -> wp.array:
        """``candidates``, on a stream of its own where nothing is read back; ``_wait`` waits for it."""
        device = self._device
        if not (BESIDE and device.is_cuda and (device.is_capturing or not self._reads_back)):
            return self.candidates(state, gap)
        stream, own = device.stream, self._stream
        own.wait_stream(stream)
        self._beside = True
        with wp.ScopedStream(own, sync_enter=False):
            return self.candidates(state, gap)

    def candidates(self, state: newton.State, gap: float | None = None) -> wp.array:
        """The pairs of particles and shapes that may touch, but for meshes whose faces meet whole soft faces.

        Args:
            state: Places of particles and bodies.
            gap: Soft contact gap of this pass; the pipeline's if ``None``. A graph keeps the one that it was captured
                with.

        Returns:
            ``(K,)`` ``vec2i``, particle and shape; valid until the next call. On a CPU they are in the pipeline's
            order. Where nothing is read back, K is the number of all pairs, and one denied pair stands behind those
            that are left, or on a GPU in all places that are left.
        """
        self._candidates_gap = gap = contact_gap(self.pipeline) if gap is None else float(gap)
        if not self.pairs or not state.particle_q:
            return self._all
        self._particles.begin()
        asked = state.particle_q, self.model.particle_radius
        made = lambda: [self._shapes.launch(state, gap), *self._particles.launches(*asked)]  # noqa: E731
        self._run(("particles", gap), state, made)
        return self._particles.kept(state.particle_q, self._reads_back) if len(self._particles) else self._all

    def _run(self, name: tuple, state: newton.State, made: Callable[[], list[BlockLaunch]]) -> None:
        """Run launches, cached by their arrays, since a simulation queries the same two states again and again."""
        device = self._device
        if device.is_capturing:
            for launch in made():
                launch.launch_whole()
            return
        key = (*name, id(state.particle_q), id(self.model.particle_radius), *map(id, self._shapes.read(state)))
        if key not in self._recorded:
            while len(self._recorded) >= MOST_RECORDED:
                del self._recorded[next(iter(self._recorded))]
            self._recorded[key] = made()
        for launch in self._recorded[key]:
            if self._particles.one_thread:
                launch.launch_whole()
            else:
                launch.launch()


@cache
def _view_of(kind: type) -> type:
    """The subclass of a pipeline's class that goes through what a cull has left.

    Its objects share all attributes with the user's pipeline, which stays as it is.
    """

    def of_surface(name: str, newtons: str) -> property:
        return property(lambda self: getattr(self._of._surface, name, self.__dict__.get(newtons)))

    class View(kind):
        __slots__ = ("_of",)  # the cull: beside the shared attributes

        def __init__(self, cull: Cull):
            self._of, self.__dict__ = cull, cull.pipeline.__dict__

        @property
        def soft_contact_pair_count(self) -> int:
            """Newton asks right before its particle-shape pass, which is where that has to wait for the cull."""
            self._of._wait()
            return len(self._of._kept)

        soft_rigid_contact_pair_count = soft_contact_pair_count
        soft_rigid_contact_pairs = property(lambda self: self._of._kept)
        broad_phase = property(lambda self: self._of._rigid or self.__dict__["broad_phase"])
        _soft_mesh_contact_data, model = of_surface("data", "_soft_mesh_contact_data"), of_surface("model", "model")

    return View
