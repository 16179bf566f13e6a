"""Hard positives of a distance: balls, segments, rays, swept balls and boxes that barely touch the object.

Each is certain by construction, from certified points of the object (p, float32) and certified upper bounds of distances, in float64 with
room for its rounding; one that is answered with *no*, or a time of contact behind one that is known, is a false negative.

Of a shape that moves, p is a point of time and space: balls are asked at its time, and segments pass it then.
"""

from typing import Any

import numpy as np

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.errors import BounderError
from warp_bounding.indicators.shape import IN, Shape
from warp_bounding.queries.boundary import border_points

__all__ = ["DISTANCE_FORMS", "DistancePositives"]

DISTANCE_FORMS = ("balls", "nearest", "segments", "rays", "boxes")
POOL = 1 << 16  # border points
MOVES = (2.0**-26, 2.0**1)  # of the shape's longest side: the least and the largest move, radius, or side
ROOM = 2.0**-40  # relative: more than what a few sums, products and roots of float64 round


class DistancePositives:
    """A stream of hard positives of one shape, that depends on the seed alone.

    Args:
        bounder: Who is asked.
        shape: The object.

    Raises:
        BounderError: If no point of the object was found.
    """

    def __init__(self, bounder: DistanceBounder, shape: Shape):
        self.bounder, self.shape, self.size = bounder, shape, float(shape.extent.max())
        self.speed, self.forms = None, DISTANCE_FORMS
        if bounder.domain.time:
            self.speed = bounder.domain.speed
            self.forms = tuple(form for form in DISTANCE_FORMS if form != "rays")  # these are of shapes at rest
        self._seed, self._pool = None, np.zeros((0, shape.ndim), np.float32)

    def _points(self, seed: int, count: int, rng: np.random.Generator) -> np.ndarray:
        if seed != self._seed:
            x = border_points(self.shape, POOL, np.random.default_rng([seed, 17])).astype(np.float32)
            self._seed, self._pool = seed, x[self.shape.decide(x) == IN]
        if not len(self._pool):
            raise BounderError(f"{self.shape.name}: no point was found that is certainly in the object")
        return self._pool[rng.integers(len(self._pool), size=count)].astype(np.float64)

    def ask(self, seed: int, chunk: int, count: int) -> tuple[str, int, dict[str, Any] | None]:
        """Ask a chunk of the stream: its form, how many certain positives it has, and the first one that was missed."""
        form, rng = self.forms[chunk % len(self.forms)], np.random.default_rng([seed, chunk])
        asked, missed = getattr(self, f"_{form}")(self._points(seed, count, rng), rng)
        return form, asked, missed

    def _moves(self, count: int, rng: np.random.Generator, largest: float = MOVES[1]) -> np.ndarray:
        return np.exp2(rng.uniform(np.log2(MOVES[0]), np.log2(largest), (count, 1))) * self.size

    def _directions(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Unit vectors, of space."""
        d = rng.normal(size=(count, self.shape.ndim)) * (rng.random((count, self.shape.ndim)) > 0.2)
        if self.speed is not None:
            d[:, 0] = 0.0
        length = np.linalg.norm(d, axis=1, keepdims=True)
        return np.where(length > 0, d / np.where(length > 0, length, 1.0), np.eye(self.shape.ndim)[-1])

    def _balls(self, p: np.ndarray, rng: np.random.Generator):
        x = (p + self._moves(len(p), rng) * self._directions(len(p), rng)).astype(np.float32)
        radius = _up(np.linalg.norm(x.astype(np.float64) - p, axis=1) * (1 + ROOM))
        missed = self.bounder.query(x, radius).numpy() == 0
        return len(p), _first(missed, x=x, radius=radius)

    def _nearest(self, p: np.ndarray, rng: np.random.Generator):
        x = (p + self._moves(len(p), rng) * self._directions(len(p), rng)).astype(np.float32)
        known = self.shape.distances(x)
        if known is None:
            return self._balls(p, rng)
        x, radius = x[np.isfinite(known[:, 1])], _up(known[np.isfinite(known[:, 1]), 1])
        missed = (self.bounder.query(x, radius).numpy() == 0) | (self.bounder.distance(x).numpy() > radius)
        return len(x), _first(missed, x=x, radius=radius)

    def _segments(self, p: np.ndarray, rng: np.random.Generator):
        count = len(p)
        d, aside = self._directions(count, rng), self._moves(count, rng) * self._directions(count, rng)
        aside *= rng.random((count, 1)) > 0.5
        back, forth = (self._moves(count, rng) * (rng.random((count, 1)) > 0.1) for _ in "bf")
        if self.speed is not None:
            d[:, 0] = (
                rng.normal(size=count)
                * (rng.random(count) > 0.2)
                * (self.shape.upper[0] - self.shape.lower[0])
                / self.size
            )
        a, b = ((p + aside + way * d).astype(np.float32) for way in (-back, forth))
        if self.speed is not None:  # within the times at which the shape is there, and p's between both
            a[:, 0], b[:, 0] = (np.clip(x[:, 0], self.shape.lower[0], self.shape.upper[0]) for x in (a, b))
        time, radius = _passing(a.astype(np.float64), b.astype(np.float64) - a, p, self.speed)
        maybe, t = (part.numpy() for part in self.bounder.segments(a, b, radius, steps=int(rng.integers(1, 80))))
        return count, _first((maybe == 0) | (t > time), start=a, end=b, radius=radius)

    def _rays(self, p: np.ndarray, rng: np.random.Generator):
        count = len(p)
        d = (self._directions(count, rng) * np.exp2(rng.uniform(-20, 20, (count, 1)))).astype(np.float32)
        unit = d.astype(np.float64) / np.linalg.norm(d.astype(np.float64), axis=1, keepdims=True)
        o = (p - self._moves(count, rng) * unit).astype(np.float32)
        length = _up(np.linalg.norm(p - o, axis=1) * rng.uniform(1.0, 2.0, count))
        time, radius = _passing(o.astype(np.float64), unit * length[:, None].astype(np.float64), p)
        maybe, t = (
            part.numpy() for part in self.bounder.rays(np.concatenate([o, d], axis=1), length=length, radius=radius)
        )
        missed = (maybe == 0) | (t > time)
        return count, _first(missed, origin=o, direction=d, length=length, radius=radius)

    def _boxes(self, p: np.ndarray, rng: np.random.Generator):
        count, n = p.shape
        sides = self._moves(count * n, rng, 1.0).reshape(count, n) * (rng.random((count, n)) > 0.2)
        share = np.where(rng.random((count, n)) < 0.5, rng.integers(0, 2, (count, n)), rng.random((count, n)))
        low, high = (p - share * sides).astype(np.float32), (p + (1 - share) * sides).astype(np.float32)
        low, high = np.minimum(low, p).astype(np.float32), np.maximum(high, p).astype(np.float32)
        missed = self.bounder.boxes(low, high, steps=int(rng.integers(1, 120))).numpy() == 0
        return count, _first(missed, lower=low, upper=high)


def _up(x: np.ndarray) -> np.ndarray:
    """float32 numbers that are not below."""
    return np.nextafter(x.astype(np.float32), np.float32(np.inf))


def _passing(a: np.ndarray, w: np.ndarray, p: np.ndarray, speed: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """When ``a + t w`` passes p nearest, and a radius that reaches p then; the time is not before that, up to rounding.

    With a speed coordinate 0 is time: then where a point is at p's time, or where it passes p nearest if its time stands still.
    """
    first = 0 if speed is None else 1
    space = slice(first, None)
    square = (w[:, space] ** 2).sum(axis=1)
    time = ((p - a) * w)[:, space].sum(axis=1) / np.where(square > 0, square, 1.0)
    size = np.abs(a).sum(axis=1) + np.abs(w).sum(axis=1) + np.abs(p).sum(axis=1)
    if first:
        goes = w[:, 0] != 0
        time = np.where(goes, (p - a)[:, 0] / np.where(goes, w[:, 0], 1.0), time)
    time = np.clip(time, 0.0, 1.0)
    at = a + time[:, None] * w
    away = np.linalg.norm((at - p)[:, space], axis=1)
    if first:  # what is left of p's time, its point may have moved
        away += speed * np.abs(at[:, 0] - p[:, 0]) * (1 + ROOM)
        size *= 1 + speed
    return time, _up(away * (1 + ROOM) + 2.0**-48 * size)


def _first(missed: np.ndarray, **numbers: np.ndarray) -> dict[str, Any] | None:
    """The numbers of the first query that was missed, or ``None``."""
    if not missed.any():
        return None
    return {name: np.asarray(values[np.argmax(missed)]).tolist() for name, values in numbers.items()}
