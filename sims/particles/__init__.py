"""The demo ``particles``: rain on a bunny that moves; see ``sims.particles.demo``."""

from sims.particles.demo import SCENE_SPECS, SPECS, Demo, shapes
from sims.particles.example import Example
from sims.particles.scene import Scene

__all__ = ["SCENE_SPECS", "SPECS", "Demo", "Example", "Scene", "run", "shapes"]

run = Demo.run
