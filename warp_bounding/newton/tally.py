"""How many pairs a pass has skipped, by kind of shape."""

from dataclasses import dataclass

import numpy as np

__all__ = ["Tally", "tallies"]


@dataclass(frozen=True)
class Tally:
    """Pairs of one kind of shape.

    Attributes:
        pairs: All of them.
        culled: Those that the pass did not go through.
    """

    pairs: int
    culled: int

    def __str__(self) -> str:
        """Both, and the share."""
        share = 100.0 * self.culled / self.pairs if self.pairs else 0.0
        return f"{self.culled:,} of {self.pairs:,} ({share:.1f} %)"


def tallies(names: list[str], shapes: np.ndarray, kept: np.ndarray) -> dict[str, Tally]:
    """Pairs by the name of their shape, in the order of the shapes.

    Args:
        names: Of each shape.
        shapes: ``(N,)`` int, of each pair.
        kept: ``(N,)`` bool, which the pass goes through.

    Returns:
        A tally for each name.
    """
    pairs = np.bincount(shapes, minlength=len(names))
    culled = np.bincount(shapes[~kept], minlength=len(names))
    order = {name: [s for s, own in enumerate(names) if own == name] for name in names}
    return {name: Tally(int(pairs[own].sum()), int(culled[own].sum())) for name, own in order.items()}
