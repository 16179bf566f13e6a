"""*Gallery*: 3D shapes by methods, with what is cut off in red."""

from functools import partial
from typing import Any

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import DENIED, METHODS, SOLID, numbered, page, show
from paper.drawing.masks import pack, packed, raster, unpack
from paper.drawing.pictures import images
from paper.drawing.solids import layer, scene

__all__ = ["Gallery"]

PIXELS = 80  # of a raster's side
COLUMNS = ("aabb", "kdop", "learned-kdop", "occupancy", "mlp")
SECONDS = {"learned-kdop": (10, 4), "occupancy": (15, 6), "mlp": (60, 10)}  # full, quick


class Gallery(Figure):
    """See module."""

    name = "gallery"
    title = "3D shapes by methods"
    paper = "the paper's comparison of methods in 3D"
    caption = (
        "Each row is an object of 32 cells a side, each column what a method makes of it: where its bound says *maybe*. Box "
        "and k-DOPs are convex, and learned half-spaces are tighter than fixed ones of the same number. `occupancy`, the "
        "same network as `mlp` trained as a classifier, looks best and is wrong: red are parts of the object "
        "that it denies. `mlp` is nearly as close, and proven to contain every point of the object."
    )
    objects = objects_named("3d/bunny=3d/bunny 3d/airplane=3d/ring 3d/armchair=3d/cup 3d/dragon 3d/teapot")
    few = 3

    def parts(self, work):
        parts = {}

        def shown(thing, grid, points) -> dict[str, Any]:
            return {"inside": packed(grid, points), "up": work.up(thing)}

        for thing in self.wanted(work.settings):
            grid = work.shape(thing)
            points = raster(grid, PIXELS)
            parts[grid.name.partition(".")[0]] = partial(shown, thing, grid, points)
            for method in COLUMNS:
                seconds, name = work.choose(*SECONDS.get(method, (60.0, 60.0))), grid.name.partition(".")[0]
                parts[f"{name} {method}"] = partial(work.measured, grid, seconds, points, method=method)
        return parts

    def draw(self, parts, tools):
        rows = [name for name in parts if "inside" in parts[name]]
        names = [name for row in rows for name in (row, *(f"{row} {method}" for method in COLUMNS))]
        pictures = images(tools, {name: self._scene(parts, name) for name in names})

        def fill(figure) -> None:
            width, height = 1.55 * (len(COLUMNS) + 1), 1.72 * len(rows) + 0.3
            figure.set_size_inches(width, height)
            place = {
                "left": 0.01,
                "right": 0.99,
                "top": 1 - 0.26 / height,
                "bottom": 0.22 / height,
                "hspace": 0.16,
                "wspace": 0.03,
            }
            panels = figure.subplots(len(rows), len(COLUMNS) + 1, gridspec_kw=place, squeeze=False)
            for line, row in zip(panels, rows, strict=True):
                for axes, method in zip(line, ("", *COLUMNS), strict=True):
                    name = f"{row} {method}".strip()
                    show(axes, pictures[name], "", numbered(parts[name]) if method else "")
                    axes.spines[:].set_visible(False)
                    if row == rows[0]:
                        axes.set_title(method or "object", fontsize=9.5, pad=4)

        return page(fill, svg=False)

    @staticmethod
    def _scene(parts, name: str) -> dict[str, Any]:
        row, _, method = name.partition(" ")
        inside, up = (parts[row][key] for key in ("inside", "up"))
        if not method:
            return scene(layer(inside, SOLID), up=up, around=inside)
        maybe = parts[name]["maybe"]
        denied = pack(unpack(inside) & ~unpack(maybe))
        bound = layer(maybe, METHODS[method], smooth=True)
        return scene(bound, layer(denied, DENIED), up=up, around=inside)

    def facts(self, parts):
        lines = []
        for method in COLUMNS:
            own = [part for name, part in parts.items() if name.partition(" ")[2] == method]
            missed = (
                f", false negatives {sum(p['fn'] for p in own):,} of {sum(p['samples'] for p in own):,} points"
                if any(p["fn"] for p in own)
                else ""
            )
            lines.append(f"`{method}` {sum(p['fp'] for p in own) / len(own):.2f} %{missed}")
        return [f"Mean false positives: {'; '.join(lines)}."]
