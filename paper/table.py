"""What the paper's tables are made of: columns, methods, the paper's own numbers, and their command-line names.

``paper.csv`` has the numbers of Liu, Fischer, Yoo, Ritschel, *Neural Bounding* (SIGGRAPH 2024): ``fp_rate`` of Table
1, per cent, with truth found by sampling and volumes around the *parameters* of the queries; ``ms`` for ten million
queries, of its supplement, on an RTX 3090; and ``ratio``, the last column of Table 2. Sizes of the networks are from
the supplement.
"""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from warp_bounding import bounders
from warp_bounding.bounders.bounder import STEPS
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.bounders.volumes import VolumeBounder
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.evaluation import ASKED
from warp_bounding.queries import QUERIES

HIDDEN = {2: (25, 25), 3: (50, 50), 4: (75, 75)}  # hidden layers by dimension
OBJECTS = {2: 9, 3: 9, 4: 3}  # the paper's objects by dimension
REGIONS = tuple(name for name, kind in QUERIES.items() if kind.is_region)
PROTOCOLS = ("exact", "sampled")  # how truth is found; the second as in the paper
SPACES = ("geometric", "parametric")  # a volume lies around the object, or around the numbers of the queries
DISTANCE_STEPS = {"ray": 128, "box": 512}  # evaluations that such a query of a distance may take at most


DISTANCE = "distance"  # the row of a network of distances


class Column(NamedTuple):
    """A column of the table: a kind of query of objects of a dimension."""

    ndim: int
    query: str

    @property
    def kind(self):
        """The kind of query."""
        return QUERIES[self.query]

    @property
    def name(self) -> str:
        """As the command line takes it, such as ``2d-point``."""
        return f"{self.ndim}d-{self.query}"

    @property
    def title(self) -> str:
        """As a heading, such as ``2D point``."""
        return f"{self.ndim}D {self.query}"

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the network's hidden layers."""
        return HIDDEN[self.ndim]


COLUMNS = tuple(Column(n, q) for n in HIDDEN for q in ("point", "ray", "plane", "box"))


def _paper() -> dict[str, dict[str, dict[Column, float]]]:
    """The paper's numbers: by what they are, by method, by column."""
    found: dict[str, dict[str, dict[Column, float]]] = {}
    with (Path(__file__).parent / "paper.csv").open() as file:
        for row in csv.DictReader(file):
            own = {c: float(row[c.name]) for c in COLUMNS if row[c.name]}
            found.setdefault(row["what"], {})[row["method"]] = own
    return found


PAPER = _paper()
EXACT = ("voxels",)  # on its own grid, at the price of its memory
NETWORKS = ("mlp", "learned-kdop+mlp", DISTANCE)  # compared with the paper's best
COMPARED = tuple(m for m in PAPER["fp_rate"] if m in bounders.METHODS)  # all of the paper's but ``mlp-early``
ROWS = (*COMPARED, *NETWORKS[1:], "occupancy", *EXACT)  # methods, in the table's order


def classes_of(method: str) -> list[Any]:
    """The registered classes of a method, or of the parts of a cascade."""
    return [bounders.METHODS[name] for name in ("mlp" if method == DISTANCE else method).split("+")]


LEARNED = tuple(m for m in ROWS if any(STEPS in cls.options for cls in classes_of(m)))  # a fit takes a budget
CLASSIC = tuple(m for m in COMPARED if m not in LEARNED)
IN_BOTH = tuple(m for m in (*CLASSIC, "learned-kdop") if issubclass(bounders.METHODS[m], VolumeBounder))  # spaces
AS_TRAINED = {"mlp": REGIONS}  # networks over a region's numbers, as the paper trains them (``regions``)


class Variant(NamedTuple):
    """A row of the table: a method, for volumes in one of two spaces, for boxes in a tree with a number of leaves."""

    method: str
    leaves: int | None = None
    parametric: bool = False

    @property
    def name(self) -> str:
        """As the command line takes it; both spaces have the same."""
        return self.method if self.leaves is None else f"{self.method}-{self.leaves}"

    @property
    def label(self) -> str:
        """As it heads a row."""
        return f"{self.name} (parametric)" if self.parametric else self.name

    @property
    def last(self) -> str:
        """The last method of a cascade; else the method."""
        return self.method.rpartition("+")[2]

    @property
    def learned(self) -> bool:
        """Whether a fit takes a budget."""
        return self.method in LEARNED

    @property
    def conservative(self) -> bool:
        """Whether its method promises to have no false negative; a volume around parameters does not (``promises``)."""
        return all(cls.conservative for cls in classes_of(self.method))

    @property
    def promises(self) -> bool:
        """Whether a false negative of it is a defect."""
        return self.conservative and not self.parametric

    def space_in(self, column: Column) -> str | None:
        """This row's space in a column, ``None`` where there is no such bounder; points have the geometric one."""
        if self.parametric:
            return SPACES[1] if column.query in AS_TRAINED.get(self.method, REGIONS) else None
        if self.method == DISTANCE:
            known = column.query in ASKED and MlpDistance.supports("distance", column.ndim)
        else:
            known = bounders.supports(self.method, column.query, column.ndim)
        return SPACES[0] if known else None

    def paper(self, column: Column, what: str = "fp_rate") -> float | None:
        """The paper's number beside this row, if there is one: beside the parametric one, where there are two."""
        both = column.query in AS_TRAINED.get(self.method, REGIONS if self.method in IN_BOTH else ())
        belongs = self.leaves is None and self.parametric == both
        return PAPER[what].get(self.method, {}).get(column) if belongs else None


