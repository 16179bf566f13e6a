"""A volume in the space of a region's own numbers, around all positives: fitted as in the paper's code, asked in float64.

The paper fits a volume to the parameters of 20,000 positive regions. Its form is taken from such samples here too (axes, principal axes,
an enclosing ellipsoid); faces and radius are then set by bounds of the set of all positives (``supports``), so that the volume has no
false negative beyond the samples either. Statistics of the samples are computed in a query's own units, as in the paper's code.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from paper.parametric.supports import ParametricSupport, directed, limit_of, to_local, v_per_unit
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.ellipsoids import QuadricBounder
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.evaluation import Rates, counted, truth_by
from warp_bounding.geometry import enclosing_of_points
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import RegionDomain, domain_of

__all__ = ["ParametricVolume", "fit", "rates"]

SAMPLES = 20_000  # queries that a volume's form follows from


@dataclass(frozen=True)
class ParametricVolume:
    """``low <= D v <= high``, or ``|A v + b|^2 <= high``; v are a region's numbers (``supports.to_local``).

    Attributes:
        domain: Of the kind of region.
        matrix: D ``(k, 2 n)``, or A.
        low: ``(k,)``; minus infinity for half-spaces without another side. ``None`` of an ellipsoid.
        high: ``(k,)``, or a number.
        offset: b; ``None`` of faces.
        numbers: How many numbers a query reads of the volume.
        seconds: What the fit took, where it is learned.
    """

    domain: RegionDomain
    matrix: np.ndarray
    low: np.ndarray | None
    high: np.ndarray | float
    offset: np.ndarray | None
    numbers: int

    certificate = None

    def query(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, *maybe*, of regions that begin in the domain; a plane whose point is outside of it is *maybe*."""
        v = to_local(self.domain, q)
        beyond = (np.abs(v) > limit_of(self.domain)).any(axis=1) if directed(self.domain)[0] else False
        if self.offset is not None:
            y = v @ self.matrix.T + self.offset
            return ((y * y).sum(axis=1) <= self.high) | beyond
        y = v @ self.matrix.T
        return ((y >= self.low) & (y <= self.high)).all(axis=1) | beyond

    @property
    def nbytes(self) -> int:
        """Bytes that a query reads: the map to v, a threshold, and the volume."""
        own = 0 if self.domain.query == "box" else self.domain.space_ndim
        return 4 * (3 * self.domain.space_ndim + 1 + own + int(self.domain.time) + self.numbers)


def fit(
    grid: IndicatorGrid,
    query: str,
    method: str,
    *,
    length: float = 1.0,
    seed: int = 0,
    seconds: float = 10.0,
    steps: int | None = None,
) -> ParametricVolume:
    """The volume of a method around the numbers of all regions of a kind that meet a grid.

    Args:
        grid: The object.
        query: Kind of region.
        method: Of a volume: ``aabb``, ``obb``, ``kdop``, ``sphere``, ``ellipsoid``, ``oriented-ellipsoid``, ``learned-kdop``.
        length: Of rays.
        seed: Of the samples, and of training.
        seconds: For training.
        steps: Of training, instead of seconds.
    """
    domain, cls = domain_of(grid, query, length), METHODS[method]
    support, scale = ParametricSupport(grid, domain), v_per_unit(domain)
    if issubclass(cls, LearnedKdop):
        from paper.parametric.learned import learned_normals  # imports torch

        normals = learned_normals(grid, domain, support, seed=seed, seconds=seconds, steps=steps)
        return ParametricVolume(
            domain, normals, np.full(len(normals), -np.inf), support(normals), None, normals.size + len(normals)
        )
    samples = to_local(domain, _positives(grid, query, domain.oracle_length, seed)) / scale
    if issubclass(cls, QuadricBounder):
        matrix, center = enclosing_of_points(samples, cls.family)
        matrix, offset = matrix / scale, -matrix @ center
        numbers = len(offset) + (len(offset) if cls.diagonal else matrix.size)
        return ParametricVolume(domain, matrix, None, support.square(matrix, offset), offset, numbers)
    directions = np.eye(len(scale)) if cls.diagonal else cls.sampled_directions(samples) / scale
    low, high = -support(-directions), support(directions)
    return ParametricVolume(
        domain, directions, low, high, None, 2 * len(low) + (0 if cls.diagonal else directions.size)
    )


def rates(
    volume: ParametricVolume,
    grid: IndicatorGrid,
    samples: int,
    protocol: str,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
    device: Any = "cpu",
) -> Rates:
    """False positives and false negatives of random queries: the very queries that ``evaluate`` asks."""
    query, length, rng = volume.domain.query, volume.domain.oracle_length, np.random.default_rng(seed)
    return counted(
        lambda count: sample(query, grid, count, rng),
        truth_by(protocol, query, grid, device, length, seed),
        volume.query,
        int(samples),
        progress,
        protocol=protocol,
        seed=int(seed),
        truth="cells",
        indicator=grid.digest,
    )


def _positives(grid: IndicatorGrid, query: str, length: float, seed: int) -> np.ndarray:
    """Random positives; where they are rare, hard ones stand in."""
    x = sample(query, grid, SAMPLES, np.random.default_rng(seed))
    found = x[oracle(query, grid, "cpu", length)(x)]
    return found if len(found) > 1 else next(draw_positives(query, grid, SAMPLES, seed, "cpu", length, outside=False))
