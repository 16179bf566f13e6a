"""Boxes against a monotone network: the least f of all that meet the object, as a minimum over the object's points.

See ``bounders.mlp`` for why. The object's cells are not widened here: what the pipeline rounds is in
the function.
"""

from dataclasses import replace

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import MonotoneMlp
from warp_bounding.networks.bounds import BoxBounds

__all__ = ["LeastBox", "of_points"]


class LeastBox:
    """``g(p)``, at most f of any box that holds p; ``search.minimum`` and ``certify`` take it as a bounder of points."""

    exact_on_cells = False

    def __init__(self, bounder: MonotoneMlp):
        self.network = bounder.point_network
        base = bounder.domain.base
        self.domain = replace(base, delta=np.zeros_like(base.delta))  # `widened` then adds float64's rounding only

    def reference(self, p: np.ndarray) -> np.ndarray:
        """The values of g at points ``(N, n)`` float64, local space, ``(N,)`` float64."""
        return self.network(p)

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See ``Bounder.cut``: g does not jump."""
        return lower, upper, np.arange(len(lower))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """Certified lower bounds over boxes of p."""
        return self.network.bound(lower, upper)


def of_points(bounder: Bounder) -> Bounder | LeastBox:
    """The f that is bounded over points: of a monotone network its ``LeastBox``, else the bounder itself."""
    return LeastBox(bounder) if isinstance(bounder, MonotoneMlp) else bounder
