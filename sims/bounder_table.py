"""Fitting every method to one shape and measuring what each costs and lets through: the demos' first table."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import warp as wp
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import warp_bounding as wb

__all__ = ["bar", "bounder_rows", "bounder_table", "fit_network", "load_network", "save_in"]

SAMPLES = 1_000_000
REPEATS = 7


@contextmanager
def bar(description: str) -> Iterator[Callable[[float, float, str], None]]:
    """A progress bar on standard error; yields ``update(done, total, note="")``."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=28),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(description, total=1.0, note="")
        yield lambda done, total=1.0, note="": progress.update(task, completed=done / total, note=note)


def fit_network(grid: wb.IndicatorGrid, *, budget: float, seed: int, device: str) -> wb.Bounder:
    """A 3-50-50-1 network, trained and proven within the budget (seconds)."""
    with bar(f"fitting a network, {budget:g} s") as update:
        return wb.fit(
            grid,
            method="mlp",
            hidden=(50, 50),
            budget=budget,
            seed=seed,
            margin=grid.margin,
            resolution=grid.resolution,
            device=device,
            progress=update,
        )


def load_network(path: str | os.PathLike, grid: wb.IndicatorGrid, *, device: str) -> wb.Bounder:
    """A bounder from a file, proven anew for this very grid.

    Raises:
        BounderError: If it has no proof there.
    """
    bounder = wb.load(path, device=device)
    if bounder.info.get("margin") != grid.margin or bounder.info.get("resolution") != grid.resolution:
        made = f"margin {bounder.info.get('margin')}, resolution {bounder.info.get('resolution')}"
        raise wb.BounderError(f"{path}: expected margin {grid.margin}, resolution {grid.resolution}, got {made}")
    certificate = wb.certify(bounder, grid)
    if not certificate.proven:
        raise wb.BounderError(f"{path}: expected a bounder of {grid.name}, got none: {certificate.message}")
    return bounder


def nanoseconds(bounder: wb.Bounder, samples: int = SAMPLES, seed: int = 2) -> float:
    """Time of one query, in a batch of points uniform in the domain, on all cores; median of several batches."""
    domain, rng = bounder.domain, np.random.default_rng(seed)
    points = (domain.lower + rng.random((samples, 3)) * (domain.upper - domain.lower)).astype(np.float32)
    x = wp.array(points, dtype=wp.vec3, device=bounder.device)
    out = wp.empty(samples, dtype=wp.uint8, device=bounder.device)
    spent = []
    for _ in range(REPEATS + 1):  # the first one loads the kernel
        wp.synchronize_device(bounder.device)
        start = time.perf_counter()
        bounder.query(x, out=out)
        wp.synchronize_device(bounder.device)
        spent.append(time.perf_counter() - start)
    return 1e9 * float(np.median(spent[1:])) / samples


def bounder_rows(bounders: dict[str, wb.Bounder], grid: wb.IndicatorGrid, samples: int = SAMPLES) -> list[dict]:
    """What there is to know about each bounder of a grid.

    Returns:
        Per bounder: ``bounder``, ``fp_rate`` (per cent of all samples), ``fn`` (a count), ``ns_query``, ``bytes``, ``proven``.
    """
    rows = []
    with bar("measuring bounders") as update:
        for done, (name, bounder) in enumerate(bounders.items()):
            update(done, len(bounders), name)
            rates = wb.evaluate(bounder, grid, samples=samples)
            rows.append(
                {
                    "bounder": name,
                    "fp_rate": rates.fp_rate,
                    "fn": rates.fn,
                    "ns_query": nanoseconds(bounder, samples),
                    "bytes": bounder.nbytes,
                    "proven": bounder.certificate is not None and bounder.certificate.proven,
                }
            )
    return rows


def bounder_table(rows: list[dict], samples: int = SAMPLES) -> Table:
    """The rows for people."""
    table = Table(
        title=f"Bounders of the bunny ({samples:,} random points each)",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("bounder", no_wrap=True)
    for column in ("FP %", "FN", "ns/query", "bytes"):
        table.add_column(column, justify="right")
    table.add_column("no false negative")
    for row in rows:
        numbers = (f"{row['fp_rate']:.2f}", f"{row['fn']}", f"{row['ns_query']:.1f}", f"{row['bytes']:,}")
        style = "bold" if row["bounder"] == "mlp" else None
        table.add_row(row["bounder"], *numbers, "proven" if row["proven"] else "not proven", style=style)
    return table


def save_in(bounder: wb.Bounder, folder: Path, name: str) -> Path:
    """Save a bounder in a folder that may not exist yet."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.safetensors"
    bounder.save(path)
    return path
