"""The demo ``shadows``: a bunny and a chair with thin legs in the sun; bounders of rays spare shadow rays that nothing stops.

Each pixel that shows a surface in the sun sends a ray to it. Most of these rays meet nothing; to know that, a renderer asks each object's mesh. A
bounder of the object's rays answers first, and the mesh is asked about what it leaves (see ``scene``). Pictures with and without
bounders must be the same, pixel for pixel. Where no proof stands behind a bounder, thin things lose their shadows; ``shadows.png`` shows it.

A ray that begins on an object's own surface is hardly ever denied: it begins in cells that are bounded. What is spared are rays from the
floor, and from one object towards the other. A ``wp.Mesh`` has a hierarchy of boxes of its own, which denies most rays at its first nodes; so
do not expect a network to save time here, with meshes of some thousand faces on a CPU. What is at stake are the shadows.

    python -m sims.shadows --out out/demo
"""

from pathlib import Path

import numpy as np
from rich.console import Console

import warp_bounding as wb
from sims.prefitted import Recipe, bounders_of
from sims.report import Run, bar, bounder_rows, output, result, run_table, verdict
from sims.shadows.example import Example, check_rays, simulate
from sims.shadows.scene import LENGTH, RESOLUTION, SCENES, Scene, grid_of

__all__ = ["RECIPES", "compare", "run"]

RAYS = {"length": LENGTH}
NETWORK = RAYS | {"hidden": (50, 50)}
RECIPES = {
    "aabb": Recipe("aabb", "ray", options=RAYS),
    "kdop": Recipe("kdop", "ray", options=RAYS),
    "bvh": Recipe("bvh", "ray", options=NETWORK),  # as many boxes as have the memory of the network
    "learned-kdop": Recipe("learned-kdop", "ray", budget=10.0, options=RAYS | {"k": 40}),
    "mlp": Recipe("mlp", "ray", budget=420.0, options=NETWORK),
    "mlp-early": Recipe("mlp-early", "ray", budget=120.0, options=NETWORK),
    "aabb+mlp": Recipe("aabb+mlp", "ray", options=RAYS),
    "learned-kdop+mlp": Recipe("learned-kdop+mlp", "ray", options=RAYS),
    "occupancy": Recipe("occupancy", "ray", budget=30.0, options=NETWORK),
}
SIZES, STEPS = ((640, 480), (160, 120)), (8, 2)  # full, quick
SAMPLES = (400_000, 50_000)  # of each bounder's rate of false positives
SHOWN = ("mlp", "learned-kdop+mlp", "learned-kdop", "kdop", "aabb")  # in the left picture: the first that is proven
SUN = 0.35  # time of the day of the picture


def run(
    out: Path,
    *,
    quick: bool = False,
    refit: bool = False,
    budget: float | None = None,
    bounder_file: Path | None = None,
    steps: int | None = None,
    seed: int = 0,
    device: str | None = None,
    console: Console | None = None,
    recipes: dict[str, Recipe] | None = None,
    resolution: int = RESOLUTION,
) -> dict:
    """Do the whole demo.

    Args:
        out: Folder for the picture, and for bounders that are fitted; made if there is none.
        quick: Fewer and smaller pictures.
        refit: Fit the learned bounders anew, rather than load them.
        budget: Seconds for each of them.
        bounder_file: A file to take ``mlp`` of one of the objects from; that of the other is the stored one, or fitted.
        steps: Pictures: places of the sun; 8, or 2 if quick.
        seed: Of fits.
        device: Warp device; the default device if ``None``.
        console: Where the table and sentences go; standard output if ``None``. Progress bars go to standard error.
        recipes: Other bounders than ``RECIPES``.
        resolution: Cells along an object's longest side.

    Returns:
        JSON-ready, see ``report.result``; of each run ``hits``: calls that found the ray stopped; ``size``, ``rays`` (shadow rays of all
            pictures), ``device``, ``bounders``: rows of each object.

    Raises:
        BoundingError: For an impossible option, an unknown device or a bounder file that does not fit.
    """
    out, console = Path(out), console or output()
    steps = STEPS[quick] if steps is None else steps
    if steps < 1:
        raise wb.BoundingError(f"steps must be at least 1, got {steps}")
    scene = Scene.still_life(*SIZES[quick], device)
    cells = {name: grid_of(shape, resolution) for name, shape in scene.shapes.items()}
    recipes = RECIPES if recipes is None else recipes
    options = {"refit": refit, "budget": budget, "out": out, "seed": seed, "device": str(scene.device)}
    whose = None if bounder_file is None else _object_of(Path(bounder_file), cells)
    rows, methods = {}, {name: {} for name in recipes}
    for name, grid in cells.items():
        file = bounder_file if name == whose else None
        bounders = bounders_of(SCENES + name, grid, recipes, file=file, **options)
        for method, bounder in bounders.items():
            check_rays(bounder, f"{method} of the {name}")
            methods[method][name] = bounder
        rows[name] = bounder_rows(bounders, grid, SAMPLES[quick])
    examples = simulate(scene, methods, steps=steps)
    runs = compare(examples, methods, rows)
    rays, (width, height) = sum(examples["none"].rays), SIZES[quick]
    title = (
        f"{steps} pictures, {width} x {height} pixels, {rays // steps:,} shadow rays, {len(cells)} objects; per picture"
    )
    console.print(run_table(title, runs, steps=steps, calls="mesh rays"))
    console.print(verdict(runs, "shadow pixels"))
    with bar("drawing") as update:
        update(0.3, 1.0, "")
        picture, same = _picture(out, methods, device)
    if not same:
        console.print("[bold red]Broken promise: the large picture is not the one without a broad phase.[/]")
    console.print(f"Picture: {picture}", markup=False)
    more = {"size": [width, height], "rays": rays, "device": str(scene.device), "bounders": rows}
    told = result("shadows", " and ".join(cells), steps, runs, [picture], **more)
    return told | {"identical": told["identical"] and same}


