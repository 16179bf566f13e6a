"""*k-DOP*: six half-spaces, with fixed normals and with learned ones, like for like."""

from functools import partial

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import METHODS, bounded, numbered, page, show
from paper.drawing.masks import packed, raster, unpack

__all__ = ["Kdop"]

PIXELS, K = 256, 6  # of a raster's side; half-spaces
ROWS = {"kdop": "fixed normals (kdop)", "learned-kdop": "learned normals (learned-kdop)"}


class Kdop(Figure):
    """See module."""

    name = "kdop"
    title = "Six half-spaces, fixed and learned"
    paper = "the paper's figure of a learned k-DOP"
    caption = (
        "Both rows have six half-spaces, each pushed against the object by the same closed form, so both are as tight as their "
        "normals allow, and both are proven. Above, the normals are those of a hexagon; below, they were learned by gradient "
        "descent on the empty space inside. Learning turns the faces to where the object lets them come nearest."
    )
    objects = objects_named("2d/bunny=2d/fish 2d/star1=2d/star 2d/dragon1=2d/crescent 2d/house 2d/teapot")
    few = 3

    def parts(self, work):
        parts = {}
        for thing in self.wanted(work.settings):
            grid = work.shape(thing)
            points = raster(grid, PIXELS)
            parts[thing.label] = partial(lambda grid, at: {"inside": packed(grid, at)}, grid, points)
            for method in ROWS:
                parts[f"{thing.label} {method}"] = partial(
                    work.measured, grid, work.choose(10, 3), points, method=method, k=K
                )
        return parts

    def draw(self, parts, tools):
        labels = [name for name, part in parts.items() if "inside" in part]

        def fill(figure) -> None:
            figure.set_size_inches(1.8 * len(labels) + 0.35, 4.05)
            place = {"left": 0.04, "right": 0.995, "top": 0.985, "bottom": 0.055, "hspace": 0.13, "wspace": 0.06}
            panels = figure.subplots(2, len(labels), gridspec_kw=place, squeeze=False)
            for line, (method, told) in zip(panels, ROWS.items(), strict=True):
                line[0].set_ylabel(told, fontsize=9)
                for axes, label in zip(line, labels, strict=True):
                    part = parts[f"{label} {method}"]
                    image = bounded(unpack(parts[label]["inside"]), unpack(part["maybe"]), METHODS[method])
                    show(axes, image, "", numbered(part))

        return page(fill)

    def facts(self, parts):
        rates = {m: [p["fp"] for n, p in parts.items() if n.partition(" ")[2] == m] for m in ROWS}
        mean = {method: sum(own) / len(own) for method, own in rates.items()}
        told = ", ".join(f"`{method}` {rate:.2f} %" for method, rate in mean.items())
        fixed, learned = mean.values()
        return [f"Mean false positives with k = {K}: {told}: {learned / fixed:.2f} times."]
