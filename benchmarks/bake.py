"""A bake whose workers, client and scheduler are killed, and its cost: `python benchmarks/bake.py --out results/bake`.

Random meshes are baked on two workers, one of which is killed (SIGKILL) every minute. After a third of the shapes the
client is killed, after two thirds the scheduler; each time the same command is started again. Then every file is
loaded, and it is counted what was lost and what was done twice. A second bake without deaths measures the engine's
overhead, empty tasks the scheduler's pace; from these follows what 10^5 shapes on 1,000 cores would take.
"""

import argparse
import heapq
import json
import math
import os
import pickle
import platform
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import trimesh

import warp_bounding as wb
from sims.versions import versions
from warp_bounding.baking import Job, Record, Settings

WORKERS, SCHEDULER_PORT = 2, 18786
CLUSTER_SHAPES, CLUSTER_CORES = 100_000, 1_000
EMPTY_TASKS = 5_000
TASK_SECONDS = (1.0, 60.0)  # a closed form of a small mesh; a network by the default budget


def write_shapes(folder: Path, count: int, seed: int) -> None:
    """So many random meshes: unions of two to four perturbed balls, boxes, capsules and rings, as .ply and .stl."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        rng, parts = np.random.default_rng([seed, number]), []
        for _ in range(rng.integers(2, 5)):
            kind = rng.integers(4)
            part = (
                trimesh.creation.icosphere(3)
                if kind == 0
                else trimesh.creation.box(rng.uniform(0.5, 2.0, 3)).subdivide_loop(2)
                if kind == 1
                else trimesh.creation.capsule(rng.uniform(0.5, 2.0), rng.uniform(0.2, 0.6))
                if kind == 2
                else trimesh.creation.torus(1.0, rng.uniform(0.15, 0.4))
            )
            wave = rng.normal(size=3)
            part.vertices *= 1.0 + 0.15 * np.sin(3.0 * part.vertices @ wave)[:, None]
            part.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
            part.apply_translation(rng.normal(size=3) * 0.6)
            parts.append(part)
        trimesh.util.concatenate(parts).export(folder / f"shape{number:04d}{('.ply', '.stl')[number % 2]}")


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
        start = [sys.executable, "-m", "warp_bounding", "bake", str(self.shapes), "--output", str(self.out)]
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
        """Bake on processes of the client until so many are done, then kill it; its output if it ends before."""
        process = subprocess.Popen(self.command("--jobs", str(WORKERS)), stdout=subprocess.PIPE, stderr=self.log)
        self.until(process, lambda: fitting(process.pid), done)
        reported = None
        if process.poll() is None:
            process.kill()
            self.deaths["client"] += 1
        else:
            reported = json.loads(process.stdout.read())
        process.wait()
        self.statuses.append(process.returncode)
        self.watched()
        return reported

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
    while (reported := bakes.local(count + 1)) is None:
        pass
    seconds = time.perf_counter() - started
    again = bakes.local(count + 1)
    library = wb.baking.BounderLibrary(bakes.out, device="cpu")
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
        "failed": reported["failed"],
        "lost_or_twice": len(bakes.spoilt),
        "again": {name: again[name] for name in ("baked", "kept", "seconds")},
        "scheduler_gone": said.replace(str(work), "."),
        "statuses": bakes.statuses,
    }


def undisturbed(shapes: Path, work: Path, fit: list[str]) -> dict:
    """A bake without deaths: what its tasks take of the workers' time."""
    start = [sys.executable, "-m", "warp_bounding", "bake", str(shapes), "--output", str(work / "calm")]
    done = subprocess.run([*start, *fit, "--json", "--jobs", str(WORKERS)], stdout=subprocess.PIPE, check=True)
    reported = json.loads(done.stdout)
    names = ("shapes", "failed", "proven", "seconds", "task_seconds")
    row = {name: reported[name] for name in names} | {"workers": WORKERS}
    ended = {file.stat().st_mtime: Record.read(file).seconds for file in (work / "calm" / "records").glob("*.json")}
    row["task"] = sorted(ended.values())
    row["running_seconds"] = max(ended) - min(end - seconds for end, seconds in ended.items())
    row["overhead"] = 1.0 - reported["task_seconds"] / (WORKERS * row["running_seconds"])
    row["startup_seconds"] = round(reported["seconds"] - row["running_seconds"], 3)
    return row


def pace(work: Path, fit: dict) -> dict:
    """How many empty tasks a second the scheduler hands out, and how many bytes a task moves."""
    import distributed

    record = Record(
        "shape0000", "shape0000.ply", "0" * 12, "0" * 12, "shape0000-000000000000.safetensors", "mlp", "point"
    )
    job = Job(str(work / "shapes" / "shape0000.ply"), work / "calm", record, Settings(fit, {}, None, 1))
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
    """Seconds until so many tasks are done on so many cores, if a scheduler deals them one by one at this pace."""
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


CONCLUSION = (
    "Nothing finished was lost or done twice, whatever was killed, and the engine takes a vanishing share of "
    "the workers' time. For a thousand cores, tasks of a few seconds are long enough."
)


