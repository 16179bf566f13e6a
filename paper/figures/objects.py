"""*Objects*: the sheet of everything that the paper bounds."""

from functools import partial
from typing import Any

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import OBJECT, bounded, page, show
from paper.drawing.masks import packed, raster, unpack
from paper.drawing.pictures import images
from paper.drawing.solids import layer, scene

__all__ = ["Objects"]

PIXELS = {2: 128, 3: 64, 4: 64}  # of a raster's side
FRAMES = (0, 3, 6)  # steps of time that are shown of an animated object
TINTS = {2: OBJECT, 3: "#8fa7bf", 4: "#c9a27c"}


class Objects(Figure):
    """See module."""

    name = "objects"
    title = "All objects"
    paper = "the supplement's figure of all objects"
    caption = (
        "The objects of all tables, as they are bounded: 2D images of 32 x 32 cells, 3D voxels of 32 x 32 x 32, and animated "
        "ones of 10 steps of time, each shown at three of them, turning about an axis."
    )
    objects = objects_named(
        "2d/bunny 2d/chair 2d/dragon1 2d/dragon2 2d/house 2d/lucy 2d/star1 2d/star2 2d/teapot "
        "3d/airplane 3d/armchair 3d/bunny 3d/camera 3d/car 3d/dragon 3d/sofa 3d/teapot 3d/teddy 4d/bunny 4d/dragon 4d/teapot"
    )

    def parts(self, work):
        parts = {}
        for thing in self.wanted(work.settings):
            grid, ndim = work.shape(thing), int(thing.label[0])
            share = round(100 * float(grid.occupancy.mean()), 2)
            for frame in FRAMES if ndim == 4 else (None,):
                time = None if frame is None else float(grid.position([frame, 0, 0, 0])[0])
                name = thing.label if frame is None else f"{thing.label}, step {frame + 1}"

                def cells(thing, grid, time, side, share) -> dict:
                    return {"inside": packed(grid, raster(grid, side, time)), "occupied": share, "up": work.up(thing)}

                parts[name] = partial(cells, thing, grid, time, PIXELS[ndim], share)
        return parts

    def draw(self, parts, tools):
        solid = {name: part for name, part in parts.items() if not name.startswith("2d")}
        pictures = images(tools, {name: self._scene(name, part) for name, part in solid.items()})

        def fill(figure) -> None:
            figure.set_size_inches(10.5, 4.15)
            place = {"left": 0.03, "right": 0.995, "top": 0.94, "bottom": 0.02, "hspace": 0.22, "wspace": 0.05}
            panels = figure.subplots(3, 9, gridspec_kw=place)
            for line, ndim in zip(panels, (2, 3, 4), strict=True):
                own = [name for name in parts if name.startswith(f"{ndim}d")]
                line[0].set_ylabel(f"{ndim}D", fontsize=11, fontweight="bold")
                for axes, name in zip(line, own, strict=True):
                    image = pictures[name] if name in pictures else bounded(unpack(parts[name]["inside"]), None, OBJECT)
                    show(axes, image, name.partition("/")[2])
                    axes.spines[:].set_color("#dde2e6")

        return page(fill, svg=False)

    @staticmethod
    def _scene(name: str, part: dict[str, Any]) -> dict[str, Any]:
        """An object as large as its panel; an animated one keeps its size from step to step."""
        ndim, inside = int(name[0]), part["inside"]
        return scene(layer(inside, TINTS[ndim]), up=part["up"], around=inside if ndim == 3 else None)

    def facts(self, parts):
        found = {name.partition(",")[0]: part["occupied"] for name, part in parts.items()}
        return ["Occupied cells, %: " + ", ".join(f"{name} {share:g}" for name, share in found.items()) + "."]
