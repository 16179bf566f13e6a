"""Float32 and float64 rounding: units, accumulated errors, numbers rounded outwards.

The error model is the standard one (Higham, *Accuracy and Stability of Numerical Algorithms*, ch. 2 and 3): each
operation returns the exact result times ``1 + e`` with ``|e| <= u``, plus at most ``TINY`` where the result is
subnormal, whether subnormals are kept or flushed. A sum of K products carries at most ``gamma(K + 1)`` times the sum
of the absolute products, in any order, fused or not; so what is proven here holds for every lane width, summation
order and device.
"""

import numpy as np

__all__ = [
    "LARGEST",
    "TINY",
    "UNIT32",
    "UNIT64",
    "gamma",
    "round_down",
    "round_up",
]

UNIT32 = 2.0**-24  # largest relative rounding error of float32, round to nearest
UNIT64 = 2.0**-53
LARGEST = 2.0**120  # sums of absolute values stay under it, so that no partial sum overflows in any order
TINY = 2.0**-126  # largest absolute error of a float32 operation whose result is subnormal (flushed to zero)


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
