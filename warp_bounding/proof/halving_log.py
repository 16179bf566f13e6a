"""Which boxes a proof has halved, in a file for the program in ``verifier/``, which need not look at those.

The file holds one number for each box, breadth first from the whole domain: along which axis it is halved, or -1. So
two halves of a box are neighbours, and no such list leaves out a box. It names the bounder's file by its SHA-256.
"""

import hashlib
import os
from pathlib import Path

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.proof.halving import Boxes, Look, Seen, halve
from warp_bounding.runtime.whole_file import file_path


class HalvingLog:
    """Records what a look halves, and takes the look's place (``of``).

    Args:
        path: Where to write.
        bounder: The path of the bounder's file.

    Raises:
        BounderError: If that is no path.
    """

    def __init__(self, path: str | os.PathLike, bounder):
        if not isinstance(bounder, str | os.PathLike):
            raise BounderError("a log names the bounder's file: give certify its path, and not the bounder")
        self.path, self.file = Path(path), file_path(bounder)
        self.axes: dict[bytes, int] = {}  # by the corners of a box

    def of(self, look: Look) -> "HalvingLog":
        """A look that sees the same."""
        self.look, self.chunk = look, look.chunk
        return self

    def __call__(self, boxes: Boxes) -> Seen:
        seen = self.look(boxes)
        (low, middle), (_, high) = (np.split(side, 2) for side in (seen.halves.lower, seen.halves.upper))
        axes = (middle > low).argmax(axis=1)
        self.axes.update(zip(_keys(low, high), axes.tolist(), strict=True))
        return seen

    def write(self, limit: np.ndarray) -> None:
        """Write the halvings of a domain, ``limit`` ``(n,)``."""
        low, high, found = -np.float64(limit)[None], np.float64(limit)[None], []
        while len(low):
            axes = np.array([self.axes.get(key, -1) for key in _keys(low, high)])
            found.append(axes)
            some = axes >= 0
            sides = (np.split(side, 2) for side in halve(low[some], high[some], axes[some]))
            low, high = (np.stack(pair, axis=1).reshape(-1, low.shape[1]) for pair in sides)
        sha = hashlib.sha256(self.file.read_bytes()).hexdigest()
        with self.path.open("wb") as log:
            np.savez_compressed(log, axis=np.concatenate(found).astype(np.int8), sha256=sha)


def _keys(low: np.ndarray, high: np.ndarray) -> list[bytes]:
    rows = np.ascontiguousarray(np.concatenate([low, high], axis=1))
    return [row.tobytes() for row in rows]
