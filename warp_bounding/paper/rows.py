"""One line of ``table1.csv``: what was measured of one bounder, and everything that it depends on."""

from dataclasses import dataclass

from warp_bounding.errors import FileFormatError
from warp_bounding.paper.columns import COLUMNS, VARIANTS, Column, Variant, variant_of
from warp_bounding.paper.lines import Lines, optional, share, whole

__all__ = ["FIELDS", "HEADER", "PROTOCOLS", "Row", "format_line", "parse_line"]

PROTOCOLS = ("exact", "sampled")
SPACES = ("geometric", "parametric")

Key = tuple[int, str, str, str, str, int | None, str]


@dataclass(frozen=True)
class Row:
    """A bounder of one object, measured under one protocol.

    Attributes:
        dimension: Of the object.
        object: Its name, the file's stem.
        query: Kind of query.
        method: Name in the registry.
        space: ``geometric`` or ``parametric``.
        leaves: Of a hierarchy, where a number was asked for.
        protocol: How truth was found.
        fp_rate: False positives, per cent of all samples.
        fn: False negatives, a count.
        positives: Per cent of all samples.
        certificate: Its kind, or empty where there is none.
        fit_seconds: Of the fit, its proof included; ``None`` where it is not known any more.
        proof_seconds: Of the last proof.
        nbytes: Memory of the bounder.
        hidden: Widths of hidden layers, such as ``25-25``; for a hierarchy, of the network whose memory it may use.
        activation: Of the network.
        budget: Seconds for a learned fit.
        samples: Number of queries.
        seed: Of the fit; the samples have the next one.
        length: Of a ray.
        device: Warp device.
        threads: CPU threads.
        indicator: Start of the SHA-256 of the object's cells.
        versions: Of what did it.
    """

    dimension: int
    object: str
    query: str
    method: str
    space: str
    leaves: int | None
    protocol: str
    fp_rate: float
    fn: int
    positives: float
    certificate: str
    fit_seconds: float | None
    proof_seconds: float | None
    nbytes: int
    hidden: str
    activation: str
    budget: float
    samples: int
    seed: int
    length: float
    device: str
    threads: int
    indicator: str
    versions: str

    @property
    def key(self) -> Key:
        """What it is about; a table has one row of each key."""
        return self.dimension, self.object, self.query, self.method, self.space, self.leaves, self.protocol

    @property
    def column(self) -> Column:
        """Where it stands."""
        return Column(self.dimension, self.query)

    @property
    def variant(self) -> Variant:
        """Where it stands."""
        return variant_of(self.method, self.space, self.leaves)


LINES = Lines(
    Row,
    {
        **dict.fromkeys(("dimension", "fn", "nbytes", "samples", "seed", "threads"), whole),
        **dict.fromkeys(("fp_rate", "positives", "budget", "length"), share),
        **dict.fromkeys(("fit_seconds", "proof_seconds"), optional(share)),
        "leaves": optional(whole),
    },
)
FIELDS, HEADER, format_line = LINES.fields, LINES.header, LINES.format


def parse_line(line: str) -> Row:
    """Inverse of ``format_line``.

    Raises:
        FileFormatError: With what is wrong with it, if it is not such a line.
    """
    row = LINES.parse(line)
    if row.column not in COLUMNS or row.variant not in VARIANTS:
        raise FileFormatError(f"there is no {row.variant.label} for {row.column.name}")
    if row.protocol not in PROTOCOLS or row.space not in SPACES or not row.object or row.fp_rate > 100:
        raise FileFormatError("protocol, space, object or fp_rate makes no sense")
    return row
