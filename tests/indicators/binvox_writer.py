"""A writer of ``.binvox`` files, for round trips: not part of the library."""

from itertools import groupby
from pathlib import Path

import numpy as np


def write_binvox(path: Path, occupancy: np.ndarray) -> None:
    """Write ``(X, Y, Z)`` bool in the file's own order x, z, y, in runs of at most 255."""
    x, y, z = occupancy.shape
    data = bytearray()
    for value, run in groupby(occupancy.transpose(0, 2, 1).ravel().tolist()):
        left = len(list(run))
        while left:
            data += bytes([value, min(left, 255)])
            left -= min(left, 255)
    header = f"#binvox 1\ndim {x} {z} {y}\ntranslate -0.5 0 1e-3\nscale 1.5\ndata\n"
    path.write_bytes(header.encode() + bytes(data))
