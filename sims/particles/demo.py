"""The demo ``particles``: 100,000 particles rain on the Stanford bunny while it turns, twists and swells.

The classic broad phase is a box, fitted to the mesh anew in every step; a bounder of the motion is asked about time and place, and is never
refitted. Two narrow phases, because the answer depends on them: robust *containment* looks for the closest point wherever a particle may be
inside, near *contact* only as far as a particle falls in a step. Each simulation runs with no broad phase and with every bounder, from the
same state; no contact may be missed, and all runs must end in the same state to the bit (see ``scene``).

    python -m sims.particles --out out/demo
"""

from pathlib import Path

import numpy as np
from rich.console import Console

import warp_bounding as wb
from sims.drawing import draw_with
from sims.particles.broad import MovingBox, OfMotion
from sims.particles.example import CONTACT, CONTAINMENT, Example
from sims.particles.scene import RESOLUTION, Scene
from sims.prefitted import Recipe, bounders_of
from sims.report import Run, bar, bounder_rows, output, result, run_table, verdict

__all__ = ["MOVING_BOX", "RECIPES", "compare", "grids", "run", "simulate"]

SCENE = "rain"
MOVING_BOX = "moving aabb"
NARROW = {"containment": CONTAINMENT, "contact": CONTACT}
RECIPES = {
    "aabb": Recipe("aabb"),
    "kdop": Recipe("kdop"),
    "bvh": Recipe("bvh", options={"hidden": (50, 50)}, kept=True),  # of the network's memory
    "voxels": Recipe("voxels"),
    "learned-kdop": Recipe("learned-kdop", budget=20.0, options={"k": 40}),
    "mlp": Recipe("mlp", budget=420.0, options={"hidden": (50, 50)}),
    "mlp-early": Recipe("mlp-early", budget=300.0, options={"hidden": (50, 50)}),
    "bvh-1500": Recipe("bvh", options={"leaves": 1500}, kept=True),  # a tenth of the memory of voxels
    "aabb+mlp": Recipe("aabb+mlp"),
    "mlp+bvh-1500": Recipe("mlp+bvh"),
    "learned-kdop+mlp": Recipe("learned-kdop+mlp"),
    "occupancy": Recipe("occupancy", budget=60.0, options={"hidden": (50, 50)}),
}
PICTURED = ("kdop", "learned-kdop", "mlp")  # their bounds, side by side
RAINED = ("mlp", "occupancy")  # their runs, side by side
WARM_UP = 4096  # particles of the run that loads kernels outside the timed part
PARTICLES, STEPS = (100_000, 10_000), (150, 24)  # full, quick


def grids(device: str = "cpu") -> dict[str, wb.IndicatorGrid]:
    """The cells whose learned bounders are stored, by the name of the scene."""
    return {SCENE: Scene.bunny(device).grid()}


