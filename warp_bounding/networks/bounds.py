"""Bounds of a network over boxes, as one fused native kernel in float64: charts, the C text, and the kernel; one box per SIMD lane.

A chart turns a box of numbers into the network's inputs, an affine function of ``zeta`` in [-1,
1]^columns and noise. A thread takes a block of boxes through all layers and back without leaving its cache. Forwards,
each neuron is a cubic or a line (``activations``) in the linear part of its argument, plus a quadratic form of zeta,
plus noise. Backwards, these curves are weighed by the output's actual coefficients and added to one cubic polynomial of
zeta, in which those of many neurons may cancel; only the bands around them count in absolute value. For two layers of H
neurons and C columns the arithmetic is ``(C (C + 1) / 2 + C + 5) H^2`` multiply-adds a box: entries of the forms, their
middle and half-range, centre, noise and columns forwards, one coefficient backwards; and fewer than ``C^3 H`` of the
polynomial. Sums may be taken in any order and fused: ``Network.padding`` and ``SQUARES_ROUNDING`` bound the float64
rounding of all of them, and the relaxations add what the kernel's own sine and tanh err by. ``Network.bound_plain``
computes the same in NumPy, for boxes of the inputs themselves (``PlainChart``): it knows no other chart and no
constraint.

The C text of bounds comes first, then that of the polynomial to which they lead; ``body`` puts them together for the shape of a network and
its chart. K are the network's inputs, Z the numbers of a box, C the columns, the entries of zeta (``Chart``).
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.activations import activation_of, constant, constants
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import named, unique_name

# What is known about a function over boxes: what every bounder's ``bound`` gives, and networks a little more.


class BoxBounds(NamedTuple):
    """Bounds of ``f`` over N boxes of m numbers: a query's coordinates, or the numbers of a network's chart.

    Attributes:
        lower: ``(N,)`` float64, certified lower bounds; infinity where a box of a chart holds no positive.
        axis: ``(N,)`` int, the axis along which halving the box helps the bound most.
        point: ``(N, m)`` float64, a point of the box where ``f`` is likely to be least; of a chart, a positive.
        value: ``(N,)`` float64, ``f`` there; infinity where a box of a chart holds no positive.
        next_axis: ``(N,)`` int, the axis to halve after ``axis``; this and the attributes below may be ``None``.
        slope: ``(N, K)``, networks only: slopes of a linear bound in the network's inputs. It is one of this very ``f``: whoever makes
            the bounds of another function of these makes them without what follows.
        level: ``(N,)``, networks only: where the chart's numbers are the inputs themselves, ``f >= level + slope .
            (v - center)`` on the box.
        boxes: ``(N, 2, m)``, networks only: corners of the boxes without what the chart cut off, which holds no
            positive.
    """

    lower: np.ndarray
    axis: np.ndarray
    point: np.ndarray
    value: np.ndarray
    next_axis: np.ndarray | None = None
    slope: np.ndarray | None = None
    level: np.ndarray | None = None
    boxes: np.ndarray | None = None

    def part(self, rows: np.ndarray) -> "BoxBounds":
        """The same of some of the boxes."""
        return BoxBounds(*(each if each is None else each[rows] for each in self))


# How a box of numbers z becomes inputs of a network: ``center + generators zeta + noise``, ``|zeta| <= 1``.
#
# A proof searches over boxes of numbers that parametrise positive queries (a point; the point where a ray enters the
# object, its parameter there and its direction; a box's corners). The network's inputs are a linear function of these
# numbers plus a rest. A chart writes this down as C text over a type V (a box a SIMD lane on a CPU, a double on CUDA):
#
# * ``expand``: from ``V low[Z], high[Z]`` to ``V center[K]``, ``V gen[P]`` (the generators that are not always zero),
#   ``V noise[K]`` (all that is left over), ``V rest[K]`` (that without the quadratic terms that ``bend`` adds) and ``V
#   dead`` (1 where the box holds no positive); it may shrink the box;
# * ``constraints``: linear functions ``q0 + q . zeta`` that are at most 0 at positives, where a box holds other queries
#   too;
# * ``realize``: from the signs of ``V slope[C]`` to ``V z[Z]``, a positive near the corner where f looks lowest, its
#   inputs ``V h[K]`` and ``V valid`` (0 where there is none);
# * ``owners``: ``V owner[C]``, the number of z that halving a column halves;
# * ``blame``: what adds to ``V score[C]`` the loss by ``noise`` (``|gradient|`` times it) that smaller boxes avoid;
# * ``bend``: what adds to ``V square[]`` the inputs' quadratic terms, times ``gradient``; of columns ``k <= m`` its
#   index is ``entry(k, m)``;
# * ``split``: what sets ``double middle`` of number ``axis`` between ``double a`` and ``double b``.
#
# K, C and Z are constants: the inputs, the columns of generators and the numbers of z. ``absolute`` is a function of V.
# ``numbers.data`` holds float64 parameters, ``table.data`` int32 ones. Rounding in float64 is part of ``noise``.


@dataclass(frozen=True)
class Chart:
    """What the kernels need to know of a chart; the C texts are explained above.

    Attributes:
        inputs: Inputs K of the network.
        noisy: Whether ``expand`` sets ``noise`` and ``rest``; else they are 0.
    """

    inputs: int

    noisy = True
    expand: ClassVar[str]
    realize: ClassVar[str]
    owners: ClassVar[str] = "for (int k = 0; k < C; ++k) owner[k] = zero + (double)k;"
    blame: ClassVar[str] = ""
    bend: ClassVar[str] = ""
    split: ClassVar[str] = "middle = (a + b) * 0.5;"

    @property
    def size(self) -> int:
        """Numbers Z of a point z."""
        return self.inputs

    @property
    def columns(self) -> int:
        """Number C of coordinates zeta, and so of columns of the generators."""
        return self.inputs

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """``(input, column)`` of the generators' entries that may differ from 0, in the order of ``gen``."""
        return [(k, k) for k in range(self.inputs)]

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        """``(q0, [(input, factor), ...])`` for each; the column of an input's generators enters with the factor."""
        return []

    def middle(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The twin of ``split``: where intervals ``(N,)`` of a number are halved."""
        return (a + b) * 0.5

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Coordinates ``v`` of a query ``(N, K)`` for points ``(N, Z)`` of a chart with these ``numbers``, float64."""
        raise NotImplementedError

    def hull(self, lower: np.ndarray, upper: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners ``(N, K)`` between which the inputs of all queries of boxes ``(N, Z)`` lie, computed ones too."""
        raise NotImplementedError


@dataclass(frozen=True)
class PlainChart(Chart):
    """The chart of points, whose numbers are the inputs themselves."""

    noisy = False
    expand = "for (int k = 0; k < K; ++k) { center[k] = (low[k] + high[k]) * 0.5; gen[k] = (high[k] - low[k]) * 0.5; }"
    realize = "for (int k = 0; k < K; ++k) h[k] = z[k] = slope[k] > zero ? low[k] : high[k];"

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        return z


# The C text of bounds over boxes: from ``V low[], high[]``, a box a lane, to its bound, layer by layer and back.
#
# What becomes of the polynomial to which that leads follows below. Names in capitals are constants that are written in front of a text, or other texts. The network's chart has K inputs and C columns, and Z numbers a
# box. A layer has INPUTS and NEURONS, of which the LINEAR leading ones are passed through, and its numbers begin at
# the index AT of ``w``.

CPU = """
#pragma clang fp contract(fast)
#define LANE(x) x[l]
constexpr int L = 8;
typedef double V __attribute__((vector_size(8 * L))); typedef long long I __attribute__((vector_size(8 * L)));
const V zero = {};
auto root = [](V x) { return __builtin_elementwise_sqrt(x); };
"""
CUDA = """
#define LANE(x) x
constexpr int L = 1;
typedef double V;
const V zero = 0.0;
auto root = [](V x) { return sqrt(x); };
"""


# What is known of a layer's neurons. The argument of each is a centre plus l + p + y: l = rate . zeta is linear, |l| <=
# near; p is the quadratic form in zeta that the parabolas of the layers below make together, within radius of 0, its
# middle being taken into the centre; y is all the rest, noise. |l + p + y| <= width, rounding included. The output is
#     h = mean + slope (l + p + y) + lean l + bend l^2 + cube l^3 + cross l p
# to within spread. Behind these stands what a layer above reads, of h = mean + part . zeta + a quadratic form + y',
# |y'| at most noise: square are that form's entries (those off the diagonal count twice), and behind them the middle
# of its range; radius is half of it. They are sums of what the parabolas are one by one, while entries of square may
# cancel. form are the entries of p, before its middle was taken off, and total the sum of their sizes. The arrays are
# declared one by one, so that the compiler drops those that nobody reads.
LAYER = """
V LAYER_mean[NEURONS], LAYER_noise[NEURONS], LAYER_width[NEURONS], LAYER_slope[NEURONS], LAYER_spread[NEURONS];
V LAYER_near[NEURONS], LAYER_rate[C][NEURONS], LAYER_lean[NEURONS], LAYER_bend[NEURONS], LAYER_cube[NEURONS];
V LAYER_cross[NEURONS], LAYER_form[SQUARES + 1][NEURONS], LAYER_total[NEURONS];
V LAYER_part[C][NEURONS], LAYER_square[SQUARES + 1][NEURONS], LAYER_radius[NEURONS];
const struct {
    V *mean, *noise, *width, *slope, *spread, *near, (*rate)[NEURONS], *lean, *bend, *cube, *cross, (*form)[NEURONS];
    V *total, (*part)[NEURONS], (*square)[NEURONS], *radius;
} LAYER = {
    LAYER_mean, LAYER_noise, LAYER_width, LAYER_slope, LAYER_spread, LAYER_near, LAYER_rate, LAYER_lean, LAYER_bend,
    LAYER_cube, LAYER_cross, LAYER_form, LAYER_total, LAYER_part, LAYER_square, LAYER_radius,
};
"""

# Neuron j from the centre z of its argument, its generators g (rate) and the largest |y|, from, and, where layers below
# BEND, its quadratic form: entries and middle in own.form, radius in reach. The form's range is taken both from its
# entries and from the parabolas one by one. ROOM is the largest middle that an activation with a limit takes: beyond it
# the range is as wide, and nothing is lost. RELAX sets s, m, e and what else of lean, k2, k3 and k4 is not 0.
NEURON = """
V near = zero, middle = zero, radius = zero;
for (int k = 0; k < C; ++k) { own.rate[k][j] = g[k]; near += absolute(g[k]); }
if (BENT) {
    V half = zero, other = zero;
    int entry = 0;
#pragma unroll
    for (int k = 0; k < C; ++k) {
        half += own.form[entry][j] * 0.5; other += absolute(own.form[entry++][j]) * 0.5;
#pragma unroll
        for (int m = k + 1; m < C; ++m) other += absolute(own.form[entry++][j]) * 2.0;
    }
    const V sum = own.form[SQUARES][j];
    V low = half - other, high = half + other;
    low = sum - reach > low ? sum - reach : low; high = sum + reach < high ? sum + reach : high;
    middle = (low + high) * 0.5; radius = (high - low) * 0.5; own.total[j] = other * 2.0;
    const V beyond = absolute(middle);
    radius = beyond > ROOM ? radius + beyond : radius; middle = beyond > ROOM ? zero : middle;
}
V s, m, e, lean = zero, k2 = zero, k3 = zero, k4 = zero;
const V at = z + middle;
RELAX
if (j < LINEAR) { s = zero + 1.0; m = at; e = lean = k2 = k3 = k4 = zero; }
e += pad;
own.mean[j] = m - s * middle; own.slope[j] = s; own.spread[j] = e; own.width[j] = near + radius + from + pad;
own.near[j] = near; own.lean[j] = lean - k4 * middle; own.bend[j] = k2; own.cube[j] = k3; own.cross[j] = k4;
const V near2 = near * near, line = s + lean + k3 * near2 * 0.75;  // l^3 is within near^3 / 4 of 3 near^2 l / 4
for (int k = 0; k < C; ++k) own.part[k][j] = g[k] * line;
own.noise[j] = absolute(s) * from + e + (absolute(k3) * near2 * 0.25 + absolute(k4) * radius) * near;
if (PASSES) {
    const V half = near2 * 0.5; int entry = 0;
#pragma unroll
    for (int k = 0; k < C; ++k) {
        const V bent = k2 * g[k];
#pragma unroll
        for (int m = k; m < C; ++m, ++entry)
            own.square[entry][j] = BENT ? bent * g[m] + s * own.form[entry][j] : bent * g[m];
    }
    own.square[SQUARES][j] = s * middle + k2 * half; own.radius[j] = absolute(s) * radius + absolute(k2) * half;
}
"""

LINES = "relax(at, near, radius + from + pad, s, m, k2, e);"
CURVES = "curve(at, near, radius, from + pad, s, m, lean, k2, k3, k4, e);"

# The first hidden layer, of the chart's inputs; GENERATORS fills g, whose entries are sparse.
FIRST = """
for (int j = 0; j < NEURONS; ++j) {
    const double* x = weight + j * INPUTS;
    V z = zero + b[j], from = zero, reach = zero, g[C];
    for (int i = 0; i < INPUTS; ++i) z += center[i] * x[i];
    GENERATORS
    if (NOISY) for (int i = 0; i < INPUTS; ++i) from += noise[i] * x[NEURONS * INPUTS + i];
    (void)reach;
    NEURON
    for (int k = 0; k < C; ++k) score[k] += absolute(g[k]) * FIRST_LAYER;
}
"""

# A later layer: BLOCKS blocks of R neurons from FIRST on, which share each input as it is loaded.
LATER = """
for (int t = 0; t < BLOCKS; ++t) {
    const double* x = weight + (FIRST + t * R) * INPUTS; const double* ax = x + NEURONS * INPUTS;
    V centers[R], noises[R], radii[R], generators[R][C];
#pragma unroll
    for (int r = 0; r < R; ++r) {
        centers[r] = zero + b[FIRST + t * R + r]; noises[r] = zero; radii[r] = zero;
#pragma unroll
        for (int k = 0; k < C; ++k) generators[r][k] = zero;
    }
    for (int i = 0; i < INPUTS; ++i) {
        const V m = below.mean[i], e = below.noise[i];
#pragma unroll
        for (int r = 0; r < R; ++r) {
            const double y = x[r * INPUTS + i];
            centers[r] += m * y; noises[r] += e * ax[r * INPUTS + i];
            if (BENT) radii[r] += below.radius[i] * ax[r * INPUTS + i];
#pragma unroll
            for (int k = 0; k < C; ++k) generators[r][k] += below.part[k][i] * y;
        }
    }
#pragma unroll
    for (int r = 0; r < R; ++r) {
        const int j = FIRST + t * R + r;
        const V z = centers[r], from = noises[r], reach = radii[r]; const V* g = generators[r]; (void)reach;
        NEURON
    }
}
"""

# Before it, where layers below bend: the quadratic forms of its arguments, ENTRIES entries from ENTRY on at a time.
SQUARES_OF_ARGUMENTS = """
for (int t = 0; t < BLOCKS; ++t) {
    const double* x = weight + (FIRST + t * R) * INPUTS;
    V sums[R][ENTRIES];
#pragma unroll
    for (int r = 0; r < R; ++r)
        for (int k = 0; k < ENTRIES; ++k) sums[r][k] = zero;
    for (int i = 0; i < INPUTS; ++i) {
#pragma unroll
        for (int k = 0; k < ENTRIES; ++k) {
            const V q = below.square[ENTRY + k][i];
#pragma unroll
            for (int r = 0; r < R; ++r) sums[r][k] += q * x[r * INPUTS + i];
        }
    }
#pragma unroll
    for (int r = 0; r < R; ++r)
        for (int k = 0; k < ENTRIES; ++k) own.form[ENTRY + k][FIRST + t * R + r] = sums[r][k];
}
"""

# Backwards through a layer: its curves are weighed by back, the output's coefficients of its neurons, and added to one
# polynomial in zeta, of which the entries are tilt, square and cubes (a <= b <= d of each, as of a symmetric tensor);
# what each neuron's spread costs is taken from least and charged to the columns that caused it (score); to receives the
# output's coefficients of what the layer computes with. bulk sums up the absolute terms of square and cubes.
BACKWARDS = """
for (int i = 0; i < INPUTS; ++i) to[i] = zero;
for (int j = 0; j < NEURONS; ++j) {
    V c = back[j];
    const V loss = absolute(c) * own.spread[j]; least -= loss;
    const V share = loss / own.width[j];
#pragma unroll
    for (int k = 0; k < C; ++k) score[k] += share * absolute(own.rate[k][j]);
    if (BENDS) {
        const V bow = c * own.bend[j], arch = c * own.cube[j], mix = c * own.cross[j] * THIRD, n = own.near[j];
        bulk += (absolute(bow) + absolute(arch) * n) * n * n;
        if (BENT) bulk += absolute(mix) * n * own.total[j] * 3.0;
        V bent[SQUARES], crossed[SQUARES]; int entry = 0, cube = 0;
#pragma unroll
        for (int k = 0; k < C; ++k) {
            const V rate = own.rate[k][j]; tilt[k] += c * own.lean[j] * rate;
#pragma unroll
            for (int m = k; m < C; ++m, ++entry) {
                const V product = rate * own.rate[m][j];
                square[entry] += bow * product; bent[entry] = arch * product;
                if (BENT) { crossed[entry] = mix * own.form[entry][j]; bent[entry] += crossed[entry]; }
            }
        }
#pragma unroll
        for (int a = 0; a < C; ++a)
#pragma unroll
            for (int b = a; b < C; ++b)
#pragma unroll
                for (int d = b; d < C; ++d, ++cube) {
                    cubes[cube] += own.rate[a][j] * bent[place(b, d)];
                    if (BENT) cubes[cube] += own.rate[b][j] * crossed[place(a, d)] + own.rate[d][j] * crossed[place(a, b)];
                }
    }
    c *= own.slope[j];
    const double* x = w + AT + NEURONS + j * INPUTS;
    for (int i = 0; i < INPUTS; ++i) to[i] += c * x[i];
}
"""

# f itself: a layer's activations y from the inputs x, in blocks as in LATER.
VALUES = """
for (int t = 0; t < BLOCKS; ++t) {
    const double* weight = b + NEURONS + (FIRST + t * R) * INPUTS;
    V sums[R];
#pragma unroll
    for (int r = 0; r < R; ++r) sums[r] = zero + b[FIRST + t * R + r];
    for (int i = 0; i < INPUTS; ++i) {
        const V m = x[i];
#pragma unroll
        for (int r = 0; r < R; ++r) sums[r] += m * weight[r * INPUTS + i];
    }
#pragma unroll
    for (int r = 0; r < R; ++r) { const int j = FIRST + t * R + r; y[j] = j < LINEAR ? sums[r] : act(sums[r]); }
}
"""


# The number of z that is best halved in lane l: the owner of the column with most score.
AXIS = """
int axis; {
    double most = LANE(score[0]); axis = (int)LANE(owner[0]);
    for (int k = 1; k < C; ++k) if (LANE(score[k]) > most) { most = LANE(score[k]); axis = (int)LANE(owner[k]); }
}
"""

STORE = """
const long long o = i + l;
least_out.data[o] = LANE(dead) != 0.0 ? INFINITY : LANE(least);
value_out.data[o] = LANE(valid) != 0.0 && LANE(dead) == 0.0 ? LANE(value) : INFINITY;
level_out.data[o] = LANE(level);
axes.data[o] = axis;
double next = -1.0; int second = axis; // the number to halve next, when the columns that axis owns are halved
for (int k = 0; k < C; ++k) {
    const double s = LANE(score[k]) * ((int)LANE(owner[k]) == axis ? HALVED : 1.0);
    if (s > next) { next = s; second = (int)LANE(owner[k]); }
}
axes.data[count + o] = second;
for (int k = 0; k < Z; ++k) point.data[o * Z + k] = LANE(z[k]);
for (int k = 0; k < K; ++k) gradient_out.data[o * K + k] = LANE(gradient[k]);
for (int k = 0; k < Z; ++k) { rows[o * (2 * Z) + k] = LANE(low[k]); rows[o * (2 * Z) + Z + k] = LANE(high[k]); }
"""


# The C text of what becomes of the polynomial in zeta that a network is above on a box: its least, or its corners.
#
# Its constant is ``least``, its other entries ``tilt``, ``square`` and ``cubes`` (``BACKWARDS``); slopes of
# the inputs are ``gradient``, and of the columns, tilt included, ``slope``.

# The cubic part of the polynomial, by entries: zeta^3 is within 1/4 of 3/4 zeta, and zeta_k^2 zeta_m within 1/2 |zeta_m|
# of 1/2 zeta_m; the lines go to tilt. Of three different ones the product counts in absolute value, or stays where the
# bound may be MULTILINEAR. Losses are shared among the columns of an entry.
STRAIGHTEN = """
int cube = 0;
const auto lose = [&](V loss, int a, int b, int d) {
    least -= loss; loss *= THIRD; score[a] += loss; score[b] += loss; score[d] += loss;
};
#pragma unroll
for (int a = 0; a < C; ++a)
#pragma unroll
    for (int b = a; b < C; ++b)
#pragma unroll
        for (int d = b; d < C; ++d, ++cube) {
            const V q = cubes[cube]; const V size = absolute(q);
            if (a == d) { tilt[a] += q * 0.75; lose(size * 0.25, a, b, d); }
            else if (a == b || b == d) { tilt[a == b ? d : a] += q * 1.5; lose(size * 1.5, a, b, d); }
            else if (!MULTILINEAR) lose(size * 6.0, a, b, d);
        }
"""

# A constraint excess + q . zeta <= 0 on the columns OF, M of them, added to the linear bound with the multiplier that
# serves it best. For any multiplier t >= 0 the bound least - sum |slope + t q| + t excess holds at all points that obey
# the constraint; it is concave in t, and largest where an entry of slope + t q vanishes, or at 0. Relative to the sum
# of the absolute terms, 1e-14 is above the rounding of the few operations here.
CONSTRAIN = """
V best = zero, gain = zero, before = absolute(slope[OF[0]]);
for (int j = 1; j < M; ++j) before += absolute(slope[OF[j]]);
#pragma unroll
for (int k = 0; k < M; ++k) {
    const V own = q[k] == zero ? zero + 1.0 : q[k];
    V t = -slope[OF[k]] / own;
    t = q[k] == zero ? zero : t; t = t > zero ? t : zero;
    V after = t * excess + before;
#pragma unroll
    for (int j = 0; j < M; ++j) after -= absolute(slope[OF[j]] + t * q[j]);
    best = after > gain ? t : best; gain = after > gain ? after : gain;
}
for (int k = 0; k < M; ++k) slope[OF[k]] += best * q[k];
least += best * excess - (best * absolute(excess) + before + 1.0) * 1e-14;
"""

# The least of slope . zeta and the quadratic form over |zeta| <= 1, entry by entry. Of q zeta_k zeta_m, k != m, only
# -|q| is sure; but where it is +|q| in the corner where slope . zeta is least, it is above the planes
# -|q| + d (a zeta_k + b zeta_m) for all 0 <= d <= |q|, a and b being the signs that lower both slopes (McCormick), so
# that d is gained from either slope, until one is 0. An entry q >= 0 of the diagonal goes with what is left of its
# slope, the least of -s |zeta| + q zeta^2 being at zeta = s / (2 q) if that is less than 1, else at the end; a negative
# one is least at the end. Where the bound may be MULTILINEAR, entries off the diagonal stay. level is the bound's constant.
CLOSE = """
V steep[C];
for (int k = 0; k < C; ++k) steep[k] = absolute(slope[k]);
int entry = 0;
#pragma unroll
for (int k = 0; k < C; ++k) {
#pragma unroll
    for (int m = k; m < C; ++m, ++entry) {
        const V q = absolute(square[entry]);
        if (m == k) { score[k] += q; least -= square[entry] < zero ? q : zero; }
        else if (!MULTILINEAR) {
            least -= q; score[k] += q * 0.5; score[m] += q * 0.5;
            V gained = steep[k] < steep[m] ? steep[k] : steep[m]; gained = q < gained ? q : gained;
            gained = slope[k] * slope[m] * square[entry] > zero ? gained : zero;
            steep[k] -= gained; steep[m] -= gained;
        }
    }
}
least -= bulk * SQUARES_ROUNDING; level = least;
entry = 0;
#pragma unroll
for (int k = 0; k < C; entry += C - k, ++k) {
    const V s = steep[k], q = square[entry] > zero ? square[entry] : zero;
    const V end = q - s, inner = s * s * -0.25 / (q > zero ? q : zero + 1.0);
    least += s < q + q ? inner : end;
}
"""

# The values at the corners of what is left where the bound may be MULTILINEAR: place i is at the upper end of column k
# where bit k of i is set. 1e-13 of all terms is more than float64 rounds here, and in where the corners lie.
CORNERS = """
V corner[1 << C], size = absolute(level);
for (int k = 0; k < C; ++k) {
    size += absolute(slope[k]) + absolute(gradient[k]) * (absolute(low[k]) + absolute(high[k]));
    for (int m = k + 1; m < C; ++m) {
        size += absolute(square[place(k, m)]);
        for (int d = m + 1; d < C; ++d) size += absolute(cubes[triple(k, m, d)]) * 6.0;
    }
}
level -= size * 1e-13;
for (int i = 0; i < 1 << C; ++i) {
    const auto at = [&](int k, V x) { return (i >> k) & 1 ? x : -x; };
    V sum = level;
#pragma unroll
    for (int k = 0; k < C; ++k) {
        V by_k = slope[k];
#pragma unroll
        for (int m = k + 1; m < C; ++m) {
            V by_m = square[place(k, m)];
#pragma unroll
            for (int d = m + 1; d < C; ++d) by_m += at(d, cubes[triple(k, m, d)] * 6.0);
            by_k += at(m, by_m);
        }
        sum += at(k, by_k);
    }
    corner[i] = sum;
}
"""


BLOCK = 64  # boxes that a thread of the kernel works on, on a CPU; on CUDA it is one
# A box's second axis to halve is chosen as if its first were halved already. The score of that number z falls by this
# factor then: a relaxation's cost falls nearly with the square of a box's width, so a little more than 1/4.
HALVED = 0.3
# Relative to the sum of the absolute terms of the polynomial in zeta: above 4000 UNIT64, for up to 4000 neurons.
SQUARES_ROUNDING = 1e-12
# Weight of |rate| of the first layer (``LAYER``: the generators of a neuron's argument) in the score by
# which an axis is chosen: it decides only where all layers behind are saturated.
FIRST_LAYER = 1e-9
ROWS = 4  # neurons that share each input as it is loaded
# The largest middle of a quadratic form around which the sine is taken (``NEURON``, ``SINE_LIMIT``).
ROOM = 1.0
REGISTERS = 28  # sums that are kept at a time, of the 32 vector registers of AVX-512


@dataclass(frozen=True)
class NetworkShape:
    """What a kernel of bounds is compiled for.

    Attributes:
        ndim: Inputs K of the network, as many as the chart has: the length of v, so 2n of rays.
        layers: ``(inputs, neurons, activation's name, leading linear rows)`` of each hidden layer.
        chart: How a box becomes inputs.
    """

    ndim: int
    layers: tuple[tuple[int, int, str, int], ...]
    chart: Chart

    name = "network_bound"


def lanes_text(shape: NetworkShape, inputs: str) -> tuple[str, str]:
    """What stands before the text of ``body``: types, tools and the chart's names, on a CPU and on CUDA.

    Args:
        shape: What the kernel is compiled for.
        inputs: C statements that name the kernel's arrays.
    """
    names = sorted({layer[2] for layer in shape.layers})
    tools = "auto absolute = [&](V x) { return x < zero ? -x : x; };\n"
    tools += "".join(activation_of(name).relaxation() for name in names)
    return tuple(f"{types}{inputs}\n{tools}" for types in (CPU, CUDA))


def body(shape: NetworkShape, tried: str = "true", *, multilinear: bool = False) -> str:
    """C statements that bound f over one box a lane.

    They read the box ``V low[Z], high[Z]``, which the chart may shrink, the weights ``w`` (``Network.packed``), the
    rounding ``padding`` of each layer and the chart's ``numbers`` and ``table``. They set, each of type ``V``:

    * ``least``, a certified lower bound of f on the box, and ``level``, the constant of the linear bound;
    * ``gradient[K]``, the slopes of the linear bound in the inputs;
    * ``dead``, 1 where the box holds no positive, else 0;
    * ``z[Z]``, a positive of the box, ``value``, f there, and ``valid``, 1 where there is one, else 0;
    * ``score[C]``, how much halving each column should raise the bound, and ``owner[C]``, the number of z to halve for
      it.

    The arrays of a hidden layer are explained at ``LAYER``; ``back`` are the output's coefficients of its
    neurons. Of the inputs, ``center``, ``gen``, ``noise`` and ``rest`` are explained in ``Chart``. ``lost`` is
    what noise takes from the bound; ``tilt``, ``square`` and ``cubes`` are explained at ``BACKWARDS``.

    Args:
        shape: What the kernel is compiled for.
        tried: C condition under which f is evaluated where it looks lowest; else ``valid`` is 0.
        multilinear: Leave products of different columns in ``square`` and ``cubes``, for ``CORNERS``: then
            ``least`` is no bound, and ``level`` the constant of a multilinear one.
    """
    chart, layers, places = shape.chart, list(enumerate(shape.layers)), [0]
    # Where each layer begins in ``w``: its biases, its weights and their absolute values (``Network.packed``).
    for inputs, neurons, _, _ in shape.layers:
        places.append(places[-1] + neurons * (2 * inputs + 1))
    squares = [(k, m) for k in range(chart.columns) for m in range(k, chart.columns)]
    n, bends = chart.columns, any(activation_of(name).bends for _, _, name, _ in shape.layers)
    sizes = constants(K=shape.ndim, C=n, Z=chart.size, NOISY=int(chart.noisy), MULTILINEAR=int(multilinear))
    sizes += constants(SQUARES=len(squares), CUBES=n * (n + 1) * (n + 2) // 6)
    last, at, count = len(layers) - 1, places[-1], shape.layers[-1][1]
    join = "\n".join
    return f"""
{sizes}
constexpr double FIRST_LAYER = {constant(FIRST_LAYER)}, SQUARES_ROUNDING = {constant(SQUARES_ROUNDING)};
constexpr double THIRD = {constant(1 / 3)};
V least = zero, value = zero, valid = zero + 1.0, dead = zero, lost = zero, level = zero, bulk = zero;
V center[K], noise[K], rest[K], gen[{len(chart.pairs)}], h[K], z[Z], gradient[K];
V score[C], slope[C], owner[C], tilt[C], square[SQUARES], cubes[CUBES];
(void)dead; (void)valid; (void)noise; (void)rest; (void)lost; (void)bulk;
const auto entry = [](int k, int m) {{ return k * (2 * C - k + 1) / 2 + m - k; }}; const auto place = entry; (void)place;
const auto triple = [&](int a, int b, int d) {{  // the place of a <= b <= d in cubes
    int before = 0;
    for (int k = 0; k < a; ++k) before += (C - k) * (C - k + 1) / 2;
    return before + place(b, d) - place(a, a);
}}; (void)triple;
{chart.expand}
{chart.owners}
for (int k = 0; k < C; ++k) score[k] = tilt[k] = zero;
for (int i = 0; i < SQUARES; ++i) square[i] = zero;
for (int i = 0; i < CUBES; ++i) cubes[i] = zero;
{join(_forwards(shape, index, places[index]) for index, _ in layers)}
V back{last}[{count}]; least = zero + (w[{at}] - padding[{last + 1}]);  // f where all neurons are at their means
for (int j = 0; j < {count}; ++j) {{
    const double x = w[{at + 1} + j];
    back{last}[j] = zero + x; least += layer{last}.mean[j] * x;
}}
{join(_backwards(shape, index, places[index]) for index, _ in reversed(layers))}
if (NOISY) {{
    for (int i = 0; i < K; ++i) lost += absolute(gradient[i]) * rest[i];
    least -= lost;
    {chart.blame}
}}
{" ".join(f"square[{i}] *= 2.0;" for i, (k, m) in enumerate(squares) if k != m)}
{{ {chart.bend} }}
{{
    V all = absolute(square[0]);
    for (int i = 1; i < SQUARES; ++i) all += absolute(square[i]);
    bulk += all;
}}
{f"{{ {STRAIGHTEN} }} {_lean(chart)}" * bends}
{" ".join(f"slope[{k}] = {_product(chart, k, 'gradient[{i}]')} + tilt[{k}];" for k in range(chart.columns))}
{join(_constrain(chart, start, factors) for start, factors in chart.constraints())}
{{ {CLOSE} }}
if ({tried}) {{
    {chart.realize}
    const V* y = h;
    {join(_values(shape, index, places[index]) for index, _ in layers)}
    value = zero + w[{at}];
    for (int j = 0; j < {count}; ++j) value += y[j] * w[{at + 1} + j];
}} else {{ valid = zero; }}
"""


def _product(chart: Chart, column: int, of: str) -> str:
    """C sum over the inputs i of ``of`` times generators of a column; those that are always 0 are left out."""
    pairs = enumerate(chart.pairs)
    return " + ".join(f"{of.format(i=i)} * gen[{entry}]" for entry, (i, k) in pairs if k == column)


def _lean(chart: Chart) -> str:
    """Where columns are inputs, each its own, C that moves the slopes ``tilt`` into ``gradient``."""
    if chart.pairs != [(k, k) for k in range(chart.inputs)]:
        return ""
    share = "tilt[k] / (gen[k] > zero ? gen[k] : zero + 1.0)"
    return f"for (int k = 0; k < C; ++k) {{ gradient[k] += gen[k] > zero ? {share} : zero; tilt[k] = zero; }}"


def _layer(shape: NetworkShape, index: int, at: int) -> str:
    inputs, neurons, name, linear = shape.layers[index]
    activation, bent = activation_of(name), _bent(shape, index)
    passes = index + 1 < len(shape.layers) and _bent(shape, index + 1)
    flags = {"BENDS": int(activation.bends), "BENT": int(bent), "PASSES": int(passes)}
    own = constants(INPUTS=inputs, NEURONS=neurons, LINEAR=linear, AT=at, **flags)
    room = "INFINITY" if activation.limit == np.inf else constant(ROOM)
    unused = " ".join(f"(void){each};" for each in ("LINEAR", "AT", "ROOM", *flags))
    return f"{own} const double ROOM = {room}; {unused} auto& own = layer{index}; (void)own;"


def _bent(shape: NetworkShape, index: int) -> bool:
    """Whether the arguments of a layer have parabolas in them."""
    return any(activation_of(name).bends for _, _, name, _ in shape.layers[:index])


def _forwards(shape: NetworkShape, index: int, at: int) -> str:
    """One hidden layer's means, slopes, spreads and generators, from those of the layer below or from the chart's."""
    chart, (_, neurons, activation, _) = shape.chart, shape.layers[index]
    if index == 0:
        generators = " ".join(f"g[{k}] = {_product(chart, k, 'x[{i}]')};" for k in range(chart.columns))
        neurons_text = FIRST.replace("GENERATORS", generators)
    else:
        bent = _bent(shape, index)
        neurons_text = f"const auto& below = layer{index - 1};"
        if bent:
            neurons_text += "\n".join(_in_blocks(each, neurons) for each in _tiles(chart.columns))
        neurons_text += _in_blocks(LATER, neurons, chart.columns + 2 + bent)
    bends = activation_of(activation).bends
    neurons_text = neurons_text.replace("NEURON\n", NEURON.replace("RELAX", CURVES if bends else LINES))
    return f"""
{LAYER.replace("LAYER", f"layer{index}").replace("NEURONS", str(neurons))} {{
{_layer(shape, index, at)}
auto& {"curve = curve" if bends else "relax = relax"}_{activation};
const double* b = w + AT; const double* weight = b + NEURONS; const double pad = padding[{index}];
{neurons_text}
}}"""


def _backwards(shape: NetworkShape, index: int, at: int) -> str:
    to = f"back{index - 1}" if index else "gradient"
    return f"""
{f"V {to}[{shape.layers[index][0]}];" * (index > 0)} {{
{_layer(shape, index, at)}
V* to = {to}; const V* back = back{index};
{BACKWARDS}
}}"""


def _values(shape: NetworkShape, index: int, at: int) -> str:
    """From the activations ``y`` of the layer below, or the inputs, to those of a hidden layer."""
    _, neurons, activation, _ = shape.layers[index]
    return f"""
V y{index}[{neurons}]; {{
{_layer(shape, index, at)}
const V* x = y; V* y = y{index}; const double* b = w + AT; auto& act = act_{activation};
{_in_blocks(VALUES, neurons)}
}}
y = y{index};"""


def _tiles(columns: int) -> list[str]:
    """Texts that sum the entries of quadratic forms, as many at a time as fit the registers."""
    entries = columns * (columns + 1) // 2 + 1
    tiles = -(-entries // (REGISTERS // ROWS - 1))
    ends = [entries * tile // tiles for tile in range(tiles + 1)]
    return [f"{constants(ENTRY=a, ENTRIES=b - a)} {SQUARES_OF_ARGUMENTS}" for a, b in pairwise(ends)]


def _in_blocks(body: str, neurons: int, sums: int = 1) -> str:
    """A text for blocks of R neurons, each of which has so many sums, that fit the registers; and for the rest."""
    rows = max(min(ROWS, REGISTERS // sums), 1)
    blocks = [(0, rows, neurons // rows), (neurons // rows * rows, neurons % rows, 1)]
    return "\n".join(f"{{ {constants(FIRST=f, R=r, BLOCKS=n)} {body} }}" for f, r, n in blocks if r and n)


def _constrain(chart: Chart, start: str, factors: list[tuple[int, str]]) -> str:
    """Add a constraint of the chart (``Chart.constraints``) to the bound."""
    terms: dict[int, list[str]] = {}
    for entry, (i, k) in enumerate(chart.pairs):
        terms.setdefault(k, []).extend(f"{factor} * gen[{entry}]" for j, factor in factors if j == i)
    moved = [k for k in sorted(terms) if terms[k]]
    values = ", ".join(" + ".join(terms[k]) for k in moved)
    names = f"constexpr int M = {len(moved)}, OF[M] = {{{', '.join(map(str, moved))}}};"
    return "\n".join([f"{{ {names} const V excess = {start}; const V q[M] = {{{values}}};", CONSTRAIN, "}"])


def load_text(source: str, row: str) -> str:
    """C statement that fills ``low[]`` and ``high[]`` of lane ``l`` from 2 Z numbers of ``source`` at row ``row``."""
    return f"""{{
    const double* at = {source} + (long long)({row}) * (2 * BOX);
    for (int k = 0; k < BOX; ++k) {{ LANE(low[k]) = at[k]; LANE(high[k]) = at[BOX + k]; }}
}}"""


def snippet(shape: NetworkShape) -> str:
    """The body of the kernel of ``bound_boxes``: a block of boxes on a CPU, one box on CUDA."""
    return stored(shape, body(shape), AXIS + STORE)


def stored(shape: NetworkShape, bounds: str, store: str) -> str:
    """A kernel's body: C that loads boxes, does what ``bounds`` says for those of all lanes, and ``store`` for each."""
    names = "const double* w = weights.data; const double* padding = paddings.data; double* rows = boxes.data;\n"
    names += constants(BOX=shape.chart.size, BLOCK=BLOCK) + f" constexpr double HALVED = {constant(HALVED)};"
    cpu, cuda = lanes_text(shape, names)
    return f"""
#if !defined(__CUDA_ARCH__)
{cpu}
const int begin = block * BLOCK; const int end = begin + BLOCK < count ? begin + BLOCK : count;
for (int i = begin; i < end; i += L) {{
    V low[BOX], high[BOX];
    for (int l = 0; l < L; ++l) {{ const int j = i + l < end ? i + l : end - 1; {load_text("rows", "j")} }}
    {bounds}
    for (int l = 0; l < L && i + l < end; ++l) {{ {store} }}
}}
#else
{cuda}
const int i = block, l = 0; if (i >= count) return;
V low[BOX], high[BOX];
{load_text("rows", "i")}
{bounds}
{{ {store} }}
#endif
#undef LANE
"""


# The bounds of ``Network.bound`` as one fused native kernel: float64, one box per SIMD lane.


@cache
def _kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "boxes"))

    @name.block_kernel(snippet(shape))
    def bound_all(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        least_out: wp.array(dtype=wp.float64),
        value_out: wp.array(dtype=wp.float64),
        axes: wp.array(dtype=wp.int32),
        point: wp.array(dtype=wp.float64),
        gradient_out: wp.array(dtype=wp.float64),
        level_out: wp.array(dtype=wp.float64),
    ): ...

    return bound_all


def double_array(values: np.ndarray, device: wp.Device) -> wp.array:
    """Float64 numbers on a device; a CPU's array shares memory with ``values``, which the caller keeps alive."""
    return wp.array(values.reshape(-1), dtype=wp.float64, device=device, copy=not device.is_cpu)


def bound_boxes(
    shape: NetworkShape,
    weights: np.ndarray,
    padding: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    numbers: np.ndarray | None = None,
    table: np.ndarray | None = None,
    device="cpu",
) -> BoxBounds:
    """Bounds of a network over boxes.

    Args:
        shape: The network's shape, and the chart.
        weights: ``Network.packed``: float64, per hidden layer biases ``(H,)``, weights ``(H, K)`` in row order and
            their absolute values, then the output's bias and weights.
        padding: ``Network.padding``: float64, a bound of what each layer's float64 arithmetic rounds, the output's
            last.
        lower: ``(N, Z)`` float64, lower corners in the chart's numbers.
        upper: ``(N, Z)`` float64, upper corners.
        numbers: float64 parameters of the chart.
        table: int32 parameters of the chart.
        device: Warp device.
    """
    count, size = lower.shape
    device = wp.get_device(device)
    held = [
        np.ascontiguousarray(a, dtype=np.float64) for a in (np.concatenate([lower, upper], axis=1), weights, padding)
    ]
    held.append(np.zeros(1) if numbers is None else np.ascontiguousarray(numbers, dtype=np.float64))
    outputs = [wp.empty(count, dtype=wp.float64, device=device) for _ in range(2)]
    outputs += [
        wp.empty(2 * count, dtype=wp.int32, device=device),
        wp.empty(count * size, dtype=wp.float64, device=device),
        wp.empty(count * shape.ndim, dtype=wp.float64, device=device),
        wp.empty(count, dtype=wp.float64, device=device),
    ]
    boxes, *parameters = (double_array(a, device) for a in held)
    if count:
        words = wp.array(np.zeros(1, np.int32) if table is None else table, dtype=wp.int32, device=device)
        inputs = [boxes, count, 0, *parameters, words]
        launch_blocks(_kernel(shape), count, inputs, outputs, device, first_index=2, block=BLOCK)
    least, value, axes, point, slope, level = (o.numpy() for o in outputs)
    shapes = [(2, count), (count, size), (count,), (count, shape.ndim), (count,)]
    numbers = (axes, point, value, slope, level)
    (axis, next_axis), point, value, *linear = (part.reshape(s) for part, s in zip(numbers, shapes, strict=True))
    return BoxBounds(least, axis, point, value, next_axis, *linear, boxes.numpy().reshape(count, 2, size))


# Multilinear bounds of a network over boxes of its inputs, as their values at the corners: one box per SIMD lane.

_STORE = """
const long long o = i + l;
for (int k = 0; k < 1 << C; ++k) corner_out.data[o * (1 << C) + k] = LANE(corner[k]);
"""


@cache
def _corner_kernel(shape: NetworkShape) -> wp.Kernel:
    name = named(unique_name(shape, "corners"))
    bounds = body(shape, "false", multilinear=True) + CORNERS

    @name.block_kernel(stored(shape, bounds, _STORE))
    def corners_of_all(
        boxes: wp.array(dtype=wp.float64),
        count: int,
        block: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        corner_out: wp.array(dtype=wp.float64),
    ): ...

    return corners_of_all


def bound_corners(
    shape: NetworkShape, weights: np.ndarray, padding: np.ndarray, lower: np.ndarray, upper: np.ndarray, device="cpu"
) -> np.ndarray:
    """Numbers at the corners of boxes: f is at least what is multilinear between them, certified.

    Args:
        shape: The network's shape, and the plain chart.
        weights: ``Network.packed``.
        padding: ``Network.padding``.
        lower: ``(N, n)`` float64, lower corners.
        upper: ``(N, n)`` float64, upper corners.
        device: Warp device.

    Returns:
        ``(N, 2^n)`` float64; the corner at place i is the upper one on axis k where bit k of i is set.
    """
    count, size = lower.shape
    device = wp.get_device(device)
    held = (np.concatenate([lower, upper], axis=1), weights, padding)
    held = [np.ascontiguousarray(each, dtype=np.float64) for each in held]
    corner = wp.empty(count << size, dtype=wp.float64, device=device)
    if count:
        boxes, *parameters = (double_array(each, device) for each in held)
        launch_blocks(
            _corner_kernel(shape), count, [boxes, count, 0, *parameters], [corner], device, first_index=2, block=BLOCK
        )
    return corner.numpy().reshape(count, 1 << size)
