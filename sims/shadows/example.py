"""A still life with shadows, one picture a place of the sun, with and without bounders (``sims.shadows.scene``)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warp_bounding as wb
from sims import base
from sims.shadows.kernels import cast, face_sun, stop
from sims.shadows.pictures import draw_one
from sims.shadows.scene import LENGTH, LIFT, REACH, TOLERANCE, Scene

__all__ = ["Example", "candidates", "check_rays"]


def check_rays(bounder: wb.Bounder, source: str) -> None:
    """Refuse a bounder whose rays are not those of the demo. One of distances is asked about rays of any length.

    Raises:
        BounderError: For another kind of query, or another length of rays.
    """
    if bounder.of_distances:
        return
    if bounder.query_kind != "ray":
        raise wb.BounderError(f"{source}: expected a bounder of rays or distances, got one of {bounder.query_kind}s")
    if bounder.domain.length != LENGTH:
        got = bounder.domain.length
        raise wb.BounderError(f"{source}: expected a bounder of rays of length {LENGTH:g}, got length {got:g}")


def candidates(bounder: wb.Bounder, rays: wp.array) -> tuple[wp.array, wp.array]:
    """Indices of the rays that may meet the object, and a number: how many they are."""
    if bounder.of_distances:
        return wb.compact(bounder.rays(rays, length=LENGTH)[0])
    return bounder.candidates(rays)


class Example(base.Example):
    """Pictures of a still life, one after another.

    Attributes:
        seconds: Per picture: broad phase, narrow phase, whole step.
        rays: Per picture: shadow rays.
        calls: Per picture: pairs of a shadow ray and an object that the narrow phase was called for.
        hits: Per picture: those of them that met the object.
        shadows: Per picture: ``(H, W)`` uint8, bit k - 1 set where the k-th object stops the pixel's ray.
    """

    LOST = "shadow pixels were lost"
    DIFFER = "the pictures differ"

    def __init__(
        self,
        scene: Scene,
        bounders: Mapping[str, wb.Bounder] | None = None,
        *,
        steps: int = 8,
        sun: float | None = None,
    ):
        """Begin with the first place of the sun.

        Args:
            scene: Shared by all series that are to be compared.
            bounders: The broad phase: for each object of the scene, by name, one of its rays or distances; ``None`` for
                none.
            steps: Places of the sun, evenly over the day; after that many pictures it begins again.
            sun: One time of the day instead, from 0 to 1.

        Raises:
            BounderError: If an object has no bounder, or one of other rays or queries.
        """
        super().__init__()
        self.scene, self.bounders = scene, None if bounders is None else dict(bounders)
        if bounders is not None:
            if set(bounders) != set(scene.shapes):
                expected, got = ", ".join(scene.shapes), ", ".join(bounders)
                raise wb.BounderError(f"expected a bounder for each of {expected}, got some for {got}")
            for name, bounder in bounders.items():
                check_rays(bounder, name)
        self.suns = scene.suns((np.arange(steps) + 0.5) / steps if sun is None else np.array([sun]))
        self._everyone = wp.array(np.arange(len(scene.seen.pixels)), dtype=wp.int32, device=scene.device)
        self.rays: list[int] = []
        self.hits: list[int] = []
        self.shadows: list[np.ndarray] = []

    def cast(self, sun: np.ndarray) -> tuple[np.ndarray, wp.array]:
        """Queries with the sun in a direction: numbers of the pixels that face it, and rays ``(N, 6)`` float32."""
        device, seen, towards = self.scene.device, self.scene.seen, wp.vec3(*map(float, sun))
        facing = wp.empty(len(seen.pixels), dtype=wp.bool, device=device)
        wb.launch_on_cores(face_sun, len(seen.pixels), [towards, seen.normals], [facing], device)
        chosen = np.flatnonzero(facing.numpy()).astype(np.int32)
        rays = wp.empty((len(chosen), 6), dtype=float, device=device)
        lit = wp.array(chosen, dtype=wp.int32, device=device)
        wb.launch_on_cores(cast, len(chosen), [towards, LIFT, lit, seen.points, seen.normals], [rays], device)
        return chosen, rays

    def step(self) -> None:
        """One picture of shadows, timed phase by phase. What the camera sees is known before."""
        scene, device, seen = self.scene, self.scene.device, self.scene.seen
        start = base.now(device)
        chosen, rays = self.cast(self.suns[len(self.shadows) % len(self.suns)])
        count = len(chosen)
        all_of_them = wp.array([count], dtype=wp.int32, device=device)
        shadow = np.zeros(scene.camera.width * scene.camera.height, dtype=np.uint8)
        broad = narrow = 0.0
        calls = hits = 0
        for bit, (name, mesh) in enumerate(scene.meshes.items()):
            stopped = wp.zeros(count, dtype=wp.bool, device=device)
            left, some, items = self._everyone, all_of_them, count
            begin = base.now(device)
            if self.bounders is not None and count:
                left, some = candidates(self.bounders[name], rays)
                items = int(some.numpy()[0])
            found = base.now(device)
            wb.launch_on_cores(stop, items, [mesh.id, rays, REACH, TOLERANCE, left, some], [stopped], device)
            end = base.now(device)
            broad += found - begin if self.bounders is not None else 0.0
            narrow += end - found
            calls += items
            answers = stopped.numpy()
            hits += int(np.count_nonzero(answers))
            shadow[seen.pixels[chosen]] |= answers << np.uint8(bit)
        self.shadows.append(shadow.reshape(scene.camera.height, scene.camera.width))
        self.seconds.append((broad, narrow, base.now(device) - start))
        self.rays.append(count)
        self.calls.append(calls)
        self.hits.append(hits)

    def state(self) -> bytes:
        """All pictures: which object stops the ray of which pixel."""
        return b"".join(shadow.tobytes() for shadow in self.shadows)

    def lost(self, reference: "Example", step: int = -1) -> np.ndarray:
        """``(H, W)`` bool: pixels of a picture in shadow without a broad phase, and not here."""
        return (reference.shadows[step] != 0) & (self.shadows[step] == 0)

    def missed(self, reference: "Example") -> int:
        """Shadow pixels of a series of the same length without a broad phase which this one lacks."""
        return sum(int(self.lost(reference, step).sum()) for step in range(len(reference.shadows)))

    def extra(self, reference: "Example") -> dict[str, Any]:
        """``hits``: calls that found the ray stopped."""
        return {"hits": sum(self.hits)}

    def render(self, folder: Path) -> list[Path]:
        """Draw the last picture, ``shadows.png``; see ``sims.shadows.pictures``."""
        return [draw_one(self, Path(folder))]
