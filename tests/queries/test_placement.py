"""Queries of shapes placed in the world: no false negative, and what the certificate does not cover is refused."""

from functools import cache

import numpy as np
import pytest
import torch
import warp as wp
from bounding_shapes import crossed, fitted, shape
from region_cases import REGIONS, fitted_region, placed, ray_length

from warp_bounding.errors import QueryError
from warp_bounding.queries.base import FAR
from warp_bounding.queries.placement import Placement, placement_error
from warp_bounding.queries.region_domain import domain_of


def rotation(s: int, rng) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(s, s)))
    q *= np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] *= -1
    return q


def homogeneous(q, t) -> np.ndarray:
    matrix = np.eye(len(t) + 1)
    matrix[:-1, :-1], matrix[:-1, -1] = q, t
    return matrix


def inner_points(grid, rng) -> np.ndarray:
    """Points of the object, float64."""
    cells = grid.occupied[rng.integers(len(grid.occupied), size=4000)]
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    return grid.position(cells + np.where(rng.random(cells.shape) < 0.6, np.copysign(0.5, offset), offset))


@pytest.mark.parametrize(
    ("method", "name"),
    crossed(("kdop", "voxels", "mlp"), ["c", "blob", "animated"], kinds=("kdop", "mlp")),  # one map for all
)
def test_placed_points_are_never_denied(method, name, device, rng):
    grid, bounder = shape(name), fitted(method, name).to(device)
    s = grid.ndim - grid.time
    for _ in range(4):
        q, t, factors = rotation(s, rng), rng.normal(size=s), rng.uniform(0.5, 2, s)
        world = placed("point", inner_points(grid, rng), grid.ndim, q, t, factors, time=int(grid.time))
        xform = homogeneous(q, t)
        assert bounder.query(world, xform=xform, scale=factors).numpy().all()  # float64: rounded in world space
        near = world.astype(np.float32)  # float32: exact, so the truth is where they are
        sure = certainly_inside(grid, placed("point", near, grid.ndim, q, t, factors, back=True, time=int(grid.time)))
        assert sure.any()
        assert bounder.query(near[sure], xform=xform, scale=factors).numpy().all()


@pytest.mark.parametrize("skew", [0.0, 4e-4])
def test_reflections_and_nearly_orthogonal_matrices_are_placed_as_they_are(skew, device, rng):
    grid, bounder = shape("c"), fitted("aabb", "c").to(device)
    q, t = rotation(grid.ndim, rng) @ np.diag([-1.0, *[1.0] * (grid.ndim - 1)]), rng.normal(size=grid.ndim)
    q = q @ (np.eye(grid.ndim) + skew * rng.uniform(-1, 1, (grid.ndim,) * 2))
    world = placed("point", inner_points(grid, rng), grid.ndim, q, t, 1.0)
    assert bounder.query(world, xform=homogeneous(q, t)).numpy().all()


def test_transforms_come_in_several_forms(rng):
    grid, bounder = shape("blob"), fitted("mlp", "blob")
    axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    xform = wp.transform(wp.vec3(0.3, -0.2, 0.1), wp.quat_from_axis_angle(wp.vec3(*axis), 0.7))
    seven = np.array(xform, dtype=np.float64)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    q = np.eye(3) + np.sin(0.7) * k + (1 - np.cos(0.7)) * k @ k
    inner = placed("point", inner_points(grid, rng), 3, q, seven[:3], 1.0)
    x = np.concatenate([inner, rng.normal(size=(4000, 3))]).astype(np.float32)
    answers = [
        bounder.values(x, xform=form).numpy()
        for form in (xform, seven, list(seven), torch.tensor(seven, requires_grad=True))
    ]
    for other in answers[1:]:
        assert (answers[0] == other).all()
    matrix = bounder.query(x, xform=homogeneous(q, seven[:3])).numpy()
    assert (matrix == bounder.query(x, xform=xform).numpy()).mean() > 0.999
    assert (bounder.query(x, xform=wp.mat44(*homogeneous(q, seven[:3]).ravel())).numpy() == matrix).mean() > 0.999


