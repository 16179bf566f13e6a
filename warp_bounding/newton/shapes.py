"""What the cull knows of a model's shapes: which hull each has, and which bounder, one number or vector a shape on the device."""

import warnings
from collections import Counter
from collections.abc import Collection, Mapping

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.errors import BounderError, BoundingWarning
from warp_bounding.newton import placing
from warp_bounding.newton.accepted import MESHES, check_bounder
from warp_bounding.newton.library import newton
from warp_bounding.newton.meshes import mesh_ids, triangles
from warp_bounding.newton.primitives import PRIMITIVES

__all__ = ["Shapes"]


class Shapes:
    """The shapes of a model, as ``place_shapes`` and the bounders' kernels read them.

    Attributes:
        bounders: Each once.
        roles: ``(S,)`` int, as of ``placing``.
        bounder_of: ``(S,)`` int32, which of the bounders; -1 for none.
    """

    def __init__(
        self,
        pipeline: newton.CollisionPipeline,
        bounders: Mapping[int, Bounder | DistanceBounder],
        unproven: bool,
        untested: Collection[int],
    ):
        """Check the bounders, and warn once of shapes that have no test; ``BounderError`` as of ``ParticleCull``."""
        self._model = model = pipeline.model
        count = model.shape_count
        for shape in untested:
            if not isinstance(shape, (int, np.integer)) or isinstance(shape, bool) or not 0 <= shape < count:
                raise BounderError(f"untested must be indices of shapes, from 0 to {count - 1}, got {shape!r}")
        both = sorted(set(untested) & set(bounders))
        if both:
            raise BounderError(f"shape {both[0]}: it is both in bounders and in untested")
        self.bounders = list({id(bounder): bounder for bounder in bounders.values()}.values())
        self.roles, self._sizes = np.full(count, placing.UNTESTED, np.int32), np.zeros(count, np.float32)
        self._margins, self._grows = np.full(count, -np.inf, np.float32), np.zeros(count, np.float32)
        self._domains, numbers = np.zeros((count, 2, 3), np.float32), np.full(count, -1, np.int32)
        kinds, unknown = model.shape_type.numpy().tolist() if count else [], Counter()
        collides = model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_PARTICLES) if count else []
        self._ids = np.zeros(count, np.uint64) if not count else mesh_ids(model).numpy().astype(np.uint64)
        known: dict[int, tuple[np.ndarray, np.ndarray]] = {}

        def mesh_of(shape: int) -> tuple[np.ndarray, np.ndarray]:
            mesh = int(self._ids[shape])
            if mesh not in known:
                known[mesh] = triangles(mesh, model.device)
            return known[mesh]

        for shape, bounder in bounders.items():
            check_bounder(pipeline, shape, bounder, unproven, mesh_of)
            self._bound(shape, bounder, unproven, mesh_of(shape)[0])
            numbers[shape] = next(n for n, other in enumerate(self.bounders) if other is bounder)
        for shape, kind in enumerate(kinds):
            if shape in bounders or shape in untested:
                continue
            if kind in PRIMITIVES:
                self.roles[shape] = placing.PRIMITIVE
            elif kind in MESHES and self._ids[shape] and _finite(mesh_of(shape)[0]):
                self._enclose(shape, mesh_of(shape)[0])
                self.roles[shape], self._margins[shape], self._grows[shape] = placing.HULL, np.inf, 1.0
            elif collides[shape]:
                unknown[newton.GeoType(kind).name.lower()] += 1
        if unknown:
            told = ", ".join(f"{name} ({number})" for name, number in sorted(unknown.items()))
            warnings.warn(f"shapes that keep all their pairs, having no test: {told}", BoundingWarning, stacklevel=3)
        on_device = [(self.roles, wp.int32), (self._domains, wp.vec3)]
        on_device += [(values, wp.float32) for values in (self._margins, self._grows, self._sizes)]
        on_device.insert(1, (self._ids, wp.uint64))
        self._own = [wp.array(values, dtype=dtype, device=model.device) for values, dtype in on_device]
        self.bounder_of = wp.array(numbers, dtype=wp.int32, device=model.device)

    def read(self, state: newton.State) -> list[wp.array | None]:
        """The arrays of a state and of the model that ``place_shapes`` reads, as they are now."""
        m = self._model
        places = [state.body_q, m.shape_transform, m.shape_body, m.shape_scale, m.shape_margin]
        return [*places, m.shape_flags, m.shape_type, mesh_ids(m)]

    def inputs(self, state: newton.State, gap: float) -> list:
        """Of ``place_shapes``, but for the first: those, and what is known of the shapes."""
        return [*self.read(state), gap, *self._own]

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

    def _bound(self, shape: int, bounder: Bounder | DistanceBounder, unproven: bool, vertices: np.ndarray) -> None:
        self._enclose(shape, vertices)
        self.roles[shape] = placing.BOUNDED
        if isinstance(bounder, DistanceBounder):
            # The hull grows by the way, from the mesh itself on; a domain has room around it.
            self._margins[shape], self._grows[shape] = np.inf, 1.0
            return
        self._margins[shape] = np.inf if unproven else bounder.info["margin"]
        lower, upper = bounder.domain.lower, bounder.domain.upper
        self._domains[shape] = (lower + upper) / 2, (upper - lower) / 2


def _finite(vertices: np.ndarray) -> bool:
    return vertices.size > 0 and bool(np.isfinite(vertices).all())
