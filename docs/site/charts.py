"""Charts of what was measured: ``python docs/site/charts.py`` writes ``times``, ``cull`` and ``tightness.png`` in docs.

*times*, from ``results/demos/*.json``. For each demo a whole step: without a broad phase; with a box, which a user
would take otherwise; with the best classic volume; with the network ``mlp``; and with what ``choose`` takes, where the
demo has measured it. Bars are shares of the step without a broad phase. What has no proof is left out.

*cull*, from ``results/newton`` and ``results/gpu/h100``: how many times as fast Newton's particle-shape pass is with a
cull, by pairs of a particle and a shape, on a CPU and on a GPU.

*tightness*, from ``results/meshes``: false positives over bytes, of five meshes together and of the one built of boxes.
"""

import argparse
import json
import re
import statistics
import sys
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
CLASSIC = ("kdop", "bvh", "bvh-1500", "voxels", "moving aabb", "aabb")


class Bars(NamedTuple):
    """A group of bars: a section of a demo."""

    demo: str
    section: str  # empty for a demo of one
    title: str


GROUPS = (
    Bars("particles", "containment", "Rain, expensive test\n(is a drop inside?)"),
    Bars("particles", "contact", "Rain, cheap test\n(contact)"),
    Bars("cloth", "", "Cloth on two meshes\n(Newton)"),
    Bars("path", "rooms", "Path of a point\n(2D map)"),
    Bars("shadows", "", "Shadows\n(rays, moving mesh)"),
    Bars("digits", "2 latent numbers", "Generated images\n(2 numbers)"),
    Bars("arm", "UR5, meshes", "Planner of a UR5\n(4 joints, meshes)"),
)
KINDS = {  # what a bar is of, and its colour
    "without": "#c9ced3",
    "a box": "#b9ad9e",
    "best classic volume": "#8b7a66",
    "network (mlp)": "#2f7fd1",
    "choose": "#e0871b",
}
LABEL = 8  # height of a number and what it is above its bar, in the axis' units


def shares(results: Path, group: Bars) -> dict[str, tuple[float, str]]:
    """Milliseconds of a step, and the name of the bounder, by kind of bar."""
    runs = json.loads((results / f"{group.demo}.json").read_text())["runs"]
    own: dict[str, dict[str, Any]] = {}
    for run in runs:
        if (run["section"] + ",").startswith((group.section + ",", group.section + " ")) or not group.section:
            own.setdefault(run["bounder"], run)
    proven = {name: run for name, run in own.items() if run["certificate"] in ("proven", "by construction")}

    def best(names) -> tuple[float, str] | None:
        found = [(proven[name]["ms_step"], name) for name in names if name in proven]
        return min(found, default=None)

    box = "moving aabb" if "moving aabb" in proven else "aabb"
    found = {
        "without": (own["none"]["ms_step"], "none"),
        "a box": best([box]),
        "best classic volume": best(CLASSIC),
        "network (mlp)": best(["mlp"]),
        "choose": best(["chosen"]),
    }
    return {kind: value for kind, value in found.items() if value is not None}


