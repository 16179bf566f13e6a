"""The demo ``cloth``: a cloth falls on the bunny and a star, simulated by Newton; and many meshes among many particles.

    python -m sims cloth --output out/demo

``scene`` has the model, ``example`` a run, ``field`` the many meshes, ``demo`` what is printed and returned,
``pictures`` draws. It needs the extra ``sims``, with Newton in it.
"""

import newton  # noqa: F401  first: where it is missing, the error names it

import warp_bounding as wb
from sims.cloth.demo import Demo
from sims.cloth.example import Example
from sims.cloth.field import FIELD_SPECS, GAPS, Field
from sims.cloth.scene import SHAPES, SPECS, Scene, dilated

__all__ = ["SCENE_SPECS", "SPECS", "Demo", "Example", "Field", "Scene", "run", "shapes"]

run = Demo.run
SCENE_SPECS = {f"field-{name}": FIELD_SPECS for name in SHAPES}  # for the scenes that do not take all of SPECS


def shapes(device: str = "cpu") -> dict[str, wb.shapes.Mesh]:
    """By scene, that is the name under which bounders are stored, the shape that they are fitted to."""
    of_cloth = {f"cloth-{name}": dilated(name) for name in SHAPES}
    return of_cloth | {f"field-{name}": dilated(name, max(GAPS)) for name in SHAPES}
