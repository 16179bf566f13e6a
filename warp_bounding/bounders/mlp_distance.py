"""The distance as a network learns it: F is the network's output, asked at the nearest point of the domain.

A network is smooth, and so is a distance away from the object, so that few weights tell it nearly. What it
overestimates anywhere is its slack, which is proven (``proof.distances``).
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.bounder import STEPS
from warp_bounding.bounders.distance import REACH, DistanceBounder
from warp_bounding.bounders.mlp import ACTIVATION, HIDDEN, Layered, Mlp
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances import FLUSHED, DistanceSource
from warp_bounding.networks.inference import MlpSource
from warp_bounding.networks.network import Network

MOST_AXES = 8  # 2^n corners of each box are requested
NORMS = 1 + 1e-9  # outweighs what float64 rounds in products of norms


@dataclass(frozen=True)
class MlpDistanceSource(DistanceSource, MlpSource):
    """Native code of the network, in a distance."""

    whole = False


class MlpDistance(Layered, DistanceBounder):
    """A network's distance; see module.

    Tensors: ``layers.i.weight`` ``(H, K)`` and ``layers.i.bias`` ``(H,)``, the last layer with H = 1. Sizes:
    ``hidden``, ``activation``.
    """

    method = Mlp.method
    bit_fields = ("levels",)  # of older files, which ``check_tensors`` refuses
    options = (HIDDEN, ACTIVATION, STEPS, REACH)
    moving = True

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and ndim <= MOST_AXES

    def check_tensors(self) -> None:
        if self.sizes.get("shape"):
            raise BounderError("distances whose parts have slacks of their own are gone: fit it anew")
        self.expect_shapes(self.layer_shapes(self.domain.ndim, 1))
        limit = self.domain.limit.astype(np.float64)
        *layers, (weight, bias) = self.layers
        self.network = Network(self.layers, self.activation, limit)
        self._negative = Network([*layers, (-weight, -bias)], self.activation, limit)

    @property
    def source(self) -> MlpDistanceSource:
        return MlpDistanceSource(self.ndim, self.domain.time, hidden=self.hidden, activation=self.activation)

    @property
    def nbytes(self) -> int:
        """See ``DistanceBounder``; a query reads one of two copies of the numbers, for lanes of queries or neurons."""
        head = len(self.domain.header) + 2 + len(self.domain.extra)
        return 4 * head + sum(tensor.nbytes for tensor in self.tensors.values())

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self.network(v)

    def rounding_bound(self) -> float:
        return self.network.rounding + FLUSHED

    def corners(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """See ``DistanceBounder``: the network's own multilinear bound (``Network.corners``)."""
        return -self._negative.corners(lower, upper)

    @property
    def rate(self) -> float:
        """See ``DistanceBounder``; two kinds of products of layer norms, as activations have slopes up to 1."""
        (weight, _), *others = self.layers
        first = weight[:, 0].astype(np.float64)
        entries, spectral = np.abs(first), float(np.linalg.norm(first))
        for weight, _ in others:
            weight = weight.astype(np.float64)
            entries, spectral = np.abs(weight) @ entries, spectral * float(np.linalg.norm(weight, 2))
        return min(float(entries.max()), spectral) * NORMS

    @property
    def steepness(self) -> float:
        """See ``DistanceBounder``: slopes of bounds are within the products of the layers' largest row sums."""
        size = float(np.abs(self.network.output.weight).sum())
        for layer in self.network.hidden:
            size *= max(float(np.abs(layer.weight).sum(axis=1).max()), 1.0)
        return max(size, 1.0)
