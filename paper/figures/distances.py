"""*Distances*: how far below the true distance a proven one is, and how far outside the true offsets its level lines."""

from functools import partial
from typing import Any

import numpy as np

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import INK, OBJECT, page, upright
from paper.drawing.masks import pack_numbers, packed, raster, unpack, unpack_numbers

__all__ = ["Distances"]

PIXELS = 160  # of a raster's side
RADII = (0.02, 0.05, 0.1, 0.2)  # object units: the longest side of the paper's domains is 1
HIDDEN = (16, 16)
SECONDS = (40, 6)  # full, quick
LEVELS = ("#0b3c8c", "#1f7fd0", "#39b8d9", "#8fd3c8")  # of level lines, from the inside out
AROUND = 0.28  # of what is shown around an object's domain, object units
GAPS = "YlOrRd"  # colours of the gap ...
MOST, POWER = 0.2, 0.5  # ... the largest that they tell apart, object units, and of which power of it they are
EXTENT = (0.0, 1.0, 0.0, 1.0)  # of a panel


class Distances(Figure):
    """See module."""

    name = "distances"
    title = "Distances that are never too large"
    paper = "not in the paper, whose bounds are of one contact distance each"
    caption = (
        "A network of two layers of 16 for each object, trained to be its distance. What it exceeds the distance by anywhere is proven and taken off "
        "everywhere: the slack. In colour: the gap between the true distance and this bound, which is nowhere negative; beyond the dashed box no network "
        "is asked, the bound follows from the way to the box, and is looser. Coloured lines: where the "
        f"bound is {', '.join(map(str, RADII[:-1]))} and {RADII[-1]}; the thin line of its colour inside is the object's true offset by as much. "
        "One bounder, proven once, answers balls of all radii: those whose centre lies outside the line of their radius certainly do not touch the object."
    )
    objects = objects_named("2d/star1=2d/star 2d/bunny=2d/fish")

    def parts(self, work):
        parts = {}
        for thing in self.wanted(work.settings):
            grid = work.shape(thing)
            points = _around(grid)
            parts[thing.label] = partial(_truth, grid, points)
            parts[f"{thing.label} mlp"] = partial(_bounded, work, grid, points)
        return parts

    def draw(self, parts, tools):
        labels = [name for name, part in parts.items() if "inside" in part]

        def fill(figure) -> None:
            figure.set_size_inches(4.1 * len(labels) + 0.75, 4.3)
            place = {"left": 0.01, "right": 0.905, "top": 0.93, "bottom": 0.075, "wspace": 0.05}
            panels = figure.subplots(1, len(labels), gridspec_kw=place, squeeze=False)[0]
            for axes, label in zip(panels, labels, strict=True):
                colours = _panel(axes, parts[label], parts[f"{label} mlp"])
                axes.set_title(label, fontsize=9, pad=4)
            bar = figure.colorbar(colours, cax=figure.add_axes((0.92, 0.12, 0.014, 0.77)), extend="max")
            bar.set_label("true distance - bound", fontsize=8)
            bar.ax.tick_params(labelsize=8)
            bar.outline.set_visible(False)

        return page(fill)

    def facts(self, parts):
        told = []
        for label in (name for name, part in parts.items() if "inside" in part):
            own = parts[f"{label} mlp"]
            rates = ", ".join(f"{rate:.2f} % at {radius}" for radius, rate in zip(RADII, own["rates"], strict=True))
            told.append(
                f"{label}: {own['nbytes']:,} bytes, {own['certificate']}, slack {own['slack']:.2g}; the gap of points outside is {own['mean']:.4f} on "
                f"average, {own['least']:.4f} to {own['most']:.4f}; false positives {own['fp']:.2f} % at radius 0, {rates}; false negatives {own['fn']}."
            )
        return told


def _around(grid) -> np.ndarray:
    """A raster over an object's domain, and what is shown around it."""
    points = raster(grid, PIXELS).astype(np.float64)
    middle, longest = (grid.lower + grid.upper) / 2, (grid.upper - grid.lower).max()
    return (middle + (points - middle) * (1 + 2 * AROUND / longest)).astype(np.float32)


def _distances(grid, points: np.ndarray) -> np.ndarray:
    """Of a raster ``(S, S, 2)``: certified upper bounds of the true distance, within float64's rounding of it."""
    return grid.distances(points.reshape(-1, 2))[:, 1].reshape(points.shape[:-1])


def _truth(grid, points: np.ndarray) -> dict[str, Any]:
    return {"inside": packed(grid, points), "distance": pack_numbers(_distances(grid, points))}


def _bounded(work, grid, points: np.ndarray) -> dict[str, Any]:
    """A network of an object's distance: what it is, how tight at each radius, and the gap at the points of a raster."""
    from warp_bounding.evaluation import evaluate

    bounder = work.fit(grid, work.choose(*SECONDS), "distance", method="mlp", hidden=HIDDEN)
    told, rates = work.rates(bounder, grid), []
    for radius in RADII:
        found = evaluate(bounder, grid, work.settings.samples, seed=work.settings.seed + 1, radius=radius)
        rates.append(round(float(found.fp_rate), 4))
        told["fn"] += int(found.fn)
        work.heed()
    truth = _distances(grid, points)
    gap = truth - bounder.distance(points.reshape(-1, 2)).numpy().reshape(truth.shape).astype(np.float64)
    outside = gap[truth > 0]
    corner, side = points[0, 0], points[-1, -1] - points[0, 0]
    told["box"] = [((end - corner) / side).tolist() for end in (bounder.domain.lower, bounder.domain.upper)]
    told |= {"slack": bounder.slack, "mean": outside.mean(), "least": outside.min(), "most": outside.max()}
    return told | {"rates": rates, "gap": pack_numbers(gap)}


def _panel(axes, truth: dict[str, Any], own: dict[str, Any]):
    """One object with the gap in colour and all lines; returns what the colour bar is of."""
    distance, gap = unpack_numbers(truth["distance"]), unpack_numbers(own["gap"])
    from matplotlib.colors import PowerNorm
    from matplotlib.patches import Rectangle

    colours = axes.imshow(
        upright(gap), cmap=GAPS, norm=PowerNorm(POWER, 0, MOST), extent=EXTENT, interpolation="nearest"
    )
    lines = {"extent": EXTENT, "origin": "upper", "levels": RADII, "colors": LEVELS}
    axes.contour(upright(distance - gap), linewidths=2, **lines)
    axes.contour(upright(distance), linewidths=0.8, **lines)
    axes.contourf(upright(unpack(truth["inside"])), extent=EXTENT, origin="upper", levels=[0.5, 1.5], colors=[OBJECT])
    low, high = np.array(own["box"])
    axes.add_patch(Rectangle(low, *(high - low), fill=False, ls="--", lw=0.8, ec=INK))
    axes.set(xticks=[], yticks=[])
    axes.set_xlabel(
        f"{own['nbytes']:,} bytes, slack {own['slack']:.2g}, mean gap {own['mean']:.4f}", fontsize=8, labelpad=3
    )
    return colours
