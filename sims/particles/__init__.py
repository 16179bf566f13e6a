"""The demo ``particles``: rain on a bunny that moves; see ``sims.particles.demo``."""

from sims.particles.demo import SPECS, Demo, grids
from sims.particles.example import Example
from sims.particles.scene import Scene

__all__ = ["SPECS", "Demo", "Example", "Scene", "grids", "run"]

run = Demo.run
