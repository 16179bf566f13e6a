"""Where an arm plans: its configurations, so scaled that a unit moves no point by over a metre a joint."""

from functools import cached_property

import numpy as np

import warp_bounding as wb
from sims.arm.robots import Cell
from sims.planning.planner import Place

__all__ = ["Workplace"]


class Workplace(Place):
    """A cell as a place to plan in.

    Attributes:
        cell: The arm and what stands around it.
        scene: Name under which its bounders lie.
        itself: Whether the arm must not touch itself either.
    """

    def __init__(self, cell: Cell, itself: bool = False):
        self.cell, self.name, self.scene, self.itself = cell, cell.title, f"arm-{cell.name}", itself

    @cached_property
    def around(self) -> wb.arms.ArmConfigurations:
        """The configurations that collide with what surrounds the arm: what bounders of the cell bound."""
        return self.cell.shape(self_collision=False)

    @cached_property
    def shape(self) -> wb.arms.ArmConfigurations:
        """The configurations that collide."""
        return self.cell.shape(self_collision=True) if self.itself else self.around

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Uniform within the joints' limits, which are float32 numbers."""
        lower, upper = self.shape.lower, self.shape.upper
        x = (lower + rng.random((count, len(lower))) * (upper - lower)).astype(np.float32)
        return np.clip(x, lower.astype(np.float32), upper.astype(np.float32))

    def problems_of(self, count: int, seed: int) -> np.ndarray:
        """Between random free configurations.

        Raises:
            ShapeError: If none is found: obstacles that swallow the base leave no room.
        """
        rng, free = np.random.default_rng([seed, 1]), np.zeros((0, self.shape.ndim), dtype=np.float32)
        for _ in range(100):
            x = self.draw(4 * count, rng)
            free = np.concatenate([free, x[~self.shape.contains(x)]])
            if len(free) >= 2 * count:
                return free[: 2 * count].reshape(count, 2, -1)
        raise wb.ShapeError(f"{self.name}: next to no configuration is free of collisions")

    def measured(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(x, dtype=np.float64)

    def joint_values(self, x: np.ndarray) -> np.ndarray:
        """``(N, n)`` float64, radians and metres, of states."""
        return np.asarray(x, dtype=np.float64) / self.shape.weights
