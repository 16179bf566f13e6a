"""A shape as the union of others, its pieces, each of which may be bounded by itself: how they are named, and what a union of them is called.

Pieces have numbers. A digest follows from that of the whole and the numbers alone, so that bounders of pieces can be put
together without the shape, and nobody can take one piece for another.
"""

import hashlib
from collections.abc import Iterable
from typing import Any, NamedTuple

from warp_bounding.errors import IndicatorError

__all__ = ["Pieces"]

MOST = 4096


class Pieces(NamedTuple):
    """Some pieces of a whole.

    Attributes:
        whole: Digest of the whole.
        count: How many pieces it has.
        held: Numbers of these, in order, from 0 on.
    """

    whole: str
    count: int
    held: tuple[int, ...]

    @classmethod
    def of(cls, whole: str, count: int, held: Iterable[int], name: str = "pieces") -> "Pieces":
        """Checked.

        Raises:
            IndicatorError: For numbers of no pieces, or none at all.
        """
        numbers = list(held)
        fine = all(isinstance(n, int) and not isinstance(n, bool) and 0 <= n < count for n in numbers)
        if not numbers or not fine:
            raise IndicatorError(f"{name}: expected some of the pieces 0 to {count - 1}, got {numbers}")
        return cls(whole, count, tuple(sorted(set(numbers))))

    @property
    def all(self) -> bool:
        """Whether nothing of the whole is missing."""
        return len(self.held) == self.count

    @property
    def digest(self) -> str:
        """That of the union; the whole's own where nothing is missing."""
        told = f"pieces {' '.join(map(str, self.held))} of {self.count} of {self.whole}"
        return self.whole if self.all else hashlib.sha256(told.encode()).hexdigest()

    def joined(self, other: "Pieces") -> "Pieces":
        """The union with other pieces of the same whole."""
        return self._replace(held=tuple(sorted({*self.held, *other.held})))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {"whole": self.whole, "count": self.count, "held": list(self.held)}

    @classmethod
    def from_dict(cls, values: Any) -> "Pieces":
        """Inverse of ``to_dict``; raises ``ValueError`` for anything else."""
        try:
            whole, count, held = values["whole"], values["count"], values["held"]
            if not isinstance(whole, str) or type(count) is not int or not 1 <= count <= MOST:
                raise ValueError(f"{values!r} are no pieces of a shape")
            return cls.of(whole, count, held)
        except (TypeError, KeyError, IndicatorError) as error:
            raise ValueError(f"{values!r} are no pieces of a shape ({error})") from error
