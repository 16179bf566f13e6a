"""A bake whose workers, client and scheduler are killed, and what the engine costs: `python benchmarks/bake --out results/bake`.

Random meshes are baked on two workers, one of which is killed (SIGKILL) every minute. After a third of the shapes the client is killed, after two
thirds the scheduler; each time the same command is started again. Then every file is loaded, and it is counted what was lost and what was done twice.
A second bake without deaths measures the engine's overhead, empty tasks the scheduler's pace; from these follows what 10^5 shapes on 1,000 cores would take.
"""

import argparse
import json
import os
import platform
import sys
import tempfile
from pathlib import Path

from deaths import WORKERS, killed
from random_meshes import write_shapes
from scaling import CLUSTER_SHAPES, pace, scaled, undisturbed

from paper.run import versions


def page(row: dict) -> str:
    """The page, in Markdown."""
    calm, killed_, pace_, deaths = row["calm"], row["killed"], row["pace"], row["killed"]["deaths"]
    moved = pace_["bytes_there"] + pace_["bytes_back"]
    lines = [
        "# A bake that is killed again and again, and what the engine costs",
        "",
        f"`{row['command']}`",
        "",
        f"{row['versions']}; {row['cores']} cores, {WORKERS} workers, load average {row['load']:.1f} (other work on the same cores, too). Random meshes (unions of perturbed balls, boxes, capsules and rings), each fitted by `{' '.join(row['fit'])}`.",
        "",
        "## Nothing lost, nothing twice",
        "",
        f"{killed_['shapes']} shapes; deaths by SIGKILL: {deaths['worker']} of workers (one every {row['every']:g} s), {deaths['client']} of the client, "
        f"{deaths['scheduler']} of the scheduler; the same command started again each time; {killed_['seconds']:.0f} s in all.",
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
        f"{calm['shapes']} shapes without deaths: tasks took {calm['task_seconds']:.1f} s, {calm['workers']} workers were there for {calm['running_seconds']:.1f} s: "
        f"**{100 * calm['overhead']:.1f} % of the workers' time is not the tasks'** (handing out, and the last worker's wait for the other). Starting workers and listing what "
        f"there is took {calm['startup_seconds']:.1f} s besides, once a bake.",
        "",
        "## 100,000 shapes on 1,000 cores, by paper and by simulation",
        "",
        f"Measured here: {pace_['per_second']:,.0f} empty tasks a second ({pace_['tasks']:,} tasks, their client, scheduler and {WORKERS} workers on the same {row['cores']} cores), {pace_['bytes_there']:,} bytes to a "
        f"worker and {pace_['bytes_back']:,} back for each task; shapes and bounders go over the shared folder, not over the scheduler. "
        f"100,000 tasks move {moved * CLUSTER_SHAPES / 1e6:,.0f} MB through it. The simulation hands out one task after another at that pace to whichever core is free, with the measured tasks' times drawn at random.",
        "",
        "| seconds a task | ideal | scheduler alone | simulated | overhead | cores at which the scheduler is the limit | shapes a task that would keep 1,000 cores busy |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for each in row["scaled"]:
        over = 100 * (each["simulated_seconds"] / each["ideal_seconds"] - 1)
        lines.append(
            f"| {each['task_seconds']:.1f} | {each['ideal_seconds']:,.0f} s | {each['scheduler_seconds']:,.0f} s | {each['simulated_seconds']:,.0f} s | {over:.1f} % | {each['saturated_at_cores']:,.0f} | {each['shapes_a_task']:,} |"
        )
    lines += [
        "",
        "A task is one shape, however short it is: where the scheduler is the limit, its own time (third column) is the whole bake's, and several shapes a task would be needed "
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
    row["command"] = " ".join(["python", "benchmarks/bake", *sys.argv[1:]])
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
