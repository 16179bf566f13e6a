"""The bunny that turns, twists and swells, the rain around it, and the space and time that bounders cover.

Why a run with a proven bounder ends as the one without, *to the bit*. The narrow phase writes to a particle only where
it finds a contact (``kernels``), and a particle with a contact is never left out:

* An *outside* sign: the closest point that the narrow phase computes lies on some face, up to rounding, so a computed
  distance under the contact distance means a true one under contact distance + rounding. The bounder is proven for the
  object dilated by just that (``Scene.margin``), inside and all, at every time, not at samples of it, and with vertices
  as the simulation rounds them (``MovingMesh.vertices_at``).
* An *inside* sign: the particle is in the solid, which is a part of what the bounder is proven for, if the sign is
  right. ``mesh_query_point_sign_normal``, which Warp's example takes, is not always: where several faces are equally
  close it can name the wrong side. Of 8 million random points around the bunny at rest it called one *inside* that was
  0.21 away from it, and a run asks 15 million times. ``mesh_query_point_sign_parity`` called none of them inside that
  was not in the dilated object. It costs a tenth more; and where its one ray says *inside*, three vote. That is
  evidence, not a proof: so every run's contacts are compared with the reference's, step by step.

What this does not do: particles do not meet each other.
"""

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

import warp_bounding as wb
from sims.assets import asset_mesh
from sims.particles.kernels import DRAG, DT, GRAVITY, RADIUS, WIND, Rain

__all__ = ["PERIOD", "Scene", "moving"]

PERIOD = 1.25  # seconds: the bunny's motion repeats
KEYFRAMES = 51
TURN, TWIST = np.radians(35.0), np.radians(15.0)  # of the whole, and of its head against its feet
SWELL = 0.1  # of its height, at constant volume
GRAIN = 2.0**16  # vertices lie on multiples of 1 / GRAIN, so that they are the same wherever sines are computed
RESOLUTION, TIME_CELLS = 48, 50
AROUND = 0.45  # of the rain, around the bunny
FALL = 0.9  # from the top of the rain to the bunny's
ROUNDING = 32 * 2.0**-24  # of a computed distance, relative to the largest coordinate; see Scene.margin


def moving(mesh: wb.shapes.Mesh) -> wb.shapes.MovingMesh:
    """A mesh that turns to and fro about the vertical, twists, swells and shrinks, once a period."""
    rest = mesh.vertices.astype(np.float64)
    lower, upper = mesh.bounds
    foot = np.array([(lower[0] + upper[0]) / 2, lower[1], (lower[2] + upper[2]) / 2])
    height = (rest[:, 1] - foot[1]) / (upper[1] - lower[1])
    frames = []
    for phase in np.linspace(0.0, 2 * np.pi, KEYFRAMES):
        angle = TURN * np.sin(phase) + TWIST * np.sin(2 * phase) * height
        tall = 1.0 + SWELL * np.sin(phase)
        x, y, z = ((rest - foot) * [tall**-0.5, tall, tall**-0.5]).T
        turned = [np.cos(angle) * x + np.sin(angle) * z, y, np.cos(angle) * z - np.sin(angle) * x]
        frames.append(np.stack(turned, axis=1) + foot)
    times = np.linspace(0.0, PERIOD, KEYFRAMES)
    name = f"moving {os.path.basename(mesh.name)}"
    return wb.shapes.MovingMesh(np.rint(np.array(frames) * GRAIN) / GRAIN, mesh.faces, times, TIME_CELLS, name=name)


@dataclass(frozen=True, eq=False)
class Scene:
    """What all runs share.

    Attributes:
        motion: The mesh that it rains on, y up.
        device: Warp device.
    """

    motion: wb.shapes.MovingMesh
    device: wp.Device

    @classmethod
    def bunny(cls, device: str | None = None) -> "Scene":
        """The moving bunny.

        Raises:
            DeviceError: If there is no such device.
        """
        return cls(moving(asset_mesh("bunny")), wb.device_of(device))

    @property
    def margin(self) -> float:
        """What a bounder's object must be dilated by: contact distance plus the narrow phase's own rounding error.

        With u = 2^-24 and c the largest coordinate of the mesh: three products, two sums and the third barycentric
        coordinate put the computed closest point within 7 u c of its face per axis; difference and length add 4 u times
        the distance, which is small: under 16 u c in all. Twice that is allowed for.
        """
        return RADIUS + ROUNDING * float(np.abs(self.motion.bounds).max())

    @cached_property
    def shape(self) -> wb.shapes.MovingMesh:
        """What bounders must hold: the motion, dilated by the margin at every time."""
        return self.motion.dilated(self.margin)

    @cached_property
    def core(self) -> wb.shapes.MovingMesh:
        """What bounders from the inside must lie in: what the narrow phase finds in contact whatever it rounds.

        That is the motion, dilated by the contact distance less the rounding error, where ``margin`` adds it.
        """
        return self.motion.dilated(2 * RADIUS - self.margin)

    def grid(self, resolution: int = RESOLUTION) -> wb.shapes.Grid:
        """The cells of time and space that ``shape`` meets, for methods that are made of cells."""
        return self.shape.to_grid(resolution=resolution)

    def time(self, step: int) -> float:
        """Time within the period, float32, mid step: never the range's ends, where bounders say *maybe*."""
        return float(np.float32(((step + 0.5) * DT) % PERIOD))

    @cached_property
    def rain(self) -> Rain:
        """Where it rains."""
        bounds = self.motion.bounds
        lower, upper = bounds + np.array([[-AROUND], [AROUND]])
        rain = Rain()
        rain.lower = wp.vec3(lower[0], bounds[0, 1] - RADIUS, lower[2])
        rain.upper = wp.vec3(upper[0], bounds[1, 1] + FALL, upper[2])
        rain.speed = GRAVITY / DRAG
        rain.shift = WIND / rain.speed * (rain.upper[1] - rain.lower[1]) / 2
        return rain

    def drops(self, particles: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rain in full fall, as if there were no bunny: some drops begin inside it.

        Returns:
            Positions ``(N, 3)`` float32, velocities ``(N, 3)`` float32, ages ``(N,)`` int32 in steps.
        """
        rain, rng = self.rain, np.random.default_rng(seed)
        x = np.array(rain.lower) + rng.random((particles, 3)) * (np.array(rain.upper) - np.array(rain.lower))
        fallen = rain.upper[1] - x[:, 1]
        x[:, 0] += WIND / rain.speed * fallen - rain.shift
        v = np.tile([WIND, -rain.speed, 0.0], (particles, 1))
        return x.astype(np.float32), v.astype(np.float32), (fallen / (rain.speed * DT)).astype(np.int32)
