"""Queries of the caller's own: false positives are weighed where these lie, and a proof does not care."""

import numpy as np
import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.maps import COORDINATES
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import QueryError
from warp_bounding.indicators.recentred import Frame
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries import QUERIES, oracle
from warp_bounding.training.samples.cell_points import columns

__all__ = ["CALLERS_SHARE", "CallersQueries"]

# Of the samples that stand for what is asked. The others are the protocol's, for what the caller's few queries do not tell of their like.
CALLERS_SHARE = 0.8
MOST = 1 << 20  # queries that are kept, a random choice of more


class CallersQueries:
    """Some queries, labelled by the exact truth.

    Args:
        x: ``(Q, m)`` numbers, object space, of the domain's kind of query.
        shape: What is bounded.
        domain: Of the queries.
        seed: Of the choice where there are too many.
        frame: Whose origin is taken off them.

    Attributes:
        x: ``(Q, m)`` float32.
        positives: Share of them that meet the object.

    Raises:
        QueryError: For another shape, none at all, or numbers that mean nothing.
    """

    def __init__(self, x, shape: Shape, domain: Domain | RegionDomain, seed: int = 0, frame: Frame | None = None):
        shift = 0.0 if frame is None else frame.shift(COORDINATES[domain.query].directed)
        self.x = _checked(x, domain, shift)
        if domain.joints is not None:  # where nothing is known every bounder says maybe
            self.x = domain.joints.turned_back(self.x[domain.joints.within(self.x)]).astype(np.float32)
            if not len(self.x):
                raise QueryError("queries must lie within the limits of joints, got none that does")
        if len(self.x) > MOST:
            self.x = self.x[np.random.default_rng(seed).choice(len(self.x), MOST, replace=False)]
        truth = np.asarray(oracle(domain.query, shape, "cpu", domain.oracle_length)(self.x), dtype=bool)
        self.positives = float(truth.mean())
        v = domain.to_local(self.x[~truth])
        # what lies outside the domain is denied whatever a network says
        self._free = columns(v[(np.abs(v) <= domain.limit).all(axis=1)])

    def negatives(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """``v`` of those among ``count`` random ones of them that are negatives, and can be anything else for a network."""
        free = self._free.shape[1]
        if not free:
            return self._free
        chosen = torch.randint(free, (round(count * free / len(self.x)),), generator=generator)
        return self._free.index_select(1, chosen)

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """``(count, m)`` random ones of them."""
        return self.x[rng.integers(len(self.x), size=count)]


def _checked(x, domain: Domain | RegionDomain, shift: np.ndarray | float) -> np.ndarray:
    try:
        x = np.asarray(x.numpy() if hasattr(x, "numpy") else x)
        x = (x.astype(np.float64) - shift if np.any(shift) and x.ndim == 2 else x).astype(np.float32)
    except (TypeError, ValueError) as error:
        raise QueryError(f"queries must be numbers ({error})") from None
    columns_ = domain.columns
    if x.ndim != 2 or x.shape[1] != columns_ or not len(x):
        raise QueryError(f"queries must be (Q, {columns_}) {domain.query} queries, at least one of them, got {x.shape}")
    bad = int((~QUERIES[domain.query].valid(x)).sum())
    if bad:
        raise QueryError(
            f"queries must all mean something, got {bad:,} of {len(x):,} with NaN, infinity or no direction"
        )
    return np.ascontiguousarray(x)
