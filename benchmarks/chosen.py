"""What `choose` takes for the demos, beside the best of their tables: `python benchmarks/chosen.py --out results/chosen`.

Two demos whose narrow phase is asked about points or rays: the rain on the moving bunny, by both of its narrow phases, and the shadows of a bunny and a chair. A run without a broad phase tells
what is asked, and what a call of the narrow phase takes. `wb.choose` is given just this, and the demo's own bounders beside its candidates. Then the demo runs with what it took, and with every
proven bounder of its table, in turns. Where no bounder pays, what it took is no broad phase.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import warp as wp
from shared.kept_rows import KeptRows

import warp_bounding as wb
from sims.particles.broad import OfMotion
from sims.particles.demo import NARROW, SCENE
from sims.particles.demo import SPECS as RAIN
from sims.particles.demo import simulate as rain
from sims.particles.example import Example as Rain
from sims.particles.scene import Scene as RainScene
from sims.prefitted import bounded, bounders_of
from sims.report import UNPROVEN
from sims.shadows.demo import SPECS as RAYS
from sims.shadows.demo import simulate as shadows
from sims.shadows.example import Example as Shadows
from sims.shadows.kernels import cast, face_sun
from sims.shadows.scene import LENGTH, LIFT, SCENES, margin_of
from sims.shadows.scene import Scene as StillLife

PARTICLES, STEPS, KEPT, RECORDED = 100_000, 60, 4000, 30
PICTURES = 8
SECTIONS = ("containment", "contact")
CHOSEN, NONE = "chosen", "none"


class Recorder:
    """No broad phase: all are candidates, and some of what would be asked is kept."""

    def __init__(self):
        self.kept, self._rng = [], np.random.default_rng(5)

    def candidates(self, time: float, points: wp.array, positions: wp.array) -> tuple[wp.array, wp.array]:
        """All of them."""
        count = len(positions)
        x = positions.numpy()[self._rng.choice(count, KEPT, replace=False)]
        self.kept.append(np.column_stack([np.full(KEPT, time), x]).astype(np.float32))
        return wp.array(np.arange(count), dtype=wp.int32, device="cpu"), wp.array([count], dtype=wp.int32, device="cpu")


def price(example) -> float:
    """Nanoseconds of a call of the narrow phase, in a run without a broad phase."""
    return 1e9 * sum(spent[1] for spent in example.seconds) / sum(example.calls)


def proven(bounders: dict[str, wb.Bounder]) -> dict[str, wb.Bounder]:
    """Those that can be chosen, and asked as they are."""
    return {n: b for n, b in bounders.items() if n not in UNPROVEN and not isinstance(b, wb.DistanceBounder)}


def told(choice, examples: dict, section: str) -> dict:
    """A row: what was taken, and what it costs beside the others."""
    cost = {name: sum(example.milliseconds()[:2]) for name, example in examples.items()}
    table = {name: value for name, value in cost.items() if name != CHOSEN}
    best = min(table, key=table.get)
    return {
        "section": section,
        "narrow_ns": choice[0].narrow_ns,
        "labels": [each.label for each in choice],
        "ms": cost[CHOSEN] if CHOSEN in cost else cost[NONE],
        "best": best,
        "best_ms": table[best],
        "none_ms": cost[NONE],
        "identical": all(example.identical(examples[NONE]) for example in examples.values()),
        "costs": cost,
        "rows": [each.to_dict() for each in choice],
    }


def of_rain(section: str, budget: float) -> dict:
    """The rain by one narrow phase."""
    scene, recorder, reach = RainScene.bunny("cpu"), Recorder(), NARROW[section]["reach"]
    shape = scene.shape
    stored = proven(bounders_of(SCENE, shape, RAIN, device="cpu"))
    run = Rain(scene, recorder, reach=reach, particles=PARTICLES, seed=1)
    for _ in range(RECORDED):
        run.step()
    choice = wb.choose(
        shape,
        queries=np.concatenate(recorder.kept),
        narrow_ns=price(run),
        bounders=stored,
        networks=(),
        budget=budget,
        device="cpu",
    )
    broad = {name: OfMotion(bounder, scene) for name, bounder in stored.items()}
    if choice.bounder is not None:
        broad[CHOSEN] = OfMotion(choice.bounder, scene)
    examples = rain(scene, broad, reach=reach, particles=PARTICLES, steps=STEPS)
    return told([choice], examples, f"particles, {section}")


def rays_of(scene: StillLife, suns: np.ndarray) -> np.ndarray:
    """``(N, 6)`` shadow rays, as the demo casts them."""
    seen, found = scene.seen, []
    for sun in suns:
        towards, facing = wp.vec3(*map(float, sun)), wp.empty(len(seen.pixels), dtype=wp.uint8, device="cpu")
        wb.launch_on_cores(face_sun, len(seen.pixels), [towards, seen.normals], [facing], "cpu")
        lit = np.flatnonzero(facing.numpy()).astype(np.int32)
        rays = wp.empty((len(lit), 6), dtype=float, device="cpu")
        lit = wp.array(lit, dtype=wp.int32, device="cpu")
        wb.launch_on_cores(cast, len(lit), [towards, LIFT, lit, seen.points, seen.normals], [rays], "cpu")
        found.append(rays.numpy())
    return np.concatenate(found)


def of_shadows(budget: float) -> dict:
    """The shadows; a choice for each object."""
    scene = StillLife.still_life(device="cpu")
    run = Shadows(scene, steps=PICTURES)
    for _ in range(PICTURES):
        run.step()
    rays, stored, choices = rays_of(scene, run.suns[::3]), {}, []
    for name, mesh in scene.shapes.items():
        shape = mesh.dilated(margin_of(mesh))
        stored[name] = proven(bounders_of(f"{SCENES}{name}", shape, RAYS, device="cpu"))
        choices.append(
            wb.choose(
                bounded(RAYS["mlp"], shape),
                "ray",
                queries=rays[np.random.default_rng(0).permutation(len(rays))[:200_000]],
                narrow_ns=price(run),
                bounders=stored[name],
                networks=(),
                length=LENGTH,
                budget=budget,
                device="cpu",
            )
        )
    methods = {m: {name: stored[name][m] for name in stored} for m in next(iter(stored.values()))}
    if all(choice.bounder is not None for choice in choices):
        methods[CHOSEN] = {name: choice.bounder for name, choice in zip(stored, choices, strict=True)}
    return told(choices, shadows(scene, methods, steps=PICTURES), "shadows")


def page(kept: KeptRows, command: str) -> str:
    """The page, in Markdown."""
    lines = ["# What `choose` takes for the demos", "", f"`{command}`", ""]
    lines += [
        f"{kept.about}. Milliseconds of broad and narrow phase together, medians of a step. *Best*: of the demo's own table, no broad phase among them. What is taken is found from some of a run's queries and",
        "the mean price of a call in it; candidates are the demo's own bounders and fresh closed forms. All runs end alike to the bit.",
        "",
        "| demo | price of a call, ns | taken | ms | best of the table | ms | taken / best | without, ms |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in kept.rows:
        lines.append(
            f"| {row['section']} | {row['narrow_ns']:.0f} | {', '.join(row['labels'])} | {row['ms']:.2f} | {row['best']} | {row['best_ms']:.2f} | {row['ms'] / row['best_ms']:.2f} | {row['none_ms']:.2f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/chosen"))
    parser.add_argument("--budget", type=float, default=30.0, help="seconds of a choice's own fits")
    options = parser.parse_args()
    kept = KeptRows(options.out, "chosen")
    jobs = {f"particles, {section}": lambda section=section: of_rain(section, options.budget) for section in SECTIONS}
    jobs["shadows"] = lambda: of_shadows(options.budget)
    for name, job in jobs.items():
        if not kept.have(section=name):
            kept.add(row := job())
            print({key: row[key] for key in ("section", "labels", "ms", "best", "best_ms")}, flush=True)
    kept.write(page(kept, "python benchmarks/chosen.py --out results/chosen"))
    return int(not all(row["identical"] for row in kept.rows))


if __name__ == "__main__":
    sys.exit(main())
