"""The demo ``shadows``: a bunny and a chair in the sun; see ``sims.shadows.demo``."""

from sims.shadows.demo import RECIPES, Demo
from sims.shadows.example import Example
from sims.shadows.scene import Scene, grids

__all__ = ["RECIPES", "Demo", "Example", "Scene", "grids", "run"]

run = Demo.run
