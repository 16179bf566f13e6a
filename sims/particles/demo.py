"""The demo ``particles``: 100,000 particles rain on the Stanford bunny while it turns, twists and swells.

The classic broad phase is a box, fitted to the mesh anew in every step; a bounder of the motion is asked about time
and place, and is never refitted. A bounder of the *distance* to the motion is queried when a drop can first touch it,
and skips the steps until then. Two narrow phases, because the answer depends on them: robust *containment* looks for
the closest point wherever a particle may be inside, near *contact* only as far as a particle falls in a step. And once
the bunny is *porous*: drops seep through it, slowly, so that the narrow phase only has to say which ones are in it;
there a bounder from the inside is queried, too, and what is certainly inside needs no narrow phase. Each simulation
runs with no broad phase and with every bounder, from the same state; no contact may be missed, and all runs must end in
the same state to the bit (see ``scene``).

    python -m sims particles --output out/demo
"""

from dataclasses import dataclass
from typing import Any

import warp_bounding as wb
from sims import base
from sims.assets import Shape
from sims.chosen import Taken, take
from sims.drawing import Drawn, draw_with
from sims.particles.bounds import MOMENT, bounds_data, of_moment
from sims.particles.broad import Everyone, MovingBox, OfMotion, OfSides
from sims.particles.due import WhenDue
from sims.particles.example import CONTACT, CONTAINMENT, Example, rain_data
from sims.particles.scene import RESOLUTION, Scene
from sims.prefitted import FitSpec, bounders_of
from sims.report import CHOSEN, UNPROVEN, Run, bounder_rows

__all__ = ["MOVING_BOX", "SPECS", "Demo", "shapes", "simulate"]

SCENE, INSIDE, INNER_NAME = "rain", "rain-inside", "inside"
MOVING_BOX = "moving aabb"
DISTANCE = "distance"
CELLS = {"resolution": RESOLUTION}  # of methods that are made of cells; the others bound the moving mesh itself
POROUS = "porous"
NARROW = {
    "containment": {"reach": CONTAINMENT},
    "contact": {"reach": CONTACT},
    POROUS: {"reach": CONTAINMENT, "porous": True},
}
SPECS = {
    "aabb": FitSpec("aabb", kept=True),
    "kdop": FitSpec("kdop", kept=True),
    "bvh": FitSpec("bvh", options={"hidden": (50, 50)}, **CELLS, kept=True),  # of the network's memory
    "voxels": FitSpec("voxels", **CELLS),
    "learned-kdop": FitSpec("learned-kdop", budget=20.0, options={"k": 40}),
    "mlp": FitSpec("mlp", budget=900.0, options={"hidden": (50, 50)}),
    "bvh-1500": FitSpec("bvh", budget=120.0, options={"leaves": 1500}, **CELLS, kept=True),  # a tenth of voxels
    "aabb+mlp": FitSpec("aabb+mlp"),
    "learned-kdop+mlp": FitSpec("learned-kdop+mlp"),
    DISTANCE: FitSpec("mlp", query="distance", budget=300.0, options={"hidden": (50, 50)}),
    "occupancy": FitSpec("occupancy", budget=120.0, options={"hidden": (50, 50)}),
}
INNER = FitSpec("mlp", budget=600.0, options={"hidden": (50, 50), "side": "inside"})  # from the inside
SCENE_SPECS = {SCENE: SPECS, INSIDE: {"mlp": INNER}}
SEEPING = (MOVING_BOX, "voxels", "mlp", "learned-kdop+mlp", "occupancy")  # what is asked where the bunny is porous
SIDED = ("voxels", "mlp")  # of these, what is also asked together with a bounder from the inside
PICTURED = ("kdop", "learned-kdop", "mlp")  # their bounds, side by side
RAINED = ("mlp", "occupancy")  # their runs, side by side
RECORDED, KEPT = 30, 4000  # steps whose queries ``choose`` is told, and how many of each
WARM_UP = 4096  # particles of the run that loads kernels outside the timed part
PARTICLES, STEPS = (100_000, 10_000), (150, 24)  # full, quick


def shapes(device: str = "cpu") -> dict[str, Shape]:
    """The shapes whose learned bounders are stored, by the names of the scenes."""
    scene = Scene.bunny(device)
    return {SCENE: scene.shape, INSIDE: scene.core}


