"""Soak test: a bounder is asked a hundred million hard positives, as it is deployed, and may deny none.

The queries (``HardPositives``) are certain positives by construction, made on the device and asked through the batch
kernel that users call: most in float32, an eighth in float64 (which the bounder rounds), an eighth in the world,
through ``xform=`` and ``scale=``, where the bounder's certificate covers such placements. A soak test proves nothing
and sets no confidence for queries of another distribution; its purpose is to contradict proofs, kernels, compilers and
machines. A false negative is confirmed in rational arithmetic before it is reported.

The stream of queries depends on the seed alone, so that a soak test can be stopped, resumed and repeated: chunk ``k``
of ``CHUNK`` queries is always the same.
"""

import contextlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates.claim import OUTSIDE, as_fitted, in_local, mismatch
from warp_bounding.errors import BounderError, FileFormatError, QueryError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.proof.attest.statistics import fresh_seed
from warp_bounding.proof.distances.soak import DISTANCE_FORMS, DistancePositives
from warp_bounding.queries import QUERIES
from warp_bounding.queries.hard import FORMS, HardPositives, HardShapePositives, World
from warp_bounding.runtime.whole_file import check_writable, write_whole

__all__ = ["CHUNK", "Soak", "random_world", "soak", "soak_grid"]

CHUNK = 2**18  # queries that are drawn and asked at a time
CYCLE = ("float32",) * 6 + ("float64", "placed")  # the forms of successive chunks
SAVED_EVERY = 2.0  # seconds between two writings of the state
WORLDS = 8  # placements that are tried before it is concluded that the certificate covers none
MOST_SEED = 2**63 - 1
STATE = 2  # version of the state file


@dataclass
class Soak:
    """How far a soak test has come.

    Attributes:
        method: The bounder's method.
        query: Kind of query.
        seed: Seed of the stream.
        wanted: Positives that were to be asked.
        done: Positives asked in whole chunks; the chunk with a missed one is not among them.
        chunks: Whole chunks of the stream that are done.
        forms: Positives asked in each form: float32, float64, placed; of a distance: balls, nearest, segments, rays, boxes.
        seconds: Time taken, earlier parts of a resumed soak included.
        missed: The first query that was answered with no, as given to the bounder, or ``None``.
        missed_form: The form of that query.
        missed_world: Where the shape was placed, for a query in the world: ``xform`` (a matrix) and ``scale``.
        interrupted: Whether Ctrl-C ended the test.
        bounder: SHA-256 of its tensors, domain and threshold.
        indicator: SHA-256 of the cells.

    Example:
        >>> from warp_bounding.proof import soak
        >>> result = soak(bounder, grid, 10_000, seed=1)
        >>> result.missed is None, result.complete
        (True, True)
    """

    method: str
    query: str
    seed: int
    wanted: int
    bounder: str
    indicator: str
    done: int = 0
    chunks: int = 0
    forms: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FORMS, 0))
    seconds: float = 0.0
    missed: list[float] | None = None
    missed_form: str | None = None
    missed_world: dict | None = None
    interrupted: bool = False

    @property
    def complete(self) -> bool:
        """Whether as many as wanted were asked, or a false negative was found.

        Example:
            >>> soak(bounder, grid, 1000, seed=1).complete
            True
        """
        return self.done >= self.wanted or self.missed is not None

    @property
    def rate(self) -> float:
        """Positives per second.

        Example:
            >>> soak(bounder, grid, 1000, seed=1).rate > 0
            True
        """
        return self.done / self.seconds if self.seconds else 0.0

    def to_dict(self) -> dict:
        """JSON-ready.

        Example:
            >>> soak(bounder, grid, 1000, seed=1).to_dict()["query"]
            'point'
        """
        return asdict(self)


def soak_grid(bounder: Bounder, shape) -> IndicatorGrid:
    """A shape's cells, made as they were for the fit.

    Raises:
        QueryError: If the bounder's claim cannot be about the shape, as where it is of another dimension.
    """
    grid = as_fitted(bounder, shape)
    if (other := mismatch(bounder, grid)) and other != OUTSIDE:
        raise QueryError(other)
    return grid


