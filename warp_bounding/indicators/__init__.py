"""What is bounded: occupancy grids, meshes, functions, and the files that they come from.

Importing this package needs NumPy only; trimesh, usd-core, Pillow, SciPy and Warp are imported when a file or a
mesh asks for them.
"""

from warp_bounding.indicators.formats.load import READERS, Indicator, load_indicator
from warp_bounding.indicators.function import IndicatorFunction
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.mesh import IndicatorMesh
from warp_bounding.indicators.motion import IndicatorMotion
from warp_bounding.indicators.parts import Complement

__all__ = [
    "READERS",
    "Complement",
    "Indicator",
    "IndicatorFunction",
    "IndicatorGrid",
    "IndicatorMesh",
    "IndicatorMotion",
    "load_indicator",
]
