"""The methods by name. ``register`` adds one, from inside the package (``methods.py``) or from outside it."""

from collections.abc import Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import TypeVar

from warp_bounding.bounders.base import Bounder
from warp_bounding.errors import BounderError

__all__ = ["METHODS", "class_named", "composed", "method_class", "register", "supports", "unregister"]

_registered: dict[str, type[Bounder]] = {}
METHODS: Mapping[str, type[Bounder]] = MappingProxyType(_registered)  # in the order in which they were registered
Kind = TypeVar("Kind", bound=Bounder)
_composed: dict[str, type[Bounder]] = {}  # classes of bounders that are made of others


def register(kind: type[Kind]) -> type[Kind]:
    """Make a method known by its name to ``fit``, ``load``, cascades and the command line. Also a decorator of a class.

    Args:
        kind: A class of bounders with a ``method`` of its own; see ``Bounder`` for what it supplies.

    Returns:
        The class.

    Raises:
        BounderError: If it is no class of bounders, or another one has its name.
    """
    if not (isinstance(kind, type) and issubclass(kind, Bounder)):
        raise BounderError(f"expected a class of bounders, got {kind!r}")
    name = getattr(kind, "method", None)
    if not isinstance(name, str) or not name or "+" in name or name in _composed:
        others = ", ".join(sorted(_composed))
        raise BounderError(f"{kind.__name__}.method must be a name without +, none of {others}, got {name!r}")
    if _registered.setdefault(name, kind) is not kind:
        raise BounderError(f"method {name} is {_registered[name].__name__} already, got {kind.__name__}")
    return kind


def composed(kind: type[Kind]) -> type[Kind]:
    """Make a class known whose bounders are made of others: files name it, ``fit`` does not take it. A decorator of a class."""
    _composed[kind.method] = kind
    return kind


def class_named(name: str) -> type[Bounder] | None:
    """The class that a file calls by a name, a method's or one of bounders made of others; ``None`` for unknown names."""
    return _registered.get(name) or _composed.get(name)


def unregister(kind: type[Bounder]) -> None:
    """Undo ``register``."""
    if _registered.get(kind.method) is kind:
        del _registered[kind.method]


def method_class(method: str, query: str = "point", ndim: int = 3) -> type[Bounder]:
    """The class of a method that can hold a kind of query.

    Raises:
        BounderError: For an unknown method, or one that cannot hold the query.
    """
    if method not in METHODS:
        near = get_close_matches(str(method), METHODS, n=1)
        meant = f"; did you mean {near[0]!r}?" if near else ""
        known = f"{', '.join(METHODS)}, or a cascade such as 'aabb+mlp'"
        raise BounderError(f"method must be one of {known}, got {method!r}{meant}")
    if not METHODS[method].supports(query, ndim):
        raise BounderError(f"method {method} does not bound {query} queries of {ndim}D objects")
    return METHODS[method]


def supports(method: str, query: str, ndim: int) -> bool:
    """Whether a method can bound a kind of query of an n-dimensional object; ``False`` for unknown methods.

    A cascade such as ``"kdop+mlp"`` can if each of its parts can.
    """
    return all(name in METHODS and METHODS[name].supports(query, ndim) for name in method.split("+"))
