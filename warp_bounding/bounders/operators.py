"""``a & b`` and ``a | b`` of bounders."""

from collections.abc import Callable
from typing import Any

__all__ = ["JOINED", "Operators"]

JOINED: dict[str, Callable[[Any, Any], Any]] = {}  # what they make, by sign; ``joining``, above all classes, says so


class Operators:
    """The operators of a ``Bounder``."""

    def __and__(self, other: Any) -> Any:
        """``a & b``: *maybe* iff both say so, a asked first; a ``cascade``, or a composition where one is part of it."""
        return JOINED["&"](self, other) if isinstance(other, Operators) else NotImplemented

    def __or__(self, other: Any) -> Any:
        """``a | b``: *maybe* iff one of them says so, a asked first; see ``either``."""
        return JOINED["|"](self, other) if isinstance(other, Operators) else NotImplemented
