"""Numbers that a user gives for a shape, checked."""

import math

import numpy as np

from warp_bounding.errors import IndicatorError

__all__ = ["checked_corners", "checked_number", "checked_vector"]


def checked_vector(value, what: str, name: str) -> np.ndarray:
    """``(n,)`` float64, read-only; raises ``IndicatorError`` for anything but at least one finite number in a row."""
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.ndim != 1 or vector.size == 0 or not np.isfinite(vector).all():
        raise IndicatorError(f"{name}: {what} must be finite numbers of shape (n,), got {value!r}")
    vector.setflags(write=False)
    return vector


def checked_number(value, what: str, name: str, least: float = 0.0) -> float:
    """A finite float above ``least``; raises ``IndicatorError`` for any other."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > least):
        needed = "finite" if math.isinf(least) else f"finite and above {least:g}"
        raise IndicatorError(f"{name}: {what} must be {needed}, got {value!r}")
    return number


def checked_corners(lower, upper, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box, each ``(n,)``; raises ``IndicatorError`` unless lower is below upper in each coordinate."""
    lower, upper = checked_vector(lower, "lower", name), checked_vector(upper, "upper", name)
    if lower.shape != upper.shape or not (lower < upper).all():
        raise IndicatorError(f"{name}: lower must be below upper in each coordinate, got {lower} and {upper}")
    return lower, upper
