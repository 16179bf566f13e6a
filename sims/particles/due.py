"""A broad phase that skips the steps in which nothing can happen to a drop, by times of first possible contact.

A distance to the moving mesh, with the speed of its points, bounds *when* a drop can first touch it: the drop's way
over the next steps is a segment of time and space, and marching along it (``segments``) clears all steps before some
time. Until then the drop is not asked again. A new life, and a drop that was pushed, is queried at once.

*Why no contact is lost.* With the velocity v and the acceleration a of now, a drop is, k steps later, within ``k (k +
1) / 2 |a| DT^2`` of ``x + k DT v``: drag makes the acceleration shrink from step to step (``kernels.integrate``). That
is the radius of the ball that is swept, and ``ROUNDING`` more: float32 moves each of at most ``AHEAD`` places by an ulp
of coordinates under 4, and times by as little, at which no point of the mesh moves faster than a few units a second.
The mesh is dilated by the contact distance (``Scene.margin``). What is cleared up to a time has no contact in the steps
before it.
"""

from functools import cache

import warp as wp

import warp_bounding as wb
from sims.particles.kernels import DRAG, DT, GRAVITY, WIND
from sims.particles.scene import PERIOD, Scene

__all__ = ["AHEAD", "WhenDue"]

AHEAD = 40  # steps that are looked ahead at most
STEPS = 6  # of a march
SHARE = 0.5  # of the distance now that the radius of the swept ball may take
ROUNDING = 1e-4  # object units
SHORTER = 1.0 - 2.0**-20  # of a time, which is rounded when it is turned into steps


@cache
def _asking(distance: wp.Function, segment: wp.Function) -> wp.Kernel:
    """The kernel that asks about the drops that are due."""

    @wp.kernel(module="unique", enable_backward=False)
    def ask(
        first: int,
        # inputs
        data: wb.Data,
        time: float,
        step: int,
        ahead: int,
        positions: wp.array(dtype=wp.vec3),
        velocities: wp.array(dtype=wp.vec3),
        lives: wp.array(dtype=wp.int32),
        # outputs
        known: wp.array(dtype=wp.int32),
        due: wp.array(dtype=wp.int32),
        mask: wp.array(dtype=wp.bool),
        asked: wp.array(dtype=wp.bool),
    ):
        thread, _ = wp.tid()
        i = first + thread
        mask[i] = False
        asked[i] = False
        if lives[i] == known[i] and step < due[i]:
            return
        known[i] = lives[i]
        asked[i] = True
        due[i] = step + 1
        x, v = positions[i], velocities[i]
        start = wp.vec4(time, x[0], x[1], x[2])
        free = distance(data, start)
        if not free > 0.0:
            mask[i] = True
            return
        pull = 0.5 * wp.length(wp.vec3(0.0, -GRAVITY, 0.0) - DRAG * (v - wp.vec3(WIND, 0.0, 0.0))) * (DT * DT)
        most = float(ahead)
        if most * most * pull > SHARE * free:  # looking that far ahead would take more room than there is
            most = wp.floor(wp.sqrt(SHARE * free / pull))
        if most >= 1.0:
            away = x + v * (DT * most)
            radius = most * (most + 1.0) * pull + ROUNDING
            end = wp.vec4(time + DT * most, away[0], away[1], away[2])
            maybe, t = segment(data, start, end, radius, STEPS)
            clear = wp.int32(wp.ceil(t * most * SHORTER)) - 1  # the last step before t, from this one on
            if not maybe:
                clear = wp.int32(most)
            due[i] = step + wp.max(clear, 0) + 1

    return ask


class WhenDue:
    """A bounder of the distance to the moving mesh, asked about drops whose time has come.

    Args:
        bounder: Of ``Scene.shape``.
        scene: Whose motion it bounds.

    Attributes:
        asked: ``(N,)`` bool, true where a drop was queried in the last step.
    """

    def __init__(self, bounder: wb.DistanceBounder, scene: Scene):
        self.bounder, self.device = bounder, scene.device
        self._arrays: tuple[wp.array, ...] = ()
        self._step = 0

    def watch(self, *arrays: wp.array) -> None:
        """The drops' velocities and lives, which a run changes in place."""
        self._arrays, self._step = arrays, 0
        count = len(arrays[0])
        self._known = wp.full(count, -1, dtype=wp.int32, device=self.device)
        self._due = wp.zeros(count, dtype=wp.int32, device=self.device)
        self._mask, self.asked = (wp.zeros(count, dtype=wp.bool, device=self.device) for _ in range(2))

    def candidates(self, time: float, points: wp.array, positions: wp.array) -> tuple[wp.array, wp.array]:
        """Particles that may touch the mesh; see ``MovingBox.candidates``."""
        self._step += 1
        ahead = max(min(AHEAD, int((PERIOD - time) / DT)), 0)  # the motion is known to the end of its period
        inputs = [self.bounder.data, time, self._step, ahead, positions, *self._arrays]
        kernel = _asking(self.bounder.distance_func, self.bounder.segment_func)
        outputs = [self._known, self._due, self._mask, self.asked]
        wb.launch_on_cores(kernel, len(positions), inputs, outputs, self.device)
        return wb.compact(self._mask)