def test_special_numbers_of_points():
    bounder, animated = fitted("mlp", "blob"), fitted("mlp", "animated")
    x = np.full((4, 3), np.float32(0.5))
    x[[0, 1, 2], [0, 1, 2]] = np.nan, np.inf, -np.inf
    x[3] = 3e38
    assert bounder.query(x, scale=2.0).numpy().tolist() == [1, 1, 1, 0]
    late = np.float32([[9.0, 0.5, 0.5, 0.5], [9.0, 1e30, 0.5, 0.5], [0.5, 1e30, 0.5, 0.5]])
    assert animated.query(late, scale=2.0).numpy().tolist() == [1, 1, 0]


IMPOSSIBLE = (
    *({"scale": scale} for scale in (0.0, np.nan, [1.0, 2.0], "large", [[1.0], [2.0, 3.0]], True, [1e-9, 1.0, 1.0])),
    *({"xform": np.eye(4) + wrong} for wrong in (0j, np.eye(4, k=-3), np.eye(4), np.full((4, 4), np.nan))),
    *({"xform": xform} for xform in (np.eye(3), [0, 0, 0, 0, 0, 0, 2], [[1], [2, 3]])),
    *({"xform": [far, 0, 0, 0, 0, 0, 1]} for far in (np.inf, 1e300)),
)


def test_impossible_placements_are_refused():
    for options in IMPOSSIBLE:
        with pytest.raises(QueryError) as error:
            fitted("aabb", "blob").query(np.zeros((1, 3)), **options)
        assert len(str(error.value).splitlines()) == 1


NAMES = ("c", "blob", "animated")
CLEAR = 1e-9  # cells: far above the float64 rounding of the tests' own maps


def points_and_directions(query: str, n: int) -> tuple[slice, slice]:
    first, last = slice(0, n), slice(n, 2 * n)
    return (last, first) if query == "plane" else (first, last)


def clear_points(grid, rng, count: int) -> np.ndarray:
    """Points in the object, most of them within a millionth of a cell's faces."""
    cells = grid.occupied[rng.integers(len(grid.occupied), size=count)]
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    near = np.copysign(0.5 - 10.0 ** rng.uniform(-8, -3, cells.shape), offset)
    return grid.position(cells + np.where(rng.random(cells.shape) < 0.8, near, offset))


def certainly_inside(grid, x: np.ndarray) -> np.ndarray:
    t = grid.cell_coordinate(x)
    index = np.clip(np.rint(t), 0, np.array(grid.shape) - 1).astype(int)
    return (np.abs(t - index) < 0.5 - CLEAR).all(axis=1) & grid.occupancy[tuple(index.T)]


def witnessed(grid, query: str, length: float, rotated, shift, factors, rng, dtype, count=3000) -> np.ndarray:
    """Queries in the world, of ``dtype`` and exactly that, which pass through points that are clearly in the object."""
    n, first = grid.ndim, int(grid.time)
    x = clear_points(grid, rng, count)
    d = rng.normal(size=x.shape) * np.where(rng.random(x.shape) < 0.2, 1e-4, 1.0)
    d = np.where((rng.random(count) < 0.2)[:, None], np.eye(n)[rng.integers(n, size=count)], d)
    if query == "box":
        y = placed("point", x, n, rotated, shift, factors, time=first)
        reach = rng.random((2, *y.shape)) * rng.choice([0.0, 1e-5, 0.1, 10.0, 1e4, 1e7], size=(2, count, n))
        world = np.concatenate([y - reach[0], y + reach[1]], axis=1).astype(dtype)
        y = np.clip(y, world[:, :n], world[:, n:])  # of the rounded box, the point nearest to y
        return world[certainly_inside(grid, placed("point", y, n, rotated, shift, factors, back=True, time=first))]
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    if query == "plane":
        along = rng.normal(size=x.shape)
        along -= unit * (along * unit).sum(axis=1, keepdims=True)
        q = np.concatenate([unit, x + along * rng.choice([0.0, 0.5, 5.0, 50.0, 1e6], size=(count, 1))], axis=1)
    else:
        t = length * rng.choice([0.0, 1e-6, 0.3, 1 - 1e-6, 1.0], size=(count, 1))
        q = np.concatenate([x - t * unit, unit], axis=1)
    world = placed(query, q, n, rotated, shift, factors, time=first)
    _, direction = points_and_directions(query, n)
    world[:, direction] *= 10.0 ** rng.uniform(-6, 6, (count, 1))
    world = world.astype(dtype)
    q = placed(query, world, n, rotated, shift, factors, back=True, time=first)  # 1e-13 off
    a, b = q[:, :n], q[:, n:]
    if query == "plane":
        x = x - a * (((x - b) * a).sum(axis=1, keepdims=True) / (a * a).sum(axis=1, keepdims=True))
    else:
        unit = b / np.linalg.norm(b, axis=1, keepdims=True)
        x = a + unit * np.clip(((x - a) * unit).sum(axis=1, keepdims=True), 0, length * (1 - 1e-12))
    return world[certainly_inside(grid, x)]


