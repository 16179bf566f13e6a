"""One run of the rain, timed phase by phase."""

import time
from pathlib import Path

import numpy as np
import warp as wp

from sims.cores import launch_on_all_cores
from sims.particles.broad import MovingBox, OfMotion
from sims.particles.kernels import DT, collide, integrate
from sims.particles.scene import Scene

__all__ = ["CONTACT", "CONTAINMENT", "Example"]

CONTACT = 0.04  # reach of a narrow phase that looks for near contact only: a little more than a drop falls in a step
CONTAINMENT = 0.52  # no point of the moving bunny is deeper: whatever is inside is found and pushed out


class Example:
    """One run of the simulation.

    Attributes:
        seconds: Per step: broad phase, narrow phase with the mesh's refit, whole step.
        calls: Per step: particles that the narrow phase was called for.
        touched: Per step: which particles were in contact, packed bits.
    """

    def __init__(
        self,
        scene: Scene,
        broad: MovingBox | OfMotion | None = None,
        *,
        reach: float = CONTAINMENT,
        particles: int = 100_000,
        seed: int = 0,
    ):
        """Start from the scene's first state.

        Args:
            scene: Shared by all runs that are to be compared.
            broad: The broad phase; ``None`` for none.
            reach: How far the narrow phase looks for the closest point.
            particles: How many.
            seed: Of the first state and of every new life.
        """
        self.scene, self.broad, self.particles, self.seed = scene, broad, particles, seed
        self.reach, self.steps = reach, 0
        device = scene.device
        positions, velocities, ages = scene.drops(particles, seed)
        self.positions = wp.array(positions, dtype=wp.vec3, device=device)
        self.velocities = wp.array(velocities, dtype=wp.vec3, device=device)
        self.ages = wp.array(ages, dtype=wp.int32, device=device)
        self.lives = wp.zeros(particles, dtype=wp.int32, device=device)
        self.contacts = wp.zeros(particles, dtype=wp.uint8, device=device)
        vertices = scene.motion.vertices_at(scene.time(0))
        points = wp.array(vertices, dtype=wp.vec3, device=device)
        indices = wp.array(scene.motion.faces.reshape(-1), dtype=wp.int32, device=device)
        self.mesh = wp.Mesh(points=points, indices=indices, velocities=wp.zeros_like(points))
        self._vertices = vertices
        self._everyone = wp.array(np.arange(particles), dtype=wp.int32, device=device)
        self._count = wp.array([particles], dtype=wp.int32, device=device)
        self.seconds: list[tuple[float, float, float]] = []
        self.calls: list[int] = []
        self.touched: list[np.ndarray] = []

    @property
    def time(self) -> float:
        """Time within the period of the motion."""
        return self.scene.time(self.steps)

    def step(self) -> None:
        """One step."""
        start = self._now()
        self.steps += 1
        self._move_mesh()
        state = [self.positions, self.velocities, self.ages, self.lives, self.contacts]
        self._launch(integrate, self.particles, [self.scene.rain, self.seed], state)
        moved = self._now()
        candidates, count = self._everyone, self._count
        if self.broad is not None:
            candidates, count = self.broad.candidates(self.time, self.mesh.points, self.positions)
        # A CPU reads the count in place; elsewhere the launch covers everyone, and threads from count on return at once.
        items = int(count.numpy()[0]) if self.scene.device.is_cpu else self.particles
        found = self._now()
        self.mesh.refit()
        inputs = [self.mesh.id, self.reach, candidates, count]
        self._launch(collide, items, inputs, [self.positions, self.velocities, self.contacts])
        end = self._now()
        self.seconds.append((found - moved if self.broad is not None else 0.0, end - found, end - start))
        self.calls.append(int(count.numpy()[0]))
        self.touched.append(np.packbits(self.contacts.numpy()))

    def _move_mesh(self) -> None:
        vertices = self.scene.motion.vertices_at(self.time)
        self.mesh.velocities.assign((vertices - self._vertices) / np.float32(DT))
        self.mesh.points.assign(vertices)  # the tree over them is refitted in the narrow phase, which needs it
        self._vertices = vertices

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list, outputs: list) -> None:
        launch_on_all_cores(kernel, count, inputs, outputs, self.scene.device)

    def _now(self) -> float:
        wp.synchronize_device(self.scene.device)
        return time.perf_counter()

    def state(self) -> bytes:
        """Everything that the next step depends on, but time."""
        return b"".join(a.numpy().tobytes() for a in (self.positions, self.velocities, self.ages, self.lives))

    def lost(self, reference: "Example") -> np.ndarray:
        """Contacts that the reference, a run of the same length without a broad phase, has and this run lacks.

        Returns:
            ``(steps, particles)`` bool.
        """
        there, here = (np.stack(run.touched) for run in (reference, self))
        return np.unpackbits(there & ~here, axis=1, count=self.particles).astype(bool)

    def missed(self, reference: "Example") -> int:
        """How many contacts are ``lost``."""
        return int(self.lost(reference).sum())

    def milliseconds(self) -> tuple[float, float, float]:
        """Median per step: broad phase, narrow phase, whole step."""
        return tuple(1e3 * np.median(self.seconds, axis=0))

    def render(self, folder: Path) -> list[Path]:
        """Draw the present state; see ``pictures``."""
        from sims.drawing import draw_with
        from sims.particles.pictures import rain_data

        return draw_with("sims.particles.pictures", folder, rain_data({"rain": self})).paths

    def test_final(self, reference: "Example") -> None:
        """Check this run against one without a broad phase.

        Raises:
            AssertionError: If a contact was missed or a bit of the state differs.
        """
        missed = self.missed(reference)
        assert missed == 0, f"{missed} contacts were missed"
        assert self.state() == reference.state(), "the final states differ"
