"""The demo ``cloth``: what it runs, prints and returns."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warp_bounding as wb
from sims import base
from sims.assets import Shape
from sims.chosen import Taken, take
from sims.cloth.example import Example, cloth_data
from sims.cloth.field import Field, field_table, run_field, sentences
from sims.cloth.scene import SHAPES, SPECS, Scene, dilated
from sims.drawing import Drawn, draw_with
from sims.report import CHOSEN, UNPROVEN, Run
from sims.threads import threads_of

__all__ = ["Demo", "simulate"]

SIDES, STEPS, ROUNDS = (65, 33), (600, 360), (11, 3)  # full, quick; 480 steps are a second
QUICK_FIELD = {"rows": 3, "particles": 4000}
ALL_CORES = "mlp"
PICTURED = ("mlp", "occupancy")
BOXES, RECORDED = "aabb", 400  # of the runs that tell ``choose`` what is asked, and their steps
COLUMNS = {"contacts": "contacts", "deepest": "deepest"}


@dataclass
class Demo(base.Demo):
    """A falling cloth, and many meshes; see ``sims.cloth`` and ``sims.base.Demo``.

    Attributes:
        steps: Of the cloth; 600, or 360 if quick.
        side: Particles along a side of the cloth; 65, or 33 if quick.
        device: ``"cpu"``.
    """

    steps: int | None = None
    side: int | None = None
    device: str = "cpu"

    NAME = "cloth"
    SPECS = SPECS
    SCENES = "cloth-"
    SAMPLES = (400_000, 60_000)
    CALLS = "pairs"

    def set_up(self) -> dict[str, Shape]:
        if self.device != "cpu":
            raise wb.BoundingError(
                f"cloth runs on the cpu, where Newton's contacts are the same each time; got device {self.device!r}"
            )
        self.choose(steps=STEPS, side=SIDES)
        if self.steps < 1:
            raise wb.BoundingError(f"steps must be at least 1, got {self.steps}")
        self.scene = Scene(side=self.side, seed=self.seed)
        self.shape = " and ".join(SHAPES)
        self.shapes = {name: dilated(name) for name in SHAPES}
        return self.shapes

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        if not compiled():
            self.console.print("Newton's kernels are compiled now, once on this machine; that takes about a minute.")
        taken = self.taken[""] = self.take()
        self.examples = simulate(self.scene, self.bounders | {CHOSEN: taken.bounders}, steps=self.steps)
        rows = [row for name, own in self.rows.items() for row in own + taken.rows(own, name)]
        title = f"{self.scene.particles:,} particles of cloth on {self.shape}, one thread, {self.steps} steps"
        return base.compare(self.examples, self.bounders | {CHOSEN: taken.bounders or {}}, rows), title, COLUMNS

    def take(self) -> Taken:
        """What ``choose`` takes for each shape, on one thread.

        Newton's pass takes most of its time whatever the pairs are: what a pair costs is what a run with boxes saves
        for each pair that it spares. And what these boxes take, which are decided at once, is what asking takes.
        """
        runs, kept = [Example(self.scene), Example(self.scene, self.bounders[BOXES])], []
        for _ in range(min(self.steps, RECORDED)):
            for run in runs:
                run.step()
            kept.append(runs[0].state.particle_q.numpy())
        (_, own, _), (asking, left, _) = (run.milliseconds() for run in runs)
        pairs, few = (float(np.median(run.calls)) for run in runs)
        price = 1e6 * max(own - left, 0.0) / max(pairs - few, 1.0)
        queried = {name: self.scene.from_shape(name, np.concatenate(kept)) for name in self.shapes}
        with threads_of(1):
            return take(self.shapes, self.bounders, queried, price, overhead_ns=1e6 * asking / pairs)

    def tell(self, runs: list[Run]) -> None:
        """What a bounder saves, how deep the cloth has sunk, and the many meshes."""
        self.console.print(saved(runs))
        if "occupancy" in self.examples:
            sunk, own = self.examples["occupancy"].deepest, self.examples["none"].deepest
            self.console.print(f"Deepest below a surface: {sunk:.3f}; without bounders {own:.3f}.")
        field = Field(**(QUICK_FIELD if self.quick else {}), seed=self.seed)
        self.field = run_field(
            field, self.bounders["mlp"], self.bounders.get("distance"), rounds=ROUNDS[self.quick], **self.fits
        )
        self.console.print(field_table(field, self.field))
        self.console.print(sentences(self.field))
        if not all(entry["identical"] for row in self.field for entry in row["bounders"]):
            self.notes.append("[bold red]Broken promise: contacts among many meshes are not Newton's own.[/]")

    def draw(self) -> Drawn:
        examples = self.examples
        pictured = {name: examples[name] for name in PICTURED if name in examples} or {"none": examples["none"]}
        return draw_with("sims.cloth.pictures", self.out, cloth_data(pictured, examples["none"]))

    def more(self) -> dict[str, Any]:
        """``particles``, ``bounders``: a row a bounder and shape; ``field``: a row a contact gap, ``field.measure``."""
        rows = [{"shape": name} | row for name, own in self.rows.items() for row in own]
        return {"particles": self.scene.particles, "bounders": rows, "field": self.field}


def compiled() -> bool:
    """Whether Newton's solver is in Warp's kernel cache, as far as can be seen."""
    wp.init()
    folder = Path(wp.config.kernel_cache_dir or "")
    return any(folder.glob("wp_newton*xpbd.kernels*"))


def simulate(scene: Scene, bounders: dict[str, dict[str, wb.Bounder] | None], *, steps: int) -> dict[str, Example]:
    """The same cloth without a broad phase and with each bounder; see ``sims.base.simulate``.

    Args:
        scene: The scene.
        bounders: By name of the method, then of the shape; ``None`` for a run without a broad phase.
        steps: How many.
    """
    wanted = {
        name: None if found is None else {"bounders": found, "unproven": name in UNPROVEN}
        for name, found in bounders.items()
    }
    if ALL_CORES in bounders:
        wanted[f"{ALL_CORES}, all cores"] = {"bounders": bounders[ALL_CORES], "all_cores": True}
    examples = base.simulate("cloth", wanted, lambda options, small: Example(scene, **(options or {})), steps)
    for example in examples.values():
        example.look()
    return examples


def saved(runs: list[Run]) -> str:
    """Whether a bounder makes the contact pass faster, its own cost included, and what that is of a step."""
    queried = [run for run in runs if run.conservative and run.bounder != CHOSEN]
    passes = {run.bounder: run.ms_broad + run.ms_narrow for run in queried}
    own = passes.pop("none")
    best = min(passes, key=passes.get)
    if passes[best] < own:
        share = 100 * (own - passes[best]) / runs[0].ms_step
        return (
            f"The contact pass is {own / passes[best]:.2f} times as fast with {best}; that is {share:.0f} % of a step."
        )
    return (
        f"No bounder makes this contact pass faster ({best} comes closest, {own / passes[best]:.2f} times as fast): "
        "Newton rejects most pairs by their boxes already, and a pass this small is mostly overhead."
    )
