"""Arms that plan among obstacles: colliding configurations are bounded, in as many dimensions as joints.

``Example(place, exact, broad)`` plans all problems of a cell at once; ``run`` does the whole demo.
"""

from sims.arm.demo import SCENE_SPECS, SPECS, Demo, Example, run, shapes

__all__ = ["SCENE_SPECS", "SPECS", "Demo", "Example", "run", "shapes"]
