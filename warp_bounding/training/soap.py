"""SOAP: Adam in the slowly rotating eigenbasis of Shampoo's factors (Vyas et al. 2024, arXiv 2409.11321).

At these sizes (50 x 51) the factors cost little, and the steps are worth several of Adam's.
"""

import math

import torch

__all__ = ["Soap"]

FACTOR_DECAY = 0.95
EIGEN_EVERY = 10  # steps between two refinements of the eigenvectors
EPSILON = 1e-10


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
        weights: The matrices.
        beta1: Decay of the first moment.
        beta2: Decay of the second moment.
    """

    def __init__(self, weights: list[torch.Tensor], beta1: float, beta2: float):
        self.weights, self.beta1, self.beta2, self.count = weights, beta1, beta2, 0
        self._states = [_State(weight) for weight in weights]

    def step(self, gradients: list[torch.Tensor], rate: float) -> None:
        """One step with this learning rate."""
        self.count += 1
        rate *= math.sqrt(1 - self.beta2**self.count) / (1 - self.beta1**self.count)
        for weight, gradient, state in zip(self.weights, gradients, self._states, strict=True):
            self._update(weight, gradient, state, rate)

    def _update(self, weight: torch.Tensor, gradient: torch.Tensor, state: _State, rate: float) -> None:
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
        change = (mean / state.square.sqrt().add_(EPSILON)) @ state.right_basis.T
        weight.add_(state.left_basis @ change if two_sided else change, alpha=-rate)
        if self.count % EIGEN_EVERY == 0:
            if two_sided:
                state.left_basis, state.square = _refine(state.left, state.left_basis, state.square, 0)
            state.right_basis, state.square = _refine(state.right, state.right_basis, state.square, 1)


def _eigenvectors(factor: torch.Tensor) -> torch.Tensor:
    return torch.linalg.eigh(factor.double())[1].flip(1).float().contiguous()


def _refine(
    factor: torch.Tensor, basis: torch.Tensor, square: torch.Tensor, axis: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """One step of orthogonal iteration, the second moment's order following the eigenvalues'."""
    order = ((basis.T @ factor) * basis.T).sum(1).argsort(descending=True)
    return torch.linalg.qr(factor @ basis[:, order])[0].contiguous(), square.index_select(axis, order)
