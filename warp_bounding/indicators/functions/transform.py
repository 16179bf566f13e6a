"""A shape that is turned, scaled and moved, with the error of a rotation that is not quite one counted."""

from functools import reduce

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.combination import Combination, check_parts
from warp_bounding.indicators.functions.intervals import Interval, norm
from warp_bounding.indicators.functions.parameters import checked_number, checked_vector
from warp_bounding.indicators.functions.solid import Foreign, Solid
from warp_bounding.indicators.shape import Shape

__all__ = ["Transform"]

ORTHOGONAL = 1e-5  # how far R^T R may be from the identity (Frobenius norm); of float32 rotations it is about 1e-7


class Transform(Combination):
    """A shape in another place: a point x is in it where ``R^T (x - translation) / scale`` is in the shape.

    That is what it means for the very numbers that are given, although R is only nearly a rotation: R^T stretches
    lengths by at most ``sqrt(1 + e)``, where e bounds the norm of ``R^T R - 1``, and distances are divided by that.

    Args:
        shape: Any shape of n coordinates, none of them time.
        rotation: ``(n, n)``, R, whose columns are the shape's axes after it was turned; the identity for ``None``. It
            may mirror.
        translation: ``(n,)``, where the shape's origin goes, object space; 0 for ``None``.
        scale: Uniform, above 0.
        name: For people.

    Raises:
        IndicatorError: For no shape, or one of time; a matrix that is no rotation to within ``ORTHOGONAL``; numbers
            that are not finite, or a scale that is not above 0.

    Example:
        >>> quarter = wb.solids.Transform(wb.solids.Box([0, 0], [2, 1]), [[0, -1], [1, 0]], scale=2.0)
        >>> quarter.lower, quarter.upper
        (array([-2.,  0.]), array([0., 4.]))
    """

    def __init__(self, shape: Shape, rotation=None, translation=None, scale: float = 1.0, *, name: str = "transform"):
        check_parts((shape,), name)
        n = shape.ndim
        if shape.time:
            raise IndicatorError(f"{name}: a shape of time cannot be turned or scaled; place it before it is moved")
        self.translation = checked_vector(np.zeros(n) if translation is None else translation, "translation", name)
        if len(self.translation) != n:
            raise IndicatorError(f"{name}: translation must have {n} numbers, got {len(self.translation)}")
        self.scale = checked_number(scale, "scale", name)
        self.rotation, self.error = _checked_rotation(rotation, n, name)
        self._stretch = (Interval(self.error) + 1.0).root() if self.error else Interval(1.0)
        self._tilted = np.count_nonzero(self.rotation) > n
        numbers = [self.rotation, self.translation, self.scale]
        super().__init__((shape,), *self._corners(shape), numbers, name)
        self.certified, self.exact = shape.certified, self._solids[0].exact

    def _corners(self, shape: Shape) -> tuple[np.ndarray, np.ndarray]:
        """A box around the shape's own box in its new place: that of R, wider by what R^-T differs from it."""
        box = [Interval(a, b) * self.scale for a, b in zip(shape.lower, shape.upper, strict=True)]
        if self.error:
            wider = norm(box) * self.error * 2.0  # |R^-T - R| <= sqrt(1 + e) e / (1 - e) < 2 e
            room = Interval(-wider.high, wider.high)
        placed = []
        for row, t in zip(self.rotation, self.translation, strict=True):
            total = _dot(box, row)
            placed.append((total + room if self.error else total) + t)
        return np.array([side.low for side in placed]), np.array([side.high for side in placed])

    def _gap(self, box: list[Interval]) -> Interval:
        gap = self._placed_gap(box)
        if not self._tilted:
            return gap
        # A box that is turned has a larger box around it: where that costs more than the ball around the box does,
        # the gap at the centre, from which it changes by the half-diagonal at most, bounds it better.
        center = [x.low / 2 + x.high / 2 for x in box]
        reach = norm((x - c).magnitude() for x, c in zip(box, center, strict=True)).high
        return gap.both(self._placed_gap([Interval(c) for c in center]) + Interval(-reach, reach))

    def _placed_gap(self, box: list[Interval]) -> Interval:
        moved = [x - t if t else x for x, t in zip(box, self.translation, strict=True)]
        own = [_dot(moved, column) for column in self.rotation.T]
        if self.scale != 1.0:
            own = [x / self.scale for x in own]
        gap = self._gaps(own)[0]
        gap = gap * self.scale if self.scale != 1.0 else gap
        return gap / self._stretch if self.error else gap

    def _at_level(self, level: float) -> "Transform":
        found = Solid._at_level(self, level)
        if level > 0 and not self.levels and isinstance(self._solids[0], Foreign):
            # A shape that is no solid dilates itself; so that nothing is lost, by a little more than was asked for.
            own = Interval(level) * self._stretch / self.scale
            found._solids, found._taken = (self._solids[0]._at_level(float(own.high)),), 1
        return found

    def landmarks(self) -> np.ndarray:
        return self.parts[0].landmarks() @ self.rotation.T * self.scale + self.translation


def _dot(box: list[Interval], numbers: np.ndarray) -> Interval:
    """Sum of products, without those with 0; those with 1 and -1 are exact."""
    own = [(x, float(r)) for x, r in zip(box, numbers, strict=True) if r]
    terms = [{1.0: x, -1.0: -x}.get(r) or x * r for x, r in own]
    return reduce(Interval.__add__, terms)


def _checked_rotation(rotation, n: int, name: str) -> tuple[np.ndarray, float]:
    """R, read-only, and a bound of the spectral norm of ``R^T R - 1``, 0 where it is the identity matrix exactly.

    Raises:
        IndicatorError: For a matrix that is no rotation.
    """
    try:
        found = np.array(np.eye(n) if rotation is None else rotation, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (n, n) or not np.isfinite(found).all():
        raise IndicatorError(f"{name}: rotation must be finite numbers of shape ({n}, {n}), got {rotation!r}")
    error = 0.0
    if not ((found == np.rint(found)).all() and (found.T @ found == np.eye(n)).all()):  # whole numbers are exact
        products = [
            sum((Interval(a) * b for a, b in zip(found[:, i], found[:, j], strict=True)), Interval(-float(i == j)))
            for i in range(n)
            for j in range(n)
        ]
        error = float(norm(products).high)
    if not error <= ORTHOGONAL:
        raise IndicatorError(f"{name}: rotation must be orthogonal, got a matrix R with |R^T R - 1| = {error:.3g}")
    found.setflags(write=False)
    return found, error