def run(
    out: Path,
    *,
    quick: bool = False,
    refit: bool = False,
    budget: float | None = None,
    bounder_file: Path | None = None,
    particles: int | None = None,
    steps: int | None = None,
    seed: int = 0,
    device: str | None = None,
    console: Console | None = None,
    recipes: dict[str, Recipe] | None = None,
    resolution: int = RESOLUTION,
) -> dict:
    """Do the whole demo.

    Args:
        out: Folder for pictures, and for bounders that are fitted; made if there is none.
        quick: Fewer particles and steps.
        refit: Fit the learned bounders anew, rather than load them.
        budget: Seconds for each of them.
        bounder_file: A file to take ``mlp`` from.
        particles: How many; 100,000, or 10,000 if quick.
        steps: Simulation steps; 150, or 24 if quick.
        seed: Of fits and particles.
        device: Warp device; the default device if ``None``.
        console: Where the table and sentences go; standard output if ``None``. Progress bars go to standard error.
        recipes: Other bounders than ``RECIPES``.
        resolution: Cells along the moving bunny's longest side.

    Returns:
        JSON-ready, see ``report.result``; runs have a ``section``, the narrow phase; ``particles``, ``device``, ``bounders``.

    Raises:
        BoundingError: For an impossible option, an unknown device or a bounder file that does not fit.
    """
    out, console = Path(out), console or output()
    particles = PARTICLES[quick] if particles is None else particles
    steps = STEPS[quick] if steps is None else steps
    if particles < 1 or steps < 1:
        raise wb.BoundingError(f"particles and steps must be at least 1, got {particles} and {steps}")
    scene = Scene.bunny(device)
    grid = scene.grid(resolution)
    recipes = RECIPES if recipes is None else recipes
    options = {"refit": refit, "budget": budget, "out": out, "file": bounder_file, "seed": seed}
    bounders = bounders_of(SCENE, grid, recipes, device=str(scene.device), **options)
    rows = bounder_rows(bounders, grid)
    broad = {MOVING_BOX: MovingBox(scene)} | {name: OfMotion(b, scene) for name, b in bounders.items()}
    rates = {row["bounder"]: row["fp_rate"] for row in rows} | {
        MOVING_BOX: broad[MOVING_BOX].fp_rate(scene.motion, grid)
    }
    runs, first = [], None
    for section, reach in NARROW.items():
        examples = simulate(scene, broad, reach=reach, particles=particles, steps=steps, seed=seed)
        runs += compare(examples, bounders, rates, section)
        first = first or examples
    title = f"{particles:,} particles, {steps} steps, by narrow phase: calls and milliseconds a step (median)"
    console.print(run_table(title, runs, steps=steps, calls="narrow calls"))
    console.print(verdict(runs))
    with bar("drawing") as update:
        update(0.3, 1.0, "")
        from sims.particles.pictures import bounds_data, rain_data

        pictured = {name: (bounders[name], rates[name]) for name in PICTURED if name in bounders}
        shown = {name: first[name] for name in RAINED if name in first} or {"none": first["none"]}
        data = bounds_data(scene, first["none"].time, pictured) | rain_data(shown, bounders, first["none"])
        drawn = draw_with("sims.particles.pictures", out, data)
    console.print(drawn.lines(), markup=False)
    more = {"particles": particles, "device": str(scene.device), "bounders": rows}
    return result("particles", scene.motion.name, steps, runs, drawn.paths, **more)


def simulate(
    scene: Scene,
    broad: dict[str, MovingBox | OfMotion],
    *,
    reach: float = CONTAINMENT,
    particles: int,
    steps: int,
    seed: int = 0,
) -> dict[str, Example]:
    """The same rain once without a broad phase (``"none"``) and once with each, from the same state.

    Returns:
        The runs, finished.
    """
    examples = {}
    for name, phase in {"none": None, **broad}.items():
        warm_up = Example(scene, phase, reach=reach, particles=min(particles, WARM_UP), seed=seed)
        warm_up.step()
        warm_up.step()
        examples[name] = example = Example(scene, phase, reach=reach, particles=particles, seed=seed)
        with bar(f"rain, broad phase: {name}") as update:
            for step in range(steps):
                example.step()
                update(step + 1, steps, "")
    return examples


def compare(
    examples: dict[str, Example], bounders: dict[str, wb.Bounder], rates: dict[str, float], section: str = ""
) -> list[Run]:
    """What the runs cost and missed, and whether they ended in the reference's state; ``"none"`` is the reference."""
    reference = examples["none"]
    final, runs = reference.state(), []
    for name, example in examples.items():
        bounder = bounders.get(name)
        if name == MOVING_BOX:
            certificate = "by construction"  # it is made of the very vertices
        else:
            certificate = bounder.certificate.kind if bounder and bounder.certificate else ""
        run = Run(
            name, int(np.sum(example.calls)), *example.milliseconds(), 0, True, rates.get(name), certificate, section
        )
        run.missed, run.identical = example.missed(reference), example.state() == final
        runs.append(run)
    return runs
