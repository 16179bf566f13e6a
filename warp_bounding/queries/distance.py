"""Distance queries: n numbers, the coordinates of a point in object space. How far is the object, at least?

It is no kind of query with a yes or no (``QUERIES``), so there is no oracle of it: the truth is what shapes tell (``Shape.distances``),
and a radius makes a yes or no of it.
"""

from dataclasses import dataclass, replace

from warp_bounding.errors import IndicatorError, QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape

__all__ = ["DISTANCE", "METRICS", "DistanceQuery", "in_metric"]

METRICS = (
    "space",
    "spacetime",
)  # where coordinate 0 is time: distances in space at a time, or in all coordinates alike


@dataclass(frozen=True)
class DistanceQuery:
    """What other floors say of distance queries."""

    name: str = "distance"
    positive: str = "distance"
    every: str = "every point, inside the domain or outside"
    is_region: bool = False

    @staticmethod
    def columns(ndim: int) -> int:
        """Numbers of a query."""
        return ndim


DISTANCE = DistanceQuery()


def in_metric(shape: Shape, metric: str) -> Shape:
    """A shape whose distances are those of a metric: of a grid with a time, in ``"spacetime"``, one without.

    Raises:
        QueryError: For an unknown metric.
        IndicatorError: For another shape with a time in ``"spacetime"``.
    """
    if metric not in METRICS:
        raise QueryError(f"metric must be one of {', '.join(METRICS)}, got {metric!r}")
    if metric == METRICS[0] or not shape.time:
        return shape
    if not isinstance(shape, IndicatorGrid):
        raise IndicatorError(
            f"{shape.name}: metric={metric} is for grids; give the shape's cells, to_grid(resolution=...)"
        )
    return replace(shape, time=False)