@cache
def bounders(name: str, query: str, length: float):
    grid = shape(name)
    methods = ("kdop", "obb") if name == "blob" else ("kdop",)
    return [fitted_region(method, query, grid, length=length) for method in methods]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", REGIONS)
def test_placed_regions_are_never_denied(query, name, dtype, device, rng):
    grid, s = shape(name), shape(name).ndim - shape(name).time
    for length in (ray_length(grid), 30.0) if query == "ray" else (1.0,):  # long: from outside, and far outside
        for factors in (1.0, 0.1, 10.0, rng.uniform(0.5, 2, s)):
            rotated, shift = rotation(s, rng), rng.uniform(-10, 10, s)
            world = witnessed(grid, query, length, rotated, shift, factors, rng, dtype)
            assert len(world) > 1000
            for bounder in bounders(name, query, length):
                values = bounder.to(device).values(world, xform=homogeneous(rotated, shift), scale=factors).numpy()
                assert (values >= bounder.threshold).all(), (bounder, world[values < bounder.threshold][:3])


@pytest.mark.parametrize("query", REGIONS)
def test_length_stays_in_object_units(query):
    """A ray that just reaches a shape of ten times the size is ten times as long in the world."""
    grid = shape("half")  # a slab: x <= 0.5
    bounder = fitted_region("kdop", query, grid, length=0.5)
    world = {
        "ray": [[9.9, 5, 5, -1, 0, 0], [10.1, 5, 5, -1, 0, 0]],
        "plane": [[-1, 0, 0, 4.9, 5, 5], [-1, 0, 0, 5.1, 5, 5]],
        "box": [[4.9, 0, 0, 6, 1, 1], [5.1, 0, 0, 6, 1, 1]],
    }[query]
    assert bounder.values(np.float32(world), scale=10.0).numpy().tolist()[0] >= bounder.threshold
    assert bounder.values(np.float32(world), scale=10.0).numpy().tolist()[1] < bounder.threshold
    moved = np.float32(world)
    moved[:, 3 if query == "plane" else 0] += 64
    if query == "box":
        moved[:, 3] += 64
    answers = bounder.values(moved, xform=wp.transform((64.0, 0.0, 0.0), wp.quat_identity()), scale=10.0).numpy()
    assert (answers >= bounder.threshold).tolist() == [True, False]


TURNED = wp.transform((1.0, 2.0, 3.0), wp.quat(0.5, 0.5, 0.5, 0.5))


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("query", REGIONS)
def test_placed_special_numbers(query, scale):
    """Maybe, whatever else: not finite, no direction, upside down, so large that the map overflows."""
    bounder = fitted_region("kdop", query, shape("blob"))
    usual = [9.0, 9, 9, 9.5, 9.5, 9.5]
    strange = [[*usual[:k], bad, *usual[k + 1 :]] for k in range(6) for bad in (np.nan, np.inf, -np.inf)]
    if query == "box":
        strange += [[9, 9, 9, 9, 9, 8], [1, 0, 0, -1, 1, 1], [-3e38, -3e38, -3e38, 3e38, 3e38, 3e38]]
    else:
        shortest = [0.0] * 3, [1e-45, 0, 0], [1e-30, -1e-30, 0]
        strange += [[*d, 9, 9, 9] if query == "plane" else [9, 9, 9, *d] for d in shortest]
        strange += [[3e38] * 6, [-3e38, 3e38, 1, 3e38, -3e38, 1]]
    assert (bounder.values(np.float32(strange), xform=TURNED, scale=scale).numpy() >= bounder.threshold).all()
    assert bounder.query(np.float32(strange), xform=TURNED, scale=scale).numpy().all()


