"""Float32 and float64 rounding, and the one sine and the one tanh that every kernel and every proof uses.

The error model is the standard one (Higham, *Accuracy and Stability of Numerical Algorithms*, ch. 2 and 3): each
operation returns the exact result times ``1 + e`` with ``|e| <= u``, plus at most ``TINY`` where the result is
subnormal, whether subnormals are kept or flushed. A sum of K products carries at most ``gamma(K + 1)`` times the sum
of the absolute products, in any order, fused or not; so what is proven here holds for every lane width, summation
order and device.

The sine is a range reduction ``r = z - n pi`` in two steps and an odd polynomial of degree 7; ``sine_error`` bounds its
distance from the true sine. The tanh clamps its argument to ``+-TANH_END`` and divides an odd polynomial of degree 7 by
an even one of degree 8, all of whose coefficients are positive; ``tanh_error`` bounds its distance from the true tanh. The
libraries' ``sinf`` and ``tanhf`` differ from device to device and promise nothing.
"""

import math
from functools import lru_cache

import numpy as np

__all__ = [
    "LARGEST",
    "SINE_LIMIT",
    "TANH_DENOMINATOR",
    "TANH_END",
    "TANH_NUMERATOR",
    "TINY",
    "UNIT32",
    "UNIT64",
    "gamma",
    "round_down",
    "round_up",
    "sine",
    "sine_error",
    "tanh32",
    "tanh_error",
]

UNIT32 = 2.0**-24  # largest relative rounding error of float32, round to nearest
UNIT64 = 2.0**-53
LARGEST = 2.0**120  # sums of absolute values stay under it, so that no partial sum overflows in any order
TINY = 2.0**-126  # largest absolute error of a float32 operation whose result is subnormal (flushed to zero)

# Sine. PI_HIGH has 8 significant bits, so n * PI_HIGH is exact for |n| < 2^16; PI_LOW is the float32 nearest the rest.
SINE_INVERSE_PI = float(np.float32(1.0 / math.pi))
SINE_PI_HIGH = 3.140625
SINE_PI_LOW = float(np.float32(math.pi - SINE_PI_HIGH))
SINE_MAGIC = 12582912.0  # 1.5 * 2^23: adding it rounds to an integer and leaves its parity in the lowest bit
SINE_COEFFICIENTS = tuple(float.fromhex(c) for c in ("-0x1.555022p-3", "0x1.10607p-7", "-0x1.83c008p-13"))  # minimax
SINE_LIMIT = 4096.0  # arguments beyond are outside the certified range; networks that reach it are refused
SINE_REDUCED = 1.5725  # |r| stays under it for |z| <= SINE_LIMIT (checked in sine_error)

# tanh z = z P(z^2) / Q(z^2) on |z| <= TANH_END, minimax; beyond, the value at the end. Lowest power first, Q(0) = 1.
TANH_END = 7.75
TANH_NUMERATOR = tuple(map(float.fromhex, ("0x1.fffffp-1", "0x1.08eea2p-3", "0x1.845ce8p-9", "0x1.844d3ep-17")))
TANH_DENOMINATOR = tuple(
    map(float.fromhex, ("0x1p+0", "0x1.d9cc2cp-2", "0x1.86f718p-6", "0x1.f8404ap-13", "0x1.0d4bf8p-22"))
)
DIVISION = 4  # roundings that a division counts for: correctly rounded it is one, CUDA's fast one errs by two units


def gamma(count: int, unit: float = UNIT32) -> float:
    """Bound of the accumulated relative error of ``count`` roundings, ``k u / (1 - k u)``, itself rounded up."""
    k = count * unit
    if k >= 0.5:
        raise ValueError(f"gamma needs count * unit < 1/2, got count={count}")
    return k / (1.0 - k) * (1.0 + 8 * UNIT64)


