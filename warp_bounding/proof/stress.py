"""What positives show where no proof does: a statistical test, an adversarial search, and a stress test.

All three put certain positives to the deployed kernels. None of them proves anything.

*Statistical test* (``statistical_test``). With N independent positives of a stated distribution and none denied, the
rate of false negatives *under that distribution* is below ``1 - alpha^(1/N)`` with confidence ``1 - alpha`` (Clopper
and Pearson 1934), about 3/N at 95 %. (Half of the positives come from each of two proposals, which only strengthens
this, by the inequality of the means.) The threshold is frozen first, by a search that earns no confidence, and the rule
that ends the count, a number or a time, must not depend on the answers. A failure lowers the threshold, and the count
begins anew. With enough attempts any bounder passes in the end; so attempt i (from 0) spends ``alpha / 2^(i+1)``, and
all of them together no more than alpha. Whoever made the bounder must not know the positives: to check one, take a
``fresh_seed``.

*Adversarial search* (``Walk``). From positives a population walks down f by random steps. The exact oracle checks every
query, and the deployed kernel computes its f, so a query that is found with f below a threshold is a false negative at
that threshold. Where a network is wrong in very little of the volume, no walk gets there, and no sample; but the boxes
that a proof cannot close do (``descend``): some of them, chosen at random, are halved again and again, and their
middles are queried.

*Stress test* (``stress_test``). Hard positives by the hundred million contradict proofs, kernels, compilers and
machines. ``HardStream`` asks points and regions, ``DistancePositives`` distances. Chunk k of a stream depends on the
seed and k alone, so that a test can be repeated.
"""

import contextlib
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates import Certificate, Verdict, document, fn_rate_bound
from warp_bounding.certificates.claim import OUTSIDE, as_fitted, in_local, mismatch
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.proof.search import ShapePositives, halve
from warp_bounding.queries import QUERIES, oracle
from warp_bounding.queries.boundary import FORMS, HardPositives, World, border_points, draw_positives
from warp_bounding.rounding import round_down
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, Shape

CONFIDENCE = 0.95  # 1 - alpha
POSITIVES = 1_000_000  # fresh positives of a statistical test
MOST_RESTARTS = 20  # attempts, each after the first with a lower threshold

OPEN = 32_768  # boxes of each generation of a descent
GENERATIONS = 12  # of them, an axis
DESCENT_SECONDS, DESCENT_SHARE = 120.0, 0.25  # at most, of a descent; of a test's time
ATTEMPT_SHARE, LEAST_SECONDS = 0.6, 1.0  # of the time that is left, for one attempt; at least, so that it asks a chunk
STARTS = 1024  # queries that walk
# Lengths of steps, in units of the domain's size:
JITTERS = (0.0, 1e-7, 1e-6, 1e-6, 1e-5, 1e-5, 1e-4, 1e-4, 1e-3, 1e-3, 1e-2)  # around the points of a proof
LONGEST, SHORTEST, FRESH = 0.05, 1e-7, 3e-3  # of a walk: the limits, and about the length that it begins with
LONGER, SHORTER = 1.6, 0.75  # factors of a step's length, after a success and after a failure
ROUNDS, RENEWED = 240, 24  # steps of a walk, and after how many the lower half of the queries replaces the upper one

QUERY_BATCH = 2**18  # queries that a stress test draws and asks at a time
CYCLE = ("float32",) * 6 + ("float64", "placed")  # the forms of successive chunks
DISTANCE_FORMS = ("balls", "nearest", "segments", "rays", "boxes")
WORLDS = 8  # placements that are tried, each gentler, before it is concluded that the certificate covers none
MOST_SEED = 2**63 - 1
POOL = 1 << 16  # border points of a shape, for distances
MOVES = (2.0**-26, 2.0**1)  # of the shape's longest side: the least and the largest move, radius, or side
ROUNDING = 2.0**-40  # relative: more than what a few sums, products and roots of float64 round


# --- statistical test ------------------------------------------------------------------------------------------------


