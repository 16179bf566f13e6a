"""A step of one of torch's own optimisers, at a rate of its own."""

import torch

__all__ = ["descend"]


def descend(optimiser: torch.optim.Optimizer, loss: torch.Tensor, rate: float) -> None:
    """One step down ``loss`` at a learning rate."""
    optimiser.zero_grad()
    loss.backward()
    for group in optimiser.param_groups:
        group["lr"] = rate
    optimiser.step()
