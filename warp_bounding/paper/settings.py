"""What all rows of one table have in common. Columns, methods, objects and protocols are selections, not settings."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, ClassVar, TypeVar

from warp_bounding.activations import DEFAULT
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.paper.budgets import budget_of, parse_budget
from warp_bounding.paper.columns import COLUMNS, Column, Variant
from warp_bounding.version import __version__

__all__ = ["ProofSettings", "Settings", "Stored"]

S = TypeVar("S", bound="Stored")


@dataclass(frozen=True)
class Stored:
    """Settings that a folder keeps, and that every run in it must agree with."""

    SINCE: ClassVar[frozenset[str]] = frozenset()  # fields that the first folders did not have

    @classmethod
    def of(cls: type[S], given: Mapping[str, Any], stored: S | None = None) -> S:
        """What was asked for, the rest as stored, or else the defaults.

        Raises:
            BounderError: For a value that makes no sense, or one that is not the stored one, named.
        """
        given = {name: value for name, value in given.items() if value is not None}
        wanted = replace(stored or cls(), **cls.fixed(), **given)
        wanted.check()
        if stored is not None and wanted != stored:
            different = (
                f"{f.name} {getattr(stored, f.name)} there, {getattr(wanted, f.name)} now"
                for f in fields(cls)
                if getattr(stored, f.name) != getattr(wanted, f.name)
            )
            raise BounderError(f"made with other settings: {'; '.join(different)}. Use those, or another folder")
        return wanted

    @classmethod
    def fixed(cls) -> dict[str, Any]:
        """Fields that nobody chooses."""
        return {"library": __version__}

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BounderError: With the rule and the value.
        """

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    @classmethod
    def from_dict(cls: type[S], values: Any) -> S:
        """Inverse of ``to_dict``.

        Raises:
            FileFormatError: If fields are not those of this version, or of another type.
        """
        defaults, names = cls(**cls.fixed()), {f.name for f in fields(cls)}
        if not isinstance(values, dict) or not names - cls.SINCE <= set(values) <= names:
            raise FileFormatError("the settings are not those that this version of warp-bounding writes")
        for name, value in values.items():
            kind = type(getattr(defaults, name))
            if type(value) is not kind and not (kind is float and type(value) is int):
                raise FileFormatError(f"the setting {name} is damaged: {value!r}")
        return cls(**values)


def _at_least_1(settings: Stored, *names: str) -> None:
    for name in names:
        if getattr(settings, name) < 1:
            raise BounderError(f"{name} must be at least 1, got {getattr(settings, name)}")


@dataclass(frozen=True)
class Settings(Stored):
    """Of ``table1``."""

    budget: float = 60.0  # seconds for a learned fit
    budgets: str = ""  # others for some columns or methods (``parse_budget``)
    samples: int = 1_000_000  # random queries that rates are measured on
    seed: int = 0  # of a fit; the samples have the next one, so that none is a training sample
    length: float = 1.0  # of a ray
    activation: str = DEFAULT.name  # of a network
    device: str = "cpu"  # Warp device
    hidden: Any = None  # widths of hidden layers by column
    library: str = __version__  # version of warp-bounding

    SINCE = frozenset({"budgets"})

    @classmethod
    def fixed(cls) -> dict[str, Any]:
        return {"hidden": {c.name: list(c.hidden) for c in COLUMNS}, **super().fixed()}

    def check(self) -> None:
        for name in ("budget", "length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise BounderError(f"{name} must be positive, got {value}")
        parse_budget(self.budget_text)
        _at_least_1(self, "samples")
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

    @property
    def fits(self) -> "Settings":
        """Those of the fits: itself."""
        return self


@dataclass(frozen=True)
class ProofSettings(Stored):
    """Of ``proofs``."""

    positives: int = 1_000_000  # hard positives that a threshold is sampled from
    samples: int = 400_000  # random queries that rates are measured on
    seconds: float = 60.0  # time for each proof
    table: dict[str, Any] = field(default_factory=dict)  # settings of the table whose networks these are
    library: str = __version__  # version of warp-bounding

    def check(self) -> None:
        _at_least_1(self, "positives", "samples")
        if not 0 < self.seconds < float("inf"):
            raise BounderError(f"seconds must be positive, got {self.seconds}")

    @property
    def fits(self) -> Settings:
        """Settings of the table."""
        return Settings.from_dict(self.table)

    @property
    def positives_seed(self) -> int:
        """Seed of the hard positives: not that of any fit or certificate."""
        return self.fits.seed + 424_243

    @classmethod
    def from_dict(cls, values: Any) -> "ProofSettings":
        settings = super().from_dict(values)
        Settings.from_dict(settings.table)
        return settings
