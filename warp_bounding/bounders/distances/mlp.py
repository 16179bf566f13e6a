"""The distance as a network learns it: F is the network's output, asked at the nearest point of the domain.

A network is smooth, and so is a distance away from the object, so that few weights tell it nearly. What it overestimates anywhere is its
slack, which is proven (``proof.distances.excesses``).
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.activations import activation_of
from warp_bounding.arithmetic import UNIT64
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.neural.mlp import ACTIVATION, HIDDEN, Mlp, check_hidden
from warp_bounding.bounders.options import STEPS
from warp_bounding.kernels.distances.source import FLUSHED, DistanceSource
from warp_bounding.networks.inference import MlpSource, head_numbers, layer_numbers
from warp_bounding.networks.network import Network

__all__ = ["MlpDistance", "MlpDistanceSource"]

MOST_AXES = 8  # 2^n corners of each box are asked for
CORNER_ROUNDING = 256.0  # units, of all terms of a linear function: more than float64 rounds in it


@dataclass(frozen=True)
class MlpDistanceSource(DistanceSource, MlpSource):
    """Native code of the network, in a distance."""

    whole = False


class MlpDistance(DistanceBounder):
    """A network's distance; see module.

    Tensors: ``layers.i.weight`` ``(H, K)`` and ``layers.i.bias`` ``(H,)``, the last layer with H = 1. Sizes: ``hidden``, ``activation``.
    """

    method = Mlp.method
    options = (HIDDEN, ACTIVATION, STEPS)
    moving = True
    room = 0.1

    @classmethod
    def supports(cls, ndim: int) -> bool:
        """See ``DistanceBounder``."""
        return 1 <= ndim <= MOST_AXES

    def check_tensors(self) -> None:
        """See ``DistanceBounder``."""
        self.hidden = check_hidden(self.sizes.get("hidden", ()))
        self.activation = activation_of(self.sizes.get("activation")).name
        sizes = (self.domain.ndim, *self.hidden, 1)
        expected = {}
        for i in range(len(sizes) - 1):
            expected |= {f"layers.{i}.weight": (sizes[i + 1], sizes[i]), f"layers.{i}.bias": (sizes[i + 1],)}
        self.expect_shapes(expected)
        limit = self.domain.limit.astype(np.float64)
        *layers, (weight, bias) = self._layers()
        self.network = Network([*layers, (weight, bias)], self.activation, None, limit)
        self._negative = Network([*layers, (-weight, -bias)], self.activation, None, limit)

    def _layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        names = [f"layers.{i}" for i in range(len(self.hidden) + 1)]
        return [(self.tensors[f"{name}.weight"], self.tensors[f"{name}.bias"]) for name in names]

    @property
    def source(self) -> MlpDistanceSource:
        """See ``DistanceBounder``."""
        return MlpDistanceSource(self.ndim, self.domain.time, hidden=self.hidden, activation=self.activation)

    def weights(self) -> np.ndarray:
        """See ``DistanceBounder``."""
        *layers, last = self._layers()
        return np.concatenate([*(layer_numbers(*layer) for layer in layers), head_numbers(*last)])

    @property
    def nbytes(self) -> int:
        """See ``DistanceBounder``: a query reads one of the two copies that the numbers hold for lanes of queries and of neurons."""
        return 4 * (len(self.domain.header) + 2 + len(self.domain.extra)) + sum(
            tensor.nbytes for tensor in self.tensors.values()
        )

    def reference(self, v: np.ndarray) -> np.ndarray:
        """See ``DistanceBounder``."""
        return self.network(np.asarray(v, dtype=np.float64))

    def rounding_bound(self) -> float:
        """See ``DistanceBounder``."""
        return self.network.rounding + FLUSHED

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See ``DistanceBounder``: F is under a linear function (``Network.bound``), and that is known by its numbers at the corners."""
        bounds = self._negative.bound(lower, upper)
        half, n = (upper - lower) / 2, lower.shape[1]
        signs = np.array([[1.0 if i >> k & 1 else -1.0 for k in range(n)] for i in range(2**n)])
        terms = np.abs(bounds.level) + (np.abs(bounds.slope) * (np.abs(lower) + np.abs(upper))).sum(axis=1)
        values = -bounds.level[:, None] - (bounds.slope * half) @ signs.T
        return values + (CORNER_ROUNDING * UNIT64 * terms)[:, None], bounds.axis

    @property
    def steepness(self) -> float:
        """See ``DistanceBounder``: slopes of bounds are within the products of the layers' largest row sums."""
        size = float(np.abs(self.network.output.weight).sum())
        for layer in self.network.hidden:
            size *= max(float(np.abs(layer.weight).sum(axis=1).max()), 1.0)
        return max(size, 1.0)