def soak(
    bounder: Bounder | str | Path,
    shape,
    count: int = 100_000_000,
    *,
    seed: int | None = None,
    state: str | Path | None = None,
    progress: Callable[[int, int, str], None] | None = None,
    seconds: float = float("inf"),
) -> Soak:
    """Ask a bounder hard positives until one is missed, or enough were asked.

    Args:
        bounder: The bounder, or the path of its file.
        shape: The shape that it bounds, or anything that ``load_indicator`` takes.
        count: Positives to ask. Whole chunks are asked, so there may be some more.
        seed: Seed of the stream, from 0 to 2^63 - 1; if ``None`` the one of the state, or a fresh one.
        state: JSON file that is written during the test. If it exists, the test is continued from it, and the seed must
            be the same.
        progress: Called after each chunk with positives asked, wanted, and a note.
        seconds: Time allowed for this call.

    Returns:
        What was done. Ctrl-C ends the soak, and the result says so.

    Raises:
        QueryError: For a shape of another dimension, or a count or seed out of range.
        FileFormatError: If the state cannot be read or written, or belongs to another bounder, shape or seed.
    """
    _check_whole("count", count, 1, 2**62)
    if seed is not None:
        _check_whole("seed", seed, 0, MOST_SEED)
    bounder, shape = in_local(bounder_of(bounder), shape)
    grid = soak_grid(bounder, shape)
    fresh = Soak(bounder.method, bounder.query_kind, -1, int(count), _digest(bounder), grid.digest)
    if isinstance(bounder, DistanceBounder):
        fresh.forms = dict.fromkeys(DISTANCE_FORMS, 0)
    result = _resumed(fresh, None if seed is None else int(seed), state)
    if state is not None:
        check_writable(state)
    started = saved = time.perf_counter()
    before = result.seconds
    if isinstance(bounder, DistanceBounder):
        positives = DistancePositives(bounder, grid)
    elif isinstance(grid, IndicatorGrid):
        positives = HardPositives(bounder.query_kind, grid, bounder.domain.oracle_length, bounder.device)
    else:
        positives = HardShapePositives(bounder.query_kind, grid, bounder.domain.oracle_length, bounder.device)
    try:
        while not result.complete and time.perf_counter() - started < seconds:
            (_of_distances if isinstance(bounder, DistanceBounder) else _chunk)(bounder, grid, positives, result)
            result.seconds = round(before + time.perf_counter() - started, 3)
            if progress:
                progress(min(result.done, result.wanted), result.wanted, f"{result.rate / 1e6:.1f} million/s")
            if state is not None and time.perf_counter() - saved > SAVED_EVERY:
                _save(result, state)
                saved = time.perf_counter()
    except KeyboardInterrupt:
        result.interrupted = True
    result.seconds = round(before + time.perf_counter() - started, 3)
    if state is not None:
        _save(result, state)
    return result


