"""A crate moves in a cell: `python benchmarks/changing_cell.py --out results/changing-cell`.

The network of the cell stays as it is. For each place of the crate a small bounder of the crate alone is fitted, and
proven; both are asked. Beside it a network of the whole cell, fitted anew. False positives are per cent of random
configurations, the truth is that of the arm among everything. One row a place and way, written as it is known.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from robots import store, stored
from shared import nanoseconds

import warp_bounding as wb
from sims.arm.robots import CELLS
from sims.prefitted import FOLDER
from sims.versions import versions

CELL, PLACES, QUERIES = CELLS["planar-4"], 3, 400_000
WAYS = {
    "box": {"method": "aabb"},
    "tree of boxes": {"method": "bvh", "resolution": 24, "hidden": (16, 16)},
    "small network": {"hidden": (8, 16, 16), "budget": 10.0},
    "network of everything": {"hidden": (8, 40, 40), "budget": 100.0},
}
FIELDS = (
    "way", "place", "seconds", "bytes", "nanoseconds", "false_positives_percent", "ideal_percent", "certificate",
    "missed", "versions",
)  # fmt: skip


def crates() -> list[wb.arms.Body]:
    """A block at places in reach of the arm."""
    rng, found = np.random.default_rng(5), []
    for _ in range(PLACES):
        away, angle, turn = rng.uniform(0.45, 0.9), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        pose[:2, 3] = away * np.cos(angle), away * np.sin(angle)
        found.append(wb.arms.Body.box([-0.1, -0.07, -1], [0.1, 0.07, 1], pose=pose, name="crate"))
    return found


def measure(place: int, crate: wb.arms.Body, way: str, network: wb.Bounder, q: np.ndarray) -> dict:
    """A row."""
    alone, everything = (
        wb.arms.ArmConfigurations(CELL.arm, obstacles, self_collision=False, weights=CELL.arm.reaching, name="crate")
        for obstacles in ([crate], [*CELL.obstacles, crate])
    )
    anew = way == "network of everything"
    start = time.perf_counter()
    own = wb.fit(everything if anew else alone, device="cpu", progress=False, **WAYS[way])
    seconds, asked = time.perf_counter() - start, [own] if anew else [network, own]
    maybe = np.logical_or.reduce([each.query(q).numpy() for each in asked])
    held, known = everything.contains(q), network.query(q).numpy()
    ideal = known | alone.contains(q)  # the crate's own answer being perfect
    return {
        "way": way,
        "place": place,
        "seconds": seconds,
        "bytes": own.nbytes,
        "nanoseconds": sum(nanoseconds(each, q, 5) for each in asked),
        "false_positives_percent": 100 * (maybe & ~held).mean(),
        "ideal_percent": 100 * (ideal & ~held).mean(),
        "certificate": own.certificate.kind,
        "missed": int((held & ~maybe).sum()),
        "versions": versions(),
    }


def page(rows: list[dict], command: str) -> str:
    """The page, in Markdown: its conclusion first."""

    def mean(way: str, field: str) -> float:
        return float(np.mean([float(row[field]) for row in rows if row["way"] == way]))

    quick, whole = "tree of boxes", "network of everything"
    lines = [
        "# A crate that moves",
        "",
        f"**A proven bounder of the crate alone takes {mean(quick, 'seconds'):.1f} s, a network of everything "
        f"{mean(whole, 'seconds'):.0f} s. Beside the cell's network it has "
        f"{mean(quick, 'false_positives_percent'):.1f} % false positives, the new network "
        f"{mean(whole, 'false_positives_percent'):.1f} %.**",
        "",
        f"`{command}`",
        "",
        f"{rows[0]['versions']}. A planar arm of four joints, {PLACES} places; means. *ns*: of both bounders together, "
        "one core. A perfect answer about the crate would leave "
        f"{mean(quick, 'ideal_percent'):.1f} %: that is the cell's own network.",
        "",
        "| bounder of the crate | seconds to fit and prove | bytes | ns a query | false positives % | missed |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for way in WAYS:
        numbers = [mean(way, field) for field in ("seconds", "bytes", "nanoseconds", "false_positives_percent")]
        missed = sum(int(row["missed"]) for row in rows if row["way"] == way)
        lines.append("| {} | {:.1f} | {:,.0f} | {:.0f} | {:.1f} | {} |".format(way, *numbers, missed))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/changing-cell"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file, shape = options.out / "changing-cell.csv", CELL.shape(self_collision=False)
    network = wb.load(FOLDER / "arm-planar-4-mlp.safetensors", device="cpu")
    q = np.random.default_rng(9).uniform(shape.lower, shape.upper, (QUERIES, shape.ndim)).astype(np.float32)
    rows = stored(file)
    known = {(row["way"], int(row["place"])) for row in rows}
    for place, crate in enumerate(crates()):
        for way in WAYS:
            if (way, place) not in known:
                rows.append(measure(place, crate, way, network, q))
                store(file, FIELDS, rows)
    text = page(rows, "python benchmarks/changing_cell.py --out results/changing-cell")
    (options.out / "README.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
