"""Reader of ``.binvox`` voxel files (P. Min, https://www.patrickmin.com/binvox/binvox.html).

A text header (``#binvox 1``, ``dim``, ``translate``, ``scale``, ``data``), then pairs of bytes: a value and how often
it repeats. The voxels come in the order x, z, y (y fastest); they are returned in x, y, z. The header's ``translate``
and ``scale`` are checked and left aside: as in the paper, a voxel file spans the unit cube, from centre to centre.
"""

import math
from pathlib import Path

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.limits import MAX_CELLS

__all__ = ["read_binvox"]

LONGEST_HEADER = 4096  # bytes


def read_binvox(path: Path) -> np.ndarray:
    """Read the occupancy of a ``.binvox`` file.

    Args:
        path: An existing file.

    Returns:
        ``(X, Y, Z)`` bool.

    Raises:
        IndicatorError: For anything that is not a complete, exact binvox file.
    """
    content = path.read_bytes()
    shape, start = _read_header(path, content)
    if (len(content) - start) % 2:
        raise IndicatorError(f"{path}: expected pairs of bytes after the header, got {len(content) - start} bytes")
    values, counts = np.frombuffer(content, np.uint8, offset=start).reshape(-1, 2).T
    if (values > 1).any():
        raise IndicatorError(f"{path}: expected voxel values 0 and 1, got {int(values.max())}")
    if (counts == 0).any():
        raise IndicatorError(f"{path}: expected runs of 1 to 255 voxels, got a run of 0")
    expected, total = math.prod(shape), int(counts.sum(dtype=np.int64))
    if total != expected:
        raise IndicatorError(f"{path}: expected {expected} voxels ({' x '.join(map(str, shape))}), got {total}")
    x_z_y = np.repeat(values.astype(bool), counts).reshape(shape)
    return x_z_y.transpose(0, 2, 1)


def _read_header(path: Path, content: bytes) -> tuple[tuple[int, int, int], int]:
    """Voxels along x, z, y, and where the data begin."""
    if not content.startswith(b"#binvox"):
        raise IndicatorError(f"{path}: expected a file that begins with '#binvox', got {content[:8]!r}")
    shape, position = None, 0
    while True:
        end = content.find(b"\n", position, LONGEST_HEADER)
        if end < 0:
            raise IndicatorError(f"{path}: expected a binvox header that ends with a line 'data', got none")
        words, position = content[position:end].split(), end + 1
        match words:
            case [b"#binvox", version]:
                if version != b"1":
                    raise IndicatorError(f"{path}: expected binvox version 1, got {version.decode(errors='replace')}")
            case [b"dim", *sizes]:
                if len(sizes) != 3 or not all(size.isdigit() and int(size) > 0 for size in sizes):
                    raise IndicatorError(f"{path}: expected 'dim' and 3 positive integers, got {_text(words)!r}")
                shape = tuple(int(size) for size in sizes)
            case [(b"translate" | b"scale") as key, *numbers]:
                if len(numbers) != (3 if key == b"translate" else 1) or not all(_is_number(n) for n in numbers):
                    raise IndicatorError(f"{path}: expected numbers after {key.decode()!r}, got {_text(words)!r}")
            case [b"data"]:
                break
            case _:
                raise IndicatorError(f"{path}: expected a binvox header line, got {_text(words)!r}")
    if shape is None:
        raise IndicatorError(f"{path}: expected a line 'dim' in the binvox header, got none")
    if math.prod(shape) > MAX_CELLS:
        raise IndicatorError(f"{path}: expected at most {MAX_CELLS} voxels, got {math.prod(shape)}")
    return shape, position


def _is_number(word: bytes) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _text(words: list[bytes]) -> str:
    return b" ".join(words)[:80].decode(errors="replace")
