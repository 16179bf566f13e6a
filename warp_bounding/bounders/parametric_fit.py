"""Classic volumes in the space of a region's own numbers: the paper's way to bound rays, planes and boxes.

The paper fits a volume to the parameters of 20,000 positive regions. Its shape is taken from such samples here too (axes,
principal axes, an enclosing ellipsoid); faces and radius are then set by what is *proven* of the whole positive set
(``ParametricSupport``), so that the volume has no false negative beyond the samples either.

Statistics of the samples are made in a query's own units, as in the paper's code, not in those of ``v``.
"""

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["enclosing_of_samples", "fit_parametric", "units"]

STEPS = 400  # of the search for an enclosing ellipsoid; its radius is set afterwards


def units(domain: RegionDomain) -> np.ndarray:
    """``(2 n,)``, v per unit of a query's own numbers."""
    scale = domain.scale.astype(np.float64)
    first, second = {
        "ray": (scale, domain.stretch.astype(np.float64)),
        "plane": (np.ones(len(scale)), scale),
        "box": (scale, scale),
    }[domain.query]
    return np.concatenate([first, second])


def fit_parametric(
    kind: type[Bounder],
    grid: IndicatorGrid,
    domain: RegionDomain,
    positives: np.ndarray,
    *,
    device: str | None = None,
    **options,
) -> Bounder:
    """A volume of one of the classic methods around all positive regions.

    Args:
        kind: A class of bounders with ``fit_regions``.
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
        raise BounderError(f"{kind.method}: expected a region's domain in parametric space")
    positives = np.asarray(positives, dtype=np.float64)
    if positives.ndim != 2 or positives.shape[1] != domain.ndim or len(positives) == 0:
        raise BounderError(f"{kind.method}: positives must have shape (N, {domain.ndim}), got {positives.shape}")
    return kind.fit_regions(grid, domain, positives / units(domain), device=device, **options)


def enclosing_of_samples(points: np.ndarray, family: str) -> tuple[np.ndarray, np.ndarray]:
    """A small ``{x: |A (x - center)| <= 1}`` of a family (see ``enclosing_ellipsoid``) around points: multiplicative updates of weights."""
    middle, size = points.mean(axis=0), np.ptp(points, axis=0).max()
    x = (points - middle) / size
    weights = np.full(len(x), 1 / len(x))
    for _ in range(STEPS):
        mean = weights @ x
        away = x - mean
        covariance = (away * weights[:, None]).T @ away
        shape = {
            "trace": np.eye(len(mean)),
            "diagonal": np.diag(1 / np.diag(covariance)),
            "determinant": np.linalg.pinv(covariance),
        }[family]
        distance = np.einsum("ij,ij->i", away @ shape, away)
        weights = weights * distance
        keep = weights > 1e-9 * weights.max()
        if not keep.all():
            x, weights, distance = x[keep], weights[keep], distance[keep]
        weights = weights / weights.sum()
    away = (points - middle) / size - mean
    distance = np.einsum("ij,ij->i", away @ shape, away).max()
    return np.linalg.cholesky(shape / distance).T / size, mean * size + middle
