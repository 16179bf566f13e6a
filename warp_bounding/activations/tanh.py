"""The hyperbolic tangent.

In float32 the argument is clamped to ``+-END``, and an odd polynomial of degree 7 is divided by an even one of degree
8, all of whose coefficients are positive; ``error`` bounds the distance from the true tanh. The libraries' ``tanhf``
differ from device to device and promise nothing.

The relaxation is linear, one slope on both sides, ``s = tanh'(q) = 1 - tanh(q)^2``: on an interval ``tanh x - s x``
is extreme at the ends, or where ``tanh' x = s``, that is at q and -q, if they lie inside. So the values there give
the tightest band of that slope, and any q is sound. In a narrow interval that does not hold 0, q is the centre,
elsewhere about where tanh is as steep as its chord. Where the slope is off by the error e of the computed tanh, the
extremes lie elsewhere, but inside an interval of half-width d they are larger by no more than ``2 e 2 d``. Where the
band of slope 0 is narrower, that is taken.
"""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warp_bounding.activations.base import Activation, constant, polynomial
from warp_bounding.arithmetic import TINY, gamma
from warp_bounding.kernels.source import Lanes, literal

if TYPE_CHECKING:
    import torch

__all__ = ["DENOMINATOR", "END", "NUMERATOR", "TANH"]

# tanh z = z P(z^2) / Q(z^2) on |z| <= END, minimax; beyond, the value at the end. Lowest power first, Q(0) = 1.
END = 7.75
NUMERATOR = tuple(map(float.fromhex, ("0x1.fffffp-1", "0x1.08eea2p-3", "0x1.845ce8p-9", "0x1.844d3ep-17")))
DENOMINATOR = tuple(
    map(float.fromhex, ("0x1p+0", "0x1.d9cc2cp-2", "0x1.86f718p-6", "0x1.f8404ap-13", "0x1.0d4bf8p-22"))
)
DIVISION = 4  # roundings that a division counts for: correctly rounded it is one, CUDA's fast one errs by two units

# The float64 tanh of bounds is 1 - 2 / (E + 1), E = exp(2 |x|) as the 64th power of a Taylor polynomial of degree 16,
# |x| cut at 20. The remainder is 1e-18; the polynomial's positive terms round by at most 4 u, the squarings make 64
# times that of it and add 63 u. So E has a relative error of at most 3.6e-14, and tanh an error of at most 2e-14 (and
# 9e-18 of the cut). NumPy's tanh is better.
SLACK = 1e-13
CUT, SQUARINGS, DEGREE = 20.0, 6, 16
NARROW = 1.0  # half-width up to which an interval that does not hold 0 takes its centre as q
FLATTER = 0.2  # in other intervals q is divided by 1 + FLATTER times the half-width; any number is sound

_P, _Q = wp.types.vector(length=4, dtype=float)(*NUMERATOR), wp.types.vector(length=5, dtype=float)(*DENOMINATOR)


@wp.func
def _plain(z: float):
    z = wp.clamp(z, -END, END)
    s = z * z
    numerator = _P[0] + s * (_P[1] + s * (_P[2] + s * _P[3]))
    denominator = _Q[0] + s * (_Q[1] + s * (_Q[2] + s * (_Q[3] + s * _Q[4])))
    return z * numerator / denominator


