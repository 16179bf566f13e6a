"""Classic volumes in the space of a region's own numbers: the paper's way to bound rays, planes and boxes.

The paper fits a volume to the parameters of 20,000 positive regions. Its shape is taken from such samples here too (axes,
principal axes, an enclosing ellipsoid); faces and radius are then set by what is *proven* of the whole positive set
(``ParametricSupport``), so that the volume has no false negative beyond the samples either. ``sampled_fit`` is the paper's own
variant without a proof, for the comparison with its tables.

Statistics of the samples are made in a query's own units, as in the paper's code, not in those of ``v``.
"""

import numpy as np

from warp_bounding.arithmetic import round_down, round_up
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.ellipsoids.base import QuadricBounder
from warp_bounding.bounders.slabs.base import SlabBounder
from warp_bounding.bounders.slabs.kdop import kdop_directions
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.support_functions.parametric import ParametricSupport

__all__ = ["fit_parametric", "parametric_least", "sampled_fit", "slab_directions"]

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
    cls: type[Bounder],
    grid: IndicatorGrid,
    domain: RegionDomain,
    positives: np.ndarray,
    *,
    k: int | None = None,
    device: str | None = None,
) -> Bounder:
    """A volume of one of the classic methods around all positive regions.

    Args:
        cls: A ``SlabBounder`` or a ``QuadricBounder``.
        grid: The object.
        domain: ``domain_of(grid, query, length, "parametric")``.
        positives: ``(N, 2 n)`` float64, ``v`` of sampled positive queries; they give the shape, not the size.
        k: Half-spaces, kdop; 8 n if ``None``.
        device: Warp device.

    Returns:
        The bounder; ``prove`` sets its threshold.

    Raises:
        BounderError: If the method has no volume in parametric space, or there are no positives.
    """
    if domain.space != "parametric" or domain.query == "point":
        raise BounderError(f"{cls.method}: expected a region's domain in parametric space")
    positives = np.asarray(positives, dtype=np.float64)
    if positives.ndim != 2 or positives.shape[1] != domain.ndim or len(positives) == 0:
        raise BounderError(f"{cls.method}: positives must have shape (N, {domain.ndim}), got {positives.shape}")
    unit = units(domain)
    if issubclass(cls, SlabBounder):
        return _fit_slabs(cls, grid, domain, slab_directions(cls.method, positives / unit, k) / unit, device)
    if issubclass(cls, QuadricBounder):
        matrix, center = _enclosing(positives / unit, cls.family)
        offset = (-matrix @ center).astype(np.float32)
        local = matrix / unit
        tensors = {"matrix": (local if cls.family == "determinant" else np.diag(local)).astype(np.float32)}
        return cls(domain, tensors | {"offset": offset}, {}, device)
    raise BounderError(f"{cls.method}: there is no such volume in parametric space")


def slab_directions(method: str, q: np.ndarray, k: int | None = None) -> np.ndarray:
    """Slab normals in a query's own units.

    Args:
        method: ``"aabb"``, ``"obb"`` (principal axes of the samples) or ``"kdop"``.
        q: ``(N, m)`` samples.
        k: Half-spaces, kdop.

    Returns:
        ``(slabs, m)`` float64.
    """
    if method == "obb":
        return np.linalg.eigh(np.cov(q.T, ddof=0))[1].T
    return kdop_directions(q.shape[1], k) if method == "kdop" else np.eye(q.shape[1])


def _fit_slabs(cls, grid: IndicatorGrid, domain: RegionDomain, directions: np.ndarray, device) -> SlabBounder:
    local = directions.astype(np.float32)
    tensors = {} if cls.diagonal else {"directions": local}
    normals = np.eye(domain.ndim) if cls.diagonal else local.astype(np.float64)
    support = ParametricSupport(grid, domain)(np.concatenate([normals, -normals]))
    high, low = support[: len(normals)], -support[len(normals) :]
    tight = cls(domain, tensors | {"low": round_down(low), "high": round_up(high)}, {}, device)
    room = 2 * tight.rounding_bound()  # so that the threshold comes out at about zero
    return cls(domain, tensors | {"low": round_down(low - room), "high": round_up(high + room)}, {}, device)


def parametric_least(bounder: Bounder, grid: IndicatorGrid) -> tuple[float, int]:
    """``Bounder.least`` for slabs and ellipsoids in parametric space.

    Args:
        bounder: A ``SlabBounder`` or ``QuadricBounder``.
        grid: The object.

    Returns:
        Certified lower bound of f over P, and the number of functionals that were bounded.
    """
    support = ParametricSupport(grid, bounder.domain)
    if isinstance(bounder, QuadricBounder):
        return -support.square(bounder.matrix, bounder.tensors["offset"].astype(np.float64)), 1
    normals = bounder.directions
    reach = support(np.concatenate([normals, -normals]))
    high, low = (bounder.tensors[name].astype(np.float64) for name in ("high", "low"))
    slack = np.concatenate([high - reach[: len(high)], -low - reach[len(high) :]])
    return float(np.nextafter(slack.min(), -np.inf)), len(reach)


def sampled_fit(method: str, q: np.ndarray, k: int | None = None):
    """The paper's own fit: a volume around samples, with nothing proven of it.

    Args:
        method: ``"aabb"``, ``"obb"`` or ``"kdop"``.
        q: ``(N, m)`` positive queries in their own units (points too).
        k: Half-spaces, kdop. By default the m axes and the m normals "all ones but one" as in the paper, whatever m is.

    Returns:
        A function from ``(M, m)`` queries to ``(M,)`` bool: inside the volume.
    """
    q = np.asarray(q, dtype=np.float64)
    m = q.shape[1]
    paper = np.concatenate([np.eye(m), 1 - np.eye(m)])
    normals = paper if method == "kdop" and k is None else slab_directions(method, q, k)
    projected = q @ normals.T
    low, high = projected.min(axis=0), projected.max(axis=0)

    def inside(x: np.ndarray) -> np.ndarray:
        y = np.asarray(x, dtype=np.float64) @ normals.T
        return ((y >= low) & (y <= high)).all(axis=1)

    return inside


def _enclosing(points: np.ndarray, family: str) -> tuple[np.ndarray, np.ndarray]:
    """A small ``{x: |A (x - center)| <= 1}`` of a family (see ``enclosing``) around points: multiplicative updates of weights."""
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