def page(row: dict) -> str:
    """The page, in Markdown."""
    calm, killed_, pace_, deaths = row["calm"], row["killed"], row["pace"], row["killed"]["deaths"]
    moved = pace_["bytes_there"] + pace_["bytes_back"]
    lines = [
        "# A bake that is killed again and again, and what the engine costs",
        "",
        CONCLUSION,
        "",
        f"`{row['command']}`",
        "",
        f"{row['versions']}; {row['cores']} cores, {WORKERS} workers, load average {row['load']:.1f} "
        "before. Random meshes (unions of perturbed balls, boxes, capsules and rings), each fitted by "
        f"`{' '.join(row['fit'])}`.",
        "",
        "## Nothing lost, nothing twice",
        "",
        f"{killed_['shapes']} shapes; deaths by SIGKILL: {deaths['worker']} of workers (one every {row['every']:g} s), "
        f"{deaths['client']} of the client, "
        f"{deaths['scheduler']} of the scheduler; the same command started again each time; {killed_['seconds']:.0f} s "
        "in all.",
        "",
        "| | |",
        "|---|---|",
        f"| bounders' files at the end, of as many shapes | {killed_['files']}, of {killed_['names']} |",
        f"| load, and are certified (proven) | {killed_['certified']} ({killed_['proven']}) |",
        f"| rows of the manifest | {killed_['rows']} |",
        f"| shapes that failed | {killed_['failed']} |",
        f"| done before a death, and lost or done again after it | {killed_['lost_or_twice']} |",
        f"| the command once more: baked, kept | {killed_['again']['baked']}, {killed_['again']['kept']} |",
        "",
        f"What the client said when its scheduler was killed: `{killed_['scheduler_gone']}`",
        "",
        "## What the engine costs",
        "",
        f"{calm['shapes']} shapes without deaths: tasks took {calm['task_seconds']:.1f} s, {calm['workers']} workers "
        f"were there for {calm['running_seconds']:.1f} s: "
        f"**{100 * calm['overhead']:.1f} % of the workers' time is not the tasks'** (handing out, and the last "
        "worker's wait for the other). Starting workers and listing what "
        f"there is took {calm['startup_seconds']:.1f} s besides, once a bake.",
        "",
        "## 100,000 shapes on 1,000 cores, by paper and by simulation",
        "",
        f"Measured here: {pace_['per_second']:,.0f} empty tasks a second ({pace_['tasks']:,} tasks, their client, "
        f"scheduler and {WORKERS} workers on the same {row['cores']} cores), {pace_['bytes_there']:,} bytes to a "
        f"worker and {pace_['bytes_back']:,} back for each task; shapes and bounders go over the shared folder, not "
        "over the scheduler. "
        f"100,000 tasks move {moved * CLUSTER_SHAPES / 1e6:,.0f} MB through it. The simulation hands out one task "
        "after another at that pace to whichever core is free, with the measured tasks' times drawn at random.",
        "",
        "| seconds a task | ideal | scheduler alone | simulated | overhead | cores at which the scheduler is the limit "
        "| shapes a task that would keep 1,000 cores busy |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for each in row["scaled"]:
        over = 100 * (each["simulated_seconds"] / each["ideal_seconds"] - 1)
        lines.append(
            f"| {each['task_seconds']:.1f} | {each['ideal_seconds']:,.0f} s | {each['scheduler_seconds']:,.0f} s | "
            f"{each['simulated_seconds']:,.0f} s | {over:.1f} % | {each['saturated_at_cores']:,.0f} | "
            f"{each['shapes_a_task']:,} |"
        )
    lines += [
        "",
        "A task is one shape, however short it is: where the scheduler is the limit, its own time (third column) is "
        "the whole bake's, and several shapes a task would be needed "
        "for less. The tasks' times are those of this run, scaled to the mean in the first column.",
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/bake"))
    parser.add_argument("--shapes", type=int, default=500)
    parser.add_argument("--calm", type=int, default=100, help="shapes of the bake without deaths")
    parser.add_argument("--every", type=float, default=60.0, help="seconds between two deaths of workers")
    parser.add_argument("--method", default="mlp")
    parser.add_argument("--hidden", default="8,8")
    parser.add_argument("--budget", type=float, default=2.0, help="seconds a shape")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    own = ["--hidden", options.hidden] if options.method == "mlp" else []
    fit = ["--method", options.method, "--budget", f"{options.budget:g}", *own]
    row = {
        "versions": versions(),
        "cores": os.cpu_count(),
        "machine": platform.machine(),
        "every": options.every,
        "fit": fit,
    }
    row["load"] = os.getloadavg()[0]
    row["command"] = " ".join(["python", "benchmarks/bake.py", *sys.argv[1:]])
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        write_shapes(work / "shapes", options.shapes, options.seed)
        write_shapes(work / "few", options.calm, options.seed + 1)
        row["calm"] = undisturbed(work / "few", work, fit)
        row["pace"] = pace(work, {"method": options.method, "budget": options.budget, "hidden": [8, 8]})
        row["scaled"] = scaled(row, options.seed)
        row["killed"] = killed(work / "shapes", work, fit, options.every, options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "bake.json").write_text(json.dumps(row, indent=1) + "\n")
    (options.out / "README.md").write_text(page(row))
    print(page(row))
    counts = {row["killed"][name] for name in ("shapes", "files", "names", "certified", "rows")}
    return 0 if len(counts) == 1 and not row["killed"]["lost_or_twice"] and not row["killed"]["again"]["baked"] else 1


if __name__ == "__main__":
    sys.exit(main())
