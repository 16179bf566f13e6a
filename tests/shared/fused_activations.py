"""The kernels' activations in NumPy: the same float32 operations, with every multiply-add fused and with none."""

import numpy as np

from warp_bounding import activations as sine_file

F32 = np.float32


def fused_sine(z: np.ndarray) -> np.ndarray:
    """The kernels' sine with every multiply-add fused: float64 holds such products exactly, one rounding follows.

    The sum is rounded twice (to float64, then to float32); that differs from a true fused operation at exact ties only,
    and by no more than one unit in 2^29 of the last place.
    """

    def fma(a, b, c):
        return (a.astype(np.float64) * np.asarray(b, dtype=np.float64) + np.asarray(c, dtype=np.float64)).astype(F32)

    q = fma(z, F32(sine_file.INVERSE_PI), sine_file.MAGIC)
    n = q - F32(sine_file.MAGIC)
    r = fma(n, -F32(sine_file.PI_LOW), fma(n, -F32(sine_file.PI_HIGH), z))
    r2 = r * r
    s1, s2, s3 = (F32(c) for c in sine_file.COEFFICIENTS)
    inner = fma(r2, fma(r2, s3, s2), s1)
    p = fma(r * r2, inner, r)
    return np.where(q.view(np.int32) & 1, -p, p)


def plain_sine(z: np.ndarray) -> np.ndarray:
    q = z * F32(sine_file.INVERSE_PI) + F32(sine_file.MAGIC)
    n = q - F32(sine_file.MAGIC)
    r = (z - n * F32(sine_file.PI_HIGH)) - n * F32(sine_file.PI_LOW)
    r2 = r * r
    s1, s2, s3 = (F32(c) for c in sine_file.COEFFICIENTS)
    p = r + (r * r2) * (s1 + r2 * (s2 + r2 * s3))
    return np.where(q.view(np.int32) & 1, -p, p)


PLAIN = {"sin": plain_sine, "relu": lambda z: np.maximum(z, F32(0))}
FUSED = PLAIN | {"sin": fused_sine}
