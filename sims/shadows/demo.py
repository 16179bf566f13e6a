"""The demo ``shadows``: a bunny and a chair with thin legs in the sun; bounders spare rays that nothing stops.

Each pixel that shows a surface in the sun sends a ray to it. Most of these rays meet nothing; to know that, a renderer
asks each object's mesh. A bounder of the object's rays answers first, and the mesh is asked about what it leaves (see
``scene``). A bounder of distances (``distance``) is no bounder of rays, but marches along them: as far as it says that
the object is away, over and over. So it serves rays of any length, and is proven for the mesh itself. Pictures with and
without bounders must be the same, pixel for pixel.

A ray that begins on an object's own surface is hardly ever denied: it begins in cells that are bounded. What is spared
are rays from the floor, and from one object towards the other. A ``wp.Mesh`` has a hierarchy of boxes of its own, which
denies most rays at its first nodes; so do not expect a march to save time here, with meshes of some thousand faces on a
CPU.

    python -m sims shadows --output out/demo
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import warp_bounding as wb
from sims import base
from sims.assets import Shape
from sims.chosen import Taken, take
from sims.drawing import Drawn
from sims.prefitted import FitSpec, bounded
from sims.report import CHOSEN, Run
from sims.shadows.example import Example
from sims.shadows.pictures import OVERSAMPLING, draw
from sims.shadows.scene import LENGTH, RESOLUTION, SCENES, Scene, margin_of

__all__ = ["SPECS", "Demo", "simulate"]

RAYS = {"length": LENGTH}
HIDDEN = (50, 50)


def _rays(method: str, budget: float = 60.0, **options) -> FitSpec:
    """Rays are proven for cells of a mesh."""
    return FitSpec(method, "ray", budget, RAYS | options, RESOLUTION)


SPECS = {
    "aabb": _rays("aabb"),
    "kdop": _rays("kdop"),
    "bvh": _rays("bvh", hidden=HIDDEN),  # as many boxes as have the memory of the network
    "learned-kdop": _rays("learned-kdop", 10.0, k=40),
    "distance": FitSpec("mlp", "distance", 150.0, {"hidden": HIDDEN}),  # of the mesh itself
}
SIZES, STEPS = ((640, 480), (160, 120)), (8, 2)  # full, quick
SHOWN = ("distance", "bvh", "learned-kdop", "kdop", "aabb")  # in the picture: the first of these
WARM_UP = (96, 72)  # pixels of the picture that loads kernels outside the timed part
SUN = 0.35  # time of the day of the picture


@dataclass
class Demo(base.Demo):
    """A still life in the sun; see module, and ``sims.base.Demo``.

    Attributes:
        steps: Pictures: places of the sun; 8, or 2 if quick.
    """

    steps: int | None = None

    NAME = "shadows"
    SPECS = SPECS
    SCENES = SCENES
    SAMPLES = (400_000, 50_000)
    DISTANCES: ClassVar[dict[str, Any]] = {"query": "ray", "length": LENGTH}
    CALLS = "mesh rays"
    MISSED = "shadow pixels"

    def set_up(self) -> dict[str, Shape]:
        self.choose(steps=STEPS)
        if self.steps < 1:
            raise wb.BoundingError(f"steps must be at least 1, got {self.steps}")
        self.scene = Scene.still_life(*SIZES[self.quick], self.device)
        self.shape = " and ".join(self.scene.shapes)
        self.shapes = {name: shape.dilated(margin_of(shape)) for name, shape in self.scene.shapes.items()}
        return self.shapes

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        taken = self.taken[""] = self.take()
        methods = self.bounders | {CHOSEN: taken.bounders}
        self.examples = simulate(self.scene, methods, steps=self.steps)
        self.rays = sum(self.examples["none"].rays)
        width, height = SIZES[self.quick]
        about = f"{self.steps} pictures, {width} x {height} pixels, {self.rays // self.steps:,} shadow rays"
        rows = [row for name, own in self.rows.items() for row in own + taken.rows(own, name)]
        runs = base.compare(self.examples, self.bounders | {CHOSEN: taken.bounders or {}}, rows)
        return runs, f"{about}, {len(self.scene.shapes)} objects; per picture", {}

    def take(self) -> Taken:
        """What ``choose`` takes for each object, told of the rays of a series, and what a call takes in it."""
        run = Example(self.scene, steps=self.steps)
        for _ in range(self.steps):
            run.step()
        price = 1e9 * sum(spent[1] for spent in run.seconds) / sum(run.calls)
        rays = np.concatenate([run.cast(sun)[1].numpy() for sun in run.suns])
        shapes = {name: bounded(next(iter(self.specs.values())), shape) for name, shape in self.shapes.items()}
        queried, device = dict.fromkeys(shapes, rays), str(self.scene.device)
        return take(shapes, self.bounders, queried, price, "ray", length=LENGTH, device=device)

    def draw(self) -> Drawn:
        width, height = SIZES[False]
        scene = Scene.still_life(width * OVERSAMPLING, height * OVERSAMPLING, self.device)
        examples = {"none": Example(scene, sun=SUN)}
        for name in [name for name in SHOWN if name in self.bounders][:1]:
            examples[name] = Example(scene, self.bounders[name], sun=SUN)
        for example in examples.values():
            example.step()
        reference = examples["none"]
        if not all(example.identical(reference) for example in examples.values()):
            self.notes.append("[bold red]Broken promise: the large picture is not the one without a broad phase.[/]")
        shown = {name: example for name, example in examples.items() if example is not reference}
        return Drawn([draw(self.out, reference, shown or examples)])

    def more(self) -> dict[str, Any]:
        """``size`` and ``rays`` (shadow rays of all pictures), ``device``, and ``bounders``: rows of each object."""
        about = {"size": list(SIZES[self.quick]), "rays": self.rays}
        return {**about, "device": str(self.scene.device), "bounders": self.rows}


def simulate(scene: Scene, methods: dict[str, dict[str, wb.Bounder] | None], *, steps: int = 8) -> dict[str, Example]:
    """The same pictures without a broad phase and with the bounders of each method; see ``sims.base.simulate``.

    Args:
        scene: What is drawn.
        methods: By name of a method, then of an object.
        steps: Pictures of each series.
    """
    little = Scene.still_life(*WARM_UP, str(scene.device))

    def series(bounders: dict[str, wb.Bounder] | None, small: bool) -> Example:
        return Example(little if small else scene, bounders, steps=steps)

    return base.simulate("shadows", methods, series, steps)
