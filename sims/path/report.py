"""What the demo ``path`` says of its runs, besides the table."""

from sims.path.planner import Example
from sims.report import Run

__all__ = ["described", "price", "solved"]

PRICED = (
    "mlp",
    "distance",
    "bvh",
    "distance-grid",
)  # runs of which it is told how many checks they save, and what one costs them


def solved(examples: dict[str, Example]) -> str:
    """What was checked and solved in one world, in two lines."""
    none = examples["none"]
    world, count, blocked = none.world, len(none.problems), int(none.blocked.sum())
    kind = "random" if world.problems is None else f"of the {len(world.problems):,} of its scenario"
    fewer = [
        f"{examples[name].checks:,} with {name} ({none.checks / max(examples[name].checks, 1):.1f} times fewer)"
        for name in PRICED
        if name in examples
    ]
    checks = ", ".join([f"{none.checks:,} exact checks without a broad phase", *fewer])
    return (
        f"{world.name}: {checks}.\n"
        f"{world.name}: {count:,} problems, {kind}; {none.solved:,} solved, {none.mean_length:.1f} cells on average; "
        f"{blocked:,} with a blocked start or goal, {count - blocked - none.solved:,} without a path in the roadmap."
    )


def price(runs: list[Run]) -> str:
    """Whether a broad phase pays in time, told as it is."""
    calls, broad = (
        {name: sum(getattr(run, key) for run in runs if run.bounder == name) for name in ("none", *PRICED)}
        for key in ("narrow_calls", "ms_broad")
    )
    price = 1e3 * sum(run.ms_narrow for run in runs if run.bounder == "none") / calls["none"]
    queried = {run.bounder for run in runs}
    saved = {name: calls["none"] - calls[name] for name in PRICED if name in queried}
    costs = {name: 1e3 * broad[name] / count for name, count in saved.items() if count > 0}
    paid = ", ".join(f"{name} {cost:.2g} us" for name, cost in costs.items()) or "nothing is saved"
    paying = [name for name, cost in costs.items() if cost < price]
    end = "so nothing saves time here, but would where a check costs more"
    if paying:
        end = f"so {' and '.join(paying)} {'saves' if len(paying) == 1 else 'save'} time"
    return f"An exact check in a grid takes {price:.2g} us; each check that is saved costs {paid}: {end}."


def described(none: Example) -> dict:
    """A world and its problems, JSON-ready, from its run without a broad phase."""
    grid = none.world.grid
    return {
        "world": none.world.name,
        "cells": list(grid.shape),
        "occupied": float(grid.occupancy.mean()),
        "digest": grid.digest,
        "problems": len(none.problems),
        "blocked": int(none.blocked.sum()),
        "solved": none.solved,
        "doubts": none.exact.doubts,
    }
