"""What robots do to themselves: `python benchmarks/robots.py --out results/robots`.

The self-collisions of robots from the example-robot-data package, in the joints that matter, once and for all cells: a
network, proven, and boxes in the same memory. False positives are per cent of the robot's free configurations, all
joints random within their limits, by its own convex hulls; so they include what solids of revolution in place of a base
or a flange cost. A network lies in ``sims/bounders/robots``, or is fitted anew. One row of a CSV file each, written as
it is known; run again, it goes on where it stopped.
"""

import argparse
import csv
import math
import sys
import time
from pathlib import Path

import numpy as np
from arms import tree_of_boxes
from shared import clock

import warp_bounding as wb
from sims.arm.robots import KEPT, ROBOTS, Own
from sims.versions import versions
from warp_bounding.proof import stress_test
from warp_bounding.runtime.launch import cpu_threads

SAMPLES, TIMED, ROUNDS, TIMES, ATTACKED = 100_000, 400_000, 5, 50, 200_000
FIELDS = (
    "robot", "bounds", "joints", "coordinates", "pairs", "colliding_percent", "checks_per_second", "bytes",
    "nanoseconds", "false_positives_percent", "certificate", "missed", "cpu_seconds", "wall_seconds",
    "proof_seconds", "versions",
)  # fmt: skip


def stored(file: Path) -> list[dict]:
    """The rows of a CSV file; none if it is not there."""
    return list(csv.DictReader(file.open())) if file.exists() else []


def store(file: Path, fields: tuple[str, ...], rows: list[dict]) -> None:
    """Write rows to a CSV file."""
    with file.open("w", newline="") as out:
        writer = csv.DictWriter(out, fields)
        writer.writeheader()
        writer.writerows(rows)


def busy(function) -> float:
    """Seconds of one core, the least of several calls."""
    function()
    return min(clock(function)[1] for _ in range(ROUNDS))


def waited(functions) -> float:
    """Seconds on the clock that calls one after another take on all cores: the least of several times."""
    spent = []
    for _ in range(TIMES):
        started = time.perf_counter()
        for function in functions:
            function()
        spent.append(time.perf_counter() - started)
    return min(spent)


def network(name: str, own: Own, shape: wb.arms.ArmConfigurations, effort: float) -> wb.Bounder:
    """A bounder of a robot, kept or fitted; how long its fit took is with its training."""
    file = KEPT / f"{name}.safetensors"
    if not file.exists():
        file.parent.mkdir(exist_ok=True)
        cpu, started, seconds = time.process_time(), time.perf_counter(), own.share * effort
        loose = wb.fit(shape, budget=seconds / 3, statistical=True, device="cpu", **own.options)
        fitted = wb.proof.make_proven(loose, shape, budget=seconds - (time.perf_counter() - started))
        took = {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - started}
        fitted.info["training"] |= took
        fitted.save(file)
    bounder = wb.load(file, device="cpu")
    if bounder.certificate is None or bounder.certificate.indicator != shape.digest:
        raise SystemExit(f"{name}: the bounder in {KEPT} is one of another shape")
    return bounder


def measure(name: str, effort: float) -> list[dict]:
    """The rows of a robot: its networks together, and boxes in the same memory."""
    import warp as wp

    robot = ROBOTS[name]
    arm, shapes = robot.arm(), robot.shapes()
    whole = arm.self_collision()
    q = np.random.default_rng(11).uniform(arm.lower, arm.upper, (SAMPLES, len(arm.free))).astype(np.float32)
    held = whole.contains(q[:, whole.columns])
    about = {
        "robot": robot.title,
        "joints": len(arm.free),
        "coordinates": " + ".join(str(shape.ndim) for shape in shapes.values()),
        "pairs": " + ".join(str(len(shape.pairs)) for shape in shapes.values()),
        "colliding_percent": 100 * held.mean(),
        "checks_per_second": len(q) / busy(lambda: whole.contains(q[:, whole.columns])),
        "versions": versions(),
    }
    bounders, launches = [], []
    maybe, boxes, cpu = np.zeros(SAMPLES, dtype=bool), np.zeros(SAMPLES, dtype=bool), 0.0
    for file, shape in shapes.items():
        bounder = network(file, robot.networks[file], shape, effort)
        x = np.ascontiguousarray(q[:, shape.columns])
        queries = wp.array(np.resize(x, (TIMED, shape.ndim)), dtype=float, device="cpu")
        launches.append(bounder.prepare(queries, out=wp.empty(TIMED, dtype=wp.bool, device="cpu")).launch)
        bounders.append(bounder)
        maybe |= bounder.query(x).numpy()
        started = time.process_time()
        ask = tree_of_boxes(shape, bounder.nbytes)
        cpu += time.process_time() - started
        boxes |= ask(shape.joints.turned_back(x.astype(np.float64)))
    trained = [bounder.info["training"] for bounder in bounders]
    missed = [
        stress_test(bounder, shape, ATTACKED, seed=1).missed is not None
        for bounder, shape in zip(bounders, shapes.values(), strict=True)
    ]
    about["bytes"] = sum(bounder.nbytes for bounder in bounders)
    rows = [
        about
        | {
            "bounds": "network",
            "nanoseconds": 1e9 * waited(launches) / TIMED,
            "certificate": ", ".join(sorted({bounder.certificate.kind for bounder in bounders})),
            "missed": sum(missed),
            "cpu_seconds": sum(each.get("cpu_seconds", math.nan) for each in trained),
            "wall_seconds": sum(each.get("wall_seconds", math.nan) for each in trained),
            "proof_seconds": sum(bounder.certificate.seconds for bounder in bounders),
            "maybe": maybe,
        },
        about
        | {
            "bounds": "tree of boxes",
            "certificate": "by construction",
            "missed": 0,
            "cpu_seconds": cpu,
            "maybe": boxes,
        },
    ]
    for row in rows:
        maybe = row.pop("maybe")
        assert not (held & ~maybe).any(), f"{name}: {row['bounds']} misses a collision"
        row["false_positives_percent"] = 100 * (maybe & ~held).sum() / (~held).sum()
    return rows