def _check_whole(name: str, value, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not least <= value <= most:
        raise QueryError(f"{name} must be a whole number from {least} to {most}, got {value!r}")


def _chunk(bounder: Bounder, grid: IndicatorGrid, positives: HardPositives, result: Soak) -> None:
    """Ask one chunk. ``result`` is changed only at the end, so that an interruption leaves no half of a chunk in it."""
    form, options, world = CYCLE[result.chunks % len(CYCLE)], {}, None
    if form == "placed":
        world, options = _placement(bounder, grid, positives, result)
        form = form if world else "float32"
    x, certain = positives.draw(result.seed, result.chunks * CHUNK, CHUNK, form, world)
    answers = bounder.query(x.numpy() if form == "float64" else x, **options).numpy()
    certain = certain.numpy() != 0
    missed = np.flatnonzero(certain & (answers == 0))
    if len(missed):
        query = x.numpy()[missed[0]]
        if world is None and not QUERIES[positives.query].certain(grid, query[None], positives.length)[0]:
            raise BounderError(f"the soak drew a {result.query} that does not meet the object: {query.tolist()}")
        result.missed, result.missed_form = [float(v) for v in query], form
        if world:
            result.missed_world = {k: np.asarray(v).tolist() for k, v in options.items()}
        return
    count = int(certain.sum())
    result.done, result.chunks = result.done + count, result.chunks + 1
    result.forms[form] += count


def _of_distances(bounder: DistanceBounder, grid: Shape, positives: DistancePositives, result: Soak) -> None:
    """Ask one chunk of a distance."""
    form, count, missed = positives.ask(result.seed, result.chunks, CHUNK)
    if missed is not None:
        result.missed = [float(v) for value in missed.values() for v in np.ravel(value)]
        result.missed_form = f"{form}: {', '.join(missed)}"
        return
    result.done, result.chunks = result.done + count, result.chunks + 1
    result.forms[form] += count


def random_world(grid: IndicatorGrid, rng: np.random.Generator, gentle: int = 0) -> tuple[World, dict]:
    """A random placement of a shape.

    Args:
        grid: The shape; its time is not moved.
        rng: Source of everything random.
        gentle: How often the range of translations, and that of the scale's exponent, is halved.

    Returns:
        The map, and the ``xform`` and ``scale`` that bounders take for it.
    """
    n, first = grid.ndim, int(grid.time)
    spatial, share = n - first, 0.5**gentle
    rotation, _ = np.linalg.qr(rng.normal(size=(spatial, spatial)))
    if rng.random() < 0.25:  # a signed permutation: boxes stay boxes
        rotation = np.eye(spatial)[rng.permutation(spatial)] * rng.choice([-1.0, 1.0], spatial)
    scale = np.exp2(rng.uniform(-1, 1, spatial) * share)
    size = (grid.upper - grid.lower)[first:].max()
    position = rng.uniform(-1, 1, spatial) * size * share
    forward, inverse, translation = np.eye(n), np.eye(n), np.zeros(n)
    forward[first:, first:] = rotation * scale
    inverse[first:, first:] = rotation.T / scale[:, None]
    translation[first:] = position
    matrix = np.eye(spatial + 1)
    matrix[:-1, :-1], matrix[:-1, -1] = rotation, position
    return World(forward, inverse, translation), {"xform": matrix, "scale": scale}


def _placement(
    bounder: Bounder, grid: IndicatorGrid, positives: HardPositives, result: Soak
) -> tuple[World | None, dict]:
    """A placement that the bounder's certificate covers; each one that is tried is gentler than the one before."""
    if not positives.placeable:
        return None, {}
    rng = np.random.default_rng([result.seed, result.chunks])
    nothing = np.zeros((0, positives.columns), np.float32)
    for gentle in range(WORLDS):
        world, options = random_world(grid, rng, gentle)
        with contextlib.suppress(QueryError):
            bounder.query(nothing, **options)
            return world, options
    return None, {}


def _digest(bounder: Bounder) -> str:
    """SHA-256 of what the answers depend on, as the bounder's file has it: tensors, domain, threshold."""
    asked = {
        "method": bounder.method,
        "query": bounder.query_kind,
        "sizes": bounder.sizes,
        "domain": bounder.domain.to_dict(),
        "threshold": float(bounder.threshold),
    }
    return digest_of(bounder.tensors, asked)


def _save(result: Soak, state: str | Path) -> None:
    write_whole(state, json.dumps({"soak": STATE, **result.to_dict()}, allow_nan=False).encode())


def _resumed(fresh: Soak, seed: int | None, state: str | Path | None) -> Soak:
    """The test that the state file holds, or else ``fresh``; with its seed."""
    if state is None or not Path(state).is_file():
        fresh.seed = fresh_seed() if seed is None else seed
        return fresh
    try:
        held = json.loads(Path(state).read_text())
        if (version := held.pop("soak")) != STATE:
            raise FileFormatError(
                f"{state}: the state of a soak of another version ({version!r}, this one is {STATE}); "
                "give another file, or remove it"
            )
        old = Soak(**held)
        numbers = (old.seed, old.done, old.chunks, *old.forms.values())
        if not all(type(v) is int and v >= 0 for v in numbers) or set(old.forms) != set(fresh.forms):
            raise ValueError("numbers")
        if sum(old.forms.values()) != old.done or not 0 <= float(old.seconds) < float("inf"):
            raise ValueError("numbers")
    except FileFormatError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, OSError, RecursionError) as error:
        raise FileFormatError(f"{state}: not the state of a soak test, or damaged") from error
    fresh.seed = old.seed if seed is None else seed
    for name, text in (("bounder", "another bounder"), ("indicator", "another shape"), ("seed", "another seed")):
        if getattr(old, name) != getattr(fresh, name):
            raise FileFormatError(f"{state}: the state of a soak of {text}; give another file, or remove it")
    old.wanted, old.interrupted = fresh.wanted, False
    old.missed = old.missed_form = old.missed_world = None  # found again: its chunk does not count as done
    return old
