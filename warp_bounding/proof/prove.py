"""From a bounder and a shape to a proven threshold.

``prove`` finds the least value of ``f`` over P_delta, every float32 input that the pipeline can make of a query that
meets the object (``least_value``), and sets ``threshold <= minimum - E``.
"""

from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.certificates import Certificate, Verdict, document, shown
from warp_bounding.certificates.claim import mismatch
from warp_bounding.errors import BounderError
from warp_bounding.proof.distances import largest_overestimate
from warp_bounding.proof.search import Search, ShapePositives, minimum
from warp_bounding.proof.stress import Walk, statistical_test
from warp_bounding.queries import QUERIES
from warp_bounding.queries.boundary import border_points
from warp_bounding.rounding import round_down
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.grid import Grid, blocks_of
from warp_bounding.shapes.shape import Shape

# --- prove -----------------------------------------------------------------------------------------------------------


BELOW_FOUND = 1e-4  # of f: how far a statistical threshold lies under the least value that a search has found
STARTS = 4096  # points of a shape's border from which a search starts, unless it is given points
TOUCHED = ", at its time; segments and swept balls that are cleared touch nothing on their way, but may be enclosed"
CENTERS = 64  # about how many centres of cells a search starts from, unless it is given points


def positive_boxes(bounder: Bounder, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """P_delta, the object widened by delta, as boxes of ``v``: one a cell for closed forms, else few large ones.

    Returns:
        Lower and upper corners ``(N, n)`` float64.
    """
    first, last = (grid.occupied, grid.occupied + 1) if bounder.exact_on_cells else blocks_of(grid.occupancy)
    return bounder.domain.widened(grid.position(first - 0.5), grid.position(last - 0.5))


def least_value(
    bounder: Bounder,
    grid: Grid,
    *,
    points: np.ndarray | None = None,
    **limits,
) -> Search:
    """Certified minimum of f over every v that the pipeline can make of a positive; arguments as in ``prove``.

    * Closed forms of cells: one pass over the cells.
    * Convex volumes: the object's convex hull alone, where it is known.
    * A network's points, best first: over the cells, or, of a shape without cells, over the domain, less what the shape
      certifies to be empty (``search.ShapePositives``).
    """
    started = working_seconds()
    limits = {"eps": 1e-3, "points": points} | limits
    of_regions = QUERIES[bounder.query_kind].is_region
    if bounder.exact_on_cells and (of_regions or isinstance(grid, Grid) or bounder.exact_on_hull(grid)):
        least, looked_at = bounder.least(grid)
        return Search(least, least, np.empty((0, grid.ndim)), looked_at, working_seconds() - started, True)
    if points is None or not len(points):
        limits["points"] = bounder.domain.to_local(_starts(grid))
    if isinstance(grid, Grid):
        return minimum(bounder, *positive_boxes(bounder, grid), **limits)
    positives = ShapePositives(bounder, grid)
    return minimum(positives, *positives.boxes(), **limits)


def _starts(shape: Shape) -> np.ndarray:
    """``(N, n)`` points of a shape, object space, from which a search starts."""
    if isinstance(shape, Grid):
        return shape.position(shape.occupied[:: max(1, len(shape.occupied) // CENTERS)].astype(np.float64))
    return border_points(shape, STARTS, np.random.default_rng(0))


def prove(
    bounder: Bounder,
    grid: Grid,
    *,
    eps: float = 1e-3,
    budget: float = float("inf"),
    boxes: float = float("inf"),
    points: np.ndarray | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> Search:
    """Set a bounder's threshold by proof and give it its certificate.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object that it bounds.
        eps: Largest gap, in ``f``, between the proven minimum and the least value found.
        budget: Seconds for the search; less of it costs tightness, never soundness.
        boxes: Number of boxes for the search; fewer of them cost tightness, never soundness.
        points: ``(P, n)`` positives with a low f that the search begins with, coordinates ``v``.
        progress: Called now and then with boxes done, boxes waiting or the share that is done, and the gap.

    Returns:
        The search, with its lowest points.

    Raises:
        BounderError: If the bounder was made for another domain; if method or shape have no proof; if it is a cascade
            of regions, which is proven part by part (``Bounder.parts``); or if the minimum is not finite.
    """
    if reason := mismatch(bounder, grid):
        raise BounderError(f"{bounder.method}: {reason}")
    if not bounder.conservative:
        raise BounderError(f"{bounder.method}: is not conservative, so there is no proof")
    if not grid.certified:
        raise BounderError(
            f"{bounder.method}: {grid.name} certifies no box to be empty, so there is no proof; see statistical_test"
        )
    if len(bounder.parts) > 1 and QUERIES[bounder.query_kind].is_region:
        raise BounderError(f"{bounder.method}: {bounder.query_kind} queries are proven part by part, see Bounder.parts")
    search = least_value(bounder, grid, eps=eps, budget=budget, boxes=boxes, points=points, progress=progress)
    settle(bounder, grid, search)
    return search


def prove_or_test(
    bounder: Bounder,
    grid: Shape,
    *,
    seed: int = 0,
    points: np.ndarray | None = None,
    statistical: bool = False,
    **limits,
) -> Search | None:
    """``prove``, with its limits; or, if the shape certifies nothing or ``statistical``, a threshold without a proof.

    That is set under the least f that a search finds; ``statistical_test`` tests it and gives the certificate.

    Returns:
        What ``prove`` does, or ``None`` without a proof.
    """
    if grid.certified and not statistical:
        return prove(bounder, grid, points=points, **limits)
    least, budget = least_found(bounder, grid, seed, points), limits.get("budget", float("inf"))
    statistical_test(bounder, grid, least=least, below=BELOW_FOUND, seed=seed, budget=budget)
    return None


def least_found(bounder: Bounder, grid: Shape, seed: int, points: np.ndarray | None = None) -> float:
    """The least f of a point of the object that a walk finds; ``points`` as in ``prove``."""
    start = border_points(grid, STARTS, np.random.default_rng(seed))
    if points is not None:
        start = np.concatenate([bounder.domain.to_object(points), start])
    start = start.astype(np.float32)
    return float(Walk(bounder, grid, seed).down(start[grid.contains(start)])[1].min(initial=np.inf))


def prove_distance(
    bounder: DistanceBounder, shape: Shape, *, of_volume: Certificate | None = None, budget: float = float("inf")
) -> None:
    """``prove`` of a distance: ``f = d - F`` on all of the domain.

    Args:
        bounder: Changed in place (``freeze``).
        shape: The object that it bounds, its margin included.
        of_volume: The certificate of ``bounder.volume``, where there is one.
        budget: Seconds for a search.

    Raises:
        BounderError: If the bounder was made for another object, its volume is not proven, or there is no finite lower
            bound.
    """
    if reason := mismatch(bounder, shape):
        raise BounderError(f"{bounder.method}: {reason}")
    if bounder.volume is None:
        started = working_seconds()
        overestimate, boxes, complete, _ = largest_overestimate(bounder, shape, budget)
        least, spent = -overestimate, working_seconds() - started
    elif of_volume is None or not of_volume.proven:
        volume = f"a volume that is proven, and {shape.name} certifies no box to be empty"
        raise BounderError(f"{bounder.method}: a distance needs {volume}")
    else:
        least, boxes, spent, complete = 0.0, of_volume.boxes, of_volume.seconds, True
    settle(bounder, shape, Search(least, least, np.empty((0, bounder.ndim)), boxes, spent, complete))


def settle(bounder: Bounder, grid: Shape, search: Search) -> Certificate:
    """Set a bounder's threshold under what ``least_value`` has certified, and give it its certificate.

    Raises:
        BounderError: If the minimum is not finite, or the bounder was made for another object.
    """
    if reason := mismatch(bounder, grid):
        raise BounderError(f"{bounder.method}: {reason}")
    error = bounder.rounding_bound()
    threshold = float(round_down(np.nextafter(search.lower_bound - error, -np.inf)))
    threshold = min(threshold, bounder.highest_threshold)
    if not np.isfinite(threshold):
        raise BounderError(f"{bounder.method}: the proof found no finite minimum")
    if bounder.of_distances:
        unit, known = bounder.domain.unit, TOUCHED if grid.time else ""
        message = f"Proven: the distance is never overestimated, for any float32 point anywhere{known}."
        slack = f"The slack, taken off so that no distance is too large, is {-threshold * unit:.3g}"
        numbers = f"{slack}, {error * unit:.2g} of it for float32 rounding."
    else:
        positive = QUERIES[bounder.query_kind].positive
        message = f"Proven: no {positive} is ever answered with no."
        rounded = f"in float32 at most {error:.2g} less" if error else "in float32 too"
        least, from_ = shown(search.lower_bound), shown(threshold)
        numbers = f"For every {positive} f >= {least}, {rounded}; from f = {from_} on the answer is maybe."
    verdict = Verdict("proven", message, search.lower_bound, search.boxes)
    certificate = document(bounder.freeze(threshold, None), grid, verdict, search.seconds, numbers)
    bounder.freeze(threshold, certificate)
    return certificate
