"""The demo ``shadows``: a bunny and a chair in the sun; see ``sims.shadows.demo``."""

from sims.shadows.demo import SPECS, Demo
from sims.shadows.example import Example
from sims.shadows.scene import Scene, shapes

__all__ = ["SPECS", "Demo", "Example", "Scene", "run", "shapes"]

run = Demo.run
