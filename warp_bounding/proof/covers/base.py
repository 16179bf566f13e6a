"""What a kind of query is to the proofs: boxes that cover its positives, and how their numbers become queries again."""

from collections.abc import Iterator

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid, blocks_of
from warp_bounding.proof.covers.monotone_box import LeastBox, of_points
from warp_bounding.proof.search.depth_first import ChartedPositives

__all__ = ["Cover", "positive_boxes"]


class Cover:
    """The cover of a kind of query; found under the kind's name in ``covers.COVERS``."""

    def charted(self, bounder: Mlp, grid: IndicatorGrid) -> ChartedPositives | None:
        """The positives of a network as boxes of a chart, for a search depth first; ``None`` where there is no chart.

        The bounder's domain must hold the object.

        Raises:
            BounderError: If the bounds' own arithmetic cannot be certified so far beyond the domain.
        """
        return None

    def best_first(self, bounder: Bounder, grid: IndicatorGrid) -> tuple:
        """What ``minimum`` searches without a chart: an f with ``bound`` and ``reference``, and corners of boxes."""
        f = of_points(bounder)
        return f, *f.cut(*positive_boxes(f, grid))[:2]

    # In how many boxes ``reach`` is asked for the points of regions, fewest first; none where shapes need no cells.
    pieces: tuple[int, ...] = ()

    def reach(
        self, cover: ChartedPositives, lower: np.ndarray, upper: np.ndarray, pieces: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where regions can meet the object: all of its points in positives of boxes, other than what other boxes tell of.

        Args:
            cover: What ``charted`` has made; its boxes may be cut further.
            lower: ``(N, Z)`` float64 corners, numbers of the chart.
            upper: ``(N, Z)`` float64.
            pieces: In how many boxes.

        Returns:
            Corners ``(N, pieces, n)`` float64 of boxes in local space, some inverted, which hold nothing: every exact
            positive of a box of z that no other box of the cover has meets the object in these.
        """
        raise NotImplementedError

    def anew(
        self, bounder: Mlp, grid: IndicatorGrid, cover: ChartedPositives
    ) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
        """The charted positives for ``certify``, some at a time, in boxes that it need not share with the search.

        Yields:
            Lower and upper corners, and how many of the object's cells are done with these.
        """
        yield cover.lower, cover.upper, len(grid.occupied)

    def at_points(self, p: np.ndarray, bounder: Bounder) -> np.ndarray:
        """V of queries that pass points ``(N, n)`` of the object, both in local space (of points and boxes in any)."""
        raise NotImplementedError(bounder.query_kind)

    def coordinates(self, bounder: Bounder, grid: IndicatorGrid, v: np.ndarray) -> np.ndarray:
        """``v`` of what a search has found, given as the numbers ``(N, Z)`` that it searched over.

        Raises:
            BounderError: If these are other numbers.
        """
        if (n := bounder.domain.ndim) != v.shape[1]:
            raise BounderError(
                f"{bounder.query_kind} queries of {grid.ndim}D objects have {n} coordinates, got {v.shape[1]}"
            )
        return v


def positive_boxes(bounder: Bounder | LeastBox, grid: IndicatorGrid) -> tuple[np.ndarray, np.ndarray]:
    """P_delta, the object widened by delta, as boxes of ``v``: one a cell for closed forms, else few large ones.

    Returns:
        Lower and upper corners ``(N, n)`` float64.
    """
    first, last = (grid.occupied, grid.occupied + 1) if bounder.exact_on_cells else blocks_of(grid.occupancy)
    return bounder.domain.widened(grid.position(first - 0.5), grid.position(last - 0.5))
