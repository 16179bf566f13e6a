"""Charts of a network: numbers in which the positives of a kind of query are boxes (``bounds.Parametrization``)."""

from dataclasses import dataclass

import numpy as np

from warp_bounding.networks.bounds import Parametrization

# Segments of points: ``z = (a, w, t)``, the points ``a + t w`` of one segment for t in an interval.
#
# Of a box only t has a width; halving it halves the segment. The inputs are linear in t, so there is one column of
# generators, and the only noise is rounding.

ROUNDING = 2.0**-50  # relative, of a product and three sums in float64


@dataclass(frozen=True)
class SegmentParametrization(Parametrization):
    """K inputs, ``2 K + 1`` numbers; see module."""

    expand = f"""
dead = zero;
const V middle_ = (low[2 * K] + high[2 * K]) * 0.5, half_ = (high[2 * K] - low[2 * K]) * 0.5;
for (int k = 0; k < K; ++k) {{
    center[k] = low[k] + low[K + k] * middle_;
    gen[k] = low[K + k] * half_;
    rest[k] = noise[k] = (absolute(low[k]) + absolute(low[K + k])) * {ROUNDING.hex()};
}}
"""
    realize = """
for (int k = 0; k < 2 * K; ++k) z[k] = low[k];
z[2 * K] = slope[0] > zero ? low[2 * K] : high[2 * K];
valid = zero + 1.0;
for (int k = 0; k < K; ++k) h[k] = z[k] + z[K + k] * z[2 * K];
"""
    owners = "owner[0] = zero + 2.0 * K;"

    @property
    def size(self) -> int:
        return 2 * self.inputs + 1

    @property
    def columns(self) -> int:
        return 1

    @property
    def pairs(self) -> list[tuple[int, int]]:
        return [(k, 0) for k in range(self.inputs)]

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n = self.inputs
        return z[:, :n] + z[:, n : 2 * n] * z[:, 2 * n :]


# Boxes that meet an object: ``z = (low, high)`` in cells, cut to where it can hold a positive.
#
# Of all boxes in a box of z, the largest is (least low, greatest high). If it meets no occupied cell, none does; if it
# does, low need not go above the occupied cells in it, nor high below them. Occupied cells are counted by a summed-area
# table, and only those that the box overlaps in their interior. Positives that only touch a cell are limits of others,
# which the neighbouring boxes hold.
#
# The network's inputs are ``z`` times a cell's size; computed boxes are off by ``delta``: noise. ``low <= high`` is a
# constraint.


