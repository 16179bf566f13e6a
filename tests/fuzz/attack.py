"""Positives put to a bounder that ``certify`` calls proven, through everything that is deployed: none may be answered with no.

The queries are certain positives of the claim that the certificate states: float32, float64 and placed ones of the soak test's
stream, and regions on corners, faces and hulls, nudged by single floats, whose truth the exact oracles know. They are asked in
batches, in the world, and one by one by the function for other kernels. Some proven bounders are walked downhill, besides.
"""

from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np
import warp as wp
from bounding_shapes import object_points
from region_cases import hard_regions

from warp_bounding.bounders import Bounder, Data, DistanceBounder
from warp_bounding.errors import QueryError
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.indicators.shape import Shape
from warp_bounding.kernels.functions import point_func
from warp_bounding.proof.attest.falsify import Walk
from warp_bounding.proof.attest.soak import random_world
from warp_bounding.proof.distances.soak import DistancePositives
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import FORMS, HardPositives, HardShapePositives
from warp_bounding.runtime.native import vector_type

__all__ = ["Denied", "attack"]

WORLDS = 6  # placements that are tried, each gentler, before the bounder is taken to allow none
STEPS = 12  # of a walk


@dataclass
class Denied:
    """A positive that a proven bounder answers with no."""

    form: str
    query: list[float]
    placement: dict = field(default_factory=dict)


def attack(
    bounder: Bounder | DistanceBounder,
    grid: IndicatorGrid,
    rng: np.random.Generator,
    count: int = 4096,
    *,
    walk: bool = False,
    quick: bool = False,
) -> tuple[int, Denied | None]:
    """Ask some ``4 count`` positives.

    Args:
        bounder: Proven, or so it is said.
        grid: The object of the claim, margin included.
        rng: Of the queries.
        count: Positives of a kind.
        walk: Whether to walk downhill, too.
        quick: Batches of float32 only: each other form needs a kernel of its own.

    Returns:
        How many were asked, and the first that was denied.
    """
    if isinstance(bounder, DistanceBounder):
        return _attack_distance(bounder, grid, rng, count)
    if not isinstance(grid, IndicatorGrid):
        return _attack_shape(bounder, grid, rng, count, quick)
    length = bounder.domain.oracle_length
    hard, seed, asked = _positives(bounder.query_kind, grid, length), int(rng.integers(2**62)), 0
    for form, x, options in _drawn(bounder, grid, hard, rng, seed, count, ("float32",) if quick else FORMS):
        missed = np.flatnonzero(bounder.query(x, **options).numpy() == 0)
        asked += len(x)
        if len(missed):
            return asked, Denied(form, x[missed[0]].tolist(), {k: np.asarray(v).tolist() for k, v in options.items()})
    near = _near(bounder.query_kind, grid, length, int(rng.integers(4)))
    if walk:
        near = np.concatenate([near, Walk(bounder, grid, seed % 2**31).down(near[:1024], STEPS)[0]])
    near = near[oracle(bounder.query_kind, grid, "cpu", length)(near)] if walk else near
    for form, ask in (("float32", lambda x: bounder.query(x).numpy()), ("function", lambda x: _ask(bounder, x)))[
        : 2 - quick
    ]:
        missed, asked = np.flatnonzero(ask(near) == 0), asked + len(near)
        if len(missed):
            return asked, Denied(form, near[missed[0]].tolist())
    return asked, None


def _attack_distance(
    bounder: DistanceBounder, grid: IndicatorGrid, rng: np.random.Generator, count: int
) -> tuple[int, Denied | None]:
    """The same of a distance: balls, segments, rays and boxes that barely touch the object, far away and near."""
    positives, seed, asked = DistancePositives(bounder, grid), int(rng.integers(2**62)), 0
    for chunk in range(2 * len(positives.forms)):
        form, there, missed = positives.ask(seed, chunk, count)
        asked += there
        if missed is not None:
            return asked, Denied(form, [], missed)
    return asked, None


def _attack_shape(
    bounder: Bounder, shape: Shape, rng: np.random.Generator, count: int, quick: bool
) -> tuple[int, Denied | None]:
    """The same of a shape without cells: points that it calls its own, and regions that hold one of them."""
    length = bounder.domain.oracle_length
    hard, first, asked = _shape_positives(bounder.query_kind, shape, length), int(rng.integers(2**62)), 0
    forms = ("float32",) if quick else tuple(form for form in FORMS if form != "placed" or hard.placeable)
    for form, x, options in _drawn(bounder, shape, hard, rng, 0, count, forms, first):
        missed = np.flatnonzero(bounder.query(x, **options).numpy() == 0)
        asked += len(x)
        if len(missed):
            return asked, Denied(form, x[missed[0]].tolist(), {k: np.asarray(v).tolist() for k, v in options.items()})
    held = _held(shape, rng, count)
    if shape.time:  # what is not known is *maybe*
        late = shape.upper[0] + np.exp2(rng.uniform(-20, 20, len(held)))
        held[::3, 0] = np.nextafter(late.astype(np.float32), np.float32(np.inf))[::3]
    near = _regions_through(bounder.query_kind, held, rng, float(shape.extent.max()))
    for form, ask in (("float32", lambda x: bounder.query(x).numpy()), ("function", lambda x: _ask(bounder, x)))[
        : 2 - quick
    ]:
        missed, asked = np.flatnonzero(ask(near) == 0), asked + len(near)
        if len(missed):
            return asked, Denied(form, near[missed[0]].tolist())
    return asked, None


