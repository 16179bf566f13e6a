"""Bounding volumes: one file a method; ``register`` adds one from outside."""

from warp_bounding.bounders.batch import Prepared
from warp_bounding.bounders.bounder import DISTANCES, METHODS, Bounder, method_class, register, supports, unregister
from warp_bounding.bounders.bvh import Bvh, BvhDistance
from warp_bounding.bounders.cascade import Cascade, cascade
from warp_bounding.bounders.distance import AabbDistance, DistanceBounder, KdopDistance, ObbDistance
from warp_bounding.bounders.distance_grid import DistanceGrid
from warp_bounding.bounders.ellipsoids import Ellipsoid, OrientedEllipsoid, Sphere
from warp_bounding.bounders.file_format import save
from warp_bounding.bounders.learned_kdop import LearnedKdop, LearnedKdopDistance
from warp_bounding.bounders.load import bounder_of, load
from warp_bounding.bounders.mlp import Mlp, Occupancy
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.bounders.relu_field import ReluField
from warp_bounding.bounders.volumes import Aabb, Kdop, Obb
from warp_bounding.bounders.voxels import Voxels
from warp_bounding.certificates import Certificate
from warp_bounding.kernels.functions import Data
from warp_bounding.runtime.arrays import compact

__all__ = [
    "DISTANCES",
    "METHODS",
    "Bounder",
    "Cascade",
    "Certificate",
    "Data",
    "DistanceBounder",
    "Prepared",
    "bounder_of",
    "cascade",
    "compact",
    "load",
    "method_class",
    "register",
    "save",
    "supports",
    "unregister",
]

# In the order in which they are listed everywhere.
for _method in (
    *(Aabb, Obb, Sphere, Ellipsoid, OrientedEllipsoid, Kdop, Bvh, LearnedKdop, Voxels),
    *(ReluField, Mlp, Occupancy),
    *(AabbDistance, ObbDistance, KdopDistance, BvhDistance, LearnedKdopDistance, DistanceGrid, MlpDistance),
):
    register(_method)
