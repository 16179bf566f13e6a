"""A file for each row of the table of formats that is about images, maps, voxels and arrays, and about where shapes
lie."""

import io
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from format_cases import Case, T, V, file
from PIL import Image

from warp_bounding.shapes import load_shape

BITS = np.zeros((4, 6), bool)
BITS[1:3, 2:4] = True
GREY = np.where(BITS, 0, 254).astype(np.uint8)


def cells(expected: np.ndarray, where: Callable | None = None) -> Callable:
    """Check that exactly these cells are occupied."""

    def check(shape) -> None:
        local = getattr(shape, "local", shape)
        np.testing.assert_array_equal(local.occupancy, expected)
        if where is not None:
            where(shape)

    return check


def at(lower, upper) -> Callable:
    """Check for the corners of the domain, to what float64 rounds."""

    def check(shape) -> None:
        np.testing.assert_allclose([shape.lower, shape.upper], [lower, upper], rtol=1e-12, atol=1e-12)

    return check


def case(write, words="", check=lambda shape: None, **options) -> Case:
    return Case(write, words, check, partial(load_shape, **options))


def png(values, mode=None, **options) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        picture = values if isinstance(values, Image.Image) else Image.fromarray(np.asarray(values), mode)
        picture.save(folder / "a.png", **options)
        return folder / "a.png"

    return write


def palette() -> Image.Image:
    picture = Image.fromarray(np.where(BITS, 3, 5).astype(np.uint8))
    picture.putpalette(list(range(256)) * 3)
    return picture


def png_cut(folder: Path) -> Path:
    path = png(GREY)(folder)
    path.write_bytes(path.read_bytes()[:-30])
    return path


