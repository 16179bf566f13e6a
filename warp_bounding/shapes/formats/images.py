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
import threading
from pathlib import Path

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.runtime.progress import silent_errors
from warp_bounding.shapes.formats.arrays import UNKNOWN, Cells, Placement, Wanted, check_cells
from warp_bounding.shapes.formats.reading import import_optional, reading

OPAQUE = 128  # alpha from here on, half of 255, is occupied
ALPHA_MODES = ("RGBA", "LA", "PA")
GREY_MODES = ("L", "I", "I;16", "I;16B", "F")  # one number a pixel, taken as it stands
WHICH = "say which grey values are occupied: level='<128' for dark ones, level='>=128' for bright ones"
PICTURES = ("PNG", "BMP", "JPEG", "GIF", "WEBP", "TIFF")  # by PIL's names
KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale")
ROWS = 256  # of a map, that are looked up at once: indices take eight times the memory of pixels
NETPBM = re.compile(rb"P([2356])" + 3 * rb"(?:\s|#[^\r\n]*[\r\n])+(\d+)")  # kind, width, height, white
_END = re.compile(rb"[ \t]|([ \t]*#[^\r\n]*)?\r?\n")  # of a header, before binary data
_pillow = threading.Lock()


@contextlib.contextmanager
def opened(path: Path, formats: tuple[str, ...] = PICTURES):
    """A picture that PIL reads, of one frame; raises ``ShapeError`` for anything else.

    The limit of pixels is ours, in place of PIL's, which is a number of its module: one picture is read at a time.
    """
    module = import_optional("PIL.Image", "pillow", path)
    with reading(path, f"a picture of {', '.join(formats)}"), _pillow, contextlib.ExitStack() as stack:
        stack.callback(setattr, module, "MAX_IMAGE_PIXELS", module.MAX_IMAGE_PIXELS)
        module.MAX_IMAGE_PIXELS = None
        with module.open(path, formats=formats) as whole:
            whole.verify()  # the checksums of a PNG, which PIL compares here only
        image = stack.enter_context(module.open(path, formats=formats))
        _check_frames(image, path)
        check_cells(image.size)
        if image.format == PICTURES[-1]:
            stack.enter_context(silent_errors())  # libtiff prints there what it does not know
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
        alpha = np.asarray(image.convert("RGBA").getchannel("A"))
    elif clear:
        raise ShapeError(f"{name}: a transparent colour is not read; give the picture an alpha channel")
    if alpha is None and not grey:
        raise ShapeError(f"{name}: expected an image with an alpha channel, got mode {image.mode} without; {WHICH}")
    if grey and alpha is not None and alpha.min() < 255:
        got = f"got {int((alpha < 255).sum())} that are not; without level what is opaque is occupied"
        raise ShapeError(f"{name}: expected opaque pixels for a level of their grey, {got}")
    if grey:
        return np.asarray(image if image.mode in GREY_MODES else image.convert("L"))
    return alpha >= OPAQUE


def read_netpbm(path: Path) -> np.ndarray:
    """Values of a PGM ``(height, width)`` or PPM ``(height, width, 3)``, top row first: uint8, or of 16 bits.

    Raises ``ValueError`` unless the file holds as many as its header says, and nothing else.
    """
    content = path.read_bytes()
    header = NETPBM.match(content)
    if header is None or int(header[4]) not in (255, 65535):
        raise ValueError("expected a PGM or PPM file, P2, P5, P3 or P6, whose white is 255 or 65535")
    colours, white = (3,) * (header[1] in b"36"), int(header[4])
    shape, kind = (int(header[3]), int(header[2])), np.dtype("u1" if white == 255 else ">u2")
    count, rest = check_cells(shape) * math.prod(colours), len(content) - header.end()
    if header[1] in b"56":
        begin = len(content) - count * kind.itemsize
        if not _END.fullmatch(content[header.end() : max(begin, 0)]):
            raise ValueError(f"expected the end of a line and {count * kind.itemsize} bytes after {white}, got {rest}")
        values = np.frombuffer(content, kind, count, begin)
    else:
        values = np.fromstring(re.sub(rb"#[^\n]*", b"", content[header.end() :]), np.int64, sep=" ")
        if len(values) != count or values.min() < 0 or values.max() > white:
            raise ValueError(f"expected {count} numbers from 0 to {white}, got {len(values)}")
    return values.reshape(*shape, *colours).astype(kind.newbyteorder("="), copy=False)


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
    values, white = _pixels_of(path.parent / str(fields["image"]))
    shade = np.arange(white + 1) / white  # of each value
    occ = (255 * shade if fields["negate"] else 255 - 255 * shade) / 255.0
    full = occ >= (occupied if mode == MODES[0] else free)  # between the two, cells of a scale are free no more
    unknown = ~full & (occ >= free)
    solid, unseen = full | (unknown & (wanted.unknown != UNKNOWN[1])), 0
    cells = np.empty(values.shape[1::-1], bool)
    for end in range(len(values), 0, -ROWS):
        rows = values[max(end - ROWS, 0) : end]
        if rows.ndim == 3:
            rows = rows[..., 0].astype(np.uint32) + rows[..., 1] + rows[..., 2]
        cells[:, len(values) - end :][:, : len(rows)] = np.take(solid, rows[::-1]).T
        unseen += np.count_nonzero(np.take(unknown, rows))
    words = [f"ROS map, {mode}, x to the right, y up, metres", *wanted.count(unseen)]
    words += [f"not read: {', '.join(others)}"] if (others := sorted(map(str, {*fields} - {*KEYS, "mode"}))) else []
    return Cells(cells, path.name, "; ".join(words), Placement(resolution, (x, y), corner=True))


def _pixels_of(path: Path) -> tuple[np.ndarray, int]:
    """Grey values ``(height, width)`` or three colours ``(height, width, 3)``; and the value, or sum, of white."""
    if not path.is_file():
        raise ShapeError(f"{path}: no such file, which the map names as its image")
    with path.open("rb") as file:
        netpbm = re.match(rb"P\d\s", file.read(3))
    with reading(path, "a PGM file") if netpbm else opened(path) as image:
        if netpbm:
            values = read_netpbm(path)
        elif ";16" in str(image.tile) or image.mode not in ("1", "L", "P", "RGB") or "transparency" in image.info:
            raise ValueError(f"expected an opaque picture of 8 bits in grey or colours, got mode {image.mode}")
        else:
            values = np.asarray(image.convert("L" if image.mode in ("1", "L") else "RGB"))
    return values, int(np.iinfo(values.dtype).max) * math.prod(values.shape[2:])


def _number(key: str, word: object) -> float:
    try:
        value = float(word)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value) or isinstance(word, bool):
        raise ValueError(f"expected a number for {key}, got {word!r}")
    return value
