"""Whether this machine can hold what a step needs: an error before it is begun instead of a process that is killed in it."""

import os

from warp_bounding.errors import IndicatorError

__all__ = ["check_memory"]


def check_memory(needed: float, what: str, advice: str) -> None:
    """Refuse a step that needs more than all of the machine's memory.

    Args:
        needed: Bytes at a time, about.
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
