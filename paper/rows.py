"""One line of a table: what was measured of one bounder, and everything that it depends on; and the files that hold such lines."""

import csv
import io
import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeVar, get_args

from paper.columns import COLUMNS, SPACES, VARIANTS, Column, Variant
from paper.settings import ProofSettings, Settings, Stored
from warp_bounding.errors import FileFormatError

__all__ = ["PROTOCOLS", "Key", "Line", "ProofRow", "Row"]

PROTOCOLS = ("exact", "sampled")

Key = tuple[int, str, str, str, str, int | None, str]
L = TypeVar("L", bound="Line")


@dataclass(frozen=True)
class Line:
    """What was measured of one bounder. The class says what a folder of such rows is; its fields are the columns of the CSV."""

    COMMAND: ClassVar[str]  # name of the command that makes the folder
    SETTINGS: ClassVar[type[Stored]]  # class of what all rows have in common
    PICTURES: ClassVar[tuple[str, ...]] = ()  # names of these in the folder
    SIGNED: ClassVar[frozenset[str]] = frozenset()  # fields that may be negative
    WORDS: ClassVar[dict[str, tuple[str, ...]]] = {}  # the values that a field may have

    dimension: int  # of the object
    object: str  # its name, the file's stem
    query: str  # kind of query
    method: str  # name in the registry

    @property
    def column(self) -> Column:
        """Where it stands."""
        return Column(self.dimension, self.query)

    @property
    def variant(self) -> Variant:
        """Its method, as a row of Table 1."""
        return Variant(self.method)

    @property
    def key(self) -> Key:
        """What it is about; a table has one row of each key."""
        return self.dimension, self.object, self.query, self.method, "geometric", None, PROTOCOLS[0]

    def agrees(self, s: Stored) -> bool:
        """Whether it can have been measured with these settings."""
        return all(getattr(self, name) == value for name, value in s.of_row(self.column, self.variant).items())

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises:
            FileFormatError: With what it is.
        """
        if self.column not in COLUMNS or self.variant not in VARIANTS or not self.object:
            raise FileFormatError(f"there is no {self.variant.label} for {self.column.name}")
        for name, words in self.WORDS.items():
            if getattr(self, name) not in words:
                raise FileFormatError(f"{name} must be one of {', '.join(words)}, got {getattr(self, name)!r}")

    @classmethod
    def table(cls) -> str:
        """Name of the CSV."""
        return f"{cls.COMMAND}.csv"

    @classmethod
    def header(cls) -> str:
        """First line of the CSV, its end included."""
        return ",".join(f.name for f in fields(cls)) + "\n"

    @property
    def line(self) -> str:
        """Its line of the CSV, the end included."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(getattr(self, f.name) for f in fields(self))
        return text.getvalue()

    @classmethod
    def parse(cls: type[L], line: str) -> L:
        """Inverse of ``line``, without its end.

        Raises:
            FileFormatError: With what is wrong with it, if it is not such a line.
        """
        try:
            (cells,) = csv.reader([line], strict=True)
        except (csv.Error, ValueError) as error:
            raise FileFormatError(str(error) or "not a line of a table") from None
        if len(cells) != len(fields(cls)):
            raise FileFormatError(f"{len(cells)} fields instead of {len(fields(cls))}")
        values = {}
        for f, text in zip(fields(cls), cells, strict=True):
            try:
                values[f.name] = _read(f.type, text, signed=f.name in cls.SIGNED)
            except ValueError as error:
                raise FileFormatError(f"{f.name}: {error}") from None
        row = cls(**values)
        row.check()
        return row


def _read(kind: Any, text: str, *, signed: bool) -> Any:
    """A value of a field's type; what may be missing is ``None`` where there is no text, no number is infinite, few are negative."""
    optional, kind = len(get_args(kind)) > 1, (get_args(kind) or (kind,))[0]
    if optional and not text:
        return None
    if kind is int and not text.isdecimal():
        raise ValueError(f"{text!r} is not a whole number")
    value = kind(text)
    if kind is float and not (math.isfinite(value) and (signed or value >= 0)):
        raise ValueError(f"{text!r} is not {'a finite number' if signed else 'a number of at least 0'}")
    return value


