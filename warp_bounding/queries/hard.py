"""Hard positives by the hundred million, drawn on the device: queries that only just meet the object, each one certainly.

A kernel takes a cell of the object (a boundary cell for the most part) and a point of it, mostly on a face, an edge or a corner,
and builds a query through that point which barely touches: rays that end, begin or graze there, many of them from
outside the domain; boxes that are thin, degenerate or reach outside; planes that are tangent to a connected component's hull,
or given by a point far away. Rounding to float32 may move such a query off the object, so the kernel then checks the rounded
numbers against *that one cell*, by the arithmetic of the oracles: signs of differences are exact (``Coordinate``), everything
else carries an error bound and must be certain. What is not certain is drawn again, and marked if that does not help: it
does not count. No other cell is looked at, which is what makes this fast, and makes it share nothing with a bounder.

Queries in float64 (a caller's numbers, which bounders round) and queries in the world (of a shape that is placed there) are
checked in float64 with an absolute error of ``SLACK`` roundings; their points lie a billionth of a cell inside the cells.

The numbers depend on the seed and the number of the query alone: not on device, threads or how the work is divided.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.geometry.hull import components
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries.region import COORDINATE, RELATIVE_ERROR
from warp_bounding.runtime.launch import BLOCK, launch_blocks
from warp_bounding.runtime.native import named

__all__ = ["FORMS", "HardPositives", "World"]

FORMS = ("float32", "float64", "placed")
TRIES = 12  # draws of one query before it is given up
SLACK = 2.0**-44  # 256 roundings, relative: no float64 quantity here goes through more than 100
INSIDE = 2.0**-30  # of a cell: how far inside its faces float64 points lie
SMALLEST_STEP = 24  # halvings of a quarter of a cell, of the distance of a plane from being tangent


class World(NamedTuple):
    """Where a shape stands, float64: ``world = forward @ object + translation``, and the inverse matrix; time stays as it is."""

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
"""

_POINT = """
const int among = u() < 0.9 ? boundary : all;
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

_DIRECTION = """
double d[N], norm = 0.0;
for (int k = 0; k < N; ++k) {
    d[k] = u() + u() - 1.0;
    const double kind = u();
    if (kind < 0.2) d[k] *= kind < 0.1 ? 0.0 : 1e-3;
    norm += d[k] * d[k];
}
if (!(norm > 1e-12)) { for (int k = 0; k < N; ++k) d[k] = k == 0; norm = 1.0; }
norm = sqrt(norm);
for (int k = 0; k < N; ++k) d[k] /= norm;
double stretch = 1.0;
if (u() < 0.2) stretch = u() < 0.5 ? power(12) : 1.0 / power(12);
"""

_DRAW = {
    "point": "for (int k = 0; k < N; ++k) a[k] = p[k];",
    "ray": _DIRECTION
    + """
const double kind = u();
double t = u() * (u() < 0.5 ? length : length < across ? length : across);
if (kind < 0.3) t = length * (1.0 - 2e-7);
else if (kind < 0.5) t = 0.0;
bool outside = false;
for (int k = 0; k < N; ++k) {
    a[k] = p[k] - t * d[k];
    outside |= a[k] < lower[k] || a[k] > upper[k];
    b[k] = d[k] * stretch;
}
if (outside && u() < 0.5) for (int k = 0; k < N; ++k) a[k] = p[k];
""",
    "plane": _DIRECTION
    + f"""
if (u() < 0.6) {{  // tangent to a component, or a little inside of that
    const int c = (int)(u() * components);
    int best = groups.data[c];
    double most = -1.0e300;
    for (int v = groups.data[c]; v < groups.data[c + 1]; ++v) {{
        double height = 0.0;
        for (int k = 0; k < N; ++k) height += d[k] / map.data[k] * corners.data[(size_t)v * (2 * N) + k];
        if (height > most) most = height, best = v;
    }}
    const double inwards = u() < 0.4 ? inset / fastest : 0.25 / fastest * power({SMALLEST_STEP});
    for (int k = 0; k < N; ++k) {{
        cell[k] = (int)corners.data[(size_t)best * (2 * N) + N + k];
        p[k] = (corners.data[(size_t)best * (2 * N) + k] + map.data[N + k]) / map.data[k] - inwards * d[k];
    }}
}}
double along = 0.0, far = u() < 0.5 ? 0.0 : u() < 0.5 ? 1.0 : 1.0 + 11.0 * u();
for (int k = 0; k < N; ++k) {{ b[k] = lower[k] + u() * (upper[k] - lower[k]) - p[k]; along += b[k] * d[k]; }}
for (int k = 0; k < N; ++k) {{
    b[k] = p[k] + far * (b[k] - along * d[k]);
    a[k] = d[k] * stretch;
}}
""",
    "box": """
