"""The step from a bounder and a grid to a proven threshold.

``prove`` finds the least value of ``f`` over P_delta, every float32 input that the pipeline can make of a query that
meets the object (``least_value``), and sets ``threshold <= minimum - E``.
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.base import Bounder
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.document import document
from warp_bounding.errors import BounderError
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.proof.least import least_value
from warp_bounding.proof.search.best_first import Search
from warp_bounding.queries import QUERIES

__all__ = ["as_fitted", "mismatch", "other_claim", "other_dimension", "outside", "prove", "settle"]


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
    reason = mismatch(bounder, grid) or bounder.domain.fault()
    if reason or len(outside(bounder, grid)):
        raise BounderError(
            f"{bounder.method}: {reason or 'the shape reaches outside the domain that the bounder was made for'}"
        )
    if not bounder.provable:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries of networks like this one have no proof")
    if len(bounder.parts) > 1 and QUERIES[bounder.query_kind].is_region:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries are proven part by part, see Bounder.parts")
    search = least_value(bounder, grid, eps=eps, seconds=seconds, boxes=boxes, points=points, progress=progress)
    settle(bounder, grid, search)
    return search


def settle(bounder: Bounder, grid: IndicatorGrid, search: Search) -> Certificate:
    """Set a bounder's threshold under a least value that was certified, and give it its certificate.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object.
        search: What ``least_value`` found for this bounder and object.

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
    certificate = document(
        bounder, grid, "proven", threshold, search.lower_bound, search.boxes, search.seconds, message
    )
    bounder.freeze(threshold, certificate)
    return certificate


def as_fitted(bounder: Bounder, shape) -> IndicatorGrid:
    """A shape's cells, made as they were for the fit: with the bounder's own resolution and margin.

    Args:
        bounder: Any bounder.
        shape: Anything that ``load_indicator`` takes.
    """
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
        known, asked = (
            f"{a[0]:.7g} to {b[0]:.7g}" for a, b in ((grid.lower, grid.upper), (domain.lower, domain.upper))
        )
        return f"the shape is known at times from {known}, the bounder denies queries from {asked}"
    return None


def outside(bounder: Bounder, grid: IndicatorGrid) -> np.ndarray:
    """The occupied cells that reach outside the bounder's domain."""
    domain, cells = bounder.domain.base, grid.occupied
    lower, upper = grid.position(cells - 0.5), grid.position(cells + 0.5)
    return cells[((lower < domain.lower) | (upper > domain.upper)).any(axis=1)]
