"""Maps: ROS's ``.yaml`` and its picture, ``.pgm``, and the grids of Moving AI's benchmarks (``.map``).

A map's coordinates are x, to the right, and y, up: the first row of a file is at the top. Of a ROS map a cell is free
only where all versions of its map server agree that it is: ``occ < free_thresh``, as ROS 1 and most of ROS 2 have it;
from ``occ >= occupied_thresh`` on, as the newest of ROS 2 has it, a cell is occupied. What is between is unknown.
Pixels that are not opaque are unknown, too.

Sources: https://wiki.ros.org/map_server, nav2_map_server, https://movingai.com/benchmarks/formats.html, the netpbm
    manual of pgm.
"""

import math
import re
from pathlib import Path

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.shapes.formats.arrays import Cells, Placement, Wanted
from warp_bounding.shapes.formats.images import alpha_of, opened
from warp_bounding.shapes.formats.reading import reading
from warp_bounding.shapes.shape import MAX_CELLS

__all__ = ["read_movingai", "read_pgm", "read_ros_map"]

PASSABLE, BLOCKED = ".GS", "@OTW"  # characters of .map: W, water, cannot be entered from the ground
TILES = ("octile", "tile", "octile_unicost")
KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale", "raw")
PERCENT = 100  # the largest value of a raw map; above it a cell is unknown
_TOKENS = re.compile(rb"(?:\s|#[^\n\r]*[\n\r])*([^\s#]+)")
_LINE = re.compile(r"([A-Za-z_][\w-]*)\s*:(?:\s+(.*))?$")


def read_pgm(path: Path) -> tuple[np.ndarray, int]:
    """Grey values ``(height, width)`` of a PGM file, plain (P2) or binary (P5), top row first, and its white."""
    content = path.read_bytes()
    kind, found, position = content[:2], [], 2
    if kind not in (b"P2", b"P5"):
        raise ValueError(f"expected a PGM file that begins with P2 or P5, got {kind!r}")
    while len(found) < 3:
        token = _TOKENS.match(content, position)
        if token is None or not token[1].isdigit():
            raise ValueError(f"expected width, height and white in the PGM header, got {found}")
        found, position = [*found, int(token[1])], token.end()
    width, height, white = found
    if not (width > 0 and height > 0 and 0 < white < 65536 and width * height <= MAX_CELLS):
        raise ValueError(f"expected a PGM size and white from 1 to 65535, got {found}")
    if kind == b"P5":
        if not content[position : position + 1].isspace():
            raise ValueError(f"expected one blank after the PGM header, got {content[position : position + 1]!r}")
        kept = np.dtype(np.uint8 if white < 256 else ">u2")
        there, needed = len(content) - position - 1, width * height * kept.itemsize
        if there != needed:
            raise ValueError(f"expected one picture of {width} x {height}, {needed} bytes, got {there}")
        values = np.frombuffer(content, kept, offset=position + 1).astype(np.uint16)
    else:
        if not content[-1:].isspace():
            raise ValueError("expected a blank after the last grey value, got the end: the file may be cut off")
        words = re.sub(rb"#[^\n\r]*", b" ", content[position:]).split()
        if len(words) != width * height or not all(word.isdigit() for word in words):
            raise ValueError(f"expected {width * height} grey values of {width} x {height}, got {len(words)}")
        values = np.array([min(int(word), 65535) for word in words], dtype=np.uint16)
    if int(values.max()) > white:
        raise ValueError(f"expected grey values up to {white}, got {int(values.max())}")
    return values.reshape(height, width), white


