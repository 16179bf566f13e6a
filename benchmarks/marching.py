"""Edges of an arm's roadmap, cleared by a distance: `python benchmarks/marching.py --out results/marching`.

A distance of the colliding configurations is a clearance, the least that any joint must move before something can
touch, weighted. A march along an edge asks for it, goes on by as much, and asks again, until the edge's end is reached
or nothing is gained. Counted are the evaluations of an edge, and which of the edges that are free are cleared.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from shared import StoredRows, evaluations

import warp_bounding as wb
from sims.arm.exact import Hulls
from sims.arm.robots import CELLS
from sims.arm.workplace import Workplace
from warp_bounding.proof import stress_test

STATES, NEIGHBOURS, EDGES, STEPS = 4000, 12, 20_000, 64
SECONDS, ATTACKED = 300.0, 10_000_000
CELL = "planar-3"
FITS = {"mlp": {"hidden": (50, 50)}, "learned-kdop": {}}


def edges_of(place: Workplace) -> tuple[np.ndarray, np.ndarray]:
    """``(EDGES, n)`` float32 twice, ends of random edges between near free states."""
    rng = np.random.default_rng(7)
    states = place.draw(3 * STATES, rng)
    states = states[~place.shape.contains(states)][:STATES]
    near = cKDTree(states).query(states, NEIGHBOURS + 1)[1][:, 1:]
    first = rng.integers(len(states), size=EDGES)
    return states[first], states[near[first, rng.integers(NEIGHBOURS, size=EDGES)]]


CONCLUSION = (
    "Marching along a network of the distance clears most of the free edges whole, in few evaluations each; "
    "half-spaces clear fewer. No edge that collides is cleared."
)


def main() -> int:
    """Fit, march, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/marching"))
    parser.add_argument("--effort", type=float, default=1.0, help="multiplies the seconds of every fit")
    parser.add_argument("--attacked", type=int, default=ATTACKED, help="hard queries that each distance is asked")
    options = parser.parse_args()
    kept = StoredRows(options.out, "marching")
    place = Workplace(CELLS[CELL])
    a, b = edges_of(place)
    hits = Hulls(place).segments(a, b)
    for label, own in FITS.items():
        if kept.have(label=label):
            continue
        bounder = wb.fit(
            place.shape,
            "distance",
            label.split()[0],
            budget=options.effort * SECONDS,
            device="cpu",
            progress=False,
            **own,
        )
        attack = stress_test(bounder, place.shape, options.attacked, seed=1)
        count, cleared = evaluations(bounder, a, b, STEPS), bounder.segments(a, b, steps=STEPS)[0].numpy() == 0
        assert not (cleared & hits).any()
        row = {
            "label": label,
            "bytes": bounder.nbytes,
            "certificate": bounder.certificate.kind,
            "slack": bounder.slack,
            "evaluations": float(count.mean()),
            "evaluations_cleared": float(count[cleared].mean()) if cleared.any() else None,
            "cleared": float(100 * cleared[~hits].mean()),
            "attacked": attack.done,
            "missed": attack.missed is not None,
            "proof_seconds": bounder.certificate.seconds,
            "free": float(100 * (~hits).mean()),
            "length": float(np.linalg.norm(b.astype(np.float64) - a, axis=1).mean()),
        }
        kept.add(row)
        print(row, flush=True)
    rows = kept.rows
    lines = [
        "# Marching along edges in an arm's configurations",
        "",
        CONCLUSION,
        "",
        "`python benchmarks/marching.py --out results/marching`",
        "",
    ]
    lines += [
        f"{kept.about}. {CELLS[CELL].title}; {EDGES:,} edges of a roadmap between free states, {rows[0]['length']:.2f} "
        f"long on average, {rows[0]['free']:.0f} % of them free (checked at configurations 2 cm apart). *Evaluations*: "
        "of",
        f"the distance, an edge, {STEPS} at most: until it is cleared or a step gains nothing. *Cleared*: of the free "
        "edges. No edge that collides is cleared.",
        "",
        "| distance | bytes | slack | certificate | proof s | asked, missed | evaluations | of those that it clears | "
        "cleared % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['label']} | {row['bytes']:,} | {row['slack']:.3f} | {row['certificate']} | {row['proof_seconds']:.0f} "
        f"| {row['attacked'] / 1e6:.1f} million, {int(row['missed'])} | {row['evaluations']:.1f} | "
        f"{'–' if row['evaluations_cleared'] is None else format(row['evaluations_cleared'], '.1f')} | "
        f"{row['cleared']:.1f} |"
        for row in rows
    ]
    kept.write("\n".join(lines) + "\n")
    return int(any(row["missed"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
