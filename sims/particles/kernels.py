"""Rain on the Stanford bunny: the simulation of ``sims.particles``.

Particles fall, meet the bunny, slide off it and begin again at the top. Each step integrates all particles, asks the
bounder for the candidates (broad phase) and pushes those out of the mesh (narrow phase: the signed closest point of a
``wp.Mesh``, as in Warp's own ``example_mesh.py``). Runs with and without a bounder start from the same state, and
must end in the same state, *to the bit*.

Why they do. The narrow phase writes to a particle only where it finds a contact, and it is the same compiled kernel in
all runs, so leaving out a particle without a contact changes nothing. A particle with a contact is never left out:

* An *outside* sign: the closest point that the narrow phase computes lies on some face, up to rounding, so a computed
  distance under the contact distance means a true one under contact distance + rounding. The bounder is proven for the
  object dilated by just that (``Scene.margin``), inside and all.
* An *inside* sign: the particle is in the solid, which is a part of what the bounder is proven for, if the sign is
  right. ``mesh_query_point_sign_normal``, which Warp's example takes, is not always: where several faces are equally
  close it can name the wrong side. Of 8 million random points around the bunny it called one *inside* that was 0.21
  away from it, and a run asks 15 million times. ``mesh_query_point_sign_parity`` called none of them inside that was
  outside the bounded cells, and differed from winding numbers at 3 of 1.7 million points, all within 3e-8 of the
  surface. It costs a tenth more; and where its one ray says *inside*, three vote. That is evidence, not a proof: so
  every run's contacts are compared with the reference's, step by step.

What this does not do: particles do not meet each other, and the mesh does not move.
"""

import os
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from sims.cores import launch_on_all_cores

__all__ = ["DT", "RADIUS", "Example", "Scene"]

RADIUS = 0.01  # of a particle: the contact distance, object units (the bunny is 1.6 of them high)
DT = 1.0 / 120.0
GRAVITY = 9.81
DRAG = 2.8  # per second: rain falls at GRAVITY / DRAG
WIND = 0.45  # along x
FRICTION = 0.2
RESTITUTION = 0.25
LONGEST_LIFE = 180  # steps; what comes to rest in a hollow begins again, too
MARGIN_AROUND = 0.45  # of the rain, around the bunny
FALL = 0.9  # from the top of the rain to the bunny's
REACH = 0.43  # of the narrow phase: no point of the bunny is deeper (0.424), so that whatever is inside is pushed out
RAYS = 3  # that confirm an inside sign
ROUNDING = 32 * 2.0**-24  # of a computed distance, relative to the largest coordinate; see Scene.margin


@wp.struct
class Rain:
    """The box that the rain falls through, upper face shifted into the wind."""

    lower: wp.vec3
    upper: wp.vec3
    shift: float
    speed: float


@wp.kernel(enable_backward=False)
def integrate(
    # inputs
    first: int,
    rain: Rain,
    seed: int,
    # outputs
    positions: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
    ages: wp.array(dtype=wp.int32),
    lives: wp.array(dtype=wp.int32),
    contacts: wp.array(dtype=wp.uint8),
):
    """Move one particle, as if there were no bunny. A new life begins at a place that depends on seed, particle and life only."""
    i = first + wp.tid()
    x = wp.vec3(positions[i])
    v = wp.vec3(velocities[i])
    age = ages[i] + 1
    if x[1] < rain.lower[1] or age > LONGEST_LIFE:
        life = lives[i] + 1
        lives[i] = life
        age = 0
        state = wp.rand_init(seed + 7919 * life, i)
        x = wp.vec3(
            rain.lower[0] + wp.randf(state) * (rain.upper[0] - rain.lower[0]) - rain.shift,
            rain.upper[1] + wp.randf(state) * rain.speed * DT,
            rain.lower[2] + wp.randf(state) * (rain.upper[2] - rain.lower[2]),
        )
        v = wp.vec3(WIND, -rain.speed, 0.0)
    v = v + (wp.vec3(0.0, -GRAVITY, 0.0) - DRAG * (v - wp.vec3(WIND, 0.0, 0.0))) * DT
    positions[i] = x + v * DT
    velocities[i] = v
    ages[i] = age
    contacts[i] = wp.uint8(0)


