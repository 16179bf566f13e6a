"""The demo ``particles``: 100,000 particles rain on the Stanford bunny, with and without bounders (see ``sims.rain``).

    python -m sims.particles --out out/demo

It fits and proves every method, prints what each costs and lets through, runs the same simulation with no broad phase
and with several bounders, checks that no contact was missed and that all runs end in the same state to the bit, and
draws pictures.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import warp as wp
from rich import box
from rich.console import Console
from rich.table import Table

import warp_bounding as wb
from sims.bounder_table import bar, bounder_rows, bounder_table, fit_network, load_network, save_in
from sims.pictures import bounds_data, rain_data, render
from sims.rain import Example, Scene

__all__ = ["Example", "Scene", "run", "simulate"]

METHODS = ("aabb", "kdop", "voxels", "mlp")
TABLE_ONLY = (
    "aabb",
    "obb",
    "sphere",
    "ellipsoid",
    "oriented-ellipsoid",
    "kdop",
    "voxels",
)  # closed forms: no time at all
PICTURED = ("aabb", "kdop", "mlp")
WARM_UP = 4096  # particles of the run that loads kernels outside the timed part


def run(
    out: Path,
    *,
    budget: float = 30.0,
    resolution: int = 64,
    particles: int = 100_000,
    steps: int = 150,
    seed: int = 0,
    methods: Sequence[str] = METHODS,
    bounder_file: Path | None = None,
    device: str | None = None,
    console: Console | None = None,
) -> dict:
    """Do the whole demo.

    Args:
        out: Folder for pictures and the network, ``bunny.safetensors``; made if there is none.
        budget: Seconds for the network's training and proof.
        resolution: Cells along the bunny's longest side.
        particles: Number of particles.
        steps: Simulation steps.
        seed: Of training and particles.
        methods: Bounders to simulate with, besides no broad phase.
        bounder_file: A network fitted before, instead of fitting one; it is proven anew.
        device: Warp device; the default device if ``None``.
        console: Where tables and sentences go; standard output if ``None``. Progress bars go to standard error.

    Returns:
        JSON-ready: ``demo``, ``shape``, ``steps``, ``particles``, ``device``, ``certificate``, ``bounders``, ``runs``,
        ``identical``, ``pictures``, ``path``.

    Raises:
        BoundingError: For an impossible option, an unknown device or a bounder file that does not fit.
    """
    out, console = Path(out), console or Console(highlight=False, soft_wrap=True)
    if particles < 1 or steps < 1:
        raise wb.BoundingError(f"particles and steps must be at least 1, got {particles} and {steps}")
    try:
        scene = Scene.bunny(device)
    except (ValueError, RuntimeError) as error:
        if isinstance(error, wb.BoundingError):
            raise
        names = ", ".join(str(d) for d in wp.get_devices())
        raise wb.QueryError(f"device must be one of {names}, got {device!r}") from error
    name = str(scene.device)
    grid = scene.shape.to_grid(resolution=resolution, margin=scene.margin)
    bounders = {m: wb.fit(grid, method=m, margin=grid.margin, resolution=resolution, device=name) for m in TABLE_ONLY}
    path = bounder_file
    if bounder_file is not None:
        bounders["mlp"] = load_network(bounder_file, grid, device=name)
    elif "mlp" in methods:
        bounders["mlp"] = fit_network(grid, budget=budget, seed=seed, device=name)
        path = save_in(bounders["mlp"], out, "bunny")
    unknown = sorted(set(methods) - set(bounders))
    if unknown:
        raise wb.BounderError(f"methods must be of {', '.join(bounders)}, got {', '.join(unknown)}")
    shown = bounders.get("mlp", bounders["voxels"]).certificate
    console.print(shown.message)
    rows = bounder_rows(bounders, grid)
    console.print(bounder_table(rows))

    rates = {row["bounder"]: row["fp_rate"] for row in rows}
    examples = simulate(scene, {m: bounders[m] for m in methods}, particles=particles, steps=steps, seed=seed)
    runs, identical = compare(examples, rates)
    console.print(run_table(runs, steps, particles))
    missed = sum(r["missed"] for r in runs)
    console.print(
        f"Missed contacts: {missed}. Final particle states: "
        + ("bit-identical in all runs." if identical else "[bold red]they differ.[/]")
    )
    with bar("drawing") as update:
        update(0.3, 1.0, "")
        pictured = {m: (bounders[m], rates[m]) for m in PICTURED if m in bounders}
        drawn = render(out, bounds_data(scene.shape, pictured) | rain_data(examples["none"]))
    console.print("\n".join([*(f"Picture: {p}" for p in drawn.paths), *([drawn.problem] if drawn.problem else [])]))
    return {
        "demo": "particles",
        "shape": Path(scene.shape.name).name,
        "steps": steps,
        "particles": particles,
        "device": name,
        "certificate": shown.to_dict(),
        "bounders": rows,
        "runs": runs,
        "identical": identical,
        "pictures": [str(p) for p in drawn.paths],
        "path": None if path is None else str(path),
    }


def simulate(
    scene: Scene, bounders: dict[str, wb.Bounder], *, particles: int, steps: int, seed: int = 0
) -> dict[str, Example]:
    """The same rain once without a broad phase (``"none"``) and once with each bounder, from the same state.

    Returns:
        The runs, finished.
    """
    examples = {}
    for name, bounder in {"none": None, **bounders}.items():
        warm_up = Example(scene, bounder, particles=min(particles, WARM_UP), seed=seed)
        warm_up.step()
        warm_up.step()
        examples[name] = example = Example(scene, bounder, particles=particles, seed=seed)
        with bar(f"rain, broad phase: {name}") as update:
            for step in range(steps):
                example.step()
                update(step + 1, steps, "")
    return examples


def compare(examples: dict[str, Example], rates: dict[str, float]) -> tuple[list[dict], bool]:
    """What the runs cost, what they missed, and whether all of them ended in the same state."""
    reference = examples["none"]
    final = reference.state()
    runs = []
    for name, example in examples.items():
        broad, narrow, step = example.milliseconds()
        runs.append(
            {
                "bounder": name,
                "narrow_calls": sum(example.calls),
                "ms_broad": broad,
                "ms_narrow": narrow,
                "ms_step": step,
                "missed": example.missed(reference),
                "identical": example.state() == final,
                "fp_rate": rates.get(name),
            }
        )
    return runs, all(r["identical"] for r in runs)


def run_table(runs: list[dict], steps: int, particles: int) -> Table:
    """The runs for people."""
    title = f"{particles:,} particles, {steps} steps: narrow-phase calls and milliseconds per step (median)"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("bounder", no_wrap=True)
    for column in ("calls", "of all", "broad", "narrow", "step", "speed-up", "missed"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("state", no_wrap=True)
    for r in runs:
        numbers = (
            f"{r['narrow_calls'] / steps:,.0f}",
            f"{100 * r['narrow_calls'] / steps / particles:.1f} %",
            f"{r['ms_broad']:.2f}",
            f"{r['ms_narrow']:.2f}",
            f"{r['ms_step']:.2f}",
            f"{runs[0]['ms_step'] / r['ms_step']:.1f}x",
            f"{r['missed']}",
        )
        same = "-" if r["bounder"] == "none" else "identical" if r["identical"] else "[bold red]differs[/]"
        table.add_row(r["bounder"], *numbers, same, style="bold" if r["bounder"] == "mlp" else None)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """``python -m sims.particles``; exit status 1 if a run missed a contact or ended in another state."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for pictures and the network")
    parser.add_argument("--budget", type=float, default=30.0, help="seconds for fitting the network")
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bounder", type=Path, default=None, help="a network fitted before, instead of fitting one")
    parser.add_argument("--device", default=None, help="Warp device, such as cpu or cuda:0")
    options = vars(parser.parse_args(arguments))
    wp.config.quiet = True
    wp.config.log_level = getattr(wp, "LOG_ERROR", 40)
    try:
        result = run(options.pop("out"), bounder_file=options.pop("bounder"), **options)
    except wb.BoundingError as error:
        print(f"particles: {error}", file=sys.stderr)
        return 2
    return 0 if result["identical"] and all(r["missed"] == 0 for r in result["runs"]) else 1


if __name__ == "__main__":
    sys.exit(main())
