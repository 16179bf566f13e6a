"""The demo ``particles``: rain on a bunny that moves; see ``sims.particles.demo``."""

from sims.particles.demo import RECIPES, grids, run
from sims.particles.example import Example
from sims.particles.scene import Scene

__all__ = ["RECIPES", "Example", "Scene", "grids", "run"]
