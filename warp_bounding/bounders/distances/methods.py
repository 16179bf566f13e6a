"""The distances of the library, one line each, in the order in which they are listed everywhere."""

from warp_bounding.bounders.distances.boxes import BvhDistance
from warp_bounding.bounders.distances.ellipsoids import EllipsoidDistance, OrientedEllipsoidDistance, SphereDistance
from warp_bounding.bounders.distances.faces import AabbDistance, KdopDistance, LearnedKdopDistance, ObbDistance
from warp_bounding.bounders.distances.grid import DistanceGrid
from warp_bounding.bounders.distances.mlp import MlpDistance
from warp_bounding.bounders.distances.registry import register_distance

__all__: list[str] = []

register_distance(AabbDistance)
register_distance(ObbDistance)
register_distance(SphereDistance)
register_distance(EllipsoidDistance)
register_distance(OrientedEllipsoidDistance)
register_distance(KdopDistance)
register_distance(BvhDistance)
register_distance(LearnedKdopDistance)
register_distance(DistanceGrid)
register_distance(MlpDistance)