def round_down(value) -> np.ndarray:
    """Largest float32 that is not above ``value`` (elementwise)."""
    value = np.asarray(value, dtype=np.float64)
    with np.errstate(over="ignore"):
        nearest = value.astype(np.float32)
        return np.where(nearest.astype(np.float64) > value, np.nextafter(nearest, np.float32(-np.inf)), nearest)


def round_up(value) -> np.ndarray:
    """Smallest float32 that is not below ``value`` (elementwise)."""
    return -round_down(-np.asarray(value, dtype=np.float64))


def sine(z: np.ndarray) -> np.ndarray:
    """NumPy twin of the kernels' sine: the same float32 operations, without fused multiply-adds.

    Args:
        z: float32, ``|z| <= SINE_LIMIT``.

    Returns:
        float32, within ``sine_error(max |z|)`` of the true sine.
    """
    f = np.float32
    q = z * f(SINE_INVERSE_PI) + f(SINE_MAGIC)
    n = q - f(SINE_MAGIC)
    r = (z - n * f(SINE_PI_HIGH)) - n * f(SINE_PI_LOW)
    r2 = r * r
    s1, s2, s3 = (f(c) for c in SINE_COEFFICIENTS)
    p = r + (r * r2) * (s1 + r2 * (s2 + r2 * s3))
    return np.where(q.view(np.int32) & 1, -p, p)


@lru_cache(maxsize=1)
def _polynomial_error() -> float:
    """Proven bound of ``|p(r) - sin r|`` on ``|r| <= SINE_REDUCED``, with p's coefficients as stored, no rounding.

    On a grid of spacing h the difference D and its derivative are evaluated in float64; between grid points D moves by
    at most ``h/2 max|D'|``, and D' by at most ``h/2 max|D''|``, where ``|D''|`` is bounded term by term.
    """
    s1, s2, s3 = SINE_COEFFICIENTS
    r = np.linspace(0.0, SINE_REDUCED, 1 << 16)  # the difference is odd
    h = float(r[1] - r[0])
    difference = r + s1 * r**3 + s2 * r**5 + s3 * r**7 - np.sin(r)
    slope = 1 + 3 * s1 * r**2 + 5 * s2 * r**4 + 7 * s3 * r**6 - np.cos(r)
    x = SINE_REDUCED
    curvature = 1.0 + 6 * abs(s1) * x + 20 * abs(s2) * x**3 + 42 * abs(s3) * x**5
    largest_slope = float(np.abs(slope).max()) + h / 2 * curvature
    return float(np.abs(difference).max()) + h / 2 * largest_slope + 1e-14  # 1e-14: float64 evaluation, values under 4


def sine_error(limit: float) -> float:
    """Bound of ``|computed sine - true sine|`` for float32 arguments up to ``limit``, fused or not.

    Args:
        limit: Largest argument in absolute value, at most ``SINE_LIMIT``.

    Returns:
        The bound (about 1.3e-6 for small limits).

    Raises:
        ValueError: If ``limit`` is outside the certified range.
    """
    if not 0 <= limit <= SINE_LIMIT:
        raise ValueError(f"the sine is certified for arguments up to {SINE_LIMIT}, got {limit}")
    u = UNIT32
    # n is within 1/2 + 3 u |z| / pi of z / pi: one rounding to an integer, one of the product, one of the constant.
    count = limit / math.pi + 1.0  # bound of |n|
    reduced = math.pi / 2 + 3 * u * limit
    # n * PI_HIGH is exact; each subtraction rounds once; n * PI_LOW rounds once unless fused; the rest of pi is left out.
    rest = abs(math.pi - SINE_PI_HIGH - SINE_PI_LOW) + 2e-16  # 2e-16: pi itself in float64
    first = u * (reduced + count * SINE_PI_LOW)
    reduction = first + u * count * SINE_PI_LOW + u * (reduced + first) + count * rest
    reduced += reduction
    assert reduced <= SINE_REDUCED, "the certified range of the sine outgrew its polynomial"
    # Roundings that a term of the polynomial meets on its way, counted for the unfused evaluation.
    s1, s2, s3 = (abs(c) for c in SINE_COEFFICIENTS)
    x = SINE_REDUCED
    evaluation = gamma(1) * x + gamma(5) * s1 * x**3 + gamma(8) * s2 * x**5 + gamma(10) * s3 * x**7
    return (_polynomial_error() + evaluation + reduction) * (1 + 1e-9) + 16 * TINY