def clear_png(bits: int, kind: int, clear: list[int], row) -> bytes:
    """A picture of two pixels in a row, with a transparent colour, which PIL does not write in these bits."""

    def chunk(key: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + key + data + zlib.crc32(key + data).to_bytes(4, "big")

    row = row if isinstance(row, bytes) else np.array(row, ">u2").tobytes()
    head = np.array([2, 1], ">u4").tobytes() + bytes([bits, kind, 0, 0, 0])
    parts = [
        (b"IHDR", head),
        (b"tRNS", np.array(clear, ">u2").tobytes()),
        (b"IDAT", zlib.compress(b"\0" + row)),
        (b"IEND", b""),
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


RGBA = np.stack([GREY, GREY, GREY, np.where(BITS, 128, 127).astype(np.uint8)], axis=2)
PNG = {
    "png/alpha": case(png(RGBA), check=cells(BITS)),
    "png/transparent-colour": case(png(palette(), transparency=5), check=cells(BITS)),
    "png/transparent-grey": case(file("a.png", clear_png(16, 0, [60001], [[60001, 60000]])), check=cells([[False,
        True]])),
    "png/transparent-grey-of-2-bits": case(file("a.png", clear_png(2, 0, [3], b"\xe0")), check=cells([[False, True]])),
    "png/transparent-colour-of-16-bits": case(file("a.png", clear_png(16, 2, [9, 9, 60001], [[9, 9, 60001] * 2])),
        "16 bits"),
    "png/transparent-16-bits-with-level": case(file("a.png", clear_png(16, 0, [0], [[0, 1000]])), "1 that are not",
        level="<500"),
    "png/grey": case(png(GREY), check=cells(BITS), level="<128"),
    "png/colours": case(png(RGBA[..., :3]), check=cells(BITS), level="<128"),
    "png/palette": case(png(palette()), check=cells(BITS), level="<13"),
    "png/16-bits": case(png(np.where(BITS, 300, 299).astype(np.uint16)), check=cells(BITS), level=">=300"),
    "png/1-bit": case(png(Image.fromarray(BITS)), check=cells(BITS), level=">=128"),
    "png/no-level": case(png(GREY), "level='<128'"),
    "png/grey-of-transparent": case(png(RGBA), "opaque pixels", level="<128"),
    "png/animation": case(png(Image.fromarray(GREY), save_all=True, append_images=[Image.fromarray(254 - GREY)]),
        "animation", level="<9"),
    "png/cut": case(png_cut, "cannot be read", level="<128"),
    "png/nothing": case(png(np.full((4, 4), 254, np.uint8)), "all 16 cells are empty", level="<128"),
}  # fmt: skip


def pgm(values: np.ndarray, kind: str = "P5", white: int = 255, comment: str = "") -> bytes:
    head = f"{kind}\n{comment}{values.shape[1]} {values.shape[0]}\n{white}\n".encode()
    data = values.astype(np.uint8 if white < 256 else ">u2").tobytes()
    return head + (data if kind == "P5" else (" ".join(map(str, values.ravel())) + "\n").encode())


DEEP = np.where(BITS, 40000, 50000)
PGM = {
    "pgm/binary": case(file("a.pgm", pgm(GREY)), check=cells(BITS), level="<128"),
    "pgm/text": case(file("a.pgm", pgm(GREY, "P2")), check=cells(BITS), level="<128"),
    "pgm/comments": case(file("a.pgm", pgm(GREY, comment="# of me\n# 9 9\n")), check=cells(BITS), level="<128"),
    "pgm/16-bits": case(file("a.pgm", pgm(DEEP, white=65535)), check=cells(BITS), level="<45000"),
    "pgm/other-white": case(file("a.pgm", pgm(np.where(BITS, 1, 7), white=7)), check=cells(BITS), level="<4"),
    "pgm/no-level": case(file("a.pgm", pgm(BITS.astype(np.uint8), white=1)), "level"),
    "pgm/cut": case(file("a.pgm", pgm(GREY)[:-1]), "24 bytes, got 23", level="<128"),
    "pgm/text-cut": case(file("a.pgm", pgm(GREY, "P2")[:-2]), "cut off", level="<128"),
    "pgm/several-pictures": case(file("a.pgm", 2 * pgm(GREY)), "one picture", level="<128"),
    "pgm/above-white": case(file("a.pgm", pgm(GREY, white=200)), "grey values up to 200", level="<128"),
    "pgm/other-kinds": case(file("a.pgm", b"P6" + pgm(GREY)[2:]), "P2 or P5", level="<128"),
}  # fmt: skip


def ros(
    picture=None,
    name="m.pgm",
    origin="[-2.03, -3.11, 0.0]",
    negate="0",
    thresholds=(0.65, 0.196),
    more="",
    drop="",
    resolution=0.05,
):
    """Writes a map, by default of cells of 5 cm."""
    lines = [f"image: {name}", f"resolution: {resolution}", f"origin: {origin}", f"negate: {negate}"]
    lines += [f"occupied_thresh: {thresholds[0]}", f"free_thresh: {thresholds[1]}", *more.split("\n")]

    def write(folder: Path) -> Path:
        if name.endswith(".pgm"):
            (folder / name).write_bytes(pgm(GREY if picture is None else picture))
        elif isinstance(picture, bytes):
            (folder / name).write_bytes(picture)
        elif picture is not None:
            picture.save(folder / name)
        (folder / "m.yaml").write_text(
            "\n".join(line for line in lines if not drop or not line.startswith(drop)) + "\n"
        )
        return folder / "m.yaml"

    return write


def told(words: str, expected=BITS, where=None) -> dict:
    """What a map's message says, and its cells: x to the right, y up."""
    return {"words": words, "check": cells(np.asarray(expected)[::-1].T, where)}


UNSEEN = np.where(BITS, 0, 205).astype(np.uint8)
UNSEEN[:, 0] = 254
SEEN = np.ones_like(BITS)
SEEN[:, 0] = False
HALVES = np.where(BITS, 0, 200).astype(np.uint8)
HALVES[:, 0] = 254
PERCENT = np.where(BITS, 65, 64).astype(np.uint8)
BEYOND = np.where(BITS, 65, 64).astype(np.uint8)
BEYOND[0, :2] = 101, 255
CLEAR = Image.fromarray(np.stack([GREY, GREY, GREY, np.where(BITS, 128, 255).astype(np.uint8)], axis=2))
BACK = """image: "m.pgm" # here
resolution: 5e-2
origin:
  - -2.03
  - -3.11
  - 0
negate: false
occupied_thresh: .65
free_thresh: 0.196
"""


def blocks(folder: Path) -> Path:
    path = ros()(folder)
    path.write_text("---\n" + BACK)
    return path


PLACE = at([-2.03, -3.11], [-2.03 + 6 * 0.05, -3.11 + 4 * 0.05])
ROS = {
    "ros/place": case(ros(), **told("x to the right, y up, metres", where=PLACE)),
    "ros/lattice": case(ros(origin="[-10, -5.5, 0]"), **told("metres", where=at([-10, -5.5], [-9.7, -5.3]))),
    "ros/survey": case(ros(origin="[500000.13, 4649776.37, 0]"), **told("metres")),
    "ros/yaml": case(blocks, **told("metres", where=PLACE)),
    "ros/negate": case(ros(254 - GREY, negate="1"), **told("metres")),
    "ros/pictures": case(ros(Image.fromarray(GREY), "m.png"), **told("metres")),
    "ros/alpha": case(ros(CLEAR, "m.png"), **told("metres")),
    "ros/transparent-grey": case(ros(clear_png(16, 0, [65535], [[65535, 65534]]), "m.png"),
        **told("1 unknown cells count as occupied", [[1, 0]])),
    "ros/colours-of-16-bits": case(ros(clear_png(16, 2, [1, 2, 3], [[9] * 6]), "m.png"), "16 bits"),
    "ros/unknown": case(ros(UNSEEN), **told("unknown cells count as occupied", SEEN)),
    "ros/unknown-free": case(ros(UNSEEN), **told("unknown cells count as free"), unknown="free"),
    "ros/scale": case(ros(HALVES, more="mode: scale"), **told("scale", SEEN), unknown="free"),
    "ros/raw": case(ros(PERCENT, more="mode: raw"), **told("raw"), level=">=65"),
    "ros/raw-unknown": case(ros(BEYOND, more="mode: raw"), **told("2 unknown cells count as occupied", BEYOND > 64),
        level=">=65"),
    "ros/raw-unknown-free": case(ros(BEYOND, more="mode: raw"), **told("2 unknown cells count as free"), level=">=65",
        unknown="free"),
    "ros/raw-without-level": case(ros(PERCENT, more="mode: raw"), "level='>=65'"),
    "ros/raw-negated": case(ros(PERCENT, negate="1", more="mode: raw"), "negate in mode raw", level=">=65"),
    "ros/other-keys": case(ros(more="author: me"), **told("not read: author")),
    "ros/number-with-underscore": case(ros(origin="[1_0, 0, 0]"), "expected a number for origin, got '1_0'"),
    "ros/turned": case(ros(origin="[0, 0, 0.3]"), "turned (yaw 0.3)"),
    "ros/no-picture": case(ros(name="gone.png"), "no such file"),
    "ros/missing-keys": case(ros(drop="origin"), "got none of origin"),
    "ros/thresholds": case(ros(thresholds=(0.1, 0.9)), "free_thresh <= occupied_thresh"),
    "ros/other-yaml": case(ros(more="nested: {a: 1}"), "line 7"),
    "ros/own-place": case(ros(), "its own resolution", spacing=1.0),
}  # fmt: skip
TILES = "type octile\nheight 2\nwidth 3\nmap\n{}"
MOVINGAI = {
    "map/place": case(file("a.map", TILES.format("..@\n@.O\n")), "y up", cells(np.array([[1, 0], [0, 0], [1, 1]],
        bool))),
    "map/water-and-swamp": case(file("a.map", TILES.format(".SW\nGTW\n")), "water, counts as occupied",
        cells(np.array([[0, 0], [1, 0], [1, 1]], bool))),
    "map/counts": case(file("a.map", TILES.format("..@\n")), "expected 2 rows of 3"),
    "map/other-characters": case(file("a.map", TILES.format("..@\n.x.\n")), "got 'x'"),
    "map/other-tiles": case(file("a.map", TILES.format("..@\n...\n").replace("octile", "hex")), "type octile"),
}  # fmt: skip


def binvox(values: np.ndarray, head: str = "", version: int = 1, dim: str = "") -> bytes:
    order = values.transpose(0, 2, 1).ravel()
    runs = b"".join(bytes([int(value), 1]) for value in order)
    dim = dim or " ".join(map(str, values.transpose(0, 2, 1).shape))
    return f"#binvox {version}\ndim {dim}\n{head}data\n".encode() + runs


VOXELS = np.zeros((3, 3, 3), bool)
VOXELS[1, 2, 0] = True
BINVOX = {
    "binvox/runs": case(file("a.binvox", binvox(VOXELS)), check=cells(VOXELS, at([-0.25] * 3, [1.25] * 3))),
    "binvox/translate-and-scale": case(file("a.binvox", binvox(VOXELS, "translate 1 2 3\nscale 6\n")),
        "spacing=2, origin=(2,3,4) place", cells(VOXELS)),
    "binvox/spacing-alone": case(file("a.binvox", binvox(VOXELS, "translate 1 2 3\nscale 6\n")), "origin=(2,3,4) place",
        cells(VOXELS), spacing=2),
    "binvox/placed": case(file("a.binvox", binvox(VOXELS, "translate 1 2 3\nscale 6\n")), check=cells(VOXELS, at([1, 2,
        3], [7, 8, 9])), spacing=2, origin=(2, 3, 4)),
    "binvox/counts": case(file("a.binvox", binvox(VOXELS)[:-2]), "27 voxels"),
    "binvox/trailing-bytes": case(file("a.binvox", binvox(VOXELS) + b"x"), "pairs of bytes"),
    "binvox/other-values": case(file("a.binvox", binvox(2 * VOXELS.astype(int))), "voxel values 0 and 1"),
    "binvox/two-sizes": case(file("a.binvox", binvox(VOXELS, "dim 3 3 3\n")), "one line 'dim'"),
    "binvox/two-places": case(file("a.binvox", binvox(VOXELS, "translate 1 2 3\ntranslate 1 2 3\n")),
        "one line 'translate'"),
    "binvox/number-with-underscore": case(file("a.binvox", binvox(VOXELS, "scale 1_0\n")), "numbers after 'scale'"),
    "binvox/version": case(file("a.binvox", binvox(VOXELS, version=2)), "binvox version 1"),
}  # fmt: skip


def npy(array: np.ndarray, **options) -> bytes:
    out = io.BytesIO()
    np.save(out, array, **options)
    return out.getvalue()


def npz(extra: bytes = b"", **arrays: np.ndarray) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, array in arrays.items():
            archive.writestr(f"{name}.npy", npy(array) + extra)
    return out.getvalue()


SIGNED = np.where(BITS, -0.5, 0.5)
SEEN_BY_ROBOT = np.where(BITS, 100, 0).astype(np.int8)
SEEN_BY_ROBOT[0, 0] = -1
WITH_UNKNOWN = BITS.copy()
WITH_UNKNOWN[0, 0] = True
ARRAYS = {
    "npy/truth-values": case(file("a.npy", npy(BITS)), check=cells(BITS)),
    "npy/zeros-and-ones": case(file("a.npy", npy(BITS.astype(np.int32))), check=cells(BITS)),
    "npy/columns-first": case(file("a.npy", npy(np.asfortranarray(BITS))), check=cells(BITS)),
    "npy/big-endian": case(file("a.npy", npy(SIGNED.astype(">f4"))), check=cells(BITS), level="<=0"),
    "npy/other-numbers": case(file("a.npy", npy(SIGNED)), "level='<=0'"),
    "npy/occupancy-grid": case(file("a.npy", npy(SEEN_BY_ROBOT)), "level='>=65'"),
    "npy/occupancy-grid-unknown": case(file("a.npy", npy(SEEN_BY_ROBOT)), "1 unknown cells count as occupied",
        cells(WITH_UNKNOWN), level=">=65"),
    "npy/unknown-and-other-numbers": case(file("a.npy", npy(np.where(WITH_UNKNOWN & ~BITS, -1, BITS * 0.7))),
        "1 unknown cells count as occupied", cells(WITH_UNKNOWN), level=">=0.65"),
    "npy/unknown-and-0-and-1": case(file("a.npy", npy(np.where(WITH_UNKNOWN & ~BITS, -1, BITS))),
        "1 unknown cells count as free", cells(BITS), level=">0", unknown="free"),
    "npy/unknown-of-other-numbers": case(file("a.npy", npy(SIGNED)), "unknown is for maps", level=">0",
        unknown="occupied"),
    "npy/nan": case(file("a.npy", npy(np.where(BITS, np.nan, 1.0))), "NaN in 4 of 24", level=">0"),
    "npy/vertices": case(file("a.npy", npy(V)), "(vertices, faces)"),
    "npy/objects": case(file("a.npy", npy(np.array([{}], object), allow_pickle=True)), "cannot be read"),
    "npy/records": case(file("a.npy", npy(np.zeros(4, "i4,f4"))), "bool or real numbers"),
    "npy/complex": case(file("a.npy", npy(np.eye(3, dtype=complex))), "bool or real numbers"),
    "npy/cut": case(file("a.npy", npy(BITS)[:-1]), "cannot be read"),
    "npy/trailing-bytes": case(file("a.npy", npy(BITS) + b"x"), "got more data"),
    "npz/one": case(file("a.npz", npz(cells=BITS)), check=cells(BITS)),
    "npz/occupancy": case(file("a.npz", npz(occupancy=BITS, spare=SIGNED)), "not read: spare", cells(BITS)),
    "npz/several": case(file("a.npz", npz(a=BITS, b=BITS)), "one array or one named 'occupancy'"),
    "npz/trailing-bytes": case(file("a.npz", npz(b"x", a=BITS)), "got more data"),
    "npz/damaged": case(file("a.npz", npz(a=BITS).replace(BITS.tobytes(), (~BITS).tobytes())), "cannot be read"),
    "npz/no-archive": case(file("a.npz", zlib.compress(npy(BITS))), "not a zip archive"),
}  # fmt: skip


def obj(shift: float, scale: float, hollow: bool = False, apart: float = 0) -> Callable[[Path], Path]:
    """A cube, perhaps with a hollow, as text."""
    parts = [(scale * V.astype(float) + shift, T)] + [
        (scale / 2 * V.astype(float) + shift + apart, T[:, ::-1])
    ] * hollow
    lines = [f"v {x!r} {y!r} {z!r}" for vertices, _ in parts for x, y, z in vertices.tolist()]
    lines += [
        "f {} {} {}".format(*(face + 8 * k + 1)) for k, (_, faces) in enumerate(parts) for face in faces.astype(int)
    ]
    return file("a.obj", "\n".join(lines) + "\n")


def hollowness(inside: bool) -> Callable:
    def check(shape) -> None:
        assert shape.contains(np.array([[0.0, 0, 0], [0.75, 0, 0], [1.5, 0, 0]])).tolist() == [inside, True, False]

    return check


PLACES = {
    "place/cells-anywhere": case(file("a.npy", npy(BITS)), check=cells(BITS, at([7.0, -1.02], [11, 4.98])), spacing=1.0,
        origin=(7.5, -0.52)),
    "place/cells-far": case(file("a.npy", npy(BITS)), check=cells(BITS), spacing=0.3, origin=(500000.13, 4649776.37)),
    "place/mesh-far": case(obj(4649776.37, 0.3), check=at([4649776.07] * 3, [4649776.67] * 3)),
    "place/hollow": case(obj(0, 1, hollow=True), "1 closed hollow filled", hollowness(True)),
    "place/hollow-empty": case(obj(0, 1, hollow=True), "1 closed hollow empty", hollowness(False), hollow="empty"),
    "place/inside-out": case(obj(0, 1, hollow=True, apart=0.75), "inside out", hollow="empty"),
    "place/hollow-of-cells": case(file("a.npy", npy(~BITS)), "1 closed hollow filled", cells(np.pad(np.ones_like(BITS),
        1)), hollow="filled"),
}  # fmt: skip
GRID_CASES: dict[str, Case] = PNG | PGM | ROS | MOVINGAI | BINVOX | ARRAYS | PLACES
