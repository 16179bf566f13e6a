"""Labelled queries for training: one file a kind of query, found by its name."""

import torch

from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.training.samples.base import Samples
from warp_bounding.training.samples.box import BoxSamples
from warp_bounding.training.samples.point import PointSamples
from warp_bounding.training.samples.ray import RaySamples
from warp_bounding.training.samples.shape_point import ShapePointSamples

__all__ = ["SAMPLES", "SHAPE_SAMPLES", "samples_of"]

# of grids, and of shapes without cells
SAMPLES: dict[str, type[Samples]] = {kind.query: kind for kind in (PointSamples, RaySamples, BoxSamples)}
SHAPE_SAMPLES: dict[str, type[Samples]] = SAMPLES | {ShapePointSamples.query: ShapePointSamples}


def samples_of(shape: Shape, domain: Domain | RegionDomain, seed: int = 0) -> Samples:
    """The samples of a domain's kind of query; the seed is that of the trainer that takes them, too.

    Raises:
        BounderError: For a kind of query that networks are not trained for.
    """
    if domain.query not in SAMPLES:
        raise BounderError(f"training knows {', '.join(SAMPLES)}, got {domain.query}")
    kinds = SAMPLES if isinstance(shape, IndicatorGrid) else SHAPE_SAMPLES
    return kinds[domain.query](shape, domain, torch.Generator().manual_seed(seed))
