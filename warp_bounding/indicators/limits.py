"""What may be asked for: resolutions, margins, cells, and steps that this machine can hold.

An error before a step is begun is better than a process that is killed in it.
"""

import math
import operator
import os

import numpy as np

from warp_bounding.errors import IndicatorError

__all__ = ["MAX_CELLS", "MAX_RESOLUTION", "check_memory", "checked_margin", "checked_resolution"]

MAX_CELLS = 2**31 - 1  # cells of a grid: their indices are 32-bit integers
DEFAULT_RESOLUTION, MAX_RESOLUTION = 64, 1024  # cells along the longest axis of a mesh


def check_memory(needed: float, what: str, advice: str) -> None:
    """Refuse a step that needs more than all of the machine's memory.

    Args:
        needed: Bytes that the step holds at a time, about.
        what: What needs them, for the message.
        advice: What would need less.

    Raises:
        IndicatorError: With both numbers.
    """
    there = _memory()
    if there is not None and needed > there:
        raise IndicatorError(
            f"{what} needs about {needed / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g}; {advice}"
        )


def _memory() -> int | None:
    """Bytes of memory of this machine; ``None`` where it does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None


def checked_resolution(resolution: int | None) -> int:
    """The resolution, or the default one for ``None``; raises ``IndicatorError`` for an impossible one."""
    if resolution is None:
        return DEFAULT_RESOLUTION
    try:
        value = operator.index(resolution)
    except TypeError:
        value = -1
    if isinstance(resolution, bool | np.bool_) or not 2 <= value <= MAX_RESOLUTION:
        raise IndicatorError(f"resolution must be an integer from 2 to {MAX_RESOLUTION}, got {resolution!r}")
    return value


def checked_margin(margin: float) -> float:
    """The margin as a float; raises ``IndicatorError`` for one that is negative or not finite."""
    try:
        value = float(margin)
    except (TypeError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise IndicatorError(f"margin must be finite and non-negative, got {margin!r}")
    return value
