"""A certificate filled in for a bounder and a grid."""

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.certificate import Certificate
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["document"]


def document(
    bounder: Bounder,
    grid: IndicatorGrid | None,
    kind: str,
    threshold: float,
    least: float,
    boxes: int,
    seconds: float,
    message: str,
    counterexample=None,
    **more,
) -> Certificate:
    """The certificate.

    Args:
        bounder: What it is about.
        grid: The object; ``None`` where it cannot be the bounded one.
        kind: See ``Certificate``.
        threshold: See ``Certificate``.
        least: Its ``lower_bound``.
        boxes: See ``Certificate``.
        seconds: See ``Certificate``.
        message: See ``Certificate``.
        counterexample: See ``Certificate``.
        more: Other fields.
    """
    base = bounder.domain.base
    return Certificate(
        kind=kind,
        query=bounder.query_kind,
        domain=[base.lower.tolist(), base.upper.tolist()],
        threshold=float(np.float32(threshold)),
        lower_bound=float(least),
        rounding_bound=bounder.rounding_bound(),
        delta=[] if grid is None else (base.delta / (base.scale / grid.cells_per_unit)).tolist(),
        boxes=int(boxes),
        seconds=round(float(seconds), 3),
        indicator="" if grid is None else grid.digest,
        cells=0 if grid is None else len(grid.occupied),
        counterexample=None if counterexample is None else [float(c) for c in counterexample],
        message=message,
        **more,
    )
