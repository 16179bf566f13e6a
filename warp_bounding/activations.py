"""Activations of hidden layers: the contract, ReLU, the sine, and the table of all by name.

An activation is one object, an entry of ``ACTIVATIONS``; one that is defined elsewhere is registered by ``register``.
Its slopes lie between -1 and 1: rounding and bounds are passed on through it undiminished.
"""

import math
from abc import ABC, abstractmethod
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import Lanes
from warp_bounding.rounding import TINY, UNIT32, gamma
from warp_bounding.runtime.native import constant, literal

if TYPE_CHECKING:
    import torch


class Activation(ABC):
    """What a hidden layer applies to each of its sums.

    Attributes:
        name: As users and files say it, and a part of names in C.
        limit: Largest |argument| for which ``error`` holds.
        largest: Bound of |value|; where it is ``None``, |value| <= |argument|.
        bends: Whether bounds enclose it by a cubic rather than by a line (``relaxation``).
        wave: Whether training begins with steep first layers (``Recipe.first_gain``), which tell neighbouring cells
            apart.
    """

    name: ClassVar[str]
    limit: ClassVar[float] = np.inf
    largest: ClassVar[float | None] = None
    bends: ClassVar[bool] = False
    wave: ClassVar[bool] = False

    # --- inference, float32 ------------------------------------------------------------------------------------------

    @abstractmethod
    def statement(self, lanes: Lanes, target: str, z: str) -> str:
        """A C statement that sets ``target`` to the value at ``z``, both of type ``V``."""

    @abstractmethod
    def error(self, limit: float) -> float:
        """Bound of ``|computed - true value|`` for float32 arguments up to ``limit``, fused or not."""

    # --- bounds, float64 ---------------------------------------------------------------------------------------------

    @abstractmethod
    def value(self, z: np.ndarray) -> np.ndarray:
        """The value at each of an array's numbers, as exactly as their type allows."""

    @abstractmethod
    def relaxation(self) -> str:
        """C lambdas for bounds: ``act_<name>(z)``, and a line or a cubic with a band that holds the values.

        The argument is ``z + l + p + y``: l is linear in the coordinates of a box, ``|l| <= near``; p is a quadratic
        form, ``|p| <= radius``; y is all the rest, ``|y| <= noise``; they are not all 0. The caller adds what float64
        rounds. ``relax_<name>(z, near, noise, slope, mean, bend, spread)`` is of an activation that does not bend, for
        which p is a part of y: the value is ``mean + slope (l + y)`` to within ``spread``, and bend is 0.
        ``curve_<name>(z, near, radius, noise, slope, mean, lean, bend, cube, cross, spread)`` is of one that bends: the
        value is ``mean + slope (l + p + y) + lean l + bend l^2 + cube l^3 + cross l p`` to within ``spread``. Numbers
        are of type ``V``: doubles, one a lane (``I`` are as many ``long long``), or on CUDA one double; ``zero`` is 0
        of that type.
        """

    # --- training ----------------------------------------------------------------------------------------------------

    @abstractmethod
    def torch_value(self, z: "torch.Tensor", out: "torch.Tensor | None" = None) -> "torch.Tensor":
        """The value in torch, which autograd knows."""

    @abstractmethod
    def torch_slope(self, z: "torch.Tensor", h: "torch.Tensor", out: "torch.Tensor") -> None:
        """Write the derivative at z, where ``h`` is the value, into ``out``."""


# The rectified linear unit, ``max(z, 0)``: exact in float32.
#
# Its relaxation is the chord of an interval, moved down by half of the corner's distance from it, with a band of that
# half-width.


class _Relu(Activation):
    name = "relu"

    def statement(self, lanes: Lanes, target: str, z: str) -> str:
        if lanes.vector:
            return f"{{ V z_ = {z}; const V o_ = {{}}; {target} = z_ > o_ ? z_ : o_; }}"
        return f"{{ V z_ = {z}; {target} = z_ > 0.0f ? z_ : z_ * 0.0f; }}"

    def error(self, limit: float) -> float:
        return 0.0

    def value(self, z: np.ndarray) -> np.ndarray:
        return np.maximum(z, 0.0)

    def relaxation(self) -> str:
        return """
auto act_relu = [&](V z) { return z > zero ? z : zero; };
auto relax_relu = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {
    const V d = near + noise; const V low = z - d; const V high = z + d; V s = high / (d + d);
    s = s < zero ? zero : s; s = s > zero + 1.0 ? zero + 1.0 : s;
    V e = s * low * -0.5; e = low < zero ? e : zero; e = high > zero ? e : zero;
    slope = s; mean = s * z + e; bend = zero; spread = e;
};
"""

    def torch_value(self, z: "torch.Tensor", out: "torch.Tensor | None" = None) -> "torch.Tensor":
        import torch

        return torch.clamp(z, min=0, out=out)

    def torch_slope(self, z: "torch.Tensor", h: "torch.Tensor", out: "torch.Tensor") -> None:
        import torch

        torch.gt(z, 0, out=out)