@dataclass
class Demo(base.Demo):
    """See module, and ``sims.base.Demo``.

    Attributes:
        particles: How many; 100,000, or 10,000 if quick.
        steps: Simulation steps; 150, or 24 if quick.
        inner: How the bounder from the inside is fitted.
    """

    particles: int | None = None
    steps: int | None = None
    inner: FitSpec = INNER

    NAME = "particles"
    SPECS = SPECS

    def set_up(self) -> dict[str, Shape]:
        self.choose(particles=PARTICLES, steps=STEPS)
        if self.particles < 1 or self.steps < 1:
            raise wb.BoundingError(f"particles and steps must be at least 1, got {self.particles} and {self.steps}")
        self.scene = Scene.bunny(self.device)
        self.shape = self.scene.motion.name
        return {SCENE: self.scene.shape}

    def fit(self, shapes: dict[str, Shape]) -> dict[str, dict[str, wb.Bounder]]:
        """See ``sims.base.Demo``; also the bounder from the inside, by the word that the runs' names have for it."""
        options, core = self.fits | {"device": str(self.scene.device)}, self.scene.core
        self.within = {INNER_NAME: bounders_of(INSIDE, core, {"mlp": self.inner}, **options)["mlp"]}
        return super().fit(shapes)

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        bounders, box = self.of_shape(SCENE), MovingBox(self.scene)
        self.rows[INSIDE] = bounder_rows(self.within, self.scene.core, self.SAMPLES[self.quick])
        rows = [*self.rows[SCENE], {"bounder": MOVING_BOX, "fp_rate": box.fp_rate(self.scene.shape)}]
        broad = {MOVING_BOX: box}
        for name, bounder in bounders.items():
            broad[name] = (WhenDue if bounder.of_distances else OfMotion)(bounder, self.scene)
        inner = self.within[INNER_NAME]
        sided = {f"{n}+{INNER_NAME}": OfSides(bounders[n], inner, self.scene) for n in SIDED if n in bounders}
        options, examples, runs = {"particles": self.particles, "steps": self.steps, "seed": self.seed}, {}, []
        for section, narrow in NARROW.items():
            queried = {n: broad[n] for n in SEEPING if n in broad} if section == POROUS else broad
            own, known = self.bounders | {INNER_NAME: self.within}, rows
            if section == POROUS:
                queried = queried | sided
            else:
                taken = self.taken[section] = self.take(narrow["reach"])
                found = taken.bounders
                queried = queried | {CHOSEN: None if found is None else OfMotion(found[SCENE], self.scene)}
                own, known = own | {CHOSEN: found or {}}, rows + taken.rows(rows, SCENE)
            queried = dict(sorted(queried.items(), key=lambda run: run[0] in UNPROVEN))  # what has no proof comes last
            examples[section] = simulate(self.scene, queried, **narrow, **options)
            runs += base.compare(examples[section], own, known, section)
        self.examples = next(iter(examples.values()))
        about = f"{self.particles:,} particles, {self.steps} steps"
        return runs, f"{about}, by narrow phase: calls and milliseconds a step (median)", {}

    def take(self, reach: float) -> Taken:
        """What ``choose`` takes for a narrow phase; a distance is queried when a drop is due, and is no candidate."""
        everyone = Everyone(KEPT, self.seed)
        run = Example(self.scene, everyone, reach=reach, particles=self.particles, seed=self.seed)
        for _ in range(min(self.steps, RECORDED)):
            run.step()
        price = 1e9 * sum(spent[1] for spent in run.seconds) / sum(run.calls)
        queried, device = {SCENE: everyone.queries}, str(self.scene.device)
        return take({SCENE: self.scene.shape}, self.bounders, queried, price, device=device)

    def draw(self) -> Drawn:
        bounders, examples, reference = self.of_shape(SCENE), self.examples, self.examples["none"]
        rates = {row["bounder"]: row["fp_rate"] for row in self.rows[SCENE]}
        pictured = {MOMENT: of_moment(self.scene, reference.time)}
        pictured |= {name: (bounders[name], rates[name]) for name in PICTURED if name in bounders}
        rained = {name: examples[name] for name in RAINED if name in examples} or {"none": reference}
        data = bounds_data(self.scene, reference.time, pictured) | rain_data(rained, bounders, reference)
        return draw_with("sims.particles.pictures", self.out, data)

    def more(self) -> dict[str, Any]:
        """``particles``, ``device``, and ``bounders``: a row for each."""
        rows = [*self.rows[SCENE], *self.rows[INSIDE]]
        return {"particles": self.particles, "device": str(self.scene.device), "bounders": rows}


def simulate(
    scene: Scene,
    broad: dict[str, MovingBox | OfMotion | OfSides | WhenDue],
    *,
    reach: float = CONTAINMENT,
    porous: bool = False,
    particles: int,
    steps: int,
    seed: int = 0,
) -> dict[str, Example]:
    """The same rain without a broad phase and with each; see ``sims.base.simulate``."""

    def rain(phase: MovingBox | OfMotion | OfSides | WhenDue | None, small: bool) -> Example:
        count = min(particles, WARM_UP) if small else particles
        return Example(scene, phase, reach=reach, porous=porous, particles=count, seed=seed)

    return base.simulate("rain", broad, rain, steps)
