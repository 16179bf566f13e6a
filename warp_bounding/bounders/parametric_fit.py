"""Classic volumes in the space of a region's own numbers: the paper's way to bound rays, planes and boxes.

The paper fits a volume to the parameters of 20,000 positive regions. Its shape is taken from such samples here too
(axes, principal axes, an enclosing ellipsoid). Faces and radius are then set by proven bounds of the set of all
positives (``ParametricSupport``), so that the volume has no false negative beyond the samples either.

Statistics of the samples are computed in a query's own units, as in the paper's code, not in those of ``v``.
"""

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["fit_parametric", "units"]


def units(domain: RegionDomain) -> np.ndarray:
    """``(2 n,)``, v per unit of a query's own numbers."""
    return domain.coordinates.units(domain)


def fit_parametric(
    cls: type[Bounder],
    grid: IndicatorGrid,
    domain: RegionDomain,
    positives: np.ndarray,
    *,
    device: str | None = None,
    **options,
) -> Bounder:
    """A volume of one of the classic methods around all positive regions.

    Args:
        cls: A class of bounders with ``fit_regions``.
        grid: The object.
        domain: ``domain_of(grid, query, length, "parametric")``.
        positives: ``(N, 2 n)`` float64, ``v`` of sampled positive queries; they give the shape, not the size.
        device: Warp device.
        options: The method's own.

    Returns:
        The bounder; ``prove`` sets its threshold.

    Raises:
        BounderError: If the method has no volume in parametric space, or there are no positives.
    """
    if not domain.parametric:
        raise BounderError(f"{cls.method}: expected a region's domain in parametric space")
    positives = np.asarray(positives, dtype=np.float64)
    if positives.ndim != 2 or positives.shape[1] != domain.ndim or len(positives) == 0:
        raise BounderError(f"{cls.method}: positives must have shape (N, {domain.ndim}), got {positives.shape}")
    return cls.fit_regions(grid, domain, positives / units(domain), device=device, **options)
