"""The demo ``pile``: two hundred bunnies and rings fall into a box, and a broad phase says which pairs may touch.

Each step, bounding spheres leave pairs of bodies; these are what the narrow phase looks at where there is no other
broad phase (``none``). Boxes of the turned bodies (``aabb`` along the world's axes, ``obb`` along their own) and
``pairs``, a proven distance of one mesh asked at the balls that hold the other, deny some of them. A denied pair has no
contact, and what has no contact changes nothing: all four piles are the same, to the bit (see ``kernels``).

The narrow phase asks one mesh at points of the other, and back. A pair costs it tens of microseconds, while ``pairs``
takes one; so time falls nearly as pairs do. It is a solver for looking at: springs, no stacking of finest quality, and
contacts at points of the surfaces only.

    python -m sims pile --output out/demo
"""

from dataclasses import dataclass
from typing import Any

import warp_bounding as wb
from sims import base
from sims.assets import Shape
from sims.drawing import Drawn, draw_with
from sims.pile.example import Boxes, Example, Pairs, pile_data
from sims.pile.kernels import GAP
from sims.pile.scene import SCENES, Scene, hold
from sims.prefitted import FitSpec
from sims.report import Run

__all__ = ["SPECS", "Demo"]

GRID = {"nodes": 24, "reach": 0.4, "storage": "uint8"}
SPECS = {"pairs": FitSpec("distance-grid", "distance", options=GRID, kept=True)}
BODIES, STEPS, WARM_UP = (200, 60), (720, 180), 3
SHOWN = ("aabb", "pairs")


@dataclass
class Demo(base.Demo):
    """A pile in a box; see module, and ``sims.base.Demo``.

    Attributes:
        steps: Steps; 720, or 180 if quick.
    """

    steps: int | None = None

    NAME = "pile"
    SPECS = SPECS
    SCENES = SCENES
    SAMPLES = (400_000, 50_000)
    DISTANCES = {"radius": GAP}  # noqa: RUF012
    CALLS = "pairs left"

    def set_up(self) -> dict[str, Shape]:
        self.choose(steps=STEPS)
        if self.steps < 1:
            raise wb.BoundingError(f"steps must be at least 1, got {self.steps}")
        self.scene = Scene(BODIES[self.quick], self.seed, self.device)
        self.balls = hold(self.out / "pairs" if self.refit else None)
        self.shape = f"{BODIES[self.quick]} bunnies and rings"
        return {scene.removeprefix(SCENES): shape for scene, shape in self.scene.shapes.items()}

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        little = Scene(WARM_UP, self.seed, self.device)
        phases = {
            "aabb": lambda scene: Boxes(scene, oriented=False),
            "obb": lambda scene: Boxes(scene, oriented=True),
            "pairs": lambda scene: Pairs(scene, self.bounders["pairs"], self.balls),
        }

        def make(phase, small: bool) -> Example:
            scene = little if small else self.scene
            return Example(scene, None if phase is None else phase(scene))

        self.examples = base.simulate("pile", phases, make, self.steps)
        runs = base.compare(self.examples, self.bounders)
        title = f"{self.shape}, {self.steps} steps; per step, none: bounding spheres"
        return runs, title, {"touching": "touching"}

    def tell(self, runs: list[Run]) -> None:
        """What a pair costs."""
        none, pairs = (next(run for run in runs if run.bounder == name) for name in ("none", "pairs"))
        looked = [1e3 * sum(spent[1] for spent in self.examples[run.bounder].seconds) for run in (none, pairs)]
        self.console.print(
            f"A pair costs the narrow phase {1e3 * looked[0] / none.narrow_calls:.3g} us; of "
            f"{none.narrow_calls / self.steps:,.0f} that spheres leave, pairs leaves "
            f"{pairs.narrow_calls / self.steps:,.0f}, and {pairs.extra['touching']:,} touch.",
            markup=False,
        )

    def draw(self) -> Drawn:
        return draw_with("sims.pile.pictures", self.out, pile_data({name: self.examples[name] for name in SHOWN}))

    def more(self) -> dict[str, Any]:
        """``bodies``, ``device``, and ``bounders``: rows of each mesh."""
        return {"bodies": BODIES[self.quick], "device": str(self.scene.device), "bounders": self.rows}