const bool slab = u() < 0.5;
for (int k = 0; k < N; ++k) for (int side = 0; side < 2; ++side) {
    const double kind = u(), end = side ? upper[k] : lower[k];
    double share = u() * (kind < 0.5 ? 1e-3 : 1.0);
    if (kind > 0.5 && slab) share = 1.0;
    if (kind < 0.3) share = 0.0;
    if (kind > 0.85) share = 1.0 / power(10);
    (side ? b : a)[k] = share == 0.0 ? p[k] : p[k] + share * (end - p[k]);
}
""",
}

_TO_WORLD = {
    "point": "for (int k = 0; k < N; ++k) q[k] = moved(a, k) + place.data[k];",
    "ray": "for (int k = 0; k < N; ++k) { q[k] = moved(a, k) + place.data[k]; q[N + k] = moved(b, k); }",
    # a normal turns with the transposed inverse
    "plane": """
for (int k = 0; k < N; ++k) {
    q[N + k] = moved(b, k) + place.data[k];
    q[k] = 0.0;
    for (int j = 0; j < N; ++j) q[k] += inverse[j * N + k] * a[j];
}
""",
    # a box of the world around the point: its sides reach as far as the box of the object does
    "box": """
for (int k = 0; k < N; ++k) {
    const double center = moved(p, k) + place.data[k];
    double below = 0.0, above = 0.0;
    for (int j = 0; j < N; ++j) {
        const double size = fabs(forward[k * N + j]);
        below += size * (p[j] - a[j]), above += size * (b[j] - p[j]);
    }
    q[k] = center - below, q[N + k] = center + above;
}
""",
}

# From the numbers as they are handed over, x, to exact cell coordinates: of the first n numbers and of the others.
_OBJECT_FLOAT = """
struct At { Coordinate c; double err; double to(double face) const { return c.to(face); } };
auto at = [&](int from, int k) { At r; r.c = Coordinate((float)x[from + k], map.data[k], map.data[N + k]); r.err = 0.0; return r; };
auto vector = [&](int from, int k) { return (double)x[from + k]; };
auto normal = vector;
auto vector_error = [&](int, int) { return 0.0; };
auto normal_error = vector_error;
"""
_DOUBLE = "struct At { double t, err; double to(double face) const { return face - t; } };"
_OBJECT_DOUBLE = (
    _DOUBLE
    + """
auto at = [&](int from, int k) {
    const double s = (double)x[from + k] * map.data[k];
    At r; r.t = s - map.data[N + k]; r.err = slack * (fabs(s) + fabs(map.data[N + k]) + 1.0); return r;
};
auto vector = [&](int from, int k) { return (double)x[from + k]; };
auto normal = vector;
auto vector_error = [&](int, int) { return 0.0; };
auto normal_error = vector_error;
"""
)
_OBJECT_PLACED = (
    _DOUBLE
    + """
auto at = [&](int from, int k) {
    double sum = 0.0, size = 0.0;
    for (int j = 0; j < N; ++j) {
        sum += inverse[k * N + j] * ((double)x[from + j] - place.data[j]);
        size += fabs(inverse[k * N + j]) * (fabs((double)x[from + j]) + fabs(place.data[j]));
    }
    At r; r.t = sum * map.data[k] - map.data[N + k];
    r.err = slack * (size * map.data[k] + fabs(map.data[N + k]) + 1.0); return r;
};
auto vector = [&](int from, int k) {
    double sum = 0.0;
    for (int j = 0; j < N; ++j) sum += inverse[k * N + j] * (double)x[from + j];
    return sum;
};
auto vector_error = [&](int from, int k) {
    double size = 0.0;
    for (int j = 0; j < N; ++j) size += fabs(inverse[k * N + j] * (double)x[from + j]);
    return slack * size;
};
auto normal = [&](int from, int k) {
    double sum = 0.0;
    for (int j = 0; j < N; ++j) sum += forward[j * N + k] * (double)x[from + j];
    return sum;
};
auto normal_error = [&](int from, int k) {
    double size = 0.0;
    for (int j = 0; j < N; ++j) size += fabs(forward[j * N + k] * (double)x[from + j]);
    return slack * size;
};
"""
)

_CERTAIN = {
    "point": """
