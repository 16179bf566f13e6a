"""Solids and their algebra: shapes that are put together by hand, in any number of dimensions, with certified bounds.

Each is a shape like any other, which ``fit`` and everything else takes. The operators ``|``, ``&`` and ``-`` combine
them with each other, and with meshes, grids and functions.

Example:
    >>> plate = wb.solids.Box([-1, -1, 0], [1, 1, 0.2]) - wb.solids.Sphere([0, 0, 0.1], 0.5)
    >>> plate.contains(np.array([[0, 0, 0.1], [0.9, 0.9, 0.1]]))
    array([False,  True])
    >>> plate.empty(np.array([[-0.1, -0.1, 0.0]]), np.array([[0.1, 0.1, 0.2]]))
    array([ True])
"""

from warp_bounding.indicators.solids import (
    Box,
    Capsule,
    Difference,
    Dilation,
    Extrusion,
    HalfSpace,
    Intersection,
    Sphere,
    Torus,
    Transform,
    Union,
)

__all__ = [
    "Box",
    "Capsule",
    "Difference",
    "Dilation",
    "Extrusion",
    "HalfSpace",
    "Intersection",
    "Sphere",
    "Torus",
    "Transform",
    "Union",
]
