"""What all figures of one folder have in common."""

from dataclasses import dataclass

from paper.settings import Stored
from warp_bounding.errors import BounderError
from warp_bounding.version import __version__

__all__ = ["OWN", "PAPER", "FigureSettings"]

PAPER, OWN = "paper", "own"  # whose objects are shown: those of the paper's data, or shapes of our own


@dataclass(frozen=True)
class FigureSettings(Stored):
    """Of ``figures``."""

    objects: str = OWN  # whose objects are shown
    quick: bool = False  # small forms: shorter fits, fewer objects and sizes
    effort: float = 1.0  # the seconds of every fit are multiplied by this
    samples: int = 200_000  # random queries that a rate is measured on
    seed: int = 0  # of fits; the samples have the next one
    library: str = __version__  # version of warp-bounding

    POSITIVE = ("effort",)
    COUNTS = ("samples",)

    def check(self) -> None:
        super().check()
        if self.objects not in (PAPER, OWN):
            raise BounderError(f"objects must be {PAPER} or {OWN}, got {self.objects!r}")
        if not 0 <= self.seed < 2**63 - 1:
            raise BounderError(f"seed must be a whole number from 0 to 2^63 - 2, got {self.seed}")
