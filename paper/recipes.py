"""Trains one network by the paper's recipe and by ours, in the same time, and compares false positives."""

from pathlib import Path
from typing import Any

import torch

from paper import results
from paper.cells import Cell, about, missing, select
from paper.comparisons import PaperTrainer
from paper.proofs import Thresholds
from paper.results import markdown
from paper.table import COLUMNS, Variant, column_of
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import QueryError
from warp_bounding.proof import prove
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.training import fit
from warp_bounding.training.engine import Clock, single_threaded_torch
from warp_bounding.training.samples import samples_of

NAME = "recipes"
CSV = """dimension object query method way steps steps_asked step_seconds fp_rate fn fp_zero fn_zero positives
    certificate fit_seconds nbytes hidden seconds samples seed length threads indicator versions""".split()
DEFAULTS = {"seconds": 600.0, "samples": 400_000, "seed": 0, "length": 1.0}
WAYS = ("default", "paper")
POINTS = ",".join(c.name for c in COLUMNS if not c.kind.is_region)
FOR_PROOF = 0.1  # of the time of the paper's training
STEPS = (1 + PaperTrainer.paper.stable) * PaperTrainer.paper.stage  # that the paper's recipe takes at least


def run(line, data, output, columns=None, objects=None, seconds=None, samples=None, seed=None) -> int:
    """Train the paper's network by its recipe and by ours."""
    cells = select(data, columns or POINTS, None, objects, [Variant(Mlp.method)])
    if any(cell.column.kind.is_region for cell in cells):
        raise QueryError(f"columns must be of points: {POINTS}")
    given = {"seconds": seconds, "samples": samples, "seed": seed}
    folder = results.opened(Path(output), NAME, CSV, DEFAULTS, given)
    if left := missing(cells, folder, "way", WAYS):
        folder.remember(line)

    def measure(work: tuple[Cell, str]) -> str:
        folder.append(row := _measured(*work, folder.settings))
        return f"{row['steps']:,} steps in {row['fit_seconds']:.0f} s, {row['fp_rate']:.2f} % false positives"

    done = results.work(folder, left, measure, lambda work: f"{work[0].title} ({work[1]})")
    folder.write(results.PAGE, page(folder))
    return int(not done)


def _trained(cell: Cell, way: str, seconds: float, seed: int) -> tuple[Mlp, int, float, float]:
    """A network with a proven threshold, its steps, and seconds of training and in all."""
    grid, started = cell.grid, working_seconds()
    if way == WAYS[0]:
        own = {"method": "mlp", "activation": "sin", "hidden": cell.column.hidden}
        bounder = results.finished(fit(grid, **own, budget=seconds, seed=seed, device="cpu"))
        record, spent = bounder.info["training"], working_seconds() - started
        return bounder, record["steps"], spent - float(bounder.certificate.seconds), spent
    domain, clock = domain_of(grid, cell.column.query), Clock((1 - FOR_PROOF) * seconds)
    trainer = PaperTrainer(samples_of(grid, domain, seed), cell.column.hidden, "sin")
    with single_threaded_torch(), torch.no_grad():
        trainer.run(clock)
    trained = working_seconds() - started
    bounder = Mlp(domain, trainer.finish(), {"hidden": list(cell.column.hidden), "activation": "sin"}, "cpu")
    prove(bounder, grid, budget=FOR_PROOF * seconds)
    return bounder, clock.count, trained, working_seconds() - started


def _measured(cell: Cell, way: str, s: dict[str, Any]) -> dict[str, Any]:
    bounder, steps, trained, spent = _trained(cell, way, s["seconds"], s["seed"])
    rates, threshold = Thresholds.of(bounder, cell.grid, s["samples"], s["seed"] + 1), float(bounder.threshold)
    row = about(cell, bounder, s) | {"way": way, "steps": steps, "steps_asked": STEPS if way == WAYS[1] else None}
    row |= {"step_seconds": trained / max(steps, 1), "fit_seconds": round(spent, 3), "seconds": s["seconds"]}
    row |= {"fp_rate": rates.fp(threshold), "fn": rates.fn(threshold), "positives": 100 * float(rates.truth.mean())}
    return row | {"fp_zero": rates.fp(0.0), "fn_zero": rates.fn(0.0)}


def page(folder: results.Folder) -> str:
    """The page, in Markdown."""
    rows = sorted(folder.rows, key=lambda r: (COLUMNS.index(column_of(r)), r["object"], r["way"]))
    heads = "|object|training|steps|of at least|hours for these|FP %, threshold proven|FP % at 0.5|FN % at 0.5"
    lines = [
        (column_of(r).title, r["object"], r["way"], f"{r['steps']:,}")
        + (("–", "–") if not r["steps_asked"] else (f"{STEPS:,}", f"{STEPS * r['step_seconds'] / 3600:.1f}"))
        + (f"{r['fp_rate']:.2f}", f"{r['fp_zero']:.2f}", f"{100 * r['fn_zero'] / r['samples']:.3f}")
        for r in rows
    ]
    return folder.page(NAME, seconds=f"{folder.settings['seconds']:g}", table=markdown(heads.split("|"), lines, 3))
