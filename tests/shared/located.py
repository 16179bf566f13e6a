"""The coordinates that a device computes with, written out by the very text that bounders compile, and their exact
reference implementation."""

from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from warp_bounding.kernels.source import TOOLS
from warp_bounding.queries.region_domain import RegionDomain
from warp_bounding.queries.registry import locate
from warp_bounding.runtime.native import named

LANES = 8
EXACT = np.longdouble  # 64 bits of mantissa on x86; elsewhere it may be float64, which is far finer than float32 too


class Located(NamedTuple):
    """``v`` ``(N, ndim)`` float64, and the two answers that the text gives."""

    v: np.ndarray
    testable: np.ndarray
    inside: np.ndarray


@cache
def _kernel(query: str, n: int, time: bool, coordinates: int, lanes: bool) -> wp.Kernel:
    text = locate(query, n, time)
    head = f"""
const float* center = domain.data; const float* scale = center + {n}; const float* limit = center + {2 * n};
const float* extra = center + {3 * n};
"""
    write = f"for (int k = 0; k < {coordinates}; ++k) v_out.data[(long long)j * {coordinates} + k] = v[k]{{at}};"
    write += " answers.data[2 * j] = testable{at} != 0; answers.data[2 * j + 1] = inside{at} != 0;"
    if lanes:
        body = f"""
#pragma clang fp contract(fast)
{head}
constexpr int L = {LANES}; typedef float V __attribute__((vector_size(4 * L), aligned(4), may_alias));
{TOOLS}
const V zero = {{}};
V q[{2 * n}], v[{coordinates}];
for (int l = 0; l < L; ++l) for (int k = 0; k < {2 * n}; ++k) {{
    const int j = i * L + l < count ? i * L + l : count - 1; q[k][l] = x.data[(long long)j * {2 * n} + k];
}}
{text}
for (int l = 0; l < L && i * L + l < count; ++l) {{ const int j = i * L + l; {write.format(at="[l]")} }}
"""
    else:
        body = f"""
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(fast)
#endif
{TOOLS}
{head}
typedef float V; const float zero = 0.0f; V q[{2 * n}], v[{coordinates}]; const int j = i;
for (int k = 0; k < {2 * n}; ++k) q[k] = x.data[(long long)j * {2 * n} + k];
{text}
{write.format(at="")}
"""
    name = named(f"wb_test_locate_{query}_geometric_{n}d_{time:d}_{lanes:d}")

    @name.func_native(body)
    def native(
        x: wp.array(dtype=wp.float32),
        domain: wp.array(dtype=wp.float32),
        count: int,
        i: int,
        v_out: wp.array(dtype=wp.float32),
        answers: wp.array(dtype=wp.uint8),
    ): ...

    @name.kernel
    def write_out(
        # inputs
        x: wp.array(dtype=wp.float32),
        domain: wp.array(dtype=wp.float32),
        count: int,
        # outputs
        v_out: wp.array(dtype=wp.float32),
        answers: wp.array(dtype=wp.uint8),
    ):
        native(x, domain, count, wp.tid(), v_out, answers)

    return write_out


def located(domain: RegionDomain, q: np.ndarray, device: str = "cpu", lanes: bool = True) -> Located:
    """What a device makes of queries ``(N, 2 n)``: a vector of them at a time, or one (all that CUDA does)."""
    lanes = lanes and device == "cpu"
    with np.errstate(over="ignore"):
        flat = np.ascontiguousarray(q, dtype=np.float32).reshape(-1)
    values = np.concatenate([domain.header, domain.extra, [0.0]]).astype(np.float32)
    x, numbers = (wp.array(a, dtype=wp.float32, device=device) for a in (flat, values))
    v = wp.zeros(len(q) * domain.ndim, dtype=wp.float32, device=device)
    answers = wp.zeros(2 * len(q), dtype=wp.uint8, device=device)
    kernel = _kernel(domain.query, domain.space_ndim, domain.time, domain.ndim, lanes)
    dim = -(-len(q) // LANES) if lanes else len(q)
    wp.launch(kernel, dim=dim, inputs=[x, numbers, len(q)], outputs=[v, answers], device=device)
    answers = answers.numpy().reshape(-1, 2).astype(bool)
    return Located(v.numpy().reshape(len(q), domain.ndim).astype(np.float64), answers[:, 0], answers[:, 1])


def to_local(domain: RegionDomain, x: np.ndarray) -> np.ndarray:
    """Local coordinates, as nearly exact as NumPy can."""
    return (x.astype(EXACT) - domain.center.astype(EXACT)) * domain.scale.astype(EXACT)


def corners(domain: RegionDomain) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the domain in local space."""
    return to_local(domain, domain.lower), to_local(domain, domain.upper)


def ray_points(domain: RegionDomain, q: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points of rays inside the domain, where they enter, where they leave or end, or between: ``y (N, n)``, and which
    rays have one."""
    n = domain.space_ndim
    low, high = corners(domain)
    origin, d = to_local(domain, q[:, :n]), q[:, n:].astype(EXACT)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        d = d / np.abs(d).max(axis=1, keepdims=True)
        w = d / np.sqrt((d * d).sum(axis=1, keepdims=True)) * domain.scale.astype(EXACT) * EXACT(domain.length)
        near, far = (low - origin) / w, (high - origin) / w
        near, far = np.minimum(near, far), np.maximum(near, far)
    parallel, within = w == 0, (origin >= low) & (origin <= high)
    near = np.where(parallel, np.where(within, 0, 2), near)
    far = np.where(parallel, np.where(within, 1, -1), far)
    enter, leave = np.maximum(near.max(axis=1), 0), np.minimum(far.min(axis=1), 1)
    share = rng.choice([0.0, 1.0, 0.5, -1.0], size=len(q))
    share = np.where(share < 0, rng.random(len(q)), share)
    t = enter + share * (leave - enter)
    return origin + t[:, None] * w, enter <= leave


def ray_distance(v: np.ndarray, y: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """``(N,)``: least distance of segments ``v`` from points y, the largest over the axes, each in its ``unit``; from
    above."""
    n = y.shape[1]
    a, w = v[:, :n].astype(EXACT), v[:, n:].astype(EXACT)
    best = np.full(len(v), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = w / unit
        along = ((y - a) / unit * scaled).sum(axis=1) / (scaled * scaled).sum(axis=1)
        tries = [along, np.zeros(len(v)), np.ones(len(v)), *((y - a) / w).T]
    for t in tries:
        t = np.clip(np.nan_to_num(t), 0, 1)[:, None]
        best = np.minimum(best, (np.abs(a + t * w - y) / unit).max(axis=1))
    return best.astype(np.float64)


def plane_points(domain: RegionDomain, q: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points of planes inside the domain, on its faces, edges and corners for the most part, and which planes have such
    a one."""
    n = domain.space_ndim
    low, high = corners(domain)
    normal, point = q[:, :n].astype(EXACT), to_local(domain, q[:, n:])
    with np.errstate(divide="ignore", invalid="ignore"):
        m = normal / domain.scale.astype(EXACT)
        m = m / np.abs(m).max(axis=1, keepdims=True)
    share = rng.choice([0.0, 1.0, -1.0], size=point.shape)
    share = np.where(share < 0, rng.random(point.shape), share)
    y, row = low + share * (high - low), np.arange(len(q))
    pivot = np.abs(m).argmax(axis=1)
    y[row, pivot] += ((point - y) * m).sum(axis=1) / m[row, pivot]
    good = (y[row, pivot] >= low[pivot]) & (y[row, pivot] <= high[pivot])
    return y, good & np.isfinite(m).all(axis=1)
