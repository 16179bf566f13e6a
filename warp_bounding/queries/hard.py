"""Hard positives by the hundred million, drawn on the device: queries that only just meet the object, but certainly.

A kernel takes a cell of the object (a boundary cell for the most part) and a point of it, mostly on a face, an edge or
a corner, and builds a query through that point which barely touches: rays that end, begin or graze there, many of them
from outside the domain; boxes that are thin, degenerate or reach outside; planes that are tangent to a connected
component's hull, or given by a point far away. Rounding to float32 may move such a query off the object, so the kernel
then checks the rounded numbers against *that one cell*, by the arithmetic of the oracles: signs of differences are
exact (``Coordinate``), everything else carries an error bound and must be certain. What is not certain is drawn again,
and marked if that does not help: it does not count. No other cell is looked at, which is what makes this fast, and
makes it share nothing with a bounder.

Queries in float64 (a caller's numbers, which bounders round) and queries in the world (of a shape that is placed
there) are checked in float64: every quantity has an absolute error of ``DOUBLE_ERROR`` times the sum of the sizes of
all that it is made of. Their points lie ``INSIDE``, a billionth of a cell, inside the cells.

The numbers depend on the seed and the number of the query alone: not on device, threads or how the work is divided.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.queries.base import Query
from warp_bounding.queries.boundary import border_points
from warp_bounding.queries.exact import COORDINATE, RELATIVE_ERROR
from warp_bounding.queries.registry import QUERIES
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.launch import BLOCK, launch_blocks
from warp_bounding.runtime.native import named
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

FORMS = ("float32", "float64", "placed")
TRIES = 12  # draws of one query before it is given up
DOUBLE_ERROR = 2.0**-44  # relative, 512 roundings of float64 (2^-53 each): no quantity here goes through more than 100
INSIDE = 2.0**-30  # of a cell: how far inside its faces the points of float64 and of placed queries lie


class World(NamedTuple):
    """Where a shape stands, float64: ``world = forward @ object + translation``, and the inverse of ``forward``."""

    forward: np.ndarray
    inverse: np.ndarray
    translation: np.ndarray


_RANDOM = """
auto mix = [](unsigned long long z) {  // splitmix64 (Steele, Lea, Flood 2014)
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
};
unsigned long long state = mix(seed + 0x9e3779b97f4a7c15ull) ^ mix((first_number + (unsigned long long)i) * 0xd1342543de82ef95ull + 1ull);
auto u = [&]() { state += 0x9e3779b97f4a7c15ull; return (double)(mix(state) >> 11) * 0x1p-53; };
auto power = [&](int most) {  // 2^0 to 2^-most
    double value = 1.0;
    for (int left = (int)(u() * (most + 1)); left > 0; --left) value *= 0.5;
    return value;
};
"""  # noqa: E501

_POINT = """
const int among = u() < 0.9 ? boundary : occupied;
const int chosen = (among == boundary ? 0 : boundary) + (int)(u() * among);
int cell[N];
double p[N];  // object space
for (int k = 0; k < N; ++k) {
    cell[k] = cells.data[(size_t)chosen * N + k];
    double away = u() - 0.5;
    if (u() < 0.6) away = away < 0.0 ? -0.5 : 0.5;
    p[k] = (cell[k] + away * (1.0 - 2.0 * inset) + map.data[N + k]) / map.data[k];
}
"""

# From the numbers x, as they are handed over, to what ``Query.hard_certain`` reads: ``at(from, k)`` is cell coordinate
# k of the point that begins at x[from], with the distance ``to`` a face and an absolute error ``err``; ``vector`` and
# ``normal`` are entry k of a direction or a normal in object space, with absolute errors.
_OWN = """
auto vector = [&](int from, int k) { return (double)x[from + k]; };
auto normal = vector;
auto vector_error = [&](int, int) { return 0.0; };
auto normal_error = vector_error;
"""
_OBJECT_FLOAT = f"""
struct At {{ Coordinate c; double err; double to(double face) const {{ return c.to(face); }} }};
auto at = [&](int from, int k) {{
    return At{{Coordinate((float)x[from + k], map.data[k], map.data[N + k]), 0.0}};
}};
{_OWN}"""
_DOUBLE = "struct At { double t, err; double to(double face) const { return face - t; } };"
_OBJECT_DOUBLE = f"""{_DOUBLE}
auto at = [&](int from, int k) {{
    const double s = (double)x[from + k] * map.data[k];
    return At{{s - map.data[N + k], slack * (fabs(s) + fabs(map.data[N + k]) + 1.0)}};
}};
{_OWN}"""
_OBJECT_PLACED = f"""{_DOUBLE}
auto at = [&](int from, int k) {{
    double sum = 0.0, size = 0.0;
    for (int j = 0; j < N; ++j) {{
        sum += inverse[k * N + j] * ((double)x[from + j] - place.data[j]);
        size += fabs(inverse[k * N + j]) * (fabs((double)x[from + j]) + fabs(place.data[j]));
    }}
    return At{{sum * map.data[k] - map.data[N + k], slack * (size * map.data[k] + fabs(map.data[N + k]) + 1.0)}};
}};
auto vector = [&](int from, int k) {{
    double sum = 0.0;
    for (int j = 0; j < N; ++j) sum += inverse[k * N + j] * (double)x[from + j];
    return sum;
}};
auto vector_error = [&](int from, int k) {{
    double size = 0.0;
    for (int j = 0; j < N; ++j) size += fabs(inverse[k * N + j] * (double)x[from + j]);
    return slack * size;
}};
auto normal = [&](int from, int k) {{
    double sum = 0.0;
    for (int j = 0; j < N; ++j) sum += forward[j * N + k] * (double)x[from + j];
    return sum;
}};
auto normal_error = [&](int from, int k) {{
    double size = 0.0;
    for (int j = 0; j < N; ++j) size += fabs(forward[j * N + k] * (double)x[from + j]);
    return slack * size;
}};
"""


# One query: ``_POINT`` chooses a cell and a point p of it; ``Query.hard_draw`` makes of it the two halves a and b of a
# query in object space, with random numbers u() and power(most) and the domain's lower and upper corners, its diagonal
# ``across`` and the largest of its cells per unit, ``fastest``. From a and b the query's numbers q are made, in the
# world or not, and x is q rounded as the form says. ``Query.hard_certain`` then clears ``sure`` unless x meets the cell
# for certain. ``map`` is cells per unit, offset and number of cells on each axis.
def _snippet(kind: Query, ndim: int, form: str) -> str:
    placed, columns = form == "placed", kind.columns(ndim)
    number = "double" if form == "float64" else "float"
    numbers = (  # from a and b to q
        kind.hard_to_world if placed else "for (int k = 0; k < N; ++k) { q[k] = a[k]; if (M > N) q[M - N + k] = b[k]; }"
    )
    read = {"float32": _OBJECT_FLOAT, "float64": _OBJECT_DOUBLE, "placed": _OBJECT_PLACED}[form]
    certain = (placed and kind.hard_certain_placed) or read + kind.hard_certain
    return f"""
