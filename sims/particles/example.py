"""One run of the rain, timed phase by phase."""

from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warp_bounding as wb
from sims import base
from sims.assets import surface
from sims.drawing import CAPTIONS, draw_with
from sims.particles.bounds import decisions
from sims.particles.broad import MovingBox, OfMotion, OfSides
from sims.particles.due import WhenDue
from sims.particles.kernels import DT, collide, integrate, seep, touch
from sims.particles.scene import Scene

__all__ = ["CONTACT", "CONTAINMENT", "Example", "rain_data"]

CONTACT = 0.04  # reach of a narrow phase that looks for near contact only: a little more than a drop falls in a step
CONTAINMENT = 0.52  # no point of the moving bunny is deeper: whatever is inside is found and pushed out


class Example(base.Example):
    """One run of the simulation.

    Attributes:
        seconds: Per step: broad phase, narrow phase with the mesh's refit, whole step.
        calls: Per step: particles that the narrow phase was called for.
        touched: Per step: which particles were in contact, packed bits.
        asked: Particles that a broad phase asked about which skips steps, in all.
        porous: Whether drops seep through the mesh, slowly, rather than slide off it.
    """

    def __init__(
        self,
        scene: Scene,
        broad: MovingBox | OfMotion | OfSides | WhenDue | None = None,
        *,
        reach: float = CONTAINMENT,
        porous: bool = False,
        particles: int = 100_000,
        seed: int = 0,
    ):
        """Start from the scene's first state.

        Args:
            scene: Shared by all runs that are to be compared.
            broad: The broad phase; ``None`` for none.
            reach: How far the narrow phase looks for the closest point.
            porous: See above.
            particles: How many.
            seed: Of the first state and of every new life.

        Raises:
            BoundingError: If the mesh is not porous and the broad phase says what certainly touches it: where to push
                that is a question for the narrow phase.
        """
        super().__init__()
        if isinstance(broad, OfSides) and not porous:
            raise wb.BoundingError("a certain contact spares the narrow phase of a porous mesh only; got another one")
        self.porous = porous
        self.certificate = "by construction" if isinstance(broad, MovingBox) else ""  # it is made of the very vertices
        self.scene, self.broad, self.particles, self.seed = scene, broad, particles, seed
        self.reach, self.steps = reach, 0
        device = scene.device
        positions, velocities, ages = scene.drops(particles, seed)
        self.positions = wp.array(positions, dtype=wp.vec3, device=device)
        self.velocities = wp.array(velocities, dtype=wp.vec3, device=device)
        self.ages = wp.array(ages, dtype=wp.int32, device=device)
        self.lives = wp.zeros(particles, dtype=wp.int32, device=device)
        self.contacts = wp.zeros(particles, dtype=wp.bool, device=device)
        vertices = scene.motion.vertices_at(scene.time(0))
        self.mesh = surface(vertices, scene.motion.faces, device, moving=True)
        self._vertices = vertices
        self._everyone = wp.array(np.arange(particles), dtype=wp.int32, device=device)
        self._count = wp.array([particles], dtype=wp.int32, device=device)
        self.touched: list[np.ndarray] = []
        self.asked = 0
        if isinstance(broad, WhenDue):
            broad.watch(self.velocities, self.lives)

    @property
    def time(self) -> float:
        """Time within the period of the motion."""
        return self.scene.time(self.steps)

    def step(self) -> None:
        """One step."""
        device = self.scene.device
        start = base.now(device)
        self.steps += 1
        self._move_mesh()
        state = [self.positions, self.velocities, self.ages, self.lives, self.contacts]
        self._launch(integrate, self.particles, [self.scene.rain, self.seed], state)
        moved = base.now(device)
        candidates, count = self._everyone, self._count
        if self.broad is not None:
            candidates, count = self.broad.candidates(self.time, self.mesh.points, self.positions)
        if isinstance(self.broad, OfSides):
            wp.copy(self.contacts, self.broad.certain)
        # A CPU reads the count in place; elsewhere the launch covers everyone, and threads from count on return at
        # once.
        items = int(count.numpy()[0]) if device.is_cpu else self.particles
        found = base.now(device)
        self.mesh.refit()
        inputs = [self.mesh.id, self.reach, candidates, count]
        if self.porous:
            self._launch(touch, items, [*inputs, self.positions], [self.contacts])
            self._launch(seep, self.particles, [self.contacts], [self.velocities])
        else:
            self._launch(collide, items, inputs, [self.positions, self.velocities, self.contacts])
        end = base.now(device)
        self.seconds.append((found - moved if self.broad is not None else 0.0, end - found, end - start))
        self.calls.append(int(count.numpy()[0]))
        self.touched.append(np.packbits(self.contacts.numpy()))
        if isinstance(self.broad, WhenDue):
            self.asked += int(self.broad.asked.numpy().sum())

    def _move_mesh(self) -> None:
        vertices = self.scene.motion.vertices_at(self.time)
        self.mesh.velocities.assign((vertices - self._vertices) / np.float32(DT))
        self.mesh.points.assign(vertices)  # the tree over them is refitted in the narrow phase, which needs it
        self._vertices = vertices

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list, outputs: list) -> None:
        wb.launch_on_cores(kernel, count, inputs, outputs, self.scene.device)

    def extra(self, reference: base.Example) -> dict[str, Any]:
        """``asked``, where the broad phase skips steps."""
        return {"asked": self.asked} if isinstance(self.broad, WhenDue) else {}

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

    def render(self, folder: Path) -> list[Path]:
        """Draw the present state; see ``pictures``."""
        return draw_with("sims.particles.pictures", folder, rain_data({"rain": self})).paths


def rain_data(
    examples: dict[str, Example],
    bounders: dict[str, wb.Bounder] | None = None,
    reference: Example | None = None,
) -> dict[str, np.ndarray]:
    """What the picture of the rain needs.

    Args:
        examples: Runs of one scene and length, by name; a panel each.
        bounders: Theirs, by the same names, where the bound is to be shown.
        reference: The run without a broad phase, to say what a run lost against it.

    Returns:
        Arrays by name.
    """
    data, bounders = {}, bounders or {}
    for number, (name, example) in enumerate(examples.items()):
        data["vertices"], data["faces"] = example.scene.motion.vertices_at(example.time), example.scene.motion.faces
        positions = example.positions.numpy()
        data[f"rain{number}_positions"], data[f"rain{number}_velocities"] = positions, example.velocities.numpy()
        lines = [CAPTIONS.get(name, name)]
        if name in bounders:
            data |= decisions(f"around{number}", bounders[name], example.time)
            queries = np.insert(positions, 0, example.time, axis=1)
            balls = bounders[name].query(queries).numpy()
            lines.append(f"balls: drops in its bound (pale), {balls.sum():,} of {example.particles:,} now")
        else:
            balls = example.contacts.numpy()
            lines.append(f"balls: drops that touch the bunny, {balls.sum():,} of {example.particles:,} now")
        data[f"rain{number}_balls"] = balls
        if reference is not None:
            lost, alive = example.lost(reference), example.ages.numpy() + 1  # steps of the present life
            present = np.arange(example.steps)[:, None] >= example.steps - alive
            data[f"rain{number}_lost"] = (lost & present).any(axis=0)
            identical = example.state() == reference.state()
            end = "identical to the run without a bounder, to the bit" if identical else "red: drops that lost one"
            lines += [f"{lost.sum():,} contacts missed in {example.steps} steps", end]
        data[f"rain{number}_caption"] = np.array("\n".join(lines))
    return data
