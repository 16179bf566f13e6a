"""What bounds an arm's colliding configurations in how many bytes: `python benchmarks/arms.py --out results/arm`.

The cells of ``sims.arm.robots``. False positives are per cent of all random configurations within the limits, and of
those that a roadmap's edges in these cells ask for: points along edges from random states to their nearest ones. Rivals
without a class of their own are built here, as tight as they get at the network's memory, and not timed: a bit for each
box of a grid that is cut by the axes' lengths, and a tree of halved boxes of three bits a leaf.
One JSON row each, written as it is known; run again, it goes on where it stopped.
"""

import argparse
import itertools
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from shared import StoredRows, nanoseconds

import warp_bounding as wb
from sims.arm.demo import specs_of
from sims.arm.robots import CELLS
from sims.arm.workplace import Workplace
from sims.prefitted import bounder_from, fit, stored
from warp_bounding.proof import stress_test

SAMPLES, TIMED, ROUNDS = 400_000, 1_000_000, 7
STATES, NEIGHBOURS, ALONG = 4000, 12, 200_000  # the roadmap whose edges are queried, and at how many points
SHOWN = ("planar-3", "planar-4")  # cells that are measured
DASH = "–"


class Sampled(NamedTuple):
    """Configurations, and which of them collide."""

    x: np.ndarray
    held: np.ndarray

    def fp_rate(self, maybe: np.ndarray) -> float:
        """Per cent of all that are free and answered with maybe."""
        return float(100 * (maybe & ~self.held).mean())


# --- rivals that are no bounders of ours
# -------------------------------------------------------------------------------


def bitmap(shape: wb.arms.ArmConfigurations, nbytes: int) -> Callable[[np.ndarray], np.ndarray]:
    """A bit for each box of a grid, boxes as nearly cubes as whole numbers allow."""
    extent = shape.upper - shape.lower
    side = (extent.prod() / (8 * nbytes)) ** (1 / shape.ndim)
    counts = np.maximum(np.floor(extent / side).astype(int), 1)
    while (grown := counts + (np.arange(len(counts)) == np.argmax(extent / counts))).prod() <= 8 * nbytes:
        counts = grown
    cell = extent / counts
    lower = (
        shape.lower + np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, len(counts)) * cell
    )
    maybe = ~shape.empty(lower, lower + cell).reshape(counts)
    return lambda x: maybe[tuple(np.clip(((x - shape.lower) / cell).astype(int), 0, counts - 1).T)]


def tree_of_boxes(shape: wb.arms.ArmConfigurations, nbytes: int) -> Callable[[np.ndarray], np.ndarray]:
    """Boxes halved along their longest side as long as something is both free and not: a bit a node, and one a leaf."""
    lower, upper, split = [shape.lower], [shape.upper], {}
    state, waiting, leaves = {0: shape.empty(shape.lower[None], shape.upper[None])[0]}, [0], 1
    while waiting and 3 * leaves - 1 < 8 * nbytes:
        room = (8 * nbytes - 3 * leaves + 1) // 3
        now, waiting = waiting[:room], waiting[room:]
        if not now:
            break
        low, high = np.array([lower[i] for i in now]), np.array([upper[i] for i in now])
        axis = np.argmax(high - low, axis=1)
        middle = (low + high)[np.arange(len(now)), axis] / 2
        halves = [(low.copy(), high.copy()) for _ in range(2)]
        halves[0][1][np.arange(len(now)), axis] = middle
        halves[1][0][np.arange(len(now)), axis] = middle
        answers = [(shape.empty(*half), shape.inside(*half)) for half in halves]
        for row, parent in enumerate(now):
            if all(inside[row] for _, inside in answers):
                continue
            split[parent] = (axis[row], middle[row], len(lower))
            leaves += 1
            for (low, high), (empty, inside) in zip(halves, answers, strict=True):
                number = len(lower)
                lower.append(low[row])
                upper.append(high[row])
                state[number] = bool(empty[row])
                if not empty[row] and not inside[row]:
                    waiting.append(number)

    def maybe(x: np.ndarray) -> np.ndarray:
        found, going = np.zeros(len(x), dtype=bool), [(0, np.arange(len(x)))]
        while going:
            node, rows = going.pop()
            if not len(rows):
                continue
            if node not in split:
                found[rows] = not state[node]
                continue
            axis, middle, child = split[node]
            right = x[rows, axis] > middle
            going += [(child, rows[~right]), (child + 1, rows[right])]
        return found

    return maybe


