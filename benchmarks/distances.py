"""Distances of a mesh: bytes, false positives of points at several radii and of segments, ns a point and a segment, in lanes and one by one.

Run from the repository: ``python benchmarks/distances.py``. The mesh is the bunny that comes with Warp; lengths are shares of half its longest side.
All times are medians of runs that take turns. Truth is the mesh itself.
"""

import time
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from warp_bounding.indicators.shape import IN, OUT
from warp_bounding.kernels.distances.batch import march_kernel

POINTS, SEGMENTS, ROUNDS = 200_000, 100_000, 7
RADII = (0.0, 0.02, 0.05, 0.1, 0.2)
METHODS = (
    ("aabb", {}),
    ("sphere", {}),
    ("ellipsoid", {}),
    ("kdop", {}),
    ("learned-kdop", {"budget": 10}),
    ("bvh", {"leaves": 64, "resolution": 192}),
    ("bvh", {"leaves": 300, "resolution": 192}),
    ("distance-grid", {"nodes": 16, "storage": "uint8"}),
    ("distance-grid", {"nodes": 24, "storage": "uint8"}),
    ("distance-grid", {"nodes": 32}),
    ("mlp", {"hidden": (24, 24), "budget": 120}),
    ("mlp", {"hidden": (32, 32), "budget": 120}),
)


def main() -> None:
    wp.config.quiet = True
    wp.init()
    shape = wb.load_indicator(str(next(Path(wp.__file__).parent.rglob("bunny.usd"))))
    size, rng = float(shape.extent.max()), np.random.default_rng(0)
    lower, upper = shape.lower - 0.1 * size, shape.upper + 0.1 * size
    x = rng.uniform(lower, upper, (POINTS, 3)).astype(np.float32)
    away, started = shape.distances(x)[:, 0], time.perf_counter()
    near = (shape.points(POINTS, rng) + rng.normal(size=(POINTS, 3)) * 0.02 * size).astype(np.float32)
    shape.distances(near)
    print(f"labels near the mesh: {POINTS / (time.perf_counter() - started) / 1e6:.2f} million a second")
    a = rng.uniform(lower, upper, (SEGMENTS, 3)).astype(np.float32)
    d = rng.normal(size=a.shape)
    b = (a + d / np.linalg.norm(d, axis=1, keepdims=True) * size / 2).astype(np.float32)
    truth = shape.decide_segments(a.astype(np.float64), b.astype(np.float64))
    print(
        "| method | bytes | "
        + " | ".join(f"FP % at {r}" for r in RADII)
        + " | segments | ns a point | ns a segment | one by one |"
    )
    print("|---" * (len(RADII) + 6) + "|")
    for method, options in METHODS:
        bounder = wb.fit(shape, "distance", method, device="cpu", progress=False, **options)
        g = bounder.distance(x).numpy()
        rates = [100 * ((g <= r * size / 2) & (away > r * size / 2)).mean() for r in RADII]
        maybe = bounder.segments(a, b)[0].numpy()
        assert not ((maybe == 0) & (truth == IN)).any()
        kernel = march_kernel(bounder.source, True, False)
        flat = [wp.array(part.ravel(), dtype=float, device="cpu") for part in (a, b)]
        out = [wp.empty(SEGMENTS, dtype=kind, device="cpu") for kind in (wp.uint8, wp.float32)]
        zero = wp.zeros(1, dtype=float, device="cpu")

        def alone(bounder=bounder, kernel=kernel, flat=flat, zero=zero, out=out) -> None:
            wb.launch_on_cores(kernel, SEGMENTS, [bounder.data, *flat, zero, 0, zero, 0, 32], out, "cpu")

        ways = (lambda: bounder.distance(x), lambda: bounder.segments(a, b), alone)  # noqa: B023 (called here)
        taken = [[] for _ in ways]
        for _ in range(ROUNDS):
            for way, times in zip(ways, taken, strict=True):
                begun = time.perf_counter()
                way()
                times.append(time.perf_counter() - begun)
        point, lanes, one = (np.median(times) for times in taken)
        told = ", ".join(f"{key} {value}" for key, value in options.items() if key != "budget")
        numbers = [f"{rate:.2f}" for rate in rates] + [f"{100 * ((maybe == 1) & (truth == OUT)).mean():.2f}"]
        numbers += [f"{point / POINTS * 1e9:.0f}", f"{lanes / SEGMENTS * 1e9:.0f}", f"{one / SEGMENTS * 1e9:.0f}"]
        print(f"| {method} {told} | {bounder.nbytes:,} | {' | '.join(numbers)} |", flush=True)


if __name__ == "__main__":
    main()
