"""A field of numbers on a grid, interpolated, trained as a classifier: what ``relu-field`` would be with a symmetric loss.

It is no bounder, and only shows what the asymmetric loss and the repair are for.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, grid_sample

from warp_bounding.training.engine import single_threaded_torch

__all__ = ["plain_field"]


def plain_field(grid, nodes: int, seed: int, steps: int, batch: int, rate: float) -> Callable[[np.ndarray], np.ndarray]:
    """Train it on uniform points of a 2D object.

    Returns:
        What answers points ``(N, 2)`` with ``(N,)`` bool: whether the field finds the object likelier than not there.
    """
    lower, upper = grid.sample_lower, grid.sample_upper
    rng, values = np.random.default_rng(seed), torch.zeros(1, 1, nodes, nodes, requires_grad=True)

    def at(x: np.ndarray) -> torch.Tensor:
        place = np.clip(2 * (x - lower) / (upper - lower) - 1, -1, 1)[:, ::-1].astype(np.float32)
        return grid_sample(values, torch.from_numpy(place.copy())[None, None], align_corners=True)[0, 0, 0]

    with single_threaded_torch(), torch.enable_grad():
        optimiser = torch.optim.Adam([values], lr=rate)
        for _ in range(steps):
            x = rng.uniform(lower, upper, (batch, 2))
            loss = binary_cross_entropy_with_logits(10 * at(x), torch.from_numpy(grid.contains(x).astype(np.float32)))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()

    def ask(x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return (at(np.asarray(x, dtype=np.float64)) >= 0).numpy()

    return ask
