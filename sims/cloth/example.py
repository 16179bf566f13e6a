"""One run of the cloth: Newton's collision pass, cut down by bounders or not, and Newton's XPBD solver.

Each step is looked at twice. The timed part asks the bounders for the pairs that may touch (broad phase), lets Newton
go through them (narrow phase) and solves. Outside of it the pass is repeated for *all* pairs of the very same state: a
contact that this has and the run lacks is *missed*. Runs that have never missed one have the same contacts, record by
record, as the reference, which has no broad phase, and end in the same state to the bit; hashes of both are compared,
too, and do not rely on that argument.

Newton's kernels run one after another on one core of a CPU, so the order of contacts and of all sums is the same each
time. On CUDA it is not, in Newton itself, and bits could not be compared: this demo runs on a CPU.
"""

import time
from contextlib import nullcontext
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import newton
import numpy as np

import warp_bounding as wb
from sims import base
from sims.cloth.scene import DT, GAP, RADIUS, Scene, shape
from sims.drawing import CAPTIONS, draw_with
from sims.threads import threads_of
from warp_bounding.newton import Cull

__all__ = ["Example", "cloth_data", "contact_keys", "contact_records"]

ITERATIONS = 4  # of the solver
LOOKED = 10  # steps from one look at the depths to the next
RECORDS = ("particle", "shape", "indices", "barycentric", "body_pos", "body_vel", "normal")


def contact_records(contacts: newton.Contacts) -> list[np.ndarray]:
    """Everything that Newton has written of its particle-shape contacts, a row a contact, in Newton's order."""
    count = int(contacts.soft_contact_count.numpy()[0])
    return [getattr(contacts, f"soft_contact_{name}").numpy()[:count] for name in RECORDS]


def contact_keys(contacts: newton.Contacts, shapes: int) -> np.ndarray:
    """``(C,)`` int64, a number for each contact's particle and shape."""
    particle, shape = contact_records(contacts)[:2]
    return particle.astype(np.int64) * shapes + shape


def _digest(arrays: list[np.ndarray]) -> bytes:
    digest = blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.int64(len(array)).tobytes() + np.ascontiguousarray(array).tobytes())
    return digest.digest()


