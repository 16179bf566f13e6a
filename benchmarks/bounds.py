"""Speed of certified bounds against eager torch, in one process, as ratios: `python benchmarks/bounds.py [--json]`.

Each round times every contestant once, in turn; ratios are taken within a round, and their median is printed.
Contestants: bounds by lines (CROWN) in eager torch, vectorised over boxes, in chunks of the best of several sizes that
torch's own threads share or that are dealt to as many Python threads, whichever is faster; in float64 and in float32
(half the memory, but the roundings of float32 are not paid for, so those bounds certify nothing); `Network.bound`. All
of them deliver the bound, the axis to halve and the value at the corner that looks lowest. The bounds are compared
first: ReLU's are the same, those of the sine parabolas here; printed is our median gap to the value found over torch's,
and the share of boxes where we are looser. Ratios are of wall time, and of core time, which other processes on the
machine disturb less.

Multiply-adds are those of the products with weights, in units of a plain float64 product of two matrices on the same
threads, timed in the same rounds ("peak"); sines, relaxations and the search's bookkeeping come on top.
"""

import argparse
import statistics
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise, product

import numpy as np
import torch
import warp as wp
from shared import clock, options, race, show, tell

from warp_bounding.activations import SINE
from warp_bounding.networks.network import Network
from warp_bounding.runtime.launch import cpu_threads
from warp_bounding.training.engine import TrainableNetwork

SIZES = ((3, (50, 50)), (4, (75, 75)), (6, (50, 50)))
CHUNKS = (512, 2048, 4096)
BEST_OF_CHUNKS = 2  # timings a chunk size gets to show that it is the best
TRIAL = 16_384  # boxes that it gets for that
PEAK = 1024  # rows of the two matrices whose product is the peak
SINE_SLACK = 4e-13  # what sine and cosine in float64 may be off by
LOOSER = 1e-7  # relative difference of bounds up to which they count as the same


