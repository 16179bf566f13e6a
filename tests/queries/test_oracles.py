"""Each kind's oracle is its rational reference implementation, query by query, above all where queries only touch.

Samples are the paper's.
"""

import numpy as np
import pytest
from bounding_shapes import SHAPES as ALL_SHAPES
from bounding_shapes import domain_points, object_points, shape

from warp_bounding.errors import QueryError
from warp_bounding.queries import QUERIES, check_query, locate, oracle, sample
from warp_bounding.queries.boundary import HardPositives, draw_positives
from warp_bounding.queries.box import BOX
from warp_bounding.queries.directions import sample_directions
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import RAY
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.shapes import Grid

SHAPES = ("line", "c", "blob", "half", "single", "anisotropic", "mesh", "animated", "five")
ODD = np.float32([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e10, -1e10, 3e38, -3e38])


def lattice_points(grid: Grid, count: int, rng: np.random.Generator) -> np.ndarray:
    """``(N, n)`` float32 points on centres, faces, edges and corners of cells, some of them moved by one float."""
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


LOW, HIGH = np.float32(0.375), np.float32(0.625)  # of one_cell


def usual(names) -> list:
    """Those of one dimension and of five, which have kernels of their own, with ``--slow`` only."""
    return [pytest.param(n, marks=pytest.mark.slow) if n in ("line", "five") else n for n in names]


def hard_points(grid, rng):
    x = lattice_points(grid, 3000, rng)
    special = rng.choice(np.float32([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3e38, -3e38]), (200, grid.ndim))
    mixed = np.where(rng.random(special.shape) < 0.5, special, x[:200])
    nudged = [np.nextafter(x, np.float32(s * np.inf)) for s in (-1, 1)]
    return np.concatenate([x, *nudged, special, mixed, domain_points(grid, 3000, rng), object_points(grid, rng, 1000)])


def of_all_kinds(query, grid, count, rng):
    """Regions as the paper draws them, on lattices, through the object, and with odd numbers."""
    n, scale = grid.ndim, np.float32(grid.cells_per_unit)
    plain = sample(query, grid, count, rng)
    a, b = lattice_points(grid, count, rng), lattice_points(grid, count, rng)
    if query == "box":
        b[::3] = a[::3]
        snapped = np.concatenate([np.minimum(a, b), np.maximum(a, b)], axis=1)
        more = [np.concatenate([a, b], axis=1)]
    elif query == "plane":
        snapped = np.concatenate([small_vectors(n, count, rng) * scale, a], axis=1)
        more = [np.concatenate([sample_directions(n, count, rng) * scale, b], axis=1)]
    else:
        snapped = np.concatenate([a, small_vectors(n, count, rng) / scale], axis=1)
        inside = object_points(grid, rng, 10)[:count]
        more = [np.concatenate([inside, small_vectors(n, len(inside), rng)], axis=1)]
        more += [np.concatenate([a, plain[:, n:] / scale], axis=1)]
    more += [odd_queries(grid, plain, rng), odd_queries(grid, snapped, rng)]
    return np.concatenate([plain, snapped, *more], dtype=np.float32)


@pytest.mark.parametrize("name", usual(ALL_SHAPES))
def test_points_are_those_that_the_grid_contains(name, device, rng):
    grid = shape(name)
    x = hard_points(grid, rng)
    truth = grid.contains(x)
    assert (POINT.oracle(grid, device)(x) == truth).all()
    assert 0 < truth.sum() < len(x)


@pytest.mark.parametrize("name", usual([*SHAPES, "star"]))
@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_regions_have_the_rational_truth(query, name, device, rng):
    grid, kind = shape(name), QUERIES[query]
    q = of_all_kinds(query, grid, {"ray": 80, "plane": 150, "box": 400}[query], rng)
    for length in (1.0, 0.3) if query == "ray" else (1.0,):
        exact, truth = kind.oracle(grid, device, length), kind.truth(grid, q, length)
        np.testing.assert_array_equal(exact(q), truth)
        assert 0 < truth.sum() < len(q)
        assert query != "box" or exact.undecided == 0


