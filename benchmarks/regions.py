"""Nanoseconds a query, by method and kind of query, and exact labels a second; methods are timed in turns, round by round.

    python benchmarks/regions.py --shape bunny.binvox [--seconds 20]

Fits one bounder a method and query (networks for ``--seconds``), then asks each the same random queries. Quoted are the median
time and the median of the ratios to ``mlp`` within a round: a noisy machine moves both alike.
"""

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np
import warp as wp

import warp_bounding as wb
from warp_bounding.queries import oracle, sample
from warp_bounding.runtime.launch import cpu_threads

METHODS = ("aabb", "kdop", "bvh", "learned-kdop", "mlp", "mlp-early")
QUERIES = ("point", "ray", "plane", "box")
COUNT, ROUNDS = 1_000_000, 9


def timed(call, *arguments) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - start


def sizes(method: str, hidden: tuple[int, ...]) -> dict:
    """``hidden``, where the method takes it."""
    return {"hidden": hidden} if any(option.name == "hidden" for option in wb.METHODS[method].options) else {}


def main() -> None:
    """Fit, ask, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shape", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--hidden", default="50,50")
    parser.add_argument("--queries", default=",".join(QUERIES))
    arguments = parser.parse_args()
    wp.config.quiet = True
    grid = wb.load_indicator(arguments.shape).to_grid()
    hidden = tuple(map(int, arguments.hidden.split(",")))
    print(f"{grid.name}, {grid.ndim}D, {COUNT:,} queries, {cpu_threads()} threads, hidden {arguments.hidden}\n")
    print("| query | method | FP % | bytes | ns a query | time over mlp's |\n|---|---|---|---|---|---|")
    labels = {}
    for query in arguments.queries.split(","):
        x = sample(query, grid, COUNT, np.random.default_rng(0))
        truth = oracle(query, grid, "cpu")
        truth(x)
        labels[query] = COUNT / np.median([timed(truth, x) for _ in range(ROUNDS)])
        held = wp.array(x, dtype=wp.float32, device="cpu")
        bounders = {
            m: wb.fit(grid, query=query, method=m, budget=arguments.seconds, device="cpu", **sizes(m, hidden))
            for m in METHODS
        }
        out = wp.empty(COUNT, dtype=wp.uint8, device="cpu")
        for bounder in bounders.values():
            bounder.query(held, out=out)
        times = {m: [] for m in METHODS}
        for _ in range(ROUNDS):
            for method, bounder in bounders.items():
                times[method].append(timed(partial(bounder.query, held, out=out)))
        for method, bounder in bounders.items():
            ratio = np.median(np.array(times[method]) / np.array(times["mlp"]))
            rate = wb.evaluate(bounder, grid, 300_000).fp_rate
            nanoseconds = np.median(times[method]) / COUNT * 1e9
            print(
                f"| {query} | {method} | {rate:.2f} | {bounder.nbytes:,} | {nanoseconds:.1f} | {ratio:.2f} |",
                flush=True,
            )
    print("\n| exact labels | million a second |\n|---|---|")
    for query, rate in labels.items():
        print(f"| {query} | {rate / 1e6:.1f} |")


if __name__ == "__main__":
    main()
