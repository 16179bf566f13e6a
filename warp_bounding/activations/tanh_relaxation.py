"""The linear relaxation of tanh, one slope on both sides, in NumPy and as text of the kernel in ``network_source``.

Of slope ``s = tanh'(q) = 1 - tanh(q)^2``: on an interval ``tanh x - s x`` is extreme at the ends, or where ``tanh' x = s``, that
is at q and -q, if they lie inside. So the values there give the tightest band of that slope, and any q is sound. In a
narrow interval beside 0, q is the centre, elsewhere about where tanh is as steep as its chord. A slope that is off by the
error e of the computed tanh has its extremes elsewhere, but inside the interval they are larger by no more than ``2 e 2 d``.
Where the band is wider than that of slope 0, the latter is taken.
"""

import numpy as np

__all__ = ["TANH_SLACK", "relax_tanh", "tanh_text"]

# The kernel's tanh is 1 - 2 / (E + 1), E = exp(2 |x|) as the 64th power of a Taylor polynomial of degree 16, |x| cut at 20.
# Remainder 1e-18; at most 4 u for the polynomial's positive terms, 64 times that and 63 u for the squarings: E within
# 3.6e-14, relatively, so tanh within 2e-14 (and 9e-18 for the cut). NumPy's is better.
TANH_SLACK = 1e-13
CUT, SQUARINGS, DEGREE = 20.0, 6, 16
NARROW = 1.0  # half-width up to which an interval beside 0 takes its centre
FLATTER = 0.2  # how fast q falls behind the width, elsewhere


def relax_tanh(z: np.ndarray, near: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
    """Slope, mean, bend (none) and spread of tanh on ``|x - z| <= near + noise``; see ``Activation.relax``."""
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
    spread = (most - least) / 2 + 4 * TANH_SLACK * (1 + width)
    return slope, (most + least) / 2 + slope * z, np.zeros_like(z), spread


def tanh_text() -> str:
    """C lambdas ``act_tanh(z)`` and ``relax_tanh(z, near, noise, slope, mean, bend, spread)``, the operations of ``relax_tanh``."""
    factorial = np.cumprod([1.0, *range(1, DEGREE + 1)])
    power = " ".join(f"e = e * w + {float(1 / f).hex()};" for f in factorial[-2::-1])
    return f"""
auto act_tanh = [&](V x) {{
    V a = x < zero ? -x : x; a = a > {CUT} ? zero + {CUT} : a; const V w = a * {(2.0 / 2**SQUARINGS).hex()};
    V e = zero + {float(1 / factorial[-1]).hex()}; {power} {"e = e * e;" * SQUARINGS}
    const V t = 1.0 - 2.0 / (e + 1.0); return x < zero ? -t : t;
}};
auto relax_tanh = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {{
    const V d = near + noise; const V low = z - d; const V high = z + d; const V away = z < zero ? -z : z; const V third = d * {(3.0**-0.5).hex()};
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
    slope = s; mean = (most + least) * 0.5 + s * z; bend = zero; spread = (most - least) * 0.5 + (d + 1.0) * {(4 * TANH_SLACK).hex()};
}};
"""
