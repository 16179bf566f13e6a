"""Parts that were made in domains of their own: how v of the whole becomes v of a part, and what that rounds.

A network may bound a mesh itself, and a hierarchy the cells of the same mesh: two boxes, two maps to v. The whole has
one of them, and ``ratio`` and ``shift`` lead from its v to that of a part. The proof of the part covers that its v is
off by up to its ``delta``, so nothing has to be proven anew if the whole allows itself an error that is small enough:
less than its own map needs, ``common_domain`` refuses, and so does ``moves_of`` for what is read from a file.

A part of fewer coordinates is asked about the first ones: what it bounds depends on no others.

What this does not do: regions, whose v are no points; and the complement of an object, which has no end.
"""

from dataclasses import dataclass, replace

import numpy as np

from warp_bounding.arithmetic import TINY, UNIT32, round_down
from warp_bounding.coordinates.domain import GROWTH, Domain
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.errors import BounderError

__all__ = ["Moves", "common_domain", "moves_of"]

ROUNDINGS = 4.0  # times UNIT32: ratio, shift, their product and the sum, each of them once


@dataclass(frozen=True)
class Moves:
    """How v of the whole becomes v of each part: ``v ratio + shift``, cut at ``limit``, where no positive is cut.

    Attributes:
        ratio: ``(parts, n)`` float32.
        shift: ``(parts, n)`` float32.
        limit: ``(parts, n)`` float32, of the part's domain: its numbers are defined, and its rounding is bounded, up to there.
        error: ``(parts, n)`` float64: by how much v of a part is off at most, beside what v of the whole is off.
    """

    ratio: np.ndarray
    shift: np.ndarray
    limit: np.ndarray
    error: np.ndarray

    @property
    def numbers(self) -> np.ndarray:
        """``(parts, 3 n)`` float32: what a kernel reads of each."""
        return np.concatenate([self.ratio, self.shift, self.limit], axis=1)

    def of(self, part: int, v: np.ndarray) -> np.ndarray:
        """Coordinates v of a part, ``(N, n)`` float64, without rounding but for that of ratio and shift; those that it has are the first."""
        limit = self.limit[part].astype(np.float64)
        return np.clip(v * self.ratio[part].astype(np.float64) + self.shift[part], -limit, limit)


def _maps(whole: Domain, part: Domain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ratio and shift from v of the whole to v of a part, and the error of the evaluated map, all ``(n,)`` float64; of coordinates that a part has not, those that change nothing."""
    k, (ratio, shift) = part.ndim, (np.full(whole.ndim, x) for x in (1.0, 0.0))
    scale = part.scale.astype(np.float64)
    ratio[:k] = scale / whole.scale[:k]
    shift[:k] = (whole.center[:k].astype(np.float64) - part.center) * scale
    largest = np.maximum(whole.limit, 1.0) * ratio + np.abs(shift)
    error = ROUNDINGS * (UNIT32 * largest + TINY) * GROWTH
    return ratio, shift, np.where((ratio == 1) & (shift == 0), 0.0, error)


def _fits(whole: Domain, part: Domain) -> bool:
    """Whether a domain may be that of a part: of the first coordinates, with time where the whole has it, and its joints."""
    joints = None if whole.joints is None else whole.joints.first(part.ndim)
    return part.ndim <= whole.ndim and part.time == whole.time and part.joints == joints


def common_domain(domain: Domain, others: list[Domain]) -> Domain:
    """A domain in which parts of other domains can be asked, too: that of one part, with less room for rounding.

    Args:
        domain: Whose box and map are taken; it holds the object.
        others: Those of the other parts, each of which holds what its part bounds, and has no more coordinates.

    Raises:
        BounderError: If these are no domains of points of one kind, or float32 is too coarse.
    """
    for other in (domain, *others):
        if not isinstance(other, Domain) or other.unbounded:
            raise BounderError("expected bounders of the same queries and domain, or of points of one bounded object")
        if not _fits(domain, other):
            raise BounderError(f"expected the same dimension, got {other.ndim} and {domain.ndim}")
    delta, limit = domain.delta.copy(), domain.limit.copy()
    for other in others:
        ratio, shift, error = _maps(domain, other)
        k = other.ndim
        delta[:k] = np.minimum(delta[:k], (other.delta / GROWTH - error[:k]) / ratio[:k])
        if domain.time:  # beyond the limit of a part's times it has no answer
            room = float(other.limit[0]) - abs(shift[0]) - 2 * error[0]
            limit[0] = min(limit[0], round_down(room / ratio[0] / GROWTH))
    common = replace(domain, delta=delta, limit=limit)
    if fault := common.fault():
        raise BounderError(f"domains are too different for float32: {fault}")
    return common


def moves_of(whole: AnyDomain, parts: list[AnyDomain]) -> Moves | None:
    """How parts are asked; ``None`` where all have the whole's own coordinates.

    Raises:
        BounderError: If the proof of a part does not cover what its v is off by.
    """
    if all(part is whole for part in parts):
        return None
    rows = []
    for part in parts:
        if part is whole:
            rows.append((np.ones(whole.ndim), np.zeros(whole.ndim), whole.limit, np.zeros(whole.ndim)))
            continue
        if not isinstance(whole, Domain) or not isinstance(part, Domain) or whole.unbounded or part.unbounded:
            raise BounderError("only parts of points of a bounded object may have domains of their own")
        if not _fits(whole, part):
            raise BounderError(f"expected parts of {whole.ndim} coordinates, got a domain of {part.ndim}")
        ratio, shift, error = _maps(whole, part)
        if not ((ratio * whole.delta + error)[: part.ndim] <= part.delta).all():
            raise BounderError("the proof of a part does not cover the rounding of its coordinates")
        if whole.time and not whole.limit[0] * ratio[0] + abs(shift[0]) + error[0] <= part.limit[0]:
            raise BounderError("the whole has answers at times at which a part has none")
        rows.append((ratio, shift, np.append(part.limit, whole.limit[part.ndim :]), error))
    ratio, shift, limit, error = (np.array(column) for column in zip(*rows, strict=True))
    if (ratio == 1).all() and (shift == 0).all() and (limit >= whole.limit).all():
        return None
    return Moves(*(each.astype(np.float32) for each in (ratio, shift, limit)), error)
