"""Whether boxes hold all of an object: what lies between them is cut into boxes, which the shape must certify empty.

A box is closed and its corners are float32 numbers, or infinite. So are queries: a float32 point outside a box lies at
least at the next float64 number behind its side, and the boxes between begin there.
"""

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.indicators.shape import Shape

__all__ = ["Region", "check_cover"]

Region = tuple[np.ndarray, np.ndarray]  # corners of a box, object space
SMALLEST = 2.0**-12  # of the longest side: pieces between the boxes that are not halved any more
MOST = 1_000_000  # pieces between the boxes that are asked about


def check_cover(shape: Shape, boxes: list[Region]) -> None:
    """Refuse boxes that do not hold every point of an object.

    Raises:
        BounderError: Naming a point of the object, or one where the shape may be, that no box holds.
    """
    if shape.unbounded:  # what lies beyond its box is object, too
        raise BounderError(f"{shape.name}: parts in boxes do not hold a shape without an end")
    low, high = shape.lower[None].copy(), shape.upper[None].copy()
    for first, last in boxes:
        low, high = _outside(low, high, first, last)
        if len(low) > MOST:
            raise BounderError(f"{shape.name}: {len(boxes)} boxes leave too many pieces between them to be looked at")
    smallest, asked = SMALLEST * float(shape.extent.max()), 0
    while len(low):
        left = ~shape.empty(low, high)
        low, high, asked = low[left], high[left], asked + len(left)
        middle = low + (high - low) / 2
        held = np.flatnonzero(shape.contains(middle))
        small = np.flatnonzero(((high - low) <= smallest).all(axis=1))
        if len(held) or len(small) or asked > MOST:
            place = middle[[*held, *small, 0][0]]
            point = ", ".join(f"{x:.6g}" for x in place)
            found = "is" if len(held) else "may be"
            raise BounderError(f"{shape.name}: the parts do not cover the object, which {found} at ({point})")
        if not len(low):
            return
        axis, row = (high - low).argmax(axis=1), np.arange(len(low))
        less, more = high.copy(), low.copy()
        less[row, axis] = more[row, axis] = middle[row, axis]
        low, high = np.concatenate([low, more]), np.concatenate([less, high])


def _outside(low: np.ndarray, high: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes that hold every float64 point of some boxes that is not in the closed box from ``first`` to ``last``."""
    apart = ((low > last) | (high < first)).any(axis=1)
    kept = [(low[apart], high[apart])]
    low, high = low[~apart].copy(), high[~apart].copy()
    for axis in range(low.shape[1]):
        for side in (0, 1):
            beyond = low[:, axis] < first[axis] if side == 0 else high[:, axis] > last[axis]
            piece_low, piece_high = low[beyond].copy(), high[beyond].copy()
            if side == 0:
                piece_high[:, axis] = np.nextafter(first[axis], -np.inf)
                low[:, axis] = np.maximum(low[:, axis], first[axis])
            else:
                piece_low[:, axis] = np.nextafter(last[axis], np.inf)
                high[:, axis] = np.minimum(high[:, axis], last[axis])
            kept.append((piece_low, piece_high))
    return tuple(np.concatenate(side) for side in zip(*kept, strict=True))
