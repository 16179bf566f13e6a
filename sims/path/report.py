"""What the demo ``path`` says of its runs: the rows of its table, and the sentences that go with it."""

from rich.console import Console
from rich.markup import escape

import warp_bounding as wb
from sims.path.planner import Example
from sims.path.worlds import World
from sims.report import Run, run_table, verdict

__all__ = ["compare", "described", "report"]

WIDE = 116  # columns of a terminal, where the table has room for more than all demos' tables have


def compare(
    world: World, examples: dict[str, Example], bounders: dict[str, wb.Bounder], rows: list[dict], section: str = ""
) -> list[Run]:
    """What the runs in a world cost, and what they lost.

    Args:
        world: Where.
        examples: The runs of ``simulate``.
        bounders: What they asked.
        rows: Of ``sims.report.bounder_rows``.
        section: Of the table.
    """
    runs, none = [], examples["none"]
    rates = {row["bounder"]: row["fp_rate"] for row in rows}
    for name, example in examples.items():
        broad, narrow, whole = (1e3 * seconds for seconds in example.seconds)
        saved = none.checks - example.checks
        extra = {
            "world": world.name,
            "fewer": none.checks / max(example.checks, 1),
            "solved": example.solved,
            "collisions": int(example.collisions().sum()),
            "mean_length": example.mean_length if example.solved else None,
            "us_per_saved_check": 1e3 * broad / saved if saved > 0 else None,
        }
        runs.append(
            Run(
                bounder=name,
                narrow_calls=example.checks,
                ms_broad=broad,
                ms_narrow=narrow,
                ms_step=whole,
                missed=example.missed(),
                identical=example.state() == none.state(),
                fp_rate=rates.get(name),
                certificate=_certificate(name, bounders),
                section=section,
                extra=extra,
            )
        )
    return runs


def _certificate(name: str, bounders: dict[str, wb.Bounder]) -> str:
    """The weakest kind of the certificates of a broad phase's parts; empty where one has none."""
    held = [bounders[part].certificate for part in name.split("+") if part in bounders]
    kinds = {None if certificate is None else certificate.kind for certificate in held}
    return "" if None in kinds or not kinds else "proven" if kinds == {"proven"} else "statistical"


def report(console: Console, worlds: list[World], examples: list[dict[str, Example]], runs: list[Run]) -> None:
    """Print the table and the sentences that go with it.

    Args:
        console: Where.
        worlds: All of them.
        examples: Per world the runs of ``simulate``.
        runs: What ``compare`` made of them.
    """
    first = examples[0]["none"]
    title = (
        f"{len(first.states):,} random states and {first.neighbours} neighbours each: exact checks of states and edges"
    )
    heads = {"fewer": "fewer", "solved": "solved", "collisions": "collide"} if console.width >= WIDE else {}
    console.print(run_table(title, runs, steps=1, calls="checks", extra=heads))
    console.print(verdict(runs, "colliding states and edges"))
    for run in runs:
        if not run.conservative:
            solved = f"{run.extra['collisions']:,} of its {run.extra['solved']:,} paths"
            console.print(f"[red]{run.bounder}[/] in {escape(run.extra['world'])}: {solved} collide.")
    for world, each in zip(worlds, examples, strict=True):
        none = each["none"]
        blocked, count = int(none.blocked.sum()), len(none.problems)
        mlp, share = each["mlp"], none.checks / max(each["mlp"].checks, 1)
        console.print(
            f"{world.name}: {none.checks:,} exact checks without a broad phase, {mlp.checks:,} with mlp: {share:.1f} times fewer.",
            markup=False,
        )
        kind = "random" if world.problems is None else f"of the {len(world.problems):,} of its scenario"
        console.print(
            f"{world.name}: {count:,} problems, {kind}; {none.solved:,} solved, {none.mean_length:.1f} cells on average; "
            f"{blocked:,} with a blocked start or goal, {count - blocked - none.solved:,} without a path in the roadmap.",
            markup=False,
        )
    console.print(_price(runs))


def _price(runs: list[Run]) -> str:
    """Whether a broad phase pays in time, told as it is."""
    calls, broad = (
        {name: sum(getattr(run, key) for run in runs if run.bounder == name) for name in ("none", "mlp", "bvh")}
        for key in ("narrow_calls", "ms_broad")
    )
    price = 1e3 * sum(run.ms_narrow for run in runs if run.bounder == "none") / calls["none"]
    saved = {name: calls["none"] - calls[name] for name in ("mlp", "bvh")}
    costs = {name: 1e3 * broad[name] / count for name, count in saved.items() if count > 0}
    paid = " and ".join(f"{name} {cost:.2g} us" for name, cost in costs.items()) or "nothing is saved"
    paying = " and ".join(name for name, cost in costs.items() if cost < price)
    end = f"so {paying} saves time" if paying else "so nothing saves time here, but would where a check costs more"
    return f"An exact check in a grid takes {price:.2g} us; each check that is saved costs {paid}: {end}."


def described(worlds: list[World], examples: list[dict[str, Example]]) -> list[dict]:
    """The worlds and their problems, JSON-ready."""
    return [
        {
            "world": world.name,
            "cells": list(world.grid.shape),
            "occupied": float(world.grid.occupancy.mean()),
            "digest": world.grid.digest,
            "problems": len(none.problems),
            "blocked": int(none.blocked.sum()),
            "solved": none.solved,
            "doubts": none.exact.doubts,
        }
        for world, none in zip(worlds, (each["none"] for each in examples), strict=True)
    ]