class _Tanh(Activation):
    name = "tanh"
    plain = _plain
    largest = 1.0

    def statement(self, lanes: Lanes, target: str, z: str) -> str:
        return (
            f"{{ V z_ = {z}; const V zero_ = {{}}; const V end_ = zero_ + {literal(END)}; "
            "z_ = z_ > end_ ? end_ : z_; z_ = z_ < -end_ ? -end_ : z_; const V s_ = z_ * z_; "
            f"{target} = over(z_ * ({polynomial(NUMERATOR, 's_')}), {polynomial(DENOMINATOR, 's_')}); }}"
        )

    def value32(self, z: np.ndarray) -> np.ndarray:
        f = np.float32
        z = np.clip(z, f(-END), f(END))
        numerator, denominator = (_horner([f(c) for c in cs], z * z) for cs in (NUMERATOR, DENOMINATOR))
        return z * numerator / denominator

    def error(self, limit: float) -> float:
        """Bound of ``|computed - tanh|``; about 2e-6, whatever the limit."""
        return _error()

    def value(self, z: np.ndarray) -> np.ndarray:
        return np.tanh(z)

    def relax(self, z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
        width = near + noise
        low, high, away, third = z - width, z + width, np.abs(z), width / np.sqrt(3.0)
        q = (0.96 * np.maximum(away, third) + 0.4 * np.minimum(away, third)) / (1 + FLATTER * width)
        q = np.maximum(np.where((away >= width) & (width <= NARROW), away, q), away - width)
        at_low, at_high, at_q = np.tanh(low), np.tanh(high), np.tanh(q)
        slope = 1 - at_q * at_q
        first, last, inner = at_low - slope * low, at_high - slope * high, at_q - slope * q
        most, least = np.maximum(first, last), np.minimum(first, last)
        most = np.where((q <= high) & (q >= low), np.maximum(most, inner), most)
        least = np.where((-q <= high) & (-q >= low), np.minimum(least, -inner), least)
        flat = at_high - at_low < most - least
        most, least = np.where(flat, at_high, most), np.where(flat, at_low, least)
        slope = np.where(flat, 0.0, slope)
        spread = (most - least) / 2 + 4 * SLACK * (1 + width)
        return slope, (most + least) / 2 + slope * z, np.zeros_like(z), spread

    def relaxation(self) -> str:
        factorial = np.cumprod([1.0, *range(1, DEGREE + 1)])
        power = " ".join(f"e = e * w + {constant(1 / f)};" for f in factorial[-2::-1])
        return f"""
auto act_tanh = [&](V x) {{
    V a = x < zero ? -x : x; a = a > {CUT} ? zero + {CUT} : a; const V w = a * {constant(2.0 / 2**SQUARINGS)};
    V e = zero + {constant(1 / factorial[-1])}; {power} {"e = e * e;" * SQUARINGS}
    const V t = 1.0 - 2.0 / (e + 1.0); return x < zero ? -t : t;
}};
auto relax_tanh = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {{
    const V d = near + noise; const V low = z - d; const V high = z + d;
    const V away = z < zero ? -z : z; const V third = d * {constant(3.0**-0.5)};
    V q = (away > third ? away * 0.96 + third * 0.4 : third * 0.96 + away * 0.4) / (d * {FLATTER} + 1.0);
    q = ((away >= d) & (d <= {NARROW})) ? away : q; q = q < away - d ? away - d : q;
    const V at_low = act_tanh(low); const V at_high = act_tanh(high); const V at_q = act_tanh(q);
    V s = 1.0 - at_q * at_q;
    const V first = at_low - s * low; const V last = at_high - s * high; const V inner = at_q - s * q;
    V most = first > last ? first : last; V least = first > last ? last : first;
    most = ((q <= high) & (q >= low) & (inner > most)) ? inner : most;
    least = ((-q <= high) & (-q >= low) & (-inner < least)) ? -inner : least;
    const V step = at_high - at_low; const V gap = most - least;
    s = step < gap ? zero : s; most = step < gap ? at_high : most; least = step < gap ? at_low : least;
    slope = s; mean = (most + least) * 0.5 + s * z; bend = zero;
    spread = (most - least) * 0.5 + (d + 1.0) * {constant(4 * SLACK)};
}};
"""

    def torch_value(self, z: "torch.Tensor", out: "torch.Tensor | None" = None) -> "torch.Tensor":
        import torch

        return torch.tanh(z, out=out)

    def torch_slope(self, z: "torch.Tensor", h: "torch.Tensor", out: "torch.Tensor") -> None:
        import torch

        torch.mul(h, h, out=out).neg_().add_(1)


def _horner(coefficients: list[np.float32], s: np.ndarray) -> np.ndarray:
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = c + s * value
    return value


@lru_cache(maxsize=1)
def _error() -> float:
    """Bound of ``|computed tanh - true tanh|`` for any float32 argument, fused or not.

    With ``R = N / M``, ``N(x) = x P(x^2)`` and ``M(x) = Q(x^2)``, on a grid of spacing h over [0, END]: between two
    grid points ``D = R - tanh`` is within ``h^2/8 max|D''|`` of a straight line. N, M and their derivatives have no
    negative coefficients, so they grow, and on ``[a, b]`` ``|R''| <= (N''(b) M(b) + N(b) M''(b)) / M(a)^2 + 2 M'(b)
    (N'(b) M(b) + N(b) M'(b)) / M(a)^3``; ``|tanh''| <= 4 / (3 sqrt 3)``. Beyond the end the true tanh lies between
    its value there and 1.

    Rounding: the term of ``s^k`` in a polynomial passes at most ``2 k + 1`` roundings of its own and those of k
    factors s, and no term is negative. The division by a computed ``Q (1 + t)``, ``|t| <= g``, adds ``g / (1 - g)``.
    """
    x = np.linspace(0.0, END, 1 << 16)
    h = float(x[1] - x[0])
    n, m = np.zeros(2 * len(NUMERATOR)), np.zeros(2 * len(DENOMINATOR) - 1)
    n[1::2], m[::2] = NUMERATOR, DENOMINATOR
    (n0, n1, n2), (m0, m1, m2) = ([np.polynomial.Polynomial(c).deriv(d)(x) for d in range(3)] for c in (n, m))
    least = m0[:-1]
    bent = (n2 * m0 + n0 * m2)[1:] / least**2 + 2 * (m1 * (n1 * m0 + n0 * m1))[1:] / least**3
    approximation = float(np.abs(n0 / m0 - np.tanh(x)).max()) + h * h / 8 * (float(bent.max()) + 0.77)
    approximation = max(approximation, abs(1.0 - float(n0[-1] / m0[-1]))) + 1e-14  # 1e-14: float64 evaluation
    # The rounding of N and of M relative to M's least value; N = x P has one more, that of the product with x.
    n[1::2] *= [gamma(3 * k + 2) for k in range(len(NUMERATOR))]
    m[::2] *= [gamma(3 * k + 1) for k in range(len(DENOMINATOR))]
    above, below = (np.polynomial.Polynomial(c)(x)[1:] / least for c in (n, m))
    ratio = n0[1:] / least
    evaluation = (above + ratio * (below / (1 - below) + gamma(DIVISION))) * (1 + 1e-5)  # 1e-5: errors of errors
    return (approximation + float(evaluation.max())) * (1 + 1e-9) + 16 * TINY


TANH = _Tanh()
