"""``local``: a network with a threshold of its own in each part of the domain, so that its worst place sets one price.

The coordinates v are cut along each axis at *edges*, into a lattice of parts. Each part has a *level*, one byte: the
threshold that f must reach there; or that no positive lies in the part at all, or hardly anything else, and the network
is not even asked. f less the threshold of v's part is the f of this class; it jumps at the edges, and so proofs cut their boxes there (``cut``);
those of rays and boxes, whose boxes are not of v, search each part by itself (``proof.parts``).
"""

from functools import cached_property
from math import prod

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32, gamma
from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.local.lattice import Lattice, packed, unpacked
from warp_bounding.bounders.local.source import CERTAIN, EVERYWHERE, NOWHERE, LocalSource
from warp_bounding.bounders.members import holding, members_of
from warp_bounding.bounders.neural.mlp import MOST_THRESHOLDS, Mlp
from warp_bounding.bounders.registry import composed
from warp_bounding.errors import BounderError
from warp_bounding.kernels.lattice import PER_WORD
from warp_bounding.kernels.source import DENIED
from warp_bounding.networks.heads import head_of

__all__ = ["Lattice", "Local"]

LEVELS = EVERYWHERE  # how many levels are thresholds
STEPS = (2.0**-60, 2.0**30)  # between two levels
MOST_NUMBER = 2.0**22  # of the first level: sums with a level stay whole numbers that float32 holds


@composed
class Local(Bounder):
    """A network at thresholds of the parts of its domain.

    Tensors: the network's, each under ``0.`` and its role there; ``edges``, the inner edges of each axis in turn;
    ``levels`` ``(ceil(parts / 4),)`` uint32, a byte for each part, which can be ``NOWHERE`` or ``EVERYWHERE``; ``scale``
    ``(2,)``, the whole number of the first level, and the step, a power of two. Sizes: ``parts``, the network's ``method`` and
    ``sizes``; ``shape``.
    """

    method = "local"
    exact_on_cells = False
    bit_fields = ("levels",)

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return Mlp.supports(query, ndim) and head_of(query).outputs == 1

    @classmethod
    def of(cls, member: Mlp, lattice: Lattice, thresholds: np.ndarray, step: float) -> "Local":
        """A network at thresholds ``(parts,)``, each rounded down to a level, as far at least as the lowest one.

        So the lowest one loses nothing, once what all are too low by is made the bounder's own threshold.

        Args:
            member: The network; its own threshold is not used.
            lattice: The parts.
            thresholds: In array order of the parts; infinity where no positive lies, minus infinity where no query is
                to be denied.
            step: Between two levels, a power of two. The highest level stands for all thresholds above it.

        Raises:
            BounderError: If the thresholds cannot be told apart by float32 in such steps.
        """
        some = np.isfinite(thresholds)
        least = float(thresholds[some].min()) if some.any() else 0.0
        first = np.floor(least / step)
        levels = np.where(thresholds > 0, NOWHERE, EVERYWHERE).astype(np.uint8)
        levels[some] = np.clip(np.floor((thresholds[some] - least) / step), 0, LEVELS - 1)
        tensors, sizes = holding([member])
        scale = np.array([first, step], np.float32)
        tensors |= {"edges": np.concatenate(lattice.edges), "levels": packed(levels), "scale": scale}
        return cls(member.domain, tensors, sizes | {"shape": list(lattice.shape)}, member._device)

    def check_tensors(self) -> None:
        shape = self.sizes.get("shape")
        whole = isinstance(shape, list) and all(type(count) is int and count >= 1 for count in shape)
        if not whole or len(shape) != self.domain.ndim or prod(shape) > MOST_THRESHOLDS:
            raise BounderError(
                f"{self.method}: expected {self.domain.ndim} counts, at most {MOST_THRESHOLDS} parts, got {shape!r}"
            )
        self.members, shapes = members_of(self, 1, 1, lambda kind: kind is Mlp)
        (self.member,) = self.members
        expected = {"edges": (sum(shape) - len(shape),), "levels": (-(-prod(shape) // PER_WORD),), "scale": (2,)}
        self.expect_shapes(shapes | expected)
        self.lattice = Lattice.stored(self.tensors["edges"], shape, self.method)
        first, step = (float(x) for x in self.tensors["scale"])
        if not (
            STEPS[0] <= step <= STEPS[1]
            and np.frexp(step)[0] == 0.5
            and first == np.floor(first)
            and abs(first) <= MOST_NUMBER
        ):
            raise BounderError(f"{self.method}: expected a whole number and a power of two, got {first} and {step}")
        self.check_range()

    @cached_property
    def thresholds(self) -> np.ndarray:
        """``(parts,)`` float64, exact; infinity where every query is denied, minus infinity where none is."""
        levels = unpacked(self.tensors["levels"], self.lattice.count).astype(np.float64)
        first, step = self.tensors["scale"].astype(np.float64)
        named = {NOWHERE: np.inf, EVERYWHERE: -np.inf}
        return np.select([levels == level for level in named], list(named.values()), (levels + first) * step)

    @property
    def source(self) -> LocalSource:
        return self.source_of(LocalSource, self.member.source, len(self.member.weights()), self.lattice.shape)

    def weights(self) -> np.ndarray:
        return np.concatenate([self.member.weights(), self.tensors["edges"], self.tensors["scale"]])

    def words(self) -> np.ndarray:
        return self.tensors["levels"]

    def cut(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.lattice.cut(lower, upper)

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        return np.clip(self.member.reference(v) - self.thresholds[self.lattice.place(v)], DENIED, CERTAIN)

    def thresholds_in(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The least and the largest threshold of the parts that boxes ``(N, n)`` meet, and which boxes meet one only."""
        return self.lattice.extremes(self.thresholds, lower, upper)

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``. A box inside one part has the part's threshold everywhere, on its upper sides too."""
        bounds = self.member.bound(lower, upper)
        _, most, single = self.thresholds_in(lower, upper)
        # Not cut at DENIED: a part that is denied by its level is, whatever the threshold.
        least = np.minimum(np.nextafter(bounds.lower - most, -np.inf), CERTAIN)
        value = np.where(single, np.clip(bounds.value - most, DENIED, CERTAIN), self.reference(bounds.point))
        # The network's slopes are not those of this f, which is less by the threshold of the part.
        return BoxBounds(least, bounds.axis, bounds.point, value, bounds.next_axis)

    def rounding_bound(self) -> float:
        network, some = self.member.network, self.thresholds[np.isfinite(self.thresholds)]
        error = self.member.rounding_bound()
        size = network.largest + error + np.abs(some).max(initial=0.0)  # of f less a threshold, which rounds once
        return (error + gamma(2) * size + 2 * TINY) * (1 + 4 * UNIT32)
