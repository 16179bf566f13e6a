"""*Progressive*: one object, bounded by wider and wider networks."""

from functools import partial
from typing import Any

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import METHODS, bounded, numbered, page, show
from paper.drawing.masks import packed, raster, unpack

__all__ = ["Progressive"]

PIXELS = 256  # of a raster's side
# Hidden widths, octaves of positional encoding and seconds, as in the paper's supplement and smaller; and of the quick form.
SIZES = (
    ((5, 5), 0, 10),
    ((10, 10), 0, 15),
    ((10, 10, 5), 0, 20),
    ((25, 25, 5), 0, 30),
    ((50, 50), 0, 40),
    ((128, 128, 128), 4, 120),
)
QUICK = (((5, 5), 0, 2), ((10, 10, 5), 0, 3), ((25, 25, 5), 0, 4), ((50, 50), 0, 5))


class Progressive(Figure):
    """See module."""

    name = "progressive"
    title = "A star, by networks of growing width"
    paper = "the paper's figure of growing networks"
    caption = (
        "The dark star is the object (its 32 x 32 cells); orange is what the bound adds to it. From left to right the "
        "networks grow. All have no false negative, proven over every point of the star, whatever their size; what a larger "
        "network buys is tightness: first the gaps between the arms, then the steps of the cells. On the right, false "
        "positives, in per cent of random points, against the number of parameters."
    )
    objects = objects_named("2d/star1=2d/star")

    def parts(self, work):
        grid = work.shape(self.objects[0])
        points = raster(grid, PIXELS)

        def fitted(hidden, octaves, seconds) -> dict[str, Any]:
            return work.measured(grid, seconds, points, method="mlp", hidden=hidden, octaves=octaves)

        parts = {"object": lambda: {"inside": packed(grid, points)}}
        for size in work.choose(SIZES, QUICK):
            name = "-".join(map(str, size[0])) + (" encoded" if size[1] else "")
            parts[name] = partial(fitted, *size)
        return parts

    def draw(self, parts, tools):
        inside = unpack(parts["object"]["inside"])
        sizes = {name: part for name, part in parts.items() if "fp" in part}

        def fill(figure) -> None:
            count = len(sizes)
            figure.set_size_inches(1.75 * count + 3.2, 2.45)
            grid = figure.add_gridspec(
                1, count + 1, width_ratios=[1] * count + [1.45], left=0.01, right=0.985, wspace=0.06
            )
            grid.update(top=0.86, bottom=0.2)
            for column, (name, part) in enumerate(sizes.items()):
                axes = figure.add_subplot(grid[column])
                show(
                    axes,
                    bounded(inside, unpack(part["maybe"]), METHODS["mlp"]),
                    f"2-{name}-1".replace(" encoded-1", "-1, encoded"),
                    numbered(part),
                )
            axes = figure.add_subplot(grid[count])
            box = axes.get_position()
            axes.set_position([box.x0 + 0.045, box.y0 + 0.02, box.width - 0.045, box.height - 0.02])
            axes.plot(
                [p["numbers"] for p in sizes.values()], [p["fp"] for p in sizes.values()], "o-", color=METHODS["mlp"]
            )
            axes.set_xscale("log")
            axes.set_ylim(0, None)
            axes.set_xlabel("parameters", fontsize=8)
            axes.set_title("false positives, %", fontsize=9, loc="left", pad=4)
            axes.tick_params(labelsize=8)
            axes.grid(axis="y", color="#dde2e6", linewidth=0.8)
            axes.spines[["top", "right"]].set_visible(False)

        return page(fill)

    def facts(self, parts):
        sizes = [(name, part) for name, part in parts.items() if "fp" in part]
        told = "; ".join(f"{name} ({part['numbers']:,} parameters) {part['fp']:.2f} %" for name, part in sizes)
        return [
            f"False positives: {told}. False negatives: {sum(p['fn'] for _, p in sizes)} of {sizes[0][1]['samples']:,} samples each."
        ]
