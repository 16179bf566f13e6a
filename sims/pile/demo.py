"""The demo ``pile``: two hundred bunnies and rings fall into a box, and a broad phase says which pairs may touch.

Each step, bounding spheres leave pairs of bodies; these are what the narrow phase looks at where there is no other
broad phase (``none``). Boxes of the turned bodies (``aabb`` along the world's axes, ``obb`` along their own) and
``pairs``, a proven distance of one mesh asked at the balls that hold the other, deny some of them. A denied pair has no
contact, and what has no contact changes nothing: all four piles are the same, to the bit (see ``kernels``).

The narrow phase asks one mesh at points of the other, and back. Do not expect time to fall as pairs do: what ``pairs``
leaves are mostly pairs that touch, and these cost the narrow phase several times as much as those that are apart, which
end at the first boxes of a ``wp.Mesh``. The solver is one for looking at: springs at points of the surfaces, which may
stand in each other a little; not one for tall stacks.

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
        none, pairs = (self.examples[name] for name in ("none", "pairs"))
        all_, left = (1e6 * sum(spent[1] for spent in run.seconds) for run in (none, pairs))
        apart = (all_ - left) / max(sum(none.calls) - sum(pairs.calls), 1)
        price = f"A pair that pairs leaves costs the narrow phase {left / max(sum(pairs.calls), 1):.3g} us"
        self.console.print(f"{price}, one that it denies {apart:.3g} us.", markup=False)

    def draw(self) -> Drawn:
        return draw_with("sims.pile.pictures", self.out, pile_data({name: self.examples[name] for name in SHOWN}))

    def more(self) -> dict[str, Any]:
        """``bodies``, ``device``, and ``bounders``: rows of each mesh."""
        return {"bodies": BODIES[self.quick], "device": str(self.scene.device), "bounders": self.rows}