def times(results: Path, path: Path) -> None:
    """Write the chart of wall time; ``results`` is the folder of the demos."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patheffects import withStroke

    from sims.drawing import INK, save_figure

    figure = Figure(figsize=(11, 5.2))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.06, 0.17, 0.925, 0.68))
    width = 0.8 / len(KINDS)
    for place, group in enumerate(GROUPS):
        measured = shares(results, group)
        whole = measured["without"][0]
        first = place - width * (len(measured) - 1) / 2
        for number, (kind, (milliseconds, _)) in enumerate(measured.items()):
            x, share = first + number * width, 100 * milliseconds / whole
            axes.bar(x, share, 0.92 * width, color=KINDS[kind], label=kind if place == 0 else None)
            weight = "bold" if kind == "network (mlp)" else "normal"
            if kind == "without":
                continue
            axes.text(
                x,
                (100 if 100 - LABEL < share < 100 else share) + 1.5,  # clear of the dashed line
                f"{share:.0f}",
                ha="center",
                fontsize=7.6,
                color=INK,
                weight=weight,
                path_effects=[withStroke(linewidth=2, foreground="white")],
            )
        text = f"{whole:,.0f} ms" if whole >= 10 else f"{whole:.1f} ms"
        axes.text(place, -19, text, ha="center", va="top", fontsize=8.5, color="#5a6b7a")
    axes.axhline(100, color=INK, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
    axes.set_xticks(range(len(GROUPS)), [group.title for group in GROUPS], fontsize=9.5, color=INK)
    axes.tick_params(axis="x", length=0, pad=4)
    axes.tick_params(axis="y", labelsize=9, colors=INK)
    axes.set_xlim(-0.55, len(GROUPS) - 0.45)
    axes.set_ylim(0, 165)
    axes.set_ylabel("time of a step, % of that without", fontsize=10, color=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0), ncols=len(KINDS), frameon=False, fontsize=9.5)
    title = "Time of a whole step with a broad phase; above the line it costs more than it saves"
    figure.text(0.06, 0.93, title, fontsize=12, color=INK, weight="bold")
    machine = json.loads((results / "particles.json").read_text())["machine"]
    text = f"Results are the same in every bar, to the bit. Milliseconds: a step without. {machine}, no GPU."
    figure.text(0.06, 0.885, text, fontsize=9.5, color="#5a6b7a")
    save_figure(figure, path, 144)


GAP, SORTED = 0.05, 100_000  # metres, of the contacts; pairs from which on the library sorts survivors on a GPU
GPU_CELL = re.compile(r"(\d+) particles, (\d+) meshes")


def gains(results: Path) -> dict[str, list[tuple[int, float]]]:
    """Pairs, and how many times as fast, by device and way."""
    rows = [json.loads(line) for line in (results / "newton/newton.jsonl").read_text().splitlines()]
    rows = [row for row in rows if row["gap"] == GAP]
    found = {
        "CPU, with bounders": [(row["pairs"], 1 / row["share"]["cores"]) for row in rows],
        "CPU, boxes of meshes alone": [(row["pairs"], 1 / row["share"]["boxes"]) for row in rows],
        "GPU, with bounders": [],
        "GPU, boxes of meshes alone": [],
    }
    for cell, values in json.loads((results / "gpu/h100/cull.json").read_text())["found"].items():
        if GPU_CELL.fullmatch(cell):
            pairs = values["pairs"]
            layout = ", 16 warps, by place" if pairs >= SORTED else ", 16 warps"

            def milliseconds(way: str, values=values) -> float:
                turns = [v for key, v in values.items() if re.fullmatch(re.escape(way) + r", ms, turn \d+", key)]
                return statistics.median(each for turn in turns for each in turn)

            for name, way in (("with bounders", "distance"), ("boxes of meshes alone", "boxes")):
                found[f"GPU, {name}"].append((pairs, milliseconds("none") / milliseconds(way + layout)))
    return found


def cull(results: Path, path: Path) -> None:
    """Write the chart of Newton's cull."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from sims.drawing import INK, save_figure

    figure = Figure(figsize=(8, 4.8))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.085, 0.125, 0.895, 0.73))
    styles = {"CPU, with bounders": ("#2f7fd1", "o", True), "CPU, boxes of meshes alone": ("#2f7fd1", "o", False)}
    styles |= {"GPU, with bounders": ("#d1420a", "s", True), "GPU, boxes of meshes alone": ("#d1420a", "s", False)}
    for name, points in gains(results).items():
        colour, marker, full = styles[name]
        x, y = zip(*sorted(points), strict=True)
        face = colour if full else "white"
        axes.plot(x, y, marker, color=colour, markerfacecolor=face, markersize=7, label=name, zorder=3 + full)
    axes.axhline(1.0, color=INK, linewidth=1.2, zorder=1)
    axes.axhspan(0.5, 1.0, color="#f6e3da", zorder=0)
    axes.text(1.6e3, 0.93, "break-even; below it the cull costs more than it saves", fontsize=9.5, color=INK, va="top")
    axes.set(xscale="log", yscale="log", xlim=(1.4e3, 1e7), ylim=(0.8, 8))
    ticks = (0.8, 1, 1.5, 2, 3, 4, 6, 8)
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    axes.tick_params(labelsize=9.5, colors=INK)
    axes.set_xlabel("pairs of a particle and a shape in Newton's pass", fontsize=10.5, color=INK)
    axes.set_ylabel("times as fast with the cull", fontsize=10.5, color=INK)
    axes.grid(axis="y", color="#e3e7ea", linewidth=0.8, zorder=0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=10)
    figure.text(
        0.085, 0.94, "When a cull of Newton's particle-shape pass pays", fontsize=12.5, color=INK, weight="bold"
    )
    text = f"Same contacts, record by record. Contact gap {GAP:g} m; CPU: 2 cores; GPU: H100, in a graph."
    figure.text(0.085, 0.89, text, fontsize=9.5, color="#5a6b7a")
    save_figure(figure, path, 144)


