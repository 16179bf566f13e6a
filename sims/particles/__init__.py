"""The demo ``particles``: rain on a bunny that moves; see ``sims.particles.demo``."""

from sims.particles.demo import RECIPES, Demo, grids
from sims.particles.example import Example
from sims.particles.scene import Scene

__all__ = ["RECIPES", "Demo", "Example", "Scene", "grids", "run"]

run = Demo.run
