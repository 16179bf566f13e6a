"""Trains networks in short steps on a CPU: torch, threads, clock, optimiser, and hand-written gradients."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from itertools import pairwise, product
from threading import local
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_bounding.activations import activation_of
from warp_bounding.errors import BounderError
from warp_bounding.runtime.launch import compiled_for, cpu_threads, run_shares, working_seconds
from warp_bounding.runtime.progress import Progress

# torch, imported at its first use: bounders that are not learned are fitted without it. No budget counts its import.


class _Torch:
    """Stands for the module; raises ``BounderError`` at its first use if torch is not installed."""

    def __getattr__(self, name: str) -> Any:
        started = perf_counter()
        try:
            found = getattr(import_module("torch"), name)
        except ImportError as error:
            raise BounderError("fitting what is learned needs torch: pip install 'warp-bounding[train]'") from error
        compiled_for(perf_counter() - started)
        setattr(self, name, found)  # found at once from now on
        return found


if TYPE_CHECKING:
    import torch
else:
    torch = _Torch()


def adam(tensors: list, **options):
    """``torch.optim.Adam``. A process's first optimiser imports torch's compiler; no budget counts that either."""
    started = perf_counter()
    optimiser = torch.optim.Adam(tensors, **options)
    compiled_for(perf_counter() - started)
    return optimiser


# Shares of a job on the library's own threads, each of which runs torch on one core.
#
# Torch's own thread pool spins at its barriers, which costs a multiple of these short steps wherever another process
# uses a core; threads that sleep in the operating system do not.

_own = local()  # of each thread
PART = 1024  # things that a thread does at a time, such as samples that it evaluates


class Team:
    """Runs ``job(k)`` for k in 0 .. size - 1, on as many threads as launches use."""

    def __init__(self):
        self.size = cpu_threads()

    def run(self, job: Callable[[int], None]) -> None:
        """Run a job on every thread, without autograd, and wait for all; an error in one is raised here."""

        def share(index: int) -> None:
            if not hasattr(_own, "single"):  # torch keeps this number for each thread
                _own.single = torch.set_num_threads(1)
            with torch.no_grad():
                job(index)

        run_shares([partial(share, index) for index in range(self.size)])

    def share(self, index: int, count: int) -> slice:
        """Thread ``index``'s part of ``count`` things."""
        return slice(*(count * k // self.size for k in (index, index + 1)))

    def over(self, count: int, job: Callable[[int, slice], None]) -> None:
        """Run ``job(k, part)`` over ``count`` things: thread k goes through its share in parts of at most ``PART``."""

        def go(index: int) -> None:
            own = self.share(index, count)
            for start in range(own.start, own.stop, PART):
                job(index, slice(start, min(start + PART, own.stop)))

        self.run(go)


@contextlib.contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Torch on one thread and without autograd, as it was before afterwards."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.no_grad():
            yield
    finally:
        torch.set_num_threads(threads)


# A training budget, in seconds or in steps, as a fraction that schedules are written in, and the schedules.
#
# Whoever trains tells the clock how it goes, and the clock tells the user.

FASTER = 2.0  # largest factor by which the used fraction may go on faster when more time is reserved


class Clock:
    """How much of a budget is used up: of seconds from now on, compiling kernels not counted, or of ``steps``.

    With steps time plays no role, and runs are repeatable. ``share`` is the part of the user's progress at which
    training ends, and proofs begin; ``past`` that at which it begins, behind trials.
    """

    def __init__(
        self,
        seconds: float,
        steps: int | None = None,
        progress: Progress | None = None,
        share: float = 1.0,
        past: float = 0.0,
    ):
        self.progress, self.share, self.past = progress, share, past
        self.started, self.total, self.limit, self.count = working_seconds(), seconds, steps, 0
        self.reserved = 0.0  # seconds at the end that belong to the proof
        self._from = (0.0, 0.0)  # seconds since the start and used fraction, from which the fraction grows evenly

    def tell(self, used: float, note: str) -> None:
        """Say how training goes at a used fraction."""
        if self.progress:
            self.progress(self.past + min(used, 1.0) * (self.share - self.past), 1.0, note)

    def go_on(self, note: str) -> None:
        """Say how work behind the training goes, by the time that is used."""
        if self.progress:
            used = self.seconds / self.total if self.timed else 0.0
            self.progress(min(max(used, self.share), 1.0), 1.0, note)

    def trial(self, share: float) -> Clock:
        """The clock of a short training before this one, which takes a share of the budget, or as many steps more."""
        steps = None if self.limit is None else max(int(share * self.limit), 1)
        past, self.past = self.past, self.past + share
        return Clock(share * self.total, steps, self.progress, self.past, past)

    def reserve(self, seconds: float) -> None:
        """Keep other seconds at the end for the proof; the used fraction goes on evenly, so schedules do not jump."""
        now, used = self.seconds, self.fraction()
        left = max(self.total - self.reserved - now, 0.0)
        self._from = (now, used)
        self.reserved = min(seconds, self.total - now - left / FASTER)

    @property
    def seconds(self) -> float:
        """Since the start, without those for compiling kernels."""
        return working_seconds() - self.started

    @property
    def timed(self) -> bool:
        """Whether the budget is in seconds."""
        return self.limit is None

    def fraction(self) -> float:
        """Share of the training budget that is used; 1 at its end."""
        if self.limit is not None:
            return self.count / self.limit
        (begin, used), now, end = self._from, self.seconds, self.total - self.reserved
        return used + (1 - used) * (now - begin) / (end - begin) if now < end else 1.0

    def steps(self) -> Iterator[tuple[int, float]]:
        """Steps from 0 on, each with the used fraction at its begin, until the budget is used up; they are counted.

        The used fraction is 0 where this begins.
        """
        step, self._from = 0, (self.seconds, 0.0)
        while (used := self.fraction()) < 1:
            yield step, used
            step += 1
            self.count += 1


def geometric(begin: float, end: float, used: float) -> float:
    """Geometric from ``begin`` to ``end`` while ``used`` goes from 0 to 1."""
    return begin * (end / begin) ** used


def cosine(rate: float, end: float, warm_up: float, used: float) -> float:
    """A learning rate that rises linearly to ``rate`` at the used fraction ``warm_up``, and falls by half a cosine.

    At the end it is the share ``end`` of the highest.
    """
    warm = min(1.0, (used + 1e-3) / warm_up)
    return rate * warm * (end + (1 - end) * 0.5 * (1 + math.cos(math.pi * min(used, 1.0))))


def interrupts(job: Callable[[], None]) -> bool:
    """Do a job; returns whether Ctrl-C ended it, in which case the caller takes what has been learned so far."""
    try:
        job()
    except KeyboardInterrupt:
        return True
    return False


# SOAP: Adam in the slowly rotating eigenbasis of Shampoo's factors, with bounded updates.
#
# The method is that of Vyas et al. 2024, arXiv 2409.11321. At these sizes (50 x 51) the factors cost little, and the
# steps are worth several of Adam's.
#
# A factor of little rank has eigenvectors that carry no gradient: which ones they are is decided by rounding, and
# differs from one linear algebra library to the next. The published method keeps each coordinate's second moment while
# the basis below it turns; where such an eigenvector turns into the gradient, a moment that has decayed to nothing
# divides one that has not, and the step has no bound. Three things keep every step sound, whatever ``eigh`` and ``qr``
# return, as long as it is orthogonal:
#
# * second moments are rotated with the basis, as the variances of uncorrelated coordinates;
# * they count as no less than the float32 rounding of the largest one (``NOISE``), so that noise is not scaled up to a
#   step;
# * no rotated coordinate moves by more than ``Soap.bound`` times the rate, which is what Adam's own moments of one
#   sequence of numbers can reach at most. In a basis that stands still the bound is never met.

FACTOR_DECAY = 0.95  # decay of Shampoo's factors, a step
EIGEN_EVERY = 10  # steps between two refinements of the eigenvectors
# Least root of a second moment, relative to the largest of a matrix in its eigenbasis: twenty times what two products
# of 50 x 50 matrices round; 1e-4 occurs in fits.
NOISE = 1e-5
SMALLEST = 1e-30  # added to that least root, so that a gradient of exactly zero moves nothing


class _State:
    """Moments and factors of one ``(out, in)`` matrix."""

    def __init__(self, weight: torch.Tensor):
        rows, columns = weight.shape
        self.left, self.right = torch.zeros(rows, rows), torch.zeros(columns, columns)
        self.left_basis, self.right_basis = torch.eye(rows), torch.eye(columns)
        self.mean, self.square = torch.zeros(rows, columns), torch.zeros(rows, columns)


class Soap:
    """Optimiser over ``(out, in)`` float32 matrices, changed in place; of a single row only the columns are rotated.

    ``beta1`` and ``beta2`` are the moments' decays, ``beta2 > beta1**2``, else Adam's steps have no bound
    (``ValueError``). A coordinate in the eigenbasis moves by ``bound`` times the learning rate a step at most;
    ``count`` are the steps so far.
    """

    def __init__(self, weights: list[torch.Tensor], beta1: float, beta2: float):
        if not 0 <= beta1 * beta1 < beta2 < 1:
            raise ValueError(f"beta2 must be under 1 and above the square of beta1, got {beta2} and beta1 {beta1}")
        self.weights, self.beta1, self.beta2, self.count = weights, beta1, beta2, 0
        # By Cauchy and Schwarz, of a mean and a second moment of the same numbers; 1 where both decay alike.
        self.bound = (1 - beta1) / math.sqrt((1 - beta2) * (1 - beta1 * beta1 / beta2))
        self._states = [_State(weight) for weight in weights]

    def step(self, gradients: list[torch.Tensor], rate: float) -> None:
        """One step with this learning rate."""
        self.count += 1
        bias = math.sqrt(1 - self.beta2**self.count) / (1 - self.beta1**self.count)
        for weight, gradient, state in zip(self.weights, gradients, self._states, strict=True):
            self._update(weight, gradient, state, rate, bias)

    def _update(self, weight: torch.Tensor, gradient: torch.Tensor, state: _State, rate: float, bias: float) -> None:
        two_sided = weight.shape[0] > 1
        if two_sided:
            state.left.mul_(FACTOR_DECAY).addmm_(gradient, gradient.T, alpha=1 - FACTOR_DECAY)
        state.right.mul_(FACTOR_DECAY).addmm_(gradient.T, gradient, alpha=1 - FACTOR_DECAY)
        if self.count == 1:
            state.right_basis = _eigenvectors(state.right)
            if two_sided:
                state.left_basis = _eigenvectors(state.left)
        state.mean.lerp_(gradient, 1 - self.beta1)
        rotated, mean = gradient @ state.right_basis, state.mean @ state.right_basis
        if two_sided:
            rotated, mean = state.left_basis.T @ rotated, state.left_basis.T @ mean
        state.square.mul_(self.beta2).addcmul_(rotated, rotated, value=1 - self.beta2)
        root = state.square.sqrt()
        root.clamp_min_(root.max() * NOISE + SMALLEST)
        change = mean.mul_(bias).div_(root).clamp_(-self.bound, self.bound) @ state.right_basis.T
        weight.add_(state.left_basis @ change if two_sided else change, alpha=-rate)
        if self.count % EIGEN_EVERY == 0:
            if two_sided:
                state.left_basis, turn = _refine(state.left, state.left_basis)
                state.square = turn @ state.square
            state.right_basis, turn = _refine(state.right, state.right_basis)
            state.square = state.square @ turn.T


def _eigenvectors(factor: torch.Tensor) -> torch.Tensor:
    return torch.linalg.eigh(factor.double())[1].flip(1).float().contiguous()


def _refine(factor: torch.Tensor, basis: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """One step of orthogonal iteration: the new basis, and each old coordinate's share of each new one's variance."""
    image = factor @ basis
    order = (image * basis).sum(0).argsort(descending=True)
    refined = torch.linalg.qr(image[:, order])[0].contiguous()
    return refined, (refined.T @ basis).square_()


# A small network in torch with a hand-written backward pass, for many short steps on a CPU.
#
# Autograd's bookkeeping and fresh allocations cost more than the arithmetic at these sizes, so forward, backward and
# the gradient in the input run in preallocated buffers. Columns are samples: data is ``(n + 1, N)``, its last
# row ones, so that a layer's weight and bias are one ``(out, in + 1)`` matrix.


class TrainableNetwork:
    """Parameters of a network of ``ndim`` coordinates ``v``, flat and as one matrix a layer."""

    def __init__(self, ndim: int, hidden: tuple[int, ...], activation: str):
        self.ndim, self.hidden, self.activation = ndim, hidden, activation
        self.act = activation_of(activation)
        self.widths = [ndim, *hidden, 1]
        self.flat = torch.zeros(sum(o * (i + 1) for i, o in pairwise(self.widths)))
        self.layers = self.split(self.flat)

    def split(self, flat: torch.Tensor) -> list[torch.Tensor]:
        """Views of a flat vector, one ``(out, in + 1)`` matrix a layer."""
        views, start = [], 0
        for i, o in pairwise(self.widths):
            views.append(flat[start : start + o * (i + 1)].view(o, i + 1))
            start += o * (i + 1)
        return views

    def initialise(self, first: float, later: float, generator: torch.Generator) -> None:
        """Uniform weights in ``+-gain / sqrt(inputs)``; the gains are ``first``, then ``later``, of the output 1."""
        for layer, gain in zip(self.layers, [first, *[later] * (len(self.hidden) - 1), 1.0], strict=True):
            rows, inputs = layer.shape[0], layer.shape[1] - 1
            layer.copy_((torch.rand(rows, inputs + 1, generator=generator) * 2 - 1) / math.sqrt(inputs))
            layer[:, :-1] *= gain

    def encode(self, v: torch.Tensor) -> torch.Tensor:
        """Columns ``(n, N)`` as the network's input ``(n + 1, N)``, with a row of ones."""
        out = torch.ones(self.ndim + 1, v.shape[1])
        out[: self.ndim] = v
        return out

    def tensors(self) -> dict[str, np.ndarray]:
        """The parameters as a bounder stores them."""
        parts = {"weight": slice(None, -1), "bias": -1}
        named = product(enumerate(self.layers), parts.items())
        return {f"layers.{i}.{name}": layer[:, part].numpy().copy() for (i, layer), (name, part) in named}


class Evaluator:
    """Forward and backward passes of one thread, in buffers of its own; the network's parameters are only read."""

    def __init__(self, network: TrainableNetwork):
        self.network = network
        self.gradient = torch.zeros_like(network.flat)
        self.gradients = network.split(self.gradient)
        self._buffers: dict[int, tuple[list[torch.Tensor], ...]] = {}

    def _buffer(self, count: int) -> tuple[list[torch.Tensor], ...]:
        if count not in self._buffers:
            hidden = self.network.hidden
            outputs = [torch.ones(h + 1, count) for h in hidden]
            scratch = [[torch.empty(h, count) for h in hidden] for _ in range(3)]
            self._buffers[count] = (outputs, *scratch, [torch.empty(1, count)])
        return self._buffers[count]

    def forward(self, x: torch.Tensor, *, keep: bool = False) -> torch.Tensor:
        """Outputs ``(N,)`` for columns ``x``, valid until the next call; ``keep`` what ``backward`` needs."""
        outputs, values, slopes, _, last = self._buffer(x.shape[1])
        act = self.network.act
        for index, layer in enumerate(self.network.layers[:-1]):
            torch.mm(layer, x, out=values[index])
            act.torch_value(values[index], out=outputs[index][:-1])
            if keep:
                act.torch_slope(values[index], outputs[index][:-1], slopes[index])
            x = outputs[index]
        return torch.mm(self.network.layers[-1], x, out=last[0])[0]

    def backward(self, x: torch.Tensor, weight: torch.Tensor) -> None:
        """Add ``sum_i weight_i d f(x_i) / d parameters`` to ``gradient``; ``forward(x, keep=True)`` comes first."""
        outputs, _, slopes, scratch, _ = self._buffer(x.shape[1])
        signal = weight.view(1, -1)
        for index in range(len(self.network.layers) - 1, -1, -1):
            below = outputs[index - 1] if index else x
            self.gradients[index].addmm_(signal, below.T.contiguous())  # the product with a transposed view is slower
            if index:
                torch.mm(self.network.layers[index][:, :-1].T, signal, out=scratch[index - 1])
                signal = scratch[index - 1].mul_(slopes[index - 1])

    def input_gradient(self, x: torch.Tensor) -> torch.Tensor:
        """``d f / d v`` ``(n, N)``."""
        self.forward(x, keep=True)
        slopes = self._buffer(x.shape[1])[2]
        signal = torch.ones(1, x.shape[1])
        for index in range(len(self.network.layers) - 1, 0, -1):
            signal = (self.network.layers[index][:, :-1].T @ signal).mul_(slopes[index - 1])
        return self.network.layers[0][:, :-1].T @ signal


def evaluated(
    team: Team,
    workers: list[Evaluator],
    columns: torch.Tensor,
    encode: Callable[[torch.Tensor], torch.Tensor] = lambda part: part,
) -> torch.Tensor:
    """``(N,)`` values of a network at columns ``(S, N)``, which ``encode`` makes inputs of, by all threads."""
    values = torch.empty(columns.shape[1])

    def job(index: int, part: slice) -> None:
        values[part] = workers[index].forward(encode(columns[:, part]))

    team.over(columns.shape[1], job)
    return values


def summed(workers: list[Evaluator]) -> list[torch.Tensor]:
    """The workers' gradients, one matrix a layer; they are the first one's own."""
    for worker in workers[1:]:
        workers[0].gradient.add_(worker.gradient)
    return workers[0].gradients
