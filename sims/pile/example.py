"""One run of the pile, timed phase by phase."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warp_bounding as wb
from sims import base
from sims.drawing import draw_with
from sims.pile.kernels import apart_kernel, meet, move, spheres, turned
from sims.pile.scene import Scene

__all__ = ["Boxes", "Example", "Pairs", "pile_data"]


class Boxes:
    """Boxes of turned bodies, along the world's axes or the bodies' own."""

    by_construction = True

    def __init__(self, scene: Scene, oriented: bool):
        """See above."""
        self.scene, self.oriented = scene, oriented

    def __call__(self, places: wp.array, pairs: np.ndarray) -> np.ndarray:
        """Which pairs ``(P, 2)`` are left, ``(P,)`` bool."""
        near = wp.empty(len(pairs), dtype=wp.bool, device=self.scene.device)
        inputs = [self.scene.bodies, places, wp.array(pairs, dtype=wp.vec2i, device=self.scene.device), self.oriented]
        wb.launch_on_cores(turned, len(pairs), inputs, [near], self.scene.device)
        return near.numpy()


class Pairs:
    """``wb.pairs``: of two kinds the first has the distance, the second the balls."""

    by_construction = False

    def __init__(self, scene: Scene, far: dict[str, wb.Bounder], balls: dict[str, wb.pairs.Balls]):
        """Take a bounder and balls of each scene's mesh."""
        self.scene, (bunny, ring), (held_bunny, held_ring) = scene, far.values(), balls.values()
        asked = [wb.pairs.Pair(bunny, held_bunny), wb.pairs.Pair(bunny, held_ring), wb.pairs.Pair(ring, held_ring)]
        self.kernel, self.data = apart_kernel(asked[0].func, asked[2].func), [pair.data for pair in asked]

    def __call__(self, places: wp.array, pairs: np.ndarray) -> np.ndarray:
        """Which pairs ``(P, 2)`` are left, ``(P,)`` bool."""
        near, device = wp.empty(len(pairs), dtype=wp.bool, device=self.scene.device), self.scene.device
        pairs = wp.array(pairs, dtype=wp.vec2i, device=device)
        wb.launch_on_cores(self.kernel, len(pairs), [*self.data, self.scene.bodies, places, pairs], [near], device)
        return near.numpy()


class Example(base.Example):
    """One run.

    Attributes:
        seconds: Per step: broad phase, bounding spheres included, narrow phase, whole step.
        calls: Per step: pairs of bodies that the narrow phase was called for.
        left: These pairs in the last step, ``(P, 2)``.
        touched: Per step: which bodies' points met which bodies, packed bits.
    """

    def __init__(self, scene: Scene, broad: Callable[[wp.array, np.ndarray], np.ndarray] | None = None):
        """Start from the scene's first state; without a broad phase there are bounding spheres."""
        super().__init__()
        self.scene, self.broad, count, device = scene, broad, len(scene.kinds), scene.device
        self.certificate = "by construction" if getattr(broad, "by_construction", False) else ""
        self.places = wp.array(scene.start, dtype=wp.transform, device=device)
        self.linear, self.angular = (wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(2))
        self.near, self.touch = (wp.zeros((count, count), dtype=wp.bool, device=device) for _ in range(2))
        self.forces = [wp.zeros((count, count), dtype=wp.vec3, device=device) for _ in range(3)]
        self.touched: list[np.ndarray] = []

    def step(self) -> None:
        """One step."""
        scene, device, count, launch = self.scene, self.scene.device, len(self.scene.kinds), wb.launch_on_cores
        start = base.now(device)
        launch(spheres, count, [scene.bodies, self.places], [self.near], device)
        self.left = np.argwhere(self.near.numpy()).astype(np.int32)
        if self.broad is not None and len(self.left):
            self.left = self.left[self.broad(self.places, self.left)]
        found = base.now(device)
        self.touch.zero_()
        pairs = wp.array(self.left, dtype=wp.vec2i, device=device)
        inputs = [scene.bodies, self.places, self.linear, self.angular, pairs]
        if len(self.left):
            launch(meet, 2 * len(self.left), inputs, [self.touch, *self.forces], device)
        end = base.now(device)
        state = [self.places, self.linear, self.angular]
        launch(move, count, [scene.bodies, self.touch, *self.forces], state, device)
        self.seconds.append((found - start, end - found, base.now(device) - start))
        self.calls.append(len(self.left))
        self.touched.append(np.packbits(self.touch.numpy()))

    def state(self) -> bytes:
        """All places and velocities."""
        return b"".join(a.numpy().tobytes() for a in (self.places, self.linear, self.angular))

    def missed(self, reference: "Example") -> int:
        """Contacts of a body's points with another body, over all steps, that the reference has and this run lacks."""
        return sum(
            int(np.unpackbits(there & ~here).sum()) for there, here in zip(reference.touched, self.touched, strict=True)
        )

    def touching(self, step: int = -1) -> np.ndarray:
        """Pairs ``(P, 2)`` in contact in a step."""
        count = len(self.scene.kinds)
        found = np.unpackbits(self.touched[step], count=count * count).reshape(count, count)
        return np.argwhere(np.triu(found | found.T))

    def extra(self, reference: "Example") -> dict[str, Any]:
        """``touching``: pairs in contact, per step."""
        steps = range(len(self.touched))
        return {"touching": round(sum(len(self.touching(step)) for step in steps) / len(steps))}

    def render(self, folder: Path) -> list[Path]:
        """Draw the present state; see ``pictures``."""
        return draw_with("sims.pile.pictures", folder, pile_data({"this run": self})).paths


def pile_data(examples: dict[str, Example]) -> dict[str, np.ndarray]:
    """What the picture needs: the bodies, and which pairs each run leaves, by its name."""
    run = next(iter(examples.values()))
    data = {"places": run.places.numpy(), "kinds": run.scene.kinds, "side": np.array(run.scene.bodies.side)}
    for number, shape in enumerate(run.scene.shapes.values()):
        data |= {f"vertices{number}": shape.vertices, f"faces{number}": shape.faces}
    data["touching"] = run.touching()
    for number, (name, example) in enumerate(examples.items()):
        data |= {f"left{number}": example.left, f"name{number}": np.array(name)}
    return data