def page(rows: list[dict], command: str) -> str:
    """The page, in Markdown: its conclusion first."""
    own = [row for row in rows if row["bounds"] == "network"]
    proven = [row for row in own if row["certificate"] == "proven"]
    worst, rivals = (
        max(float(row["false_positives_percent"]) for row in part)
        for part in (own, [row for row in rows if row["bounds"] != "network"])
    )
    lines = [
        "# What robots do to themselves",
        "",
        f"**{len(proven)} of {len(own)} networks are proven. They leave at most {worst:.1f} % of free configurations "
        f"undecided; boxes in the same memory leave up to {rivals:.0f} %.**",
        "",
        f"`{command}`",
        "",
        f"{rows[0]['versions']}. Exact checks: of one core. *ns*: on the clock, all of {cpu_threads()} cores busy with "
        f"{TIMED:,} configurations. *False positives*: per cent of the free configurations among {SAMPLES:,} random "
        "ones of all joints. *CPU seconds*: of all cores, the proof included; *seconds*: on the clock. *Missed*: hard "
        f"configurations of {ATTACKED:,}.",
        "",
        "A network is fitted in a third of its time, with a threshold that samples attest; in the rest "
        "`make_proven` proves the first lower threshold whose proof is expected to end. False positives include those "
        "of the solids of revolution that spare joints. Where coordinates are a sum, some pairs of parts have a "
        "network of their own, in other joints; size and time are those of both networks.",
        "",
        "| robot | bounds | joints | coordinates | pairs | colliding % | exact checks/s | bytes | ns "
        "| false positives % | certificate | missed | CPU seconds | seconds |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    forms = (
        "{}", "{}", "{}", "{}", "{}", "{:.1f}", "{:,.0f}", "{:,}", "{:.1f}", "{:.1f}", "{}", "{}", "{:.0f}", "{:.0f}"
    )  # fmt: skip
    for row in rows:
        shown = []
        for field, form in zip(FIELDS, forms, strict=False):
            value = row.get(field)
            if value in (None, "") or value != value or value == "nan":
                shown.append("–")
            else:
                kind = {"{}": str, "{:,}": int}.get(form, float)
                shown.append(form.format(kind(value)))
        lines.append("| " + " | ".join(shown) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/robots"))
    parser.add_argument("--robots", default=",".join(ROBOTS), help="some of them, by name")
    parser.add_argument("--effort", type=float, default=800.0, help="seconds of each fit, its proof included")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "self-collision.csv"
    rows = stored(file)
    for name in options.robots.split(","):
        if any(row["robot"] == ROBOTS[name].title for row in rows):
            continue
        rows += measure(name, options.effort)
        store(file, FIELDS, rows)
    titles = [robot.title for robot in ROBOTS.values()]
    text = page(
        sorted(rows, key=lambda row: titles.index(row["robot"])),
        f"python benchmarks/robots.py --out results/robots --robots {options.robots}",
    )
    (options.out / "README.md").write_text(text)
    print(text)
    return int(any(int(row["missed"]) for row in rows))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except wb.BoundingError as error:
        sys.exit(f"robots: {error}")
