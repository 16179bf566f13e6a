"""Bounders that a bounder is made of: what they must share, how its tensors and sizes hold them, how they are read back.

Tensor ``r`` of member i is the tensor ``i.r`` of the whole; ``sizes["parts"]`` has an entry for each member, its
``method`` and its ``sizes``; and its ``domain``, where that is not the whole's.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.registry import class_named
from warp_bounding.coordinates.domain import Domain
from warp_bounding.errors import BounderError

__all__ = ["BIT_FIELDS", "check_kinds", "check_members", "has_bits", "holding", "members_of", "word_places", "words_of"]

BIT_FIELDS = ("bits", "levels")  # tensors of members that are uint32
Shapes = dict[str, tuple[int, ...]]


def check_kinds(name: str, kinds: Sequence[type[Bounder]]) -> None:
    """Refuse classes that say *no* to positives, with ``BounderError``.

    Args:
        name: Of the whole, for the message.
        kinds: Classes of members.
    """
    if wrong := [kind.method for kind in kinds if not kind.conservative]:
        raise BounderError(f"{name}: {wrong[0]} is not conservative")


def check_members(name: str, members: Sequence[Bounder], *, domains: bool = True) -> None:
    """Refuse what is no conservative bounder of the first one's queries and domain, with ``BounderError``.

    Args:
        name: Of the whole, for the message.
        members: Before they are put together.
        domains: Whether the domain must be the same.
    """
    for member in members:
        if not isinstance(member, Bounder):
            raise BounderError(f"{name}: expected bounders, got {type(member).__name__}")
    check_kinds(name, [type(member) for member in members])
    for member in members if domains else ():
        if member.domain.to_dict() != members[0].domain.to_dict():
            got = f"got {members[0]!r} and {member!r}"
            raise BounderError(f"{name}: expected bounders of the same queries and domain, {got}")


def holding(members: Sequence[Bounder]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Tensors and sizes of a whole that hold its members."""
    tensors = {f"{i}.{role}": value for i, member in enumerate(members) for role, value in member.tensors.items()}
    return tensors, {"parts": [{"method": member.method, "sizes": member.sizes} for member in members]}


def members_of(
    whole: Bounder,
    least: int,
    most: int,
    fits: Callable[[type[Bounder]], bool] = lambda kind: True,
    *,
    own_domains: bool = False,
) -> tuple[list[Bounder], Shapes]:
    """The members that the tensors and sizes of a whole hold, not yet at their thresholds.

    Args:
        whole: Made of them.
        least: How many there are at least.
        most: How many there are at most.
        fits: Whether a class can be a member.
        own_domains: Whether entries may have a ``domain``; else it is not read.

    Returns:
        The members; and the shapes of the tensors that are theirs, by their names in the whole.

    Raises:
        BounderError: If there are more or fewer, or one cannot be a member or is not conservative.
    """
    entries = whole.sizes.get("parts")
    if not isinstance(entries, list) or not least <= len(entries) <= most:
        expected = f"{least} to {most} parts" if least < most else f"a list of parts, {least} of them"
        got = len(entries) if isinstance(entries, list) else repr(entries)
        raise BounderError(f"{whole.method}: expected {expected}, got {got}")
    own: list[dict[str, np.ndarray]] = [{} for _ in entries]
    for name, value in whole.tensors.items():
        number, _, role = name.partition(".")
        if role and number.isdecimal() and str(int(number)) == number and int(number) < len(own):
            own[int(number)][role] = value
    members = []
    for i, (entry, tensors) in enumerate(zip(entries, own, strict=True)):
        kind = class_named(entry.get("method")) if isinstance(entry, dict) else None
        if kind is None or not fits(kind):
            raise BounderError(f"{whole.method}: part {i} is no bounder that can be a part: {entry!r}")
        domain = whole.domain
        if own_domains and "domain" in entry:
            try:
                domain = Domain.from_dict(entry["domain"])
            except (KeyError, TypeError, ValueError) as error:
                raise BounderError(f"{whole.method}: the domain of part {i} is none ({error})") from error
        members.append(kind(domain, tensors, entry["sizes"], whole._device))
    check_kinds(whole.method, [type(member) for member in members])
    return members, {f"{i}.{role}": t.shape for i, tensors in enumerate(own) for role, t in tensors.items()}


def words_of(members: Sequence[Bounder]) -> np.ndarray | None:
    """The words of all members that have a bit field, one behind the other; ``None`` where no member has one."""
    fields = [member.words() for member in members if has_bits(member)]
    return np.concatenate(fields) if fields else None


def word_places(members: Sequence[Bounder]) -> list[int]:
    """For each member, where its own words begin in ``words_of``; 0 where it has none."""
    places, place = [], 0
    for member in members:
        own = len(member.words()) if has_bits(member) else 0
        places.append(place if own else 0)
        place += own
    return places


def has_bits(member: Bounder) -> bool:
    """Whether a member has a bit field, or holds members that do."""
    return any(tensor.dtype == np.uint32 for tensor in member.tensors.values())
