"""E: how far f may be from its exact value when float32 computes it, derived from the operations of the C text.

Believed of float32: an operation returns the exact result times ``1 + e``, ``|e| <= U``, or errs by at most TINY where
the result is subnormal; subnormal numbers may be read as 0; a fused multiply-add leaves out a rounding. The sine is
``q = z * INVERSE_PI + MAGIC, n = q - MAGIC, r = (z - n * PI_HIGH) - n * PI_LOW, s = r * r, p = r + (r * s) * (S1 + s *
(S2 + s * S3))``, and -p where n is odd, all float32; INVERSE_PI is 1 / pi, MAGIC 1.5 2^23: q and n are whole numbers.

Around the F of a distance: p is v cut off at ``limit``, r = v - p, ``h = max(F(p) + threshold, 0)``, ``g = sqrt(r . r +
h h)``, ``g - 38 U (|v|_1 + g)``, and that times 1 / scale is answered if it exceeds 2^-60, else 0.
"""

import math

import flint
import numpy as np

U, TINY, UP = 2.0**-24, 2.0**-126, 1 + 2.0**-30  # UP is above what the float64 sums of positive numbers here round
AROUND = 2.0**-60  # of E, for what is subnormal in the operations around the F of a distance: docs/verifier.md
PI_HIGH, PI_LOW = 3.140625, float(np.float32(math.pi - 3.140625))
S1, S2, S3 = (float.fromhex(c) for c in ("-0x1.555022p-3", "0x1.10607p-7", "-0x1.83c008p-13"))
REACH, PIECES = 1.5725, 4096  # the |r| up to which the polynomial is compared with the sine, in so many pieces


def affine(weight: np.ndarray, bias: np.ndarray, size: np.ndarray, error: np.ndarray):
    """Size and error of ``W h + b``: K products and b pass K additions at most, products one rounding more."""
    weight, terms = np.abs(weight), weight.shape[1]
    gamma = (terms + 1) * U / (1 - (terms + 1) * U)
    computed = weight @ (size + error) + np.abs(bias)
    if not (computed < 2.0**120).all():
        raise OverflowError("sums of float32 may overflow in some order")
    flushed = 2 * TINY * (2 * terms + 2 + weight.sum(axis=1) + (size + error).sum())
    return (weight @ size + np.abs(bias)) * UP, (weight @ error + gamma * computed + flushed) * UP


def sine(largest: float) -> float:
    """How far the computed sine is from the sine, for arguments of at most this absolute value."""
    away = 0.5 + largest / math.pi * 3 * U + TINY  # of n from z / pi: 1 / pi, the product and n are rounded
    count = largest / math.pi + away  # bound of |n|; n PI_HIGH is exact below 2^16, as PI_HIGH has 8 bits
    first = U * (math.pi * away + count * (math.pi - PI_HIGH) * UP) + TINY
    second = U * count * PI_LOW + TINY
    error = first + second + U * (math.pi * away + first + second) + TINY
    error += count * (abs(math.pi - PI_HIGH - PI_LOW) + 2.0**-51)
    if not (count < 2.0**16 and (math.pi * away + error) * UP <= REACH):
        raise OverflowError(f"arguments of a sine reach {largest:.3g}")
    terms = ((1, 1, 1), (5, S1, 3), (8, S2, 5), (10, S3, 7))  # how often what becomes c r^n of p is rounded, c, and n
    rounded = sum(k * abs(c) * REACH**n for k, c, n in terms) * U / (1 - 10 * U) + 64 * TINY
    return (polynomial() + rounded + error) * UP


def polynomial() -> float:
    """Largest ``|p(r) - sin r|`` for ``|r| <= REACH``, by Arb and the mean value theorem on each piece; p is odd."""
    worst, half, (s1, s2, s3) = flint.arb(0), flint.arb(REACH) / (2 * PIECES), (flint.arb(c) for c in (S1, S2, S3))
    for piece in range(PIECES):
        m = half * (2 * piece + 1)
        r = m + flint.arb(0, 1) * half
        value = m + m**3 * s1 + m**5 * s2 + m**7 * s3 - m.sin()
        slope = 1 + 3 * r**2 * s1 + 5 * r**4 * s2 + 7 * r**6 * s3 - r.cos()
        worst = worst.max(abs(value) + abs(slope) * half)
    return math.nextafter(float(worst.upper()), math.inf)


def network(layers, activation: str, limit: np.ndarray) -> float:
    """E of a network of float32 inputs up to ``limit``; sine and ReLU have slopes of at most 1."""
    size, error = limit, np.zeros_like(limit)
    for weight, bias in layers[:-1]:
        size, error = affine(weight, bias, size, error)
        if activation == "sin":
            size, error = np.ones_like(size), error + sine(float((size + error).max()))
    return float(affine(*layers[-1], size, error)[1].max())


def faces(directions: np.ndarray, offsets: np.ndarray, limit: np.ndarray, axes: bool) -> float:
    """E of the least ``offset - d . v``; where d are axes there is no product."""
    if axes:
        return float(((limit.max() + np.abs(offsets).max()) * U + 4 * TINY) * UP)
    size, error = affine(directions, np.zeros(len(directions)), limit, np.zeros_like(limit))
    return float(((error + U * (size + error + np.abs(offsets)) + 4 * TINY) * UP).max())


def grid(values: np.ndarray, low: float) -> float:
    """E of a distance-grid; where values are of 8 bits, ``low`` is that of 0. See docs/verifier.md."""
    rises = [np.abs(np.diff(values, axis=k)).max() * count for k, count in enumerate(values.shape)]
    return float((4 * U * sum(rises) + 21 * U * max(np.abs(values).max(), abs(low))) * UP)
