"""Pictures, and maps: ROS's ``.yaml`` and its picture, often ``.pgm``.

Pixels of a PNG are occupied by default where it is opaque, or by its grey values for a level.

A map's coordinates are x, to the right, and y, up: the first row of a file is at the top. Of a ROS map a cell is free
only where all versions of its map server agree that it is: ``occ < free_thresh``, as ROS 1 and most of ROS 2 have it;
from ``occ >= occupied_thresh`` on, as the newest of ROS 2 has it, a cell is occupied. What is between is unknown.
Pictures are opaque.

Sources: https://wiki.ros.org/map_server, nav2_map_server, the netpbm manual of pgm.
"""

import contextlib
import math
import re
import sys
import warnings
from pathlib import Path

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formats.arrays import Cells, Placement, Wanted
from warp_bounding.shapes.formats.reading import import_optional, reading

OPAQUE = 0.5  # alpha from here on is occupied
ALPHA_MODES = ("RGBA", "LA", "PA")
GREY_MODES = ("L", "I", "I;16", "I;16B", "F")  # one number a pixel, taken as it stands
WHICH = "say which grey values are occupied: level='<128' for dark ones, level='>=128' for bright ones"
KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale")
_BLANK = rb"(?:\s|#[^\n]*\n)+"
_PGM = re.compile(rb"P[25]" + _BLANK + rb"\d+" + _BLANK + rb"\d+" + _BLANK + rb"(\d+)\s")


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


def read_pgm(path: Path) -> np.ndarray:
    """Grey values ``(height, width)`` of a PGM file, plain (P2) or binary (P5), top row first: uint8, or of 16 bits."""
    header = _PGM.match(path.read_bytes())
    if header is None or int(header[1]) not in (255, 65535):
        raise ValueError("expected a PGM file, P2 or P5, whose white is 255 or 65535")
    with opened(path, ("PPM",)) as image:
        values = np.asarray(image)
    return values if values.dtype == np.uint8 else values.astype(np.uint16)


def read_ros_map(path: Path, wanted: Wanted) -> Cells:
    """A ROS map: the cells of the picture that its YAML file names, in metres.

    Raises ``ValueError`` for a key that is missing or means nothing, an origin that is turned, or a picture of another
    kind.
    """
    if wanted.level is not None:
        raise ShapeError(f"{path}: a map has thresholds of its own, got a level")
    fields = import_optional("yaml", "pyyaml", path).safe_load(path.read_text(encoding="utf-8-sig"))
    if not isinstance(fields, dict) or (missing := [key for key in KEYS if key not in fields]):
        raise ValueError(f"expected a ROS map with {', '.join(KEYS)}" + (f", got no {missing[0]}" if fields else ""))
    mode = fields.get("mode", MODES[0])
    if mode not in MODES:
        raise ValueError(f"expected mode {' or '.join(MODES)}, got {mode!r}; load its picture with a level")
    resolution, occupied, free = (_number(key, fields[key]) for key in ("resolution", "occupied_thresh", "free_thresh"))
    if not resolution > 0 or not 0 <= free <= occupied <= 1:
        got = f"{resolution}, {free}, {occupied}"
        raise ValueError(f"expected resolution > 0 and 0 <= free_thresh <= occupied_thresh <= 1, got {got}")
    if fields["negate"] not in (0, 1):
        raise ValueError(f"expected negate: 0 or 1, got {fields['negate']!r}")
    if not isinstance(fields["origin"], list) or len(fields["origin"]) != 3:
        raise ValueError(f"expected origin: [x, y, yaw], got {fields['origin']}")
    x, y, yaw = (_number("origin", word) for word in fields["origin"])
    if yaw:
        instead = "set yaw to 0, and place the bounder with xform="
        raise ShapeError(f"{path}: a map whose origin is turned (yaw {yaw:g}) is not read; {instead}")
    shade = _shades(path.parent / str(fields["image"]))
    occ = (255 * shade if fields["negate"] else 255 - 255 * shade) / 255.0
    full = occ >= occupied
    known = full | (occ < free)
    if mode == "scale":  # between the two its cells have a value, and are no more free than those above
        full |= occ >= free
        known |= full
    words = [f"ROS map, {mode}, x to the right, y up, metres", *wanted.count(int((~known & ~full).sum()))]
    words += [f"not read: {', '.join(others)}"] if (others := sorted(map(str, {*fields} - {*KEYS, "mode"}))) else []
    cells = (full | (~known & (wanted.unknown != "free")))[::-1].T
    return Cells(cells, path.name, "; ".join(words), Placement(resolution, (x, y), corner=True))


def _shades(path: Path) -> np.ndarray:
    """From 0, black, to 1, ``(height, width)``."""
    if not path.is_file():
        raise ShapeError(f"{path}: no such file, which the map names as its image")
    if path.suffix.lower() == ".pgm":
        with reading(path, "a PGM file"):
            values = read_pgm(path)
        return values / (255 if values.dtype == np.uint8 else 65535)
    with opened(path, None) as image:
        deep = image.tile and ";16" in str(image.tile[0][3])
        if deep or image.mode not in ("1", "L", "P", "RGB") or "transparency" in image.info:
            raise ValueError(f"expected an opaque picture of 8 bits in grey or colours, got mode {image.mode}")
        return np.asarray(image.convert("RGB")).astype(np.float64).mean(axis=2) / 255


def _number(key: str, word: object) -> float:
    try:
        value = float(word)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value) or isinstance(word, bool):
        raise ValueError(f"expected a number for {key}, got {word!r}")
    return value
