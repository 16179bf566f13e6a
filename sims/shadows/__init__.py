"""The demo ``shadows``: a bunny and a chair in the sun; see ``sims.shadows.demo``."""

from sims.shadows.demo import RECIPES, run
from sims.shadows.example import Example
from sims.shadows.scene import Scene, grids

__all__ = ["RECIPES", "Example", "Scene", "grids", "run"]