for (int k = 0; k < N; ++k) {
    const At c = at(0, k);
    sure &= c.to(cell[k] - 0.5) <= -c.err && c.to(cell[k] + 0.5) >= c.err;
}
""",
    "ray": """
double square = 0.0;
for (int k = 0; k < N; ++k) { const double v = vector(N, k); square += v * v; }
const double last = length / sqrt(square);
double begin_ = 0.0, end_ = last - last * (inset > 0.0 ? slack * 16.0 : rho);
sure = square > 0.0;
for (int k = 0; k < N; ++k) {
    const At c = at(0, k);
    const double err = c.err + last * vector_error(N, k) * map.data[k], v = vector(N, k) * map.data[k];
    const double near = c.to(cell[k] - 0.5) + err, far = c.to(cell[k] + 0.5) - err;
    if (fabs(v) < 1e-280) { sure &= near <= 0.0 && far >= 0.0; continue; }
    const double first_u = (v > 0.0 ? near : far) / v, last_u = (v > 0.0 ? far : near) / v;
    const double a_sure = first_u + fabs(first_u) * rho, b_sure = last_u - fabs(last_u) * rho;
    begin_ = a_sure > begin_ ? a_sure : begin_;
    end_ = b_sure < end_ ? b_sure : end_;
    sure &= near <= far;
}
sure &= begin_ <= end_;
""",
    "plane": """
bool below = false, above = false;
double m[N], me[N];
At c[N];
for (int k = 0; k < N; ++k) c[k] = at(N, k), m[k] = normal(0, k) / map.data[k], me[k] = normal_error(0, k) / map.data[k];
for (int corner = 0; corner < (1 << N); ++corner) {
    double height = 0.0, bound = 0.0;
    for (int k = 0; k < N; ++k) {
        const double reach = c[k].to(cell[k] + ((corner >> k) & 1 ? 0.5 : -0.5)), term = m[k] * reach;
        height += term;
        bound += fabs(term) * rho + (fabs(m[k]) + me[k]) * c[k].err + me[k] * fabs(reach);
    }
    below |= height <= -bound, above |= height >= bound;
}
sure = below && above;
""",
    "box": """
for (int k = 0; k < N; ++k) {
    const At low = at(0, k), high = at(N, k);
    sure &= x[k] <= x[N + k] && low.to(cell[k] + 0.5) >= low.err && high.to(cell[k] - 0.5) <= -high.err;
}
""",
}
_CERTAIN_PLACED_BOX = """
for (int k = 0; k < N; ++k) {  // the point, which lies inside its cell, lies in the box
    double size = fabs(place.data[k]);
    for (int j = 0; j < N; ++j) size += fabs(forward[k * N + j] * p[j]);
    const double center = moved(p, k) + place.data[k];
    sure &= (double)x[k] <= center - slack * size && (double)x[N + k] >= center + slack * size;
    const double t = p[k] * map.data[k] - map.data[N + k];
    sure &= fabs(t - cell[k]) <= 0.5 - slack * (fabs(p[k] * map.data[k]) + fabs(map.data[N + k]) + 1.0);
}
"""


def _snippet(query: str, ndim: int, form: str) -> str:
    placed, columns = form == "placed", ndim if query == "point" else 2 * ndim
    number = "double" if form == "float64" else "float"
    to_world = (
        _TO_WORLD[query] if placed else "for (int k = 0; k < N; ++k) { q[k] = a[k]; if (M > N) q[M - N + k] = b[k]; }"
    )
    read = {"float32": _OBJECT_FLOAT, "float64": _OBJECT_DOUBLE, "placed": _OBJECT_PLACED}[form]
    certain = _CERTAIN_PLACED_BOX if placed and query == "box" else read + _CERTAIN[query]
    return f"""
