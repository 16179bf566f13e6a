"""The step from a bounder and a grid to a proven threshold.

``prove`` finds the least value of ``f`` over P_delta, every float32 input that the pipeline can make of a query that
meets the object (``least_value``), and sets ``threshold <= minimum - E``.
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claim import mismatch
from warp_bounding.certificates.document import document, shown
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.attest.falsify import Walk
from warp_bounding.proof.attest.statistics import attest
from warp_bounding.proof.covers import COVERS
from warp_bounding.proof.covers.monotone_box import of_points
from warp_bounding.proof.search.best_first import Search, minimum
from warp_bounding.proof.search.depth_first import ChartedPositives, charted_minimum
from warp_bounding.proof.search.vacancy import ShapePositives
from warp_bounding.proof.shape_regions import least_region
from warp_bounding.queries import QUERIES
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds

__all__ = ["charted", "least_value", "prove", "prove_or_attest", "settle"]

ROOM = 1e-4  # of f: how far under the least value that a search has found an attested threshold is set
STARTS = 4096  # points of a shape's border that a search begins with, where it is given none
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

    That takes one pass over the cells, or branch and bound. Of a shape without cells the whole domain is searched, less
    what the shape certifies to be empty (``search.vacancy``), for points and for a monotone network's boxes; convex volumes,
    of points or of regions that are tested against them, and planes need its convex hull alone, where that is known. Points, rays and boxes of a network are searched depth first
    in the numbers of a chart (``charted``). Where there is no chart the search is best first: planes over their normals,
    a monotone network's boxes over the object's points (``covers``).
    """
    started = working_seconds()
    limits = {"eps": eps, "seconds": seconds, "boxes": boxes, "progress": progress}
    f, region = of_points(bounder), QUERIES[bounder.query_kind].is_region
    searched = not isinstance(grid, IndicatorGrid) and not bounder.exact_on_hull(grid)
    if searched and (not region or f is not bounder):
        positives = ShapePositives(f, grid)
        if points is None or not len(points):
            points = f.domain.to_local(border_points(grid, STARTS, np.random.default_rng(0)))
        return minimum(positives, *positives.boxes(), points=points, positives=positives, **limits)
    if bounder.exact_on_cells:
        least, looked_at = bounder.least(grid)
        return Search(least, least, np.empty((0, grid.ndim)), looked_at, working_seconds() - started, True)
    kind = COVERS[bounder.query_kind]
    known = np.empty((0, bounder.domain.ndim)) if points is None else points
    if not isinstance(grid, IndicatorGrid) and kind.pieces:
        if not len(known):
            border = border_points(grid, STARTS, np.random.default_rng(0))
            known = kind.at_points(bounder.domain.base.to_local(border), bounder)
        return least_region(bounder, grid, float(bounder.reference(known).min()), **limits)
    found = charted(bounder, grid)
    if found is None:
        return minimum(*kind.best_first(bounder, grid), points=points, **limits)
    if not len(known):
        centers = grid.position(grid.occupied[:: max(1, len(grid.occupied) // CENTERS)].astype(np.float64))
        known = kind.at_points(bounder.domain.base.to_local(centers), bounder)
    return charted_minimum(found, upper=float(bounder.reference(known).min()), **limits)


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
    if reason := mismatch(bounder, grid):
        raise BounderError(f"{bounder.method}: {reason}")
    if not bounder.provable:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries of networks like this one have no proof")
    if not grid.certified:
        raise BounderError(
            f"{bounder.method}: {grid.name} certifies no box to be empty, so there is no proof; see attest"
        )
    if len(bounder.parts) > 1 and QUERIES[bounder.query_kind].is_region:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries are proven part by part, see Bounder.parts")
    search = least_value(bounder, grid, eps=eps, seconds=seconds, boxes=boxes, points=points, progress=progress)
    settle(bounder, grid, search)
    return search


def prove_or_attest(
    bounder: Bounder,
    grid: Shape,
    *,
    seed: int = 0,
    points: np.ndarray | None = None,
    attested: bool = False,
    **limits,
) -> Search | None:
    """``prove``, with its limits; where the shape certifies nothing, or no proof is wanted, lower the threshold by a search and attest it.

    Returns:
        What ``prove`` does, or ``None``.
    """
    if grid.certified and not attested:
        return prove(bounder, grid, points=points, **limits)
    walk, start = Walk(bounder, grid, seed), border_points(grid, STARTS, np.random.default_rng(seed))
    if points is not None:
        start = np.concatenate([bounder.domain.to_object(points), start])
    start = start.astype(np.float32)
    values = walk.down(start[grid.contains(start)])[1]
    attest(bounder, grid, least=float(values.min(initial=np.inf)), room=ROOM, seed=seed)
    return None


def settle(bounder: Bounder, grid: IndicatorGrid, search: Search) -> Certificate:
    """Set a bounder's threshold under what ``least_value`` has certified, and give it its certificate.

    Raises:
        BounderError: If the minimum is not finite: no threshold separates anything; or if the bounder was made for
            another object.
    """
    if reason := mismatch(bounder, grid):
        raise BounderError(f"{bounder.method}: {reason}")
    error = bounder.rounding_bound()
    threshold = float(round_down(np.nextafter(search.lower_bound - error, -np.inf)))
    if not np.isfinite(threshold):
        raise BounderError(f"{bounder.method}: the proof found no finite minimum")
    message = f"Proven: no {QUERIES[bounder.query_kind].positive} is ever answered with no."
    rounded = f"in float32 at most {error:.2g} less" if error else "in float32 too"
    numbers = (
        f"For every {QUERIES[bounder.query_kind].positive} f >= {shown(search.lower_bound)}, {rounded}; "
        f"from f = {shown(threshold)} on the answer is maybe."
    )
    found = (search.lower_bound, search.boxes, search.seconds)
    certificate = document(bounder, grid, "proven", threshold, *found, message, numbers=numbers)
    bounder.freeze(threshold, certificate)
    return certificate