def attempt_confidence(attempt: int, confidence: float = CONFIDENCE) -> float:
    """The confidence of attempt number ``attempt`` (from 0) with which all attempts together reach ``confidence``."""
    return 1.0 - (1.0 - confidence) * 0.5 ** (attempt + 1)


def fresh_seed() -> int:
    """A seed from the operating system's entropy, for positives that nobody could have fitted a bounder to."""
    return secrets.randbits(63)


def try_positives(
    bounder: Bounder,
    grid: Shape,
    count: int,
    seed: int | Sequence[int],
    budget: float = float("inf"),
) -> tuple[int, float, np.ndarray | None]:
    """Ask a bounder fresh positives.

    Args:
        bounder: Any bounder, with its threshold.
        grid: The object.
        count: How many positives to ask, at least.
        seed: Seed of the samples.
        budget: Seconds allowed: no chunk is begun that would end later if it took as long as the longest one before.
            Fewer positives are then asked, possibly none.

    Returns:
        How many were queried, the least f among them (as the device computes it), and the first query that was answered
        with *no* (``None`` if there is none; the count ends there).
    """
    started, done, least, longest = working_seconds(), 0, np.inf, 0.0
    chunks = draw_positives(bounder.query_kind, grid, count, seed, bounder.device, bounder.domain.oracle_length)
    while done < count and (begun := working_seconds()) - started + longest < budget:
        x = next(chunks)
        values = bounder.values(x).numpy()
        done, least = done + len(x), min(least, float(values.min(initial=np.inf)))
        missed = np.flatnonzero(values < bounder.threshold)
        if len(missed):
            return done, least, x[missed[np.argmin(values[missed])]]
        longest = max(longest, working_seconds() - begun)
    return done, least, None


def statistical_test(
    bounder: Bounder,
    grid: Shape,
    *,
    least: float,
    below: float,
    count: int = POSITIVES,
    seed: int = 0,
    budget: float = float("inf"),
) -> Certificate:
    """Set a threshold below the least value that a search has found, and give the bounder a statistical certificate.

    Args:
        bounder: Changed in place (``freeze``).
        grid: The object.
        least: Least f that is known of any positive.
        below: How far below it the threshold is set, beyond what rounding needs.
        count: How many fresh positives to ask.
        seed: Seed of these positives; every attempt draws others.
        budget: Seconds: where they do not suffice for ``count`` positives, there are fewer, but some.

    Raises:
        BounderError: If the bounder was made for another object; or if the threshold had to be lowered too often, as
            where the search found no low f at all.
    """
    if reason := mismatch(bounder, grid):
        raise BounderError(f"{bounder.method}: {reason}")
    started, error = working_seconds(), bounder.rounding_bound()
    for restart in range(MOST_RESTARTS):
        bounder.freeze(float(round_down(least - 2 * error - below)), None)
        left = budget - (working_seconds() - started)
        denied, opened = descend(bounder, grid, (seed, restart), min(DESCENT_SHARE * left, DESCENT_SECONDS))
        if len(denied):
            least = min(least, float(Walk(bounder, grid, seed).down(denied)[1].min()))
            continue
        # Fixed before an answer is known, so that the count's end does not depend on answers
        left = max(ATTEMPT_SHARE * (budget - (working_seconds() - started)), LEAST_SECONDS)
        done, lowest, missed = try_positives(bounder, grid, count, (seed, restart), left)
        if missed is None:
            break
        if not np.isfinite(lowest):
            outside = f"a {bounder.query_kind} that meets the object counts as outside the domain: {missed}"
            raise BounderError(f"{bounder.method}: {outside}")
        least = min(least, lowest)
    else:
        missed = f"{MOST_RESTARTS} thresholds in a row missed a positive {bounder.query_kind}"
        raise BounderError(f"{bounder.method}: {missed}")
    judged = attempt_confidence(restart)
    rate = fn_rate_bound(done, judged)
    before = f" after {restart} that missed one" if restart else ""
    message = (
        f"Statistical, not proven: {done:,} fresh positives ({QUERIES[bounder.query_kind].distribution}), "
        f"none answered with no; at {CONFIDENCE:.0%} confidence fewer than {rate:.2g} of such queries are missed "
        f"(attempt {restart + 1}{before}, judged at {judged:.6%}, so that all attempts together keep to "
        f"{CONFIDENCE:.0%})."
    )
    # No f was computed where every positive was answered without one, or none was queried.
    margin = lowest - float(bounder.threshold) if np.isfinite(lowest) else None
    counts = {"samples": done, "fn_rate_bound": rate, "confidence": CONFIDENCE, "worst_margin": margin}
    found = f", which found no denied positive in {opened:,} open boxes at last" if opened else ""
    numbers = f"The threshold was set by an adversarial search{found}. No proof was tried."
    verdict = Verdict("statistical", message, least, statistics=counts | {"restarts": restart})
    certificate = document(bounder, grid, verdict, working_seconds() - started, numbers)
    bounder.freeze(float(bounder.threshold), certificate)
    return certificate


