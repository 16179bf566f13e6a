"""What all rows of one table have in common. Columns, methods, objects and protocols are selections, not settings."""

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from warp_bounding.activations import DEFAULT
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.paper.budgets import budget_of, parse_budget
from warp_bounding.paper.columns import COLUMNS, Column, Variant
from warp_bounding.version import __version__

__all__ = ["Settings", "agree", "read_fields"]


SINCE = {"budgets"}  # not in the first folders


def _sizes() -> dict[str, list[int]]:
    return {c.name: list(c.hidden) for c in COLUMNS}


@dataclass(frozen=True)
class Settings:
    """See module.

    Attributes:
        budget: Seconds for a learned fit.
        budgets: Others for some columns or methods (``parse_budget``).
        samples: Random queries that rates are measured on.
        seed: Of a fit; the samples have the next one, so that none is a training sample.
        length: Of a ray.
        activation: Of a network.
        device: Warp device.
        hidden: Widths of hidden layers by column.
        library: Version of warp-bounding.
    """

    budget: float = 60.0
    budgets: str = ""
    samples: int = 1_000_000
    seed: int = 0
    length: float = 1.0
    activation: str = DEFAULT.name
    device: str = "cpu"
    hidden: Any = None
    library: str = __version__

    @classmethod
    def of(cls, given: Mapping[str, Any], stored: "Settings | None" = None) -> "Settings":
        """What was asked for, the rest as stored, or else the defaults.

        Raises:
            BounderError: For a value that makes no sense, or one that is not the stored one, named.
        """
        given = {name: value for name, value in given.items() if value is not None}
        wanted = replace(stored or cls(), hidden=_sizes(), library=__version__, **given)
        wanted.check()
        return agree(wanted, stored)

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BounderError: With the rule and the value.
        """
        for name in ("budget", "length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise BounderError(f"{name} must be positive, got {value}")
        parse_budget(self.budget_text)
        if self.samples < 1:
            raise BounderError(f"samples must be at least 1, got {self.samples}")
        if not 0 <= self.seed < 2**63 - 1:
            raise BounderError(f"seed must be a whole number from 0 to 2^63 - 2, got {self.seed}")

    def budget_of(self, column: Column, variant: Variant) -> float:
        """Seconds for a learned fit."""
        return budget_of(column, variant, self.budget, self.budgets)

    @property
    def budget_text(self) -> str:
        """All budgets, as ``--budget`` takes them."""
        return ",".join(filter(None, (f"{self.budget:g}", self.budgets)))

    @property
    def sample_seed(self) -> int:
        """Seed of the samples."""
        return self.seed + 1

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Any) -> "Settings":
        """Inverse of ``to_dict``.

        Raises:
            FileFormatError: If fields are not those of this version, or of another type.
        """
        return read_fields(cls(hidden=_sizes()), values, SINCE)


def agree(wanted: Any, stored: Any | None) -> Any:
    """What is wanted, unless it is not what is stored.

    Raises:
        BounderError: With the names and both values of what is not the same.
    """
    if stored is not None and wanted != stored:
        different = (
            f"{n} {getattr(stored, n)} there, {getattr(wanted, n)} now"
            for n in (f.name for f in fields(wanted))
            if getattr(stored, n) != getattr(wanted, n)
        )
        raise BounderError(f"made with other settings: {'; '.join(different)}. Use those, or another folder")
    return wanted


def read_fields(defaults: Any, values: Any, since: Collection[str] = ()) -> Any:
    """Settings, a dataclass like ``defaults``, from what JSON has kept of them.

    Args:
        defaults: Of the same class; their types are expected.
        values: As read.
        since: Fields that may be missing.

    Raises:
        FileFormatError: If fields are not those of this version, or of another type.
    """
    names = {f.name for f in fields(defaults)}
    if not isinstance(values, dict) or not names - set(since) <= set(values) <= names:
        raise FileFormatError("the settings are not those that this version of warp-bounding writes")
    for name, value in values.items():
        kind = type(getattr(defaults, name))
        if type(value) is not kind and not (kind is float and type(value) is int):
            raise FileFormatError(f"the setting {name} is damaged: {value!r}")
    return type(defaults)(**values)