def compare(
    examples: dict[str, Example], methods: dict[str, dict[str, wb.Bounder]], rows: dict[str, list[dict]] | None = None
) -> list[Run]:
    """What the series cost and lost against ``"none"``, the reference.

    Args:
        examples: As ``simulate`` returns them.
        methods: As it takes them.
        rows: Per object, what ``report.bounder_rows`` says of its bounders; a run's rate of false positives is their mean.
    """
    reference, runs = examples["none"], []
    final = reference.state()
    for name, example in examples.items():
        bounders = methods.get(name, {}).values()
        kinds = [bounder.certificate.kind if bounder.certificate else "" for bounder in bounders]
        certificate = next((kind for kind in ("", "statistical", "proven") if kind in kinds), "")  # the weakest
        rates = [row["fp_rate"] for of in (rows or {}).values() for row in of if row["bounder"] == name]
        calls = sum(example.calls)
        run = Run(name, calls, *example.milliseconds(), 0, True, float(np.mean(rates)) if rates else None, certificate)
        run.missed, run.identical = example.missed(reference), example.state() == final
        run.extra = {"hits": sum(example.hits)}
        runs.append(run)
    return runs


def _object_of(path: Path, cells: dict[str, wb.IndicatorGrid]) -> str:
    """Whose bounder a file holds: of the object with its very cells; of the first, which then refuses it, if there is none."""
    if not path.is_file():
        raise wb.BounderError(f"{path}: there is no such file")
    made = wb.load(path, device="cpu").info.get("indicator")
    return next((name for name, grid in cells.items() if grid.digest == made), next(iter(cells)))


def _picture(out: Path, methods: dict[str, dict[str, wb.Bounder]], device: str | None) -> tuple[Path, bool]:
    """Draw one place of the sun: with a proven bounder, and with ``occupancy`` where there is one.

    Returns:
        The file, and whether what is proven changed nothing.
    """
    from sims.shadows.pictures import OVERSAMPLING, draw

    width, height = SIZES[False]
    scene = Scene.still_life(width * OVERSAMPLING, height * OVERSAMPLING, device)

    def proven(name: str) -> bool:
        return all(b.certificate is not None and b.certificate.proven for b in methods[name].values())

    kept = [name for name in SHOWN if name in methods and proven(name)][:1]
    shown = kept + [name for name in ("occupancy",) if name in methods] or ["none"]
    examples = {"none": Example(scene, sun=SUN)}
    examples |= {name: Example(scene, methods[name], sun=SUN) for name in shown if name != "none"}
    for example in examples.values():
        example.step()
    reference = examples["none"]
    same = all(examples[name].state() == reference.state() for name in kept)
    return draw(out, reference, {name: examples[name] for name in shown}), same
