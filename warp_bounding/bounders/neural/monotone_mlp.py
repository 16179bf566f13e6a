"""``monotone-mlp``: a network for boxes whose f never falls as a box grows, so that points suffice to prove it.

Positives are an up-set: a box that holds one that meets the object meets it too. The network knows that: with ``v =
(low, high)``, f is nonincreasing in low and nondecreasing in high, by the signs of its weights alone. Every positive
holds a point p of the object, ``low <= p <= high``, so ``f(low, high) >= f(p, p)``, and the least f over all
positives is the least over the points of the object: a proof in n dimensions instead of 2 n (``point_network``,
``proof.covers.monotone_box``).

Signs: a neuron rises or falls as the box grows, and a weight leads a rising neuron into another by a number that is
not negative, a falling one by one that is not positive; low falls, high rises, f rises. Any monotone activation will
do. For tanh, which is odd, falling neurons add nothing; a ReLU that falls, counted negatively, is concave (Runje and
Shankaranarayana, *Constrained Monotonic Neural Networks*, 2023). Networks of other signs do not load.

Exact arithmetic is monotone and float32 need not be; but the computed f is within ``rounding_bound`` of the exact
one, for every box, and a threshold must leave room for that alone.
"""

from functools import cached_property

import numpy as np

from warp_bounding.activations import ACTIVATIONS, DEFAULT, activation_of
from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.bounders.neural.mlp import HIDDEN, Mlp
from warp_bounding.bounders.options import STEPS, Option
from warp_bounding.coordinates.domain import GROWTH
from warp_bounding.errors import BounderError
from warp_bounding.networks.network import Network
from warp_bounding.queries.box import BOX

__all__ = ["MonotoneMlp"]


def _monotone(activation) -> str:
    """The name of the activation that a monotone network has in the place of this one, which may fall."""
    return activation_of(activation).monotone.name


def _help() -> str:
    """The words of the option: activations that never fall, and what stands in for the others."""
    never, falling = ([a for a in ACTIVATIONS.values() if (a.monotone is a) == own] for own in (True, False))
    others = "".join(f"; {a.monotone.name} stands in for {a.name}" for a in falling)
    return f"{' or '.join(a.name for a in reversed(never))}{others}"


class MonotoneMlp(Mlp):
    """A network of box queries whose f never falls as a box grows; see the module and ``Mlp``.

    Tensors and sizes: those of ``Mlp``, no encoding.

    Attributes:
        signs: For each hidden layer ``(H,)``: 1 where a neuron rises with the box, -1 where it falls, 0 where it has no
            say.
    """

    method = "monotone-mlp"
    options = (HIDDEN, Option("activation", DEFAULT.monotone.name, _help(), _monotone), STEPS)

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return query == BOX.name and super().supports(query, ndim)

    @classmethod
    def takes_shapes(cls, query: str) -> bool:
        return True  # it is proven over the object's points

    def check_tensors(self) -> None:
        """See ``Mlp``; refuses also tensors of which f would not be monotone."""
        super().check_tensors()
        if self.features or _monotone(self.activation) != self.activation:
            raise BounderError(
                f"{self.method} takes no octaves, and activations that never fall ({_help()}), got "
                f"octaves={self.sizes.get('octaves', 0)} and {self.activation}"
            )
        self.signs = self._signs()

    def _signs(self) -> list[np.ndarray]:
        """Which way each neuron goes, found from the output down; raises ``BounderError`` where one goes both ways."""
        sign, signs = np.ones(1), []
        for index in range(len(self.hidden), -1, -1):
            ways = sign[:, None] * np.sign(self.tensors[f"layers.{index}.weight"].astype(np.float64))
            rises, falls = (ways > 0).any(axis=0), (ways < 0).any(axis=0)
            if index == 0:  # the inputs' own ways are known
                rises[self.ndim :], falls[: self.ndim] = False, False
            if (rises & falls).any() or (index == 0 and (rises | falls).any()):
                wrong = f"a weight in layers.{index}.weight has the wrong sign"
                raise BounderError(f"{self.method}: {wrong}, f would not be monotone")
            sign = rises.astype(np.float64) - falls
            signs.insert(0, sign)
        return signs[1:]

    @cached_property
    def point_network(self) -> Network:
        """A network g of points, local space: ``g(p) <= f(low, high)`` for all that is computed of a box that holds p.

        The input error moves a box's corners by delta at most, to ``low <= p + delta`` and ``high >= p - delta``, and
        clipping to the domain, in which p lies, leaves it at that. So ``g(p) = f(p + delta, p - delta)``: a first
        layer with the sum of both halves' weights, and a bias that is moved. The float64 rounding of these numbers,
        and of p (as in ``Domain.widened``), moves it a little further.
        """
        base, n = self.domain.base, self.ndim
        layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in self._layers()]
        weight, bias = layers[0]
        size = np.abs(weight[:, :n]) + np.abs(weight[:, n:])
        delta = base.delta * GROWTH + 1e-15 * (1 + np.abs(base.to_local(base.lower)))
        limit = base.limit.astype(np.float64)
        rounding = gamma(8 * n + 16, UNIT64) * (np.abs(bias) + size @ (limit + delta))
        moved = bias - self.signs[0] * (size @ delta + rounding)
        layers[0] = (weight[:, :n] + weight[:, n:], moved)
        return Network(layers, self.activation, None, limit)