constexpr int N = {ndim}, M = {columns};
constexpr double rho = {RELATIVE_ERROR.hex()}, slack = {DOUBLE_ERROR.hex()};
constexpr double inset = {(0.0 if form == "float32" else INSIDE).hex()};
{COORDINATE}
#if defined(__CUDA_ARCH__)
const int begin = block; const int end = block < count ? block + 1 : count;
#else
const int begin = block * {BLOCK}; const int end = begin + {BLOCK} < count ? begin + {BLOCK} : count;
#endif
const double* forward = place.data + N; const double* inverse = forward + N * N;
auto moved = [&](const double* v, int k) {{
    double sum = 0.0;
    for (int j = 0; j < N; ++j) sum += forward[k * N + j] * v[j];
    return sum;
}};
double lower[N], upper[N], across = 0.0, fastest = 0.0;
for (int k = 0; k < N; ++k) {{
    lower[k] = (map.data[N + k] - 0.5) / map.data[k];
    upper[k] = (map.data[2 * N + k] + map.data[N + k] - 0.5) / map.data[k];
    across += (upper[k] - lower[k]) * (upper[k] - lower[k]);
    fastest = map.data[k] > fastest ? map.data[k] : fastest;
}}
across = sqrt(across);
for (int i = begin; i < end; ++i) {{
    {_RANDOM}
    {number}* x = out.data + (size_t)i * M;
    bool sure = false;
    for (int attempt = 0; attempt < {TRIES} && !sure; ++attempt) {{
        double a[N], b[N], q[2 * N];
        {_POINT}
        {kind.hard_draw}
        {numbers}
        for (int k = 0; k < M; ++k) x[k] = ({number})q[k];
        sure = true;
        {{ {certain} }}
    }}
    certain.data[i] = sure;
}}
"""


@cache
def _kernel(kind: Query, ndim: int, form: str) -> wp.Kernel:
    name, number = named(f"wb_hard_{kind.name}_{ndim}d_{form}"), wp.float64 if form == "float64" else wp.float32

    @name.block_kernel(_snippet(kind, ndim, form))
    def hard_positives(
        seed: wp.uint64,
        first_number: wp.uint64,
        count: int,
        block: int,
        cells: wp.array(dtype=wp.int32),
        boundary: int,
        occupied: int,
        map: wp.array(dtype=wp.float64),
        components: int,
        groups: wp.array(dtype=wp.int32),
        corners: wp.array(dtype=wp.float64),
        place: wp.array(dtype=wp.float64),
        length: wp.float64,
        out: wp.array(dtype=number),
        certain: wp.array(dtype=wp.uint8),
    ): ...

    return hard_positives


class HardPositives:
    """A stream of hard positives of one object; a ray has ``length``, in object units."""

    def __init__(self, query: str, grid: Grid, length: float = 1.0, device=None):
        self.query, self.grid, self.length, self.device = query, grid, float(length), wp.get_device(device)
        self.kind, self.placeable = QUERIES[query], True
        self.columns = self.kind.columns(grid.ndim)
        boundary = grid.boundary if len(grid.boundary) else grid.occupied
        self._boundary, self._occupied = len(boundary), len(grid.occupied)
        # Boundary cells, then all occupied ones; cells per unit, offset and number of cells on each axis; and of each
        # component of the object the rows of ``Query.hulls``, with the number of the row at which each begins.
        self._cells = self._array(np.concatenate([boundary, grid.occupied]), wp.int32)
        self._map = self._array(np.concatenate([grid.cells_per_unit, grid.offset, np.array(grid.shape)]), wp.float64)
        parts = self.kind.hulls(grid)
        self._components = len(parts)
        self._groups = self._array(np.cumsum([0, *map(len, parts)]), wp.int32)
        self._corners = self._array(np.concatenate(parts), wp.float64)

    def _array(self, values: np.ndarray, dtype) -> wp.array:
        return wp.array(values.reshape(-1), dtype=dtype, device=self.device)

    def draw(
        self, seed: int, first: int, count: int, form: str = "float32", world: World | None = None
    ) -> tuple[wp.array, wp.array]:
        """Queries number ``first`` to ``first + count - 1`` of a seed, from 0 to 2^64 - 1.

        The form is ``"float32"``; ``"float64"``: their numbers are not float32; ``"placed"``: where the shape stands in
        the ``world``, float32.

        Returns:
            ``(count, m)`` float32 or float64, and ``(count,)`` uint8: 1 = certainly meets the object; others do not
                count.
        """
        n = self.grid.ndim
        world = world or World(np.eye(n), np.eye(n), np.zeros(n))
        place = self._array(
            np.concatenate([world.translation, world.forward.ravel(), world.inverse.ravel()]), wp.float64
        )
        number = wp.float64 if form == "float64" else wp.float32
        out = wp.empty(count * self.columns, dtype=number, device=self.device)
        certain = wp.empty(count, dtype=wp.uint8, device=self.device)
        inputs = [
            *(wp.uint64(seed), wp.uint64(first), count, 0, self._cells, self._boundary, self._occupied, self._map),
            *(self._components, self._groups, self._corners, place, wp.float64(self.length)),
        ]
        kernel = _kernel(self.kind, n, form)
        launch_blocks(kernel, count, inputs, [out, certain], self.device, first_index=3)
        return out.reshape((count, self.columns)), certain


# Hard positives of a shape without cells: points of its border, moved by less and less, and regions that pass these.
#
# Each is checked by the shape, which counts only what certainly meets it.
#
# The stream depends on the seed alone, as that of ``hard`` does: the pool of border points belongs to the seed, and
# query i is a pool point and a move that belong to (seed, chunk of i).

POOL = 1 << 17  # border points
MOVES = (2.0**-26, 2.0**-8)  # of the shape's longest side: the least and the largest move
STILL = 0.25  # share of queries that are the border points themselves


class HardShapePositives:
    """A stream of hard positives of one shape, as ``HardPositives`` is of a grid.

    Raises ``QueryError`` if the shape cannot tell which regions of this kind meet it.
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