class Example(base.Example):
    """One run of the simulation.

    Attributes:
        seconds: Per step: broad phase, narrow phase, whole step (solver included).
        calls: Per step: pairs that Newton's pass went through.
        touched: Contacts of all steps so far.
        digests: Per step: of the state that it began with and of its contacts, record by record.
        deepest: How far the deepest particle's centre has been under a surface, world units, looked at every tenth step
            and at the end.
    """

    DIFFER = "contacts, states on the way or the final states differ"

    def __init__(
        self,
        scene: Scene,
        bounders: dict[str, wb.Bounder] | None = None,
        *,
        unproven: bool = False,
        all_cores: bool = False,
    ):
        """Start from the scene's first state.

        Args:
            scene: Shared by all runs that are to be compared.
            bounders: By name of the shape; ``None`` for no broad phase.
            unproven: Take bounders without a proof, too.
            all_cores: Let the broad phase use all cores; else it has one, as Newton has.

        Raises:
            BounderError: For a bounder that is not of its shape, has too small a margin or no proof.
        """
        super().__init__()
        self.scene, self.model = scene, scene.model
        self.state, self._next = self.model.state(), self.model.state()
        self._pipeline = newton.CollisionPipeline(self.model, soft_contact_gap=GAP)
        self._contacts, self._all = self._pipeline.contacts(), self._pipeline.contacts()
        self._control = self.model.control()
        self._solver = newton.solvers.SolverXPBD(self.model, iterations=ITERATIONS)
        self._threads = nullcontext if all_cores else partial(threads_of, 1)  # as Newton's kernels on a CPU
        self._cull = None
        if bounders is not None:
            of_shape = {scene.indices[name]: bounder for name, bounder in bounders.items()}
            self._cull = Cull(self._pipeline, of_shape, unproven=unproven)
        self.digests: list[bytes] = []
        self.touched = self._missed = 0
        self.deepest = 0.0

    def step(self) -> None:
        """One step, timed phase by phase."""
        with self._threads():
            begin = time.perf_counter()
            kept = None if self._cull is None else self._cull.candidates(self.state)
            found = time.perf_counter()
            if self._cull is None:
                self._pipeline.collide(self.state, self._contacts)
            else:
                self._cull.collide(self.state, self._contacts, candidates=kept)
            touched = time.perf_counter()
        self._audit()
        solving = time.perf_counter()
        self.state.clear_forces()
        self._solver.step(self.state, self._next, self._control, self._contacts, DT)
        self.state, self._next = self._next, self.state
        solved = time.perf_counter() - solving
        broad = 0.0 if self._cull is None else found - begin
        self.seconds.append((broad, touched - found, touched - begin + solved))
        if len(self.seconds) % LOOKED == 0:
            self.look()

    def _audit(self) -> None:
        """Compare the contacts with those of a pass over all pairs."""
        self.calls.append(len(self._pipeline.soft_rigid_contact_pairs) if self._cull is None else self._cull.survivors)
        self._pipeline.collide(self.state, self._all)
        here, there = (contact_keys(contacts, self.model.shape_count) for contacts in (self._contacts, self._all))
        self._missed += len(np.setdiff1d(there, here))
        self.touched += len(here)
        before = [self.state.particle_q.numpy(), self.state.particle_qd.numpy()]
        self.digests.append(_digest([*before, *contact_records(self._contacts)]))

    def look(self) -> np.ndarray:
        """Depths of the particles' centres, ``(N,)`` float32, world units; ``deepest`` takes note of them."""
        depths = self.scene.depths(self.state.particle_q)
        self.deepest = max(self.deepest, float(depths.max()))
        return depths

    def missed(self, reference: base.Example | None = None) -> int:
        """Contacts, of all steps so far, that a pass over all pairs of the run's own states has and the run lacks."""
        return self._missed

    def final(self) -> bytes:
        """Positions and velocities, bit by bit."""
        return self.state.particle_q.numpy().tobytes() + self.state.particle_qd.numpy().tobytes()

    def identical(self, reference: "Example") -> bool:
        """Whether all states and contacts, and the end, are those of a run, record by record and to the bit."""
        return self.digests == reference.digests and self.final() == reference.final()

    def extra(self, reference: base.Example) -> dict[str, Any]:
        """``contacts``, and how deep the ``deepest`` particle has been."""
        return {"contacts": self.touched, "deepest": self.deepest}

    def render(self, folder: Path) -> list[Path]:
        """Draw the present state; see ``sims.cloth.pictures``."""
        return draw_with("sims.cloth.pictures", folder, cloth_data({"cloth": self})).paths


def cloth_data(examples: dict[str, Example], reference: Example | None = None) -> dict[str, np.ndarray]:
    """What the picture needs.

    Args:
        examples: By name; a panel each.
        reference: The run without a broad phase, to say of a panel that it is identical to it.

    Returns:
        Arrays by name.
    """
    data = {"names": np.array(list(examples)), "radius": np.array(RADIUS)}
    for number, (name, example) in enumerate(examples.items()):
        scene, depths = example.scene, example.look()
        data["triangles"] = scene.triangles
        for solid in scene.indices:
            data[f"{solid}_vertices"], data[f"{solid}_faces"] = scene.world_vertices(solid), shape(solid).faces
        data["shapes"] = np.array(list(scene.indices))
        data[f"positions{number}"] = example.state.particle_q.numpy()
        data[f"depths{number}"] = depths
        head = CAPTIONS.get(name, name)
        under, deepest = int((depths > 0).sum()), example.deepest
        below = f"{under} particles under the surface" + (f" (red), the deepest {deepest:.3f}" if under else "")
        missed = f"{example.missed():,} contacts missed"
        if reference is not None and example is not reference and example.identical(reference):
            missed += "; identical to the run without a bounder, to the bit"
        data[f"caption{number}"] = np.array(f"{head}\n{missed}\n{below}")
    return data
