"""The methods of the library, one line each, in the order in which they are listed everywhere."""

from warp_bounding.bounders.bvh import Bvh
from warp_bounding.bounders.ellipsoids import Ellipsoid, OrientedEllipsoid, Sphere
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.bounders.neural.mlp_early import MlpEarly
from warp_bounding.bounders.neural.monotone_mlp import MonotoneMlp
from warp_bounding.bounders.neural.occupancy import Occupancy
from warp_bounding.bounders.registry import register
from warp_bounding.bounders.relu_field import ReluField
from warp_bounding.bounders.slabs import Aabb, Kdop, Obb
from warp_bounding.bounders.voxels import Voxels

__all__: list[str] = []

register(Aabb)
register(Obb)
register(Sphere)
register(Ellipsoid)
register(OrientedEllipsoid)
register(Kdop)
register(Bvh)
register(LearnedKdop)
register(Voxels)
register(ReluField)
register(Mlp)
register(MlpEarly)
register(MonotoneMlp)
register(Occupancy)
