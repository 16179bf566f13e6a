"""The sine.

In float32 it is a range reduction ``r = z - n pi`` in two steps and an odd polynomial of degree 7; ``error`` bounds
its distance from the true sine, for arguments up to ``limit``; networks that reach farther are refused. The
libraries' ``sinf`` differ from device to device and promise nothing.

The relaxation (``relax``) encloses the sine around a centre z by a parabola with a band. The argument is ``z + x``,
``x = l + y``: l is linear in the coordinates of a box, ``|l| <= near``, and of y only ``|y| <= noise`` is known. With
``D = near + noise``, so that ``|x| <= D``, of ``sin(z + x) = sin z cos x + cos z sin x``

* ``cos x`` lies within ``D^4 / 192 + D^6 / 720`` of ``1 - D^4 / 192 + (D^2 / 24 - 1/2) x^2``: the series
  ``1 - x^2/2 + x^4/24 - ...`` alternates, and ``u^2`` is within 1/8 of ``u - 1/8`` on [0, 1], ``u = x^2 / D^2``;
* ``sin x`` lies within ``D^3 / 24 + D^5 / 120`` of ``(1 - D^2 / 8) x``: its series alternates too, and ``x^3`` is
  within ``D^3 / 4`` of ``3 D^2 x / 4``.

Only l may be squared, so ``x^2`` is replaced by ``l^2 + noise^2 / 2``, from which it differs by at most
``2 near noise + noise^2 / 2``. Of three enclosures the one with the narrowest band is taken: this parabola; the line
for which ``cos x`` is replaced by ``1 - D^2 / 4``, within ``D^2 / 4``; and the constant 0 with the band [-1, 1].
"""

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warp_bounding.activations.base import Activation, constant
from warp_bounding.activations.tanh import TANH
from warp_bounding.arithmetic import TINY, UNIT32, gamma
from warp_bounding.kernels.source import Lanes, literal

if TYPE_CHECKING:
    import torch

__all__ = ["COEFFICIENTS", "INVERSE_PI", "LIMIT", "MAGIC", "PI_HIGH", "PI_LOW", "SINE"]

# PI_HIGH has 8 significant bits, so n * PI_HIGH is exact for |n| < 2^16; PI_LOW is the float32 nearest the rest.
INVERSE_PI = float(np.float32(1.0 / math.pi))
PI_HIGH = 3.140625
PI_LOW = float(np.float32(math.pi - PI_HIGH))
# 1.5 * 2^23: for |x| < 2^22, x + MAGIC is rounded to an integer n, whose parity is the lowest bit of the float32
# pattern.
MAGIC = 12582912.0
# sin r is about r + c3 r^3 + c5 r^5 + c7 r^7 for |r| <= REDUCED, a minimax fit rounded to float32. Nothing rests on how
# good it is: ``_polynomial_error`` bounds the error of these very numbers.
COEFFICIENTS = tuple(float.fromhex(c) for c in ("-0x1.555022p-3", "0x1.10607p-7", "-0x1.83c008p-13"))
LIMIT = 4096.0  # largest |argument| of the certified range
# Just above pi / 2: the reduced argument r, its error included, stays under it for |z| <= LIMIT (asserted in
# ``error``).
REDUCED = 1.5725

# Bound of the error of the float64 sine and cosine of bounds for |z| <= 2^13: Taylor remainders under 7e-12 (degrees 15
# and 16 on [-pi/2, pi/2]), the reduction under 2^-52 (1 + n 2^-30), about 30 roundings of terms under 2. ``relax`` adds
# 4 SLACK (1 + D^2) to its band: mean, slope and band carry at most 4 such errors together.
#
# Why 2^13 is enough: a network's arguments are certified up to LIMIT = 2^12 for activations of size at most 1. In
# bounds a neuron's centre, its mean plus half of the parabola's height, is at most 2: where the constant 0 is not
# taken, spread and half of the height together are at most 1. So sums of centres are at most twice as large.
SLACK = 1e-11
# Pi in three float64 parts: the first 34 bits, exact times n < 2^12 (|z| < 2^13); the next 32 bits; the rest.
PI_PARTS = (float.fromhex("0x1.921fb544p+1"), float.fromhex("0x1.0b4611a6p-33"), float.fromhex("0x1.3198a2e037073p-68"))

_S1, _S2, _S3 = COEFFICIENTS


@wp.func
def _plain(z: float):
    q = z * INVERSE_PI + MAGIC
    n = q - MAGIC
    r = (z - n * PI_HIGH) - n * PI_LOW
    s = r * r
    p = r + (r * s) * (_S1 + s * (_S2 + s * _S3))
    if int(n) & 1:
        p = -p
    return p


