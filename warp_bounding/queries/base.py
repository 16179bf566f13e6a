"""A kind of query as one object: numbers, sampler, exact truth, hard positives, and the map to a bounder's v.

A *positive* is a query that meets the object, a *hard* one barely; a bounder *denies* a query by answering *no*. Each
kind has a file of its own and an entry in ``queries.QUERIES`` under its name. Higher floors have tables by the same
name for what they know of it.

*Local space* is object space mapped by ``x -> (x - center) * scale``; the domain is about [-1, 1]^n there. A query
becomes numbers ``v`` of that space: coordinates of points, displacements, normals. The C text that computes them is
given ``V q[]`` (the numbers in object space), ``center scale limit`` (n each), ``extra``, a ``V zero`` and the
functions ``root`` and ``over`` (``kernels``). It sets ``V v[]`` and clears two masks. ``testable`` is false if the
query cannot be tested: a number is not finite, a direction has no usable length, a box is inverted, or a region is
given from too far away or lies outside the range of time. Then the answer is *maybe*, whatever ``inside`` is.
``inside`` is false where the answer is *no*. V is a vector of queries or a float, so masks are combined with ``&`` and
``|`` and never negated. If a shape is placed, ``q`` are numbers in the world and ``place`` is ``Placement.values``:
another text moves q into object space first.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.queries.exact import ExactOracle, oracle_kernel
from warp_bounding.rounding import UNIT32, gamma, round_up
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, OUT, Shape

FAR = 8.0  # largest |a|_1 of a region's point a in local space; beyond, a region that may meet the domain is *maybe*
FAR_AWAY = 20.0  # see ``Query.usual``: less than millimetres for metres make of most batches
FARTHEST_SUM = 2.0**60  # beyond this |a|_1 any region is *maybe*, as sums with it could overflow
# A direction whose largest |entry| is outside of these is *maybe*: products with it could overflow or vanish.
DIRECTION_SMALLEST, DIRECTION_LARGEST = 2.0**-90, 2.0**90
PARALLEL = 2.0**-80  # local units: a ray whose w is at most this on an axis counts as parallel to that axis' faces
GUARD = 16 * UNIT32  # relative room in the test against the domain: over three times its rounding
SUMMED = 2.0**-17  # relative, of an offset: above what a sum of n <= 64 products rounds, n + 12 units
LATER = 4 * GUARD  # relative, of coordinate 0 at a ray's end: above the rounding of it, n + 18 units
# The largest |entry| of a computed unit vector, times a stretch. It does not grow with n: the norm is the root of a
# sum of non-negative squares, and rounding is monotonic, so the sum is at least the rounded square of each entry. With
# e_k the entry before the last division, norm >= |e_k| (1 - u)^(3/2); the quotient and the product round once more: 4
# units.
UNIT_LIMIT = 1 + gamma(16)


class WorldMap(NamedTuple):
    """A placement before rounding, float64.

    Attributes:
        matrix: M, from the world's axes to the object's.
        forward: M^-1, from the object's axes to the world's.
        translation: Where the object's origin stands in the world.
        translation_error: By how much each of its numbers changes when it is rounded to float32.
    """

    matrix: np.ndarray
    forward: np.ndarray
    translation: np.ndarray
    translation_error: np.ndarray


# of ``distribution``, before the words of the kind
UNIFORM = (
    "half uniform queries that meet the object (or as many as an equal number of draws gives, where they are "
    "rare), half "
)


class Query(ABC):
    """A kind of query.

    Attributes:
        name: What users call it.
        is_region: A query is a set of points, given by 2n numbers, and a bounder tests the set, not the numbers as one
            point. False for points only.
        has_length: Its queries share a length, which is an option: rays.
        every: In words, all queries of the kind; ``{length}`` stands for the length.
        hard_positives: In words, the half of ``draw_positives`` that is drawn to be hard.
        oracle_body: C text of the exact truth (``exact.loop_snippet``).
        decider: Name of the method of shapes that decides queries of this kind.
        directed: For each n of a query's numbers: they are a direction, whose length does not count, or else a point.
        ends: For each n of them: whether a query meets nothing where they are too small, and where they are too large.
        map_text: The C text from the numbers ``q`` to the coordinates ``v``.
        placed_text: The C text that moves q from the world into the object's space; it runs before ``map_text``.
    """

    name: str
    is_region: bool = True
    has_length: bool = False
    every: str
    hard_positives: str
    oracle_body: ClassVar[str]
    decider: ClassVar[str] = ""
    directed: ClassVar[tuple[bool, ...]]
    ends: ClassVar[tuple[tuple[bool, bool], ...]]
    map_text: ClassVar[str]
    placed_text: ClassVar[str]

    @property
    def positive(self) -> str:
        """In words and without an article, a query that meets the object."""
        return f"{self.name} that meets the object"

    @property
    def distribution(self) -> str:
        """In words, what ``draw_positives`` draws."""
        return UNIFORM + self.hard_positives

    def usual(self, domain) -> tuple[np.ndarray, np.ndarray]:
        """``(m,)`` each, least and largest numbers of queries: others are of another unit, or about another origin.

        They are ``FAR_AWAY`` times the domain's longest side outside of it; infinite where any number may occur.
        """
        if domain.joints is not None:
            return domain.joints.usual
        in_space = np.arange(domain.space_ndim) >= int(domain.time)
        room = FAR_AWAY * (domain.upper - domain.lower)[in_space].max() + (domain.length or 0.0)
        least, most = zip(*self.ends, strict=True)
        low = [np.where(in_space & each, domain.lower - room, -np.inf) for each in least]
        high = [np.where(in_space & each, domain.upper + room, np.inf) for each in most]
        return np.concatenate(low), np.concatenate(high)

    def columns(self, ndim: int) -> int:
        """Numbers of one query about an object of dimension ``ndim``."""
        return 2 * ndim if self.is_region else ndim

    def valid(self, q: np.ndarray) -> np.ndarray:
        """``(N,)`` bool, which queries ``(N, m)`` mean something. Oracles call the others False, bounders *maybe*."""
        return np.isfinite(q).all(axis=1)

    @abstractmethod
    def sample(self, grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
        """Random queries ``(count, m)`` float32 in object space, drawn as the paper draws them.

        The paper's coordinates 0 and 1 are the centres of the grid's first and last cells.
        """

    @abstractmethod
    def truth(self, grid: Grid, q: np.ndarray, length: float = 1.0, cells: np.ndarray | None = None) -> np.ndarray:
        """The truth ``(N,)`` bool in rational arithmetic, one query after another: slow, and as simple as possible.

        ``cells`` ``(M, n)`` are those that may be looked at; all occupied ones if ``None``.
        """

    def certain(self, shape: Shape, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        """``(N,)`` bool: which queries meet the object beyond doubt; of a grid ``truth``, against every cell."""
        return self.truth(shape, q, length) if isinstance(shape, Grid) else self.decide(shape, q, length) == IN

    def near(self, grid: Grid, q: np.ndarray) -> np.ndarray:
        """``(M, n)``, the occupied cells that one query ``(m,)`` meets or nearly meets, by the kernel's error bound."""
        return grid.occupied

    @abstractmethod
    def arrays(self, grid: Grid) -> dict[str, np.ndarray]:
        """What ``oracle_body`` reads of an object, by the names of ``exact.oracle_kernel``."""

    def kernel(self, ndim: int) -> wp.Kernel:
        """The kernel of the exact truth."""
        return oracle_kernel(f"wb_{self.name}_oracle_{ndim}d", ndim, self.columns(ndim), self.oracle_body)

    def oracle(self, grid: Shape, device: str | None = None, length: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
        """The exact truth for many queries; ``QueryError`` for a length that is negative or not finite.

        Of a grid a Warp kernel, with ``truth`` as its plain reference implementation, else ``decide``: what a shape
        without cells cannot decide counts as meeting the object.
        """
        if self.has_length and not 0 <= length < np.inf:
            raise QueryError(f"length must be finite and non-negative, got {length}")
        if not isinstance(grid, Grid):
            return lambda q: self.decide(grid, q, length) != OUT
        return ExactOracle(self, grid, device, length, self.kernel(grid.ndim), self.arrays(grid))

    @abstractmethod
    def barely(self, grid: Grid, p: np.ndarray, rng: np.random.Generator, length: float, outside: bool) -> np.ndarray:
        """Queries ``(N, m)`` float64 that barely pass points ``(N, n)`` of the object.

        With ``outside``, queries that are given by points outside the domain are among them. Rounding may move some off
        the object.
        """

    def decides(self, shape: Shape) -> bool:
        """Whether a shape without cells can decide queries of this kind."""
        return getattr(shape, self.decider, None) is not None

    def decide(self, shape: Shape, q: np.ndarray, length: float = 1.0) -> np.ndarray:
        """``(N,)`` uint8, the truth of such a shape for float32 ``(N, m)``: ``OUT``, ``IN`` or ``UNDECIDED``."""
        if not self.decides(shape):
            raise QueryError(f"{shape.name}: cannot tell the truth for {self.name} queries; give a resolution")
        return np.where(self.valid(q), getattr(shape, self.decider)(*self.halves(q, length)), OUT).astype(np.uint8)

    def halves(self, q: np.ndarray, length: float) -> list[np.ndarray]:
        """The arguments of the shape's ``decider``."""
        return np.split(q, 2, axis=1)

    @abstractmethod
    def nudged(self, grid: Grid, x: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Queries ``(N, m)`` float64 near ``x``: points move by shares ``move`` of the domain, directions turn."""

    def hardest(
        self, grid: Shape, p: np.ndarray, rng: np.random.Generator, length: float, hulls: list[np.ndarray]
    ) -> np.ndarray:
        """As ``barely``, for stress tests; ``hulls`` are those of the grid."""
        return self.barely(grid, p, rng, length, True)

    def hulls(self, grid: Grid) -> list[np.ndarray]:
        """Hull corners ``(V, n)`` of each component, object space, where ``hardest`` needs them."""
        return []

    # --- the map to coordinates v ------------------------------------------------------------------------------------
    # A ``domain`` is a ``Domain`` or ``RegionDomain`` of this kind, ``base`` its domain of points.

    def coordinates(self, n: int) -> int:
        """Number of coordinates ``v`` for an object of dimension n."""
        return self.columns(n)

    def extra_count(self, n: int, time: bool) -> int:
        """How many numbers ``extra`` there are: the kind's own, and one more where coordinate 0 is time."""
        return int(time)

    def stretch(self, base, length: float | None) -> np.ndarray:
        """``(n,)`` float32, a ray's displacement in local space, per axis and unit direction; ones for others."""
        return np.ones(base.ndim, np.float32)

    def extra(self, domain) -> np.ndarray:
        """float32, the kind's own part of ``extra``."""
        return np.zeros(0, np.float32)

    def limit(self, domain) -> np.ndarray:
        """``(ndim,)`` float32, largest ``|v|`` that a bounder is queried at."""
        return self._by_part(domain.base.limit, round_up(domain.stretch * UNIT_LIMIT))

    def delta(self, domain) -> np.ndarray:
        """``(ndim,)`` float64, the input error of ``v`` that proofs cover."""
        base = domain.base
        return self._by_part(base.delta, direction_rounding(base.ndim) * domain.stretch.astype(np.float64))

    def to_local(self, domain, q: np.ndarray) -> np.ndarray:
        """``v`` ``(N, ndim)`` of finite queries ``(N, m)`` that meet the domain, in float64."""
        parts = np.split(q, len(self.directed), axis=1)
        for k, part in enumerate(parts):
            if self.directed[k]:
                parts[k] = part / np.linalg.norm(part, axis=1, keepdims=True) * domain.stretch.astype(np.float64)
            else:
                parts[k] = domain.base.to_local(part)
        return np.concatenate(parts, axis=1)

    def to_object(self, domain, v: np.ndarray) -> np.ndarray:
        """A query ``(N, m)`` float64 in object space for each ``v`` ``(N, ndim)``."""
        stretch, parts = domain.stretch.astype(np.float64), np.split(v, len(self.directed), axis=1)
        both = zip(parts, self.directed, strict=True)
        return np.concatenate([p / stretch if directed else domain.base.to_object(p) for p, directed in both], axis=1)

    def _by_part(self, point: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return np.concatenate([direction if directed else point for directed in self.directed])

    @abstractmethod
    def rounding(self, base, length: float | None) -> np.ndarray:
        """``(n,)``: how far, per axis of local space, the computed query may pass a point of the exact one."""

    def placed_values(self, domain, world: WorldMap) -> list[np.ndarray]:
        """What the kernels read of a placement in addition to translation and matrix."""
        return []

    @abstractmethod
    def placed_rounding(self, domain, world: WorldMap, input_unit: float) -> np.ndarray:
        """``(n,)``, local units: how far a moved query may pass a point of the exact one; infinite without a bound.

        ``input_unit`` is the relative rounding error of the query's numbers before the move. See ``domain``.
        """


def direction_rounding(ndim: int) -> float:
    """Relative error of an entry of a unit direction: two divisions, the norm of n squares, a float64 input."""
    return gamma(ndim + 10)
