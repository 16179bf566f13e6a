"""The demo ``shadows``: a bunny and a chair in the sun; see ``sims.shadows.demo``."""

from sims.shadows.demo import SPECS, Demo
from sims.shadows.example import Example
from sims.shadows.scene import Scene, grids

__all__ = ["SPECS", "Demo", "Example", "Scene", "grids", "run"]

run = Demo.run
