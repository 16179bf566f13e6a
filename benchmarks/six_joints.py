"""An arm of six joints in a cell, proven: `python benchmarks/six_joints.py`.

A network whose threshold samples attest gets a lower one that is proven, by two processes of which one is killed every
ten minutes (``--kill``). What is left of the proof is kept in ``--kept``; the same command goes on from there, also on
another day. Without ``--network`` one is fitted first (``--effort`` seconds).

The page has what the proof took, and what it would take on more cores: the measured tasks are dealt out to them as Dask
does, each to the first that is free. Files of older versions, which know no joints, are read, too.
"""

import argparse
import heapq
import json
import os
import random
import signal
import threading
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
from robots import store, stored
from shared import nanoseconds

import warp_bounding as wb
from sims.arm.robots import CELLS
from sims.versions import versions
from warp_bounding.proof import halving
from warp_bounding.queries.domain import Domain
from warp_bounding.runtime import workers

CELL, HIDDEN, QUERIES = CELLS["six"], (12, 66, 66), 1_000_000
FIELDS = ("at", "given", "boxes", "left", "seconds", "killed")
CORES, PAUSE = (2, 16, 1000), 120.0  # seconds without a row after which the proof was stopped for a while


def network(file: Path | None, kept: Path, effort: float, shape: wb.arms.ArmConfigurations) -> wb.Bounder:
    """The statistical network, given, kept or fitted."""
    own = kept / "statistical.safetensors"
    if own.exists():
        return wb.load(own, device="cpu")
    if file is None:
        found = wb.fit(shape, hidden=HIDDEN, budget=effort, statistical=True, device="cpu")
    else:
        given = wb.load(file, device="cpu")
        found = type(given)(Domain.of(shape), given.tensors, given.sizes, "cpu").freeze(float(given.threshold), None)
        found.info = given.info | {"library": wb.__version__, "rates": None}
    found.save(own)
    return found


@contextmanager
def recorded(file: Path, kill: float):
    """Write a row for each task that ends; kill a worker now and then."""
    rows, ended, enter = stored(file), halving._Search.ended, workers.Workers.__enter__

    def noted(search, key, left) -> None:
        if key is not None:
            told = (time.time(), search.out[key].count, left.boxes, sum(each.count for each in left.waiting))
            rows.append(dict(zip(FIELDS, (*told, left.seconds, ""), strict=True)))
            store(file, FIELDS, rows)
        ended(search, key, left)

    def entered(self):
        found = enter(self)

        def kills() -> None:
            while not done.wait(kill):
                pids = [pid for pid in self._client.run(os.getpid, on_error="return").values() if isinstance(pid, int)]
                if pids:
                    os.kill(random.choice(pids), signal.SIGKILL)
                    rows.append(dict(zip(FIELDS, (time.time(), "", "", "", "", 1), strict=True)))

        threading.Thread(target=kills, daemon=True).start()
        return found

    done = threading.Event()
    halving._Search.ended, workers.Workers.__enter__ = noted, entered
    try:
        yield rows
    finally:
        done.set()
        halving._Search.ended, workers.Workers.__enter__ = ended, enter


def makespan(seconds: list[float], cores: int) -> float:
    """When the last of these tasks ends, each given to the core that is free first."""
    free = [0.0] * cores
    for each in seconds:
        heapq.heapreplace(free, free[0] + each)
    return max(free)


def page(known: dict, rows: list[dict], command: str) -> str:
    """The page, in Markdown: its conclusion first."""
    tasks = [float(row["seconds"]) for row in rows if row["seconds"]]
    killed = sum(bool(row["killed"]) for row in rows)
    hours = {cores: makespan(tasks, cores) / 3600 for cores in CORES}
    at = [float(row["at"]) for row in rows]
    wall = sum(min(late - early, PAUSE) for early, late in pairwise(at)) / 60
    return "\n".join(
        [
            "# Six joints, proven",
            "",
            f"**A network of {known['bytes']:,} bytes around the colliding configurations of an arm of six joints is "
            f"proven. It leaves {known['fp']:.1f} % of all configurations undecided that are free.**",
            "",
            f"`{command}`",
            "",
            f"{known['versions']}. The proof looked at {known['boxes']:,} boxes, in {len(tasks):,} tasks that take "
            f"{sum(tasks) / 3600:.2f} hours of one core. Two processes did them in {wall:.0f} minutes; one of the two "
            f"was killed {killed} times.",
            "",
            f"The threshold that samples attest left {known['fp_statistical']:.1f} %. A query takes {known['ns']:.0f} "
            "ns on one core.",
            "",
            "Dealt out to more cores the same tasks take "
            + ", ".join(f"{value * 60:.1f} minutes on {cores:,}" for cores, value in hours.items())
            + ". The longest task alone takes "
            + f"{max(tasks):.0f} s. [The log](tasks.csv) has a row for each task, and for each death of a process.",
            "",
        ]
    )


def main() -> None:
    """Go on with the proof, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/six-joints"))
    parser.add_argument("--kept", type=Path, default=Path("out/six"))
    parser.add_argument("--network", type=Path)
    parser.add_argument("--effort", type=float, default=1000.0)
    parser.add_argument("--budget", type=float, default=7200.0, help="seconds of the proof")
    parser.add_argument("--kill", type=float, default=600.0, help="seconds between two deaths")
    options = parser.parse_args()
    options.kept.mkdir(parents=True, exist_ok=True)
    shape = CELL.shape(self_collision=False)
    loose, file = network(options.network, options.kept, options.effort, shape), options.kept / "proven.safetensors"
    tasks = options.kept / "tasks.csv"
    if not file.exists():
        with recorded(tasks, options.kill):
            run = {"budget": options.budget, "scheduler": 2, "checkpoint": options.kept / "left"}
            wb.proof.make_proven(loose, shape, progress=told(), **run).save(file)
    proven = wb.load(file, device="cpu")
    q = np.random.default_rng(7).uniform(shape.lower, shape.upper, (QUERIES, shape.ndim)).astype(np.float32)
    free = ~shape.contains(q)
    rates = [100 * each.query(q).numpy()[free].sum() / QUERIES for each in (proven, loose)]
    known = {"bytes": proven.nbytes, "fp": rates[0], "fp_statistical": rates[1], "boxes": proven.certificate.boxes}
    known |= {"ns": nanoseconds(proven, q, 9), "versions": versions(), "certificate": proven.certificate.to_dict()}
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "six-joints.json").write_text(json.dumps(known, indent=1))
    (options.out / tasks.name).write_text(tasks.read_text())
    given = f" --network {options.network}" if options.network else f" --effort {options.effort:g}"
    command = f"python benchmarks/six_joints.py{given} --budget {options.budget:g}"
    text = page(known, stored(tasks), command)
    (options.out / "README.md").write_text(text)
    print(text)


def told():
    """Prints what is done, once a minute."""
    last = [0.0]

    def progress(done: float, total: float) -> None:
        if time.monotonic() - last[0] > 60:
            last[0] = time.monotonic()
            print(f"{time.strftime('%T')} {100 * done / total:.2f} %", flush=True)

    return progress


if __name__ == "__main__":
    main()
