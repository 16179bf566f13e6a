"""The object itself as a surface, without its margin: triangles of a mesh, cells of a grid, and else a level set of the truth."""

from functools import singledispatch

import numpy as np

from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, IndicatorMotion
from warp_bounding.indicators.shape import Shape
from warp_bounding.views.section import Section
from warp_bounding.views.surfaces import Surface, cell_surface, level_surface

__all__ = ["object_surface"]


@singledispatch
def object_surface(shape: Shape, section: Section, resolution: int) -> Surface:
    """The surface of an object in a section with three coordinates.

    Args:
        shape: The object.
        section: Where it is cut.
        resolution: Cells along the longest side, where it has to be searched for.
    """
    lower, upper = shape.lower[section.axes], shape.upper[section.axes]
    step = (upper - lower).max() / resolution
    return level_surface(lambda x: shape.contains(section.lift(x)), lower - step, upper + step, resolution)


@object_surface.register
def _of_mesh(shape: IndicatorMesh, section: Section, resolution: int) -> Surface:
    return Surface(np.asarray(shape.vertices, dtype=np.float64), np.asarray(shape.faces, dtype=np.int64))


@object_surface.register
def _of_motion(shape: IndicatorMotion, section: Section, resolution: int) -> Surface:
    if section.axes != [1, 2, 3]:  # time runs, or a coordinate of space is held
        return object_surface.dispatch(Shape)(shape, section, resolution)
    vertices = shape.vertices_at(section.held[0]).astype(np.float64)
    return Surface(vertices, np.asarray(shape.faces, dtype=np.int64))


@object_surface.register
def _of_grid(shape: IndicatorGrid, section: Section, resolution: int) -> Surface:
    cells = shape.occupancy
    for axis in sorted(section.held, reverse=True):
        centres = shape.position(np.repeat(np.arange(shape.shape[axis])[:, None], shape.ndim, axis=1))[:, axis]
        cells = np.take(cells, np.abs(centres - section.held[axis]).argmin(), axis)
    edges = []
    for axis in section.axes:
        places = np.repeat(np.arange(shape.shape[axis] + 1)[:, None] - 0.5, shape.ndim, axis=1)
        edges.append(shape.position(places)[:, axis])
    return cell_surface(cells, edges)
