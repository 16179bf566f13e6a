"""Shapes placed in the world: their points are never denied, and what the certificate does not cover is refused."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import CONSERVATIVE, crossed, fitted, object_points, shape
from placements import homogeneous, rotation

from warp_bounding.errors import QueryError


def inner_points(grid, rng) -> np.ndarray:
    """Points of the object, float64."""
    cells = grid.occupied[rng.integers(len(grid.occupied), size=4000)]
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    return grid.position(cells + np.where(rng.random(cells.shape) < 0.6, np.copysign(0.5, offset), offset))


def to_world(grid, x, q, t, factors) -> np.ndarray:
    first = int(grid.time)
    world = x.copy()
    world[:, first:] = (x[:, first:] * factors) @ q.T + t
    return world


@pytest.mark.parametrize(
    ("method", "name"),
    crossed(CONSERVATIVE, ["c", "blob", "animated"], kinds=("kdop", "mlp")),  # of a map that all have
)
def test_placed_points_are_never_denied(method, name, device, rng):
    grid, bounder = shape(name), fitted(method, name).to(device)
    s = grid.ndim - grid.time
    for _ in range(4):
        q, t, factors = rotation(s, rng), rng.normal(size=s), rng.uniform(0.5, 2, s)
        world = to_world(grid, inner_points(grid, rng), q, t, factors)
        xform = homogeneous(q, t)
        assert bounder.query(world, xform=xform, scale=factors).numpy().all()  # float64: rounded in world space
        near = world.astype(np.float32)  # float32: exact, so the truth is where they are
        back = near.astype(np.float64)
        first = int(grid.time)
        back[:, first:] = (back[:, first:] - t) @ q / factors
        cell = grid.cell_coordinate(back)
        index = np.clip(np.rint(cell), 0, np.array(grid.shape) - 1).astype(int)
        sure = (np.abs(cell - index) < 0.5 - 1e-9).all(axis=1) & grid.occupancy[tuple(index.T)]
        assert sure.any()
        assert bounder.query(near[sure], xform=xform, scale=factors).numpy().all()


@pytest.mark.parametrize("skew", [0.0, 4e-4])
def test_reflections_and_nearly_orthogonal_matrices_are_placed_as_they_are(skew, device, rng):
    grid, bounder = shape("c"), fitted("aabb", "c").to(device)
    q, t = rotation(grid.ndim, rng) @ np.diag([-1.0, *[1.0] * (grid.ndim - 1)]), rng.normal(size=grid.ndim)
    q = q @ (np.eye(grid.ndim) + skew * rng.uniform(-1, 1, (grid.ndim,) * 2))
    world = to_world(grid, inner_points(grid, rng), q, t, 1.0)
    assert bounder.query(world, xform=homogeneous(q, t)).numpy().all()


@pytest.mark.parametrize("method", ["aabb", "mlp"])
def test_transforms_come_in_several_forms(method, rng):
    grid, bounder = shape("blob"), fitted(method, "blob")
    axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    xform = wp.transform(wp.vec3(0.3, -0.2, 0.1), wp.quat_from_axis_angle(wp.vec3(*axis), 0.7))
    seven = np.array(xform, dtype=np.float64)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    q = np.eye(3) + np.sin(0.7) * k + (1 - np.cos(0.7)) * k @ k
    x = np.concatenate([to_world(grid, inner_points(grid, rng), q, seven[:3], 1.0), rng.normal(size=(4000, 3))]).astype(
        np.float32
    )
    answers = [bounder.values(x, xform=form).numpy() for form in (xform, seven, list(seven), tuple(seven))]
    for other in answers[1:]:
        assert (answers[0] == other).all()
    matrix = bounder.query(x, xform=homogeneous(q, seven[:3])).numpy()
    assert (matrix == bounder.query(x, xform=xform).numpy()).mean() > 0.999
    assert (bounder.query(x, xform=wp.mat44(*homogeneous(q, seven[:3]).ravel())).numpy() == matrix).mean() > 0.999


def test_a_tensor_with_gradients_places(rng):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    grid, bounder = shape("blob"), fitted("aabb", "blob")
    x, matrix = object_points(grid, rng, 500), homogeneous(np.eye(3), [0.1, 0.2, 0.3])
    expected = bounder.query(x, xform=matrix, scale=2.0).numpy()
    xform, scale = (torch.tensor(value, requires_grad=True) for value in (matrix, 2.0))
    assert (bounder.query(x, xform=xform, scale=scale).numpy() == expected).all()


def test_identity_changes_nothing(rng):
    grid, bounder = shape("blob"), fitted("mlp", "blob")
    x = object_points(grid, rng, 500)
    plain = bounder.query(x).numpy()
    assert (bounder.query(x, scale=1.0).numpy() == plain).all()
    assert (bounder.query(x, xform=np.eye(4), scale=(1, 1, 1)).numpy() == plain).all()
    count = bounder.candidates(x, xform=np.eye(4))[1]
    assert count.numpy()[0] == plain.sum()


def test_placed_special_numbers():
    bounder, animated = fitted("mlp", "blob"), fitted("mlp", "animated")
    x = np.full((4, 3), np.float32(0.5))
    x[[0, 1, 2], [0, 1, 2]] = np.nan, np.inf, -np.inf
    x[3] = 3e38
    assert bounder.query(x, scale=2.0).numpy().tolist() == [1, 1, 1, 0]
    late = np.float32([[9.0, 0.5, 0.5, 0.5], [9.0, 1e30, 0.5, 0.5], [0.5, 1e30, 0.5, 0.5]])
    assert animated.query(late, scale=2.0).numpy().tolist() == [1, 1, 0]


@pytest.mark.parametrize(
    "options",
    [
        {"scale": 0.0},
        {"scale": -1.0},
        {"scale": np.nan},
        {"scale": np.inf},
        {"scale": [1.0, 2.0]},
        {"scale": "large"},
        {"scale": [[1.0], [2.0, 3.0]]},
        {"scale": "2"},
        {"scale": True},
        {"scale": 2 + 0j},
        {"scale": np.eye(3)},
        {"xform": np.eye(4) + 0j},
        {"xform": False},
        {"xform": np.eye(4) + np.eye(4, k=-3)},
        {"xform": np.eye(3)},
        {"xform": np.zeros((4, 4))},
        {"xform": 2 * np.eye(4)},
        {"xform": np.full((4, 4), np.nan)},
        {"xform": [0, 0, 0, 0, 0, 0, 2]},
        {"xform": [0, 0, 0, 0, 0, 0]},
        {"xform": [np.inf, 0, 0, 0, 0, 0, 1]},
        {"xform": "here"},
        {"xform": [[1], [2, 3]]},
        {"xform": [1e300, 0, 0, 0, 0, 0, 1]},
        {"scale": [1e-9, 1.0, 1.0]},
    ],
    ids=str,
)
def test_impossible_placements_are_refused(options):
    with pytest.raises(QueryError) as error:
        fitted("aabb", "blob").query(np.zeros((1, 3)), **options)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "dtype"),
    [
        ({"xform": [1e6, 0, 0, 0, 0, 0, 1]}, np.float64),  # float64 points are rounded out there
        ({"xform": [0.1 + 1e6, 0, 0, 0, 0, 0, 1]}, np.float32),  # the translation itself is no float32 number
        ({"scale": 1e44}, np.float32),  # its inverse is subnormal: zero on some devices
        ({"scale": 1e300}, np.float32),  # and zero on all
        ({"xform": [1e30, 0, 0, 0, 0, 0, 1]}, np.float32),
    ],
    ids=str,
)
def test_placements_beyond_the_certificate_are_refused(options, dtype):
    with pytest.raises(QueryError, match="certificate covers"):
        fitted("aabb", "blob").query(np.zeros((1, 3), dtype), **options)


def test_far_away_is_no_matter_where_float32_is_exact(rng):
    """Float32 points around a translation that float32 holds lose nothing."""
    grid, bounder = shape("blob"), fitted("voxels", "blob")
    t = np.array([2.0**20, -(2.0**19), 3.0])
    world = np.float32(inner_points(grid, rng) + t)
    x = world.astype(np.float64) - t
    assert (bounder.query(world, xform=homogeneous(np.eye(3), t)).numpy() >= grid.contains(x)).all()
