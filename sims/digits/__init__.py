"""The demo ``digits``: a generative model of handwritten digits, bounded before it is run; see ``sims.digits.demo``."""

from sims.digits.demo import SPECS, Demo, shapes
from sims.digits.example import Example

__all__ = ["SPECS", "Demo", "Example", "run", "shapes"]

run = Demo.run
