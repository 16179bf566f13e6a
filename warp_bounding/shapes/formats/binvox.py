"""Reader of ``.binvox`` voxel files (P. Min, https://www.patrickmin.com/binvox/binvox.html).

A text header (``#binvox 1``, ``dim``, ``translate``, ``scale``, ``data``), then pairs of bytes: a value and how often
it repeats. The voxels come in the order x, z, y (y fastest); they are returned in x, y, z. As in the paper, a voxel
file spans the unit cube, from centre to centre; what the header's ``translate`` and ``scale`` say instead is told, with
what places the voxels so.
"""

import math
from pathlib import Path

import numpy as np

from warp_bounding.shapes.formats.arrays import Cells
from warp_bounding.shapes.shape import MAX_CELLS

__all__ = ["read_binvox"]

LONGEST_HEADER = 4096  # bytes


def read_binvox(path: Path) -> Cells:
    """Read occupancy ``(X, Y, Z)`` bool; ``ValueError`` for anything that is not a complete, exact binvox file."""
    content = path.read_bytes()
    shape, start, header = _read_header(content)
    if (len(content) - start) % 2:
        raise ValueError(f"expected pairs of bytes after the header, got {len(content) - start} bytes")
    values, counts = np.frombuffer(content, np.uint8, offset=start).reshape(-1, 2).T
    if (values > 1).any():
        raise ValueError(f"expected voxel values 0 and 1, got {int(values.max())}")
    if (counts == 0).any():
        raise ValueError("expected runs of 1 to 255 voxels, got a run of 0")
    expected, total = math.prod(shape), int(counts.sum(dtype=np.int64))
    if total != expected:
        raise ValueError(f"expected {expected} voxels ({' x '.join(map(str, shape))}), got {total}")
    x_z_y = np.repeat(values.astype(bool), counts).reshape(shape)
    translate, (scale,) = header.get("translate", [0.0] * 3), header.get("scale", [1.0])
    if not any(translate) and scale == 1:
        return Cells(x_z_y.transpose(0, 2, 1), path.name)
    cell = scale / max(shape)
    origin = ",".join(f"{t + cell / 2:.17g}" for t in translate)
    reported = f"the header's translate ({', '.join(f'{t:g}' for t in translate)}) and scale {scale:g} are not used"
    return Cells(
        x_z_y.transpose(0, 2, 1),
        path.name,
        elsewhere=f"{reported}; spacing={cell:.17g}, origin=({origin}) place the voxels so",
    )


def _read_header(content: bytes) -> tuple[tuple[int, int, int], int, dict[str, list[float]]]:
    """Voxels along x, z, y, where the data begin, and the header's numbers."""
    if not content.startswith(b"#binvox"):
        raise ValueError(f"expected a file that begins with '#binvox', got {content[:8]!r}")
    shape, position, found = None, 0, {}
    while True:
        end = content.find(b"\n", position, LONGEST_HEADER)
        if end < 0:
            raise ValueError("expected a binvox header that ends with a line 'data', got none")
        words, position = content[position:end].split(), end + 1
        match words:
            case [b"#binvox", version]:
                if version != b"1":
                    raise ValueError(f"expected binvox version 1, got {version.decode(errors='replace')}")
            case [b"dim", *sizes]:
                if len(sizes) != 3 or not all(size.isdigit() and int(size) > 0 for size in sizes):
                    raise ValueError(f"expected 'dim' and 3 positive integers, got {_text(words)!r}")
                if shape is not None:
                    raise ValueError("expected one line 'dim' in the binvox header, got two")
                shape = tuple(int(size) for size in sizes)
            case [(b"translate" | b"scale") as key, *numbers]:
                if len(numbers) != (3 if key == b"translate" else 1) or not all(_is_number(n) for n in numbers):
                    raise ValueError(f"expected numbers after {key.decode()!r}, got {_text(words)!r}")
                if key.decode() in found:
                    raise ValueError(f"expected one line {key.decode()!r} in the binvox header, got two")
                found[key.decode()] = [float(number) for number in numbers]
                if key == b"scale" and not found["scale"][0] > 0:
                    raise ValueError(f"expected a scale above 0, got {_text(words)!r}")
            case [b"data"]:
                break
            case _:
                raise ValueError(f"expected a binvox header line, got {_text(words)!r}")
    if shape is None:
        raise ValueError("expected a line 'dim' in the binvox header, got none")
    if math.prod(shape) > MAX_CELLS:
        raise ValueError(f"expected at most {MAX_CELLS} voxels, got {math.prod(shape)}")
    return shape, position, found


def _is_number(word: bytes) -> bool:
    try:
        return b"_" not in word and math.isfinite(float(word))
    except ValueError:
        return False


def _text(words: list[bytes]) -> str:
    return b" ".join(words)[:80].decode(errors="replace")
