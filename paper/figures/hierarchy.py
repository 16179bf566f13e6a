"""*Hierarchy*: a school of fish in three levels of networks."""

from functools import partial
from typing import Any

import numpy as np

from paper.drawing.base import Figure
from paper.drawing.canvas import OBJECT, page, show, upright
from paper.drawing.masks import packed, raster, unpack
from paper.drawing.shapes import fish
from warp_bounding.bounders import cascade
from warp_bounding.indicators import IndicatorGrid

__all__ = ["Hierarchy", "school"]

CELLS, PIXELS, SCALE = 160, 400, 1.25  # cells a side; of a raster's side; what the lengths below are multiplied by
LEVELS = {"root": "#5b9bd5", "children": "#f2c230", "leaves": "#e77fb3"}  # colours as in the paper
TITLES = {"root": "one network", "children": "two children", "leaves": "four leaves", "together": "together"}
HIDDEN = {"root": (16, 16), "children": (12, 12), "leaves": (10, 10)}
STEPS = (
    4000,
    500,
)  # of training, for each network: full, quick; a time would be shared by more networks from level to level
# Centres, lengths and angles of the fish, of which the upper ones swim a little downwards.
SCHOOL = (
    (0.14, 0.83, 0.17, -0.25), (0.33, 0.9, 0.15, -0.15), (0.29, 0.74, 0.19, -0.3), (0.49, 0.79, 0.16, -0.1),
    (0.46, 0.93, 0.12, -0.2), (0.66, 0.87, 0.15, -0.05), (0.83, 0.78, 0.17, 0.1), (0.65, 0.7, 0.13, 0.0),
    (0.2, 0.21, 0.18, 0.2), (0.4, 0.3, 0.15, 0.1), (0.39, 0.13, 0.16, 0.15), (0.59, 0.2, 0.19, 0.05),
    (0.78, 0.32, 0.15, -0.1), (0.8, 0.13, 0.14, 0.1), (0.6, 0.38, 0.11, 0.0), (0.91, 0.22, 0.11, 0.0),
)  # fmt: skip


def school() -> IndicatorGrid:
    """A school of fish, drawn by code, in 2D cells."""
    ticks = np.linspace(0, 1, CELLS)
    points = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    cells = np.zeros((CELLS, CELLS), dtype=bool)
    for x, y, size, angle in SCHOOL:
        cells |= fish(points, (x, y), SCALE * size, angle)
    return IndicatorGrid(cells, name="school")


class Hierarchy(Figure):
    """See module."""

    name = "hierarchy"
    title = "A hierarchy of networks around a school of fish"
    paper = "the paper's figure of a hierarchy"
    caption = (
        "A school of fish, drawn by code, in three levels: one network around all (blue), one for each half of the school (yellow), and one for "
        "each quarter (pink). What a level answers *no* is not asked further, so together (right) only what the first and the last level "
        "let through is left. No level has to bound the level below it: each is proven to bound the fish in its own region, and that is enough; in places a "
        "child's bound reaches beyond its parent's."
    )

    def parts(self, work):
        def levels() -> dict[str, Any]:
            from warp_bounding.training import fit, hierarchy

            grid = school()
            points, steps = raster(grid, PIXELS), max(1, round(work.choose(*STEPS) * work.settings.effort))
            about = {
                "method": "mlp",
                "steps": steps,
                "seed": work.settings.seed,
                "device": "cpu",
                "progress": work.tell,
            }
            bounders = {}
            for depth, (level, hidden) in enumerate(HIDDEN.items()):
                make = partial(hierarchy, levels=depth) if depth else fit
                bounders[level] = make(grid, hidden=hidden, **about)
                work.heed()
            bounders["together"] = cascade(bounders["root"], bounders["leaves"])
            found = {name: {**work.rates(b, grid), "maybe": packed(b, points)} for name, b in bounders.items()}
            return {"inside": packed(grid, points), "levels": found}

        return {"school": levels}

    def draw(self, parts, tools):
        inside, levels = unpack(parts["school"]["inside"]), parts["school"]["levels"]
        masks = {name: unpack(level["maybe"]) for name, level in levels.items()}

        def fill(figure) -> None:
            figure.set_size_inches(10.4, 2.95)
            panels = figure.subplots(
                1, 4, gridspec_kw={"left": 0.01, "right": 0.99, "top": 0.9, "bottom": 0.08, "wspace": 0.05}
            )
            for axes, name in zip(panels, TITLES, strict=True):
                drawn = LEVELS if name not in LEVELS else {name: LEVELS[name]}
                show(
                    axes,
                    _layers(inside, masks, drawn),
                    TITLES[name],
                    f"FP {levels[name]['fp']:.2f} %, FN {levels[name]['fn']}",
                )

        return page(fill)

    def facts(self, parts):
        levels = parts["school"]["levels"]
        told = "; ".join(
            f"{TITLES[n]} {level['fp']:.2f} % ({level['nbytes'] / 1024:.1f} kB, {level['certificate']})"
            for n, level in levels.items()
        )
        return [f"False positives: {told}."]

    def broken(self, parts):
        return super().broken(parts["school"]["levels"])


def _layers(inside: np.ndarray, masks: dict[str, np.ndarray], drawn: dict[str, str]) -> np.ndarray:
    """A picture of levels, the finer ones over the coarser, and the object over all."""
    image = np.full((*inside.shape, 3), 255, dtype=np.uint8)
    for name, colour in {**drawn, "": OBJECT}.items():
        image[masks[name] if name else inside] = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return upright(image)
