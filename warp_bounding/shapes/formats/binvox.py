"""Reader of ``.binvox`` voxel files (P. Min, https://www.patrickmin.com/binvox/binvox.html).

A text header (``#binvox 1``, ``dim``, ``translate``, ``scale``, ``data``), then pairs of bytes: a value and how often
it repeats. The voxels come in the order x, z, y (y fastest); they are returned in x, y, z. As in the paper, a voxel
file spans the unit cube, from centre to centre; a remark says that the header's ``translate`` and ``scale`` are not
used. trimesh reads cubes of voxels only.
"""

import math
import re
from pathlib import Path

import numpy as np

from warp_bounding.shapes.formats.arrays import Cells
from warp_bounding.shapes.shape import MAX_CELLS

KEYS = {b"#binvox": 1, b"dim": 3, b"translate": 3, b"scale": 1}  # and how many words follow


def read_binvox(path: Path) -> Cells:
    """Read occupancy ``(X, Y, Z)`` bool; ``ValueError`` for anything that is not a complete, exact binvox file."""
    header, _, content = re.split(rb"(\ndata\r?\n)", path.read_bytes(), maxsplit=1)
    fields = {words[0]: words[1:] for line in header.splitlines() if (words := line.split())}
    if fields.get(b"#binvox") != [b"1"] or any(len(words) != KEYS.get(key) for key, words in fields.items()):
        raise ValueError(f"expected a header of binvox 1 with {b' '.join(KEYS).decode()}, got {header[:80]!r}")
    shape = tuple(map(int, fields[b"dim"]))
    if min(shape) < 1 or math.prod(shape) > MAX_CELLS:
        raise ValueError(f"expected 1 to {MAX_CELLS} voxels, got {shape}")
    values, counts = np.frombuffer(content, np.uint8).reshape(-1, 2).T
    if (values > 1).any():
        raise ValueError(f"expected voxel values 0 and 1, got {int(values.max())}")
    if (total := int(counts.sum(dtype=np.int64))) != math.prod(shape):
        raise ValueError(f"expected {math.prod(shape)} voxels ({' x '.join(map(str, shape))}), got {total}")
    x_z_y = np.repeat(values.astype(bool), counts).reshape(shape)
    place = [float(word) for key in (b"translate", b"scale") for word in fields.get(key, ())]
    remark = "the header's translate and scale are not used; spacing= and origin= place the voxels"
    return Cells(x_z_y.transpose(0, 2, 1), path.name, remark if place not in ([], [0, 0, 0, 1]) else "")
