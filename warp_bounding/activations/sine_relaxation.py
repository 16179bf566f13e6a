"""The relaxation of the sine by a parabola, in NumPy and as text of the kernel in ``network_source``.

``sin(z + x) = sin z cos x + cos z sin x`` for ``|x| <= D``, and

* ``cos x`` lies within ``D^4 / 192 + D^6 / 720`` of ``1 - D^4 / 192 + (D^2 / 24 - 1/2) x^2``: the series
  ``1 - x^2/2 + x^4/24 - ...`` alternates, and ``u^2`` within 1/8 of ``u - 1/8`` on [0, 1], ``u = x^2 / D^2``;
* ``sin x`` lies within ``D^3 / 24 + D^5 / 120`` of ``(1 - D^2 / 8) x``: likewise, and ``x^3`` within ``D^3 / 4`` of ``3 D^2 x / 4``.

Of ``x = l + y`` only l is known as a linear function (of zeta, ``|l| <= near``), y is noise (``|y| <= noise``): ``x^2`` is within
``2 near noise + noise^2 / 2`` of ``l^2 + noise^2 / 2``. Where a line is as good as the parabola, ``cos x`` within ``D^2 / 4`` of ``1 - D^2 / 4``, it is taken, and
where neither is better than [-1, 1], that is.
"""

import numpy as np

__all__ = ["SINE_SLACK", "relax_sin", "sine_text"]

# |error| of the kernel's sine and cosine for |z| <= 2^13: Taylor remainders under 7e-12 (degrees 15 and 16 on [-pi/2, pi/2]),
# the reduction under 2^-52 (1 + n 2^-30), about 30 roundings of terms under 2. Mean, slope and spread carry it at most 4 times.
# Arguments are certified up to 2^12 with activations of size 1. A relaxed neuron's centre is a mean plus half a parabola, and at
# most 2: where it is not flat, spread and half of the parabola's height together are at most 1. So centres of arguments stay below 2^13.
SINE_SLACK = 1e-11


def relax_sin(z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
    """``sin(z + l + y)`` as ``mean + slope (l + y) + bend l^2 +- spread``; see module.

    Args:
        z: ``(N, H)``, centres.
        near: ``(N, H)``, largest ``|l|``.
        noise: ``(N, H)``, largest ``|y|``.

    Returns:
        slope, mean, bend, spread; float64 rounding is the caller's.
    """
    sine, cosine = np.sin(z), np.cos(z)
    size = near + noise
    square = size * size
    odd = np.abs(cosine) * (size * square * (1 / 24 + square / 120)) + 4 * SINE_SLACK * (1 + square)
    bend = sine * (square / 24 - 0.5)
    line = np.abs(sine) * (square / 4) + odd
    half = noise * noise / 2
    curve = np.abs(sine) * (square * square * (1 / 192 + square / 720)) + np.abs(bend) * (2 * noise * near + half) + odd
    curved = curve < line
    spread = np.where(curved, curve, line)
    mean = np.where(curved, sine * (1 - square * square / 192) + bend * half, sine * (1 - square / 4))
    bend = np.where(curved, bend, 0.0)
    slope = cosine * (1 - square / 8)
    flat = spread + np.abs(bend) * near * near / 2 > 1
    slope[flat], mean[flat], bend[flat], spread[flat] = 0.0, 0.0, 0.0, 1.0
    return slope, mean, bend, spread


def sine_text() -> str:
    """C lambdas ``act_sin(z)`` and ``relax_sin(z, near, noise, slope, mean, bend, spread)``, the operations of ``relax_sin``."""
    return f"""{_sincos()}
auto relax_sin = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {{
    V s, c; sincos(z, s, c); const V d = near + noise; const V d2 = d * d; const V d4 = d2 * d2;
    const V as = s < zero ? -s : s; const V ac = c < zero ? -c : c;
    const V odd = ac * (d * d2 * (d2 * {_constant(1 / 120)} + {_constant(1 / 24)})) + (d2 + 1.0) * {_constant(4 * SINE_SLACK)};
    V k = s * (d2 * {_constant(1 / 24)} - 0.5); const V ak = k < zero ? -k : k;
    const V line = as * d2 * 0.25 + odd; const V half = noise * noise * 0.5;
    const V curve = as * d4 * (d2 * {_constant(1 / 720)} + {_constant(1 / 192)}) + ak * (noise * near * 2.0 + half) + odd;
    V e = curve < line ? curve : line; V m = curve < line ? s - s * d4 * {_constant(1 / 192)} + k * half : s - s * d2 * 0.25;
    k = curve < line ? k : zero; const V size = e + (curve < line ? ak * near * near * 0.5 : zero);
    slope = size > 1.0 ? zero : c - c * d2 * 0.125; mean = size > 1.0 ? zero : m; bend = size > 1.0 ? zero : k;
    spread = size > 1.0 ? zero + 1.0 : e;
}};
auto act_sin = [&](V z) {{ V s, c; sincos(z, s, c); return s; }};
"""


def _constant(value: float) -> str:
    return float(value).hex()


def _sincos() -> str:
    """A lambda ``sincos(z, s, c)``."""
    high = float.fromhex("0x1.921fb544p+1")  # the first 34 bits of pi; times n < 2^12 (|z| < 2^13) exact
    middle = float.fromhex("0x1.0b4611a6p-33")  # the next 32
    low = float.fromhex("0x1.3198a2e037073p-68")  # and the rest to double precision
    factorial = np.cumprod([1.0, *range(1, 17)])
    s_terms = [_constant((-1) ** (k // 2) / factorial[k]) for k in range(1, 16, 2)]
    c_terms = [_constant((-1) ** (k // 2) / factorial[k]) for k in range(0, 17, 2)]
    sine = (
        f"V s_ = zero + {s_terms[-1]}; {' '.join(f's_ = s_ * r2 + {t};' for t in reversed(s_terms[:-1]))} s_ = s_ * r;"
    )
    cosine = f"V c_ = zero + {c_terms[-1]}; {' '.join(f'c_ = c_ * r2 + {t};' for t in reversed(c_terms[:-1]))}"
    return f"""
auto sincos = [&](V z, V& s, V& c) {{
    const V q = z * {_constant(1 / np.pi)} + 6755399441055744.0; const V n = q - 6755399441055744.0;
    const V r = ((z - n * {_constant(high)}) - n * {_constant(middle)}) - n * {_constant(low)}; const V r2 = r * r;
    {sine}
    {cosine}
    FLIP(s, s_) FLIP(c, c_)
}};"""
