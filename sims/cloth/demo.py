"""The demo ``cloth``: what it runs, prints and returns."""

from pathlib import Path

import warp as wp
from rich.console import Console

import warp_bounding as wb
from sims.cloth.example import Example
from sims.cloth.field import Field, field_table, run_field, sentences
from sims.cloth.pictures import cloth_data
from sims.cloth.scene import RECIPES, SHAPES, Scene, grid_of
from sims.drawing import draw_with
from sims.prefitted import Recipe, bounders_of
from sims.report import UNPROVEN, Run, bar, bounder_rows, kept, output, result, run_table, verdict

__all__ = ["compare", "fitted", "run", "simulate"]

SIDE, STEPS, ROUNDS = 65, 600, 11
QUICK_SIDE, QUICK_STEPS, QUICK_ROUNDS = 33, 360, 3
QUICK_FIELD = {"rows": 3, "particles": 4000}
SAMPLES, QUICK_SAMPLES = 400_000, 60_000
ALL_CORES = "mlp"
PICTURED = ("mlp", "occupancy")
COLUMNS = {"contacts": "contacts", "deepest": "deepest"}


def run(
    out: Path,
    *,
    quick: bool = False,
    refit: bool = False,
    budget: float | None = None,
    bounder_file: Path | None = None,
    steps: int | None = None,
    side: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    recipes: dict[str, Recipe] = RECIPES,
    console: Console | None = None,
) -> dict:
    """Do the whole demo.

    Args:
        out: Folder for pictures, and for networks that are fitted; made if there is none.
        quick: A small cloth, few steps, a small field.
        refit: Fit the networks anew rather than load them.
        budget: Seconds a network, then.
        bounder_file: A file for ``mlp``, of the bunny or of the star; the other one's stays.
        steps: Of the cloth; 480 are a second.
        side: Particles along a side of the cloth.
        seed: Of the fits, the cloth's irregularity and the field.
        device: ``"cpu"``.
        recipes: Which bounders there are.
        console: Where tables and sentences go; standard output if ``None``. Progress goes to standard error.

    Returns:
        As ``sims.report.result``, and ``particles``, ``bounders`` (a row a bounder and shape), ``field`` (a row a contact gap, see
        ``sims.cloth.field.measure``).

    Raises:
        BoundingError: For an impossible option, a device that is not a CPU, or a bounder that is missing or does not fit.
    """
    out, console = Path(out), console or output()
    if device != "cpu":
        raise wb.BoundingError(
            f"cloth runs on the cpu, where Newton's contacts are the same each time; got device {device!r}"
        )
    steps = steps if steps is not None else QUICK_STEPS if quick else STEPS
    if steps < 1:
        raise wb.BoundingError(f"steps must be at least 1, got {steps}")
    scene = Scene(side=side or (QUICK_SIDE if quick else SIDE), seed=seed)
    options = {"refit": refit, "budget": budget, "out": out, "seed": seed, "file": bounder_file}
    bounders = fitted(recipes, **options)
    rows = [
        {"shape": name} | row
        for name in SHAPES
        for row in bounder_rows(of_shape(bounders, name), grid_of(name), QUICK_SAMPLES if quick else SAMPLES)
    ]
    if not compiled():
        console.print("Newton's kernels are compiled now, once on this machine; that takes about a minute.")
    examples = simulate(scene, bounders, steps=steps)
    runs = compare(examples, rows)
    title = f"{scene.particles:,} particles of cloth on {' and '.join(SHAPES)}, one thread, {steps} steps"
    console.print(run_table(title, runs, steps=steps, calls="pairs", extra=COLUMNS))
    console.print(verdict(runs))
    console.print(saved(runs))
    if "occupancy" in examples:
        console.print(
            f"Deepest below a surface: {examples['occupancy'].deepest:.3f}; without bounders {examples['none'].deepest:.3f}."
        )
    field = Field(**QUICK_FIELD, seed=seed) if quick else Field(seed=seed)
    measured = run_field(
        field, bounders["mlp"], rounds=QUICK_ROUNDS if quick else ROUNDS, refit=refit, budget=budget, out=out, seed=seed
    )
    console.print(field_table(field, measured))
    console.print(sentences(measured))
    with bar("drawing") as update:
        update(0.3)
        pictured = {name: examples[name] for name in PICTURED if name in examples} or {"none": examples["none"]}
        drawn = draw_with("sims.cloth.pictures", out, cloth_data(pictured, examples["none"]))
    console.print(drawn.lines(), markup=False)
    same = kept(runs) and all(entry["identical"] for row in measured for entry in row["bounders"])
    more = {"particles": scene.particles, "bounders": rows, "field": measured, "identical": same}
    return result("cloth", " and ".join(SHAPES), steps, runs, drawn.paths, **more)


