"""What a call costs besides the queries: `python benchmarks/overhead.py [--json]`.

Each round times every way of asking an ``aabb`` once, in turn, the median of a number of calls in a row; ratios to
Warp's own recorded launch of the very same kernel on one thread are taken within a round, and their median is printed.
Answers are compared first.
"""

import statistics

import numpy as np
import warp as wp
from shared import clock, options, race, show, tell

import warp_bounding as wb
from sims.threads import threads_of
from warp_bounding.bounders import METHODS
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.queries.domain import Domain
from warp_bounding.runtime.launch import BLOCK, cpu_threads
from warp_bounding.shapes import Grid

RECORDED = "Warp, recorded launch"
CALLS = {1_000: 50, 100_000: 10}  # in a row, per round
PLACE = wp.transform(wp.vec3(0.1, -0.2, 0.3), wp.quat_from_axis_angle(wp.vec3(0.0, 0.6, 0.8), 0.5))


def box() -> wb.Bounder:
    """An ``aabb`` of a voxelised ball in the unit cube."""
    axis = np.linspace(-1, 1, 32)
    grid = Grid(sum(np.meshgrid(axis**2, axis**2, axis**2)) < 0.6, name="ball")
    return METHODS["aabb"].fit(grid, Domain.of(grid), device="cpu")


def contestants(bounder: wb.Bounder, count: int) -> dict:
    """The ways to ask so many queries, as functions."""
    points = np.random.default_rng(0).random((count, 3), dtype=np.float32)
    x, out = wp.array(points, dtype=wp.vec3, device="cpu"), wp.empty(count, dtype=wp.bool, device="cpu")
    flat, data = wp.array(points.reshape(-1), dtype=wp.float32, device="cpu"), bounder.data
    kernel, blocks = batch_kernel(bounder.source, False, False), -(-count // BLOCK)
    launch = {
        "kernel": kernel,
        "dim": blocks,
        "inputs": [flat, count, 0, data.parameters, data.words, data.parameters],
        "outputs": [out],
        "device": "cpu",
    }
    recorded = wp.launch(**launch, record_cmd=True)
    prepared, placed = bounder.prepare(x, out=out), bounder.prepare(x, xform=PLACE)
    found = bounder.prepare(x, candidates=True)
    recorded.launch()
    expected = out.numpy().copy()
    assert (bounder.query(x).numpy() == expected).all()
    assert (prepared.launch().numpy() == expected).all()
    assert (placed.launch().numpy() == bounder.query(x, xform=PLACE).numpy()).all()
    indices, total = found.launch()
    assert (indices.numpy()[: total.numpy()[0]] == np.flatnonzero(expected)).all()
    return {
        RECORDED: recorded.launch,
        "Warp, plain launch": lambda: wp.launch(**launch),
        "query": lambda: bounder.query(x),
        "query, out=": lambda: bounder.query(x, out=out),
        "query, xform=": lambda: bounder.query(x, xform=PLACE),
        "candidates": lambda: bounder.candidates(x),
        "prepared": prepared.launch,
        "prepared, with a placement": placed.launch,
        "prepared, moved each time": lambda: (placed.move(xform=PLACE), placed.launch()),
        "prepared candidates": found.launch,
    }


def main() -> None:
    """Run and print."""
    arguments = options(__doc__, rounds=41).parse_args()
    wp.config.quiet = True
    bounder, results = box(), []
    for count, calls in CALLS.items():
        for threads in sorted({1, cpu_threads()}):
            with threads_of(threads):
                ways = contestants(bounder, count)
                times = race(
                    ways, arguments.rounds, lambda f, n=calls: statistics.median(clock(f)[0] for _ in range(n))
                )
            for way, values in times.items():
                row = {"queries": count, "threads": threads, "way": way, "us": round(1e6 * np.median(values), 1)}
                results.append(row | {"ratio": round(np.median(values / times[RECORDED]), 2)})
    if arguments.json:
        tell({"cores": cpu_threads()}, results)
        return
    for count, threads in dict.fromkeys((row["queries"], row["threads"]) for row in results):
        about = f"{count:,} queries of an aabb, {threads} thread{'s' * (threads > 1)}"
        own = [row for row in results if (row["queries"], row["threads"]) == (count, threads)]
        cells = [(row["way"], f"{row['us']:.1f}", f"{row['ratio']:.2f}") for row in own]
        show(f"{about}, median of {arguments.rounds} rounds", ("", "us a call", f"time / {RECORDED}"), cells)


if __name__ == "__main__":
    main()