def read_ros_map(path: Path, wanted: Wanted) -> Cells:
    """A ROS map: the cells of the picture that its YAML file names, in metres.

    Raises ``ValueError`` for a key that is missing or means nothing, an origin that is turned, or a picture of another
    kind.
    """
    fields = _fields(path)
    if missing := [key for key in KEYS if key not in fields]:
        raise ValueError(f"expected a ROS map with {', '.join(KEYS)}, got none of {', '.join(missing)}")
    mode = fields.get("mode", MODES[0])
    if mode not in MODES:
        raise ValueError(f"expected mode {', '.join(MODES)}, got {mode!r}")
    resolution, occupied, free = (_number(key, fields[key]) for key in ("resolution", "occupied_thresh", "free_thresh"))
    if not resolution > 0 or not 0 <= free <= occupied <= 1:
        raise ValueError(
            f"expected resolution > 0 and 0 <= free_thresh <= occupied_thresh <= 1, got {resolution}, {free}, "
            f"{occupied}"
        )
    negate = {"0": False, "false": False, "1": True, "true": True}.get(str(fields["negate"]).lower())
    if negate is None:
        raise ValueError(f"expected negate: 0 or 1, got {fields['negate']!r}")
    origin = fields["origin"] if isinstance(fields["origin"], list) else [fields["origin"]]
    if len(origin) != 3:
        raise ValueError(f"expected origin: [x, y, yaw], got {origin}")
    x, y, yaw = (_number("origin", word) for word in origin)
    if yaw:
        raise ShapeError(
            f"{path}: a map whose origin is turned (yaw {yaw:g}) is not read; set yaw to 0, and place the bounder with "
            "xform="
        )
    if (mode == MODES[2]) != (wanted.level is not None):
        raise ShapeError(
            f"{path}: level is for maps of mode raw, which need one, such as level='>=65'; got mode {mode}"
            f"{'' if wanted.level is None else ' and a level'}"
        )
    if mode == MODES[2] and negate:
        raise ShapeError(f"{path}: negate in mode raw means one thing in ROS 1 and another in ROS 2, and is not read")
    shade, opaque = _shades(path.parent / str(fields["image"]), trinary=mode == MODES[0])
    if mode == MODES[2]:
        value = np.rint(255 * shade)
        full = (value <= PERCENT) & wanted.level(value)
        known = full | ((value <= PERCENT) & opaque)
    else:
        occ = (255 * shade if negate else 255 - 255 * shade) / 255.0
        full = occ >= occupied
        known = full | ((occ < free) & opaque)
        if mode == MODES[1]:  # between the two its cells have a value, and are no more free than those above
            full |= (occ >= free) & opaque
            known |= full
    words = [f"ROS map, {mode}, x to the right, y up, metres", *wanted.count(int((~known & ~full).sum()))]
    words += [f"not read: {', '.join(others)}"] if (others := sorted(set(fields) - {*KEYS, "mode"})) else []
    cells = (full | (~known & (wanted.unknown != "free")))[::-1].T
    return Cells(cells, path.name, "; ".join(words), Placement(resolution, (x, y), corner=True))