# in the order of the rows
VARIANTS = tuple(
    Variant(method, leaves, parametric)
    for method in ROWS
    for leaves in ((None, 16, 64, 256) if method == "bvh" else (None,))
    for parametric in ((False, True) if method in IN_BOTH or method in AS_TRAINED else (False,))
)


def column_of(row: dict[str, Any]) -> Column:
    """The column of a row of a file."""
    return Column(row["dimension"], row["query"])


def variant_of(row: dict[str, Any]) -> Variant:
    """The method of a row of a file."""
    parametric = row.get("space") == SPACES[1]
    return Variant(row["method"], row.get("leaves"), parametric)


def words_of(text: str | None) -> list[str] | None:
    """Words between commas; ``None`` for no text."""
    return None if text is None else [word.strip() for word in text.split(",")]


def columns_named(word: str) -> set[Column]:
    """The columns that a word such as ``2d-point``, ``2d`` or ``ray`` names; none for other words."""
    return {c for c in COLUMNS if word.lower() in (c.name, f"{c.ndim}d", c.query)}


def select_columns(text: str | None) -> list[Column]:
    """The columns that words name; all for ``None``. Raises ``QueryError`` for a word that names none."""
    words = words_of(text)
    for word in words or ():
        if not columns_named(word):
            names = ", ".join(c.name for c in COLUMNS)
            raise QueryError(f"columns must be among {names} (or 2d, 3d, 4d, point, ray, plane, box), got {word!r}")
    return [c for c in COLUMNS if words is None or any(c in columns_named(word) for word in words)]


def select_methods(text: str | None, among: Sequence[Variant] = VARIANTS) -> list[Variant]:
    """The rows that names of methods stand for, among these; all for ``None``."""
    words, names = words_of(text), list(dict.fromkeys(v.name for v in among))
    for word in words or ():
        if word not in names:
            raise BounderError(f"methods must be among {', '.join(names)}, got {word!r}")
    return [v for v in among if words is None or v.name in words]


def budgets_in(text: str, default: float) -> dict[str, Any]:
    """The settings ``budget`` and ``budgets`` from ``--budget``: seconds of learned fits, for some columns or methods.

    Such as ``20,3d=40,3d-ray:mlp=240``: of all words that name a fit's column or method, the last one counts.
    """
    general, parts = [], []
    for word in words_of(text):
        name, named, seconds = word.rpartition("=")
        try:
            value, name = float(seconds), name.strip().lower()
        except ValueError:
            value = math.nan
        if not 0 < value < math.inf:
            raise BounderError(f"budget must be positive seconds, such as 60 or 20,3d-ray=60, got {word!r}")
        if named and not all(columns_named(part) or part in LEARNED for part in name.split(":")):
            raise BounderError(f"budget must name columns (3d-ray, 3d, ray), learned methods, or both, got {word!r}")
        (parts if named else general).append(f"{name}={value:g}" if named else value)
    if len(general) > 1:
        raise BounderError(f"budget must have one number without a name, got {text!r}")
    return {"budget": general[0] if general else default, "budgets": ",".join(parts)}


def budget_of(settings: dict[str, Any], column: Column, variant: Variant) -> float:
    """Seconds of a learned fit: a cascade takes its last part's."""
    seconds, names = settings["budget"], {variant.method, variant.last}
    for word in settings["budgets"].split(",") if settings["budgets"] else ():
        name, _, value = word.partition("=")
        if all(part in names or column in columns_named(part) for part in name.split(":")):
            seconds = float(value)
    return seconds


def budget_text(settings: dict[str, Any]) -> str:
    """All budgets, as ``--budget`` takes them."""
    return ",".join(filter(None, (f"{settings['budget']:g}", settings["budgets"])))
