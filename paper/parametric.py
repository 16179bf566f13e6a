"""The paper's volumes around the *numbers* of regions, in plain NumPy.

In parametric space a ray is the point ``v = (a, w)`` of R^2n, a plane ``(u, a)``, a box ``(low, high)``. As in the
paper's code a volume encloses the positives among 20,000 random regions. Nothing is proven of it: it may deny a
positive that these samples do not show, and tables count that.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from paper.labels import SampledOracle
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.ellipsoids import QuadricBounder
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.volumes import kdop_directions
from warp_bounding.errors import BounderError
from warp_bounding.evaluation import Rates, counted
from warp_bounding.geometry import enclosing_of_points
from warp_bounding.queries import decision, oracle, sample
from warp_bounding.queries.boundary import draw_positives
from warp_bounding.queries.region_domain import RegionDomain, domain_of

SAMPLES = 20_000  # regions of whose positives a volume is made
DIRECTIONS = {"ray": (False, True), "plane": (True, False), "box": (False, False)}  # halves of v without a length


def to_local(domain: RegionDomain, q: np.ndarray) -> np.ndarray:
    """V ``(N, 2 n)`` float64 of regions that begin in the domain: local points, and directions of a ray's length."""
    parts = np.split(np.asarray(q, dtype=np.float64), 2, axis=1)
    for k, turned in enumerate(DIRECTIONS[domain.query]):
        unit = parts[k] / np.linalg.norm(parts[k], axis=1, keepdims=True) if turned else None
        parts[k] = unit * domain.stretch.astype(np.float64) if turned else domain.base.to_local(parts[k])
    return np.concatenate(parts, axis=1)


def numbers_of_domain(domain: RegionDomain, more: int) -> int:
    """Bytes of the map to v, of a threshold, and of so many float32 numbers."""
    own = 0 if domain.query == "box" else domain.space_ndim
    return 4 * (3 * domain.space_ndim + 1 + own + int(domain.time) + more)


@dataclass(frozen=True)
class ParametricVolume:
    """``low <= D v <= high``, or ``|A v + b|^2 <= high``; v are a region's numbers (``to_local``)."""

    domain: RegionDomain
    matrix: np.ndarray  # D ``(k, 2 n)``, or A
    low: np.ndarray | None  # ``(k,)``, minus infinity for half-spaces without another side; ``None`` of an ellipsoid
    high: np.ndarray | float
    offset: np.ndarray | None  # b; ``None`` of faces
    numbers: int  # that a query reads of the volume

    certificate = None

    def query(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, *maybe*, of regions that begin in the domain."""
        y = to_local(self.domain, q) @ self.matrix.T
        if self.offset is not None:
            return ((y + self.offset) ** 2).sum(axis=1) <= self.high
        return ((y >= self.low) & (y <= self.high)).all(axis=1)

    @property
    def nbytes(self) -> int:
        """Bytes that a query reads: the map to v, a threshold, and the volume."""
        return numbers_of_domain(self.domain, self.numbers)


def fit(grid, query, method, *, length=1.0, seed=0, seconds=10.0, steps=None) -> ParametricVolume:
    """The volume of a method around the numbers of positives among random regions of a kind.

    Seed, seconds and steps, instead of seconds, are those of samples and training.
    """
    domain, cls = domain_of(grid, query, length), METHODS[method]
    if query not in DIRECTIONS:
        raise BounderError(f"expected regions, got {query} queries")
    x = sample(query, grid, SAMPLES, np.random.default_rng(seed))
    met = oracle(query, grid, "cpu", domain.oracle_length)(x)
    negatives, x = to_local(domain, x[~met]), x[met]
    if len(x) < 2:  # positives are rare: hard ones stand in
        x = next(draw_positives(query, grid, SAMPLES, seed, "cpu", domain.oracle_length, outside=False))
    v, scales = to_local(domain, x), (domain.base.scale, domain.stretch)
    scale = np.concatenate([scales[turned] for turned in DIRECTIONS[query]]).astype(np.float64)
    samples = v / scale  # in a query's own units, as in the paper's code
    if issubclass(cls, LearnedKdop):
        normals = learned_normals(v, negatives, scale, seed=seed, seconds=seconds, steps=steps)
        low, high = np.full(len(normals), -np.inf), (v @ normals.T).max(axis=0)
        return ParametricVolume(domain, normals, low, high, None, normals.size + len(normals))
    if issubclass(cls, QuadricBounder):
        matrix, center = enclosing_of_points(samples, cls.family)
        matrix, offset = matrix / scale, -matrix @ center
        high = float(((v @ matrix.T + offset) ** 2).sum(axis=1).max())
        numbers = len(offset) + (len(offset) if cls.diagonal else matrix.size)
        return ParametricVolume(domain, matrix, None, high, offset, numbers)
    directions = np.eye(len(scale)) if cls.diagonal else cls.sampled_directions(samples) / scale
    y = v @ directions.T
    numbers = 2 * len(directions) + (0 if cls.diagonal else directions.size)
    return ParametricVolume(domain, directions, y.min(axis=0), y.max(axis=0), None, numbers)


def rates(ask: Callable, query: str, grid: Any, samples: int, protocol: str, *, seed: int, length: float) -> Rates:
    """False positives and false negatives of random queries: the very queries that ``evaluate`` asks.

    ``ask`` tells which queries ``(N, m)`` are *maybe*.
    """
    rng = np.random.default_rng(seed)
    sampled = protocol != "exact"
    truth = SampledOracle(query, grid, "cpu", seed, length) if sampled else decision(query, grid, "cpu", length)
    reported = {"seed": int(seed), "truth": "cells", "indicator": grid.digest}
    return counted(lambda count: sample(query, grid, count, rng), truth, ask, int(samples), None, **reported)


def learned_normals(positives, negatives, scale, *, seed: int, seconds: float, steps: int | None) -> np.ndarray:
    """``(k, 2 n)`` normals, the paper's OurkDOP: of ``kdop``'s and learned ones the best by negatives inside."""
    import torch

    from warp_bounding.training import learned_kdop as train
    from warp_bounding.training.engine import Clock, single_threaded_torch

    class AroundSamples(train.HalfSpaceProblem):
        def __init__(self):
            self.points, self.columns = train.tensor(positives), len(scale)

    problem = AroundSamples()
    v = train.tensor(negatives if len(negatives) else positives[:64])
    clock, generator = Clock(seconds, steps, None), torch.Generator().manual_seed(seed)
    directions = kdop_directions(len(scale)) / scale
    classic, best = np.concatenate([directions, -directions]), []
    start = train.of_length_1(train.tensor(classic))
    with single_threaded_torch():
        for index in range(train.STARTS):
            normals = start + train.JITTER * torch.randn(start.shape, generator=generator)
            normals = problem.start(len(start), generator) if index % 2 == 1 else normals
            best.append((np.inf, start))
            share = ((index + 1) / train.STARTS, index / train.STARTS)
            train.descend(problem, v, train.of_length_1(normals), clock, share, generator, best)
            if clock.fraction() >= 1:
                break
    best.sort(key=lambda pair: pair[0])
    tried = [classic, *(normals.double().numpy() for _, normals in best[: train.FINALISTS])]
    inside = lambda n: float((negatives @ n.T <= (positives @ n.T).max(axis=0)).all(axis=1).mean())  # noqa: E731
    return min(tried, key=inside)
