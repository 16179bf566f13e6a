"""Hard positives of a shape without cells: points of its border, moved by less and less, and regions that pass these.

Each is checked by the shape, which counts only what certainly meets it.

The stream depends on the seed alone, as that of ``hard`` does: the pool of border points belongs to the seed, and query
i is a pool point and a move that belong to (seed, chunk of i).
"""

import numpy as np
import warp as wp

from warp_bounding.arithmetic import UNIT32
from warp_bounding.errors import QueryError
from warp_bounding.indicators.shape import IN, Shape
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.hard import World
from warp_bounding.queries.registry import QUERIES

__all__ = ["HardShapePositives"]

POOL = 1 << 17  # border points
MOVES = (2.0**-26, 2.0**-8)  # of the shape's longest side: the least and the largest move
STILL = 0.25  # share of queries that are the border points themselves


class HardShapePositives:
    """A stream of hard positives of one shape, as ``hard.HardPositives`` is of a grid.

    Args:
        query: Kind of query.
        shape: The object.
        length: Of a ray, object units.
        device: Warp device of the queries; the default device if ``None``.

    Raises:
        QueryError: If the shape cannot tell which regions of this kind meet it.
    """

    def __init__(self, query: str, shape: Shape, length: float = 1.0, device=None):
        self.kind = QUERIES[query]
        if not self.kind.decides(shape):
            raise QueryError(f"{shape.name}: cannot tell which {query} queries meet it; give a resolution")
        self.query, self.shape, self.length, self.device = query, shape, float(length), wp.get_device(device)
        self.columns, self.placeable = self.kind.columns(shape.ndim), not self.kind.is_region
        self._seed, self._pool = None, None

    def draw(
        self, seed: int, first: int, count: int, form: str = "float32", world: World | None = None
    ) -> tuple[wp.array, wp.array]:
        """See ``HardPositives.draw``; regions are not placed in the world."""
        if seed != self._seed:
            self._seed, self._pool = seed, border_points(self.shape, POOL, np.random.default_rng([seed, 5]))
        rng, n = np.random.default_rng([seed, first]), self.shape.ndim
        x = self._pool[rng.integers(POOL, size=count)]
        size = np.exp2(rng.uniform(*np.log2(MOVES), count)) * float(self.shape.extent.max())
        x = x + (rng.random(count) >= STILL)[:, None] * size[:, None] * rng.uniform(-1, 1, (count, n))
        if form == "placed":
            q = (x @ world.forward.T + world.translation).astype(np.float32)
            back = (q.astype(np.float64) - world.translation) @ world.inverse.T
            terms = (np.abs(q) + np.abs(world.translation)) @ np.abs(world.inverse).T
            room = UNIT32 * 2.0**-20 * terms  # of the way back in float64: generous
            certain = self.shape.inside(back - room, back + room)
        else:
            q = self.kind.barely(self.shape, x, rng, self.length, True)
            q = q if form == "float64" else q.astype(np.float32)
            certain = self.kind.decide(self.shape, q, self.length) == IN
        number = wp.float64 if form == "float64" else wp.float32
        arrays = (np.ascontiguousarray(q), number), (certain.astype(np.uint8), wp.uint8)
        return tuple(wp.array(values, dtype=dtype, device=self.device) for values, dtype in arrays)
