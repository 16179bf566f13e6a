"""Regions where bounders fail first: through corners and faces, grazing, tiny, axis-parallel, from outside."""

import numpy as np
from bounding_shapes import object_points

from warp_bounding.bounders import METHODS
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.rounding import round_down

VOLUMES = ("aabb", "obb", "kdop", "bvh")
REGIONS = ("ray", "plane", "box")


def ray_length(grid) -> float:
    """Of the order of the object; one and a bit for those in the unit cube."""
    size = float((grid.upper - grid.lower).max())
    return 1.25 if size < 3 else size / 2


def fitted_region(method: str, query: str, grid, device="cpu", length=None, **options):
    """A bounder with the threshold that its closed form proves."""
    domain = domain_of(grid, query, ray_length(grid) if length is None else length)
    bounder = METHODS[method].fit(grid, domain, device=device, **options)
    least, boxes = bounder.least(grid)
    assert boxes == len(grid.occupied)
    return bounder.freeze(float(round_down(np.nextafter(least - bounder.rounding_bound(), -np.inf))), None)


def extreme_points(grid, normals: np.ndarray) -> np.ndarray:
    """The object's last corner along each normal, float64."""
    cells = grid.occupied
    corner = np.where(normals > 0, 0.5, -0.5)
    at, some = grid.position(cells), max(1, 10_000_000 // len(cells))  # normals at a time, so that memory is bounded
    last = [np.argmax(normals[i : i + some] @ at.T, axis=1) for i in range(0, len(normals), some)]
    return grid.position(cells[np.concatenate(last)] + corner)


def directions(grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random, axis-parallel, diagonal, nearly axis-parallel and the object's own axes, in object space; not unit."""
    n = grid.ndim
    d = rng.normal(size=(count, n))
    kind = rng.integers(6, size=count)
    axis = np.eye(n)[rng.integers(n, size=count)] * rng.choice([-1.0, 1.0], size=(count, 1))
    diagonal = rng.choice([-1.0, 0.0, 1.0], size=(count, n))
    diagonal[(diagonal == 0).all(axis=1), 0] = 1
    d = np.where((kind == 1)[:, None], axis, d)
    d = np.where((kind == 2)[:, None], diagonal, d)
    d = np.where((kind == 3)[:, None], axis + 10.0 ** rng.uniform(-45, -3, (count, 1)) * d, d)
    own = np.linalg.eigh(np.atleast_2d(np.cov(grid.position(grid.occupied).T, ddof=0)))[1].T
    d = np.where((kind == 4)[:, None], own[rng.integers(n, size=count)], d)
    return np.where((kind == 5)[:, None], d / grid.cells_per_unit, d)


def hard_regions(query: str, grid, rng: np.random.Generator, length: float, count: int = 6000) -> np.ndarray:
    """``(N, 2 n)`` float32; most of them meet the object, many of them barely."""
    inside = object_points(grid, rng, count).astype(np.float64)
    inside = inside[rng.integers(len(inside), size=count)]
    m = directions(grid, count, rng)
    p = np.where(rng.random((count, 1)) < 0.5, extreme_points(grid, m), inside)
    size = grid.upper - grid.lower
    if query == "box":
        reach = size * rng.choice([0.0, 1e-9, 1e-5, 1e-2, 0.3, 3.0], size=(count, 1)) * rng.random(p.shape)
        outward = m > 0
        low, high = np.where(outward, p, p - reach), np.where(outward, p + reach, p)
        around = (rng.random(count) < 0.2)[:, None]
        low, high = np.where(around, p - reach, low), np.where(around, p + reach, high)
        q = np.concatenate([low, high], axis=1)
    elif query == "plane":
        along = directions(grid, count, rng)
        along -= m * ((along * m).sum(axis=1, keepdims=True) / (m * m).sum(axis=1, keepdims=True))
        away = size.min() * rng.choice([0.0, 0.0, 0.3, 3.0], size=(count, 1))
        away /= np.linalg.norm(along + 1e-30, axis=1)[:, None]
        q = np.concatenate([m * 10.0 ** rng.uniform(-6, 6, (count, 1)), p + along * away], axis=1)
    else:
        d = directions(grid, count, rng)
        tangent = d - m * ((d * m).sum(axis=1, keepdims=True) / (m * m).sum(axis=1, keepdims=True))
        usable = (rng.random(count) < 0.5) & (np.abs(tangent).max(axis=1) > 1e-6)
        d = np.where(usable[:, None], tangent, d)
        unit = d / np.linalg.norm(d, axis=1, keepdims=True)
        t = length * rng.choice([0.0, 1e-8, 1e-3, 0.5, 1 - 1e-6, 1 - 1e-7, 1.0], size=(count, 1))
        t = np.where(rng.random((count, 1)) < 0.5, t, rng.random((count, 1)) * length)
        q = np.concatenate([p - t * unit, d * 10.0 ** rng.uniform(-6, 6, (count, 1))], axis=1)
    q = q.astype(np.float32)
    nudged = np.nextafter(q, np.where(rng.random(q.shape) < 0.5, np.float32(np.inf), np.float32(-np.inf)))
    q = np.concatenate([q, np.where(rng.random(q.shape) < 0.3, nudged, q)])
    if query == "box":
        n = grid.ndim
        q = np.concatenate([np.minimum(q[:, :n], q[:, n:]), np.maximum(q[:, :n], q[:, n:])], axis=1)
    return q


def cases(query: str, grid, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Random and hard regions, and the exact truth about them."""
    length = ray_length(grid)
    q = np.concatenate([sample(query, grid, 6000, rng), hard_regions(query, grid, rng, length)])
    return q, oracle(query, grid, "cpu", length)(q)


PARTS = {"point": "p", "ray": "pd", "plane": "np", "box": "pp"}  # place, direction, normal: how they move


def placed(query: str, q, ndim: int, rotated, shift, factors, back=False, time=0, dtype=np.float64) -> np.ndarray:
    """Queries from object space to the world, or back, in this precision; boxes by permutations only."""
    parts = []
    for k, kind in enumerate(PARTS[query]):
        x = q[:, k * ndim : (k + 1) * ndim].astype(dtype)
        stretch, by = 1 / np.asarray(factors) if kind == "n" else factors, shift if kind == "p" else 0.0
        y = x[:, time:]
        x[:, time:] = (y - by) @ rotated / stretch if back else (y * stretch) @ rotated.T + by
        parts.append(x)
    return np.concatenate(parts, axis=1)