BUILT = {"bitmap": bitmap, "tree of boxes": tree_of_boxes}
CLASSIC = ("aabb", "learned-kdop", "bvh")
FITTED = (*CLASSIC, "mlp")


# --- measuring
# ---------------------------------------------------------------------------------------------------------


def along_edges(place: Workplace) -> np.ndarray:
    """``(ALONG, n)`` float32, points of a roadmap's edges between free states."""
    rng = np.random.default_rng(7)
    states = place.draw(2 * STATES, rng)
    states = states[~place.shape.contains(states)][:STATES]
    near = cKDTree(states).query(states, NEIGHBOURS + 1)[1][:, 1:]
    first = rng.integers(len(states), size=ALONG)
    a, b = states[first], states[near[first, rng.integers(NEIGHBOURS, size=ALONG)]]
    return (a + rng.random((ALONG, 1)) * (b - a)).astype(np.float32)


def measure(place: Workplace, label: str, samples: tuple[Sampled, Sampled], effort: float, attacked: int) -> dict:
    """One row."""
    shape, name, started = place.shape, place.cell.name, time.perf_counter()
    specs = dict(specs_of(shape))
    row: dict = {"cell": name, "label": label}
    if label in BUILT:
        memory = nbytes_of(shape.ndim, specs["mlp"].options)
        ask = BUILT[label](shape, memory)
        row |= {
            "bytes": memory,
            "certificate": "by construction",
            "missed": None,
            "fit_seconds": time.perf_counter() - started,
        }
    else:
        spec = specs[label]
        if (file := stored(place.scene, label)).exists():
            fitted = bounder_from(file, shape, spec, device="cpu")
        else:
            fitted = fit(spec, shape, budget=effort * spec.budget, device="cpu")
        with tempfile.TemporaryDirectory() as folder:
            fitted.save(Path(folder) / "bounder.safetensors")
            bounder = wb.load(Path(folder) / "bounder.safetensors", device="cpu")
        attack = stress_test(bounder, shape, attacked, seed=1)
        row |= {
            "bytes": bounder.nbytes,
            "certificate": bounder.certificate.kind,
            "message": bounder.certificate.message,
            "attacked": attack.done,
            "missed": attack.missed,
            "fit_seconds": fitted.info["training"]["seconds"],
            "proof_seconds": bounder.certificate.seconds,
            "nanoseconds": nanoseconds(bounder, np.resize(samples[0].x, (TIMED, shape.ndim)), ROUNDS),
        }

        def ask(x: np.ndarray) -> np.ndarray:
            return bounder.query(x).numpy()

    answers = [ask(sampled.x) for sampled in samples]
    assert not any((sampled.held & ~maybe).any() for sampled, maybe in zip(samples, answers, strict=True)), label
    rates = [sampled.fp_rate(maybe) for sampled, maybe in zip(samples, answers, strict=True)]
    row |= {"fp_rate": rates[0], "fp_rate_along": rates[1], "positives": float(100 * samples[0].held.mean())}
    return row


def nbytes_of(joints: int, options: dict) -> int:
    """Bytes of a network's numbers."""
    widths = (joints, *options["hidden"], 1)
    return 4 * sum((k + 1) * h for k, h in itertools.pairwise(widths))


