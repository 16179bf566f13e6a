"""What an evaluation tells."""

from dataclasses import asdict, dataclass

from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape

__all__ = ["QUICK", "QUICK_SEED", "Rates", "truth_told"]

QUICK, QUICK_SEED = 16_384, 2  # the queries that ``quick_rates`` measures on: how many, and their seed


@dataclass(frozen=True)
class Rates:
    """Rates over all samples, in per cent, as in the paper.

    Attributes:
        fp_rate: False positives, per cent of all samples.
        fn: False negatives, a count; a conservative bounder has none.
        positives: Samples whose truth is *yes*, per cent.
        samples: Number of samples.
        protocol: ``"exact"`` or ``"sampled"`` (the truth from random points of a region, as in the paper; for points
            both are the same).
        seed: Seed of the samples.
        truth: Whose truth it is, in words: of the shape itself, or of cells, where a grid was given or where the shape
            cannot tell for this kind of query.
        indicator: SHA-256 of the shape or the cells that the fit bounded; equal to ``bounder.info["indicator"]``.
        undecided: Samples whose truth could not be decided, per cent; they count as positives, but not as ``fn``.
        fp_rate_cells: Where the fit bounded cells of a shape: the same against these cells, per cent; else ``None``.
        radius: Of a distance that is asked points: those within it are positive, object units; else ``None``.
        query: Of a distance: the kind of query that it was asked; else ``None``.

    Example:
        >>> rates = wb.evaluate(bounder, grid, samples=10_000)
        >>> rates.fn, rates.samples
        (0, 10000)
    """

    fp_rate: float
    fn: int
    positives: float
    samples: int
    protocol: str
    seed: int
    truth: str = "of its cells"
    indicator: str | None = None
    undecided: float = 0.0
    fp_rate_cells: float | None = None
    radius: float | None = None
    query: str | None = None

    @property
    def truth_told(self) -> str:
        """Whose truth it is, and what stands beside the rate: that against cells, and what could not be decided."""
        told = [self.truth]
        if self.fp_rate_cells is not None:
            told.append(f"{self.fp_rate_cells:.2f} % against the cells that are bounded")
        if self.radius:
            told.append(f"within radius {self.radius:g}")
        if self.undecided:
            told.append(f"{self.undecided:.2g} % undecided, counted as positives")
        return "; ".join(told)

    def to_dict(self) -> dict:
        """JSON-ready.

        Example:
            >>> wb.evaluate(bounder, grid, samples=1000).to_dict()["protocol"]
            'exact'
        """
        return asdict(self)


def truth_told(judge: Shape, fitted: Shape) -> str:
    """Whose truth counts, in words: that of a judge, where the fit bounded a shape or its cells."""
    if not isinstance(judge, IndicatorGrid):
        return "of the shape itself"
    return "of its cells" + (f" at resolution {fitted.resolution}" if fitted.resolution else "")
