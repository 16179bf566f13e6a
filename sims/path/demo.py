"""Running the demo ``path``: worlds, bounders, the planner with each of them, one table, one picture.

Bounders of the generated worlds come with the demo. Those of a user's world are fitted on the first run, and kept in the output folder under a name that
holds the world's digest, so that they are used again for the very same cells only.
"""

from pathlib import Path

from rich.console import Console

import warp_bounding as wb
from sims.path.broad import Boxes, BroadPhase, First, Samples, Segments
from sims.path.exact import ExactWorld
from sims.path.planner import Example
from sims.path.report import compare, described, report
from sims.path.worlds import World, generated, worlds_at
from sims.prefitted import Recipe, bounder_from, bounders_of, fit, stored
from sims.report import bar, bounder_rows, output, result

__all__ = ["RECIPES", "grids", "phases", "run", "simulate"]

HIDDEN = (50, 50)
RECIPES: dict[str, Recipe] = {
    "aabb": Recipe("aabb", query="box"),
    "kdop": Recipe("kdop", query="box"),
    "bvh": Recipe("bvh", query="box", options={"hidden": HIDDEN}),
    "learned-kdop": Recipe("learned-kdop", query="box", budget=5.0),
    "mlp": Recipe("mlp", budget=30.0, options={"hidden": HIDDEN}),
    "mlp-early": Recipe("mlp-early", budget=30.0, options={"hidden": HIDDEN}),
    "occupancy": Recipe("occupancy", budget=30.0, options={"hidden": HIDDEN}),
}
CASCADE = "aabb+mlp"  # boxes first, then a network's segments: bounders of different queries, so the planner puts them together
USERS_BUDGET = 20.0  # seconds a network, for a user's world
STATES, PROBLEMS, SAMPLES = 4000, 200, 200_000
QUICK_STATES, QUICK_PROBLEMS, QUICK_SAMPLES = 2500, 40, 20_000
WARM_UP = 300  # states of the run that loads kernels outside the timed part
REPEATS = 3  # of a run in full, for its time


def grids(device: str = "cpu") -> dict[str, wb.IndicatorGrid]:
    """The worlds whose bounders come with the demo, by the name under which these lie."""
    return {world.scene: world.grid for world in generated()}


def run(
    out: Path,
    *,
    quick: bool = False,
    refit: bool = False,
    budget: float | None = None,
    bounder_file: Path | None = None,
    world: str | Path | None = None,
    seed: int = 0,
    device: str = "cpu",
    states: int | None = None,
    problems: int | None = None,
    console: Console | None = None,
) -> dict:
    """Do the whole demo.

    Args:
        out: Folder for the picture, and for bounders that are fitted; made if there is none.
        quick: A small form.
        refit: Fit the networks anew, rather than load them.
        budget: Seconds a network, where one is fitted.
        bounder_file: A network to take as ``mlp``, for the world whose cells it was fitted to.
        world: A file or a folder of worlds, instead of the generated ones.
        seed: Of states, problems and fits.
        device: Warp device.
        states: Random states of a roadmap; 4,000 by default, 2,500 if quick.
        problems: Problems a world; 200 by default, 40 if quick.
        console: Where tables and sentences go; standard output if ``None``. Progress bars go to standard error.

    Returns:
        JSON-ready: see ``sims.report.result``; the only step plans everything in a world, and runs are told apart by ``world``. Besides:
        ``worlds`` and ``bounders``.

    Raises:
        BoundingError: For an impossible option, a world that cannot be read, or a bounder file that does not fit.
    """
    out, console = Path(out), console or output()
    states = (QUICK_STATES if quick else STATES) if states is None else states
    problems = (QUICK_PROBLEMS if quick else PROBLEMS) if problems is None else problems
    if states < 2 or problems < 1:
        raise wb.BoundingError(f"expected at least 2 states and 1 problem, got {states} and {problems}")
    if budget is not None and not budget > 0:
        raise wb.BoundingError(f"budget must be a positive number of seconds, got {budget}")
    worlds = generated() if world is None else worlds_at(world)
    files = _files(worlds, bounder_file)
    rows, runs, examples, asked = [], [], [], []
    for place in worlds:
        bounders = _bounders(place, files.get(place.scene), out, refit, budget, seed, device, console)
        measured = bounder_rows(bounders, place.grid, QUICK_SAMPLES if quick else SAMPLES)
        options = {"states": states, "problems": problems, "seed": seed, "device": device}
        each = simulate(place, bounders, repeats=1 if quick else REPEATS, **options)
        runs += compare(place, each, bounders, measured, section=place.name if len(worlds) > 1 else "")
        rows += [{"world": place.name, **row} for row in measured]
        examples.append(each)
        asked.append((bounders["mlp"], bounders["occupancy"]))
    report(console, worlds, examples, runs)
    with bar("drawing") as update:
        update(0.3, 1.0, "")
        from sims.path.pictures import draw

        pairs = [(each["mlp"], each["occupancy"]) for each in examples]
        pictures = [draw(out, pairs, asked, ("mlp", "occupancy"))]
    console.print("\n".join(f"Picture: {path}" for path in pictures), markup=False)
    shape = ", ".join(place.name for place in worlds)
    return result("path", shape, 1, runs, pictures, worlds=described(worlds, examples), bounders=rows)


