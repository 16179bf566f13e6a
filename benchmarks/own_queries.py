"""A fit to a simulation's own queries, and the usual one: `python benchmarks/own_queries.py --out results/own-queries`.

The rain on the moving bunny is run once without a broad phase, and what it asks is kept: some particles at each step's
time. Networks of the same size are fitted in the same time, to random queries and to these, each seed of training on
its own. Then it rains anew, from another seed, and the calls of the narrow phase are counted: nothing of what is
counted was trained on.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from shared import StoredRows

import warp_bounding as wb
from sims.particles.broad import Everyone, OfMotion
from sims.particles.demo import SCENE, SPECS, shapes
from sims.particles.example import Example
from sims.particles.scene import Scene
from sims.prefitted import bounded, bounder_from, stored

PARTICLES, STEPS, KEPT = (
    (100_000, 10_000),
    150,
    2000,
)  # of the rain, full and quick; particles of each step that are kept
HIDDEN, SECONDS = (50, 50), 240.0
RAINS = (0, 1)  # seeds: of the rain that is fitted to, and of the one that is counted
FITS = {"usual": False, "to its own queries": True}


def rained(scene: Scene, broad, particles: int, seed: int) -> Example:
    """A rain, ended."""
    example = Example(scene, broad, particles=particles, seed=seed)
    for _ in range(STEPS):
        example.step()
    return example


def measured(scene: Scene, label: str, bounder: wb.Bounder, reference: Example, particles: int) -> dict:
    """A row: what a rain that nothing was fitted to costs with a bounder."""
    run = rained(scene, OfMotion(bounder, scene), particles, RAINS[1])
    run.test_final(reference)
    return {
        "label": label,
        "calls": float(np.mean(run.calls)),
        "touching": float(np.mean([np.unpackbits(bits).sum() for bits in reference.touched])),
        "fp_rate": wb.evaluate(bounder, scene.shape, samples=200_000).fp_rate,
        "bytes": bounder.nbytes,
        "certificate": bounder.certificate.kind,
        "seconds": bounder.info["training"]["seconds"],
    }


def _more(pairs: list[tuple[dict, dict]], key: str) -> str:
    """By how much the first of each pair has more of something, in words: the geometric mean."""
    share = 100 * np.expm1(np.mean([np.log(one[key] / other[key]) for one, other in pairs]))
    return f"{abs(share):.0f} % {'fewer' if share < 0 else 'more'}"


def page(kept: StoredRows, command: str) -> str:
    """The page, in Markdown."""
    rows = kept.rows
    seconds = dict.fromkeys(f"{row['budget']:g}" for row in rows if "budget" in row)
    usual = {row["seed"]: row for row in rows if row["label"] == "usual"}
    pairs = [(row, usual[row["seed"]]) for row in rows if row.get("seed") in usual and row["label"] != "usual"]
    lines = ["# A fit to a simulation's own queries", ""]
    if pairs:
        lines += [
            f"A network fitted to the queries of a simulation leaves {_more(pairs, 'calls')} exact checks than one "
            f"fitted to random queries, and {_more(pairs, 'fp_rate')} false positives among random ones "
            f"(geometric means of {len(pairs)} pairs).",
            "",
        ]
    lines += [f"`{command}`", ""]
    lines += [
        f"{kept.about}. Rain on the moving bunny, {rows[0]['particles']:,} particles, {STEPS} steps, seed {RAINS[1]}; "
        "*calls*: particles a step that the narrow phase is",
        f"asked about, of which {rows[0]['touching']:,.0f} touch. Networks {'-'.join(map(str, HIDDEN))}, "
        f"{', '.join(seconds)} seconds each, fitted to random queries, or to {STEPS * KEPT:,} that the rain of seed "
        f"{RAINS[0]} asks. No contact is missed; all runs end alike to the bit.",
        "",
        "| fit | training's seed | bytes | calls | fewer than usual | FP % of random queries | certificate |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        seed = row.get("seed")
        fewer = f"{usual[seed]['calls'] / row['calls']:.2f} times" if seed in usual and row["label"] != "usual" else "–"
        lines.append(
            f"| {row['label']} | {'–' if seed is None else seed} | {row['bytes']:,} | {row['calls']:,.0f} | {fewer} | "
            f"{row['fp_rate']:.2f} | {row['certificate']} |"
        )
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/own-queries"))
    parser.add_argument("--effort", type=float, default=1.0, help="multiplies the seconds of every fit")
    parser.add_argument("--seeds", default="0,1,2", help="of training, a pair of fits each")
    parser.add_argument("--quick", action="store_true", help="fewer particles")
    options = parser.parse_args()
    kept, particles = StoredRows(options.out, "own-queries"), PARTICLES[options.quick]
    scene, everyone = Scene.bunny("cpu"), Everyone(KEPT)
    shape = shapes()[SCENE]
    rained(scene, everyone, particles, RAINS[0])
    asked, reference = everyone.queries, rained(scene, None, particles, RAINS[1])

    def add(row: dict) -> None:
        kept.add(row | {"particles": particles})
        print({key: row[key] for key in ("label", "calls", "fp_rate", "certificate")}, flush=True)

    for label in ("mlp", "bvh"):
        if not kept.have(label=f"stored {label}"):
            bounder = bounder_from(stored(SCENE, label), shape, SPECS[label], device="cpu")
            add(measured(scene, f"stored {label}", bounder, reference, particles))
    for seed in map(int, options.seeds.split(",")):
        for label, own in FITS.items():
            if kept.have(label=label, seed=seed):
                continue
            given = {"hidden": HIDDEN, "budget": options.effort * SECONDS, "seed": seed}
            bounder = wb.fit(
                bounded(SPECS["mlp"], shape),
                margin=shape.margin,
                device="cpu",
                workload=asked if own else None,
                **given,
            )
            own_row = measured(scene, label, bounder, reference, particles)
            add(own_row | {"seed": seed, "budget": given["budget"]})
    kept.write(page(kept, "python benchmarks/own_queries.py --out results/own-queries"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