@wp.kernel(enable_backward=False)
def collide(
    # inputs
    first: int,
    mesh: wp.uint64,
    candidates: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    # outputs
    positions: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
    contacts: wp.array(dtype=wp.uint8),
):
    """Push one candidate out to the contact distance, with friction and a little bounce; write only if it is in contact."""
    item = first + wp.tid()
    if item >= count[0]:
        return
    i = candidates[item]
    x = positions[i]
    query = wp.mesh_query_point_sign_parity(mesh, x, REACH)
    if not query.result:
        return
    if query.sign < 0.0:  # seldom, and a wrong one would do harm: let more rays confirm it
        query = wp.mesh_query_point_sign_parity(mesh, x, REACH, RAYS)
    away = x - wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    distance = wp.length(away) * query.sign
    if distance >= RADIUS:
        return
    n = wp.mesh_eval_face_normal(mesh, query.face)  # for a particle that lies in the surface itself
    if wp.length(away) > 0.0:
        n = wp.normalize(away) * query.sign
    v = velocities[i]
    into = wp.dot(v, n)
    if into < 0.0:
        along = v - n * into
        sliding = wp.length(along)
        kept = 0.0
        if sliding > 0.0:
            kept = wp.max(0.0, 1.0 + FRICTION * into / sliding)
        velocities[i] = along * kept - n * (RESTITUTION * into)
    positions[i] = x + n * (RADIUS - distance)
    contacts[i] = wp.uint8(1)


