"""One network of an arm's self-collisions: `python benchmarks/self_collision.py --out results/self-collision`.

The planar arm of four joints, which may touch itself, plans roadmaps in two cells. A cell's network knows nothing of
the arm's own links, so by itself it clears nothing: every configuration would have to be checked against the arm. A
network of the arm alone is proven once, for all cells, and together they clear what both deny.
"""

import argparse
import json
import sys
from pathlib import Path

import warp_bounding as wb
from sims.arm.demo import Example, specs_of
from sims.arm.exact import Hulls
from sims.arm.robots import CELLS
from sims.arm.workplace import Workplace
from sims.planning.broad import Every, Segments
from sims.prefitted import FitSpec, bounder_from, fit, stored
from sims.versions import versions
from warp_bounding.runtime.launch import cpu_threads

NAMES = ("planar-4", "corridor-4")
ALONE = FitSpec("mlp", budget=180.0, options={"hidden": (8, 32, 32)})
STATES, PROBLEMS, REPEATS = 4000, 100, 3


def kept(file: Path, spec: FitSpec, shape: wb.arms.ArmConfigurations, effort: float) -> wb.Bounder:
    """The bounder in a file, or a new one that is put there."""
    if not file.exists():
        fit(spec, shape, budget=effort * spec.budget, device="cpu").save(file)
    return bounder_from(file, shape, spec, device="cpu")


def planned(name: str, alone: wb.Bounder, folder: Path, effort: float) -> list[dict]:
    """A row for each way to plan in a cell."""
    cell = CELLS[name]
    own = cell.shape(self_collision=False)
    spec = specs_of(own)["mlp"]
    file = stored(f"arm-{name}", "mlp")
    around = kept(file if file.exists() else folder / f"{name}.safetensors", spec, own, effort)
    place = Workplace(cell, itself=True)
    phases = {
        "none": None,
        "cell and arm": Every(Segments(around, halvings=0), Segments(alone, halvings=0)),
    }
    runs = {
        label: Example(place, Hulls(place), phase, states=STATES, problems=PROBLEMS) for label, phase in phases.items()
    }
    for _ in range(REPEATS):
        for run in runs.values():
            run.step()
    reference, rows = runs["none"], []
    for label, run in runs.items():
        run.test_final(reference)
        broad, narrow, whole = run.milliseconds()
        rows.append(
            {
                "cell": cell.title,
                "label": label,
                "checks": run.checks,
                "broad_ms": broad,
                "narrow_ms": narrow,
                "step_ms": whole,
                "solved": run.solved,
                "identical": run.identical(reference),
            }
        )
        if label != "none":
            rows[-1] |= {
                "bytes": [around.nbytes, alone.nbytes],
                "certificates": [around.certificate.kind, alone.certificate.kind],
            }
    return rows


CONCLUSION = (
    "One network of an arm's collisions with itself serves in every cell: with a second one of the cell, "
    "planning takes a third of the time or less, on the same paths."
)


def page(rows: list[dict], alone: dict, command: str) -> str:
    """The page, in Markdown."""
    lines = ["# One network of an arm with itself, in two cells", "", CONCLUSION, "", f"`{command}`", ""]
    lines += [
        f"{versions()}; {cpu_threads()} threads of a CPU. The planar arm of four joints touches itself in "
        f"{alone['positives']:.1f} % of its configurations. Its network: {alone['bytes']:,} bytes, "
        f"{alone['certificate']} in {alone['proof_seconds']:.0f} s, {alone['fp_rate']:.2f} % false positives."
    ]
    lines += [
        f"Roadmaps of {STATES:,} states, {PROBLEMS} problems; configurations are checked exactly against cell and arm. "
        f"Medians of {REPEATS} runs, in turns.",
        "",
        "| cell | broad phase | exact checks | broad ms | narrow ms | all ms | solved | same paths |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['cell']} | {row['label']} | {row['checks']:,} | {row['broad_ms']:.0f} | {row['narrow_ms']:.0f} | "
        f"{row['step_ms']:.0f} | {row['solved']} | {'yes' if row['identical'] else 'NO'} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Fit what is missing, plan, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/self-collision"))
    parser.add_argument("--files", type=Path, default=Path("out/self-collision"), help="where bounders are kept")
    parser.add_argument("--effort", type=float, default=1.0, help="multiplies the seconds of every fit")
    options = parser.parse_args()
    for folder in (options.out, options.files):
        folder.mkdir(parents=True, exist_ok=True)
    arm = CELLS[NAMES[0]].arm
    own = wb.arms.ArmConfigurations(arm, weights=arm.reaching, name="arm alone")
    network = kept(options.files / "alone.safetensors", ALONE, own, options.effort)
    rates = wb.evaluate(network, own, samples=400_000)
    alone = {
        "positives": rates.positives,
        "bytes": network.nbytes,
        "certificate": network.certificate.kind,
        "proof_seconds": network.certificate.seconds,
        "fp_rate": rates.fp_rate,
    }
    rows = [row for name in NAMES for row in planned(name, network, options.files, options.effort)]
    text = page(rows, alone, "python benchmarks/self_collision.py --out results/self-collision")
    (options.out / "README.md").write_text(text)
    found = {"versions": versions(), "alone": alone, "rows": rows}
    (options.out / "self-collision.json").write_text(json.dumps(found, indent=1) + "\n")
    print(text)
    return int(not all(row["identical"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
