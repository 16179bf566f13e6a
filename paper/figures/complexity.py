"""*Complexity*: false positives against the size of the network, by dimension."""

from functools import partial

import numpy as np

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import METHODS, PALE, page

__all__ = ["Complexity"]

# Widths of both hidden layers by dimension, the paper's as far as two cores train and prove them in the time; and of the quick form.
WIDTHS = {2: (10, 16, 25, 50, 75, 125), 3: (16, 25, 50, 75, 125), 4: (25, 50, 75)}
QUICK = {2: (10, 25), 3: (16, 32), 4: (16, 32)}
SECONDS = {2: (10, 2), 3: (30, 5), 4: (60, 8)}
WIDE = 50  # neurons a layer from which the seconds grow with the width
BASELINES = {"obb": "-", "sphere": "--"}


class Complexity(Figure):
    """See module."""

    name = "complexity"
    title = "What a larger network buys, by dimension"
    paper = "the supplement's plot of complexity"
    caption = (
        "False positives, in per cent of random points (logarithmic), against the number of parameters, a panel a dimension. "
        "The band is from the best to the worst object, the line their mean. Oriented box and sphere have one size, and get "
        "worse from dimension to dimension; a network stays low, and what it has too much goes down with its size. "
        "The paper's plot goes on to 256 neurons a layer in 3D and to 1,024 in 4D. Those are left out: on two cores they do "
        "not get tight in the time of a fit (in 4D, 125 neurons a layer did not in three minutes)."
    )
    objects = objects_named(
        "2d/bunny=2d/fish 2d/star1=2d/star 3d/bunny=3d/bunny 3d/airplane=3d/cup 4d/bunny=4d/bunny 4d/dragon=4d/cup"
    )

    def wanted(self, settings):
        found = super().wanted(settings)
        if not settings.quick:
            return found
        return tuple(next(thing for thing in found if thing.label.startswith(f"{n}d")) for n in WIDTHS)

    def parts(self, work):
        parts = {}
        for thing in self.wanted(work.settings):
            grid, ndim = work.shape(thing), int(thing.label[0])
            for method in BASELINES:
                parts[f"{thing.label} {method}"] = partial(work.measured, grid, 60.0, method=method)
            for width in work.choose(WIDTHS, QUICK)[ndim]:
                own = {"method": "mlp", "hidden": (width, width)}
                seconds = work.choose(*SECONDS[ndim]) * max(1.0, width / WIDE)
                parts[f"{thing.label} mlp {width}"] = partial(work.measured, grid, seconds, **own)
        return parts

    def draw(self, parts, tools):
        def fill(figure) -> None:
            figure.set_size_inches(9.2, 3.3)
            panels = figure.subplots(
                1,
                3,
                sharey=True,
                gridspec_kw={"left": 0.07, "right": 0.99, "top": 0.87, "bottom": 0.24, "wspace": 0.08},
            )
            for axes, ndim in zip(panels, WIDTHS, strict=True):
                self._panel(axes, {n: p for n, p in parts.items() if n.startswith(f"{ndim}d")})
                axes.set_title(f"{ndim}D", loc="left", fontweight="bold", fontsize=10)
            panels[0].set_ylabel("false positives, % (log scale)")
            panels[-1].legend(frameon=False, fontsize=8, loc="lower right")

        return page(fill)

    @staticmethod
    def _panel(axes, parts) -> None:
        labels = list(dict.fromkeys(name.partition(" ")[0] for name in parts))
        widths = sorted({int(name.split(" ")[2]) for name in parts if name.count(" ") == 2})
        found = np.array([[parts[f"{label} mlp {width}"]["fp"] for width in widths] for label in labels])
        size = [parts[f"{labels[0]} mlp {width}"]["numbers"] for width in widths]
        axes.fill_between(size, found.min(axis=0), found.max(axis=0), color=METHODS["mlp"], alpha=0.25, linewidth=0)
        axes.plot(size, found.mean(axis=0), "o-", color=METHODS["mlp"], label="mlp")
        for method, style in BASELINES.items():
            rates = [parts[f"{label} {method}"]["fp"] for label in labels]
            axes.axhspan(min(rates), max(rates), color=METHODS[method], alpha=0.15, linewidth=0)
            axes.axhline(np.mean(rates), color=METHODS[method], linestyle=style, label=method)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_yticks([0.1, 0.3, 1, 3, 10, 30, 100], ["0.1", "0.3", "1", "3", "10", "30", "100"])
        axes.set_xticks(size, [f"{number:,}" for number in size], rotation=30)
        axes.minorticks_off()
        axes.set_xlabel("parameters", fontsize=9)
        axes.grid(axis="y", color=PALE, linewidth=0.8)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)

    def facts(self, parts):
        lines = []
        for ndim in WIDTHS:
            own = {name: part for name, part in parts.items() if name.startswith(f"{ndim}d")}
            of = {m: np.mean([p["fp"] for n, p in own.items() if n.split(" ")[1] == m]) for m in BASELINES}
            widths = sorted({int(n.split(" ")[2]) for n in own if n.count(" ") == 2})
            ends = [np.mean([p["fp"] for n, p in own.items() if n.endswith(f" {w}")]) for w in (widths[0], widths[-1])]
            lines.append(
                f"{ndim}D: "
                + ", ".join(f"`{m}` {rate:.1f}" for m, rate in of.items())
                + f", `mlp` {ends[0]:.2f} ({widths[0]} neurons a layer) to {ends[1]:.2f} ({widths[-1]})"
            )
        return [f"Mean false positives, %: {'; '.join(lines)}."]