class _Sine(Activation):
    name = "sin"
    plain = _plain
    limit, largest = LIMIT, 1.0
    bends = True
    wave, support_gains = True, (3.0, 1.7)

    @property
    def monotone(self) -> Activation:
        """A monotone network needs an activation that never falls, and has tanh in the sine's place."""
        return TANH

    def statement(self, lanes: Lanes, target: str, z: str) -> str:
        s1, s2, s3 = (literal(c) for c in COEFFICIENTS)
        body = (
            f"V q_ = z_ * {literal(INVERSE_PI)} + {literal(MAGIC)}; V n_ = q_ - {literal(MAGIC)}; "
            f"V r_ = (z_ - n_ * {literal(PI_HIGH)}) - n_ * {literal(PI_LOW)}; V s_ = r_ * r_; "
            f"V p_ = r_ + (r_ * s_) * ({s1} + s_ * ({s2} + s_ * {s3})); "
        )
        if lanes.vector:
            sign = f"{target} = (V)((I)p_ ^ ((I)q_ << 31));"  # bit 0 of q_ is the parity of n_
        else:
            sign = (
                "union { float f; unsigned int i; } a_, b_; a_.f = p_; b_.f = q_; "
                f"a_.i ^= b_.i << 31; {target} = a_.f;"
            )
        return f"{{ V z_ = {z}; {body}{sign} }}"

    def value32(self, z: np.ndarray) -> np.ndarray:
        f = np.float32
        q = z * f(INVERSE_PI) + f(MAGIC)
        n = q - f(MAGIC)
        r = (z - n * f(PI_HIGH)) - n * f(PI_LOW)
        r2 = r * r
        s1, s2, s3 = (f(c) for c in COEFFICIENTS)
        p = r + (r * r2) * (s1 + r2 * (s2 + r2 * s3))
        return np.where(q.view(np.int32) & 1, -p, p)

    def error(self, limit: float) -> float:
        """Bound of ``|computed - sine|``; about 1.3e-6 for small limits.

        Raises:
            ValueError: If ``limit`` is outside the certified range.
        """
        if not 0 <= limit <= LIMIT:
            raise ValueError(f"the sine is certified for arguments up to {LIMIT}, got {limit}")
        u = UNIT32
        # n is within 1/2 + 3 u |z| / pi of z / pi: it is rounded to an integer, the product is rounded, and so is 1 /
        # pi.
        count = limit / math.pi + 1.0  # bound of |n|
        reduced = math.pi / 2 + 3 * u * limit
        # n * PI_HIGH is exact; each subtraction rounds once; n * PI_LOW rounds once unless fused; the rest of pi is
        # left out.
        rest = abs(math.pi - PI_HIGH - PI_LOW) + 2e-16  # 2e-16: pi itself in float64
        first = u * (reduced + count * PI_LOW)
        reduction = first + u * count * PI_LOW + u * (reduced + first) + count * rest
        reduced += reduction
        assert reduced <= REDUCED, "the certified range of the sine outgrew its polynomial"
        # Roundings that a term of the polynomial meets on its way, counted for the unfused evaluation.
        s1, s2, s3 = (abs(c) for c in COEFFICIENTS)
        x = REDUCED
        evaluation = gamma(1) * x + gamma(5) * s1 * x**3 + gamma(8) * s2 * x**5 + gamma(10) * s3 * x**7
        return (_polynomial_error() + evaluation + reduction) * (1 + 1e-9) + 16 * TINY

    def value(self, z: np.ndarray) -> np.ndarray:
        return np.sin(z)

    def relax(self, z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
        sine, cosine = np.sin(z), np.cos(z)
        size = near + noise
        square = size * size
        odd = np.abs(cosine) * (size * square * (1 / 24 + square / 120)) + 4 * SLACK * (1 + square)
        bend = sine * (square / 24 - 0.5)
        line = np.abs(sine) * (square / 4) + odd  # the band of the line; curve is that of the parabola
        half = noise * noise / 2
        fourth = np.abs(sine) * (square * square * (1 / 192 + square / 720))
        curve = fourth + np.abs(bend) * (2 * noise * near + half) + odd
        curved = curve < line
        spread = np.where(curved, curve, line)
        mean = np.where(curved, sine * (1 - square * square / 192) + bend * half, sine * (1 - square / 4))
        bend = np.where(curved, bend, 0.0)
        slope = cosine * (1 - square / 8)
        flat = spread + np.abs(bend) * near * near / 2 > 1
        slope[flat], mean[flat], bend[flat], spread[flat] = 0.0, 0.0, 0.0, 1.0
        return slope, mean, bend, spread

    def relaxation(self) -> str:
        return f"""{_sincos()}
auto act_sin = [&](V z) {{ V s, c; sincos(z, s, c); return s; }};
auto relax_sin = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {{
    V s, c; sincos(z, s, c); const V d = near + noise; const V d2 = d * d; const V d4 = d2 * d2;
    const V as = s < zero ? -s : s; const V ac = c < zero ? -c : c;
    const V odd = ac * (d * d2 * (d2 * {constant(1 / 120)} + {constant(1 / 24)})) + (d2 + 1.0) * {constant(4 * SLACK)};
    V k = s * (d2 * {constant(1 / 24)} - 0.5); const V ak = k < zero ? -k : k;
    const V line = as * d2 * 0.25 + odd; const V half = noise * noise * 0.5;
    const V fourth = as * d4 * (d2 * {constant(1 / 720)} + {constant(1 / 192)});
    const V curve = fourth + ak * (noise * near * 2.0 + half) + odd;
    V e = curve < line ? curve : line;
    V m = curve < line ? s - s * d4 * {constant(1 / 192)} + k * half : s - s * d2 * 0.25;
    k = curve < line ? k : zero; const V size = e + (curve < line ? ak * near * near * 0.5 : zero);
    slope = size > 1.0 ? zero : c - c * d2 * 0.125; mean = size > 1.0 ? zero : m; bend = size > 1.0 ? zero : k;
    spread = size > 1.0 ? zero + 1.0 : e;
}};
"""

    def torch_value(self, z: "torch.Tensor", out: "torch.Tensor | None" = None) -> "torch.Tensor":
        import torch

        return torch.sin(z, out=out)

    def torch_slope(self, z: "torch.Tensor", h: "torch.Tensor", out: "torch.Tensor") -> None:
        import torch

        torch.cos(z, out=out)


def _sincos() -> str:
    """A C lambda ``sincos(z, s, c)``: Taylor polynomials at ``z - n pi``, n = round(z / pi), negated where n is odd."""
    high, middle, low = (constant(part) for part in PI_PARTS)
    factorial = np.cumprod([1.0, *range(1, 17)])
    s_terms = [constant((-1) ** (k // 2) / factorial[k]) for k in range(1, 16, 2)]
    c_terms = [constant((-1) ** (k // 2) / factorial[k]) for k in range(0, 17, 2)]
    return f"""
auto sincos = [&](V z, V& s, V& c) {{
    const V q = z * {constant(1 / np.pi)} + 6755399441055744.0; const V n = q - 6755399441055744.0; // 1.5 * 2^52
    const V r = ((z - n * {high}) - n * {middle}) - n * {low}; const V r2 = r * r;
    V s_ = zero + {s_terms[-1]}; {" ".join(f"s_ = s_ * r2 + {t};" for t in reversed(s_terms[:-1]))} s_ = s_ * r;
    V c_ = zero + {c_terms[-1]}; {" ".join(f"c_ = c_ * r2 + {t};" for t in reversed(c_terms[:-1]))}
#if !defined(__CUDA_ARCH__)
    const I sign = (I)q << 63; s = (V)((I)s_ ^ sign); c = (V)((I)c_ ^ sign); // bit 0 of q is the parity of n
#else
    const bool odd = ((long long)n) & 1; s = odd ? -s_ : s_; c = odd ? -c_ : c_;
#endif
}};"""


@lru_cache(maxsize=1)
def _polynomial_error() -> float:
    """Proven bound of ``|p(r) - sin r|`` on ``|r| <= REDUCED``, with p's coefficients as stored, no rounding.

    On a grid of spacing h the error ``e(r) = p(r) - sin r`` and its derivative are evaluated in float64; between grid
    points e moves by at most ``h/2 max|e'|``, and e' by at most ``h/2 max|e''|``, where ``|e''|`` is bounded term by
    term.
    """
    s1, s2, s3 = COEFFICIENTS
    r = np.linspace(0.0, REDUCED, 1 << 16)  # e is odd
    h = float(r[1] - r[0])
    difference = r + s1 * r**3 + s2 * r**5 + s3 * r**7 - np.sin(r)
    slope = 1 + 3 * s1 * r**2 + 5 * s2 * r**4 + 7 * s3 * r**6 - np.cos(r)
    x = REDUCED
    curvature = 1.0 + 6 * abs(s1) * x + 20 * abs(s2) * x**3 + 42 * abs(s3) * x**5
    largest_slope = float(np.abs(slope).max()) + h / 2 * curvature
    return float(np.abs(difference).max()) + h / 2 * largest_slope + 1e-14  # 1e-14: float64 evaluation, values under 4


SINE = _Sine()
