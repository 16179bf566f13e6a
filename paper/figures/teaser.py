"""*Teaser*: classic volumes and networks around one 2D object, and growing networks in two, three and four dimensions."""

from functools import partial
from typing import Any

from paper.drawing.base import Figure, objects_named
from paper.drawing.canvas import DENIED, METHODS, SOLID, bounded, numbered, page, show
from paper.drawing.masks import pack, packed, raster, unpack
from paper.drawing.pictures import images
from paper.drawing.solids import layer, scene

__all__ = ["Teaser"]

PIXELS = {2: 256, 3: 72, 4: 72}  # of a raster's side, by dimension
FRAME = 2  # step of time that is shown of an animated object
CLASSIC = ("aabb", "ellipsoid", "kdop", "occupancy", "mlp")
HIDDEN = (20, 10, 5)  # of the row of methods, as in the paper's supplement
# By dimension: hidden widths of the growing networks; seconds of each, and in the quick form.
GROWING = {
    2: ((4,), (10,), (20, 10, 5), (50, 50)),
    3: ((4,), (10, 10), (25, 25), (50, 50)),
    4: ((4,), (10, 10), (25, 25), (75, 75)),
}
SECONDS = {2: (15, 2), 3: (40, 4), 4: (90, 8)}


class Teaser(Figure):
    """See module."""

    name = "teaser"
    title = "Tight, and never too tight"
    paper = "the paper's teaser, and its idea in 3D and 4D"
    caption = (
        "First row: a box, an ellipsoid and a k-DOP hold the object (dark) but add much empty space (coloured). A network "
        "that is trained as a classifier fits closely and cuts pieces off (red); ours is as close, and a proof says that nothing is "
        "cut off. Below: objects in 2D, in 3D, and in 4D (one moment of a turning object), each with four networks of growing "
        "size: the bound, translucent, closes in on the object and never enters it (it is drawn from a raster, smoothed, so that patches of "
        "the object may show through)."
    )
    objects = objects_named("2d/dragon2=2d/fish 3d/bunny=3d/bunny 4d/bunny=4d/bunny")

    def parts(self, work):
        parts = {}
        shapes = {ndim: work.shape(thing) for ndim, thing in zip(PIXELS, self.objects, strict=True)}
        points = {ndim: raster(grid, PIXELS[ndim], self._time(ndim, grid)) for ndim, grid in shapes.items()}

        def measured(ndim, **options) -> dict[str, Any]:
            return work.measured(shapes[ndim], work.choose(*SECONDS[ndim]), points[ndim], **options)

        def shown(ndim) -> dict[str, Any]:
            return {"inside": packed(shapes[ndim], points[ndim]), "up": work.up(self.objects[ndim - 2])}

        for ndim in shapes:
            parts[f"{ndim}d object"] = partial(shown, ndim)
        for method in CLASSIC:
            own = {"hidden": HIDDEN} if method in ("occupancy", "mlp") else {}
            parts[f"2d {method}"] = partial(measured, 2, method=method, **own)
        for ndim, sizes in GROWING.items():
            for hidden in sizes:
                parts[f"{ndim}d {'-'.join(map(str, hidden))}"] = partial(measured, ndim, method="mlp", hidden=hidden)
        return parts

    @staticmethod
    def _time(ndim: int, grid) -> float | None:
        return float(grid.position([FRAME, 0, 0, 0])[0]) if ndim == 4 else None

    def draw(self, parts, tools):
        names = {n: [f"{n}d object", *(f"{n}d {'-'.join(map(str, h))}" for h in GROWING[n])] for n in (3, 4)}
        pictures = images(tools, {name: self._scene(parts, n, name) for n, own in names.items() for name in own})
        inside = unpack(parts["2d object"]["inside"])

        def fill(figure) -> None:
            figure.set_size_inches(9.2, 8.3)
            panels = figure.subplots(
                4,
                5,
                gridspec_kw={"left": 0.03, "right": 0.99, "top": 0.965, "bottom": 0.03, "hspace": 0.26, "wspace": 0.06},
            )
            for axes, method in zip(panels[0], CLASSIC, strict=True):
                part = parts[f"2d {method}"]
                show(axes, bounded(inside, unpack(part["maybe"]), METHODS[method]), method, numbered(part))
            rows = [["2d object", *(f"2d {'-'.join(map(str, h))}" for h in GROWING[2])], names[3], names[4]]
            for line, row, ndim in zip(panels[1:], rows, GROWING, strict=True):
                line[0].set_ylabel(f"{ndim}D", fontsize=11, fontweight="bold")
                for axes, name in zip(line, row, strict=True):
                    maybe = unpack(parts[name]["maybe"]) if "maybe" in parts[name] else None
                    image = pictures[name] if name in pictures else bounded(inside, maybe, METHODS["mlp"])
                    title = f"{ndim}-{name.partition(' ')[2]}-1" if maybe is not None else "object"
                    show(axes, image, title, numbered(parts[name]) if maybe is not None else "")
            for axes in panels.flat:
                axes.spines[:].set_color("#dde2e6")

        return page(fill, svg=False)

    @staticmethod
    def _scene(parts, ndim: int, name: str) -> dict[str, Any]:
        inside, up = (parts[f"{ndim}d object"][key] for key in ("inside", "up"))
        if "maybe" not in parts[name]:
            return scene(layer(inside, SOLID), up=up)
        denied = pack(unpack(inside) & ~unpack(parts[name]["maybe"]))
        bound = layer(parts[name]["maybe"], METHODS["mlp"], 0.45, smooth=True)
        return scene(layer(inside, SOLID), layer(denied, DENIED), bound, up=up)

    @staticmethod
    def _label(name: str) -> str:
        """A method in 2D, or a network's layers."""
        ndim, what = name[0], name.partition(" ")[2]
        return f"`{what}` in 2D" if what in CLASSIC else f"{ndim}-{what}-1"

    def facts(self, parts):
        found = [(name, part) for name, part in parts.items() if "fp" in part]
        told = "; ".join(f"{self._label(name)} {part['fp']:.2f} %" for name, part in found)
        missed = parts["2d occupancy"]
        return [
            f"False positives of all points: {told}.",
            f"False negatives of `occupancy`: {missed['fn']:,} of {missed['samples']:,} points; of all others none, and all are proven.",
        ]
