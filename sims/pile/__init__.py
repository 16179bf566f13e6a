"""The demo ``pile``: bunnies and rings fall into a box and come to rest; see ``sims.pile.demo``."""

from sims.pile.demo import SPECS, Demo
from sims.pile.example import Example
from sims.pile.scene import Scene, hold, shapes

__all__ = ["SPECS", "Demo", "Example", "Scene", "hold", "run", "shapes"]

run = Demo.run