def tanh32(z: np.ndarray) -> np.ndarray:
    """NumPy twin of the kernels' tanh: the same float32 operations, without fused multiply-adds.

    Args:
        z: float32, any finite number.

    Returns:
        float32, within ``tanh_error()`` of the true tanh.
    """
    f = np.float32
    z = np.clip(z, f(-TANH_END), f(TANH_END))
    s = z * z
    numerator, denominator = (_horner([f(c) for c in cs], s) for cs in (TANH_NUMERATOR, TANH_DENOMINATOR))
    return z * numerator / denominator


def _horner(coefficients, s: np.ndarray) -> np.ndarray:
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = c + s * value
    return value


@lru_cache(maxsize=1)
def tanh_error() -> float:
    """Bound of ``|computed tanh - true tanh|`` for any float32 argument, fused or not; about 2e-6.

    With ``R = N / M``, ``N(x) = x P(x^2)`` and ``M(x) = Q(x^2)``, on a grid of spacing h over [0, TANH_END]: between two grid
    points ``D = R - tanh`` is within ``h^2/8 max|D''|`` of a straight line. N, M and their derivatives have no negative
    coefficients, so they grow, and on ``[a, b]`` ``|R''| <= (N''(b) M(b) + N(b) M''(b)) / M(a)^2 + 2 M'(b) (N'(b) M(b) + N(b)
    M'(b)) / M(a)^3``; ``|tanh''| <= 4 / (3 sqrt 3)``. Beyond the end the true tanh lies between its value there and 1.

    Rounding: the term of ``s^k`` in a polynomial passes at most ``2 k + 1`` roundings of its own and those of k factors s, and
    no term is negative. The division by a computed ``Q (1 + t)``, ``|t| <= g``, adds ``g / (1 - g)``.
    """
    x = np.linspace(0.0, TANH_END, 1 << 16)
    h = float(x[1] - x[0])
    n, m = np.zeros(2 * len(TANH_NUMERATOR)), np.zeros(2 * len(TANH_DENOMINATOR) - 1)
    n[1::2], m[::2] = TANH_NUMERATOR, TANH_DENOMINATOR
    (n0, n1, n2), (m0, m1, m2) = ([np.polynomial.Polynomial(c).deriv(d)(x) for d in range(3)] for c in (n, m))
    least = m0[:-1]
    bent = (n2 * m0 + n0 * m2)[1:] / least**2 + 2 * (m1 * (n1 * m0 + n0 * m1))[1:] / least**3
    approximation = float(np.abs(n0 / m0 - np.tanh(x)).max()) + h * h / 8 * (float(bent.max()) + 0.77)
    approximation = max(approximation, abs(1.0 - float(n0[-1] / m0[-1]))) + 1e-14  # 1e-14: float64 evaluation
    # What float32 makes of N and of M, against M's least value; once more for N = x P.
    n[1::2] *= [gamma(3 * k + 2) for k in range(len(TANH_NUMERATOR))]
    m[::2] *= [gamma(3 * k + 1) for k in range(len(TANH_DENOMINATOR))]
    above, below = (np.polynomial.Polynomial(c)(x)[1:] / least for c in (n, m))
    ratio = n0[1:] / least
    evaluation = (above + ratio * (below / (1 - below) + gamma(DIVISION))) * (1 + 1e-5)  # 1e-5: errors of errors
    return (approximation + float(evaluation.max())) * (1 + 1e-9) + 16 * TINY