RELU = _Relu()


# The sine.
#
# In float32 it is a range reduction ``r = z - n pi`` in two steps and an odd polynomial of degree 7; ``error`` bounds
# its distance from the true sine, for arguments up to ``limit``; networks that reach farther are refused. The
# libraries' ``sinf`` differ from device to device and promise nothing.
#
# The relaxation encloses the sine around a centre z by a cubic with a band. The argument is ``z + x``, ``x
# = l + p + y``: l is linear in the coordinates of a box, ``|l| <= near``, p is a quadratic form, ``|p| <= radius``,
# and of y only ``|y| <= noise`` is known. With ``w = p + y``, ``W = radius + noise`` and ``D = near + W``, so that
# ``|x| <= D``, of ``sin(z + x) = sin z cos x + cos z sin x``
#
# * ``cos x`` lies within ``D^4 / 192 + D^6 / 720`` of ``1 - D^4 / 192 + (D^2 / 24 - 1/2) x^2``: the series
#   ``1 - x^2/2 + x^4/24 - ...`` alternates, and ``u^2`` is within 1/8 of ``u - 1/8`` on [0, 1], ``u = x^2 / D^2``;
# * ``sin x`` lies within ``D^5 / 1920 + D^7 / 5040`` of ``(1 - D^4 / 384) x + (D^2 / 96 - 1/6) x^3``: its series
#   alternates too, and ``x^5`` is within ``D^5 / 16`` of ``(20 D^2 x^3 - 5 D^4 x) / 16`` (Chebyshev).
#
# Only l may be squared and cubed, and multiplied by p. As ``0 <= w^2 <= W^2`` and ``0 <= l^2 <= near^2``,
#
# * ``x^2 = l^2 + 2 l p + 2 l y + w^2`` is within ``2 near noise + W^2 / 2`` of ``l^2 + 2 l p + W^2 / 2``;
# * ``x^3 = l^3 + 3 l^2 w + 3 l w^2 + w^3`` is within ``3/2 near^2 W + 3/2 near W^2 + W^3 / 4`` of ``l^3 + 3/2 near^2 w
#   + 3/2 W^2 l + 3/4 W^2 w``; w is x less l, which ``lean`` accounts for.
#
# Where it is narrower, the even part is the line for which ``cos x`` is ``1 - D^2 / 4``, within ``D^2 / 4``, and the
# odd part the line ``(1 - D^2 / 8) x``, within ``D^3 / 24 + D^5 / 120``: ``x^3`` is within ``D^3 / 4`` of ``3 D^2 x /
# 4``. Where the whole is no narrower than [-1, 1], it is the constant 0 with that band.

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
SINE_LIMIT = 4096.0  # largest |argument| of the certified range
# Just above pi / 2: the reduced argument r, its error included, stays under it for |z| <= LIMIT (asserted in
# ``error``).
REDUCED = 1.5725

# Bound of the error of the float64 sine and cosine of bounds for |z| <= 4000 pi: Taylor remainders under 7e-12 (degrees
# 15 and 16 on [-pi/2, pi/2]), the reduction under 2^-52 (1 + n 2^-30), about 30 roundings of terms under 2. The curve
# adds 4 SLACK (1 + D^2 + D^4) to its band: at x, mean, slopes, curves and band carry no more such errors together.
#
# Why it is enough up to 4000 pi > 3 LIMIT + 1: a network's arguments are certified up to LIMIT = 2^12 for activations
# of size at most 1. In bounds, a neuron's ``mean`` is within ``spread`` of a value, so at most 2 where the constant 0
# is not taken; less the middle of a quadratic form, at most 1 (``bounds.LARGEST_MIDDLE``), it is at most 3. So sums of
# means are at most three times as large as those of values, and the centre is off by one more middle.
SINE_SLACK = 1e-11
# Pi in three float64 parts: the first 34 bits, exact times n <= 2^12 (|z| <= 4000 pi); the next 32 bits; the rest.
PI_PARTS = (float.fromhex("0x1.921fb544p+1"), float.fromhex("0x1.0b4611a6p-33"), float.fromhex("0x1.3198a2e037073p-68"))


