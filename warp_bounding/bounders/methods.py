"""The methods of the library, one line each, in the order in which they are listed everywhere."""

from warp_bounding.bounders.bvh.bvh import Bvh
from warp_bounding.bounders.ellipsoids.ellipsoid import Ellipsoid
from warp_bounding.bounders.ellipsoids.oriented_ellipsoid import OrientedEllipsoid
from warp_bounding.bounders.ellipsoids.sphere import Sphere
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.bounders.neural.mlp_early import MlpEarly
from warp_bounding.bounders.neural.monotone_mlp import MonotoneMlp
from warp_bounding.bounders.neural.occupancy import Occupancy
from warp_bounding.bounders.polytopes.learned_kdop import LearnedKdop
from warp_bounding.bounders.registry import register
from warp_bounding.bounders.relu_field.relu_field import ReluField
from warp_bounding.bounders.slabs.aabb import Aabb
from warp_bounding.bounders.slabs.kdop import Kdop
from warp_bounding.bounders.slabs.obb import Obb
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