def fitted(
    recipes: dict[str, Recipe] = RECIPES, *, file: Path | None = None, **options
) -> dict[str, dict[str, wb.Bounder]]:
    """All bounders, by name of the method, then of the shape.

    Args:
        recipes: Which there are.
        file: For ``mlp`` of the shape that it was made for.
        options: What ``sims.prefitted.bounders_of`` takes.

    Raises:
        BounderError: For a bounder that is missing or fits neither shape.
    """
    files = {}
    if file is not None:
        if not Path(file).is_file():
            raise wb.BounderError(f"{file}: there is no such file")
        made = wb.load(file, device="cpu").info.get("indicator")
        files = {next((name for name in SHAPES if grid_of(name).digest == made), SHAPES[0]): file}
    found = {
        name: bounders_of(f"cloth-{name}", grid_of(name), recipes, file=files.get(name), **options) for name in SHAPES
    }
    return {method: {name: found[name][method] for name in SHAPES} for method in recipes}


def of_shape(bounders: dict[str, dict[str, wb.Bounder]], name: str) -> dict[str, wb.Bounder]:
    """Those of one shape, by name of the method."""
    return {method: found[name] for method, found in bounders.items()}


def compiled() -> bool:
    """Whether Newton's solver is in Warp's kernel cache, as far as can be seen."""
    wp.init()
    folder = Path(wp.config.kernel_cache_dir or "")
    return any(folder.glob("wp_newton*xpbd.kernels*"))


def simulate(scene: Scene, bounders: dict[str, dict[str, wb.Bounder]], *, steps: int) -> dict[str, Example]:
    """The same cloth without a broad phase (``"none"``) and with each bounder, from the same state, in turns, step by step.

    Runs take turns so that whatever else the machine does slows all of them alike.

    Args:
        scene: The scene.
        bounders: By name of the method, then of the shape.
        steps: How many.

    Returns:
        The runs, finished.
    """
    wanted = {"none": {"bounders": None}}
    wanted |= {name: {"bounders": found, "unproven": name in UNPROVEN} for name, found in bounders.items()}
    if ALL_CORES in bounders:
        wanted[f"{ALL_CORES}, all cores"] = {"bounders": bounders[ALL_CORES], "all_cores": True}
    with bar("loading kernels (compiled at first use, a minute)") as update:
        for done, (name, options) in enumerate(wanted.items()):
            update(done, len(wanted), name)
            Example(scene, **options).step()
    examples = {name: Example(scene, **options) for name, options in wanted.items()}
    with bar(f"cloth, {len(examples)} runs in turns") as update:
        for step in range(steps):
            for example in examples.values():
                example.step()
            update(step + 1, steps)
    for example in examples.values():
        example.look()
    return examples


def saved(runs: list[Run]) -> str:
    """Whether a bounder makes the contact pass faster, its own cost included, and what that is of a step."""
    passes = {run.bounder: run.ms_broad + run.ms_narrow for run in runs if run.conservative}
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


def compare(examples: dict[str, Example], rows: list[dict]) -> list[Run]:
    """What the runs cost, what they missed, and whether they are identical to the first one.

    Args:
        examples: From ``simulate``.
        rows: Of the bounders; false positives are the mean over the shapes.
    """
    reference = examples["none"]
    runs = []
    for name, example in examples.items():
        own = [row for row in rows if row["bounder"] == name.split(",")[0]]
        kinds = {row["certificate"] for row in own}
        broad, narrow, step = example.milliseconds()
        runs.append(
            Run(
                name,
                narrow_calls=sum(example.calls),
                ms_broad=broad,
                ms_narrow=narrow,
                ms_step=step,
                missed=example.missed,
                identical=example.identical(reference),
                fp_rate=sum(row["fp_rate"] for row in own) / len(own) if own else None,
                certificate="proven" if kinds == {"proven"} else "",
                extra={"contacts": example.touched, "deepest": example.deepest},
            )
        )
    return runs
