"""``results/demos``: what the demos measured, as JSON and as a page.

python -m sims NAME --out out/demo --json > results/demos/NAME.json     # for each of the demos
python -m sims.page results/demos                                           # writes README.md there
"""

import json
import sys
from itertools import groupby
from pathlib import Path

import warp_bounding as wb
from sims import DEMOS
from sims.report import CHOSEN, UNPROVEN

__all__ = ["page"]

CALLS = {
    "particles": "narrow calls",
    "cloth": "pairs",
    "path": "exact checks",
    "shadows": "mesh rays",
    "digits": "pixels run",
    "arm": "configurations checked",
}
STEP = {"particles": "step", "cloth": "step", "path": "world", "shadows": "picture", "digits": "batch", "arm": "cell"}
ABOUT = {
    "particles": "100,000 particles rain on the moving bunny; `moving aabb` is fitted anew in every step, the others "
    "never. *Porous*: drops seep through it, and "
    "the narrow phase says which ones are in it; `+inside`: with a second network, from the inside, which decides "
    "some without it.",
    "cloth": "A cloth falls on the bunny and a star, on one thread (Newton); ms_broad is the cull. `distance`: a "
    "network of the distance, one fit for every contact gap.",
    "path": "Rooms and a maze: states and whole edges of a roadmap, cleared by a bounder or checked exactly; "
    "`+inside`: or known to collide, by a second "
    "network, from the inside. `distance` and `distance-grid`, a network and a grid of distances, march along edges; "
    "the other networks bound pieces of them.",
    "shadows": "The bunny and a chair in the sun: shadow rays of all pixels against both meshes. `distance` marches "
    "along rays, and is proven for the mesh "
    "itself; the others are bounders of rays, proven for its cells.",
    "digits": "Random digits of a generative model, an implicit decoder: it is run for the pixels that a bounder "
    "leaves. *FP %*: of the box of latent numbers and pixels.",
    "arm": "Roadmaps of planar arms with three and four joints: configurations and whole edges, cleared by a bounder "
    "or checked one configuration after another, at "
    "most 2 cm apart. *Meshes*: the same bounders, and triangle meshes as the narrow phase (Coal, Pinocchio, one "
    "core).",
}


def page(folder: Path) -> str:
    """The page about the JSON files in a folder.

    Raises:
        BoundingError: If there are none, or one is not what a demo printed.
    """
    found = [name for name in DEMOS if (folder / f"{name}.json").is_file()]
    if not found:
        raise wb.BoundingError(f"{folder}: expected files such as {DEMOS[0]}.json, found none")
    answers = [_read(folder / f"{name}.json") for name in found]
    machines = "; ".join(sorted({answer["machine"] for answer in answers}))
    parts = ["# What the demos measured", ""]
    parts += [
        "`python -m sims NAME --json > results/demos/NAME.json`, then `python -m sims.page results/demos`. "
        f"{machines}.",
        "Milliseconds are medians, on a machine that had other work too: only compare them within a table.",
        "*Missed*: contacts, shadow pixels, colliding",
        "states and edges that the run without a broad phase has and this one lacks. *FP %*: false positives among "
        "random",
        "queries, against the shape itself, dilated by what the narrow phase needs: the mesh, the moving mesh, or the "
        "world's",
        "grid. *Of cells*: the same against the cells of a mesh, for bounders that bound these. A `statistical` "
        "certificate is",
        "no proof. `chosen`: what `wb.choose` takes of the table's proven bounders, given the queries of a run "
        "without a broad phase",
        "and what a call of the narrow phase takes in it (the planner's by `wb.choose_among`).",
    ]
    for answer in answers:
        parts += ["", *_demo(answer)]
    return "\n".join(parts) + "\n"


def _read(path: Path) -> dict:
    try:
        answer = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise wb.BoundingError(f"{path}: expected what a demo prints with --json, got something else") from error
    if not isinstance(answer, dict) or not {"demo", "machine", "runs", "steps"} <= answer.keys():
        raise wb.BoundingError(f"{path}: expected what a demo prints with --json, got something else")
    return answer


