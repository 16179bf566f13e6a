"""What the engine costs: a bake without deaths, the scheduler's pace, and what follows from them for a cluster."""

import heapq
import json
import math
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from deaths import WORKERS

from warp_bounding.baking.bake import Job, Record, Settings

__all__ = ["CLUSTER_CORES", "CLUSTER_SHAPES", "empty", "pace", "scaled", "simulated", "undisturbed"]

CLUSTER_SHAPES, CLUSTER_CORES = 100_000, 1_000
EMPTY_TASKS = 5_000
TASK_SECONDS = (1.0, 60.0)  # a closed form of a small mesh; a network by the default budget


def undisturbed(shapes: Path, work: Path, fit: list[str]) -> dict:
    """A bake without deaths: what its tasks take of the workers' time."""
    start = [sys.executable, "-m", "warp_bounding", "bake", str(shapes), "--out", str(work / "calm")]
    done = subprocess.run([*start, *fit, "--json", "--jobs", str(WORKERS)], stdout=subprocess.PIPE, check=True)
    told = json.loads(done.stdout)
    names = ("shapes", "failed", "proven", "seconds", "running_seconds", "task_seconds", "workers")
    row = {name: told[name] for name in names}
    row["overhead"] = 1.0 - told["task_seconds"] / (told["workers"] * told["running_seconds"])
    files = (work / "calm" / "records").glob("*.json")
    row["task"] = sorted(Record.read(file).seconds for file in files)
    row["startup_seconds"] = round(told["seconds"] - told["running_seconds"], 3)
    return row


def pace(work: Path, fit: dict) -> dict:
    """How many empty tasks a second the scheduler hands out, and how many bytes a task moves."""
    import distributed

    record = Record(
        "shape0000", "shape0000.ply", "0" * 12, "0" * 12, "shape0000-000000000000.safetensors", "mlp", "point"
    )
    job = Job(str(work / "shapes" / "shape0000.ply"), str(work / "calm"), record, Settings(fit))
    with (
        distributed.LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, dashboard_address=None, memory_limit=0
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.gather(client.map(empty, [(job, -i) for i in range(1, 100)], pure=False))
        started = time.perf_counter()
        client.gather(client.map(empty, [(job, i) for i in range(EMPTY_TASKS)], pure=False))
        seconds = time.perf_counter() - started
    return {
        "tasks": EMPTY_TASKS,
        "seconds": round(seconds, 3),
        "per_second": EMPTY_TASKS / seconds,
        "bytes_there": len(pickle.dumps(job)),
        "bytes_back": len(pickle.dumps(vars(record))),
    }


def empty(job) -> dict:
    """A task that does nothing, with the arguments and about the result of one that bakes."""
    return vars(job[0].record)


def simulated(seconds: list[float], shapes: int, cores: int, per_second: float, seed: int) -> float:
    """Seconds until so many tasks are done on so many cores, if a scheduler hands out one after another at this pace."""
    rng, free, clock, end = np.random.default_rng(seed), [0.0] * cores, 0.0, 0.0
    for length in rng.choice(seconds, shapes):
        clock = max(clock, heapq.heappop(free)) + 1.0 / per_second
        heapq.heappush(free, clock + length)
        end = max(end, clock + length)
    return end


def scaled(row: dict, seed: int) -> list[dict]:
    """What 10^5 shapes take on 1,000 cores, for tasks as they were measured and for longer ones."""
    measured, found = np.array(row["calm"]["task"]), []
    for mean in sorted({*TASK_SECONDS, float(measured.mean())}):
        seconds = measured * (mean / measured.mean())
        ideal = CLUSTER_SHAPES * seconds.mean() / CLUSTER_CORES
        by_pace = CLUSTER_SHAPES / row["pace"]["per_second"]
        found.append(
            {
                "task_seconds": float(seconds.mean()),
                "ideal_seconds": ideal,
                "scheduler_seconds": by_pace,
                "simulated_seconds": simulated(seconds, CLUSTER_SHAPES, CLUSTER_CORES, row["pace"]["per_second"], seed),
                "shapes_a_task": math.ceil(CLUSTER_CORES / (row["pace"]["per_second"] * mean)),
                "saturated_at_cores": row["pace"]["per_second"] * float(seconds.mean()),
            }
        )
    return found
