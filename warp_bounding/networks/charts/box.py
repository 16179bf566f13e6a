"""Boxes that meet an object: ``z = (low, high)`` in cells, cut to where it can hold a positive.

Of all boxes in a box of z, the largest is (least low, greatest high). If it meets no occupied cell, none does; if it
does, low need not go above the occupied cells in it, nor high below them. Occupied cells are counted by a summed-area
table, and only those that the box overlaps in their interior. Positives that only touch a cell are limits of others,
which the neighbouring boxes hold.

The network's inputs are ``z`` times a cell's size; computed boxes are off by ``delta``: noise. ``low <= high`` is a
constraint.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.networks.charts.base import Chart

__all__ = ["BoxChart"]


@dataclass(frozen=True)
class BoxChart(Chart):
    """The chart of boxes.

    ``numbers``, n of each: the cells' size, the origin (local position of cell 0's centre), and noise. ``table``: shape
    (n), strides (n), the summed-area table.
    """

    expand = """
constexpr int N = K / 2;
const int* shape = table.data; const int* stride = shape + N; const int* cells = stride + N;
const auto occupied = [&](const int* first, const int* last) {  // cells from first to one before last
    int sum = 0;
#pragma unroll
    for (int corner = 0; corner < 1 << N; ++corner) {
        int place = 0, sign = 1;
        for (int k = 0; k < N; ++k) {
            const bool upper = (corner >> k) & 1;
            place += (upper ? last[k] : first[k]) * stride[k];
            sign = upper ? sign : -sign;
        }
        sum += sign * cells[place];
    }
    return sum;
};
const auto cut = [&](int* first, int* last) {  // to the grid; whether cells are left
    bool some = true;
    for (int k = 0; k < N; ++k) {
        first[k] = first[k] < 0 ? 0 : first[k]; last[k] = last[k] > shape[k] ? shape[k] : last[k];
        some = some && first[k] < last[k];
    }
    return some;
};
dead = zero;
for (int l = 0; l < L; ++l) {
    int a[N], b[N];  // the cells that the largest box overlaps: a to b - 1
    for (int k = 0; k < N; ++k) a[k] = (int)floor(LANE(low[k]) + 0.5), b[k] = (int)ceil(LANE(high[N + k]) + 0.5);
    if (!cut(a, b) || occupied(a, b) == 0) { LANE(dead) = 1.0; continue; }
#pragma unroll
    for (int k = 0; k < N; ++k) {
        const int from = a[k], to = b[k];
        while (b[k] - a[k] > 1) {  // until a is the first layer that is not empty
            const int middle = (a[k] + b[k]) / 2, last = b[k];
            b[k] = middle;
            if (!occupied(a, b)) a[k] = middle, b[k] = last;
        }
        const double begin = a[k] - 0.5;
        if (LANE(high[N + k]) > begin && LANE(low[N + k]) < begin) LANE(low[N + k]) = begin;
        a[k] = from, b[k] = to;
        while (b[k] - a[k] > 1) {  // until a is the last
            const int middle = (a[k] + b[k]) / 2, first = a[k];
            a[k] = middle;
            if (!occupied(a, b)) a[k] = first, b[k] = middle;
        }
        const double end = a[k] + 0.5;
        if (LANE(low[k]) < end && LANE(high[k]) > end) LANE(high[k]) = end;
        a[k] = from, b[k] = to;
    }
}
for (int k = 0; k < N; ++k) dead = low[k] > high[N + k] ? zero + 1.0 : dead;
const double* unit = numbers.data; const double* origin = unit + N; const double* delta = origin + N;
for (int k = 0; k < K; ++k) {
    center[k] = (low[k] + high[k]) * (0.5 * unit[k % N]) + origin[k % N];
    gen[k] = (high[k] - low[k]) * (0.5 * unit[k % N]);
    rest[k] = noise[k] = zero + delta[k % N];
}
"""
    # The corner, with low moved down to high where it is above, if that box still meets the object; and as far off as a
    # computed box may be.
    realize = """
for (int k = 0; k < K; ++k) z[k] = slope[k] > zero ? low[k] : high[k];
for (int k = 0; k < N; ++k) z[k] = z[k] > z[N + k] ? z[N + k] : z[k];
for (int l = 0; l < L; ++l) {
    int a[N], b[N];  // the cells that it touches
    for (int k = 0; k < N; ++k) a[k] = (int)ceil(LANE(z[k]) - 0.5), b[k] = (int)floor(LANE(z[N + k]) + 0.5) + 1;
    LANE(valid) = cut(a, b) && occupied(a, b) != 0 ? 1.0 : 0.0;
}
for (int k = 0; k < K; ++k) {
    h[k] = z[k] * unit[k % N] + origin[k % N];
    h[k] -= gradient[k] < zero ? zero - delta[k % N] : zero + delta[k % N];
}
"""
    # halves lie between cells as long as the interval spans several
    split = """
middle = (a + b) * 0.5;
const double edge = floor(middle) + 0.5, other = edge > middle ? edge - 1.0 : edge + 1.0;
if (edge > a && edge < b) middle = edge;
else if (other > a && other < b) middle = other;
"""

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        n = self.inputs // 2
        return [(f"center[{k}] - center[{n + k}] - noise[{k}]", [(k, "1.0"), (n + k, "-1.0")]) for k in range(n)]

    def middle(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        middle = (a + b) * 0.5
        edge = np.floor(middle) + 0.5
        other = np.where(edge > middle, edge - 1.0, edge + 1.0)
        within = (edge > a) & (edge < b)
        return np.where(within, edge, np.where((other > a) & (other < b), other, middle))

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n = self.inputs // 2
        return z * np.tile(numbers[:n], 2) + np.tile(numbers[n : 2 * n], 2)

    def hull(self, lower: np.ndarray, upper: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unit, origin, noise = (np.tile(each, 2) for each in np.split(numbers, 3))
        return lower * unit + origin - 2 * noise, upper * unit + origin + 2 * noise
