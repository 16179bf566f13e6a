"""Contestants are timed in turn, round by round, so that a machine whose speed drifts does not matter: ratios are taken within a round."""

import argparse
import json
import time
from collections.abc import Callable, Iterable

import numpy as np
from rich.console import Console
from rich.table import Table

__all__ = ["clock", "options", "race", "show", "tell"]


def clock(function: Callable) -> tuple[float, float]:
    """Seconds of one call, by the wall and of all cores."""
    start, busy = time.perf_counter(), time.process_time()
    function()
    return time.perf_counter() - start, time.process_time() - busy


def race(
    contestants: dict[str, Callable], rounds: int, measure: Callable = clock, pause: float = 0.0
) -> dict[str, np.ndarray]:
    """What ``measure`` says of every contestant in every round, ``(rounds, ...)``, after one warm-up.

    Between them is a pause, in seconds, where one leaves threads behind that wait busily, as torch's do for some milliseconds.
    """
    for function in contestants.values():
        function()
    times = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, function in contestants.items():
            time.sleep(pause)
            times[name].append(measure(function))
    return {name: np.array(values) for name, values in times.items()}


def options(about: str, **numbers: int) -> argparse.ArgumentParser:
    """A command line with whole numbers, by their defaults, and ``--json``."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    return parser


def show(
    title: str, heads: Iterable[str], rows: Iterable[Iterable[str]], left: int = 1, width: int | None = None
) -> None:
    """A table; the first ``left`` of its columns are text, the others numbers."""
    table = Table(title=title)
    for place, head in enumerate(heads):
        table.add_column(head, justify="left" if place < left else "right")
    for row in rows:
        table.add_row(*row)
    Console(width=width).print(table)


def tell(head: dict, results: list[dict]) -> None:
    """For programs."""
    print(json.dumps(head | {"results": results}))
