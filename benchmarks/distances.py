"""Distances of a mesh: bytes, false positives of points at several radii and of segments, evaluations a segment, ns a point and a segment, in lanes and one by one.

Run from the repository: ``python benchmarks/distances.py``. The mesh is the bunny that comes with Warp; lengths are shares of half its longest side.
All times are medians of runs that take turns. Truth is the mesh itself. The last rows are Warp's own exact queries of the mesh, in a kernel on one core as the last column.
"""

import os
import time
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from warp_bounding.indicators.shape import IN, OUT
from warp_bounding.kernels.distances.batch import march_kernel

POINTS, SEGMENTS, ROUNDS, STEPS = 200_000, 100_000, 7, 32
THREADS = "WARP_BOUNDING_THREADS"
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
    ("distance-grid", {"nodes": 12, "storage": "uint8", "refine": 4}),
    ("distance-grid", {"nodes": 24, "storage": "uint8", "refine": 2}),
    ("mlp", {"hidden": (24, 24), "budget": 120}),
    ("mlp", {"hidden": (32, 32), "budget": 120}),
)


def asking(bounder: wb.DistanceBounder) -> wp.Kernel:
    """A kernel of a user's own, that asks one point a thread."""
    distance = bounder.distance_func

    @wp.kernel(module="unique", enable_backward=False)
    def ask(first: int, data: wb.Data, x: wp.array(dtype=wp.vec3), g: wp.array(dtype=float)):
        i = first + wp.tid()
        g[i] = distance(data, x[i])

    return ask


@wp.kernel(enable_backward=False)
def closest(first: int, mesh: wp.uint64, x: wp.array(dtype=wp.vec3), d: wp.array(dtype=float)):
    i = first + wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, x[i], 1.0e6)
    d[i] = wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))


@wp.kernel(enable_backward=False)
def closest_signed(first: int, mesh: wp.uint64, x: wp.array(dtype=wp.vec3), d: wp.array(dtype=float)):
    i = first + wp.tid()
    query = wp.mesh_query_point_sign_parity(mesh, x[i], 1.0e6)
    d[i] = wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v)) * query.sign


EXACT = {"wp.mesh_query_point_no_sign": closest, "wp.mesh_query_point_sign_parity": closest_signed}


def on_one_core(kernel: wp.Kernel, inputs: list, out: wp.array) -> float:
    """Median ns an item."""
    before, taken = os.environ.get(THREADS), []
    os.environ[THREADS] = "1"
    for _ in range(ROUNDS):
        begun = time.perf_counter()
        wb.launch_on_cores(kernel, len(out), inputs, [out], "cpu")
        taken.append(time.perf_counter() - begun)
    del os.environ[THREADS]
    if before is not None:
        os.environ[THREADS] = before
    return float(np.median(taken)) / len(out) * 1e9


def evaluations(bounder: wb.DistanceBounder, a: np.ndarray, b: np.ndarray) -> float:
    """Of a segment, mean: a march ends where it is clear, or where a step gains nothing."""
    going, last, total = np.ones(len(a), bool), np.zeros(len(a), np.float32), 0
    for steps in range(1, STEPS + 1):
        total += int(going.sum())
        maybe, t = (part.numpy() for part in bounder.segments(a, b, steps=steps))
        going &= (maybe == 1) & (t > last)
        last = t
    return total / len(a)


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
        + " | segments | evaluations | ns a point | ns a segment | one by one | ns a point in a kernel, one core |"
    )
    print("|---" * (len(RADII) + 8) + "|")
    points, found = wp.array(x, dtype=wp.vec3, device="cpu"), wp.empty(POINTS, dtype=float, device="cpu")
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
            wb.launch_on_cores(kernel, SEGMENTS, [bounder.data, *flat, zero, 0, zero, 0, STEPS], out, "cpu")

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
        numbers += [f"{evaluations(bounder, a, b):.1f}"]
        numbers += [f"{point / POINTS * 1e9:.0f}", f"{lanes / SEGMENTS * 1e9:.0f}", f"{one / SEGMENTS * 1e9:.0f}"]
        numbers += [f"{on_one_core(asking(bounder), [bounder.data, points], found):.0f}"]
        print(f"| {method} {told} | {bounder.nbytes:,} | {' | '.join(numbers)} |", flush=True)
    held = 12 * (len(shape.vertices) + len(shape.faces))
    corners, faces = (
        wp.array(shape.vertices, dtype=wp.vec3, device="cpu"),
        wp.array(shape.faces.ravel(), dtype=int, device="cpu"),
    )
    mesh = wp.Mesh(points=corners, indices=faces)
    for name, kernel in EXACT.items():
        nothing = "| " * (len(RADII) + 6)
        print(
            f"| {name}, exact | {held:,} and its tree {nothing}| {on_one_core(kernel, [mesh.id, points], found):.0f} |"
        )


if __name__ == "__main__":
    main()