def _files(worlds: list[World], file: Path | None) -> dict[str, Path]:
    """The world that a user's file belongs to, by its cells."""
    if file is None:
        return {}
    digest = wb.load(file).info.get("indicator")
    scenes = [world.scene for world in worlds if world.grid.digest == digest]
    if not scenes:
        expected = ", ".join(f"{world.name} ({world.grid.digest[:12]})" for world in worlds)
        raise wb.BounderError(f"{file}: expected a bounder of one of {expected}, got one of {str(digest)[:12]}")
    return {scenes[0]: Path(file)}


def _bounders(
    world: World,
    file: Path | None,
    out: Path,
    refit: bool,
    budget: float | None,
    seed: int,
    device: str,
    console: Console,
) -> dict[str, wb.Bounder]:
    """All bounders of a world: from the demo's own files, or fitted here and kept in ``out``."""
    if world.fitted:
        options = {"refit": refit, "budget": budget, "out": out, "file": file, "seed": seed, "device": device}
        return bounders_of(world.scene, world.grid, RECIPES, **options)
    bounders, fitted, again = {}, [], []
    for name, recipe in RECIPES.items():
        path = stored(world.scene, name, out)
        if recipe.closed:
            bounders[name] = fit(recipe, world.grid, device=device)
        elif name == "mlp" and file is not None:
            bounders[name] = bounder_from(file, world.grid, recipe, device=device)
        elif path.is_file() and not refit:
            bounders[name] = bounder_from(path, world.grid, recipe, device=device)
            again.append(name)
        else:
            bounders[name] = fit(recipe, world.grid, budget=budget or USERS_BUDGET, seed=seed, device=device)
            out.mkdir(parents=True, exist_ok=True)
            bounders[name].save(path)
            fitted.append(name)
    if fitted:
        text = f"{world.name}: fitted {', '.join(fitted)} for this world; kept in {out} for the next time."
        console.print(text, markup=False)
    if again:
        text = f"{world.name}: took {', '.join(again)} from {out}, fitted to these very cells before."
        console.print(text, markup=False)
    return bounders


def phases(bounders: dict[str, wb.Bounder], world: World) -> dict[str, BroadPhase]:
    """The broad phases of a world's bounders, and their cascade."""
    made: dict[str, BroadPhase] = {}
    for name, bounder in bounders.items():
        if not bounder.conservative:
            made[name] = Samples(bounder, world.grid.cells_per_unit)
        else:
            made[name] = Boxes(bounder) if bounder.query_kind == "box" else Segments(bounder)
    if {"aabb", "mlp"} <= made.keys():
        cascade = {CASCADE: First(made["aabb"], made["mlp"])}
        last = made.pop("occupancy", None)
        made |= cascade | ({} if last is None else {"occupancy": last})
    return made


def simulate(
    world: World, bounders: dict[str, wb.Bounder], *, repeats: int = 1, device: str = "cpu", **options
) -> dict[str, Example]:
    """The same problems once without a broad phase (``"none"``) and once with each.

    Args:
        world: Where.
        bounders: By name.
        repeats: How often each run is done; the times are those of the run of median time.
        device: Warp device.
        options: Of ``Example``.

    Returns:
        The runs, finished.
    """
    exact, examples = ExactWorld(world.grid, device), {}
    broad = {"none": None, **phases(bounders, world)}
    with bar(f"planning in {world.name}") as update:
        for done, (name, phase) in enumerate(broad.items()):
            update(done, len(broad), name)
            Example(world, phase, exact=exact, **{**options, "states": WARM_UP, "problems": 1}).step()
            examples[name] = example = Example(world, phase, exact=exact, **options)
            seconds = []
            for _ in range(repeats):
                example.step()
                seconds.append(example.seconds)
            example.seconds = sorted(seconds, key=lambda spent: spent[-1])[repeats // 2]
    return examples