@pytest.mark.parametrize("cells", [(40, 25, 30), (120, 40), (7, 9, 8, 11)])
@pytest.mark.parametrize("query", ["plane", "box"])
def test_few_cells_in_a_large_grid(query, cells, device, rng):
    grid = sparse_grid(cells, 6)
    q = of_all_kinds(query, grid, 200, rng)
    np.testing.assert_array_equal(QUERIES[query].oracle(grid, device)(q), QUERIES[query].truth(grid, q))


@pytest.mark.parametrize("length", [0.7, 1e6])
@pytest.mark.parametrize("cells", [(40, 25, 30), (3, 90), (7, 9, 8, 11)])
def test_jumps_over_empty_space_miss_nothing(cells, length, device, rng):
    grid = sparse_grid(cells, 12)
    q = RAY.sample(grid, 600, rng)
    target = grid.position(grid.occupied[rng.integers(12, size=300)] + rng.uniform(-0.6, 0.6, (300, grid.ndim)))
    q[:300, grid.ndim :] = target - q[:300, : grid.ndim]
    q[300:450, grid.ndim] *= 30  # along the first axis
    truth = RAY.truth(grid, q, length)
    np.testing.assert_array_equal(RAY.oracle(grid, device, length)(q), truth)
    assert 20 < truth.sum() < 580


# --- what only touches -----------------------------------------------------------------------------------------------


BELOW, ABOVE, HUGE = np.nextafter(LOW, np.float32(0)), np.nextafter(HIGH, np.float32(1)), np.float32(3e38)
SHORT = np.nextafter(0.375, 0)  # of a ray's length
TOUCHING = [  # of one cell: kind, numbers, the length of rays, whether they meet
    *((RAY, [-0.5, side, 0.5, 1, 0, 0], 2.0, True) for side in (LOW, HIGH)),  # along a face
    *((RAY, [-0.5, side, 0.5, 1, 0, 0], 2.0, False) for side in (BELOW, ABOVE)),
    *((RAY, [side, 0.5, 1.5, 0, 0, -1], 2.0, True) for side in (LOW, HIGH)),
    *((RAY, [side, 0.5, 1.5, 0, 0, -1], 2.0, False) for side in (BELOW, ABOVE)),
    *((RAY, [side, side, 1.5, 0, 0, -1], 2.0, True) for side in (LOW, HIGH)),  # along an edge
    (RAY, [0.125, 0.375, 0.5, 1, -1, 0], 1.0, False),  # the edge x = y = 3/8 is behind; passes (3/8, 1/8)
    (RAY, [0.25, 0.5, 0.5, 1, -1, 0], 1.0, True),  # the edge at (3/8, 3/8)
    (RAY, [0.25, 0.5, 0.25, 1, -1, 1], 1.0, True),  # the corner (3/8, 3/8, 3/8)
    (RAY, [0.25, 0.5, 0.25, 1, -1, 1.0000002], 1.0, True),  # z is over 3/8 at that edge
    (RAY, [0.25, 0.5, 0.25, 1, -1, 0.9999999], 1.0, False),  # z is under 3/8 at that edge
    (RAY, [0.625, 0.625, 0.625, 1, 2, 3], 1.0, True),  # starts at a corner, goes away
    (RAY, [0.625, 0.5, 0.5, 1, 0, 0], 1.0, True),  # starts on a face, goes away
    (RAY, [ABOVE, 0.5, 0.5, 1, 0, 0], 1.0, False),
    *((RAY, [0, 0.5, 1, 0], 0.375, True), (RAY, [0, 0.5, 1, 0], SHORT, False)),  # the end of the segment is closed
    *((RAY, [0.1875, 0.125, 3, 4], length, length == 0.3125) for length in (0.3125, np.nextafter(0.3125, 0))),
    *((RAY, [0.1875, 0.125, 3e-20, 4e-20], length, None) for length in (0.3125, np.nextafter(0.3125, 0))),
    (BOX, [0.625, 0.625, 0.9, 0.9], 1.0, True),  # corner to corner
    (BOX, [ABOVE, 0.625, 0.9, 0.9], 1.0, False),
    (BOX, [0.1, 0.625, 0.9, 0.7], 1.0, True),  # edge to edge
    (BOX, [0.4, 0.4, 0.5, 0.5], 1.0, True),  # inside
    *((BOX, [-HUGE, -HUGE, HUGE, HUGE], 1.0, True), (BOX, [-HUGE, 0.7, HUGE, HUGE], 1.0, False)),
    *((BOX, [1.2, 0.5, 2.0, 0.5], 1.0, False), (BOX, [-9, 0.5, 0.375, 0.5], 1.0, True)),  # outside the domain, partly
]


