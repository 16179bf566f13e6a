"""Pictures of bounds: rasters, pages of panels with matplotlib, and scenes in 3D with pyvista.

Colours mean the same everywhere: the object is dark, what a bounder adds to it (false positives) has the method's
tint, what it denies of the object (false negatives) is red, and white is certainly empty. Of an object in 2D,
coordinate 0 goes to the right and coordinate 1 up, so that the paper's images stand upright. A raster samples the
domain at the centres of even pixels, in as many dimensions as the object has; rates are measured elsewhere.
"""

import base64
import io
import json
import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.errors import BoundingError

INK, PALE, OBJECT, SOLID, DENIED = "#22303c", "#dde2e6", "#34495e", "#7c93aa", "#e02f2f"
TINTS = {  # of methods
    "aabb": "#4aa3df",
    "obb": "#1b5e9e",
    "sphere": "#8d9196",
    "ellipsoid": "#b9bdc2",
    "kdop": "#00a384",
    "learned-kdop": "#c05a9c",
    "mlp": "#f08a4b",
    "occupancy": "#d6a11d",
    "relu-field": "#d97bb6",
    "voxels": "#9a8fc0",
}
DPI, PALETTE = 130, 256  # pixels an inch; colours of a PNG

# --- rasters, and as JSON ---------------------------------------------------------------------------------------------


