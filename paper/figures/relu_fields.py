"""*ReLU fields*: pixels, a field that is trained as a classifier, and ours, all of the same resolution."""

from typing import Any

import numpy as np

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import METHODS, bounded, numbered, page, show
from paper.drawing.masks import pack, packed, raster, unpack

__all__ = ["ReluFields"]

PIXELS, NODES = 384, 12  # of a raster's side, a multiple of the next; of all three along each axis
STEPS, BATCH, RATE = 1500, 8192, 0.05  # of the plain field's training
TITLES = {"pixels": "pixels", "plain": "field, as a classifier", "ours": "field, ours (proven)"}


class ReluFields(Figure):
    """See module."""

    name = "relu-fields"
    title = f"Fields of {NODES} x {NODES} numbers"
    paper = "the paper's figure of ReLU fields"
    caption = (
        f"The same {NODES * NODES} numbers in three ways. Left, pixels: a pixel is marked if the object touches it. Middle, a field: "
        "numbers at nodes, interpolated between them, and trained as a classifier; it follows the outline and cuts pieces off (red). Right, ours: "
        "the same field with the asymmetric loss, repaired and proven: no piece is missing, and it is tighter than the pixels. It trains in seconds."
    )
    objects = objects_named("2d/dragon1=2d/fish")

    def parts(self, work):
        grid = work.shape(self.objects[0])
        points = raster(grid, PIXELS)

        def measured(ask) -> dict[str, Any]:
            """Rates of an answer to points, as ``Work.rates`` has them."""
            x = np.random.default_rng(work.settings.seed + 1).uniform(
                grid.sample_lower, grid.sample_upper, (work.settings.samples, grid.ndim)
            )
            x = x.astype(np.float32).astype(np.float64)
            truth, maybe = grid.contains(x), ask(x)
            counts = {"fp": round(100 * float((maybe & ~truth).mean()), 4), "fn": int((~maybe & truth).sum())}
            return {**counts, "samples": len(x), "maybe": pack(ask(points.reshape(-1, 2)).reshape(points.shape[:-1]))}

        def pixels() -> dict[str, Any]:
            block = PIXELS // NODES
            inside = unpack(packed(grid, points))
            marked = inside.reshape(NODES, block, NODES, block).any(axis=(1, 3))
            lower, upper = grid.lower, grid.upper

            def ask(x: np.ndarray) -> np.ndarray:
                cell = np.floor((x - lower) / (upper - lower) * NODES).astype(int).clip(0, NODES - 1)
                return marked[tuple(cell.T)]

            return measured(ask)

        def plain() -> dict[str, Any]:
            from warp_bounding.training.comparisons.plain_field import plain_field

            return measured(plain_field(grid, NODES, work.settings.seed, STEPS, BATCH, RATE))

        def ours() -> dict[str, Any]:
            return work.measured(grid, work.choose(20, 4), points, method="relu-field", nodes=NODES)

        return {"object": lambda: {"inside": packed(grid, points)}, "pixels": pixels, "plain": plain, "ours": ours}

    def draw(self, parts, tools):
        inside = unpack(parts["object"]["inside"])
        tints = {"pixels": METHODS["voxels"], "plain": METHODS["occupancy"], "ours": METHODS["relu-field"]}

        def fill(figure) -> None:
            figure.set_size_inches(7.2, 2.75)
            panels = figure.subplots(
                1, 3, gridspec_kw={"left": 0.01, "right": 0.99, "top": 0.9, "bottom": 0.09, "wspace": 0.06}
            )
            for axes, name in zip(panels, TITLES, strict=True):
                part = parts[name]
                show(axes, bounded(inside, unpack(part["maybe"]), tints[name]), TITLES[name], numbered(part))

        return page(fill)

    def facts(self, parts):
        told = [f"{TITLES[name]}: {numbered(parts[name])}, {parts[name]['seconds']:.0f} s" for name in TITLES]
        return [f"{'; '.join(told)}."]