constexpr int N = {ndim}, M = {columns};
constexpr double rho = {RELATIVE_ERROR.hex()}, slack = {SLACK.hex()}, inset = {(0.0 if form == "float32" else INSIDE).hex()};
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
        {_DRAW[query]}
        {to_world}
        for (int k = 0; k < M; ++k) x[k] = ({number})q[k];
        sure = true;
        {{ {certain} }}
    }}
    certain.data[i] = sure;
}}
"""


@cache
def _kernel(query: str, ndim: int, form: str) -> wp.Kernel:
    name, number = named(f"wb_hard_{query}_{ndim}d_{form}"), wp.float64 if form == "float64" else wp.float32

    @name.func_native(_snippet(query, ndim, form))
    def draw(
        seed: wp.uint64,
        first_number: wp.uint64,
        count: int,
        block: int,
        cells: wp.array(dtype=wp.int32),
        boundary: int,
        all: int,
        map: wp.array(dtype=wp.float64),
        components: int,
        groups: wp.array(dtype=wp.int32),
        corners: wp.array(dtype=wp.float64),
        place: wp.array(dtype=wp.float64),
        length: wp.float64,
        out: wp.array(dtype=number),
        certain: wp.array(dtype=wp.uint8),
    ): ...

    @name.kernel
    def hard_positives(
        # inputs
        seed: wp.uint64,
        first_number: wp.uint64,
        count: int,
        first: int,
        cells: wp.array(dtype=wp.int32),
        boundary: int,
        all: int,
        map: wp.array(dtype=wp.float64),
        components: int,
        groups: wp.array(dtype=wp.int32),
        corners: wp.array(dtype=wp.float64),
        place: wp.array(dtype=wp.float64),
        length: wp.float64,
        # outputs
        out: wp.array(dtype=number),
        certain: wp.array(dtype=wp.uint8),
    ):
        block = first + wp.tid()
        draw(
            seed, first_number, count, block, cells, boundary, all, map, components, groups, corners, place, length,
            out, certain,
        )  # fmt: skip

    return hard_positives


class HardPositives:
    """A stream of hard positives of one object.

    Args:
        query: Kind of query.
        grid: The object.
        length: Of a ray, object units.
        device: Warp device; the default device if ``None``.
    """

    def __init__(self, query: str, grid: IndicatorGrid, length: float = 1.0, device=None):
        self.query, self.grid, self.length, self.device = query, grid, float(length), wp.get_device(device)
        self.columns = grid.ndim * (1 if query == "point" else 2)
        boundary = grid.boundary if len(grid.boundary) else grid.occupied
        self._boundary, self._all = len(boundary), len(grid.occupied)
        self._cells = self._array(np.concatenate([boundary, grid.occupied]), wp.int32)
        self._map = self._array(np.concatenate([grid.cells_per_unit, grid.offset, np.array(grid.shape)]), wp.float64)
        parts = _hulls(grid) if query == "plane" else [np.zeros((1, 2 * grid.ndim))]
        self._components = len(parts)
        self._groups = self._array(np.cumsum([0, *map(len, parts)]), wp.int32)
        self._corners = self._array(np.concatenate(parts), wp.float64)

    def _array(self, values: np.ndarray, dtype) -> wp.array:
        return wp.array(values.reshape(-1), dtype=dtype, device=self.device)

    def draw(
        self, seed: int, first: int, count: int, form: str = "float32", world: World | None = None
    ) -> tuple[wp.array, wp.array]:
        """Queries number ``first`` to ``first + count - 1`` of a seed.

        Args:
            seed: From 0 to 2^64 - 1.
            first: Number of the first.
            count: How many.
            form: ``"float32"``; ``"float64"``: their numbers are not float32; ``"placed"``: in the world, float32.
            world: Where the shape stands, for ``"placed"``.

        Returns:
            ``(count, m)`` float32 or float64, and ``(count,)`` uint8: 1 = certainly meets the object; others do not count.
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
            *(wp.uint64(seed), wp.uint64(first), count, 0, self._cells, self._boundary, self._all, self._map),
            *(self._components, self._groups, self._corners, place, wp.float64(self.length)),
        ]
        kernel = _kernel(self.query, n, form)
        launch_blocks(kernel, count, inputs, [out, certain], self.device, first_index=3)
        return out.reshape((count, self.columns)), certain


def _hulls(grid: IndicatorGrid) -> list[np.ndarray]:
    """For each component ``(V, 2 n)``: hull corners in cell coordinates, and an occupied cell at each."""
    n, found = grid.ndim, []
    padded = np.pad(grid.occupancy, 1)
    for part in components(grid.occupancy):
        corners = part.corners
        cells = np.zeros_like(corners)
        for shift in np.ndindex((2,) * n):
            neighbour = corners - shift
            there = padded[tuple((neighbour + 1).T)]
            cells[there] = neighbour[there]
        found.append(np.concatenate([corners - 0.5, cells], axis=1).astype(np.float64))
    return found
