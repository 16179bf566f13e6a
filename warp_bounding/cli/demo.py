"""``warp-bounding demo``: the library at work on real input, with tables and pictures."""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from warp_bounding.cli.output import Device, Json, console, print_json, quiet_warp
from warp_bounding.errors import BoundingError

__all__ = ["DEMOS", "command"]

DEMOS = ("particles",)


def command(
    name: Annotated[str, typer.Argument(help=f"Which: {', '.join(DEMOS)}.")],
    out: Annotated[str, typer.Option(help="Folder for pictures and the bounder.")] = "out/demo",
    budget: Annotated[float, typer.Option(help="Seconds for fitting the network.")] = 30.0,
    particles: Annotated[int, typer.Option(help="Number of particles.")] = 100_000,
    steps: Annotated[int, typer.Option(help="Simulation steps.")] = 150,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Run a demo. Exit status 1 if it finds its own promise broken."""
    if name not in DEMOS:
        raise BoundingError(f"demo must be one of {', '.join(DEMOS)}, got {name!r}")
    if particles < 1 or steps < 1:
        raise BoundingError(f"particles and steps must be at least 1, got {particles} and {steps}")
    quiet_warp(device)
    result = import_module(f"sims.{name}").run(
        Path(out), budget=budget, particles=particles, steps=steps, seed=seed, device=device, console=console(json)
    )
    if json:
        print_json(result)
    return 0 if result["identical"] and all(run["missed"] == 0 for run in result["runs"]) else 1
