"""What Table 1 is: its columns, its rows, and the paper's figures.

Source: Liu, Fischer, Yoo, Ritschel, *Neural Bounding* (SIGGRAPH 2024), Table 1; sizes of the networks from its supplement. The paper's
figures were measured with truth found by sampling, and its volumes were fitted to the *parameters* of the queries.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from warp_bounding.errors import BounderError, QueryError
from warp_bounding.queries import QUERIES, Query

__all__ = [
    "COLUMNS",
    "LEARNED",
    "METHODS",
    "NETWORKS",
    "VARIANTS",
    "Column",
    "Supports",
    "Variant",
    "columns_named",
    "select_columns",
    "select_methods",
    "variant_of",
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
CLASSIC = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "bvh")
CASCADE = "learned-kdop+mlp"
LEARNED = ("learned-kdop", "relu-field", "mlp", "mlp-early", "monotone-mlp", CASCADE, "occupancy")  # they take a budget
NETWORKS = ("mlp", "mlp-early", "monotone-mlp", CASCADE)  # compared with the paper's best network
IN_BOTH_SPACES = (*CLASSIC, "learned-kdop")  # a row for each; for points there is but one
OUTSIDE = ("occupancy", "voxels")  # not conservative; exact on its own grid, at the price of its memory
BVH_LEAVES = (16, 64, 256)

METHODS = (*CLASSIC, *(f"bvh-{n}" for n in BVH_LEAVES), *LEARNED, "voxels")  # what ``--methods`` takes

Supports = Callable[[str, str, int, str], bool]  # method, query, dimension, space


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
    def classic(self) -> bool:
        """Whether it is a volume that is fitted in closed form."""
        return self.method in CLASSIC

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
        return self.method != "occupancy"

    @property
    def ranked(self) -> bool:
        """Whether it may be the best of a column."""
        return self.method not in OUTSIDE

    def space_in(self, column: Column, supports: Supports) -> str | None:
        """The space that this row has in a column, or ``None`` where there is no such bounder.

        For points both spaces are the same: the geometric row has it. What has one row takes the space that it can.
        """
        if self.in_both_spaces:
            spaces = ("parametric",) if self.parametric else ("geometric",)
            if self.parametric and not column.kind.is_region:
                return None
        else:
            spaces = ("geometric", "parametric")
        return next((s for s in spaces if supports(self.method, column.query, column.ndim, s)), None)

    def paper(self, column: Column, supports: Supports) -> float | None:
        """The paper's figure that belongs beside this row: a volume's beside the parametric one, where there is one."""
        if self.leaves is not None:
            return None
        if self.in_both_spaces:
            parametric = column.kind.is_region and supports(self.method, column.query, column.ndim, "parametric")
            if self.parametric != parametric:
                return None
        figures = PAPER.get(self.method)
        return figures[COLUMNS.index(column)] if figures else None


def _variants() -> list[Variant]:
    rows = []
    for method in (*CLASSIC, *LEARNED, "voxels"):
        for leaves in (None, *BVH_LEAVES) if method == "bvh" else (None,):
            rows += [Variant(method, leaves, p) for p in ((False, True) if method in IN_BOTH_SPACES else (False,))]
    return rows


VARIANTS = tuple(_variants())  # in the order of the rows


def variant_of(method: str, space: str, leaves: int | None) -> Variant:
    """The row that a measured bounder belongs to."""
    return Variant(method, leaves, method in IN_BOTH_SPACES and space == "parametric")


def columns_named(word: str) -> set[Column]:
    """The columns that a word such as ``2d-point``, ``2d`` or ``ray`` names; none for other words."""
    return {c for c in COLUMNS if word.lower() in (c.name, f"{c.ndim}d", c.query)}


def select_columns(words: Sequence[str] | None) -> list[Column]:
    """The columns that words such as ``2d-point``, ``2d`` or ``ray`` name; all for ``None``.

    Raises:
        QueryError: For a word that names none.
    """
    if words is None:
        return list(COLUMNS)
    chosen = set()
    for word in words:
        found = columns_named(word)
        if not found:
            names = ", ".join(c.name for c in COLUMNS)
            raise QueryError(f"columns must be among {names} (or 2d, 3d, 4d, point, ray, plane, box), got {word!r}")
        chosen |= found
    return [c for c in COLUMNS if c in chosen]


def select_methods(words: Sequence[str] | None) -> list[Variant]:
    """The rows that names of methods stand for; all for ``None``.

    Raises:
        BounderError: For an unknown name.
    """
    for word in words or ():
        if word not in METHODS:
            raise BounderError(f"methods must be among {', '.join(METHODS)}, got {word!r}")
    return [v for v in VARIANTS if words is None or v.name in words]