def _shades(path: Path, *, trinary: bool) -> tuple[np.ndarray, np.ndarray]:
    """From 0, black, to 1; and where pixels are opaque.

    The alpha channel counts as a colour where a map is trinary, as in ROS.
    """
    if not path.is_file():
        raise ShapeError(f"{path}: no such file, which the map names as its image")
    if path.suffix.lower() == ".pgm":
        with reading(path, "a PGM file"):
            values, white = read_pgm(path)
        return values / white, np.ones(values.shape, dtype=bool)
    with opened(path, None) as image:
        deep = image.mode.startswith("I;16")
        if not deep and image.tile and ";16" in str(image.tile[0][3]):
            raise ShapeError(f"{path}: colours of 16 bits are not read in a map; save them with 8 bits, or as grey")
        if not deep and image.mode not in ("1", "L", "P", "LA", "PA", "RGB", "RGBA"):
            raise ValueError(f"expected a picture in grey or colours, got mode {image.mode}")
        alpha, white = alpha_of(image, path), 65535 if deep else 255
        values = np.asarray(image)[..., None] if deep else np.asarray(image.convert("RGBA"))[..., :3]
        values = values.astype(np.float64).mean(axis=2)
    if alpha is None:
        return values / white, np.ones(values.shape, dtype=bool)
    return ((3 * values + white // 255 * alpha.astype(np.float64)) / 4 if trinary else values) / white, alpha == 255


def read_movingai(path: Path) -> Cells:
    """A map of Moving AI's benchmarks: cells of size 1, their centres on whole numbers."""
    lines = path.read_bytes().decode("ascii").replace("\r\n", "\n").rstrip("\n").split("\n")
    head = dict(words for line in lines[:3] if len(words := line.split()) == 2)
    tiles, sizes = head.get("type"), [head.get(key, "") for key in ("width", "height")]
    if lines[3:4] != ["map"] or tiles not in TILES or not all(size.isdigit() and int(size) > 0 for size in sizes):
        raise ValueError(f"expected the lines 'type octile', 'height', 'width' and 'map', got {lines[:4]}")
    width, height = map(int, sizes)
    rows = lines[4:]
    lengths = sorted({len(row) for row in rows})
    if len(rows) != height or lengths != [width]:
        raise ValueError(f"expected {height} rows of {width} characters, got {len(rows)} of {lengths}")
    letters = np.frombuffer("".join(rows).encode(), dtype="S1").reshape(height, width)
    found = {letter.decode() for letter in np.unique(letters)}
    if unknown := found - {*PASSABLE, *BLOCKED}:
        raise ValueError(f"expected characters {PASSABLE} and {BLOCKED}, got {''.join(sorted(unknown))!r}")
    reported = {"S": "S, swamp, counts as free", "W": "W, water, counts as occupied"}
    words = [
        "x to the right, y up, the file's first row at the top",
        *(reported[letter] for letter in sorted(found & set(reported))),
    ]
    cells = np.isin(letters, [letter.encode() for letter in BLOCKED])[::-1].T
    return Cells(cells, path.name, "; ".join(words), spacing=1.0)


def _number(key: str, word) -> float:
    try:
        value = math.nan if "_" in word else float(word)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"expected a number for {key}, got {word!r}")
    return value


def _fields(path: Path) -> dict[str, str | list[str]]:
    """The keys of a YAML file that is a table of words, numbers and lists of them; anything else is refused."""
    text = path.read_text(encoding="utf-8-sig")
    found: dict[str, str | list[str]] = {}
    key, open_ = None, ""
    for number, line in enumerate(text.splitlines(), 1):
        line = re.sub(r"(^|\s)#.*", "", line).rstrip()
        if not line.strip() or (line == "---" and not found):
            continue
        own = _LINE.match(line)
        if open_:
            open_ += " " + line.strip()
        elif own and own[1] not in found:
            key, open_ = own[1], (own[2] or "").strip()
            found[key] = []
        elif key is not None and isinstance(found[key], list) and (item := re.match(r"\s*-\s+(\S+)$", line)):
            found[key].append(_unquoted(item[1]))
            continue
        elif own:
            raise ShapeError(f"{path}: line {number} gives {own[1]} a second time")
        else:
            raise ShapeError(f"{path}: line {number}: expected 'key: value' or '- number', got {line.strip()[:60]!r}")
        if open_.startswith("["):
            if open_.endswith("]"):
                found[key], open_ = [_unquoted(word) for word in open_[1:-1].split(",")], ""
        elif open_:
            if open_[0] in "{|>&*!":
                raise ShapeError(
                    f"{path}: line {number}: expected {key} as a word, a number or a list of them, got {open_[:60]!r}"
                )
            found[key], open_ = _unquoted(open_), ""
    if open_:
        raise ShapeError(f"{path}: the list of {key} has no end")
    return found


def _unquoted(word: str) -> str:
    word = word.strip()
    return word[1:-1] if len(word) > 1 and word[0] == word[-1] and word[0] in "'\"" else word