@dataclass(frozen=True, eq=False)
class Scene:
    """What all runs share.

    Attributes:
        shape: The mesh that it rains on, y up.
        device: Warp device.
    """

    shape: wb.IndicatorMesh
    device: wp.Device

    @classmethod
    def bunny(cls, device: str | None = None) -> "Scene":
        """The Stanford bunny that ships in warp-lang."""
        import warp.examples

        path = os.path.join(warp.examples.get_asset_directory(), "bunny.usd")
        return cls(wb.load_indicator(path), wp.get_device(device))

    @property
    def margin(self) -> float:
        """What a bounder's object must be dilated by: contact distance plus the narrow phase's own rounding error.

        With u = 2^-24 and c the largest coordinate of the mesh: three products, two sums and the third barycentric
        coordinate put the computed closest point within 7 u c of its face per axis; difference and length add 4 u
        times the distance, which is small: under 16 u c in all. Twice that is allowed for.
        """
        return RADIUS + ROUNDING * float(np.abs(self.shape.bounds).max())

    @cached_property
    def mesh(self) -> wp.Mesh:
        """The narrow phase's mesh."""
        points = wp.array(self.shape.vertices, dtype=wp.vec3, device=self.device)
        indices = wp.array(self.shape.faces.reshape(-1), dtype=wp.int32, device=self.device)
        return wp.Mesh(points=points, indices=indices)

    @cached_property
    def rain(self) -> Rain:
        """Where it rains."""
        lower, upper = self.shape.bounds + np.array([[-MARGIN_AROUND], [MARGIN_AROUND]])
        rain = Rain()
        rain.lower = wp.vec3(lower[0], self.shape.bounds[0, 1] - RADIUS, lower[2])
        rain.upper = wp.vec3(upper[0], self.shape.bounds[1, 1] + FALL, upper[2])
        rain.speed = GRAVITY / DRAG
        rain.shift = WIND / rain.speed * (rain.upper[1] - rain.lower[1]) / 2
        return rain

    def drops(self, particles: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rain in full fall, as if there were no bunny: some drops begin inside it, and the narrow phase must catch them.

        Returns:
            Positions ``(N, 3)`` float32, velocities ``(N, 3)`` float32, ages ``(N,)`` int32 in steps.
        """
        rain, rng = self.rain, np.random.default_rng(seed)
        x = np.array(rain.lower) + rng.random((particles, 3)) * (np.array(rain.upper) - np.array(rain.lower))
        fallen = rain.upper[1] - x[:, 1]
        x[:, 0] += WIND / rain.speed * fallen - rain.shift
        v = np.tile([WIND, -rain.speed, 0.0], (particles, 1))
        return x.astype(np.float32), v.astype(np.float32), (fallen / (rain.speed * DT)).astype(np.int32)


class Example:
    """One run of the simulation.

    Attributes:
        seconds: Per step: broad phase, narrow phase, whole step.
        calls: Per step: particles that the narrow phase was called for.
        touched: Per step: which particles were in contact, packed bits.
    """

    def __init__(self, scene: Scene, bounder: wb.Bounder | None = None, *, particles: int = 100_000, seed: int = 0):
        """Start from the scene's first state.

        Args:
            scene: Shared by all runs that are to be compared.
            bounder: The broad phase; ``None`` for none. Proven for the scene's shape with at least its margin.
            particles: How many.
            seed: Of the first state and of every new life.
        """
        self.scene, self.bounder, self.particles, self.seed = scene, bounder, particles, seed
        device = scene.device
        positions, velocities, ages = scene.drops(particles, seed)
        self.positions = wp.array(positions, dtype=wp.vec3, device=device)
        self.velocities = wp.array(velocities, dtype=wp.vec3, device=device)
        self.ages = wp.array(ages, dtype=wp.int32, device=device)
        self.lives = wp.zeros(particles, dtype=wp.int32, device=device)
        self.contacts = wp.zeros(particles, dtype=wp.uint8, device=device)
        self._everyone = wp.array(np.arange(particles), dtype=wp.int32, device=device)
        self._count = wp.array([particles], dtype=wp.int32, device=device)
        self.seconds: list[tuple[float, float, float]] = []
        self.calls: list[int] = []
        self.touched: list[np.ndarray] = []

    def step(self) -> None:
        """One step, timed phase by phase."""
        start = self._now()
        state = [self.positions, self.velocities, self.ages, self.lives, self.contacts]
        self._launch(integrate, self.particles, [self.scene.rain, self.seed], state)
        moved = self._now()
        candidates, count = self._everyone, self._count
        if self.bounder is not None:
            candidates, count = self.bounder.candidates(self.positions)
        # A CPU reads the count in place; elsewhere the launch covers everyone, and threads from count on return at once.
        items = int(count.numpy()[0]) if self.scene.device.is_cpu else self.particles
        found = self._now()
        inputs = [self.scene.mesh.id, candidates, count]
        self._launch(collide, items, inputs, [self.positions, self.velocities, self.contacts])
        end = self._now()
        self.seconds.append((found - moved if self.bounder is not None else 0.0, end - found, end - start))
        self.calls.append(int(count.numpy()[0]))
        self.touched.append(np.packbits(self.contacts.numpy()))

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list, outputs: list) -> None:
        launch_on_all_cores(kernel, count, inputs, outputs, self.scene.device)

    def _now(self) -> float:
        wp.synchronize_device(self.scene.device)
        return time.perf_counter()

    def state(self) -> bytes:
        """Everything that the next step depends on."""
        return b"".join(a.numpy().tobytes() for a in (self.positions, self.velocities, self.ages, self.lives))

    def missed(self, reference: "Example") -> int:
        """Contacts that the reference, a run of the same length without a broad phase, has and this run lacks."""
        pairs = zip(reference.touched, self.touched, strict=True)
        return sum(int(np.unpackbits(there & ~here).sum()) for there, here in pairs)

    def milliseconds(self) -> tuple[float, float, float]:
        """Median per step: broad phase, narrow phase, whole step."""
        return tuple(1e3 * np.median(self.seconds, axis=0))

    def render(self, folder: Path) -> list[Path]:
        """Draw the present state; see ``sims.pictures``."""
        from sims.pictures import rain_data, render

        return render(folder, rain_data(self)).paths

    def test_final(self, reference: "Example") -> None:
        """Check this run against one without a broad phase.

        Raises:
            AssertionError: If a contact was missed or a bit of the state differs.
        """
        missed = self.missed(reference)
        assert missed == 0, f"{missed} contacts were missed"
        assert self.state() == reference.state(), "the final states differ"
