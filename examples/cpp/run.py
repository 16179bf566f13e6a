"""Make the knot and its headers, build the planners, run them with and without the header, and compare.

python examples/cpp/run.py BUILD [--out results/export]

BUILD is a folder for everything that is made. The exit status is 1 where a path or a roadmap differs.
"""

import argparse
import csv
import io
import platform
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
import warp as wp

import warp_bounding as wb

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from sims.versions import versions  # noqa: E402

TUBE, AROUND, ALONG = 0.28, 24, 400  # radius; vertices of a ring, and rings


def knot() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a tube along a trefoil knot, closed."""
    t = np.arange(ALONG) * 2 * np.pi / ALONG
    center = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1) / 2
    along = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    side = np.cross(along, [0.1, 0.2, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    angle = np.arange(AROUND)[:, None] * 2 * np.pi / AROUND
    rings = center[:, None] + TUBE * (np.cos(angle) * side[:, None] + np.sin(angle) * other[:, None])
    i, k = np.indices((ALONG, AROUND)).reshape(2, -1)
    ahead, next_ = (i + 1) % ALONG, (k + 1) % AROUND
    a, b, c, d = i * AROUND + k, ahead * AROUND + k, ahead * AROUND + next_, i * AROUND + next_
    return rings.reshape(-1, 3), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def make(build: Path) -> dict[str, wb.DistanceBounder]:
    """Write the mesh and both headers, where they are not there yet."""
    build.mkdir(parents=True, exist_ok=True)
    vertices, faces = knot()
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (build / "knot.obj").write_text("\n".join([*lines, ""]))
    methods = {"knot": {"method": "distance-grid", "nodes": 48}}
    methods["knot_network"] = {"method": "mlp", "hidden": (24, 24), "budget": 60.0}
    found = {}
    for name, options in methods.items():
        path = build / f"{name}.safetensors"
        if not path.is_file():
            wb.fit(str(build / "knot.obj"), "distance", device="cpu", **options).save(path)
        found[name] = wb.load(path, device="cpu")
        found[name].export(build / f"{name}.h")
    return found


def in_a_kernel(bounder: wb.DistanceBounder) -> float:
    """Nanoseconds of the function in a kernel of Warp, on one thread of a CPU."""

    @wp.kernel
    def ask(data: wb.Data, x: wp.array(dtype=wp.vec3), d: wp.array(dtype=float)):
        i = wp.tid()
        d[i] = wp.static(bounder.distance_func)(data, x[i])

    points = np.random.default_rng(3).uniform(-1.9, 1.9, (200_000, 3)).astype(np.float32)
    x, d, best = wp.array(points, dtype=wp.vec3, device="cpu"), wp.zeros(len(points), dtype=float, device="cpu"), np.inf
    for _ in range(5):
        start = time.perf_counter()
        wp.launch(ask, len(points), [bounder.data, x, d], device="cpu")
        best = min(best, time.perf_counter() - start)
    return best * 1e9 / len(points)


def rows(build: Path, mode: str) -> list[dict[str, str]]:
    """What the program prints in a mode."""
    line = [build / "plan", mode, build / "knot.obj"]
    text = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    return list(csv.DictReader(io.StringIO(text)))


def table(found: dict[str, list[dict[str, str]]]) -> list[str]:
    """A row for each planner, without and with the header."""
    lines = ["| planner | check | results | ms, median | states | edges | cleared by the header | asked of FCL |"]
    lines.append("|---|---|--:|--:|--:|--:|--:|--:|")
    for planner in ("RRT-Connect", "PRM"):
        for mode, each in found.items():
            own = [row for row in each if row["planner"] == planner]
            total = {name: sum(int(row[name]) for row in own) for name in ("states", "edges", "cleared", "exact")}
            counts = " | ".join(f"{value:,}" for value in total.values())
            solved = f"{sum(int(row['solved']) for row in own):,}"
            result = f"{solved} of {len(own)} solved" if len(own) > 1 else f"{solved} nodes, {own[0]['result']} edges"
            states, *others = counts.split(" | ")
            ms = median(float(row["seconds"]) for row in own) * 1e3
            check = "FCL" if mode == "exact" else "header, then FCL"
            lines.append(f"| {planner} | {check} | {result} | {ms:.1f} | {states} | {' | '.join(others)} |")
    return lines


def main() -> int:
    """Everything; see above."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    bounders = make(given.build)
    for line in (["cmake", "-S", HERE, "-B", given.build], ["cmake", "--build", given.build]):
        subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
    found = {mode: rows(given.build, mode) for mode in ("exact", "header")}
    same = all(
        (a["solved"], a["result"]) == (b["solved"], b["result"])
        for a, b in zip(found["exact"], found["header"], strict=True)
    )
    calls = rows(given.build, "calls")
    for name, label in (("knot", "distance-grid"), ("knot_network", "mlp 24-24")):
        calls.append({"call": f"Warp kernel: {label} `distance_func`", "ns": f"{in_a_kernel(bounders[name]):.1f}"})
    text = [*table(found), "", "Paths and roadmaps are the same." if same else "PATHS OR ROADMAPS DIFFER.", ""]
    text += ["| single call | ns |", "|---|--:|", *(f"| {row['call']} | {row['ns']} |" for row in calls), ""]
    print("\n".join(text))
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        with (given.out / "plans.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, ["check", *found["exact"][0], "versions"])
            writer.writeheader()
            known = {mode: {"check": mode, "versions": versions()} for mode in found}
            writer.writerows(known[mode] | row for mode, each in found.items() for row in each)
        mesh = f"A ball in a trefoil knot of {2 * AROUND * ALONG:,} triangles; {platform.machine()}, one thread."
        about = ["# A bounder as a header, in C++", "", "`python examples/cpp/run.py BUILD --out results/export`", ""]
        others = "OMPL and FCL as Debian has them."
        (given.out / "README.md").write_text("\n".join([*about, f"{mesh} {versions()}; {others}", "", *text]))
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
