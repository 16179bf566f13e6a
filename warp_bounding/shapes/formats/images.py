"""Pixels of a PNG: by default where it is opaque, or its grey values for a level."""

import contextlib
import sys
import warnings
from pathlib import Path

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formats.reading import import_optional, reading

OPAQUE = 0.5  # alpha from here on is occupied
ALPHA_MODES = ("RGBA", "LA", "PA")
GREY_MODES = ("L", "I", "I;16", "I;16B", "F")  # one number a pixel, taken as it stands
WHICH = "say which grey values are occupied: level='<128' for dark ones, level='>=128' for bright ones"


@contextlib.contextmanager
def opened(path: Path, formats: tuple[str, ...] | None):
    """A picture that PIL reads, of one frame; raises ``ShapeError`` for anything else."""
    image_module = import_optional("PIL.Image", "pillow", path)
    what = f"a {formats[0]} image" if formats else "a picture"
    with reading(path, what), warnings.catch_warnings():
        warnings.simplefilter("error", image_module.DecompressionBombWarning)
        with image_module.open(path, formats=formats) as image:
            _check_frames(image, path)
            yield image


def image_from(source: object, *, grey: bool) -> np.ndarray | None:
    """The pixels of a picture that is given as PIL's object, as ``read_png`` has them; ``None`` for anything else."""
    module = sys.modules.get("PIL.Image")
    if module is None or not isinstance(source, module.Image):
        return None
    with reading("image", "a picture"):
        _check_frames(source, "image")
        return _pixels(source, "image", grey=grey)


def _check_frames(image, name) -> None:
    if getattr(image, "n_frames", 1) != 1:
        raise ShapeError(f"{name}: expected one picture, got an animation of {image.n_frames}")


def read_png(path: Path, *, grey: bool) -> np.ndarray:
    """Read a picture ``(height, width)``; coordinate 0 is the row, from the top.

    Bool, where alpha is at least one half; or, if ``grey`` is asked for, 0 (black) to 255, or to 65,535 in a file of 16
    bits. Colours count by their luma (ITU-R 601).
    """
    with opened(path, ("PNG",)) as image:
        return _pixels(image, path, grey=grey)


def _pixels(image, name, *, grey: bool) -> np.ndarray:
    """See ``read_png``.

    A PNG file may name one colour that is transparent, in its own bits, of which PIL keeps other ones: it is refused.
    """
    image.load()
    alpha, clear = None, "transparency" in image.info
    if image.mode in ALPHA_MODES or (image.mode == "P" and (clear or image.palette.mode == "RGBA")):
        alpha = np.asarray(image.convert("RGBA"))[..., 3]
    elif clear:
        raise ShapeError(f"{name}: a transparent colour is not read; give the picture an alpha channel")
    if alpha is None and not grey:
        raise ShapeError(f"{name}: expected an image with an alpha channel, got mode {image.mode} without; {WHICH}")
    if grey and alpha is not None and alpha.min() < 255:
        got = f"got {int((alpha < 255).sum())} that are not; without level what is opaque is occupied"
        raise ShapeError(f"{name}: expected opaque pixels for a level of their grey, {got}")
    if grey:
        return np.asarray(image if image.mode in GREY_MODES else image.convert("L"))
    return alpha / 255.0 >= OPAQUE
