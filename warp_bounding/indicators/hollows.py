"""Air that an object encloses: whether it counts as inside, one word for meshes and grids.

A hollow is a part of space that nothing leads out of, and that no surface goes around: the air of a tank, of a room without a door. Cells
that touch in an edge or a corner only are closed there, as they are closed sets.
"""

from dataclasses import replace

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.mesh import IndicatorMesh
from warp_bounding.indicators.recentred import Recentred
from warp_bounding.indicators.shape import HOLLOW

__all__ = ["with_hollow"]


def with_hollow(shape, hollow: str):
    """A shape whose hollows are filled or empty.

    Args:
        shape: A grid or a mesh.
        hollow: One of ``HOLLOW``.

    Raises:
        IndicatorError: For other shapes, and for a mesh whose faces do not tell air from solid parts, where hollows are to be empty.
    """
    if isinstance(shape, Recentred):
        return Recentred(with_hollow(shape.local, hollow), shape.coordinates)
    if isinstance(shape, IndicatorMesh):
        return replace(shape, hollow=hollow)
    if not isinstance(shape, IndicatorGrid):
        raise IndicatorError(
            f"{shape.name}: hollow is for grids and for meshes at rest, got hollow={hollow!r} for {type(shape).__name__}"
        )
    return shape if hollow == HOLLOW[1] else _filled(shape)


def _filled(grid: IndicatorGrid) -> IndicatorGrid:
    """A grid whose enclosed cells are occupied; where coordinate 0 is time, those that are enclosed at their time."""
    from scipy import ndimage

    occupancy, offset, count = grid.occupancy.copy(), grid.offset, 0
    for part in occupancy if grid.time else occupancy[None]:
        padded = np.pad(part, 1)
        label, regions = ndimage.label(~padded)
        enclosed = (~padded & (label != label[(0,) * part.ndim]))[(slice(1, -1),) * part.ndim]
        part |= enclosed
        count += regions - 1
    if occupancy.all():  # a wall all around: a border that can be left out
        occupancy = np.pad(occupancy, [(int(k > 0 or not grid.time),) * 2 for k in range(grid.ndim)])
        offset = offset - [float(k > 0 or not grid.time) for k in range(grid.ndim)]
    remark = f"{count:,} closed hollow{'s' * (count != 1)} filled"
    return replace(grid, occupancy=occupancy, offset=offset, remark="; ".join(filter(None, [grid.remark, remark])))
