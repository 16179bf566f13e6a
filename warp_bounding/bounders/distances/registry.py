"""The methods that have a distance, by name; the names are those of ``METHODS`` where the volume is the same."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeVar

from warp_bounding.bounders.distances.base import DistanceBounder
from warp_bounding.errors import BounderError

__all__ = ["DISTANCES", "distance_class", "register_distance", "unregister_distance"]

_registered: dict[str, type[DistanceBounder]] = {}
DISTANCES: Mapping[str, type[DistanceBounder]] = MappingProxyType(
    _registered
)  # in the order in which they were registered
Kind = TypeVar("Kind", bound=DistanceBounder)


def register_distance(kind: type[Kind]) -> type[Kind]:
    """Make a method's distance known to ``fit``, ``load`` and the command line. Also a decorator of a class.

    Raises:
        BounderError: If it is no class of distance bounders, or another one has its name.
    """
    if not (isinstance(kind, type) and issubclass(kind, DistanceBounder)) or not isinstance(
        getattr(kind, "method", None), str
    ):
        raise BounderError(f"expected a class of distance bounders with a method, got {kind!r}")
    if _registered.setdefault(kind.method, kind) is not kind:
        raise BounderError(
            f"distance {kind.method} is {_registered[kind.method].__name__} already, got {kind.__name__}"
        )
    return kind


def unregister_distance(kind: type[DistanceBounder]) -> None:
    """Undo ``register_distance``."""
    if _registered.get(kind.method) is kind:
        del _registered[kind.method]


def distance_class(method: str, ndim: int | None = None) -> type[DistanceBounder]:
    """The class of a method's distance.

    Args:
        method: Its name.
        ndim: Dimensions of the object, where they are known.

    Raises:
        BounderError: For a method that has none, or not in n dimensions.
    """
    if method not in DISTANCES:
        raise BounderError(f"method of a distance must be one of {', '.join(DISTANCES)}, got {method!r}")
    if ndim is not None and not DISTANCES[method].supports(ndim):
        raise BounderError(f"method {method} has no distance of {ndim}D objects")
    return DISTANCES[method]
