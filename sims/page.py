"""``results/demos``: what the demos measured, as JSON and as a page.

python -m sims NAME --output out/demo --json > results/demos/NAME.json     # for each of the demos
python -m sims.page results/demos                                          # writes README.md there
"""

import json
import operator
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import warp_bounding as wb
from sims import DEMOS
from sims.report import CHOSEN

__all__ = ["page"]

STEP = {"particles": "step", "cloth": "step", "path": "world", "shadows": "picture", "digits": "batch", "arm": "cell"}
STEP["pile"] = "step"
BOXES, NETWORKS = ("moving aabb", "aabb"), ("mlp", "learned-kdop+mlp", "distance", "pairs")
CLASSIC = ("kdop", "bvh", "obb", "bvh-1500", "voxels", *BOXES)
HEAD = """# What the demos measured

A proven bounder changes no result: every run with one ends in the same state, picture or path as the run without,
to the bit. A network saves much of the time where an exact check is expensive (rain, arms, generated digits), and
little or nothing where it is cheap (contacts, cloth, paths in a 2D grid). In the pile, `pairs` leaves little but the
pairs that touch, and these cost most. `occupancy`, a network without a proof, misses hits in every demo that has it.

`python -m sims NAME --json > results/demos/NAME.json`, then `python -m sims.page results/demos`. {machines}.
Milliseconds are medians. The JSON files have all bounders, with false positives, certificates and the times of both
phases.

## Time of a step

Milliseconds, everything included; in brackets the share of the exact checks that is left. *Box*: refitted in each
step, where the shape moves. *Without*, in the pile: bounding spheres. `choose` takes one of the proven bounders, given
the queries of a run without a broad phase. *Missed*: hits of the run without a broad phase that the run with
`occupancy` lacks.

| | without | box | best classic | network, or `pairs`, proven | `choose` | `occupancy` | missed |
|---|---:|---:|---:|---:|---:|---:|---:|
"""
FIELD = """
## Many meshes among many particles

One contact pass of Newton, and how many times as fast it is with a cull (ratios in one run). Contacts are identical,
record by record.

"""


def page(folder: Path) -> str:
    """The page about the JSON files in a folder.

    Raises:
        BoundingError: If there are none, or one is not what a demo printed.
    """
    found = [name for name in DEMOS if (folder / f"{name}.json").is_file()]
    if not found:
        raise wb.BoundingError(f"{folder}: expected files such as {DEMOS[0]}.json, found none")
    answers = [_read(folder / f"{name}.json") for name in found]
    text = HEAD.replace("{machines}", "; ".join(sorted({answer["machine"] for answer in answers})))
    text += "".join(f"| {' | '.join(row)} |\n" for answer in answers for row in _rows(answer))
    for answer in answers:
        text += _field(answer["field"]) if "field" in answer else ""
    return text


def _read(path: Path) -> dict:
    try:
        answer = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise wb.BoundingError(f"{path}: expected what a demo prints with --json, got something else") from error
    if not isinstance(answer, dict) or not {"demo", "machine", "runs", "steps"} <= answer.keys():
        raise wb.BoundingError(f"{path}: expected what a demo prints with --json, got something else")
    return answer


def _rows(answer: dict) -> Iterator[list[str]]:
    """The cells of each section."""
    for section, found in groupby(answer["runs"], key=lambda run: run["section"]):
        runs = {run["bounder"]: run for run in found}
        whole = runs["none"]["narrow_calls"]

        def cell(names: tuple[str, ...], runs: dict = runs, whole: int = whole) -> str:
            own = [runs[name] for name in names if name in runs and runs[name]["certificate"] != "statistical"]
            if not own:
                return ""
            best = min(own, key=operator.itemgetter("ms_step"))
            name = f"`{best['bounder']}` " if names is CLASSIC or best["bounder"] in NETWORKS[1:] else ""
            return f"{name}{best['ms_step']:,.1f} ({100 * best['narrow_calls'] / whole:.0f} %)"

        title = ", ".join(filter(None, (answer["demo"], section.removeprefix("Planar arm, ").split(", decoder")[0])))
        box = next((name for name in BOXES if name in runs), "none")
        yield [
            f"{title}, a {STEP[answer['demo']]}",
            f"{runs['none']['ms_step']:,.1f}",
            cell((box,)) if box != "none" else "",
            cell(CLASSIC),
            cell(NETWORKS),
            cell((CHOSEN,)),
            cell(("occupancy",)),
            f"**{runs['occupancy']['missed']:,}**" if "occupancy" in runs else "",
        ]


def _field(rows: list[dict]) -> str:
    names = [entry["bounder"] for entry in rows[0]["bounders"]]
    lines = ["| contact gap | Newton's own, ms | pairs | " + " | ".join(f"`{n}`" for n in names) + " |"]
    lines += ["|---:" * (len(names) + 3) + "|"]
    for row in rows:
        if not all(entry["identical"] for entry in row["bounders"]):
            raise wb.BoundingError(f"expected the contacts of Newton's own pass, got others at a gap of {row['gap']}")
        ratios = " | ".join(f"{entry['ratio']:.2f}" for entry in row["bounders"])
        lines.append(f"| {row['gap']:g} | {row['newton_ms']:.1f} | {row['pairs']:,} | {ratios} |")
    return FIELD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    try:
        target = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demos")
        (target / "README.md").write_text(page(target))
    except wb.BoundingError as error:
        sys.exit(f"page: {error}")
