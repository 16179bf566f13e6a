"""What Table 1 is: its columns, its rows, and the paper's figures.

Source: Liu, Fischer, Yoo, Ritschel, *Neural Bounding* (SIGGRAPH 2024), Table 1; sizes of the networks from its supplement. The paper's
figures were measured with truth found by sampling, and its volumes were fitted to the *parameters* of the queries.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from warp_bounding import bounders
from warp_bounding.bounders.bounder import STEPS
from warp_bounding.bounders.mlp import Local
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.bounders.union import Union
from warp_bounding.bounders.volumes import VolumeBounder
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.evaluation import ASKED
from warp_bounding.queries import QUERIES, Query
from warp_bounding.queries.point import POINT

__all__ = [
    "COLUMNS",
    "DISTANCE",
    "DISTANCE_STEPS",
    "FITTED",
    "LEARNED",
    "LOCAL",
    "LOCAL_PARTS",
    "METHODS",
    "NETWORKS",
    "SPACES",
    "TREE",
    "TREE_LEAVES",
    "VARIANTS",
    "Column",
    "Variant",
    "columns_named",
    "select_columns",
    "select_methods",
]

HIDDEN = {2: (25, 25), 3: (50, 50), 4: (75, 75)}  # widths of hidden layers by dimension, from the supplement
PAPER_OBJECTS = {2: 9, 3: 9, 4: 3}  # by dimension
NONE = None  # the paper has no such figure
PAPER = {  # false positives in per cent; columns as in ``COLUMNS``
    "aabb": (28.4, 43.9, 21.3, 11.0, 28.5, 69.3, 19.1, 18.9, 81.7, 70.3, 3.6, 38.0),
    "obb": (27.0, 29.3, 21.2, 21.9, 26.1, 52.5, 19.1, 36.4, 76.2, 68.9, 3.6, 37.7),
    "sphere": (40.2, 43.9, 21.3, 27.3, 56.7, 69.3, 19.1, 47.3, 84.5, 70.4, 3.6, 40.6),
    "ellipsoid": (39.6, 43.9, 21.3, 26.9, 52.2, 69.3, 19.1, 45.1, 82.8, 70.4, 3.6, 40.5),
    "oriented-ellipsoid": (28.8, 36.2, 21.3, 23.3, 29.1, 62.9, 19.1, 37.1, 74.2, 68.8, 3.6, 39.9),
    "kdop": (28.4, 33.4, 21.2, 8.9, 22.0, 65.6, 19.1, 17.4, 75.3, 70.0, 3.6, 36.4),
    "bvh": (10.4, 28.9, 15.3, 8.2, 10.0, 34.4, 18.4, 14.6, 39.8, 61.7, 3.6, 35.2),
    "learned-kdop": (19.5, 18.5, 14.3, 7.7, 15.1, 40.0, 18.0, 15.3, 62.0, 64.7, 3.6, 31.6),
    "relu-field": (5.0, 6.4, 5.7, 3.3, 3.3, NONE, NONE, NONE, 10.0, NONE, NONE, NONE),
    "mlp": (3.2, 2.7, 1.2, 2.2, 4.2, 7.6, 5.6, 5.0, 10.9, 31.0, 3.1, 11.3),
    "mlp-early": (2.8, 3.3, 1.3, 3.1, 2.9, 10.1, 5.7, 6.5, 11.5, 38.8, 3.1, 17.2),
}
CASCADE = "learned-kdop+mlp"
DISTANCE = "distance"  # a network that learned the distance: one fit an object, which all of these queries are asked
LOCAL = "mlp-local"  # an ``mlp`` with a threshold for each part of its domain
LOCAL_PARTS = 256  # about how many
TREE = "hierarchy"  # boxes with a network in each, of about the memory of one
TREE_LEAVES, TREE_NARROWER = 8, 3  # how many there are, and how many times as narrow as one network their layers are
NETWORKS = (
    "mlp",
    "mlp-early",
    "monotone-mlp",
    LOCAL,
    TREE,
    CASCADE,
    DISTANCE,
)  # compared with the paper's best network
EXACT = ("voxels",)  # on its own grid, at the price of its memory
ROWS = (*PAPER, "monotone-mlp", LOCAL, TREE, CASCADE, DISTANCE, "occupancy", *EXACT)  # methods, in the table's order
DISTANCE_STEPS = {"ray": 128, "box": 512}  # evaluations that a query of these may take at most; most take a few


class Fitted(NamedTuple):
    """What makes the bounder of a row that is not named after its method."""

    kind: type[bounders.Bounder] | type[bounders.DistanceBounder]  # the class of its bounder
    method: str  # as ``fit`` takes it
    options: dict[str, Any]  # of ``fit``, besides those of the table
    by: str = "fit"  # the function of ``training`` that makes it
    narrower: int = 1  # how many times as narrow as the column's its hidden layers are
    queries: tuple[str, ...] = tuple(QUERIES)  # that it answers, if its class does


FITTED = {
    LOCAL: Fitted(Local, "mlp", {"thresholds": LOCAL_PARTS}),
    TREE: Fitted(Union, "mlp", {"leaves": TREE_LEAVES}, "hierarchy", TREE_NARROWER, (POINT.name,)),
    DISTANCE: Fitted(MlpDistance, "mlp", {}),
}


def _of_parts(method: str) -> list[type[bounders.Bounder] | type[bounders.DistanceBounder]]:
    """The registered classes of a method as ``fit`` takes it, or of the parts of a cascade."""
    named = (FITTED[method].method if method in FITTED else method).split("+")
    return [bounders.METHODS[name] for name in named]


LEARNED = tuple(m for m in ROWS if any(STEPS in cls.options for cls in _of_parts(m)))  # a fit takes a budget
CLASSIC = tuple(m for m in PAPER if m not in LEARNED)
IN_BOTH_SPACES = tuple(
    m for m in (*CLASSIC, "learned-kdop") if issubclass(bounders.METHODS[m], VolumeBounder)
)  # a row for each; for points there is but one
SPACES = ("geometric", "parametric")
LEAVES = {"bvh": (None, 16, 64, 256)}  # a row for each number; ``None`` where the fit decides


class Column(NamedTuple):
    """One column of the table: a kind of query of objects of a dimension."""

    ndim: int
    query: str

    @property
    def kind(self) -> Query:
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
        """Widths of the network's hidden layers, from the supplement."""
        return HIDDEN[self.ndim]

    @property
    def paper_network(self) -> float:
        """The paper's best network: false positives, per cent."""
        return min(PAPER[m][COLUMNS.index(self)] for m in NETWORKS if m in PAPER)

    @property
    def paper_objects(self) -> int:
        """Number of objects that the paper's mean is over."""
        return PAPER_OBJECTS[self.ndim]