def test_what_only_touches_meets(device):
    for kind, numbers, length, meets in TOUCHING:
        q, grid = np.float32([numbers]), one_cell(len(numbers) // 2)
        (truth,) = kind.truth(grid, q, length)
        assert truth == meets or meets is None, (kind.name, numbers, length)
        assert kind.oracle(grid, device, length)(q)[0] == truth, (kind.name, numbers, length)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_planes_touch_faces_and_corners(n, device, rng):
    """Supporting planes of one cell, through its own corner: at it, and one float outside of it."""
    grid, exact = one_cell(n), PLANE.oracle(one_cell(n), device)
    normal = np.abs(sample_directions(n, 500, rng)) + np.float32(1e-3)
    normal[:n] = np.eye(n)
    normal[n : n + 50] = rng.integers(1, 4, (50, n))
    corner = np.full_like(normal, 0.625)
    outside = np.where(normal > 0, np.nextafter(corner, np.float32(1)), corner)
    touching, missing = (np.concatenate([normal, point], axis=1) for point in (corner, outside))
    assert exact(touching).all()
    assert exact.undecided == 0
    assert not exact(missing).any()
    assert PLANE.truth(grid, touching[:100]).all()
    assert not PLANE.truth(grid, missing[:100]).any()


def test_rounding_onto_a_face_is_noticed(device):
    """The cell coordinate of a tiny number rounds onto the face at 3/2, but the point is on one side of it."""
    for cell in (1, 2):
        grid = Grid(np.arange(4) == cell, cells_per_unit=[3.0], offset=[-1.5])
        q = np.float32([[x, x] for x in (-1e-30, 0.0, 1e-30)])
        expected = [cell == 1, True, cell == 2]
        np.testing.assert_array_equal(BOX.truth(grid, q), expected)
        np.testing.assert_array_equal(BOX.oracle(grid, device)(q), expected)


@pytest.mark.parametrize("name", ["c", "blob", "mesh"])
def test_a_region_of_no_size_is_a_point(name, device, rng):
    grid = shape(name)
    x = np.concatenate([object_points(grid, rng, 500), lattice_points(grid, 500, rng)])
    ray = np.concatenate([x, small_vectors(grid.ndim, len(x), rng)], axis=1)
    np.testing.assert_array_equal(RAY.oracle(grid, device, 0.0)(ray), grid.contains(x))
    np.testing.assert_array_equal(BOX.oracle(grid, device)(np.concatenate([x, x], axis=1)), grid.contains(x))


def test_the_length_of_a_direction_does_not_matter(device, rng):
    grid = shape("blob")
    rays, planes = RAY.sample(grid, 500, rng), PLANE.sample(grid, 500, rng)
    planes[:, 3:] = object_points(grid, rng, 2000)[:500]
    truth = RAY.oracle(grid, device)(rays)
    for power in (-100, -3, 90):
        scale = np.float32(2.0) ** power
        np.testing.assert_array_equal(RAY.oracle(grid, device)(rays * np.repeat([1, scale], 3)), truth)
        assert PLANE.oracle(grid, device)(planes * np.repeat([scale, 1], 3)).all()


# --- a kind of one's own ---------------------------------------------------------------------------------------------


class Cuboid(type(QUERIES["box"])):
    """Boxes under another name."""

    name = "cuboid"


def test_a_kind_of_query_is_added_from_outside(monkeypatch, rng):
    monkeypatch.setitem(QUERIES, "cuboid", Cuboid())
    cuboid, grid = "cuboid", shape("blob")
    q = sample(check_query(cuboid), grid, 2000, rng)
    truth = oracle(cuboid, grid, "cpu")
    np.testing.assert_array_equal(truth(q), oracle("box", grid, "cpu")(q))
    assert truth(next(draw_positives(cuboid, grid, 100, 1, "cpu"))).all()
    assert truth(HardPositives(cuboid, grid, device="cpu").draw(1, 0, 500)).all()
    domain, same = domain_of(grid, cuboid), domain_of(grid, "box")
    np.testing.assert_array_equal(domain.to_local(q), same.to_local(q))
    np.testing.assert_array_equal(domain.limit, same.limit)
    assert locate(cuboid, 3, False) == locate("box", 3, False)
    assert domain.tested_as_region


# --- input -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 511, 513])
@pytest.mark.parametrize("query", QUERIES)
def test_any_number_of_queries(query, count, device, rng):
    grid = shape("c")
    q = sample(query, grid, count, rng)
    answer = oracle(query, grid, device)(q)
    assert answer.dtype == bool
    np.testing.assert_array_equal(answer, QUERIES[query].truth(grid, q))


@pytest.mark.parametrize("query", QUERIES)
def test_other_shapes_are_refused(query):
    m = QUERIES[query].columns(3)
    for q in (np.zeros(m), np.zeros((4, m - 1)), np.zeros((1, 4, m))):
        with pytest.raises(QueryError, match=rf"\(N, {m}\)"):
            QUERIES[query].oracle(shape("blob"), "cpu")(q)


def test_what_is_no_query_meets_nothing(device):
    nan, inf = np.nan, np.inf
    none = {
        RAY: [[0.5, 0.5, 0, 0], [0.5, 0.5, nan, 1], [inf, 0.5, 1, 0], [0.5, 0.5, inf, 1]],
        PLANE: [[0, 0, 0.5, 0.5], [nan, 1, 0.5, 0.5], [1, 0, inf, 0.5], [inf, 1, 0.5, 0.5]],
        BOX: [[0.6, 0.5, 0.4, 0.5], [0.1, 0.1, inf, 0.9], [nan, 0.1, 0.9, 0.9]],
    }
    for kind, q in none.items():
        assert not kind.oracle(one_cell(2), device)(np.float32(q)).any()


def test_unknown_kinds_and_impossible_lengths_are_refused():
    for door in (check_query, lambda k: oracle(k, shape("blob")), lambda k: sample(k, shape("blob"), 1, None)):
        with pytest.raises(QueryError, match="point, ray, plane, box, got 'cone'"):
            door("cone")
    for length in (-1.0, np.nan, np.inf):
        with pytest.raises(QueryError, match="length must be"):
            RAY.oracle(shape("blob"), "cpu", length)


# --- samples ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["c", "single", "mesh", "animated"])
def test_points_and_boxes_are_the_papers(name, rng):
    grid = shape(name)
    x, q = POINT.sample(grid, 20_000, rng), BOX.sample(grid, 20_000, rng)
    assert x.dtype == q.dtype == np.float32
    step = np.float32(1e-6) * np.abs(x).max(axis=0)
    assert (x >= grid.sample_lower - step).all()
    assert (x <= grid.sample_upper + step).all()
    middle, size = (grid.sample_lower + grid.sample_upper) / 2, grid.upper - grid.lower
    assert np.abs(x.mean(axis=0) - middle).max() < 0.02 * size.max()
    lower, upper = q[:, : grid.ndim], q[:, grid.ndim :]
    assert (lower <= upper).all()
    frame = grid.sample_upper - grid.sample_lower
    for corner, mean in ((lower, 0.5), (upper, 0.75)):
        np.testing.assert_allclose((corner - grid.sample_lower).mean(axis=0), mean * frame, atol=0.01 * size.max())


@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
def test_rays_are_the_papers(ndim, rng):
    occupancy = np.zeros((4,) * ndim, dtype=bool)
    occupancy.flat[0] = True
    q = RAY.sample(Grid(occupancy), 20_000, rng)
    assert q.dtype == np.float32
    origin, d = q[:, :ndim], q[:, ndim:].astype(np.float64)
    assert ((origin >= 0) & (origin <= 1)).all()
    np.testing.assert_allclose((d * d).sum(axis=1), 1, atol=1e-6)
    if ndim > 1:  # the first angle is uniform, so the first coordinate is an arc sine variable
        angle = np.arccos(np.clip(d[:, 0], -1, 1)) / np.pi
        np.testing.assert_allclose(np.histogram(angle, 10, (0, 1))[0], 2000, atol=250)
        assert abs((d[:, -1] > 0).mean() - 0.5) < 0.02