@pytest.mark.parametrize("query", ["point", *REGIONS])
@pytest.mark.parametrize(
    ("options", "dtype"),
    [
        ({"xform": [1e6, 0, 0, 0, 0, 0, 1]}, np.float64),  # float64 numbers are rounded out there
        ({"xform": [0.1 + 1e6, 0, 0, 0, 0, 0, 1]}, np.float32),  # the translation itself is no float32 number
        ({"scale": 1e37}, np.float32),
        ({"scale": 1e300}, np.float32),  # its inverse is zero
        ({"xform": [1e30, 0, 0, 0, 0, 0, 1]}, np.float64),
    ],
    ids=str,
)
def test_placements_beyond_the_certificate_are_refused(query, options, dtype):
    bounder = fitted("aabb", "blob") if query == "point" else fitted_region("aabb", query, shape("blob"))
    for ask in (bounder.query, bounder.candidates):
        with pytest.raises(
            QueryError, match=f"move a {query} by a rounding error .* certificate covers|must fit float32"
        ):
            ask(np.zeros((1, bounder.domain.columns), dtype), **options)


def in_single(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``x matrix^T`` as float32 products and sums, float64."""
    products = x.astype(np.float32)[:, None] * matrix.astype(np.float32)
    total = products[..., 0]
    for k in range(1, products.shape[2]):
        total = total + products[..., k]
    return total.astype(np.float64)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", ["ray", "plane"])
def test_rounding_stays_within_its_bound(query, name, dtype, rng):
    """The moved float32 numbers, and how far their exact region passes a point of the exact region."""
    grid, length = shape(name), 3.0
    n, s, domain = grid.ndim, grid.ndim - grid.time, domain_of(grid, query, length)
    scale, center = domain.base.scale.astype(np.float64), domain.base.center.astype(np.float64)
    point, direction = points_and_directions(query, n)
    near_share = 0.0
    for factors in (1.0, 0.1, 10.0, *rng.uniform(0.3, 3, (8, s))):
        rotated, shift = rotation(s, rng), rng.uniform(-10, 10, s)
        placement = Placement.of(domain, homogeneous(rotated, shift), factors)
        bound = placement_error(domain, placement.world, double=dtype is np.float64)
        matrix, drift = placement.values[n : n + n * n].reshape(n, n), placement.values[n + n * n : 2 * n + n * n]
        x = domain.base.to_object(rng.uniform(-0.9, 0.9, (4000, n)))
        unit = rng.normal(size=x.shape)
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        away = rng.normal(size=x.shape)
        away -= unit * (away * unit).sum(axis=1, keepdims=True)
        away *= rng.choice([0.0, 1.0, 1e3, 1e5], size=(4000, 1))
        q = np.concatenate(
            [unit, x + away] if query == "plane" else [x - rng.random((4000, 1)) * length * unit, unit], 1
        )
        world = placed(query, q, n, rotated, shift, factors, time=n - s).astype(dtype)
        q = placed(query, world, n, rotated, shift, factors, back=True, time=n - s)
        single = world.astype(np.float32)
        turn = matrix if query == "ray" else placement.values[2 * n + n * n :].reshape(n, n)
        moved, turned = (
            in_single(matrix, single[:, point] - placement.values[:n]),
            in_single(turn, single[:, direction]),
        )
        far = np.abs((q[:, point] - center) * scale).sum(axis=1)[:, None]
        d = q[:, direction] / np.linalg.norm(q[:, direction], axis=1, keepdims=True)
        if query == "ray":
            t = np.clip(((x - q[:, point]) * d).sum(axis=1, keepdims=True), 0, length)
            off = q[:, point] + t * d - (moved + t * turned / np.linalg.norm(turned, axis=1, keepdims=True))
            off = np.abs(off) * scale
        else:
            x = x - d * ((x - q[:, point]) * d).sum(axis=1, keepdims=True)
            normal = turned / scale
            off = np.abs((normal * ((x - moved) * scale)).sum(axis=1)) / np.abs(normal).max(axis=1)
            off = off[:, None]
        host = 1e-13 * (1 + far)  # what this test's own float64 rounds
        allowed = bound + np.where(far > FAR, far * drift, 0.0) + host
        assert (off <= allowed).all()
        near_share = max(near_share, float((off / allowed)[far[:, 0] <= FAR].max()))
    assert near_share > 0.05  # and the bound is worth something
