"""The step from a bounder and a grid to a proven threshold.

``prove`` finds the least value of ``f`` over P_delta, every float32 input that the pipeline can make of a query that
meets the object (``least_value``), and sets ``threshold <= minimum - E``.
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.document import document
from warp_bounding.errors import BounderError
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.search.depth_first import ChartedPositives, charted_minimum
from warp_bounding.queries import QUERIES
from warp_bounding.runtime.launch import working_seconds

__all__ = [
    "as_fitted",
    "charted",
    "least_value",
    "mismatch",
    "other_claim",
    "other_dimension",
    "outside",
    "prove",
    "settle",
]

OUTSIDE = "the shape reaches outside the domain that the bounder was made for"
CENTERS = 64  # about how many cells' centres a search begins with, where it is given no points


def charted(bounder: Bounder, grid: IndicatorGrid) -> ChartedPositives | None:
    """The positives of a network as boxes of a chart (``Cover.charted``); ``None`` where the proof has no chart."""
    return COVERS[bounder.query_kind].charted(bounder, grid) if type(bounder) is Mlp else None


def least_value(
    bounder: Bounder,
    grid: IndicatorGrid,
    *,
    eps: float = 1e-3,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> Search:
    """Certified minimum of f over every v that the pipeline can make of a positive; arguments as in ``prove``.

    That takes one pass over the cells, or branch and bound. Points, rays and boxes of a network are searched depth first
    in the numbers of a chart (``charted``). Where there is no chart the search is best first: planes over their normals,
    a monotone network's boxes over the object's points (``covers``).
    """
    started = working_seconds()
    if bounder.exact_on_cells:
        least, looked_at = bounder.least(grid)
        return Search(least, least, np.empty((0, grid.ndim)), looked_at, working_seconds() - started, True)
    limits = {"eps": eps, "seconds": seconds, "boxes": boxes, "progress": progress}
    kind, found = COVERS[bounder.query_kind], charted(bounder, grid)
    if found is None:
        return minimum(*kind.best_first(bounder, grid), points=points, **limits)
    if points is None or not len(points):
        centers = grid.position(grid.occupied[:: max(1, len(grid.occupied) // CENTERS)].astype(np.float64))
        points = kind.at_points(bounder.domain.base.to_local(centers), bounder)
    return charted_minimum(found, upper=float(bounder.reference(points).min()), **limits)


def prove(
    bounder: Bounder,
    grid: IndicatorGrid,
    *,
    eps: float = 1e-3,
    seconds: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> Search:
    """Set a bounder's threshold by proof and give it its certificate.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object that it bounds.
        eps: Largest gap, in ``f``, between the proven minimum and the least value found.
        seconds: Time for the search; less of it costs tightness, never soundness.
        boxes: Number of boxes for the search; fewer of them cost tightness, never soundness.
        points: ``(P, n)`` positives with a low f that the search begins with, coordinates ``v``.
        progress: Called now and then with boxes done, boxes waiting or the share that is done, and the gap.

    Returns:
        The search, with its lowest points.

    Raises:
        BounderError: If the bounder was made for another domain; if it consists of several networks whose regions are
            proven one by one (``Bounder.parts``); or if no threshold separates anything (the minimum is not finite).
    """
    reason = mismatch(bounder, grid) or bounder.domain.fault() or (len(outside(bounder, grid)) and OUTSIDE)
    if reason:
        raise BounderError(f"{bounder.method}: {reason}")
    if not bounder.provable:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries of networks like this one have no proof")
    if len(bounder.parts) > 1 and QUERIES[bounder.query_kind].is_region:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries are proven part by part, see Bounder.parts")
    search = least_value(bounder, grid, eps=eps, seconds=seconds, boxes=boxes, points=points, progress=progress)
    settle(bounder, grid, search)
    return search


def settle(bounder: Bounder, grid: IndicatorGrid, search: Search) -> Certificate:
    """Set a bounder's threshold under what ``least_value`` has certified, and give it its certificate.

    Raises:
        BounderError: If the minimum is not finite: no threshold separates anything.
    """
    error = bounder.rounding_bound()
    threshold = float(round_down(np.nextafter(search.lower_bound - error, -np.inf)))
    if not np.isfinite(threshold):
        raise BounderError(f"{bounder.method}: the proof found no finite minimum")
    message = (
        f"Proven: no {QUERIES[bounder.query_kind].positive} is ever answered with no. "
        f"f >= {search.lower_bound:.6g} on all of them, float32 rounding changes it by at most {error:.2g}, "
        f"the threshold is {threshold:.6g}."
    )
    found = (search.lower_bound, search.boxes, search.seconds)
    certificate = document(bounder, grid, "proven", threshold, *found, message)
    bounder.freeze(threshold, certificate)
    return certificate


def as_fitted(bounder: Bounder, shape) -> IndicatorGrid:
    """The cells of anything that ``load_indicator`` takes, as for the fit: with the bounder's resolution and margin."""
    shape = load_indicator(shape)
    resolution = None if isinstance(shape, IndicatorGrid) else bounder.info.get("resolution")
    return shape.to_grid(resolution=resolution, margin=bounder.info.get("margin") or 0.0)


def other_claim(bounder: Bounder, expected: dict[str, str | float | None]) -> str | None:
    """How a bounder's claim differs from what is expected of it, or ``None``; an expected ``None`` is not compared."""
    claimed = {
        "query": bounder.query_kind,
        "margin": bounder.info.get("margin") or 0.0,
        "length": bounder.domain.length,
        "resolution": bounder.info.get("resolution"),
    }
    for name, value in expected.items():
        if value is not None and value != claimed[name]:
            own = "none" if claimed[name] is None else claimed[name]
            return f"another claim than the expected one: expected {name} {value}, the bounder is for {name} {own}"
    return None


def other_dimension(bounder: Bounder, grid: IndicatorGrid) -> str | None:
    """How a grid's dimension, or its having a time, differs from the bounder's; ``None`` where it does not."""
    sides = ((grid.ndim, grid.time), (bounder.ndim, bounder.domain.time))
    kinds = [f"{n}D" + (", animated" if t else "") for n, t in sides]
    return None if sides[0] == sides[1] else f"the shape is {kinds[0]}, the bounder {kinds[1]}"


def mismatch(bounder: Bounder, grid: IndicatorGrid) -> str | None:
    """Why a grid's points cannot be this bounder's queries, or ``None``."""
    domain = bounder.domain.base
    if other := other_dimension(bounder, grid):
        return other
    if grid.time and (domain.lower[0] < grid.lower[0] or domain.upper[0] > grid.upper[0]):
        times = ((grid.lower[0], grid.upper[0]), (domain.lower[0], domain.upper[0]))
        known, asked = (f"{first:.7g} to {last:.7g}" for first, last in times)
        return f"the shape is known at times from {known}, the bounder denies queries from {asked}"
    return None


def outside(bounder: Bounder, grid: IndicatorGrid) -> np.ndarray:
    """The occupied cells that reach outside the bounder's domain."""
    domain, cells = bounder.domain.base, grid.occupied
    lower, upper = grid.position(cells - 0.5), grid.position(cells + 0.5)
    return cells[((lower < domain.lower) | (upper > domain.upper)).any(axis=1)]
