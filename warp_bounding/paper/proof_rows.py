"""One line of ``proofs.csv``: what sampling would have shipped of a network, and what a proof says about it."""

from dataclasses import asdict, dataclass, replace
from typing import Any

from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.paper.columns import COLUMNS, VARIANTS, Column, Variant
from warp_bounding.paper.folder import Kind
from warp_bounding.paper.lines import Lines, number, optional, share, whole
from warp_bounding.paper.rows import Key
from warp_bounding.paper.settings import Settings, agree, read_fields
from warp_bounding.version import __version__

__all__ = ["PROOFS", "PROOF_COST", "ProofRow", "ProofSettings"]

PROOF_COST = 1e-4  # share of all queries that a proof's gap may cost in false positives


@dataclass(frozen=True)
class ProofRow:
    """A network of one object, with three thresholds: 0, the least f of many positives, and what a proof allows.

    Attributes:
        dimension: Of the object.
        object: Its name, the file's stem.
        query: Kind of query.
        method: Name in the registry.
        search: ``complete``: it came as near to the least f as was asked for; or ``cut short``, by time or by rounding: the
            threshold is as proven, but costs more.
        fp_zero: False positives at threshold 0, an output of 0.5, per cent of all samples. Like the others about it ``None`` for
            planes, whose networks learn distances and no output between 0 and 1.
        fn_zero: False negatives there among the samples, a count.
        hard_fn_zero: Likewise among the hard positives.
        missed_zero: Whether a checked query is a false negative there.
        fp_sampled: False positives at the least f of the hard positives, per cent.
        fn_sampled: False negatives there among the samples, a count.
        missed_sampled: Whether a checked query is a false negative there.
        found_by: ``prover`` if that query comes from the proof's search, ``walk`` if only from a walk from samples.
        depth: How far its f is below that threshold, as computed by the kernel.
        depth_std: The same in standard deviations of f over the samples.
        depth_fp: What a threshold that lets it through would have cost: false positives, per cent of all samples.
        fp_proven: False positives at the proven threshold, per cent.
        fn_proven: False negatives there among samples, hard positives and what the searches found.
        positives: Per cent of all samples.
        sampled: Least f of the hard positives.
        proven: The proven threshold.
        lower_bound: Certified: f is not less on any positive.
        upper_bound: Least f that the proof's search found; the gap is the difference.
        gap: See there.
        rounding_bound: E, what float32 may change.
        boxes: Of the proof.
        proof_seconds: Of the proof.
        counterexample: Numbers of the query, separated by blanks.
        counterexample_f: Its f.
        shipped: Threshold of the bounder as it was fitted.
        certificate: Kind of its certificate.
        fp_shipped: False positives there, per cent.
        fit_seconds: Of the fit.
        samples: Random queries.
        hard_positives: Number of these.
        seconds: Time that the proof was given.
        budget: Time that the fit was given.
        fitted: ``table`` or ``here``.
        seed: Of the fit.
        threads: CPU threads.
        indicator: Start of the SHA-256 of the object's cells.
        versions: Of what did it.
    """

    dimension: int
    object: str
    query: str
    method: str
    search: str
    fp_zero: float | None
    fn_zero: int | None
    hard_fn_zero: int | None
    missed_zero: int | None
    fp_sampled: float
    fn_sampled: int
    missed_sampled: int
    found_by: str
    depth: float | None
    depth_std: float | None
    depth_fp: float | None
    fp_proven: float
    fn_proven: int
    positives: float
    sampled: float
    proven: float
    lower_bound: float
    upper_bound: float
    gap: float
    rounding_bound: float
    boxes: int
    proof_seconds: float
    counterexample: str
    counterexample_f: float | None
    shipped: float
    certificate: str
    fp_shipped: float
    fit_seconds: float | None
    samples: int
    hard_positives: int
    seconds: float
    budget: float
    fitted: str
    seed: int
    threads: int
    indicator: str
    versions: str

    @property
    def key(self) -> Key:
        """As a job of ``table1`` has it."""
        return self.dimension, self.object, self.query, self.method, "geometric", None, "exact"

    @property
    def column(self) -> Column:
        """Where it stands."""
        return Column(self.dimension, self.query)

    @property
    def variant(self) -> Variant:
        """Its method."""
        return Variant(self.method)


COUNTS = ("dimension", "fn_sampled", "missed_sampled", "fn_proven")
SHARES = ("fp_sampled", "fp_proven", "fp_shipped", "positives", "rounding_bound", "proof_seconds")
LINES = Lines(
    ProofRow,
    {
        **dict.fromkeys((*COUNTS, "boxes", "samples", "hard_positives", "seed", "threads"), whole),
        **dict.fromkeys((*SHARES, "seconds", "budget"), share),
        **dict.fromkeys(("sampled", "proven", "lower_bound", "upper_bound", "gap", "shipped"), number),
        **dict.fromkeys(("fn_zero", "hard_fn_zero", "missed_zero"), optional(whole)),
        **dict.fromkeys(("fp_zero", "depth", "depth_std", "depth_fp", "fit_seconds"), optional(share)),
        "counterexample_f": optional(number),
    },
)


def _parse(line: str) -> ProofRow:
    row = LINES.parse(line)
    if row.column not in COLUMNS or row.variant not in VARIANTS or not row.object:
        raise FileFormatError(f"there is no {row.method} for {row.dimension}d-{row.query}")
    if row.search not in ("complete", "cut short") or row.found_by not in ("", "prover", "walk"):
        raise FileFormatError("search or found_by makes no sense")
    return row


@dataclass(frozen=True)
class ProofSettings:
    """What all rows have in common.

    Attributes:
        positives: Hard positives that a threshold is sampled from.
        samples: Random queries that rates are measured on.
        seconds: Time for each proof.
        table: Settings of the table whose networks these are.
        library: Version of warp-bounding.
    """

    positives: int = 1_000_000
    samples: int = 400_000
    seconds: float = 60.0
    table: Any = None
    library: str = __version__

    @classmethod
    def of(cls, given: dict[str, Any], stored: "ProofSettings | None" = None) -> "ProofSettings":
        """See ``Settings.of``."""
        given = {name: value for name, value in given.items() if value is not None}
        wanted = replace(stored or cls(), library=__version__, **given)
        for name in ("positives", "samples"):
            if getattr(wanted, name) < 1:
                raise BounderError(f"{name} must be at least 1, got {getattr(wanted, name)}")
        if not 0 < wanted.seconds < float("inf"):
            raise BounderError(f"seconds must be positive, got {wanted.seconds}")
        return agree(wanted, stored)

    @property
    def fits(self) -> Settings:
        """Settings of the table."""
        return Settings.from_dict(self.table)

    @property
    def positives_seed(self) -> int:
        """Seed of the hard positives: not that of any fit or certificate."""
        return self.fits.seed + 424_243

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Any) -> "ProofSettings":
        """Inverse of ``to_dict``; raises ``FileFormatError``."""
        settings = read_fields(cls(table={}), values)
        Settings.from_dict(settings.table)
        return settings


def _check(settings: ProofSettings, row: ProofRow) -> None:
    fits = settings.fits
    expected = (settings.samples, settings.seconds, fits.budget_of(row.column, row.variant), fits.seed)
    if expected != (row.samples, row.seconds, row.budget, row.seed) or row.hard_positives < settings.positives:
        raise FileFormatError("it was measured with other settings")


PROOFS = Kind("proofs", "proofs.csv", (), ProofSettings, LINES.header, LINES.format, _parse, _check)
