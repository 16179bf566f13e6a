"""Activations' own C text, asked neuron by neuron: what encloses their values."""

from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.activations import ACTIVATIONS
from warp_bounding.networks.bounds import text
from warp_bounding.runtime.native import named

Doubles = wp.array(dtype=wp.float64)


class Curve(NamedTuple):
    """A line or a cubic with a band, each attribute as the arguments (``Activation.relaxation``)."""

    mean: np.ndarray
    slope: np.ndarray
    lean: np.ndarray
    bend: np.ndarray
    cube: np.ndarray
    cross: np.ndarray
    spread: np.ndarray


def enclosure(name: str, z: np.ndarray, near: np.ndarray, radius: np.ndarray, noise: np.ndarray) -> Curve:
    """What the text of an activation says of values at ``z + l + p + y``; see ``Activation.relaxation``."""
    x = np.stack([part.reshape(-1) for part in (z, near, radius, noise)], axis=1)
    out = np.zeros((len(x), len(Curve._fields)))
    arrays = [wp.array(each.reshape(-1), dtype=wp.float64, device="cpu", copy=False) for each in (x, out)]
    wp.launch(_kernel(name), (1, 1), [arrays[0], len(x), 0], [arrays[1]], device="cpu")
    return Curve(*(column.reshape(z.shape) for column in out.T))


@cache
def _kernel(name: str) -> wp.Kernel:
    if ACTIVATIONS[name].bends:
        call = f"curve_{name}(z, near, radius, noise, slope, mean, lean, bend, cube, cross, spread);"
    else:
        call = f"relax_{name}(z, near, radius + noise, slope, mean, bend, spread);"
    rows = "\n".join(f"y.data[(i + l) * {len(Curve._fields)} + {k}] = LANE({f});" for k, f in enumerate(Curve._fields))

    snippet = f"""
{text.CPU}{text.LANES}{text.VECTORS}
{ACTIVATIONS[name].relaxation()}
for (int i = 0; i < count; i += L) {{
    V z = zero, near = zero, radius = zero, noise = zero + 1.0;
    V mean = zero, slope = zero, lean = zero, bend = zero, cube = zero, cross = zero, spread = zero;
    for (int l = 0; l < L && i + l < count; ++l) {{
        const double* at = x.data + (i + l) * 4;
        LANE(z) = at[0]; LANE(near) = at[1]; LANE(radius) = at[2]; LANE(noise) = at[3];
    }}
    {call}
    for (int l = 0; l < L && i + l < count; ++l) {{ {rows} }}
}}
#undef LANE
"""

    @named(f"enclosure_{name}").block_kernel(snippet)
    def enclose(x: Doubles, count: int, block: int, y: Doubles): ...

    return enclose
