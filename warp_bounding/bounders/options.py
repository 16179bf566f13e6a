"""What a method can be told besides its shape and query: each class of bounders lists its ``options``.

``fit`` and the command line read them there. An option that no part of a method takes is refused, never ignored.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import Parameter, signature
from typing import Any

import numpy as np

from warp_bounding.errors import BounderError
from warp_bounding.queries import QUERIES

__all__ = ["STEPS", "Option", "arguments_of", "meant", "one_of", "settled", "taken", "unknown_option", "whole"]

ALIKE = 0.7  # least similarity, as ``difflib`` has it, of a name and the one that is suggested in its place


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


def arguments_of(function: Callable) -> list[str]:
    """The names of a function's own arguments."""
    return [p.name for p in signature(function).parameters.values() if p.kind != Parameter.VAR_KEYWORD]


def meant(name: str, known: Iterable[str]) -> str | None:
    """The name among those known that was probably meant; ``None`` where none is alike."""
    return next(iter(get_close_matches(name, list(known), 1, ALIKE)), None)


def unknown_option(name: str, method: str, known: Iterable[str], asked: str, callers: Iterable[Callable] = ()) -> str:
    """What to say of an option that a method does not take: which one was probably meant, and which ones there are.

    Args:
        name: As it was given.
        method: Who does not take it.
        known: Names of the options that the method takes.
        asked: What it bounds then, such as ``"point queries"``.
        callers: Functions that hand options on to the method: their own arguments may have been meant.
    """
    callers, known = list(callers), list(known)
    near = meant(name, [*known, *(own for caller in callers for own in arguments_of(caller))])
    beside = f"beside the arguments of {' and '.join(caller.__name__ for caller in callers)}, " if callers else ""
    takes = f"{beside}{method} takes {', '.join(known) or 'no options of its own'} for {asked}"
    if near is None:
        return f"{method} takes no option {name!r}; {takes}"
    return f"there is no option {name!r}; did you mean {near!r}? {takes[0].upper() + takes[1:] if beside else takes}"


def settled(
    classes: list[type], query: str, given: dict[str, Any], callers: Iterable[Callable] = ()
) -> list[dict[str, Any]]:
    """The value of every option of each class of bounders: as given, else the class's default.

    Args:
        classes: Of bounders.
        query: Kind of query.
        given: Options by name.
        callers: Functions that hand on the options, for the message of an unknown one.

    Raises:
        BounderError: For a wrong value, or an option that none of the classes takes for this kind of query; the message
            names those that are taken.
    """
    known = taken(classes, query)
    if unknown := [name for name in given if name not in known]:
        method = "+".join(cls.method for cls in classes)
        raise BounderError(unknown_option(unknown[0], method, known, f"{query} queries", callers))
    return [{name: _value(option, given) for name, option in taken([cls], query).items()} for cls in classes]


def _value(option: Option, given: dict[str, Any]) -> Any:
    value = given.get(option.name, option.default)
    return None if value is None and option.default is None else option.check(value)
