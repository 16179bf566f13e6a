"""Positives put to a bounder that ``certify`` calls proven, through everything that is deployed: none may be answered
with no.

The queries are certain positives of the claim that the certificate states: those of the stress test's stream, and
regions on corners, faces and hulls, nudged by single floats, whose truth the exact oracles know. They are queried in
batches, in the world, and one by one by the function for other kernels. Some proven bounders are walked downhill,
besides.
"""

from functools import lru_cache

import numpy as np
from asking import ask
from bounding_shapes import object_points
from region_cases import hard_regions

from warp_bounding.bounders import Bounder
from warp_bounding.proof.stress import DistancePositives, HardStream, Missed, Walk
from warp_bounding.queries import oracle
from warp_bounding.queries.hard import FORMS, HardPositives, HardShapePositives
from warp_bounding.shapes import Grid
from warp_bounding.shapes.shape import Shape

STEPS = 12  # of a walk


def attack(
    bounder: Bounder,
    shape: Shape,
    rng: np.random.Generator,
    count: int = 4096,
    *,
    walk: bool = False,
    quick: bool = False,
) -> tuple[int, Missed | None]:
    """Ask some ``4 count`` positives.

    Args:
        bounder: Proven, or so it is said.
        shape: The object of the claim, margin included.
        rng: Of the queries.
        count: Positives of a kind.
        walk: Whether to walk downhill, too; of cells only.
        quick: Batches of float32 only: each other form needs a kernel of its own.

    Returns:
        How many were queried, and the first that was denied.
    """
    queried, far = 0, bounder.of_distances
    if far:
        stream = DistancePositives(bounder, shape)
        chunks = range(2 * len(stream.forms))
        seed = int(rng.integers(2**62))
    else:
        query, length = bounder.query_kind, bounder.domain.oracle_length
        stream = HardStream(bounder, shape, _positives(query, shape, length))
        stream.cycle, seed = ("float32",) if quick else FORMS, 0  # a shape's pool of border points belongs to the seed
        first = int(rng.integers(2**30)) * len(stream.cycle)
        chunks = range(first, first + len(stream.cycle))
    for chunk in chunks:
        _, there, missed = stream.ask(seed, chunk, count)
        queried += there
        if missed is not None:
            return queried, missed
    if far:
        return queried, None
    if isinstance(shape, Grid):
        near = _near(query, shape, length, int(rng.integers(4)))
        if walk:
            near = np.concatenate([near, Walk(bounder, shape, int(rng.integers(2**31))).down(near[:1024], STEPS)[0]])
            near = near[oracle(query, shape, "cpu", length)(near)]
    else:
        held = _held(shape, rng, count)
        if shape.time:  # what is not known is *maybe*
            late = shape.upper[0] + np.exp2(rng.uniform(-20, 20, len(held)))
            held[::3, 0] = np.nextafter(late.astype(np.float32), np.float32(np.inf))[::3]
        near = _regions_through(query, held, rng, float(shape.extent.max()))
    answers = {"float32": bounder.query(near).numpy()} | ({} if quick else {"function": ask(bounder, near)})
    for form, answer in answers.items():
        missed, queried = np.flatnonzero(answer == 0), queried + len(near)
        if len(missed):
            return queried, Missed(near[missed[0]].tolist(), form)
    return queried, None


def _held(shape: Shape, rng: np.random.Generator, count: int) -> np.ndarray:
    """``(N, n)`` float32 points that the shape contains: inside, on the faces of its box, and, where it has no end, far
    away."""
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


_KNOWN: dict[tuple, HardPositives | HardShapePositives] = {}


def _positives(query: str, shape: Shape, length: float) -> HardPositives | HardShapePositives:
    """One stream for all shapes that are the same; a shape's pool of border points takes a while."""
    key = query, shape.digest, shape.margin, shape.unbounded, length
    if key not in _KNOWN:
        kind = HardPositives if isinstance(shape, Grid) else HardShapePositives
        _KNOWN[key] = kind(query, shape, length, "cpu")
    return _KNOWN[key]


@lru_cache(maxsize=256)
def _near(query: str, grid: Grid, length: float, number: int, count: int = 2000) -> np.ndarray:
    """Corners, faces and hulls, float32 neighbours included; all of them positives."""
    rng = np.random.default_rng(number)
    if query == "point":
        return object_points(grid, rng, count)
    x = hard_regions(query, grid, rng, length, count)
    return x[oracle(query, grid, "cpu", length)(x)]