def _held(shape: Shape, rng: np.random.Generator, count: int) -> np.ndarray:
    """``(N, n)`` float32 points that the shape contains: inside, on the faces of its box, and, where it has no end, far away."""
    x = shape.lower + (shape.upper - shape.lower) * rng.uniform(-0.1, 1.1, (4 * count, shape.ndim))
    on = rng.random(x.shape) < 0.1
    x = np.where(on, np.where(rng.random(x.shape) < 0.5, shape.lower, shape.upper), x)
    if shape.unbounded:
        x *= np.exp2(rng.uniform(0, 60, (len(x), 1)) * (rng.random((len(x), 1)) < 0.5))
    x = x.astype(np.float32)
    return x[shape.contains(x.astype(np.float64))][:count]


def _regions_through(query: str, p: np.ndarray, rng: np.random.Generator, size: float) -> np.ndarray:
    """Queries that hold these float32 points exactly: rays that begin there, planes through them, boxes around them."""
    if query == "point":
        return p
    if query == "box":
        around = (np.exp2(rng.uniform(-30, 1, p.shape)) * size * (rng.random(p.shape) < 0.7)).astype(np.float32)
        lower = np.where(rng.random(p.shape) < 0.5, p - around, p)
        return np.concatenate([lower, np.maximum(p, p + around)], axis=1).astype(np.float32)
    way = rng.normal(size=p.shape).astype(np.float32)
    return np.concatenate([p, way] if query == "ray" else [way, p], axis=1)


_SHAPES: dict[tuple, HardShapePositives] = {}


def _shape_positives(query: str, shape: Shape, length: float) -> HardShapePositives:
    """One stream for all shapes that are the same; its pool of border points takes a while."""
    key = query, shape.digest, shape.margin, shape.unbounded, length
    if key not in _SHAPES:
        _SHAPES[key] = HardShapePositives(query, shape, length, "cpu")
    return _SHAPES[key]


def _drawn(bounder, grid, hard, rng, seed: int, count: int, forms: tuple[str, ...], first: int = 0):
    """``(form, queries, options)`` of the soak test's stream."""
    for form in forms:
        if form == "placed":
            break
        x, certain = hard.draw(seed, first, count, form)
        yield form, x.numpy()[certain.numpy() != 0], {}
    else:
        return
    nothing = np.zeros((0, hard.columns), np.float32)
    for gentle in range(WORLDS):
        world, options = random_world(grid, rng, gentle)
        try:
            bounder.query(nothing, **options)
        except QueryError:
            continue
        x, certain = hard.draw(seed, first + count, count, "placed", world)
        yield "placed", x.numpy()[certain.numpy() != 0], options
        return


@lru_cache(maxsize=256)
def _positives(query: str, grid: IndicatorGrid, length: float) -> HardPositives:
    return HardPositives(query, grid, length, "cpu")


@lru_cache(maxsize=256)
def _near(query: str, grid: IndicatorGrid, length: float, number: int, count: int = 2000) -> np.ndarray:
    """Corners, faces and hulls, float32 neighbours included; all of them positives."""
    rng = np.random.default_rng(number)
    if query == "point":
        return object_points(grid, rng, count)
    x = hard_regions(query, grid, rng, length, count)
    return x[oracle(query, grid, "cpu", length)(x)]


@cache
def _asking_points(source) -> wp.Kernel:
    """A kernel as a user would write it."""
    test, vector = point_func(source), vector_type(source.ndim)

    @wp.kernel(module="unique", enable_backward=False)
    def ask_points(data: Data, q: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if test(data, q[i]):
            answer[i] = wp.uint8(1)

    return ask_points


@cache
def _asking_regions(source) -> wp.Kernel:
    test, vector = point_func(source), vector_type(source.ndim)

    @wp.kernel(module="unique", enable_backward=False)
    def ask_regions(data: Data, a: wp.array(dtype=vector), b: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if test(data, a[i], b[i]):
            answer[i] = wp.uint8(1)

    return ask_regions


def _ask(bounder: Bounder, x: np.ndarray) -> np.ndarray:
    """Answers of ``bounder.func`` inside a user's kernel."""
    answer, n = wp.zeros(len(x), dtype=wp.uint8, device="cpu"), bounder.ndim
    parts = [np.ascontiguousarray(x[:, k : k + n]) for k in range(0, x.shape[1], n)]
    arrays = [wp.array(part, dtype=vector_type(n), device="cpu") for part in parts]
    kernel = (_asking_points if bounder.query_kind == "point" else _asking_regions)(bounder.source)
    wp.launch(kernel, len(x), [bounder.data, *arrays], [answer], device="cpu")
    return answer.numpy()
