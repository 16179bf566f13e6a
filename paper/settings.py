"""What all rows of one table have in common. Columns, methods, objects and protocols are selections, not settings.

A budget is the seconds of each learned fit: one number, and others for some columns or methods, as in
``20,3d=40,3d-ray:mlp=240,occupancy=5``. What comes later goes before: of all words that name a fit's column or method, the
last one counts. Presets are such texts, made to measure every object of the paper on two cores in a stated time.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, ClassVar, NamedTuple, TypeVar

from paper.columns import COLUMNS, LEARNED, Column, Variant, columns_named
from warp_bounding.activations import DEFAULT
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.version import __version__

__all__ = ["PRESETS", "Preset", "ProofSettings", "Settings", "Stored", "parse_budget"]

S = TypeVar("S", bound="Stored")


class Preset(NamedTuple):
    """A whole run."""

    budget: str  # as ``--budget`` takes it
    samples: int  # random queries that rates are measured on
    protocol: str  # as ``--protocol`` takes it


PRESETS = {
    "full": Preset(
        "16,2d=12,2d-ray=24,2d-box=14,3d-point=20,3d-ray=50,3d-box=40,4d-point=40,4d-ray=60,4d-box=60,"
        "learned-kdop=5,relu-field=12,occupancy=6,2d-ray:mlp=60,2d-box:mlp=24,3d-box:mlp=90,3d-ray:mlp=120,4d-point:mlp=150,4d-ray:mlp=180,4d-box:mlp=120,4d-box:monotone-mlp=180,"
        "2d:distance=20,3d:distance=90,4d:distance=420",
        400_000,
        "both",
    ),
    "hour": Preset("4,3d=6,4d=12,3d-ray=13,4d-ray=16,learned-kdop=2,relu-field=4,occupancy=2", 100_000, "both"),
}


def parse_budget(text: str) -> tuple[float | None, str]:
    """Read what ``--budget`` takes.

    Returns:
        The number for all others (``None`` if there is none), and the text of the rest, as ``Settings.budgets`` has it.

    Raises:
        BounderError: With the word that makes no sense.
    """
    general, parts = None, []
    for word in (w.strip() for w in text.split(",")):
        name, given, seconds = word.rpartition("=")
        value, name = _seconds(seconds, word), name.strip().lower()
        if not given:
            if general is not None:
                raise BounderError(f"budget must have one number without a name, got {text!r}")
            general = value
        elif not all(columns_named(part) or part in LEARNED for part in name.split(":")):
            raise BounderError(
                f"budget must name columns (3d-ray, 3d, ray), learned methods, or both (3d-ray:mlp), got {word!r}"
            )
        else:
            parts.append(f"{name}={value:g}")
    return general, ",".join(parts)


def _seconds(text: str, word: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise BounderError(f"budget must be positive seconds, such as 60 or 20,3d-ray=60, got {word!r}")
    return value


@dataclass(frozen=True)
class Stored:
    """Settings that a folder keeps, and that every run in it must agree with."""

    FIXED: ClassVar[tuple[str, ...]] = ("library",)  # fields that nobody chooses: this version's
    SINCE: ClassVar[frozenset[str]] = frozenset()  # fields that the first folders did not have
    POSITIVE: ClassVar[tuple[str, ...]] = ()  # numbers that must be finite and above 0
    COUNTS: ClassVar[tuple[str, ...]] = ()  # numbers that must be at least 1

    @classmethod
    def of(cls: type[S], given: Mapping[str, Any], stored: S | None = None) -> S:
        """What was asked for, the rest as stored, or else the defaults.

        Raises:
            BounderError: For a value that makes no sense, or one that is not the stored one, named.
        """
        given = {name: value for name, value in given.items() if value is not None}
        wanted = replace(stored or cls(), **{name: getattr(cls(), name) for name in cls.FIXED}, **given)
        wanted.check()
        if stored is not None and wanted != stored:
            pairs = ((f.name, getattr(stored, f.name), getattr(wanted, f.name)) for f in fields(cls))
            different = "; ".join(f"{name} {old} there, {new} now" for name, old, new in pairs if old != new)
            raise BounderError(f"made with other settings: {different}. Use those, or another folder")
        return wanted

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BounderError: With the rule and the value.
        """
        for name in self.POSITIVE:
            if not 0 < getattr(self, name) < math.inf:
                raise BounderError(f"{name} must be positive, got {getattr(self, name)}")
        for name in self.COUNTS:
            if getattr(self, name) < 1:
                raise BounderError(f"{name} must be at least 1, got {getattr(self, name)}")

    def of_row(self, column: Column, variant: Variant) -> dict[str, Any]:
        """What these settings decide of a row: some of its fields."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    @classmethod
    def from_dict(cls: type[S], values: Any) -> S:
        """Inverse of ``to_dict``.

        Raises:
            FileFormatError: If fields are not those of this version, or of another type.
        """
        names = {f.name for f in fields(cls)}
        if not isinstance(values, dict) or not names - cls.SINCE <= set(values) <= names:
            raise FileFormatError("the settings are not those that this version of warp-bounding writes")
        for name, value in values.items():
            kind = type(getattr(cls(), name))
            if type(value) is not kind and not (kind is float and type(value) is int):
                raise FileFormatError(f"the setting {name} is damaged: {value!r}")
        return cls(**values)


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
    hidden: Any = field(default_factory=lambda: {c.name: list(c.hidden) for c in COLUMNS})  # widths of hidden layers
    library: str = __version__  # version of warp-bounding

    FIXED = ("hidden", "library")
    SINCE = frozenset({"budgets"})
    POSITIVE = ("budget", "length")
    COUNTS = ("samples",)

    def check(self) -> None:
        super().check()
        parse_budget(self.budget_text)
        if not 0 <= self.seed < 2**63 - 1:
            raise BounderError(f"seed must be a whole number from 0 to 2^63 - 2, got {self.seed}")

    def of_row(self, column: Column, variant: Variant) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in ("activation", "samples", "seed", "length", "device")}
        return own | {"budget": self.budget_of(column, variant), "hidden": "-".join(map(str, column.hidden))}

    def budget_of(self, column: Column, variant: Variant) -> float:
        """Seconds for a learned fit; a cascade takes what its last part would, a network of local thresholds what one of one would."""
        seconds, known = self.budget, {variant.method, variant.last}
        known |= set() if variant.of_distances else {variant.fitted.method}
        for word in self.budgets.split(",") if self.budgets else ():
            name, _, value = word.partition("=")
            if all(part in known or column in columns_named(part) for part in name.split(":")):
                seconds = float(value)
        return seconds

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

    POSITIVE = ("seconds",)
    COUNTS = ("positives", "samples")

    def of_row(self, column: Column, variant: Variant) -> dict[str, Any]:
        fits = {"budget": self.fits.budget_of(column, variant), "seed": self.fits.seed}
        return fits | {"samples": self.samples, "seconds": self.seconds}

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
