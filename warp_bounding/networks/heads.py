"""How the outputs of a network become f, by kind of query.

Points, rays and boxes have one output, and that is f. Planes ``m . y = c``: a connected object meets all planes of
normal m whose c lies between two supports of its hull, so the network has two outputs of m alone, ``H`` and ``G``,
and ``f = min(H(m) - c, G(m) + c)``: a learned support function.
"""

from typing import TYPE_CHECKING

import numpy as np

from warp_bounding.arithmetic import TINY, gamma

if TYPE_CHECKING:
    from warp_bounding.networks.network import Network

__all__ = ["Head", "head_of"]


class Head:
    """One output, which is f.

    Attributes:
        outputs: Number of the network's outputs.
        offsets: Number of last entries of ``v`` that the outputs are compared with; the others enter the network.
        finish: C statements from the first two outputs, ``f`` and ``other``, to ``f``; ``OFFSET`` is the index of the
            offset in ``v``.
    """

    outputs = 1
    offsets = 0
    finish = ""

    def value(self, networks: "list[Network]", v: np.ndarray) -> np.ndarray:
        """Exact f ``(N,)`` of coordinates ``(N, n)``, float64; ``networks`` has one for each output."""
        return networks[0](v)

    def rounding(self, networks: "list[Network]", limit: np.ndarray) -> float:
        """Bound of the error of f in float32, where ``|v| <= limit``."""
        return networks[0].rounding


class _Supports(Head):
    outputs = 2
    offsets = 1
    finish = "f = f - v[OFFSET]; other = other + v[OFFSET]; f = other < f ? other : f;"

    def value(self, networks: "list[Network]", v: np.ndarray) -> np.ndarray:
        high, low = (network(v[:, :-1]) for network in networks)
        return np.minimum(high - v[:, -1], low + v[:, -1])

    def rounding(self, networks: "list[Network]", limit: np.ndarray) -> float:
        offset = float(limit[-1])
        return max(n.rounding + gamma(2) * (n.largest + n.rounding + offset) for n in networks) + 2 * TINY


_VALUE, _HEADS = Head(), {"plane": _Supports()}


def head_of(query: str) -> Head:
    """What a network for a kind of query ends with."""
    return _HEADS.get(query, _VALUE)
