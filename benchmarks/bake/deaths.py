"""A bake whose workers, client and scheduler are killed, and what is there at its end."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil

import warp_bounding as wb
from warp_bounding.baking.bake import Record

__all__ = ["WORKERS", "killed"]

WORKERS = 2
SCHEDULER_PORT = 18786


class Bakes:
    """One folder that is baked again and again, whatever is killed."""

    def __init__(self, shapes: Path, out: Path, fit: list[str], every: float, seed: int):
        self.shapes, self.out, self.fit, self.every = shapes, out, fit, every
        self.rng, self.last = np.random.default_rng(seed), time.monotonic()
        self.log = (out.parent / "log.txt").open("ab")
        self.deaths = {"worker": 0, "client": 0, "scheduler": 0}
        self.seen: dict[str, int] = {}  # when each record without an error was written, as it was seen first
        self.spoilt: set[str] = set()  # records that were there and were lost, or written again
        self.statuses: list[int] = []

    def command(self, *more: str) -> list[str]:
        """The command line of a bake."""
        start = [sys.executable, "-m", "warp_bounding", "bake", str(self.shapes), "--out", str(self.out)]
        return [*start, *self.fit, "--json", *more]

    def records(self) -> dict[str, int]:
        """When each record without an error was written, nanoseconds."""
        files = (self.out / "records").glob("*.json")
        return {f.name: f.stat().st_mtime_ns for f in files if (r := Record.read(f)) is not None and not r.error}

    def until(self, process: subprocess.Popen, workers, done: int) -> None:
        """Kill a worker every so often until so many shapes are done, or the process has ended."""
        while process.poll() is None and len(self.watched()) < done:
            time.sleep(0.5)
            alive = workers()
            if time.monotonic() - self.last > self.every and len(alive) == WORKERS:
                os.kill(alive[self.rng.integers(len(alive))], signal.SIGKILL)
                self.deaths["worker"] += 1
                self.last = time.monotonic()
                print(f"{len(self.records())} done, worker killed", file=sys.stderr, flush=True)

    def local(self, done: int) -> dict | None:
        """Bake on processes of the client until so many are done, and kill the client; what it prints if it ends before."""
        process = subprocess.Popen(self.command("--jobs", str(WORKERS)), stdout=subprocess.PIPE, stderr=self.log)
        self.until(process, lambda: fitting(process.pid), done)
        told = None
        if process.poll() is None:
            process.kill()
            self.deaths["client"] += 1
        else:
            told = json.loads(process.stdout.read())
        process.wait()
        self.statuses.append(process.returncode)
        self.watched()
        return told

    def remote(self, done: int) -> str:
        """Bake on a scheduler of its own until so many are done, and kill that; what the client says."""
        address, at = f"tcp://127.0.0.1:{SCHEDULER_PORT}", [sys.executable, "-m", "distributed.cli"]
        scheduler = subprocess.Popen(
            [
                *at[:2],
                "distributed.cli.dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                str(SCHEDULER_PORT),
                "--no-dashboard",
            ],
            stdout=self.log,
            stderr=self.log,
        )
        start = [*at[:2], "distributed.cli.dask_worker", address, "--nworkers", str(WORKERS), "--nthreads", "1"]
        workers = subprocess.Popen([*start, "--no-dashboard"], stdout=self.log, stderr=self.log)
        try:
            client = subprocess.Popen(
                self.command("--scheduler", address), stdout=self.log, stderr=subprocess.PIPE, text=True
            )
            self.until(client, lambda: fitting(workers.pid), done)
            scheduler.kill()
            self.deaths["scheduler"] += 1
            said = client.communicate(timeout=120)[1].strip().splitlines()
            self.statuses.append(client.returncode)
        finally:
            scheduler.kill()
            for child in psutil.Process(workers.pid).children(recursive=True):
                child.kill()
            workers.kill()
            scheduler.wait()
            workers.wait()
        self.watched()
        return said[-1] if said else ""

    def watched(self) -> dict[str, int]:
        """The records as they are now; those that were there before and are gone, or written again, are remembered."""
        now = self.records()
        self.spoilt |= {name for name, written in self.seen.items() if now.get(name) != written}
        self.seen = now | self.seen
        return now


def fitting(pid: int) -> list[int]:
    """The processes below this one that Dask has started as workers, if they are up."""
    try:
        below = psutil.Process(pid).children(recursive=True)
        return [p.pid for p in below if "spawn_main" in " ".join(p.cmdline()) and p.cpu_times().user > 1.0]
    except psutil.Error:
        return []


def killed(shapes: Path, work: Path, fit: list[str], every: float, seed: int) -> dict:
    """A bake with deaths, and what is there at its end."""
    count, started = len(list(shapes.iterdir())), time.perf_counter()
    bakes = Bakes(shapes, work / "killed", fit, every, seed)
    bakes.local(count // 3)
    said = bakes.remote(2 * count // 3)
    while (told := bakes.local(count + 1)) is None:
        pass
    seconds = time.perf_counter() - started
    again = bakes.local(count + 1)
    library = wb.BounderLibrary(bakes.out, device="cpu")
    kinds = [library[name].certificate.kind for name in library.names]
    return {
        "shapes": count,
        "seconds": round(seconds, 1),
        "deaths": bakes.deaths,
        "files": len(library),
        "names": len({name.rpartition("-")[0] or name for name in library.names}),
        "certified": sum(kind in ("proven", "statistical") for kind in kinds),
        "proven": kinds.count("proven"),
        "rows": len(library.manifest),
        "failed": told["failed"],
        "lost_or_twice": len(bakes.spoilt),
        "again": {name: again[name] for name in ("baked", "kept", "seconds")},
        "scheduler_gone": said.replace(str(work), "."),
        "statuses": bakes.statuses,
    }