BOXES = "bear"  # the mesh that is built of boxes
CURVES = {  # sizes of a method, joined by a line, and its colour
    "network (mlp)": (("mlp 16-16", "mlp 24-24", "mlp 32-32", "mlp 50-50"), "#2f7fd1"),
    "tree of boxes (bvh)": (("bvh 64", "bvh 300", "bvh 1500"), "#8b5a2b"),
    "grid of bits (voxels)": (("voxels 64", "voxels 192"), "#2e8b6f"),
    "one volume": (("aabb", "kdop", "learned-kdop"), "#7d8790"),
}
ALONG = list(CURVES)[:3]  # those that are one method in several sizes


def tightness(results: Path, path: Path) -> None:
    """Write the chart of false positives over bytes; over several meshes, geometric means, the least and the most."""
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from sims.drawing import INK, save_figure

    rows = [json.loads(line) for line in (results / "meshes/meshes.jsonl").read_text().splitlines()]
    proven = {(row["mesh"], row["label"]): row for row in rows if row["certificate"] == "proven"}
    meshes = list(dict.fromkeys(row["mesh"] for row in rows))
    others = [name for name in meshes if name != BOXES]
    figure = Figure(figsize=(9.6, 4.6))
    FigureCanvasAgg(figure)
    sides = ((others, ", ".join(others)), ([BOXES], f"{BOXES}, which is built of boxes"))
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    figure.subplots_adjust(left=0.075, right=0.985, bottom=0.13, top=0.74, wspace=0.06)
    for ax, (names, title) in zip(axes, sides, strict=True):
        for kind, (labels, colour) in CURVES.items():
            found = [[proven[name, label] for name in names] for label in labels]
            size, rate = (np.array([[r[key] for r in each] for each in found]) for key in ("bytes", "fp_rate"))
            x, y = (np.exp(np.log(each).mean(axis=1)) for each in (size, rate))
            ax.plot(x, y, "o-" if kind in ALONG else "o", color=colour, linewidth=2.2, label=kind, zorder=3)
            if len(names) > 1:
                ax.vlines(x, rate.min(axis=1), rate.max(axis=1), color=colour, linewidth=4, alpha=0.22, zorder=2)
            if kind not in ALONG and len(names) > 1:
                for label, at in zip(labels, zip(x, y, strict=True), strict=True):
                    ax.annotate(label, at, (8, 0), textcoords="offset points", fontsize=9, color=colour, va="center")
        ax.set(xscale="log", yscale="log", xlim=(40, 2e6), ylim=(0.15, 70))
        ax.set_title(title, fontsize=10.5, color=INK, loc="left")
        ax.set_xticks([100, 1e3, 1e4, 1e5, 1e6], ["100 B", "1 kB", "10 kB", "100 kB", "1 MB"])
        ax.set_yticks([0.2, 0.5, 1, 2, 5, 10, 20, 50], ["0.2", "0.5", "1", "2", "5", "10", "20", "50"])
        ax.minorticks_off()
        ax.tick_params(labelsize=9.5, colors=INK)
        ax.grid(color="#e3e7ea", linewidth=0.8, zorder=0)
        ax.set_axisbelow(True)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc=(0.066, 0.8), ncols=4, frameon=False, fontsize=9.5)
    axes[0].set_ylabel("false positives, % of points", fontsize=10.5, color=INK)
    head = "How much a bound lets through, by its bytes; all are proven"
    figure.text(0.075, 0.94, head, fontsize=12.5, color=INK, weight="bold")
    text = "Lower is tighter. Left: geometric means over five meshes; bars show their range."
    figure.text(0.075, 0.885, text, fontsize=9.5, color="#5a6b7a")
    save_figure(figure, path, 144)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the pictures")
    given = parser.parse_args()
    times(ROOT / "results/demos", given.out / "times.png")
    cull(ROOT / "results", given.out / "cull.png")
    tightness(ROOT / "results", given.out / "tightness.png")
