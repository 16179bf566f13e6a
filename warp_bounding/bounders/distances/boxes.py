"""The distance to the leaves of a hierarchy of boxes: ``bvh``, exact but for rounding and for what rounds the boxes outwards.

Nodes lie in depth-first order, each with the index behind its subtree, so that a walk is a loop over one number. A query first goes down to a leaf, always to the child
that is nearest, and then through all nodes that are nearer than the nearest leaf so far. Lanes share both walks: they go down where the first lane goes,
and leave out what is far for all of them.

Every point of the object lies in a leaf *and* in all nodes above it, as the bounder of points denies nothing else. So where a node is not nearer than a leaf that was
found, no point of the object below it is, either.

*Rounding*: the way to a box is the larger of two differences on each axis, off by ``u (|v_k| + |corner|)``; n of them by ``root(n)`` times as much, and
squares, sum and root by ``(n + 4) u`` of the result. That the way is short for some nodes decides only which are asked, up to a factor ``1 + 2 (n + 4) u`` that
the result's own rounding has room for.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.arithmetic import UNIT32, round_down, round_up
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.bvh import Bvh
from warp_bounding.bounders.distances.volume import NOISE, Form, VolumeDistance
from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.box_distances import BoxDistances
from warp_bounding.kernels.distances.source import DistanceSource
from warp_bounding.kernels.source import Lanes, fill

__all__ = ["BvhDistance", "BvhDistanceSource"]

FARTHEST = 3e38  # a squared distance that nothing is farther than

_BODY = """
{
    const int count = (int)w[0];
    const auto way = [&](int i) {
        const float* b = w + 1 + i * (2 * N + 1);  // low, high, past
        V sum = zero;
#pragma unroll
        for (int k = 0; k < N; ++k) {
            const V out = most(most(b[k] - v[k], v[k] - b[N + k]), zero);
            sum = sum + out * out;
        }
        return sum;
    };
    const auto past = [&](int i) { return (int)w[1 + i * (2 * N + 1) + 2 * N]; };
    V nearest = zero + $farthest;
    int i = 0;
    while (past(i) > i + 1) {  // down to the leaf that is near the first lane
        int best = i + 1;
        float nearer = $farthest;
        for (int child = i + 1; child < past(i); child = past(child)) {
            const V there = way(child);
            const float first = $first;
            if (first < nearer) { nearer = first; best = child; }
        }
        i = best;
    }
    nearest = least(nearest, way(i));
    i = 0;
    while (i < count) {
        const V there = way(i);
        const int behind = past(i);
        if ($none) {
            i = behind;
        } else {
            if (behind == i + 1) nearest = least(nearest, there);
            ++i;
        }
    }
    f = root(nearest);
}
"""


@dataclass(frozen=True)
class BvhDistanceSource(DistanceSource):
    """Native code of the walk. Numbers: how many nodes; per node low, high and past."""

    def body(self, lanes: Lanes) -> str:
        first, none = (
            ("there[0]", "!__builtin_reduce_or(there < nearest)") if lanes.vector else ("there", "!(there < nearest)")
        )
        return fill(_BODY, first=first, none=none, farthest=f"{FARTHEST:g}f")


class BvhDistance(VolumeDistance):
    """The distance to the leaves; see module."""

    method, bounds = Bvh.method, Bvh

    @classmethod
    def form_of(cls, volume: Bounder, domain: DistanceDomain) -> Form:
        if not float(volume.threshold) > -1:
            raise BounderError(f"{cls.method}: the threshold leaves nothing out")
        n, own = domain.ndim, volume.domain
        per_unit, to_unit = own.scale.astype(np.float64), domain.scale.astype(np.float64)
        apart = own.center.astype(np.float64) - domain.center.astype(np.float64)
        low, high = (volume.tensors[name].astype(np.float64) / per_unit + apart for name in ("low", "high"))
        room = NOISE * (np.abs(low).max() + np.abs(high).max() + np.abs(apart).max())
        low, high = round_down((low - room) * to_unit), round_up((high + room) * to_unit)
        nodes = np.concatenate([low, high, volume.tensors["past"][:, None]], axis=1)
        numbers = np.concatenate([[len(nodes)], nodes.reshape(-1)]).astype(np.float32)
        leaves = volume.leaves
        distances = BoxDistances(low[leaves].astype(np.float64), high[leaves].astype(np.float64))
        largest, root = max(float(np.abs(low).max()), float(np.abs(high).max())), float(np.sqrt(n))

        def reference(v: np.ndarray) -> np.ndarray:
            return distances(v)[:, 0]

        return Form(BvhDistanceSource(n, False), numbers, root * 2 * UNIT32 * largest, root * 2 + 2 * n + 12, reference)