def _demo(answer: dict) -> list[str]:
    name = answer["demo"]
    lines = [f"## {name}", "", ABOUT[name], ""]
    for section, runs in groupby(answer["runs"], key=lambda run: run["section"]):
        runs = list(runs)
        extra = [key for key in ("deepest", "collisions", "asked", "faster") if key in runs[0]]
        cells = any(run["fp_rate_cells"] is not None for run in runs)
        heads = [f"{CALLS[name]} a {STEP[name]}", "broad ms", "narrow ms", f"{STEP[name]} ms", *extra]
        heads += ["missed", "FP %", *(["of cells"] if cells else [])]
        lines += [f"*{section}*", ""] if section else []
        lines += ["| broad phase | " + " | ".join(heads) + " | certificate | result |", "|---" * (len(heads) + 3) + "|"]
        lines += [_row(run, answer["steps"], extra, cells, run is runs[0]) for run in runs]
        lines += ["", _choice(answer["chosen"][section], runs)] if section in answer.get("chosen", {}) else []
        lines.append("")
    if "field" in answer:
        lines += _field(answer["field"])
    return lines[:-1] if not lines[-1] else lines


def _row(run: dict, steps: int, extra: list[str], cells_too: bool, first: bool) -> str:
    cells = [f"`{run['bounder']}`" if not first else run["bounder"], f"{run['narrow_calls'] / steps:,.0f}"]
    cells += [f"{run[key]:.2f}" for key in ("ms_broad", "ms_narrow", "ms_step")]
    cells += [f"{run[key]:.3f}" if isinstance(run[key], float) else f"{run[key]}" for key in extra]
    if first:
        return "| " + " | ".join([*cells, *[""] * (4 + cells_too)]) + " |"
    missed = f"{run['missed']:,}"
    rates = [run["fp_rate"], run["fp_rate_cells"]][: 1 + cells_too]
    cells += [f"**{missed}**" if run["bounder"] in UNPROVEN else missed]
    cells += ["" if rate is None else f"{rate:.2f}" for rate in rates]
    cells += [run["certificate"] or "none", "identical" if run["identical"] else "differs"]
    return "| " + " | ".join(cells) + " |"


def _choice(chosen: dict, runs: list[dict]) -> str:
    """What ``choose`` has taken, and what that costs beside the best of the table."""
    cost = {run["bounder"]: run["ms_broad"] + run["ms_narrow"] for run in runs if run["bounder"] not in UNPROVEN}
    own = cost.pop(CHOSEN)
    best = min(cost, key=cost.get)
    told = sorted({f"{each['label']} at {each['narrow_ns']:.3g} ns a call" for each in chosen.values()})
    return (
        f"`chosen`: {', '.join(told)}; broad and narrow phase together {own:.2f} ms, {own / cost[best]:.2f} times "
        ""
        f"those of {best}, the best of the table."
    )


def _field(rows: list[dict]) -> list[str]:
    lines = [
        "Many meshes among many particles: one contact pass of Newton, and how many times as fast it is with a cull "
        "(ratios in one run).",
        "",
    ]
    names = [entry["bounder"] for entry in rows[0]["bounders"]]
    lines += ["| contact gap | Newton's own, ms | pairs | " + " | ".join(f"`{n}`" for n in names) + " | contacts |"]
    lines += ["|---" * (len(names) + 4) + "|"]
    for row in rows:
        ratios = " | ".join(f"{entry['ratio']:.2f}" for entry in row["bounders"])
        same = "identical" if all(entry["identical"] for entry in row["bounders"]) else "differ"
        lines.append(f"| {row['gap']:g} | {row['newton_ms']:.1f} | {row['pairs']:,} | {ratios} | {same} |")
    return [*lines, ""]


if __name__ == "__main__":
    try:
        target = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")
        (target / "README.md").write_text(page(target))
    except wb.BoundingError as error:
        sys.exit(f"page: {error}")
