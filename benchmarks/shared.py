"""What several benchmarks share: rows that are kept, and contestants that are timed in turn.

In each round every contestant is timed once, so that a machine whose speed drifts does not matter: ratios are taken
within a round.
"""

import argparse
import json
import math
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from sims.versions import versions
from warp_bounding.runtime.launch import cpu_threads


class StoredRows:
    """A folder with rows, a line of JSON each, written as they are known, and a page of them; it resumes.

    Args:
        folder: Where; made if it is not there.
        name: Of the file, without its ending.

    Attributes:
        folder: Where.
        rows: In the order in which they were measured; each names the versions and the number of threads that it was
            measured with.
    """

    def __init__(self, folder: Path, name: str):
        self.folder, self._file = folder, folder / f"{name}.jsonl"
        folder.mkdir(parents=True, exist_ok=True)
        lines = self._file.read_text().splitlines() if self._file.exists() else []
        self.rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
        self._versions = versions()  # as the program begins

    def __len__(self) -> int:
        return len(self.rows)

    def have(self, **known: Any) -> bool:
        """Whether there is a row with these values."""
        return any(all(row.get(key) == value for key, value in known.items()) for row in self.rows)

    def add(self, row: dict[str, Any]) -> None:
        """Keep a row: once this returns, it is on the disk. JSON has no NaN: it is left out."""
        self.rows.append(_plain(row) | {"threads": cpu_threads(), "versions": self._versions})
        with self._file.open("a") as file:
            file.write(json.dumps(self.rows[-1]) + "\n")
            file.flush()
            os.fsync(file.fileno())

    @property
    def about(self) -> str:
        """Versions and threads in words, for the page."""
        reported = "; ".join(dict.fromkeys(row["versions"] for row in self.rows))
        return f"{reported}; {self.rows[0]['threads']} threads of a CPU"

    def write(self, page: str) -> None:
        """Write the page into the folder of the rows."""
        (self.folder / "README.md").write_text(page)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(own) for key, own in value.items()}
    if isinstance(value, list):
        return [_plain(own) for own in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def clock(function: Callable) -> tuple[float, float]:
    """Seconds of one call, by the wall and of all cores."""
    start, busy = time.perf_counter(), time.process_time()
    function()
    return time.perf_counter() - start, time.process_time() - busy


def race(
    contestants: dict[str, Callable], rounds: int, measure: Callable = clock, pause: float = 0.0
) -> dict[str, np.ndarray]:
    """What ``measure`` says of every contestant in every round, ``(rounds, ...)``, after one warm-up.

    Between them is a pause, in seconds, where one leaves threads behind that wait busily, as torch's do for some
    milliseconds.
    """
    for function in contestants.values():
        function()
    times = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, function in contestants.items():
            time.sleep(pause)
            times[name].append(measure(function))
    return {name: np.array(values) for name, values in times.items()}


def nanoseconds(bounder: Any, x: np.ndarray, rounds: int) -> float:
    """The time of one query of a batch ``(N, m)``: the least of several rounds."""
    import warp as wp

    queries, out = wp.array(x, dtype=float, device="cpu"), wp.empty(len(x), dtype=wp.bool, device="cpu")
    launch = bounder.prepare(queries, out=out).launch
    launch()
    return 1e9 * min(clock(launch)[0] for _ in range(rounds)) / len(x)


def evaluations(bounder: Any, a: np.ndarray, b: np.ndarray, most: int) -> np.ndarray:
    """``(N,)`` int, of a distance, for each segment: a march ends where it is clear, or where a step gains nothing."""
    going, last, count = np.ones(len(a), bool), np.zeros(len(a), np.float32), np.zeros(len(a), int)
    for steps in range(1, most + 1):
        count += going
        maybe, t = (part.numpy() for part in bounder.segments(a, b, steps=steps))
        going &= maybe & (t > last)
        last = t
        if not going.any():
            break
    return count


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
