"""The demo ``path``: plans motions in 2D worlds, with the world's bounder asked before every exact check.

    python -m sims path --output out/path

A probabilistic roadmap needs to know of thousands of states and edges whether they meet an obstacle. Each batch of them
is first asked of a bounder; what the bounder clears is never checked again. Bounders of distances march along edges,
which takes a twentieth of the time of bounding a network along them. With proven bounders the planner finds the same
paths, to the bit, with a fraction of the exact checks; with a network that is only *mostly* conservative it plans
through walls.
"""

from sims.path.demo import SPECS, Demo, run, shapes
from sims.path.planner import Example

__all__ = ["SPECS", "Demo", "Example", "run", "shapes"]