# Random positives, half of them where bounders fail first: what statistics about false negatives are drawn from.
#
# Half are the protocol's own random queries whose truth is *yes* (fewer where hardly any is: both proposals are then
# drawn equally often, and all of their positives are taken); the other half pass a random point of the object, on
# faces, edges and corners of its boundary cells for the most part, and barely: rays that begin or end there or lie in
# a face, boxes that are thin, small or only touch, slabs that reach the domain's border, planes through it. What a
# bounder clips is among them: rays that start outside the domain, boxes that reach out of it, planes given by a point
# outside, directions of any length. Every one is checked by the exact oracle after its numbers were rounded to
# float32.

RARE = 0.05  # of the draws: where fewer meet the object, all that do are taken, not as many of either half
CHUNK = 200_000  # draws of either half at a time
SNAPPED = 0.6  # share of a point's coordinates that lie on a face of its cell


def draw_positives(
    query: str,
    grid: Grid,
    count: int,
    seed: int | Sequence[int],
    device=None,
    length=1.0,
    *,
    outside: bool = True,
) -> Iterator[np.ndarray]:
    """Fresh independent positives ``(N, m)`` float32, in chunks, at least ``count`` of them.

    With ``outside``, queries that are given by points outside the domain are among them.
    """
    rng = np.random.default_rng([*([seed] if isinstance(seed, (int, np.integer)) else seed), 20_24])
    kind = QUERIES[query]
    pool = np.empty((0, grid.ndim)) if isinstance(grid, Grid) else border_points(grid, POOL, rng)
    truth, done, rare = kind.oracle(grid, device, length), 0, None
    while done < count:
        uniform = kind.sample(grid, CHUNK, rng)
        points = pool[rng.integers(len(pool), size=CHUNK)] if len(pool) else _boundary_points(grid, CHUNK, rng)
        hard = kind.barely(grid, points, rng, length, outside).astype(np.float32)
        uniform, hard = uniform[truth(uniform)], hard[truth(hard)]
        half = min(len(uniform), len(hard))
        if rare is None:  # decided once: the distribution is the same in all chunks
            rare = half < RARE * CHUNK
        part = np.concatenate([uniform, hard] if rare else [uniform[:half], hard[:half]])
        done += len(part)
        yield part


def _boundary_points(grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, n)`` float64 points of the object, object space."""
    cells = grid.boundary if len(grid.boundary) else grid.occupied
    cells = np.where(
        rng.random((count, 1)) < 0.9, *(c[rng.integers(len(c), size=count)] for c in (cells, grid.occupied))
    )
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    offset = np.where(rng.random(cells.shape) < SNAPPED, np.copysign(0.5, offset), offset)
    return grid.position(cells + offset)
