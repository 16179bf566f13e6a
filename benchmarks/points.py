"""Tightness of proven networks on the paper's shapes, points: `python benchmarks/points.py --data DIR --out results/points`.

Fits `mlp` at the supplement's sizes to every shape of the folder (2D images, 3D voxels, 4D arrays), proves it, certifies it from
the saved file, and counts false positives and negatives in 1,000,000 samples. One CSV row a shape, written as it is
known; run again after an interruption, it goes on where it stopped. A table of means ends the run.
"""

import argparse
import csv
import sys
import time
from itertools import islice
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from paper.columns import COLUMNS, PAPER, Column
from paper.run import versions
from paper.shapes import find_shapes
from warp_bounding.queries.point import POINT
from warp_bounding.runtime.launch import cpu_threads

SAMPLES = 1_000_000  # random points that are counted
SHOWN = 9  # columns of a row that is done


def measure(path: Path, dimension: int, budget: float, seed: int, folder: Path) -> dict:
    """One row: fit, save, load, certify, count."""
    shape = wb.load_indicator(path)
    start = time.perf_counter()
    fitted = wb.fit(shape, hidden=Column(dimension, "point").hidden, budget=budget, seed=seed, device="cpu")
    seconds = time.perf_counter() - start
    file = folder / "bounders" / f"{dimension}d-{path.stem}.safetensors"
    fitted.save(file)
    bounder = wb.load(file, device="cpu")
    proof = wb.certify(bounder, shape)
    x = POINT.sample(shape, SAMPLES, np.random.default_rng(1))
    truth, maybe, values = POINT.oracle(shape, "cpu")(x), bounder.query(x).numpy() == 1, bounder.values(x).numpy()
    training = fitted.info["training"]
    found = fitted.certificate.lower_bound + training["gap"]  # the least value that was seen, without any proof
    return {
        "dimension": dimension,
        "shape": path.stem,
        "fp_rate": round(100 * float((maybe & ~truth).mean()), 4),
        "fn": int((truth & ~maybe).sum()),
        "fp_cost_of_proof": round(100 * float((maybe & ~truth & (values < found)).mean()), 4),
        "certificate": proof.kind,
        "fit_seconds": round(seconds, 1),
        "proof_seconds": fitted.certificate.seconds,
        "proof_boxes": fitted.certificate.boxes,
        "certify_seconds": proof.seconds,
        "steps": training["steps"],
        "budget": budget,
        "seed": seed,
        "threads": cpu_threads(),
        "versions": versions(),
    }


def main() -> None:
    """Run what is not in the CSV yet, then print the means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with 2D/*.png, 3D/*.binvox, 4D/*.npy")
    parser.add_argument("--out", type=Path, default=Path("results/points"))
    parser.add_argument("--dimensions", default="2,3,4")
    parser.add_argument("--budgets", default="60,60,180", help="seconds a fit in 2D, 3D, 4D")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    wp.config.quiet = True
    budgets = dict(zip((2, 3, 4), map(float, arguments.budgets.split(",")), strict=True))
    table = arguments.out / "points.csv"
    table.parent.mkdir(parents=True, exist_ok=True)
    rows = list(csv.DictReader(table.open())) if table.exists() else []
    done = {(int(r["dimension"]), r["shape"], float(r["budget"]), int(r["seed"])) for r in rows}
    for dimension, name, path in find_shapes(arguments.data, map(int, arguments.dimensions.split(","))):
        if (dimension, name, budgets[dimension], arguments.seed) in done:
            continue
        row = measure(path, dimension, budgets[dimension], arguments.seed, arguments.out)
        new = not table.exists()
        with table.open("a", newline="") as file:
            writer = csv.DictWriter(file, row)
            if new:
                writer.writeheader()
            writer.writerow(row)
        print(dict(islice(row.items(), SHOWN)), flush=True)
    summarise(table, arguments.out / "README.md", " ".join(["python", "benchmarks/points.py", *sys.argv[1:]]))


def summarise(table: Path, page: Path, command: str) -> None:
    """A Markdown page of all rows and the means, the paper's beside them."""
    rows = sorted(csv.DictReader(table.open()), key=lambda r: (int(r["dimension"]), r["shape"]))
    lines = ["# Points: proven networks on the paper's shapes", "", f"`{command}`", "", rows[0]["versions"], ""]
    lines += [
        "| | shapes | FP %, mean | paper | FN | proven | FP cost of the proof, worst | proof s, worst | fit s, worst |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    for dimension in (2, 3, 4):
        part = [r for r in rows if int(r["dimension"]) == dimension]
        if part:
            mean = np.mean([float(r["fp_rate"]) for r in part])
            worst = {k: max(float(r[k]) for r in part) for k in ("fp_cost_of_proof", "proof_seconds", "fit_seconds")}
            proven = sum(r["certificate"] == "proven" for r in part)
            missed = sum(int(r["fn"]) for r in part)
            lines.append(
                f"| {dimension}D | {len(part)} | **{mean:.2f}** | {PAPER['mlp'][COLUMNS.index(Column(dimension, 'point'))]} | {missed} | {proven} of {len(part)} | "
                f"{worst['fp_cost_of_proof']:.3f} | {worst['proof_seconds']:.2f} | {worst['fit_seconds']:.0f} |"
            )
    lines += [
        "",
        "| dimension | shape | FP % | FN | certificate | steps | proof boxes | proof s | certify s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    names = ("dimension", "shape", "fp_rate", "fn", "certificate", "steps")
    names += ("proof_boxes", "proof_seconds", "certify_seconds")
    lines += ["| " + " | ".join(row[n] for n in names) + " |" for row in rows]
    page.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    try:
        main()
    except wb.IndicatorError as error:
        sys.exit(f"points.py: {error}")
