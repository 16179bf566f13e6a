"""``mlp``: a multi-layer perceptron (the paper's OurNN), of any widths and activation.

``f`` is the network's output before the paper's sigmoid. A proof or a search sets the threshold, instead of a
probability of one half.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import ClassVar

import numpy as np

from warp_bounding.activations import ACTIVATIONS, DEFAULT, activation_of
from warp_bounding.bounders.bounder import STEPS, Bounder, Option, one_of, truth
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.networks.inference import MlpSource, head_numbers, layer_numbers
from warp_bounding.networks.network import Network
from warp_bounding.queries.point import POINT

# --- networks --------------------------------------------------------------------------------------------------------

LARGEST_WIDTH = 1024  # neurons of a hidden layer
MOST_LAYERS = 8  # hidden layers
# Neurons of all hidden layers: proofs hold some 64 (2 n + 7) bytes for each on a thread's stack, 2 MB in 4D.
MOST_NEURONS = 2048


def check_hidden(hidden) -> tuple[int, ...]:
    """Hidden widths as a tuple.

    Raises ``BounderError`` for none, too many, or a width that is no whole number in its range.
    """
    if not isinstance(hidden, Iterable) or isinstance(hidden, str | bytes):
        raise BounderError(f"hidden must be the widths of the layers, such as (24, 24), got {hidden!r}")
    widths = tuple(hidden)
    known = all(isinstance(h, (int, np.integer)) and not isinstance(h, bool) for h in widths)
    known = known and all(1 <= h <= LARGEST_WIDTH for h in widths)
    if not 1 <= len(widths) <= MOST_LAYERS or not known or sum(widths) > MOST_NEURONS:
        limits = f"1 to {MOST_LAYERS} widths from 1 to {LARGEST_WIDTH}, {MOST_NEURONS} in all"
        got = repr(hidden) if len(widths) <= MOST_LAYERS else f"{len(widths)} of them"
        raise BounderError(f"hidden must be {limits}, such as (50, 50), got {got}")
    return tuple(int(h) for h in widths)


def _widths(text: str) -> tuple[int, ...]:
    """Hidden widths as the command line writes them, such as 50,50."""
    try:
        return tuple(int(width) for width in text.split(","))
    except ValueError:
        raise BounderError(f"hidden must be widths such as 50,50, got {text!r}") from None


_HELP = f"of the hidden layers: {', '.join(ACTIVATIONS)}"

HIDDEN = Option("hidden", (50, 50), "widths of the hidden layers", check_hidden, _widths)
ACTIVATION = Option("activation", DEFAULT.name, _HELP, one_of("activation", ACTIVATIONS))
POINTS_ACTIVATION = Option(
    ACTIVATION.name, None, f"{_HELP}; for points the better one in a short training", ACTIVATION.check
)
STATISTICAL = Option(
    "statistical",
    False,
    "take a threshold from samples, unproven, where in many dimensions a proven one denies nothing",
    truth("statistical"),
    bool,
    queries=("point",),
)


class Layered(tensor_cores.TensorCores):
    """What bounders with a network have in common: its layers as tensors, and as kernels read them."""

    def layer_shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """Shapes of the layers' tensors by ``sizes``; sets ``hidden`` and ``activation``, checked."""
        self.hidden = check_hidden(self.sizes.get("hidden", ()))
        self.activation = activation_of(self.sizes.get("activation")).name
        shapes, sizes = {}, (inputs, *self.hidden, outputs)
        for i, (k, h) in enumerate(pairwise(sizes)):
            shapes |= {f"layers.{i}.weight": (h, k), f"layers.{i}.bias": (h,)}
        return shapes

    @property
    def layers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weight ``(H, K)`` and bias ``(H,)`` of each layer, the output's last."""
        names = [f"layers.{i}" for i in range(len(self.hidden) + 1)]
        return [(self.tensors[f"{name}.weight"], self.tensors[f"{name}.bias"]) for name in names]

    def weights(self) -> np.ndarray:
        """See ``Bounder``: the layers' numbers as ``MlpSource`` reads them."""
        *layers, last = self.layers
        return np.concatenate([*(layer_numbers(*layer) for layer in layers), head_numbers(*last)])


class Mlp(Layered, Bounder):
    """A network; *maybe* where its output reaches the threshold.

    Tensors: ``layers.i.weight`` ``(H, K)``, ``layers.i.bias`` ``(H,)``, the last layer with H = 1.
    Sizes: ``hidden``, ``activation``.
    """

    method = "mlp"
    exact_on_cells = False
    instead = "; a network of distances answers rays and boxes, proven: fit(shape, 'distance')"
    options = (HIDDEN, POINTS_ACTIVATION, STATISTICAL, STEPS)
    source_kind: ClassVar[type[MlpSource]] = MlpSource

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return query == POINT.name

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        return True

    def check_tensors(self) -> None:
        self.expect_shapes(self.layer_shapes(self.domain.ndim, 1) | self.more_shapes())
        self.network = Network(self.layers, self.activation, self.domain.limit.astype(np.float64))

    def more_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the tensors besides the layers'."""
        return {}

    @property
    def source(self) -> MlpSource:
        return self.source_of(self.source_kind, self.hidden, self.activation)

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self.network(np.asarray(v, dtype=np.float64))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        return self.network.bound(lower, upper)

    def rounding_bound(self) -> float:
        return self.network.rounding


class Occupancy(Mlp):
    """A network with false negatives, trained with a symmetric loss (the paper's OccNet). Tensors: ``Mlp``'s.

    It answers *maybe* where the probability that the query meets the object is at least one half (``f >= 0``), as
    occupancy networks do (Mescheder et al. 2019). It errs both ways alike: some queries that do meet the object are
    denied. It shows what the asymmetric loss and the proof are for, and is of no use as a broad phase; it can never
    hold a certificate.
    """

    method = "occupancy"
    conservative = False
    options = (HIDDEN, ACTIVATION, STEPS)

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Occupancy":
        """Set the threshold; raises ``BounderError`` for a certificate, which this bounder cannot hold."""
        if certificate is not None:
            raise BounderError("occupancy: is not conservative and cannot hold a certificate")
        return super().freeze(threshold, None)

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, not conservative>"
