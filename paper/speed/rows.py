"""One line of the table of speeds, and what all lines have in common."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from paper.columns import SPACES, Column, Variant
from paper.rows import Line
from paper.settings import Settings, Stored, parse_budget
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.version import __version__

__all__ = ["GENERATED", "QUICK", "SHAPES", "SpeedKey", "SpeedRow", "SpeedSettings"]

SpeedKey = tuple[int, str, str, str, str, int | None, str]
GENERATED = "generated"
SHAPES = ("data", GENERATED)  # where objects come from


class Quick(NamedTuple):
    """What ``--quick`` stands for, where no other value is given."""

    budget: str
    queries: int
    rounds: int
    samples: int


# Twelve columns of all of the paper's methods in under five minutes on two cores, their kernels being compiled.
QUICK = Quick("2,relu-field=1,learned-kdop=1", 200_000, 5, 50_000)


@dataclass(frozen=True)
class SpeedSettings(Stored):
    """Of ``speed``."""

    queries: int = 2_000_000  # asked at a time
    rounds: int = 9  # in which every method is asked once, in turn
    samples: int = 400_000  # random queries that false positives are measured on
    budget: float = 20.0  # seconds for a learned fit
    budgets: str = ""  # others for some columns or methods (``settings.parse_budget``)
    seed: int = 0  # of a fit; the queries have the next ones
    length: float = 1.0  # of a ray
    shapes: str = SHAPES[0]
    library: str = __version__  # version of warp-bounding

    POSITIVE = ("budget", "length")
    COUNTS = ("queries", "rounds", "samples")

    def check(self) -> None:
        super().check()
        parse_budget(",".join(filter(None, (f"{self.budget:g}", self.budgets))))
        if not 0 <= self.seed < 2**63 - 2:
            raise BounderError(f"seed must be a whole number from 0 to 2^63 - 3, got {self.seed}")
        if self.shapes not in SHAPES:
            raise BounderError(f"shapes must be one of {', '.join(SHAPES)}, got {self.shapes!r}")

    def of_row(self, column: Column, variant: Variant) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in ("queries", "rounds", "samples", "seed", "length")}
        return own | {"budget": self.fits.budget_of(column, variant)}

    @property
    def fits(self) -> Settings:
        """Those of the fits."""
        about = ("samples", "budget", "budgets", "seed", "length")
        return Settings(**{name: getattr(self, name) for name in about})


@dataclass(frozen=True)
class SpeedRow(Line):
    """A bounder of one object, raced on one device against the reference, in the same rounds."""

    space: str  # ``geometric`` or ``parametric``
    leaves: int | None  # of a hierarchy, where a number was asked for
    device: str  # Warp device
    device_name: str  # what it is
    ns: float  # nanoseconds a query, the median over rounds
    ratio: float  # its time over the reference's in the same round, the median
    ratio_low: float  # the least of these
    ratio_high: float  # the largest
    reference: str  # method that it was raced against
    fp_rate: float  # false positives, per cent of all samples, exact truth
    fn: int  # false negatives, a count
    positives: float  # per cent of all samples
    certificate: str  # its kind, or empty where there is none
    nbytes: int  # memory of the bounder
    fit_seconds: float | None  # of the fit, its proof included; ``None`` where it is not known any more
    budget: float  # seconds for a learned fit
    queries: int  # asked at a time
    rounds: int  # number of rounds
    samples: int  # random queries that rates are measured on
    seed: int  # of the fit
    length: float  # of a ray
    threads: int  # CPU threads
    indicator: str  # start of the SHA-256 of the object's cells
    versions: str  # of what did it

    COMMAND, SETTINGS = "speed", SpeedSettings
    PICTURES = ("early_out.png", "early_out.svg", "speed.json")
    WORDS: ClassVar = {"space": SPACES}

    @property
    def variant(self) -> Variant:
        row = Variant(self.method, self.leaves)
        return row._replace(parametric=row.in_both_spaces and self.space == "parametric")

    @property
    def key(self) -> SpeedKey:
        return self.dimension, self.object, self.query, self.method, self.space, self.leaves, self.device

    def check(self) -> None:
        super().check()
        if self.fp_rate > 100:
            raise FileFormatError(f"fp_rate must be at most 100 per cent, got {self.fp_rate}")
        if not (self.ns > 0 and self.ratio > 0):
            raise FileFormatError(f"times must be positive, got {self.ns} ns and a ratio of {self.ratio}")