COLUMNS = tuple(Column(n, q) for n in HIDDEN for q in ("point", "ray", "plane", "box"))


class Variant(NamedTuple):
    """One row of the table: a method, for volumes in one of two spaces, for a hierarchy with a number of leaves."""

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
    def slug(self) -> str:
        """As part of a file name."""
        return f"{self.name}-parametric" if self.parametric else self.name

    @property
    def last(self) -> str:
        """The last method of a cascade, on which most of its time goes; else the method."""
        return self.method.rpartition("+")[2]

    @property
    def front(self) -> str:
        """What stands before a cascade's last method; else nothing."""
        return self.method.rpartition("+")[0]

    @property
    def in_both_spaces(self) -> bool:
        """Whether it has a row for each space."""
        return self.method in IN_BOTH_SPACES

    @property
    def learned(self) -> bool:
        """Whether a fit takes a budget."""
        return self.method in LEARNED

    @property
    def conservative(self) -> bool:
        """Whether it promises to have no false negative."""
        return all(cls.conservative for cls in _of_parts(self.method))

    @property
    def of_distances(self) -> type[bounders.DistanceBounder] | None:
        """The class of its bounder, where that bounds distances; else ``None``."""
        kind = FITTED[self.method].kind if self.method in FITTED else None
        return kind if kind is not None and issubclass(kind, bounders.DistanceBounder) else None

    @property
    def fitted(self) -> Fitted:
        """What makes it: its class, the method and the options that make it what it is, and who takes them."""
        return FITTED.get(self.method) or Fitted(bounders.Bounder, self.method, {})

    @property
    def ranked(self) -> bool:
        """Whether it may be the best of a column."""
        return self.conservative and self.method not in EXACT

    def _supports(self, column: Column, space: str) -> bool:
        if space != SPACES[0]:  # ``paper.parametric``
            return column.kind.is_region and self.in_both_spaces
        if self.of_distances:
            return column.query in ASKED and self.of_distances.supports(column.ndim)
        if self.method in FITTED:
            made = FITTED[self.method]
            return column.query in made.queries and made.kind.supports(column.query, column.ndim)
        return bounders.supports(self.method, column.query, column.ndim)

    def space_in(self, column: Column) -> str | None:
        """The space that this row has in a column, or ``None`` where there is no such bounder.

        For points both spaces are the same: the geometric row has it. What has one row takes the space that it can.
        """
        if self.parametric and not column.kind.is_region:
            return None
        spaces = (SPACES[self.parametric],) if self.in_both_spaces else SPACES[:1]
        return next((s for s in spaces if self._supports(column, s)), None)

    def paper(self, column: Column) -> float | None:
        """The paper's figure that belongs beside this row: a volume's beside the parametric one, where there is one."""
        return PAPER[self.method][COLUMNS.index(column)] if self.is_papers(column) else None

    def is_papers(self, column: Column) -> bool:
        """Whether the paper's figures of a column belong beside this row."""
        if self.method not in PAPER or self.leaves is not None:
            return False
        parametric = self.in_both_spaces and self._supports(column, "parametric")
        return not self.in_both_spaces or self.parametric == parametric


VARIANTS = tuple(
    Variant(method, leaves, parametric)
    for method in ROWS
    for leaves in LEAVES.get(method, (None,))
    for parametric in ((False, True) if method in IN_BOTH_SPACES else (False,))
)  # in the order of the rows
METHODS = tuple(dict.fromkeys(v.name for v in VARIANTS))  # what ``--methods`` takes


def columns_named(word: str) -> set[Column]:
    """The columns that a word such as ``2d-point``, ``2d`` or ``ray`` names; none for other words."""
    return {c for c in COLUMNS if word.lower() in (c.name, f"{c.ndim}d", c.query)}


def select_columns(words: Sequence[str] | None) -> list[Column]:
    """The columns that words such as ``2d-point``, ``2d`` or ``ray`` name; all for ``None``.

    Raises:
        QueryError: For a word that names none.
    """
    for word in words or ():
        if not columns_named(word):
            names = ", ".join(c.name for c in COLUMNS)
            raise QueryError(f"columns must be among {names} (or 2d, 3d, 4d, point, ray, plane, box), got {word!r}")
    return [c for c in COLUMNS if words is None or any(c in columns_named(word) for word in words)]


def select_methods(words: Sequence[str] | None, among: Sequence[str] = METHODS) -> list[Variant]:
    """The rows that names of methods stand for; all of ``among`` for ``None``.

    Raises:
        BounderError: For a name that is not ``among`` these.
    """
    for word in words or ():
        if word not in among:
            raise BounderError(f"methods must be among {', '.join(among)}, got {word!r}")
    return [v for v in VARIANTS if v.name in (among if words is None else words)]
