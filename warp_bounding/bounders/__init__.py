"""Bounding volumes: one file a method, in families; ``methods`` lists them, ``register`` adds one from outside."""

from warp_bounding.bounders import methods  # noqa: F401 (registers them)
from warp_bounding.bounders.asking import Prepared
from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.distances import methods as distance_methods  # noqa: F401 (registers them)
from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.bounders.distances.registry import DISTANCES, distance_class, register_distance, unregister_distance
from warp_bounding.bounders.file_format import save
from warp_bounding.bounders.joining import cascade, union, united
from warp_bounding.bounders.load import bounder_of, load
from warp_bounding.bounders.registry import METHODS, method_class, register, supports, unregister
from warp_bounding.bounders.union import Union
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.kernels.functions import Data
from warp_bounding.runtime.compaction import compact

__all__ = [
    "DISTANCES",
    "METHODS",
    "Bounder",
    "Cascade",
    "Certificate",
    "Data",
    "DistanceBounder",
    "Prepared",
    "Union",
    "bounder_of",
    "cascade",
    "compact",
    "distance_class",
    "load",
    "method_class",
    "register",
    "register_distance",
    "save",
    "supports",
    "union",
    "united",
    "unregister",
    "unregister_distance",
]