# --- adversarial search ----------------------------------------------------------------------------------------------


def descend(
    bounder: Bounder, shape: Shape, seed: int | Sequence[int], budget: float = DESCENT_SECONDS
) -> tuple[np.ndarray, int]:
    """Positives that a bounder of points denies, looked for in the boxes that no proof at its threshold closes.

    Args:
        bounder: With its threshold.
        shape: The object, without cells; of others nothing is looked for.
        seed: Of the boxes that are followed where there are more than ``OPEN``.
        budget: Seconds after which no further generation begins.

    Returns:
        ``(K, n)`` float32 points that meet the object, all of them denied; and how many boxes were bounded.
    """
    of_others = isinstance(shape, Grid) or not shape.certified or bounder.domain is not bounder.domain.base
    if of_others or len(bounder.parts) > 1:
        return np.empty((0, shape.ndim), np.float32), 0
    positives, rng, started = ShapePositives(bounder, shape), np.random.default_rng(seed), working_seconds()
    target = float(np.nextafter(float(bounder.threshold) + bounder.rounding_bound(), np.inf))
    (low, high), found, boxes = positives.boxes(), [np.empty((0, shape.ndim), np.float32)], 0
    for _ in range(GENERATIONS * shape.ndim):
        if working_seconds() - started > budget:
            break
        bounds, boxes = positives.bound(low, high), boxes + len(low)
        left = np.flatnonzero(~(bounds.lower >= target))
        held = positives.tightened(low[left], high[left], bounds.part(left), np.full(len(left), target))
        open_ = np.flatnonzero(~(held.lower >= target))
        if not len(open_):
            break
        chosen = rng.choice(open_, OPEN // 2, replace=False) if len(open_) > OPEN // 2 else open_
        low, high = halve(*(side[chosen] for side in held.corners), held.axis[chosen])
        x = bounder.domain.to_object((low + high) / 2).astype(np.float32)
        x = x[~bounder.query(x).numpy()]
        found.append(x[shape.decide(x) == IN])
    return np.concatenate(found), boxes


class Walk:
    """Looks for positives with a low f.

    Args:
        bounder: The bounder whose f is computed; its threshold plays no part.
        grid: The object.
        seed: Seed of the steps.
    """

    def __init__(self, bounder: Bounder, grid: Shape, seed: int = 0):
        self.bounder, self.grid, self.query = bounder, grid, bounder.query_kind
        self._truth = oracle(self.query, grid, bounder.device, bounder.domain.oracle_length)
        self._rng = np.random.default_rng([seed, 77])

    def values(self, x: np.ndarray) -> np.ndarray:
        """The f of float32 queries as the device computes it; infinity for queries that do not meet the object."""
        values = self.bounder.values(x).numpy().copy()
        values[~self._truth(x)] = np.inf
        return values

    def around(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lowest positives at and close around queries ``(N, m)`` in object space, positives or not.

        Returns:
            ``(K, m)`` float32 and ``(K,)`` f, lowest first; none if no positive is there.
        """
        near = np.concatenate([self._moved(x, np.full(len(x), step)) for step in JITTERS])
        return self._lowest(near, self.values(near))

    def down(self, x: np.ndarray, rounds: int = ROUNDS) -> tuple[np.ndarray, np.ndarray]:
        """Walk from positives; returns what ``around`` does."""
        x, values = self._lowest(x, self.values(x))
        if not len(x):
            return x, values
        copies = -(-STARTS // len(x))
        x, values = np.tile(x, (copies, 1))[:STARTS], np.tile(values, copies)[:STARTS]
        steps = FRESH * 10.0 ** self._rng.uniform(-2, 1, len(x))
        for number in range(1, rounds + 1):
            tried = self._moved(x, steps)
            found = self.values(tried)
            better = found < values
            x[better], values[better] = tried[better], found[better]
            steps = np.clip(np.where(better, LONGER, SHORTER) * steps, SHORTEST, LONGEST)
            if number % RENEWED == 0:
                order, half = np.argsort(values, kind="stable"), len(x) // 2
                low, high = order[:half], order[len(x) - half :]
                x[high], values[high] = x[low], values[low]
                steps = FRESH * 10.0 ** self._rng.uniform(-3, 1, len(x))
        return self._lowest(x, values)

    def _lowest(self, x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(values, kind="stable")[:STARTS]
        order = order[np.isfinite(values[order])]
        return x[order].copy(), values[order].copy()

    def _moved(self, x: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Each query with some of its numbers moved by about its step, as a float32 query of its kind."""
        x = np.asarray(x, dtype=np.float64)
        move = self._rng.normal(size=x.shape) * steps[:, None] * (self._rng.random(x.shape) < 0.6)
        return QUERIES[self.query].nudged(self.grid, x, move).astype(np.float32)


# --- hard positives --------------------------------------------------------------------------------------------------


class Missed(NamedTuple):
    """A positive that was denied: its numbers as given to the bounder, their form, and the shape's placement."""

    query: list[float]
    form: str
    world: dict | None = None


class HardStream:
    """Hard positives put to a bounder: in float32, in float64, and in the world where its certificate covers that.

    Args:
        bounder: Who is queried.
        shape: The object.
        positives: Those of the shape, where they are known already.
    """

    def __init__(self, bounder: Bounder, shape: Shape, positives: HardPositives | None = None):
        self.bounder, self.shape, self.forms, self.cycle = bounder, shape, FORMS, CYCLE
        about = bounder.query_kind, shape, bounder.domain.oracle_length, bounder.device
        self.positives = positives or HardPositives(*about)

    def ask(self, seed: int, chunk: int, count: int) -> tuple[str, int, Missed | None]:
        """Ask a chunk of the stream: its form, how many certain positives it has, and the first one that was missed."""
        form, options, world = self.cycle[chunk % len(self.cycle)], {}, None
        if form == "placed":
            world, options = self._placement(np.random.default_rng([seed, chunk, 1]))
            form = form if world else "float32"
        x = self.positives.draw(seed, chunk, count, form, world)
        missed = np.flatnonzero(~self.bounder.query(x, **options).numpy())
        if not len(missed):
            return form, len(x), None
        placed = {name: np.asarray(value).tolist() for name, value in options.items()} or None
        return form, len(x), Missed(x[missed[0]].tolist(), form, placed)

    def _placement(self, rng: np.random.Generator) -> tuple[World | None, dict]:
        """A placement that the bounder's certificate covers; each one that is tried is gentler than the one before."""
        kind, n = self.positives.kind, self.shape.ndim
        for gentle in range(WORLDS):
            world, options = random_world(self.shape, rng, gentle, exact=kind.is_region)
            with contextlib.suppress(QueryError):
                self.bounder.query(np.zeros((0, kind.columns(n)), np.float32), **options)
                return world, options
        return None, {}


def random_world(shape: Shape, rng: np.random.Generator, gentle: int = 0, exact: bool = False) -> tuple[World, dict]:
    """A random placement of a shape, without a move in time.

    Args:
        shape: The shape.
        rng: Of the placement.
        gentle: How often the ranges of translations and of the scale's exponent are halved.
        exact: A signed permutation and 1 or 2 times the size: float32 queries of the shape stay float32 in the world.

    Returns:
        The map, and the ``xform`` and ``scale`` that bounders take for it.
    """
    n, first = shape.ndim, int(shape.time)
    spatial, share = n - first, 0.5**gentle
    rotation, _ = np.linalg.qr(rng.normal(size=(spatial, spatial)))
    if exact or rng.random() < 0.25:
        rotation = np.eye(spatial)[rng.permutation(spatial)] * rng.choice([-1.0, 1.0], spatial)
    scale = np.full(spatial, 2.0 ** rng.integers(2)) if exact else np.exp2(rng.uniform(-1, 1, spatial) * share)
    position = rng.uniform(-1, 1, spatial) * (shape.upper - shape.lower)[first:].max() * share * (not exact)
    forward, inverse, translation, matrix = np.eye(n), np.eye(n), np.zeros(n), np.eye(spatial + 1)
    forward[first:, first:], inverse[first:, first:] = rotation * scale, rotation.T / scale[:, None]
    translation[first:], matrix[:-1, :-1], matrix[:-1, -1] = position, rotation, position
    return World(forward, inverse, translation), {"xform": matrix, "scale": scale}


class DistancePositives:
    """Hard positives of a distance: balls, segments, rays, swept balls and boxes that barely touch the object.

    Each is certain, from certified points p of the object and certified upper bounds of distances, in float64 with a
    margin for its rounding; one that is answered with *no*, or a time of contact behind one that is known, is a false
    negative. Of a shape that moves, p is a point of time and space: balls are queried at its time, and segments pass it
    then.

    Args:
        bounder: Who is queried.
        shape: The object.

    Raises:
        BounderError: If no point of the object was found.
    """

    def __init__(self, bounder: DistanceBounder, shape: Shape):
        self.bounder, self.shape, self.size = bounder, shape, float(shape.extent.max())
        self.speed = bounder.domain.speed if bounder.domain.time else None
        # rays are of shapes at rest
        self.forms = DISTANCE_FORMS if self.speed is None else tuple(f for f in DISTANCE_FORMS if f != "rays")
        self._seed, self._pool = None, np.zeros((0, shape.ndim), np.float32)

    def ask(self, seed: int, chunk: int, count: int) -> tuple[str, int, Missed | None]:
        """See ``HardStream.ask``."""
        form, rng = self.forms[chunk % len(self.forms)], np.random.default_rng([seed, chunk])
        if seed != self._seed:
            x = border_points(self.shape, POOL, np.random.default_rng([seed, 17])).astype(np.float32)
            self._seed, self._pool = seed, x[self.shape.decide(x) == IN]
        if not len(self._pool):
            raise BounderError(f"{self.shape.name}: no point was found that is certainly in the object")
        p = self._pool[rng.integers(len(self._pool), size=count)].astype(np.float64)
        missed, numbers = getattr(self, f"_{form}")(p, rng)
        if not missed.any():
            return form, len(missed), None
        query = [float(v) for values in numbers.values() for v in np.ravel(values[np.argmax(missed)])]
        return form, len(missed), Missed(query, f"{form}: {', '.join(numbers)}")

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
        radius = _up(np.linalg.norm(x.astype(np.float64) - p, axis=1) * (1 + ROUNDING))
        return ~self.bounder.query(x, radius).numpy(), {"x": x, "radius": radius}

    def _nearest(self, p: np.ndarray, rng: np.random.Generator):
        x = (p + self._moves(len(p), rng) * self._directions(len(p), rng)).astype(np.float32)
        known = self.shape.distances(x)
        if known is None:
            return self._balls(p, rng)
        x, radius = x[np.isfinite(known[:, 1])], _up(known[np.isfinite(known[:, 1]), 1])
        missed = ~self.bounder.query(x, radius).numpy() | (self.bounder.distance(x).numpy() > radius)
        return missed, {"x": x, "radius": radius}

    def _segments(self, p: np.ndarray, rng: np.random.Generator):
        count = len(p)
        d, aside = self._directions(count, rng), self._moves(count, rng) * self._directions(count, rng)
        aside *= rng.random((count, 1)) > 0.5
        back, forth = (self._moves(count, rng) * (rng.random((count, 1)) > 0.1) for _ in "bf")
        if self.speed is not None:
            span = (self.shape.upper[0] - self.shape.lower[0]) / self.size
            d[:, 0] = rng.normal(size=count) * (rng.random(count) > 0.2) * span
        a, b = ((p + aside + way * d).astype(np.float32) for way in (-back, forth))
        if self.speed is not None:  # within the times at which the shape is there, and p's between both
            a[:, 0], b[:, 0] = (np.clip(x[:, 0], self.shape.lower[0], self.shape.upper[0]) for x in (a, b))
        time, radius = _passing(a.astype(np.float64), b.astype(np.float64) - a, p, self.speed)
        maybe, t = (part.numpy() for part in self.bounder.segments(a, b, radius, steps=int(rng.integers(1, 80))))
        return ~maybe | (t > time), {"start": a, "end": b, "radius": radius}

    def _rays(self, p: np.ndarray, rng: np.random.Generator):
        count = len(p)
        d = (self._directions(count, rng) * np.exp2(rng.uniform(-20, 20, (count, 1)))).astype(np.float32)
        unit = d.astype(np.float64) / np.linalg.norm(d.astype(np.float64), axis=1, keepdims=True)
        o = (p - self._moves(count, rng) * unit).astype(np.float32)
        length = _up(np.linalg.norm(p - o, axis=1) * rng.uniform(1.0, 2.0, count))
        time, radius = _passing(o.astype(np.float64), unit * length[:, None].astype(np.float64), p)
        found = self.bounder.rays(np.concatenate([o, d], axis=1), length=length, radius=radius)
        maybe, t = (part.numpy() for part in found)
        return ~maybe | (t > time), {"origin": o, "direction": d, "length": length, "radius": radius}

    def _boxes(self, p: np.ndarray, rng: np.random.Generator):
        count, n = p.shape
        sides = self._moves(count * n, rng, 1.0).reshape(count, n) * (rng.random((count, n)) > 0.2)
        share = np.where(rng.random((count, n)) < 0.5, rng.integers(0, 2, (count, n)), rng.random((count, n)))
        low, high = (p - share * sides).astype(np.float32), (p + (1 - share) * sides).astype(np.float32)
        low, high = np.minimum(low, p).astype(np.float32), np.maximum(high, p).astype(np.float32)
        missed = ~self.bounder.boxes(low, high, steps=int(rng.integers(1, 120))).numpy()
        return missed, {"lower": low, "upper": high}


def _up(x: np.ndarray) -> np.ndarray:
    """float32 numbers that are not below."""
    return np.nextafter(x.astype(np.float32), np.float32(np.inf))


def _passing(a: np.ndarray, w: np.ndarray, p: np.ndarray, speed: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """When ``a + t w`` passes p nearest, and a radius that reaches p then; the time is not before that, up to rounding.

    With a speed coordinate 0 is time: then where a point is at p's time, or where it passes p nearest if its time
    stands still.
    """
    space = slice(int(speed is not None), None)
    square = (w[:, space] ** 2).sum(axis=1)
    time = ((p - a) * w)[:, space].sum(axis=1) / np.where(square > 0, square, 1.0)
    if speed is not None:
        time = np.where(w[:, 0] != 0, (p - a)[:, 0] / np.where(w[:, 0] != 0, w[:, 0], 1.0), time)
    time = np.clip(time, 0.0, 1.0)
    at, size = a + time[:, None] * w, np.abs(a).sum(axis=1) + np.abs(w).sum(axis=1) + np.abs(p).sum(axis=1)
    away = np.linalg.norm((at - p)[:, space], axis=1)
    if speed is not None:  # what is left of p's time, its point may have moved
        away += speed * np.abs(at[:, 0] - p[:, 0]) * (1 + ROUNDING)
        size *= 1 + speed
    return time, _up(away * (1 + ROUNDING) + 2.0**-48 * size)


# --- stress test -----------------------------------------------------------------------------------------------------


@dataclass
class StressResult:
    """How far a stress test has come.

    Example:
        >>> from warp_bounding.proof import stress_test
        >>> result = stress_test(bounder, grid, 10_000, seed=1)
        >>> result.missed is None, result.done >= result.wanted, result.query
        (True, True, 'point')
    """

    method: str  #: The bounder's method
    query: str  #: Kind of query
    seed: int  #: Seed of the stream
    wanted: int  #: Positives that were to be queried
    indicator: str  #: SHA-256 of the shape
    done: int = 0  #: Positives asked in whole chunks; the chunk with a missed one is not among them
    forms: dict[str, int] = field(default_factory=dict)  #: Positives asked in each form
    seconds: float = 0.0  #: Time taken
    missed: list[float] | None = None  #: The first query that was answered with no, as given to the bounder
    missed_form: str | None = None  #: Its form: float32, float64, placed; of a distance: balls, segments, ...
    missed_world: dict | None = None  #: Where the shape was placed for it: ``xform`` (a matrix) and ``scale``
    interrupted: bool = False  #: Whether Ctrl-C ended the test


def stress_test(
    bounder: Bounder | str | Path,
    shape,
    count: int = 100_000_000,
    *,
    seed: int | None = None,
    progress: Callable[[int, int, str], None] | None = None,
    budget: float = float("inf"),
) -> StressResult:
    """Ask a bounder hard positives until one is missed, or enough were queried.

    Args:
        bounder: The bounder, or the path of its file.
        shape: The shape that it bounds, or anything that ``load_shape`` takes.
        count: Positives to ask. Whole chunks are queried, so there may be some more.
        seed: Seed of the stream, from 0 to 2^63 - 1; a fresh one if ``None``.
        progress: Called after each chunk with positives asked, wanted, and a note.
        budget: Seconds allowed.

    Returns:
        What was done. Ctrl-C ends the test, and the result says so.

    Raises:
        QueryError: For a shape that the bounder's claim cannot be about, as one of another dimension, or a count or
            seed out of range.
    """
    seed = fresh_seed() if seed is None else seed
    for name, value, least, most in (("count", count, 1, 2**62), ("seed", seed, 0, MOST_SEED)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not least <= value <= most:
            raise QueryError(f"{name} must be a whole number from {least} to {most}, got {value!r}")
    bounder, shape = in_local(bounder_of(bounder), shape)
    shape = as_fitted(bounder, shape)
    if (other := mismatch(bounder, shape)) and other != OUTSIDE:
        raise QueryError(other)
    stream = (DistancePositives if bounder.of_distances else HardStream)(bounder, shape)
    result = StressResult(bounder.method, bounder.query_kind, int(seed), int(count), shape.digest)
    result.forms, started, chunk = dict.fromkeys(stream.forms, 0), time.perf_counter(), 0
    try:
        while result.missed is None and result.done < count and time.perf_counter() - started < budget:
            form, queried, missed = stream.ask(result.seed, chunk, QUERY_BATCH)
            chunk += 1
            if missed is not None:
                result.missed, result.missed_form, result.missed_world = missed
            else:
                result.done += queried
                result.forms[form] += queried
            result.seconds = round(time.perf_counter() - started, 3)
            if progress:
                rate = result.done / max(result.seconds, 1e-9) / 1e6
                progress(min(result.done, result.wanted), result.wanted, f"{rate:.1f} million/s")
    except KeyboardInterrupt:
        result.interrupted = True
    return result
