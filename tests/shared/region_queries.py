"""Regions where oracles fail first: on faces, edges and corners of cells, around the domain, and odd numbers."""

import numpy as np

from warp_bounding.shapes import Grid

SHAPES = ("line", "c", "blob", "half", "single", "anisotropic", "mesh", "animated", "five")
ODD = np.float32([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e10, -1e10, 3e38, -3e38])


def lattice_points(grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(N, n)`` float32 points on centres, faces, edges and corners of cells, some one float beside them."""
    t = np.round(rng.uniform(-2, np.array(grid.shape) + 1, (count, grid.ndim)) * 2) / 2
    x = grid.position(t).astype(np.float32)
    toward = rng.choice(np.float32([-np.inf, np.inf]), x.shape)
    return np.where(rng.random(x.shape) < 0.2, np.nextafter(x, toward), x)


def small_vectors(ndim: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(N, n)`` float32 directions with small integer components: through edges and corners, many zeros."""
    d = rng.integers(-2, 3, (count, ndim)).astype(np.float32)
    d[(d == 0).all(axis=1), 0] = -1.0
    return d


def odd_queries(grid: Grid, ordinary: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The queries with some of their numbers replaced: NaN, infinities, zeros, subnormal and huge numbers."""
    return np.where(rng.random(ordinary.shape) < 0.25, rng.choice(ODD, ordinary.shape), ordinary)


def sparse_grid(shape: tuple[int, ...], cells: int, seed: int = 0, **options) -> Grid:
    """Few occupied cells, far apart."""
    occupancy = np.zeros(shape, dtype=bool)
    occupancy.flat[np.random.default_rng(seed).choice(occupancy.size, cells, replace=False)] = True
    return Grid(occupancy, **options)


def one_cell(ndim: int = 3) -> Grid:
    """Five cells along each axis, the middle one occupied: coordinates 3/8 to 5/8."""
    occupancy = np.zeros((5,) * ndim, dtype=bool)
    occupancy[(2,) * ndim] = True
    return Grid(occupancy)
