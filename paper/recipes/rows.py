"""One line of the table of recipes: a network of one object, trained in one way for a stated time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from paper.columns import Column, Variant
from paper.rows import Key, Line
from paper.settings import Settings, Stored
from warp_bounding.bounders.mlp import RECIPES
from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.version import __version__

__all__ = ["FOLDER", "WAYS", "RecipeRow", "RecipeSettings", "Way", "read_rows"]

FOLDER = "recipes"  # in a folder of ``table1``
OCTAVES = 4  # of the positional encoding: 18 inputs in 2D, as in the supplement


class Way(NamedTuple):
    """A way of training."""

    recipe: str
    octaves: int

    @property
    def name(self) -> str:
        """As it stands in the table."""
        return f"{self.recipe}+encoding" if self.octaves else self.recipe


WAYS = {way.name: way for recipe in RECIPES for octaves in (0, OCTAVES) for way in (Way(recipe, octaves),)}


@dataclass(frozen=True)
class RecipeSettings(Stored):
    """Of ``recipes``."""

    seconds: float = 600.0  # for each fit, its proof included
    samples: int = 400_000  # random queries that rates are measured on
    seed: int = 0  # of a fit; the samples have the next one
    length: float = 1.0  # of a ray
    library: str = __version__  # version of warp-bounding

    POSITIVE = ("seconds", "length")
    COUNTS = ("samples",)

    def check(self) -> None:
        super().check()
        if not 0 <= self.seed < 2**63 - 1:
            raise BounderError(f"seed must be a whole number from 0 to 2^63 - 2, got {self.seed}")

    def of_row(self, column: Column, variant: Variant) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("seconds", "samples", "seed", "length")}

    @property
    def fits(self) -> Settings:
        """Those of the fits."""
        return Settings(budget=self.seconds, samples=self.samples, seed=self.seed, length=self.length)


@dataclass(frozen=True)
class RecipeRow(Line):
    """A network of one object, trained in one way."""

    way: str  # name in ``WAYS``
    steps: int  # of training, as many as the time allowed
    steps_asked: int | None  # that the recipe asks for at least; ``None`` where it asks for a time
    step_seconds: float  # what a step took
    fp_rate: float  # false positives at the threshold that the fit has set, per cent of all samples, exact truth
    fn: int  # false negatives there, a count
    fp_zero: float  # false positives at the paper's threshold, an output of 0.5
    fn_zero: int  # false negatives there, a count
    positives: float  # per cent of all samples
    certificate: str  # its kind, or empty where there is none
    fit_seconds: float  # of the fit, its proof included
    nbytes: int  # memory of the bounder
    hidden: str  # widths of hidden layers, such as ``25-25``
    seconds: float  # that the fit was given
    samples: int  # random queries
    seed: int  # of the fit
    length: float  # of a ray
    threads: int  # CPU threads
    indicator: str  # start of the SHA-256 of the object's cells
    versions: str  # of what did it

    COMMAND, SETTINGS = "recipes", RecipeSettings
    WORDS: ClassVar = {"way": tuple(WAYS)}

    @property
    def key(self) -> Key:
        return *super().key[:-1], self.way

    @property
    def hours_asked(self) -> float | None:
        """Hours that the recipe asks for at least, at the pace that was measured."""
        return None if self.steps_asked is None else self.steps_asked * self.step_seconds / 3600


def read_rows(table: Path) -> list[RecipeRow]:
    """The rows in a folder of ``table1``, which somebody may be adding to; none where there are none.

    Raises:
        FileFormatError: If they are not of this version.
    """
    path = table / FOLDER / RecipeRow.table()
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError):
        return []
    header, *lines = text[: text.rfind("\n") + 1].split("\n")
    if header + "\n" != RecipeRow.header():
        raise FileFormatError(f"{path}: not a table of this version")
    try:
        return [RecipeRow.parse(line) for line in lines if line]
    except BoundingError as error:
        raise FileFormatError(f"{path}: damaged ({error})") from None