@dataclass(frozen=True)
class BoxParametrization(Parametrization):
    """The parametrization of boxes.

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


# Rays that meet an object: the point where one first enters it, its parameter t there, and its direction.
#
# ``z = (p, t, m)``: p in local space, on a face that is exposed (one entry has no width), or anywhere in the object
# with t = 0; the ray's parameter 0 <= t <= 1 at p; m on a face of a cube (one entry is 1 or -1, without width), ``u =
# m / |m|`` the unit direction in object space. The network's inputs are ``w = stretch u`` and ``a = p - t w``: of the
# 2n + 1 numbers of z 2n - 1 have a width in a box, and all 2n inputs depend on them.
#
# * ``u(m0 + h) = u0 + J h + r`` with ``J = (I - u0 u0^T) / |m0|`` and ``|r| <= 1/2 |h|^2 sqrt(4/3) / min |m|^2``: with
#   ``h = alpha u + h'``, ``D^2 u [h, h] = -(2 alpha h' + |h'|^2 u) / |m|^2``, whose length is largest, ``sqrt(4/3)
#   |h|^2 / |m|^2``, where ``|h'|^2 = 2/3 |h|^2``. The quadratic part of r is ``(-alpha h + (3/2 alpha^2 - |h|^2 / 2)
#   u0) / |m0|^2``; behind it is at most ``3 / 6 (|h| / min |m|)^3``: in the plane of u0 and h, at an angle phi between
#   m and a unit h, ``theta = Im log(1 + s h)`` has the derivatives ``sin phi``, ``-sin 2 phi`` and ``2 sin 3 phi``
#   (over powers of ``|m|``), and the square of the third one of ``u = e^(i theta)``, ``9 sin^2 phi sin^2 2 phi +
#   (2 sin 3 phi - sin^3 phi)^2 = 36 x - 72 x^2 + 45 x^3`` with ``x = sin^2 phi``, is at most 9, where x is 1.
# * ``t w = t0 w + (t - t0) (w - w0) + (t - t0) w0``: the product of two changes is bilinear, but for the rest of w.
# * Only queries with ``|a| <= limit`` reach the network: the box is cut in t, and what still lies outside is excluded
#   by a constraint.
# * A computed query differs from the exact one by ``delta_a`` in a and by ``delta_w`` in w: both are noise, and f is
#   tried at a query that far off.

SECOND = 0.57736  # above sqrt(4/3) / 2, the factor in the bound of u without its linear part
THIRD = 0.50001  # above 3 / 6, the factor in the bound of u without its linear and quadratic parts


@dataclass(frozen=True)
class RayParametrization(Parametrization):
    """The parametrization of rays.

    ``numbers``, n of each: stretch (w is stretch times a unit vector), limit of |a|, lower and upper (the corners of
    the object's grid, local), delta_a, delta_w, and slop, a bound of what float64 rounds here.
    """

    expand = f"""
constexpr int N = K / 2;
const double* stretch = numbers.data; const double* limit = stretch + N; const double* delta_a = stretch + 4 * N;
const double* delta_w = stretch + 5 * N; const double* slop = stretch + 6 * N;
V p[N], rp[N], m[N], rm[N], u[N], way[N], ew[N], ww[N], gw[N][N];
for (int k = 0; k < N; ++k) {{
    p[k] = (low[k] + high[k]) * 0.5; rp[k] = (high[k] - low[k]) * 0.5;
    m[k] = (low[N + 1 + k] + high[N + 1 + k]) * 0.5; rm[k] = (high[N + 1 + k] - low[N + 1 + k]) * 0.5;
}}
V fp = zero + (N - 1.0), fm = fp;  // the entries without width; p may have none
for (int k = N - 2; k >= 0; --k) {{
    fp = rp[k] == zero ? zero + (double)k : fp;
    fm = rm[k] == zero ? zero + (double)k : fm;
}}
V squares = m[0] * m[0], turned = rm[0] * rm[0], nearest = zero;
for (int k = 1; k < N; ++k) squares = squares + m[k] * m[k], turned = turned + rm[k] * rm[k];
for (int k = 0; k < N; ++k) {{ V s = absolute(m[k]) - rm[k]; s = s > zero ? s : zero; nearest += s * s; }}
const V norm = root(squares); const V shrink = 1.0 / norm;
for (int k = 0; k < N; ++k) u[k] = m[k] * shrink;
const V curved = turned * {SECOND} / nearest, third = turned * {THIRD} / nearest * root(turned / nearest);
const auto jacobian = [&](int i, int j) {{ return (i == j ? 1.0 - u[i] * u[j] : -u[i] * u[j]) * rm[j]; }};
#pragma unroll
for (int i = 0; i < N; ++i) {{
    way[i] = u[i] * stretch[i]; ew[i] = curved * stretch[i] + delta_w[i] + slop[i]; ww[i] = ew[i];
    for (int c = 0; c < N - 1; ++c) {{
        gw[i][c] = (fm > (double)c ? jacobian(i, c) : jacobian(i, c + 1)) * (shrink * stretch[i]);
        ww[i] += absolute(gw[i][c]);
    }}
}}
V t_most = high[N];  // cut at the domain
for (int i = 0; i < N; ++i) {{
    const V speed = absolute(way[i]) - ww[i];
    const V room = limit[i] + delta_a[i] + slop[i] + rp[i] + (way[i] < zero ? -p[i] : p[i]);
    const V end = room / (speed > zero ? speed : zero + 1.0);
    t_most = speed > zero ? (end < t_most ? end : t_most) : t_most;
}}
dead = t_most < low[N] ? zero + 1.0 : zero;
t_most = t_most < low[N] ? low[N] : t_most;
high[N] = t_most;
const V t = (low[N] + t_most) * 0.5, rt = (t_most - low[N]) * 0.5;
V* by_p = gen; V* by_t = by_p + 2 * (N - 1); V* by_m = by_t + N;  // in the order of pairs
for (int k = 0; k < N - 1; ++k) {{
    by_p[2 * k] = fp > (double)k ? rp[k] : zero;
    by_p[2 * k + 1] = fp > (double)k ? zero : rp[k + 1];
}}
#pragma unroll
for (int i = 0; i < N; ++i) {{
    center[i] = p[i] - t * way[i]; center[N + i] = way[i];
    noise[i] = delta_a[i] + slop[i] + t_most * ew[i] + rt * (ww[i] - ew[i]); noise[N + i] = ew[i];
    rest[N + i] = third * stretch[i] + delta_w[i] + slop[i];
    rest[i] = delta_a[i] + slop[i] + t_most * rest[N + i] + rt * (curved * stretch[i]);
    by_t[i] = -rt * way[i];
    if (i == N - 1) by_t[i] = by_t[i] + (fp > N - 2.0 ? rp[i] : zero);
    for (int c = 0; c < N - 1; ++c) {{ by_m[K * c + i] = -t * gw[i][c]; by_m[K * c + N + i] = gw[i][c]; }}
}}
"""
    # the positive, and as far off as a computed one may be
    realize = """
const double* lower = numbers.data + 2 * N; const double* upper = lower + N;
for (int k = 0; k < N; ++k) {
    const V by_place = fp < (double)k ? slope[k > 0 ? k - 1 : 0] : slope[k];
    z[k] = by_place > zero ? low[k] : high[k];
    const V by_turn = fm < (double)k ? slope[N + k - 1] : slope[k < N - 1 ? N + k : 2 * N - 2];
    z[N + 1 + k] = by_turn > zero ? low[N + 1 + k] : high[N + 1 + k];
}
V size = z[N + 1] * z[N + 1];
for (int k = 1; k < N; ++k) size = size + z[N + 1 + k] * z[N + 1 + k];
V t_ = slope[N - 1] > zero ? low[N] : high[N]; const V inverse = 1.0 / root(size);
for (int k = 0; k < N; ++k) {
    h[N + k] = z[N + 1 + k] * inverse * stretch[k];
    const V speed = absolute(h[N + k]), room = h[N + k] < zero ? upper[k] - z[k] : z[k] - lower[k];
    const V end = room / (speed > 1e-30 ? speed : zero + 1e-30);
    t_ = end < t_ ? end : t_;
}
t_ = t_ > zero ? t_ : zero; z[N] = t_;
for (int k = 0; k < N; ++k) h[k] = z[k] - t_ * h[N + k];
for (int k = 0; k < K; ++k) {
    const double delta = k < N ? delta_a[k] : delta_w[k - N];
    h[k] -= gradient[k] < zero ? zero - delta : zero + delta;
}
"""
    owners = """
for (int k = 0; k < N - 1; ++k) {
    owner[k] = fp > (double)k ? zero + (double)k : zero + (k + 1.0);
    owner[N + k] = fm > (double)k ? zero + (N + 1.0 + k) : zero + (N + 2.0 + k);
}
owner[N - 1] = high[N] > low[N] ? zero + (double)N : zero + (N - 1.0);
"""
    # the loss by the direction's remainder goes to its entries, by the squares of their widths, and to t
    blame = """
V bent = zero, twisted = zero;
for (int i = 0; i < N; ++i) {
    const V by_a = absolute(gradient[i]), by_w = absolute(gradient[N + i]);
    bent += (by_a * t_most + by_w) * (third * stretch[i]); twisted += by_a * rt * (curved * stretch[i]);
}
score[N - 1] += twisted * 0.5;
bent = turned > zero ? (bent + twisted * 0.5) / turned : zero;
for (int c = 0; c < N - 1; ++c) {
    const V width = fm > (double)c ? rm[c] : rm[c + 1];
    score[N + c] += bent * (width * width);
}
"""
    # the quadratic terms are those of u, and the product of the changes of t and w
    bend = """
V along = zero, by[N], r[N], e[N], b[N];
for (int i = 0; i < N; ++i) { by[i] = (gradient[N + i] - t * gradient[i]) * stretch[i]; along += by[i] * u[i]; }
const V scale = shrink * shrink;
for (int c = 0; c < N - 1; ++c) {
    r[c] = fm > (double)c ? rm[c] : rm[c + 1]; e[c] = fm > (double)c ? u[c] : u[c + 1];
    b[c] = fm > (double)c ? by[c] : by[c + 1];
}
#pragma unroll
for (int c = 0; c < N - 1; ++c) {
    square[entry(N + c, N + c)] += scale * r[c] * r[c] * (along * (e[c] * e[c] * 1.5 - 0.5) - e[c] * b[c]);
    for (int d = c + 1; d < N - 1; ++d)
        square[entry(N + c, N + d)] += scale * r[c] * r[d] * (along * e[c] * e[d] * 3.0 - e[c] * b[d] - e[d] * b[c]);
    V turn = gradient[0] * gw[0][c];
    for (int i = 1; i < N; ++i) turn = turn + gradient[i] * gw[i][c];
    square[entry(N - 1, N + c)] -= rt * turn;
}
"""

    @property
    def ndim(self) -> int:
        """Dimension n of the object."""
        return self.inputs // 2

    @property
    def size(self) -> int:
        return 2 * self.ndim + 1

    @property
    def columns(self) -> int:
        """There are n - 1 columns for p, one for t (or for the last entry of p where t is 0), and n - 1 for m."""
        return 2 * self.ndim - 1

    @property
    def pairs(self) -> list[tuple[int, int]]:
        n = self.ndim
        place = [(i, k) for k in range(n - 1) for i in (k, k + 1)]
        parameter = [(i, n - 1) for i in range(n)]
        turn = [(i, n + c) for c in range(n - 1) for i in range(2 * n)]
        return place + parameter + turn

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        """Followed backwards, a ray leaves the domain on the side that it comes from."""
        side = "(way[{0}] < zero ? zero + 1.0 : zero - 1.0)"
        sides = [(i, side.format(i)) for i in range(self.ndim)]
        return [(f"{side} * center[{i}] - noise[{i}] - limit[{i}]", [(i, side)]) for i, side in sides]

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n, m = self.ndim, z[:, self.ndim + 1 :]
        w = m / np.linalg.norm(m, axis=1, keepdims=True) * numbers[:n]
        return np.concatenate([z[:, :n] - z[:, n : n + 1] * w, w], axis=1)

    def hull(self, lower: np.ndarray, upper: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n = self.ndim
        stretch, _, _, _, delta_a, delta_w, slop = np.split(numbers, 7)
        (p, t, m), (p_most, t_most, m_most) = (np.split(side, [n, n + 1], axis=1) for side in (lower, upper))
        least = np.maximum(np.maximum(m, -m_most), 0.0) ** 2  # of each entry of m, squared
        most = np.maximum(np.abs(m), np.abs(m_most)) ** 2
        near, far = (each.sum(axis=1, keepdims=True) - each for each in (least, most))  # of the other entries together
        # An entry of m / |m| grows with its own entry of m, and shrinks towards 0 as the others grow.
        low = m / np.sqrt(m * m + np.where(m > 0, far, near)) * stretch
        high = m_most / np.sqrt(m_most * m_most + np.where(m_most > 0, near, far)) * stretch
        ways = np.stack([t * low, t * high, t_most * low, t_most * high])
        beyond_a, beyond_w = delta_a + 2 * slop, delta_w + 2 * slop
        least_a, most_a = p - ways.max(axis=0) - beyond_a, p_most - ways.min(axis=0) + beyond_a
        return np.concatenate([least_a, low - beyond_w], axis=1), np.concatenate([most_a, high + beyond_w], axis=1)
