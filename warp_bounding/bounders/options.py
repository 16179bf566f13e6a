"""What a method can be told besides its shape and query: each class of bounders lists its ``options``.

``fit`` and the command line read them there. An option that no part of a method takes is refused, never ignored.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.queries import QUERIES

__all__ = ["STEPS", "Option", "one_of", "settled", "taken", "whole"]


@dataclass(frozen=True)
class Option:
    """One thing that a method can be told.

    Attributes:
        name: As ``fit`` takes it, and the command line after two dashes.
        default: The value of an option that is not given. Where it is ``None`` the method decides.
        help: A few words for the command line.
        check: Turns a given value into the one that the method uses; raises ``BounderError`` if it makes no sense.
        parse: Turns the command line's text into a value; raises ``BounderError`` if the text is none.
        queries: Kinds of query that the option is for.
    """

    name: str
    default: Any
    help: str
    check: Callable[[Any], Any] = lambda value: value
    parse: Callable[[str], Any] = str
    queries: tuple[str, ...] = tuple(QUERIES)


def whole(name: str, least: int, most: int | None = None) -> Callable[[Any], int]:
    """A check for whole numbers of at least ``least``, and where there is one, at most ``most``."""
    limits = f"of at least {least}" if most is None else f"from {least} to {most}"

    def check(value: Any) -> int:
        whole_number = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if not whole_number or value < least or (most is not None and value > most):
            raise BounderError(f"{name} must be a whole number {limits}, got {value!r}")
        return int(value)

    return check


def one_of(name: str, names: Iterable[str]) -> Callable[[Any], str]:
    """A check for names."""

    def check(value: Any) -> str:
        if value not in tuple(names):
            raise BounderError(f"{name} must be one of {', '.join(names)}, got {value!r}")
        return value

    return check


_STEPS = "training steps, instead of seconds: repeatable to the bit on a machine"
STEPS = Option("steps", None, _STEPS, whole("steps", 1), int)


def taken(classes: Iterable[type], query: str) -> dict[str, Option]:
    """The options that one of these classes of bounders takes for a kind of query, by name."""
    return {option.name: option for cls in classes for option in cls.options if query in option.queries}


def settled(classes: list[type], query: str, given: dict[str, Any]) -> list[dict[str, Any]]:
    """The value of every option of each class of bounders: as given, else the class's default.

    Raises:
        BounderError: For a wrong value, or an option that none of the classes takes for this kind of query; the message
            names those that are taken.
    """
    known = taken(classes, query)
    if unknown := [name for name in given if name not in known]:
        method = "+".join(cls.method for cls in classes)
        what = ", ".join(known) if known else "no options of its own"
        raise BounderError(f"{method} takes {what} for {query} queries, got {', '.join(unknown)}")
    return [{name: _value(option, given) for name, option in taken([cls], query).items()} for cls in classes]


def _value(option: Option, given: dict[str, Any]) -> Any:
    value = given.get(option.name, option.default)
    return None if value is None and option.default is None else option.check(value)