@dataclass(frozen=True)
class Row(Line):
    """A bounder of one object, measured under one protocol."""

    space: str  # ``geometric`` or ``parametric``
    leaves: int | None  # of a hierarchy, where a number was asked for
    protocol: str  # how truth was found
    fp_rate: float  # false positives, per cent of all samples
    fn: int  # false negatives, a count
    positives: float  # per cent of all samples
    certificate: str  # its kind, or empty where there is none
    fit_seconds: float | None  # of the fit, its proof included; ``None`` where it is not known any more
    proof_seconds: float | None  # of the last proof
    nbytes: int  # memory of the bounder
    hidden: str  # widths of hidden layers, such as ``25-25``; for a hierarchy, of the network whose memory it may use
    activation: str  # of the network
    budget: float  # seconds for a learned fit
    samples: int  # number of queries
    seed: int  # of the fit; the samples have the next one
    length: float  # of a ray
    device: str  # Warp device
    threads: int  # CPU threads
    indicator: str  # start of the SHA-256 of the object's cells
    versions: str  # of what did it

    COMMAND, SETTINGS, PICTURES = "table1", Settings, ("rank.png", "rank.svg")
    WORDS: ClassVar = {"protocol": PROTOCOLS, "space": SPACES}

    @property
    def variant(self) -> Variant:
        row = Variant(self.method, self.leaves)
        return row._replace(parametric=row.in_both_spaces and self.space == "parametric")

    @property
    def key(self) -> Key:
        return self.dimension, self.object, self.query, self.method, self.space, self.leaves, self.protocol

    def check(self) -> None:
        super().check()
        if self.fp_rate > 100:
            raise FileFormatError(f"fp_rate must be at most 100 per cent, got {self.fp_rate}")


@dataclass(frozen=True)
class ProofRow(Line):
    """A network of one object, with three thresholds: 0, the least f of many positives, and what a proof allows.

    What is said about threshold 0 is ``None`` for planes, whose networks learn distances and no output between 0 and 1.
    """

    search: str  # ``complete``: as near to the least f as asked for; ``cut short``, by time or rounding: it costs more
    fp_zero: float | None  # false positives at threshold 0, an output of 0.5, per cent of all samples
    fn_zero: int | None  # false negatives there among the samples, a count
    hard_fn_zero: int | None  # false negatives there among the hard positives, a count
    missed_zero: int | None  # whether a checked query is a false negative there
    fp_sampled: float  # false positives at the least f of the hard positives, per cent
    fn_sampled: int  # false negatives there among the samples, a count
    missed_sampled: int  # whether a checked query is a false negative there
    found_by: str  # ``prover`` if that query comes from the proof's search, ``walk`` if only from a walk from samples
    depth: float | None  # how far its f is below that threshold, as computed by the kernel
    depth_std: float | None  # the same in standard deviations of f over the samples
    depth_fp: float | None  # false positives that a threshold that lets it through would have cost, per cent of samples
    fp_proven: float  # false positives at the proven threshold, per cent
    fn_proven: int  # false negatives there among samples, hard positives and what the searches found
    positives: float  # per cent of all samples
    sampled: float  # least f of the hard positives
    proven: float  # the proven threshold
    lower_bound: float  # certified: f is not less on any positive
    upper_bound: float  # least f that the proof's search found
    gap: float  # the difference of these bounds
    rounding_bound: float  # E, what float32 may change
    boxes: int  # of the proof
    proof_seconds: float  # of the proof
    counterexample: str  # numbers of the query, separated by blanks
    counterexample_f: float | None  # its f
    shipped: float  # threshold of the bounder as it was fitted
    certificate: str  # kind of its certificate
    fp_shipped: float  # false positives there, per cent
    fit_seconds: float | None  # of the fit
    samples: int  # random queries
    hard_positives: int  # number of these
    seconds: float  # time that the proof was given
    budget: float  # time that the fit was given
    fitted: str  # ``table`` or ``here``
    seed: int  # of the fit
    threads: int  # CPU threads
    indicator: str  # start of the SHA-256 of the object's cells
    versions: str  # of what did it

    COMMAND, SETTINGS = "proofs", ProofSettings
    SIGNED = frozenset({"sampled", "proven", "lower_bound", "upper_bound", "gap", "shipped", "counterexample_f"})
    WORDS: ClassVar = {"search": ("complete", "cut short"), "found_by": ("", "prover", "walk")}

    def agrees(self, s: ProofSettings) -> bool:
        return super().agrees(s) and self.hard_positives >= s.positives
