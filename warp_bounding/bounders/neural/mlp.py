"""``mlp``: a multi-layer perceptron (the paper's OurNN), any widths and activation, with an optional encoding.

The network's output before the paper's sigmoid is ``f`` (of planes, two outputs make it: ``networks.heads``); the
threshold on it is set by a proof or a search, not at a probability of one half.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import ClassVar

import numpy as np
import warp as wp

from warp_bounding.activations import ACTIVATIONS, DEFAULT, activation_of
from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.options import STEPS, Option, one_of, whole
from warp_bounding.coordinates.domain import Domain
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import warp_kernel
from warp_bounding.networks import tensor_cores
from warp_bounding.networks.heads import head_of
from warp_bounding.networks.inference import MlpSource, head_numbers, layer_numbers
from warp_bounding.networks.network import Network
from warp_bounding.queries import QUERIES
from warp_bounding.runtime.launch import BlockLaunch

__all__ = ["ACTIVATION", "HIDDEN", "MOST_THRESHOLDS", "OCTAVES", "RECIPE", "RECIPES", "Mlp", "encoding_tensors"]

LARGEST_WIDTH = 1024  # neurons of a hidden layer
MOST_LAYERS = 8  # hidden layers
# Neurons of all hidden layers: proofs hold some 64 (2 n + 7) bytes for each on a thread's stack, 2 MB in 4D.
MOST_NEURONS = 2048
MOST_OCTAVES = 10  # octaves of the positional encoding
RECIPES = ("default", "paper")  # names of the recipes of training


def encoding_tensors(ndim: int, octaves: int) -> dict[str, np.ndarray]:
    """The positional encoding of the supplement: sine and cosine of ``2^i pi v`` for each coordinate and octave.

    The features are ``sin(weight v + bias)``, ``encoding.weight`` ``(2 n octaves, n)``; 4 octaves give the supplement's 18
    inputs in 2D.
    """
    frequency = np.float32(np.pi) * 2.0 ** np.arange(octaves)
    weight = np.kron(np.kron(frequency[:, None], np.eye(ndim)), np.ones((2, 1)))
    bias = np.tile([0.0, np.pi / 2], ndim * octaves)
    return {"encoding.weight": weight.astype(np.float32), "encoding.bias": bias.astype(np.float32)}


def check_hidden(hidden) -> tuple[int, ...]:
    """Hidden widths as a tuple; raises ``BounderError`` for none, too many, or one that is no whole number in its range."""
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


check_octaves = whole("octaves", 0, MOST_OCTAVES)
_HELP = f"of the hidden layers: {', '.join(ACTIVATIONS)}"
_NOT_PLANES = ("point", "ray", "box")  # networks of planes have neither an encoding nor the paper's recipe
MOST_THRESHOLDS = 65_536  # parts of a domain that have one each (``bounders.local``)

HIDDEN = Option("hidden", (50, 50), "widths of the hidden layers", check_hidden, _widths)
ACTIVATION = Option("activation", DEFAULT.name, _HELP, one_of("activation", ACTIVATIONS))
OCTAVES = Option("octaves", 0, "of positional encoding, 0 for none", check_octaves, int, _NOT_PLANES)
RECIPE = Option(
    "recipe", RECIPES[0], "default, or paper for the paper's schedule", one_of("recipe", RECIPES), queries=_NOT_PLANES
)
THRESHOLDS = Option(
    "thresholds",
    1,
    "parts of the domain, each with a threshold of its own",
    whole("thresholds", 1, MOST_THRESHOLDS),
    int,
    _NOT_PLANES,
)
CERTIFICATES = ("proven", "statistical")
CERTIFICATE = Option(
    "certificate",
    CERTIFICATES[0],
    "proven; or statistical, for a threshold that samples attest where a proof in many dimensions leaves nothing",
    one_of("certificate", CERTIFICATES),
    queries=("point",),
)


class Mlp(tensor_cores.TensorCores, Bounder):
    """A network; *maybe* where its output reaches the threshold.

    Tensors: ``layers.i.weight`` ``(H, K)``, ``layers.i.bias`` ``(H,)``, the last layer with H = 1, or 2 for planes;
    ``encoding.weight`` and ``encoding.bias`` where there is an encoding. Sizes: ``hidden``, ``activation``,
    ``octaves``; older files also hold ``moments``, always false.
    """

    method = "mlp"
    exact_on_cells = False
    options = (HIDDEN, ACTIVATION, OCTAVES, RECIPE, THRESHOLDS, CERTIFICATE, STEPS)
    source_kind: ClassVar[type[MlpSource]] = MlpSource

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return not QUERIES[query].is_region or ndim >= 2

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        return True

    def check_tensors(self) -> None:
        self.hidden = check_hidden(self.sizes.get("hidden", ()))
        self.activation = activation_of(self.sizes.get("activation")).name
        octaves = check_octaves(self.sizes.get("octaves", 0))
        if (moments := self.sizes.get("moments", False)) is not False:
            raise BounderError(f"networks that are given a ray's moments are no longer read, got moments={moments!r}")
        self.head = head_of(self.query_kind)
        raw = self.domain.ndim - self.head.offsets
        self.features = 2 * raw * octaves
        expected = self._shapes()
        if octaves:
            expected |= {"encoding.weight": (self.features, raw), "encoding.bias": (self.features,)}
        self.expect_shapes(expected)
        encoding = (self.tensors["encoding.weight"], self.tensors["encoding.bias"]) if octaves else None
        limit = self.domain.limit[:raw].astype(np.float64)
        self.networks = [Network(self._layers(o), self.activation, encoding, limit) for o in range(self.head.outputs)]

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the tensors, but for the encoding."""
        shapes, sizes = {}, (self.source.inputs, *self.hidden, self.head.outputs)
        for i, (k, h) in enumerate(pairwise(sizes)):
            shapes |= {f"layers.{i}.weight": (h, k), f"layers.{i}.bias": (h,)}
        return shapes

    def _layers(self, output: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
        names = [f"layers.{i}" for i in range(len(self.hidden) + 1)]
        *layers, (weight, bias) = [(self.tensors[f"{name}.weight"], self.tensors[f"{name}.bias"]) for name in names]
        return [*layers, (weight[output : output + 1], bias[output : output + 1])]

    def rebased(self, domain: Domain) -> "Mlp":
        """The same network of points for another domain: the first layer takes the map between the two, rounded to float32.

        It is not proven: its threshold is this one's, and it has no certificate.

        Args:
            domain: The domain that the new network is asked in.

        Raises:
            BounderError: For networks of regions, and those with an encoding of this domain's coordinates.
        """
        if not self.domain.tested_as_point or self.features:
            raise BounderError(
                f"{self.method}: only a network of points without an encoding can be asked in another domain"
            )
        own, scale = self.domain, self.domain.scale.astype(np.float64)
        weight, bias = (self.tensors[f"layers.0.{name}"].astype(np.float64) for name in ("weight", "bias"))
        shift = (domain.center.astype(np.float64) - own.center) * scale
        first = {
            "layers.0.weight": weight * (scale / domain.scale.astype(np.float64)),
            "layers.0.bias": bias + weight @ shift,
        }
        tensors = self.tensors | {name: value.astype(np.float32) for name, value in first.items()}
        return type(self)(domain, tensors, self.sizes, self._device).freeze(float(self.threshold), None)

    @property
    def network(self) -> Network:
        """The network of the first output."""
        return self.networks[0]

    @property
    def source(self) -> MlpSource:
        return self.source_of(self.source_kind, self.hidden, self.activation, self.features)

    def weights(self) -> np.ndarray:
        parts = []
        if self.features:
            parts += [self.tensors["encoding.bias"], self.tensors["encoding.weight"].reshape(-1)]
        parts += [layer_numbers(weight, bias) for weight, bias in self._layers()[:-1]]
        last = f"layers.{len(self.hidden)}"
        return np.concatenate([*parts, head_numbers(self.tensors[f"{last}.weight"], self.tensors[f"{last}.bias"])])

    def reference(self, v: np.ndarray) -> np.ndarray:
        return self.head.value(self.networks, np.asarray(v, dtype=np.float64))

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        if self.head.outputs > 1:
            raise BounderError(f"{self.method}: boxes of {self.query_kind} coordinates are not bounded one by one")
        return self.network.bound(lower, upper)

    def batch_launch(
        self, queries: wp.array, count: int, place: wp.array | None, out: wp.array, *, values: bool = False
    ) -> BlockLaunch:
        numbers = None if values else self.tensor_numbers
        if numbers is None:
            return super().batch_launch(queries, count, place, out, values=values)
        data, source = self.data, self.source
        inputs = [queries, count, 0, data.parameters, data.words, data.parameters if place is None else place, numbers]
        kernel = warp_kernel(source, place is not None, values, tensor_cores.text(source))
        return BlockLaunch(
            kernel, tensor_cores.threads(count), inputs, [out], self.device, first_index=2, block_dim=tensor_cores.BLOCK
        )

    def rounding_bound(self) -> float:
        return self.head.rounding(self.networks, self.domain.limit)
