"""Pages of panels with matplotlib, which is imported when something is drawn and needs no display.

Colours mean the same everywhere: the object is dark, what a bounder adds to it (false positives) has the method's tint,
what it denies of the object (false negatives) is red, and white is certainly empty. Of an object in 2D, coordinate 0 goes
to the right and coordinate 1 up, so that the paper's images stand upright.
"""

import io
from collections.abc import Callable
from typing import Any

import numpy as np

from warp_bounding.errors import BoundingError

__all__ = [
    "DENIED",
    "DPI",
    "INK",
    "METHODS",
    "NAMES",
    "OBJECT",
    "PALE",
    "SOLID",
    "bounded",
    "numbered",
    "page",
    "show",
    "tinted",
    "upright",
]

INK, PALE, OBJECT, SOLID, DENIED = "#22303c", "#dde2e6", "#34495e", "#7c93aa", "#e02f2f"
METHODS = {  # tints of methods, those of the rank plot
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
NAMES = {"occupancy": "occupancy (not conservative)"}  # of methods, where a name alone would mislead
DPI = 130
PALETTE = 256  # colours of a PNG


def page(draw: Callable[[Any], None], *, svg: bool = True, dpi: int = DPI) -> dict[str, bytes]:
    """Files of a figure, by their ending.

    Args:
        draw: Called with an empty ``matplotlib.figure.Figure``; sets its size and fills it.
        svg: Whether it is made of lines and text, so that an SVG of it is small.
        dpi: Pixels an inch, of the PNG and of pictures in the SVG.

    Raises:
        BoundingError: If matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BoundingError("figures need matplotlib: pip install 'warp-bounding[train]'") from error
    options = {"font.size": 9, "font.family": "DejaVu Sans", "svg.hashsalt": "figure", "text.color": INK}
    options |= {"axes.labelcolor": INK, "xtick.labelcolor": INK, "ytick.labelcolor": INK, "axes.edgecolor": PALE}
    options |= {"xtick.color": PALE, "ytick.color": PALE, "axes.titlecolor": INK, "image.interpolation": "nearest"}
    with matplotlib.rc_context(options):
        figure, files = Figure(), {}
        draw(figure)
        png = io.BytesIO()
        figure.savefig(png, format="png", dpi=dpi, metadata={"Software": None})
        files["png"] = with_palette(png.getvalue())
        if svg:
            text = io.BytesIO()
            figure.savefig(text, format="svg", dpi=dpi, metadata={"Date": None})
            files["svg"] = text.getvalue()
    return files


def with_palette(png: bytes, colours: int = PALETTE, width: int | None = None) -> bytes:
    """A PNG with a palette, a third of the size, and no wider than ``width`` pixels."""
    from PIL import Image

    image, small = Image.open(io.BytesIO(png)).convert("RGB"), io.BytesIO()
    if width is not None and image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    image.quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE).save(
        small, "png", optimize=True
    )
    return small.getvalue()


def _rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.uint8)


def bounded(inside: np.ndarray, maybe: np.ndarray | None, tint: str) -> np.ndarray:
    """``(H, W, 3)`` uint8: an object's raster, and what a bounder adds to it and denies of it; ``None``: the object alone."""
    maybe = inside if maybe is None else maybe
    image = np.full((*inside.shape, 3), 255, dtype=np.uint8)
    image[maybe & ~inside] = _rgb(tint)
    image[inside & maybe] = _rgb(OBJECT)
    image[inside & ~maybe] = _rgb(DENIED)
    return upright(image)


def tinted(shape: tuple[int, int], layers: dict[str, np.ndarray]) -> np.ndarray:
    """``(H, W, 3)`` uint8: masks over a raster in these colours, later ones over earlier ones."""
    image = np.full((*shape, 3), 255, dtype=np.uint8)
    for colour, mask in layers.items():
        image[mask] = _rgb(colour)
    return upright(image)


def upright(raster: np.ndarray) -> np.ndarray:
    """A raster over coordinates 0 and 1 as rows of a picture, from the top: coordinate 0 to the right, 1 up."""
    return np.rot90(raster)


def show(axes, image: np.ndarray, title: str = "", below: str = "") -> None:
    """A picture in a panel, with a title and a line below."""
    axes.imshow(image, extent=(0, 1, 1, 0), aspect=image.shape[0] / image.shape[1])
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title, fontsize=9, pad=4)
    axes.set_xlabel(below, fontsize=8, labelpad=3)


def numbered(part: dict[str, Any]) -> str:
    """Rates for below a panel."""
    text = f"FP {part['fp']:.2f} %"
    return f"{text}, FN {100 * part['fn'] / part['samples']:.2f} %" if part["fn"] else f"{text}, FN 0"