def conclusion(rows: list[dict]) -> str:
    """What a network leaves, per cent of what the tightest that is built in its memory leaves."""
    rate = {(row["cell"], row["label"]): row["fp_rate"] for row in rows}
    cells = [name for name in SHOWN if all((name, label) in rate for label in ("mlp", *BUILT))]
    shares = [100 * rate[name, "mlp"] / min(rate[name, label] for label in BUILT) for name in cells]
    told = ", ".join(f"{share:.0f} % ({CELLS[name].title})" for name, share in zip(cells, shares, strict=True))
    return (
        f"False positives of a proven network, as a share of those of the tightest grid or tree in its memory: {told}."
    )


def page(kept: StoredRows, command: str) -> str:
    """The page, in Markdown."""
    rows = kept.rows
    lines = [
        "# Arms: colliding configurations in a network's memory",
        "",
        f"These are measurements of {', '.join(sorted({row['versions'].split(' (')[0] for row in rows}))}.",
        "",
        conclusion(rows),
        "",
        f"`{command}`",
        "",
        f"{kept.about}. *FP %*: of {SAMPLES:,} random configurations within the limits, those that are",
        "free and get *maybe*; *along edges*: of points along the edges of a roadmap between free states, where a "
        "planner asks. *Bitmap* and *tree of boxes* have the",
        "network's memory, and are built by `benchmarks/arms.py` as tight as they get in it; all others are "
        "bounders, tested with as many hard configurations as a row says.",
    ]
    for name, cell in CELLS.items():
        own = [row for row in rows if row["cell"] == name]
        if not own:
            continue
        lines += ["", f"## {cell.title}", "", f"{own[0]['positives']:.1f} % of the configurations collide.", ""]
        lines += [
            "| | bytes | FP % | along edges | certificate | missed | ns | fit s | proof s |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for row in sorted(own, key=lambda row: [*FITTED, *BUILT].index(row["label"])):
            missed = (
                f"{0 if row['missed'] is None else 1} of {row['attacked'] / 1e6:.1f} million"
                if "attacked" in row
                else DASH
            )
            ns, proof = (f"{row[key]:.1f}" if key in row else DASH for key in ("nanoseconds", "proof_seconds"))
            lines.append(
                f"| {row['label']} | {row['bytes']:,} | {row['fp_rate']:.2f} | {row['fp_rate_along']:.2f} | "
                f"{row['certificate']} | {missed} | {ns} | {row['fit_seconds']:.0f} | "
                f"{proof} |"
            )
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/arm"))
    parser.add_argument("--cells", default=",".join(SHOWN), help="some of them, by name")
    parser.add_argument("--methods", default=",".join([*BUILT, *FITTED]), help="some of them, by label")
    parser.add_argument("--effort", type=float, default=1.0, help="multiplies the seconds of every fit")
    parser.add_argument(
        "--attacked", type=int, default=10_000_000, help="hard configurations that each bounder is asked"
    )
    parser.add_argument("--page", action="store_true", help="only make the page of the rows that are there")
    options = parser.parse_args()
    kept = StoredRows(options.out, "arm")
    for name in () if options.page else options.cells.split(","):
        place = Workplace(CELLS[name])
        shape = place.shape
        x = np.random.default_rng(11).uniform(shape.lower, shape.upper, (SAMPLES, shape.ndim)).astype(np.float32)
        samples = tuple(Sampled(y, shape.contains(y)) for y in (x, along_edges(place)))
        for label in options.methods.split(","):
            if kept.have(cell=name, label=label):
                continue
            row = measure(place, label, samples, options.effort, options.attacked)
            kept.add(row)
            print(
                {key: row[key] for key in ("cell", "label", "bytes", "fp_rate", "fp_rate_along", "certificate")},
                flush=True,
            )
    if len(kept):
        kept.write(page(kept, f"python benchmarks/arms.py --attacked {options.attacked}"))
    return int(any(row["missed"] is not None for row in kept.rows))


if __name__ == "__main__":
    sys.exit(main())
