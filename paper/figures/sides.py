"""*Inside and outside*: where a point is certainly not in the object, and where it certainly is."""

from functools import partial
from typing import Any

import numpy as np

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import INK, SOLID, page, show, tinted
from paper.drawing.masks import pack, packed, raster, unpack
from paper.drawing.pictures import images
from paper.drawing.solids import layer, scene
from warp_bounding.indicators.parts import SIDES

__all__ = ["Sides"]

NEVER, ALWAYS, WITHIN, AROUND = "#a9cbe8", "#f2bd1d", "#6d8296", "#ffffff"
PIXELS = {2: 256, 3: 80}  # of a raster's side, by dimension
HIDDEN = {2: (25, 25), 3: (50, 50)}
SECONDS = {2: (30, 6), 3: (90, 12)}  # full, quick
NDIMS = (2, 3)


class Sides(Figure):
    """See module."""

    name = "inside-and-outside"
    title = "Never hit, always hit"
    paper = "the paper's figures of never- and always-hit regions, in 2D and 3D"
    caption = (
        'Two networks for each object, one from the outside and one from the inside (`side="inside"`): where the first says *no* a '
        "point is never in the object (blue), where the second does it always is (yellow). Only what is left, white outside and grey "
        "inside, has to be looked at closely. Both are proven. In 3D the object is drawn translucent over what is certainly inside, and "
        "what is certainly outside is left out."
    )
    objects = objects_named("2d/star1=2d/star 2d/dragon2=2d/fish 3d/bunny=3d/bunny 3d/teapot=3d/cup")

    def parts(self, work):
        parts = {}

        def shown(thing, grid, points) -> dict[str, Any]:
            return {"inside": packed(grid, points), "up": work.up(thing), "ndim": grid.ndim}

        def measured(grid, points, side) -> dict[str, Any]:
            seconds, own = work.choose(*SECONDS[grid.ndim]), {"method": "mlp", "hidden": HIDDEN[grid.ndim]}
            return work.measured(grid, seconds, points, side=side, **own)

        for thing in self.wanted(work.settings):
            grid = work.shape(thing)
            name, points = self._named(grid), raster(grid, PIXELS[grid.ndim])
            parts[name] = partial(shown, thing, grid, points)
            for side in SIDES:
                parts[f"{name} {side}"] = partial(measured, grid, points, side)
        return parts

    @staticmethod
    def _named(grid) -> str:
        return f"{grid.ndim}D-{grid.name.partition('.')[0]}"

    def draw(self, parts, tools):
        rows = [name for name in parts if "inside" in parts[name]]
        solid = {name: self._scene(parts, name) for name in rows if parts[name]["ndim"] > NDIMS[0]}
        pictures = images(tools, solid)

        def fill(figure) -> None:
            figure.set_size_inches(2.45 * len(rows), 2.75)
            place = {"left": 0.01, "right": 0.99, "top": 0.91, "bottom": 0.12, "wspace": 0.04}
            for axes, name in zip(
                figure.subplots(1, len(rows), gridspec_kw=place, squeeze=False)[0], rows, strict=True
            ):
                image = pictures[name] if name in pictures else self._flat(parts, name)
                show(axes, image, name.partition("-")[2], self._certain(parts, name))
                axes.spines[:].set_visible(name not in pictures)
                axes.xaxis.label.set_color(INK)

        return page(fill, svg=False)

    @staticmethod
    def _masks(parts, name: str) -> tuple[np.ndarray, ...]:
        """Where the object is, and where a point is certainly outside and certainly inside."""
        inside = unpack(parts[name]["inside"])
        return inside, *(~unpack(parts[f"{name} {side}"]["maybe"]) for side in SIDES)

    def _flat(self, parts, name: str) -> np.ndarray:
        inside, never, always = self._masks(parts, name)
        return tinted(inside.shape, {AROUND: ~inside, WITHIN: inside, NEVER: never, ALWAYS: always})

    def _scene(self, parts, name: str) -> dict[str, Any]:
        inside, _, always = self._masks(parts, name)
        body = layer(pack(always), ALWAYS, smooth=True)
        return scene(body, layer(pack(inside), SOLID, 0.35, smooth=True), up=parts[name]["up"], around=pack(inside))

    def _certain(self, parts, name: str) -> str:
        _, never, always = self._masks(parts, name)
        share = np.floor(1000 * (never | always).mean()) / 10  # what is not certain everywhere is not told to be
        return f"certain: {share:.1f} % of all"

    def facts(self, parts):
        lines = []
        for name in (name for name in parts if "inside" in parts[name]):
            outer, inner = (parts[f"{name} {side}"] for side in SIDES)
            held = 100 - inner["positives"]
            lines.append(
                f"{name.partition('-')[2]} ({name[:2]}): maybe {outer['fp']:.2f} % outside and {inner['fp']:.2f} % inside, of "
                f"{outer['samples']:,} points of which {held:.1f} % are in the object"
            )
        return [f"{'; '.join(lines)}."]
