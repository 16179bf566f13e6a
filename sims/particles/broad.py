"""Broad phases of the rain: a box that is refitted to the mesh in every step, and bounders of the whole motion.

Each says which particles may touch the mesh; ``OfSides`` also which ones certainly do (``certain``).
"""

import numpy as np
import warp as wp

import warp_bounding as wb
from sims.particles.kernels import box_mask, box_of, split, with_time
from sims.particles.scene import Scene

__all__ = ["Everyone", "MovingBox", "OfMotion", "OfSides"]

EMPTY = np.array([[np.inf] * 3, [-np.inf] * 3], dtype=np.float32)


class MovingBox:
    """The axis-aligned box of the mesh as it is now, dilated by the margin.

    The mesh's points are float32, the box is theirs; that adding the margin rounds is covered by the half of the
    margin's allowance for rounding that the narrow phase does not need (``Scene.margin``).
    """

    def __init__(self, scene: Scene):
        self.margin, self.device = scene.margin, scene.device
        self._box = wp.array(EMPTY, dtype=wp.vec3, device=self.device)
        self._empty = wp.array(EMPTY, dtype=wp.vec3, device=self.device)
        self._mask = wp.empty(0, dtype=wp.bool, device=self.device)

    def candidates(self, time: float, points: wp.array, positions: wp.array) -> tuple[wp.array, wp.array]:
        """Particles that may touch the mesh.

        Args:
            time: Of the step; not used.
            points: ``(V,)`` vec3, the mesh's vertices now.
            positions: ``(N,)`` vec3.

        Returns:
            As ``Bounder.candidates``.
        """
        count = len(positions)
        if len(self._mask) != count:
            self._mask = wp.empty(count, dtype=wp.bool, device=self.device)
        wp.copy(self._box, self._empty)
        wp.launch(box_of, dim=len(points), inputs=[points], outputs=[self._box], device=self.device)
        inputs = [self._box, self.margin, positions]
        wb.launch_on_cores(box_mask, count, inputs, [self._mask], self.device)
        return wb.compact(self._mask)

    def fp_rate(self, shape: wb.shapes.MovingMesh, times: int = 50, seed: int = 1) -> float:
        """False positives in per cent of random points and times around the dilated motion, as of ``evaluate``."""
        rng, each, false = np.random.default_rng(seed), 8000, 0
        lower, upper = shape.sample_lower, shape.sample_upper
        for share in rng.random(times):
            x = lower + rng.random((each, 4)) * (upper - lower)
            x[:, 0] = lower[0] + share * (upper[0] - lower[0])
            x = x.astype(np.float32)
            vertices = shape.vertices_at(x[0, 0])[np.unique(shape.faces)]
            low, high = vertices.min(axis=0) - self.margin, vertices.max(axis=0) + self.margin
            inside = ((x[:, 1:] >= low) & (x[:, 1:] <= high)).all(axis=1)
            false += int((inside & ~shape.contains(x)).sum())
        return 100.0 * false / (times * each)


class Everyone:
    """No broad phase; what would be asked is kept.

    Attributes:
        kept: A step each, ``(K, 4)`` float32, times and places of some particles.
    """

    def __init__(self, most: int, seed: int = 0):
        """Keep so many particles of each step."""
        self.kept: list[np.ndarray] = []
        self._most, self._rng = most, np.random.default_rng(seed)

    def candidates(self, time: float, points: wp.array, positions: wp.array) -> tuple[wp.array, wp.array]:
        """All of them; see ``MovingBox.candidates``."""
        count, device = len(positions), positions.device
        some = np.sort(self._rng.permutation(count)[: self._most])
        self.kept.append(np.insert(positions.numpy()[some], 0, time, axis=1))
        return wp.array(np.arange(count), dtype=wp.int32, device=device), wp.array(
            [count], dtype=wp.int32, device=device
        )

    @property
    def queries(self) -> np.ndarray:
        """``(N, 4)`` float32, of all steps."""
        return np.concatenate(self.kept)


class OfMotion:
    """A bounder of time and space; nothing to refit."""

    def __init__(self, bounder: wb.Bounder, scene: Scene):
        self.bounder, self.device = bounder, scene.device
        self._asking: wb.Prepared | None = None
        self._queries = wp.empty(0, dtype=wp.vec4, device=self.device)

    def candidates(self, time: float, points: wp.array, positions: wp.array) -> tuple[wp.array, wp.array]:
        """Particles that may touch the mesh; see ``MovingBox.candidates``."""
        if self._asking is None or len(self._queries) != len(positions):
            self._queries = wp.empty(len(positions), dtype=wp.vec4, device=self.device)
            self._asking = self.bounder.prepare(self._queries, candidates=True)
        wb.launch_on_cores(with_time, len(positions), [time, positions], [self._queries], self.device)
        return self._asking.launch()


class OfSides:
    """Two bounders of time and space, one from the inside: what is certain either way is no candidate.

    Attributes:
        certain: ``(N,)`` bool, true where a particle certainly touches the mesh or is in it, as of the last
            ``candidates``.
    """

    def __init__(self, outer: wb.Bounder, inner: wb.Bounder, scene: Scene):
        """Put them together.

        Args:
            outer: Of ``Scene.shape``.
            inner: From the inside, of ``Scene.core``.
            scene: Whose motion they bound.
        """
        self.sides, self.device = wb.two_sided(outer, inner), scene.device
        self._queries = wp.empty(0, dtype=wp.vec4, device=self.device)

    def candidates(self, time: float, points: wp.array, positions: wp.array) -> tuple[wp.array, wp.array]:
        """Particles of which it is not certain whether they touch the mesh; see ``MovingBox.candidates``."""
        count = len(positions)
        if len(self._queries) != count:
            self._queries = wp.empty(count, dtype=wp.vec4, device=self.device)
            memory = (wp.empty(count, dtype=kind, device=self.device) for kind in (wp.uint8, wp.bool, wp.bool))
            self._answers, self._maybe, self.certain = memory
        wb.launch_on_cores(with_time, count, [time, positions], [self._queries], self.device)
        self.sides.classify(self._queries, out=self._answers)
        wb.launch_on_cores(split, count, [self._answers], [self._maybe, self.certain], self.device)
        return wb.compact(self._maybe)