class _Sine(Activation):
    name = "sin"
    limit, largest = SINE_LIMIT, 1.0
    bends = True
    wave = True

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

    def error(self, limit: float) -> float:
        """Bound of ``|computed - sine|``; about 1.3e-6 for small limits.

        Raises:
            ValueError: If ``limit`` is outside the certified range.
        """
        if not 0 <= limit <= SINE_LIMIT:
            raise ValueError(f"the sine is certified for arguments up to {SINE_LIMIT}, got {limit}")
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

    def relaxation(self) -> str:
        return f"""{_sincos()}
auto act_sin = [&](V z) {{ V s, c; sincos(z, s, c); return s; }};
auto curve_sin = [&](V z, V near, V radius, V noise, V& slope, V& mean, V& lean, V& bend, V& cube, V& cross, V& spread) {{
    V s, c; sincos(z, s, c);
    const V w = radius + noise; const V d = near + w; const V d2 = d * d; const V n2 = near * near; const V w2 = w * w;
    const V d4 = d2 * d2; const V even = s < zero ? -s : s; const V odd = c < zero ? -c : c;
    const V k2 = s * (d2 * {constant(1 / 24)} - 0.5); const V k3 = c * (d2 * {constant(1 / 96)} - {constant(1 / 6)});
    const V height = k2 < zero ? -k2 : k2; const V rise = k3 < zero ? -k3 : k3;
    const V even_line = even * d2 * 0.25;
    const V even_curve = even * d4 * (d2 * {constant(1 / 720)} + {constant(1 / 192)})
        + height * (near * noise * 2.0 + w2 * 0.5);
    const V odd_line = odd * d2 * d * (d2 * {constant(1 / 120)} + {constant(1 / 24)});
    const V odd_curve = odd * d4 * d * (d2 * {constant(1 / 5040)} + {constant(1 / 1920)})
        + rise * (near * w * d * 1.5 + w2 * w * 0.25);
    const auto bends = even_curve < even_line; const auto twists = odd_curve < odd_line;
    const V e = (bends ? even_curve : even_line) + (twists ? odd_curve : odd_line)
        + (d2 + d4 + 1.0) * {constant(4 * SINE_SLACK)};
    const V size = e + (bends ? height * near * (near * 0.5 + radius * 2.0) : zero)
        + (twists ? rise * n2 * near * 0.25 : zero);
    const auto flat = size > zero + 1.0;
    const V m = bends ? s - s * d4 * {constant(1 / 192)} + k2 * w2 * 0.5 : s - s * d2 * 0.25;
    const V a = twists ? c - c * d4 * {constant(1 / 384)} + k3 * (n2 * 1.5 + w2 * 0.75) : c - c * d2 * 0.125;
    const V b = twists ? k3 * (w2 * 0.75 - n2 * 1.5) : zero;
    const V k = bends ? k2 : zero; const V t = twists ? k3 : zero;
    slope = flat ? zero : a; mean = flat ? zero : m; lean = flat ? zero : b; bend = flat ? zero : k; cross = bend + bend;
    cube = flat ? zero : t; spread = flat ? zero + 1.0 : e;
}};
"""  # noqa: E501

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


ACTIVATIONS: dict[str, Activation] = {each.name: each for each in (SINE, RELU)}
DEFAULT = SINE  # of hidden layers


def register(activation: Activation) -> None:
    """Make an activation that is defined elsewhere known by its name, to ``fit`` and ``load`` too.

    Raises:
        BounderError: If its name is taken, or cannot be a part of names in C.
    """
    if not activation.name.isidentifier() or not activation.name.isascii():
        raise BounderError(f"an activation's name must be letters, digits and underscores, got {activation.name!r}")
    if ACTIVATIONS.setdefault(activation.name, activation) is not activation:
        raise BounderError(f"there is another activation of the name {activation.name!r} already")


def activation_of(name) -> Activation:
    """The activation of a name.

    Raises:
        BounderError: If there is none of this name.
    """
    if not isinstance(name, str) or name not in ACTIVATIONS:
        raise BounderError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {name!r}")
    return ACTIVATIONS[name]
