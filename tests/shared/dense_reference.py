"""Bounds of small networks written out from the definitions, extended precision, nothing of the package: what kernels
must agree with.

An affine form ``center + G zeta + E eps``, all of zeta and eps in [-1, 1], runs through the network with one symbol eps
for every neuron's relaxation, never merged: concretising a layer, ``|G| 1 + |E| 1``, is then CROWN's backward
substitution down to the input, through the actual coefficients, for every pre-activation and for the output. With
``merged=True`` a neuron's eps are merged into one of its absolute sum before the next layer, as forward propagation
does; the output keeps them all.
"""

from fractions import Fraction
from itertools import pairwise, product

import numpy as np

REAL = np.longdouble


def sine_band(z, d):
    """Slope, mean, half-width of a band around sin on ``[z - d, z + d]``, from Taylor's remainders; or the band [-1,
    1]."""
    slope, mean = np.cos(z) * (1 - d**2 / 6), np.sin(z) * (1 - d**2 / 4)
    odd = d**3 / (9 * np.sqrt(REAL(3))) + d**5 / 120  # |sin t - t (1 - d^2 / 6)|
    even = d**2 / 4  # |cos t - (1 - d^2 / 4)|
    half = np.abs(np.cos(z)) * odd + np.abs(np.sin(z)) * even
    wide = half > 1
    return np.where(wide, 0, slope), np.where(wide, 0, mean), np.where(wide, REAL(1), half)


def relu_band(z, d):
    """The chord from end to end, and its parallel through 0, where the sign changes; else the line itself."""
    low, high = z - d, z + d
    crosses = (low < 0) & (high > 0)
    with np.errstate(all="ignore"):
        chord = np.where(crosses, high / (high - low), 0)
    slope = np.where(crosses, chord, np.where(low >= 0, REAL(1), REAL(0)))
    half = np.where(crosses, -chord * low / 2, 0)
    return slope, slope * z + half, half


BANDS = {"sin": sine_band, "relu": relu_band}
ACTIVATIONS = {"sin": np.sin, "relu": lambda z: np.maximum(z, 0), "tanh": np.tanh}


def stack(tensors, activation):
    """``(weight, bias, activation, rows that are copied)`` of all layers, from a bounder's tensors; the output has
    none."""
    layers, count = [], sum(name.startswith("layers.") for name in tensors) // 2
    if "encoding.weight" in tensors:
        weight, bias = (tensors[f"encoding.{part}"].astype(REAL) for part in ("weight", "bias"))
        n = weight.shape[1]
        rows = np.concatenate([np.eye(n, dtype=REAL), weight])
        layers.append((rows, np.concatenate([np.zeros(n, REAL), bias]), "sin", n))
    for index in range(count):
        weight, bias = (tensors[f"layers.{index}.{part}"].astype(REAL) for part in ("weight", "bias"))
        layers.append((weight, bias, activation if index < count - 1 else None, 0))
    return layers


def value(layers, v):
    """f of points ``(..., n)``."""
    h = np.asarray(v, dtype=REAL)
    for weight, bias, activation, copied in layers:
        z = np.einsum("...i,ji->...j", h, weight) + bias
        h = z if activation is None else ACTIVATIONS[activation](z)
        h[..., :copied] = z[..., :copied]
    return h[..., 0]


def bound(layers, lower, upper, merged=False):
    """Lower bounds of f over boxes ``(N, n)``, rounding aside."""
    lower, upper = lower.astype(REAL), upper.astype(REAL)
    boxes, n = lower.shape
    center = (lower + upper) / 2
    forms = (upper - lower)[:, :, None] / 2 * np.eye(n, dtype=REAL)  # (N, neurons, zeta)
    errors, noise = np.zeros((boxes, n, 0), REAL), np.zeros((boxes, n), REAL)  # (N, neurons, eps), and merged
    for weight, bias, activation, copied in layers:
        center = np.einsum("Ni,ji->Nj", center, weight) + bias
        forms, errors = (np.einsum("Nik,ji->Njk", part, weight) for part in (forms, errors))
        noise = np.einsum("Ni,ji->Nj", noise, np.abs(weight))
        linear, kept = np.abs(forms).sum(axis=2), np.abs(errors).sum(axis=2)
        if activation is None:
            return (center - linear - kept)[:, 0]
        slope, mean, half = BANDS[activation](center, linear + (noise if merged else kept))
        slope[:, :copied], mean[:, :copied], half[:, :copied] = 1, center[:, :copied], 0
        own = half[:, :, None] * np.eye(len(bias), dtype=REAL)
        center, forms = mean, forms * slope[:, :, None]
        errors, noise = np.concatenate([errors * slope[:, :, None], own], axis=2), np.abs(slope) * noise + half
    raise ValueError("the last layer must have no activation")


def extremes(activation, z, d, slope):
    """Least and greatest ``act(x) - slope x`` on ``[z - d, z + d]``, exactly: at the ends, or where ``act'`` is the
    slope."""
    z, d, slope = (np.asarray(a, dtype=REAL) for a in (z, d, slope))
    low, high = z - d, z + d
    if activation == "relu":
        inner = [np.zeros_like(z)]
    elif activation == "tanh":
        q = np.arctanh(np.sqrt(np.clip(1 - slope, 0, 1 - REAL(1e-18))))
        inner = [q, -q]
    else:  # the terms of a family differ by -2 pi slope: its first and its last in the interval are extreme
        turn, q = 8 * np.arctan(REAL(1)), np.arccos(np.clip(slope, -1, 1))
        ends = product((q, -q), ((np.ceil, low), (np.floor, high)))
        inner = [a + turn * rounding((end - a) / turn) for a, (rounding, end) in ends]
    points = np.stack([low, high, *(np.clip(x, low, high) for x in inner)])
    values = ACTIVATIONS[activation](points) - slope * points
    return values.min(axis=0), values.max(axis=0)


def least_of_piecewise_linear(layers, low, high):
    """Exact minimum, a fraction, of a ReLU network of one input on ``[low, high]``: between kinks it is linear."""
    exact = [
        ([[Fraction(float(x)) for x in row] for row in w], [Fraction(float(x)) for x in b], a) for w, b, a, _ in layers
    ]
    points = [Fraction(float(low)), Fraction(float(high))]
    for depth in range(
        1, len(exact)
    ):  # the kinks of layer `depth` lie where its sums vanish, linear between those before
        ends = [[sums(exact, depth, x)[j] for x in points] for j in range(len(exact[depth - 1][1]))]
        kinks = set(points)
        for sum_ in ends:
            for (x0, y0), (x1, y1) in pairwise(zip(points, sum_, strict=True)):
                if y0 * y1 < 0:
                    kinks.add(x0 + (x1 - x0) * y0 / (y0 - y1))
        points = sorted(kinks)
    return min(sums(exact, len(exact), x)[0] for x in points)


def sums(exact, depth, x):
    """What layer ``depth`` (from 1) computes before its activation, in fractions."""
    z = [x]
    for index, (weight, bias, _) in enumerate(exact[:depth]):
        h = [max(y, Fraction(0)) for y in z] if index else z
        z = [sum(w * y for w, y in zip(row, h, strict=True)) + b for row, b in zip(weight, bias, strict=True)]
    return z