class TorchBounds:
    """Bounds in eager torch: one line per neuron on both sides, backward substitution, one pass over a chunk of boxes.

    Args:
        network: Whose bounds; two hidden layers or more, no encoding.
        dtype: Of all arithmetic.
    """

    def __init__(self, network: Network, dtype: torch.dtype):
        self.weights = [torch.from_numpy(x.weight).to(dtype) for x in [*network.hidden, network.output]]
        self.biases = [torch.from_numpy(x.bias).to(dtype) for x in [*network.hidden, network.output]]
        self.padding, self.sine = network.padding, network.hidden[0].activation is SINE

    def relax(self, z: torch.Tensor, width: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Slope, mean and spread of the activation around ``z``: the chord, or Taylor's line."""
        if not self.sine:
            low, high = z - width, z + width
            slope = (high / (2 * width)).clamp_(0, 1)
            spread = slope * torch.clamp(low, max=0).mul_(-0.5)  # nothing where the slope is 0, or low positive
            return slope, torch.addcmul(spread, slope, z), spread
        sine, cosine, square = torch.sin(z), torch.cos(z), width * width
        bend = torch.mul(square, 1 / 120).add_(1 / (9 * 3**0.5)).mul_(square).mul_(width)
        spread = (cosine.abs() * bend).add_(SINE_SLACK).addcmul_(sine.abs(), square, value=0.25)
        slope = torch.addcmul(cosine, cosine, square, value=-1 / 6)
        mean = torch.addcmul(sine, sine, square, value=-0.25)
        wide = spread > 1
        return slope.masked_fill_(wide, 0), mean.masked_fill_(wide, 0), spread.masked_fill_(wide, 1)

    def __call__(self, lower: torch.Tensor, upper: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Bounds ``(N,)``, axes ``(N,)`` and values ``(N,)`` of boxes ``(N, n)``."""
        count, n = lower.shape
        center, radius = (lower + upper) / 2, (upper - lower) / 2
        first = self.weights[0].T.contiguous()
        z, width = torch.addmm(self.biases[0], center, first), radius @ first.abs() + self.padding[0]
        parts, rates, noise = first[:, None], first.abs()[:, None], torch.zeros((), dtype=lower.dtype)
        slope, mean, spread = self.relax(z, width)
        spread += self.padding[0]
        trace = [(rates, width, slope, spread)]
        for weight, bias, padding in zip(self.weights[1:-1], self.biases[1:-1], self.padding[1:-1], strict=True):
            both = torch.cat([mean[None], parts * slope]).view((n + 1) * count, -1) @ weight.T
            z, parts = both[:count] + bias, both[count:].view(n, count, -1)
            noise = (slope.abs() * noise).add_(spread) @ weight.abs().T
            rates = parts.abs()
            width = torch.einsum("knh,nk->nh", rates, radius).add_(noise).add_(padding)
            slope, mean, spread = self.relax(z, width)
            spread += padding
            trace.append((rates, width, slope, spread))
        output = self.weights[-1][0]
        least, score = mean @ output + (self.biases[-1] - self.padding[-1]), torch.zeros_like(radius)
        coefficient = output.expand(count, -1)
        for index in range(len(trace) - 1, -1, -1):
            rates, width, slope, spread = trace[index]
            loss = coefficient.abs() * spread
            least -= loss.sum(dim=1)
            share = loss / width
            score += torch.einsum("nh,knh->nk", share, rates) if index else share @ rates[:, 0].T
            coefficient = (coefficient * slope) @ self.weights[index]
        least -= (coefficient.abs() * radius).sum(dim=1)
        h = torch.where(coefficient > 0, lower, upper)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = torch.addmm(bias, h, weight.T)
            h = h.sin_() if self.sine else h.relu_()
        return least, (score * radius).argmax(dim=1), h @ output + self.biases[-1]

    def chunked(self, lower: np.ndarray, upper: np.ndarray, size: int, dealt: bool) -> Callable:
        """A call that bounds all boxes in chunks of ``size``, by Python threads or by all of torch's."""
        dtype = self.weights[0].dtype
        chunks = list(zip(*(torch.from_numpy(a).to(dtype).split(size) for a in (lower, upper)), strict=True))

        def one(chunk: tuple[torch.Tensor, torch.Tensor]) -> tuple[torch.Tensor, ...]:
            with torch.inference_mode():
                return self(*chunk)

        def run() -> list[torch.Tensor]:
            torch.set_num_threads(1 if dealt else cpu_threads())
            parts = list(threads().map(one, chunks) if dealt else map(one, chunks))
            return [torch.cat(part) for part in zip(*parts, strict=True)]

        return run


@cache
def threads() -> ThreadPoolExecutor:
    """Python threads, each with one thread of torch's."""
    return ThreadPoolExecutor(cpu_threads(), initializer=torch.set_num_threads, initargs=(1,))


def multiply_adds(ndim: int, hidden: tuple[int, ...]) -> int:
    """Of a box: first layer and back, its value; then means, noise and ``ndim`` generators, one row back, the value."""
    later = sum(a * b for a, b in pairwise(hidden))
    return 3 * ndim * hidden[0] + (ndim + 4) * later + 2 * hidden[-1]


def problem(ndim: int, hidden: tuple[int, ...], activation: str, boxes: int) -> tuple[Network, np.ndarray, np.ndarray]:
    """Random weights of the usual size, and boxes such as a search meets: half-widths from 0.003 to 0.1."""
    trained = TrainableNetwork(ndim, hidden, activation)
    trained.initialise(6.0 if activation == "sin" else 3.0, 3.0, torch.Generator().manual_seed(0))
    tensors = trained.tensors()
    layers = [(tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"]) for i in range(len(hidden) + 1)]
    rng = np.random.default_rng(0)
    center = rng.uniform(-0.9, 0.9, (boxes, ndim))
    radius = 10.0 ** rng.uniform(-2.5, -1, (boxes, 1)) * rng.uniform(0.3, 1.0, (boxes, ndim))
    return Network(layers, activation, np.ones(ndim)), center - radius, center + radius


def contest(network: Network, lower: np.ndarray, upper: np.ndarray) -> tuple[dict[str, Callable], float, float]:
    """The contestants, our median gap over torch's, and the share of boxes where our bound is looser.

    Raises:
        RuntimeError: If a bound of ours is above a value of f, or looser than torch's for ReLU.
    """
    contestants = {}
    for name, dtype in (("float64", torch.float64), ("float32", torch.float32)):
        reference = TorchBounds(network, dtype)
        trials = {}
        for size, dealt in product(CHUNKS, (False, True)):
            call = reference.chunked(lower[:TRIAL], upper[:TRIAL], size, dealt)
            trials[size, dealt] = min(clock(call)[0] for _ in range(BEST_OF_CHUNKS))
        size, dealt = min(trials, key=trials.get)
        call = reference.chunked(lower, upper, size, dealt)
        contestants[f"torch {name}, {'dealt ' if dealt else ''}{size}"] = call
        if dtype == torch.float64:
            least, _, value = (x.numpy() for x in call())
    contestants["ours"] = lambda: network.bound(lower, upper)
    our_least, _, _, our_value, *_ = contestants["ours"]()
    looser = (least - our_least) / (1 + np.abs(least)) > LOOSER
    found = np.minimum(value, our_value)
    gap = float(np.median((found - our_least) / (found - least)))
    if (our_least > found).any() or (looser.any() and network.hidden[0].activation.name == "relu"):
        raise RuntimeError("the bounds are not right")
    return contestants, gap, float(looser.mean())


def results(ndim: int, hidden: tuple[int, ...], activation: str, arguments: argparse.Namespace) -> list[dict]:
    """One row a contestant."""
    network, lower, upper = problem(ndim, hidden, activation, arguments.boxes)
    contestants, gap, looser = contest(network, lower, upper)
    square = torch.rand(PEAK, PEAK, dtype=torch.float64)

    def peak() -> torch.Tensor:
        torch.set_num_threads(cpu_threads())
        return square @ square

    times = race(contestants | {"peak": peak}, arguments.rounds)
    most, rows, work = PEAK**3 / times.pop("peak")[:, 0].min(), [], multiply_adds(ndim, hidden)
    for name, values in times.items():
        ratios = values / times["ours"]
        rate = arguments.boxes / statistics.median(values[:, 0])
        rows.append(
            {
                "network": "-".join(map(str, (ndim, *hidden, 1))) + f" {activation}",
                "contestant": name,
                "boxes_per_second": round(rate),
                "times_ours": round(statistics.median(ratios[:, 0]), 2),
                "times_ours_range": [round(ratios[:, 0].min(), 2), round(ratios[:, 0].max(), 2)],
                "core_times_ours": round(statistics.median(ratios[:, 1]), 2),
                "core_ns_per_box": round(statistics.median(values[:, 1]) / arguments.boxes * 1e9),
                "multiply_adds_per_box": work,
                "share_of_peak": round(work * rate / most, 3),
                "peak_multiply_adds_per_second": round(most),
                "our_gap": round(gap, 3),
                "ours_looser": round(looser, 4),
            }
        )
    return rows


def main() -> None:
    """Run and print."""
    arguments = options(__doc__, boxes=100_000, rounds=5).parse_args()
    wp.config.quiet = True
    torch.set_grad_enabled(False)
    rows = []
    for ndim, hidden in SIZES:
        for activation in ("sin", "relu"):
            rows += results(ndim, hidden, activation, arguments)
    if arguments.json:
        tell({"boxes": arguments.boxes, "threads": cpu_threads(), "torch": torch.__version__}, rows)
        return
    heads = ("network", "contestant", "boxes / s", "time / ours", "range", "core time / ours", "core ns / box")
    cells = []
    for row in rows:
        low, high = row["times_ours_range"]
        cells.append(
            (
                *(row["network"], row["contestant"], f"{row['boxes_per_second']:,}", f"{row['times_ours']:.2f}"),
                *(f"{low:.1f} - {high:.1f}", f"{row['core_times_ours']:.2f}", f"{row['core_ns_per_box']:,}"),
                *(f"{row['multiply_adds_per_box']:,}", f"{row['share_of_peak']:.1%}"),
                *((f"{row['our_gap']:.2f}", f"{row['ours_looser']:.1%}") if row["contestant"] == "ours" else ("", "")),
            )
        )
    title = f"{arguments.boxes:,} boxes, {cpu_threads()} threads, median of {arguments.rounds} rounds"
    show(title, (*heads, "mul-adds", "of peak", "gap", "looser"), cells, left=2, width=140)


if __name__ == "__main__":
    main()
