"""Speed of batch queries against torch, in one process, as ratios: `python benchmarks/inference.py [--json]`.

Each round times every contestant once, in turn; ratios are taken within a round, so that a machine whose speed drifts does
not matter, and their median is printed. All points lie in the domain: none is answered without asking the network.
Contestants: torch eager on one (N, 3) tensor; torch eager in chunks, the best of several sizes; ours, its function in somebody's kernel.
Same cores, same data, results compared first.
"""

import argparse

import numpy as np
import torch
import warp as wp
from shared.racing import clock, options, race, show, tell

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.queries.domain import Domain
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine import TrainableNetwork

CHUNKS = (2048, 4096, 8192, 16384, 32768, 65536)
BEST_OF_CHUNKS = 5  # timings a chunk size gets to show that it is the best
HIDDEN = (50, 50)


class Sine(torch.nn.Module):
    """The paper's activation."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Elementwise sine."""
        return torch.sin(x)


def ball(cells: int = 32) -> IndicatorGrid:
    """A voxelised ball in the unit cube."""
    axis = np.linspace(-1, 1, cells)
    return IndicatorGrid(sum(np.meshgrid(axis**2, axis**2, axis**2)) < 0.6, name="ball")


def network(domain: Domain, activation: str, hidden: tuple[int, ...] = HIDDEN):
    """A bounder with random weights of the usual size, and the same network as a torch module in object coordinates."""
    trained = TrainableNetwork(3, hidden, activation)
    trained.initialise(20.0 if activation == "sin" else 3.0, 3.0, torch.Generator().manual_seed(0))
    sizes = {"hidden": list(hidden), "activation": activation, "octaves": 0}
    bounder = METHODS["mlp"](domain, trained.tensors(), sizes, "cpu").freeze(0.0, None)
    modules = []
    for index, layer in enumerate(trained.layers):
        linear = torch.nn.Linear(layer.shape[1] - 1, layer.shape[0])
        with torch.no_grad():
            weight, bias = layer[:, :-1].clone(), layer[:, -1].clone()
            if index == 0:  # v = (x - center) * scale goes into the first layer: torch pays nothing for the map
                weight, bias = (
                    weight * torch.from_numpy(domain.scale),
                    bias - weight @ torch.from_numpy(domain.scale * domain.center),
                )
            linear.weight.copy_(weight)
            linear.bias.copy_(bias)
        modules += [linear, Sine() if activation == "sin" else torch.nn.ReLU()]
    return bounder, torch.nn.Sequential(*modules[:-1])


def in_kernel(bounder, points: wp.array, out: wp.array):
    """A launch of somebody's own kernel that calls the bounder's function; Warp runs it on one core."""

    @wp.kernel(enable_backward=False, module="unique")
    def ask(data: wb.Data, q: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        out[i] = wp.uint8(0)
        if wp.static(bounder.func)(data, q[i]):
            out[i] = wp.uint8(1)

    return lambda: wp.launch(ask, dim=len(points), inputs=[bounder.data, points], outputs=[out], device=out.device)


def ours(bounder, points: wp.array, out: wp.array) -> dict:
    """Calls of a bounder, in a batch and in a kernel."""
    return {
        "ours": lambda: bounder.query(points, out=out),
        "ours, func in a kernel, one core": in_kernel(bounder, points, out),
    }


def chunked(function, x: torch.Tensor, size: int):
    """``function`` over chunks of rows."""
    return lambda: [function(part) for part in x.split(size)]


def best_of_chunks(function, x: torch.Tensor) -> dict:
    """A contestant: ``function`` over chunks of the size that is the fastest."""

    def fastest(size: int) -> float:
        return min(clock(chunked(function, x, size))[0] for _ in range(BEST_OF_CHUNKS))

    size = min(CHUNKS, key=fastest)
    return {f"torch, chunks of {size}": chunked(function, x, size)}


def main() -> None:
    """Run and print."""
    arguments = options(__doc__, points=1_000_000, rounds=9).parse_args()
    wp.config.quiet = True
    torch.set_num_threads(cpu_threads())
    torch.set_grad_enabled(False)

    domain = Domain.of(ball())
    points = np.random.default_rng(0).random((arguments.points, 3), dtype=np.float32)
    x, array = torch.from_numpy(points), wp.array(points, dtype=wp.vec3, device="cpu")
    out = wp.empty(arguments.points, dtype=wp.uint8, device="cpu")
    rows = []
    for activation in ("sin", "relu"):
        bounder, module = network(domain, activation)
        error = np.abs(bounder.values(array).numpy() - module(x)[:, 0].numpy()).max()
        assert error < 1e-2, f"the two networks differ by {error}"
        contestants = {"torch": lambda m=module: m(x)} | best_of_chunks(module, x) | ours(bounder, array, out)
        rows.append((f"mlp 3-50-50-1 {activation}", race(contestants, arguments.rounds)))
    box = METHODS["aabb"].fit(ball(), domain, device="cpu")
    low, high = torch.tensor([0.11] * 3), torch.tensor([0.89] * 3)

    def expression(p: torch.Tensor) -> torch.Tensor:
        return ((p >= low) & (p <= high)).all(dim=1)

    contestants = {"torch": lambda: expression(x)} | best_of_chunks(expression, x) | ours(box, array, out)
    rows.append(("aabb", race(contestants, arguments.rounds)))
    report(rows, arguments)


def report(rows: list[tuple[str, dict[str, np.ndarray]]], arguments: argparse.Namespace) -> None:
    """Nanoseconds a point, and how many times faster ours is within a round."""
    results = []
    for name, times in rows:
        for contestant, values in times.items():
            ratios = values[:, 0] / times["ours"][:, 0]
            results.append(
                {
                    "test": name,
                    "contestant": contestant,
                    "ns_per_point": round(float(np.median(values[:, 0])) / arguments.points * 1e9, 2),
                    "times_ours": round(float(np.median(ratios)), 2),
                    "times_ours_range": [round(float(ratios.min()), 2), round(float(ratios.max()), 2)],
                }
            )
    if arguments.json:
        tell({"points": arguments.points, "threads": cpu_threads(), "torch": torch.__version__}, results)
        return
    show(
        f"{arguments.points:,} points, {cpu_threads()} threads, median of {arguments.rounds} rounds",
        ("test", "contestant", "ns / point", "time / ours", "range"),
        (
            (
                row["test"],
                row["contestant"],
                f"{row['ns_per_point']:.1f}",
                f"{row['times_ours']:.2f}",
                "{:.2f} - {:.2f}".format(*row["times_ours_range"]),
            )
            for row in results
        ),
        left=2,
    )


if __name__ == "__main__":
    main()
