"""A shape that moves through time: from keyframe to keyframe on straight ways, certified in time and space at once."""

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.functions.combination import Combination, check_parts
from warp_bounding.indicators.functions.intervals import Interval, widened
from warp_bounding.indicators.shape import Shape

__all__ = ["Extrusion"]


class Extrusion(Combination):
    """A shape in space and time, time first: at time t it is the shape, moved by the offset at t.

    Offsets go straight from one keyframe to the next. Before the first and after the last one there is nothing, and
    nothing is known there: bounders answer with *maybe*. The margin and distances are those in space, at each time.

    Args:
        shape: Any shape of n coordinates, none of them time.
        times: ``(K,)``, ascending, at least two; rounded to float32, as those of ``IndicatorMotion``.
        offsets: ``(K, n)``, where the shape's origin is at each keyframe, object space.
        name: For people.

    Raises:
        IndicatorError: For no shape, or one of time; for times that do not ascend, or numbers that are not finite.

    Example:
        >>> thrown = wb.solids.Extrusion(wb.solids.Sphere([0, 0], 0.5), [0, 1, 2], [[0, 0], [2, 1], [4, 0]])
        >>> thrown.contains(np.array([[1.0, 2.0, 1.0], [1.5, 3.0, 0.5], [1.5, 2.0, 1.0]]))
        array([ True,  True, False])
        >>> thrown.empty(np.array([[0.0, 1.5, -1.0]]), np.array([[0.25, 9.0, 9.0]]))
        array([ True])
    """

    def __init__(self, shape: Shape, times, offsets, *, name: str = "extrusion"):
        check_parts((shape,), name)
        if shape.time:
            raise IndicatorError(f"{name}: expected a shape at rest, and {shape.name} moves already")
        with np.errstate(over="ignore"):
            self.times = np.array(times, dtype=np.float32).astype(np.float64)
        self.offsets = np.array(offsets, dtype=np.float64)
        if self.times.ndim != 1 or len(self.times) < 2 or not (np.diff(self.times) > 0).all():
            raise IndicatorError(f"{name}: expected two or more ascending float32 times, got {times}")
        expected = len(self.times), shape.ndim
        if self.offsets.shape != expected or not (np.isfinite(self.offsets).all() and np.isfinite(self.times).all()):
            raise IndicatorError(f"{name}: expected finite offsets of shape {expected}, got {offsets!r}")
        lower = widened(shape.lower, -self.offsets.min(axis=0), -1)
        upper = widened(shape.upper, self.offsets.max(axis=0), 1)
        corners = np.r_[self.times[0], lower], np.r_[self.times[-1], upper]
        super().__init__((shape,), *corners, [self.times, self.offsets], name)
        self.time, self.certified, self.exact = True, shape.certified, self._solids[0].exact

    def _gap(self, box: list[Interval]) -> Interval:
        time, *space = box
        first, last = self.times[0], self.times[-1]
        away = (time.low > last) | (time.high < first)
        begin, end = (np.clip(each, first, last) for each in (time.low, time.high))
        gap = self._gaps([x - p for x, p in zip(space, self._offsets(begin, end), strict=True)])[0]
        partly = (time.low < first) | (time.high > last)
        return Interval(np.where(away, np.inf, gap.low), np.where(partly, np.inf, gap.high))

    def _offsets(self, begin: np.ndarray, end: np.ndarray) -> list[Interval]:
        """What each coordinate of the offset is between two times: what it is at both, and at keyframes between."""
        low, high = np.full((2, len(self.offsets[0]), len(begin)), np.inf)
        high = -high
        for time in (begin, end):
            for k, place in enumerate(self._offset(time)):
                low[k], high[k] = np.minimum(low[k], place.low), np.maximum(high[k], place.high)
        for time, offset in zip(self.times, self.offsets, strict=True):
            within = (begin <= time) & (time <= end)
            low[:, within] = np.minimum(low[:, within], offset[:, None])
            high[:, within] = np.maximum(high[:, within], offset[:, None])
        return [Interval(a, b) for a, b in zip(low, high, strict=True)]

    def _offset(self, time: np.ndarray) -> list[Interval]:
        """Each coordinate of the offset at a time within the range; at keyframes exactly."""
        k = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        k = np.where(np.isnan(time), 0, k)
        start = self.times[k]
        share = (Interval(time) - start) / (Interval(self.times[k + 1]) - start)
        found = []
        for a, b in zip(self.offsets[k].T, self.offsets[k + 1].T, strict=True):
            between = (Interval(b) - a) * share + a
            found.append(between.both(Interval(np.minimum(a, b), np.maximum(a, b))))
        return found

    def landmarks(self) -> np.ndarray:
        own = self.parts[0].landmarks()
        placed = [
            np.insert(own + offset, 0, time, axis=1) for time, offset in zip(self.times, self.offsets, strict=True)
        ]
        return np.concatenate(placed)
