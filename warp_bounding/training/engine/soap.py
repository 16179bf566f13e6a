"""SOAP: Adam in the slowly rotating eigenbasis of Shampoo's factors, with bounded updates.

The method is that of Vyas et al. 2024, arXiv 2409.11321. At these sizes (50 x 51) the factors cost little, and the
steps are worth several of Adam's.

A factor of little rank has eigenvectors that carry no gradient: which ones they are is decided by rounding, and
differs from one linear algebra library to the next. The published method keeps each coordinate's second moment while
the basis below it turns; where such an eigenvector turns into the gradient, a moment that has decayed to nothing
divides one that has not, and the step has no bound. Three things keep every step sound, whatever ``eigh`` and ``qr``
return, as long as it is orthogonal:

* second moments are rotated with the basis, as the variances of uncorrelated coordinates;
* they count as no less than the float32 rounding of the largest one (``NOISE``), so that noise is not scaled up to a
  step;
* no rotated coordinate moves by more than ``Soap.bound`` times the rate, which is what Adam's own moments of one
  sequence of numbers can reach at most. In a basis that stands still the bound is never met.
"""

import math

import torch

__all__ = ["Soap"]

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
    """Optimiser over a list of matrices, which it changes in place.

    Args:
        weights: ``(out, in)`` float32 matrices; of a single row only the columns are rotated.
        beta1: Decay of the first moment.
        beta2: Decay of the second moment, more than ``beta1**2``.

    Attributes:
        bound: A coordinate in the eigenbasis moves by at most this times the learning rate, a step.
        count: Steps so far.

    Raises:
        ValueError: For decays under which Adam's steps have no bound.
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
    """One step of orthogonal iteration.

    Returns:
        The new basis, and the share ``(new, old)`` of each old coordinate's variance that each new one takes.
    """
    image = factor @ basis
    order = (image * basis).sum(0).argsort(descending=True)
    refined = torch.linalg.qr(image[:, order])[0].contiguous()
    return refined, (refined.T @ basis).square_()