def raster(shape: Any, side: int, time: float | None = None) -> np.ndarray:
    """``(side, ..., side, n)`` float32: points on an even raster over a shape's domain, at a time if animated."""
    lower, upper = (np.asarray(x, dtype=np.float64)[int(time is not None) :] for x in (shape.lower, shape.upper))
    ticks = [low + (np.arange(side) + 0.5) / side * (high - low) for low, high in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
    if time is not None:
        points = np.concatenate([np.full((*points.shape[:-1], 1), time), points], axis=-1)
    return points.astype(np.float32)


def packed(owner: Any, points: np.ndarray) -> dict[str, Any]:
    """JSON of where a bounder says *maybe*, or where a shape is, at points ``(..., n)``."""
    flat, ask = points.reshape(-1, points.shape[-1]), getattr(owner, "query", None)
    found = ask(flat).numpy() if ask else owner.contains(flat.astype(np.float64))
    return pack(found.reshape(points.shape[:-1]))


def pack(mask: np.ndarray) -> dict[str, Any]:
    """A mask ``(...)`` bool as JSON: its shape, and its bits, compressed, as text."""
    bits = zlib.compress(np.packbits(np.asarray(mask, dtype=bool)).tobytes(), 9)
    return {"shape": list(mask.shape), "bits": base64.b64encode(bits).decode()}


def unpack(value: dict[str, Any]) -> np.ndarray:
    """Inverse of ``pack``."""
    bits = np.frombuffer(zlib.decompress(base64.b64decode(value["bits"])), np.uint8)
    return np.unpackbits(bits, count=int(np.prod(value["shape"]))).reshape(value["shape"]).astype(bool)


def picture(png: bytes) -> np.ndarray:
    """``(H, W, 3)`` uint8 of a PNG."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def rgb(colour: str) -> np.ndarray:
    """``(3,)`` uint8 of a colour."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.uint8)


def tinted(layers: dict[str, np.ndarray]) -> np.ndarray:
    """``(H, W, 3)`` uint8, upright: masks over a raster in these colours, later ones over earlier ones, on white."""
    image = np.full((*next(iter(layers.values())).shape, 3), 255, dtype=np.uint8)
    for colour, mask in layers.items():
        image[mask] = rgb(colour)
    return upright(image)


def bounded(inside: np.ndarray, maybe: np.ndarray, tint: str) -> np.ndarray:
    """``(H, W, 3)`` uint8: an object's raster, and what a bounder adds to it and denies of it."""
    return tinted({tint: maybe & ~inside, OBJECT: inside & maybe, DENIED: inside & ~maybe})


def upright(image: np.ndarray) -> np.ndarray:
    """A raster over coordinates 0 and 1 as rows of a picture, from the top: coordinate 0 to the right, 1 up."""
    return np.rot90(image)


# --- pages of panels --------------------------------------------------------------------------------------------------


def page_of(draw: Callable[[Any], None], *, svg: bool = True) -> dict[str, bytes]:
    """Files of a figure, by their ending; the same drawing makes the same files.

    ``draw`` sets the size of an empty ``matplotlib.figure.Figure`` and fills it; one of lines and text is also an SVG.
    """
    import matplotlib
    from matplotlib.figure import Figure

    options = {"font.size": 9, "font.family": "DejaVu Sans", "svg.hashsalt": "figure", "text.color": INK}
    options |= {"axes.titlesize": 9, "axes.labelsize": 8, "xtick.labelsize": 8, "ytick.labelsize": 8}
    options |= {"axes.labelcolor": INK, "xtick.labelcolor": INK, "ytick.labelcolor": INK, "axes.edgecolor": PALE}
    options |= {"xtick.color": PALE, "ytick.color": PALE, "axes.titlecolor": INK, "image.interpolation": "nearest"}
    with matplotlib.rc_context(options):
        figure, png, text = Figure(), io.BytesIO(), io.BytesIO()
        draw(figure)
        figure.savefig(png, format="png", dpi=DPI, metadata={"Software": None})
        if svg:
            figure.savefig(text, format="svg", dpi=DPI, metadata={"Date": None})
    return {"png": with_palette(png.getvalue())} | ({"svg": text.getvalue()} if svg else {})


class Panel(NamedTuple):
    """A picture with a title, a line below, and one at the left side."""

    image: np.ndarray
    title: str = ""
    below: str = ""
    framed: bool = True
    side: str = ""

    def __call__(self, axes: Any) -> None:
        image = self.image
        axes.imshow(image, extent=(0, 1, 1, 0), aspect=image.shape[0] / image.shape[1])
        axes.set(xticks=[], yticks=[])
        axes.set_title(self.title, fontsize=9, pad=4)
        axes.set_xlabel(self.below, fontsize=8, labelpad=3)
        axes.set_ylabel(self.side, fontsize=9)
        axes.spines[:].set_visible(self.framed)


def grid(rows: Sequence[Sequence[Callable[[Any], None]]], *, svg: bool = True, inch: float = 1.8, legend: bool = False):
    """Files of a page of rows of panels, or of other functions that fill axes, each so many inches wide."""

    def fill(figure: Any) -> None:
        heights = [max(_height(panel, inch) for panel in row) for row in rows]
        columns, ratios = max(map(len, rows)), [height + 0.42 / inch for height in heights]
        figure.set_size_inches(inch * columns, inch * sum(ratios) + 0.4 * legend)
        figure.set_layout_engine("constrained", w_pad=0.03, h_pad=0.03)
        panels = figure.subplots(len(rows), columns, squeeze=False, gridspec_kw={"height_ratios": ratios})
        for line, row in zip(panels, rows, strict=True):
            for axes in line[len(row) :]:
                axes.set_axis_off()
            for axes, panel in zip(line, row, strict=False):
                panel(axes)
        if legend:
            handles = panels[0, 0].get_legend_handles_labels()
            figure.legend(*handles, frameon=False, fontsize=8, loc="outside lower center", ncols=2)

    return page_of(fill, svg=svg)


def _height(panel: Any, inch: float) -> float:
    """The height of a panel, as a share of its width. Axes that are not panels need room for ticks and labels."""
    return panel.image.shape[0] / panel.image.shape[1] if isinstance(panel, Panel) else 0.85 + 0.5 / inch


def with_palette(png: bytes, width: int | None = None) -> bytes:
    """A PNG with a palette, a third of the size, and no wider than ``width`` pixels."""
    from PIL import Image

    image, small = Image.open(io.BytesIO(png)).convert("RGB"), io.BytesIO()
    if width is not None and image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    image = image.quantize(PALETTE, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    image.save(small, "png", optimize=True)
    return small.getvalue()


def numbered(part: dict[str, Any]) -> str:
    """Rates for below a panel."""
    text = f"FP {part['fp']:.2f} %"
    return f"{text}, FN {100 * part['fn'] / part['samples']:.2f} %" if part["fn"] else f"{text}, FN 0"


# --- scenes in 3D -----------------------------------------------------------------------------------------------------

SMOOTHING = 0.9  # standard deviation, in pixels of the raster, of what takes the steps out of an isosurface
VIEW = (1.15, 1.5, 0.8)  # towards the camera: along the two axes after the one that is up, and along this
ANGLE, PIXELS = 30.0, 300  # degrees of the view; side of a picture
DOMAIN_RADIUS = 0.8  # of what is shown of the domain, in its sides: a little less than to its corners
BATCH = 15  # scenes that one process draws


def layer(mask: dict[str, Any], colour: str, opacity: float = 1.0, *, smooth: bool = False) -> dict[str, Any]:
    """A layer of a scene: a packed mask ``(X, Y, Z)`` over the domain, as an isosurface or as whole cells."""
    return {"mask": mask, "colour": colour, "opacity": opacity, "smooth": smooth}


def scene(
    *layers: dict[str, Any], up: Sequence[int] = (0, 0, 1), around: dict[str, Any] | None = None
) -> dict[str, Any]:
    """A scene, with the direction that is up, and the packed mask whose box fills the view; the domain if ``None``."""
    middle, radius = [0.5, 0.5, 0.5], DOMAIN_RADIUS
    if around is not None:
        inside = unpack(around)
        places = np.argwhere(inside) / np.array(inside.shape)
        low, high = places.min(axis=0), places.max(axis=0) + 1 / np.array(inside.shape)
        middle, radius = ((low + high) / 2).tolist(), float(np.linalg.norm(high - low)) / 2
    return {"layers": list(layers), "up": list(up), "middle": middle, "radius": radius}


def images(scenes: dict[str, dict[str, Any]]) -> dict[str, np.ndarray]:
    """``(H, W, 3)`` uint8 pictures of scenes, by their names; ``BoundingError`` if there is nothing to draw with."""
    from sims.drawing import draw_with

    names, found = list(scenes), {}
    for start in range(0, len(names), BATCH):
        own = names[start : start + BATCH]
        with tempfile.TemporaryDirectory() as folder:
            drawn = draw_with(__name__, Path(folder), {"scenes": np.array(json.dumps([scenes[name] for name in own]))})
            if len(drawn.paths) != len(own):
                raise BoundingError(drawn.problem)
            found |= {name: picture(path.read_bytes()) for name, path in zip(own, drawn.paths, strict=True)}
    return found


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Write ``0000.png``, ... into a folder: a picture of each scene; ``data["scenes"]`` is their JSON."""
    import pyvista

    for number, each in enumerate(json.loads(str(data["scenes"]))):
        plotter = pyvista.Plotter(off_screen=True, window_size=(PIXELS, PIXELS), border=False)
        plotter.set_background("white")
        for one in each["layers"]:
            surface = _surface(unpack(one["mask"]), one["smooth"])
            if surface is not None and surface.n_cells:
                light = {"ambient": 0.25, "diffuse": 0.75, "specular": 0.1, "smooth_shading": one["smooth"]}
                plotter.add_mesh(surface, color=one["colour"], opacity=one["opacity"], **light)
        plotter.enable_anti_aliasing("ssaa")
        up = np.array(each["up"], dtype=float)
        view = VIEW[0] * np.roll(np.abs(up), 1) + VIEW[1] * np.roll(np.abs(up), 2) + VIEW[2] * up
        middle, distance = np.array(each["middle"]), each["radius"] / np.sin(np.radians(ANGLE) / 2)
        plotter.camera.focal_point = tuple(middle)
        plotter.camera.position = tuple(middle + distance * view / np.linalg.norm(view))
        plotter.camera.up, plotter.camera.view_angle = tuple(up), ANGLE
        plotter.screenshot(str(folder / f"{number:04}.png"))
        plotter.close()


def _surface(mask: np.ndarray, smooth: bool):
    """The surface of a mask, in the unit cube; ``None`` if it is empty."""
    import pyvista
    from scipy.ndimage import gaussian_filter

    if not mask.any():
        return None
    size = 1.0 / np.array(mask.shape)
    if not smooth:
        cells = pyvista.ImageData(dimensions=np.array(mask.shape) + 1, spacing=size)
        cells.cell_data["inside"] = mask.ravel(order="F").astype(np.uint8)
        return cells.threshold(0.5, scalars="inside").extract_surface(algorithm="dataset_surface")
    padded = gaussian_filter(np.pad(mask, 2).astype(np.float32), SMOOTHING)
    points = pyvista.ImageData(dimensions=padded.shape, spacing=size, origin=-1.5 * size)
    points.point_data["inside"] = padded.ravel(order="F")
    return points.contour([0.5], scalars="inside").compute_normals(auto_orient_normals=True, split_vertices=False)
