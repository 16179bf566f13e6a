"""Bounding volumes: one file a method. A new one is a file and a line in ``METHODS``."""

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.bvh.bvh import Bvh
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.ellipsoids.ellipsoid import Ellipsoid
from warp_bounding.bounders.ellipsoids.oriented_ellipsoid import OrientedEllipsoid
from warp_bounding.bounders.ellipsoids.sphere import Sphere
from warp_bounding.bounders.file_format import bounder_of, load, save
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.bounders.neural.mlp_early import MlpEarly
from warp_bounding.bounders.neural.monotone_mlp import MonotoneMlp
from warp_bounding.bounders.neural.occupancy import Occupancy
from warp_bounding.bounders.polytopes.learned_kdop import LearnedKdop
from warp_bounding.bounders.prepared import Prepared
from warp_bounding.bounders.relu_field.relu_field import ReluField
from warp_bounding.bounders.slabs.aabb import Aabb
from warp_bounding.bounders.slabs.kdop import Kdop
from warp_bounding.bounders.slabs.obb import Obb
from warp_bounding.bounders.voxels import Voxels
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import Data
from warp_bounding.runtime.compaction import compact

__all__ = [
    "KINDS",
    "METHODS",
    "Bounder",
    "Cascade",
    "Certificate",
    "Data",
    "Prepared",
    "bounder_of",
    "compact",
    "load",
    "method_class",
    "save",
    "supports",
]

METHODS: dict[str, type[Bounder]] = {
    c.method: c
    for c in (
        *(Aabb, Obb, Sphere, Ellipsoid, OrientedEllipsoid, Kdop, Bvh, LearnedKdop, Voxels),
        *(ReluField, Mlp, MlpEarly, MonotoneMlp, Occupancy),
    )
}
KINDS: dict[str, type[Bounder]] = METHODS | {Cascade.method: Cascade}  # what a file may hold


def method_class(method: str, query: str = "point", ndim: int = 3, space: str = "geometric") -> type[Bounder]:
    """The class of a method that can hold a kind of query.

    Raises:
        BounderError: For an unknown method, or one that cannot hold the query.
    """
    if method not in METHODS:
        raise BounderError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if not METHODS[method].supports(query, ndim, space):
        where = " in parametric space" if space == "parametric" else ""
        raise BounderError(f"method {method} does not bound {query} queries of {ndim}D objects{where}")
    return METHODS[method]


def supports(method: str, query: str, ndim: int, space: str = "geometric") -> bool:
    """Whether a method can bound a kind of query of an n-dimensional object, in a space; ``False`` for unknown methods.

    Of several, as in ``"kdop+mlp"``: whether each can.
    """
    return all(name in METHODS and METHODS[name].supports(query, ndim, space) for name in method.split("+"))
