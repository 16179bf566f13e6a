"""Points: no positive is denied, by any method; beyond keyframes the answer is maybe; what goes in and out."""

from functools import cache

import numpy as np
import pytest
import trimesh
import warp as wp
from asking import ask
from bounding_shapes import CONSERVATIVE, HIDDEN, crossed, domain_points, fitted, object_points, report_of, shape
from plain_shapes import box_of

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.errors import BounderError, DeviceError, QueryError
from warp_bounding.proof import positive_boxes
from warp_bounding.proof.search import minimum


def low_points(bounder, grid) -> np.ndarray:
    """What a search finds lowest on the object, in object space, as float32 points of it; also nudged on all axes."""
    lower, upper = positive_boxes(bounder, grid)
    search = minimum(bounder, lower, upper, eps=1e-2, boxes=100_000)
    x = bounder.domain.to_object(search.worst).astype(np.float32)
    x = np.concatenate([x, *(np.nextafter(x, np.float32(s * np.inf)) for s in (-1, 1))])
    return x[grid.contains(x)]


@pytest.mark.parametrize(
    ("method", "name"),
    crossed(CONSERVATIVE, ("line", "c", "blob", "single", "anisotropic", "mesh", "animated", "five")),
)
def test_no_false_negative(method, name, device, rng):
    grid, bounder = shape(name), fitted(method, name).to(device)
    assert bounder.certificate.proven
    dense = domain_points(grid, 40_000, rng)
    positives = np.concatenate([object_points(grid, rng), low_points(bounder, grid), dense[grid.contains(dense)]])
    assert len(positives) > 3000  # there is something to deny
    assert bounder.query(positives).numpy().all()
    answers = bounder.query(dense).numpy().astype(bool)
    if not grid.time:
        beyond = 2 * bounder.domain.delta / bounder.domain.scale
        outside = ((dense < grid.lower - beyond) | (dense > grid.upper + beyond)).any(axis=1)
        assert outside.any()
        assert not answers[outside].any()
    if METHODS[method].exact_on_cells:  # and the bounder denies something; the networks here are hardly trained
        assert not answers.all()


@pytest.mark.parametrize("method", ["aabb", "oriented-ellipsoid", "bvh", "voxels", "mlp"])
def test_double_precision_points(method, rng):
    """Points of the object in float64 are rounded to float32 first; the proof covers that."""
    grid, bounder = shape("mesh"), fitted(method, "mesh")
    cells = grid.occupied[rng.integers(len(grid.occupied), size=20_000)]
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    offset = np.where(rng.random(cells.shape) < 0.6, np.copysign(0.5, offset), offset)
    assert bounder.query(grid.position(cells + offset)).numpy().all()


SPAN = (-0.7, 0.1)  # no cells of time meet both ends
POINTS = ("aabb", "bvh", "voxels", "mlp")
TIMED = [(name, query) for name in ("kdop", "bvh") for query in ("ray", "plane", "box")]


@cache
def moving_box() -> wb.shapes.MovingMesh:
    """A small box that wanders from one corner to the other."""
    solid = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    frames = np.stack([solid.vertices + shift for shift in (-0.3, 0.1, 0.3)])
    return wb.shapes.MovingMesh(frames, solid.faces, times=[SPAN[0], sum(SPAN) / 2, SPAN[1]], time_cells=3)


@cache
def bounded(method: str, query: str) -> wb.Bounder:
    reported = report_of(method, query, hidden=HIDDEN, steps=3)
    return wb.fit(moving_box().to_grid(resolution=5), query=query, method=method, device="cpu", **reported)


def beyond(rng: np.random.Generator) -> np.ndarray:
    """float32 times before the first and after the last cell of time: the next ones, and up to many ranges away."""
    grid = moving_box().to_grid(resolution=5)
    (start, *_), (end, *_) = grid.lower, grid.upper
    away, times = (end - start) * np.concatenate([[0.0], 10.0 ** rng.uniform(-9, 6, 200)]), []
    for border, sign in ((start, -1), (end, 1)):
        times.append(np.nextafter((border + sign * away).astype(np.float32), np.float32(sign * np.inf)))
    times = np.concatenate(times)
    return times[(times < start) | (times > end)]


def places(count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, 3)``: on the object's way, near it and far from it."""
    return (rng.uniform(-1, 1, (count, 3)) * 10.0 ** rng.integers(-1, 3, (count, 1))).astype(np.float32)


@pytest.mark.parametrize("method", POINTS)
def test_points_beyond_the_keyframes(method, rng):
    bounder, times = bounded(method, "point"), beyond(rng)
    for _ in range(5):
        x = np.column_stack([times, places(len(times), rng)])
        assert bounder.query(x).numpy().all()
        assert bounder.query(x.astype(np.float64)).numpy().all()
        assert ask(bounder, x).all()
    inside = rng.uniform(SPAN[0] + 0.1, SPAN[1] - 0.1, len(times))  # between them there are answers
    assert method == "mlp" or not bounder.query(np.column_stack([inside, np.full((len(times), 3), 5.0)])).numpy().any()


@pytest.mark.parametrize(("method", "query"), TIMED)
def test_regions_beyond_the_keyframes(method, query, rng):
    """A region that holds no time of the motion; one that reaches into it counts by its part inside."""
    bounder, times = bounded(method, query), beyond(rng)
    at = np.column_stack([times, places(len(times), rng)])
    away = np.where(times > sum(SPAN) / 2, 1.0, -1.0)  # out of the range of time
    if query == "box":
        further = at + np.column_stack([away * rng.choice([0.0, 0.1, 9.0], len(at)), rng.random((len(at), 3))])
        x = np.concatenate([np.minimum(at, further), np.maximum(at, further)], axis=1)
    elif query == "ray":
        d = rng.normal(size=at.shape)
        d[:, 0] = np.abs(d[:, 0]) * away * (rng.random(len(d)) < 0.7)
        x = np.concatenate([at, d], axis=1)
    else:  # the planes that hold no time of the motion are those of one time
        x = np.concatenate([np.tile([1.0, 0.0, 0.0, 0.0], (len(at), 1)), at], axis=1)
    assert not (bounder.values(x.astype(np.float32)).numpy() < bounder.threshold).any()
    assert ask(bounder, x.astype(np.float32)).all()


@pytest.mark.parametrize("query", ["point", "box"])
def test_a_bounder_that_denies_beyond_the_keyframes_is_not_certified(query):
    """Such as one of cells that reach beyond them."""
    grid = moving_box().to_grid(resolution=5)
    wide = np.concatenate([grid.occupancy[:1], grid.occupancy, grid.occupancy[-1:]])
    longer = wb.shapes.Grid(wide, cells_per_unit=grid.cells_per_unit, offset=grid.offset - [1, 0, 0, 0], time=True)
    bounder = wb.fit(longer, query=query, method="bvh", device="cpu")
    assert wb.certify(bounder, longer).proven
    proof = wb.certify(bounder, grid)
    assert proof.kind == "inapplicable"
    assert "known at times from" in proof.message
    assert wb.certify(bounded("bvh", query), grid).proven


torch = pytest.importorskip("torch", reason="torch is not installed")


@pytest.fixture
def bounder():
    return fitted("aabb", "blob")


@pytest.fixture
def x(rng):
    points = domain_points(shape("blob"), 1500, rng)
    points[::50] = np.nan
    return points


@pytest.mark.parametrize("dtype", ["u1", "i8", ">i4"])
def test_whole_numbers_that_float32_holds_exactly(dtype):
    solid = box_of([0.5, 0.5, 0.5], [2.5, 2.5, 2.5])
    bounder, whole = wb.fit(solid, method="aabb", device="cpu"), np.indices((4, 4, 4)).reshape(3, -1).T
    expected = bounder.query(whole.astype(np.float32)).numpy()
    assert set(expected) == {0, 1}
    assert (bounder.query(whole.astype(dtype)).numpy() == expected).all()
    assert (bounder.query(whole.tolist()).numpy() == expected).all()
    if dtype != ">i4":
        assert (bounder.query(torch.from_numpy(whole.astype(dtype))).numpy() == expected).all()
    large = np.array([[2**24, 2**62, -(2**40)], [1, 1, 1]])
    assert bounder.query(large).numpy().tolist() == bounder.query(large.astype(np.float32)).numpy().tolist() == [0, 1]


def test_arrays_of_every_kind_are_asked_alike(bounder, x):
    expected, t, wide = bounder.query(x).numpy(), torch.from_numpy(x), np.zeros((len(x), 7), np.float32)
    assert expected[::50].all()
    assert set(np.unique(expected)) == {0, 1}
    wide[:, 1:7:2] = x
    frozen = x.copy()
    frozen.setflags(write=False)
    unaligned = np.frombuffer(b"\0" + x.tobytes(), np.uint8)[1:].view(np.float32).reshape(x.shape)
    for same in (
        *(x.tolist(), x.astype(np.float64), x.astype(">f4"), x.astype(">f8")),
        *(np.asfortranarray(x), wide[:, 1:7:2], frozen, unaligned),
        *(t, t.double(), t.clone().requires_grad_(), t.T.contiguous().T, torch.cat([t, t], 1)[:, 3:]),
    ):
        assert (bounder.query(same).numpy() == expected).all()
    assert (bounder.query(x[::-3]).numpy() == expected[::-3]).all()
    assert (bounder.query(t[::2]).numpy() == expected[::2]).all()
    assert bounder.query([[0, 1, 2]]).shape == (1,)
    for large, answer in ((1e300, 1), (3e38, 0)):  # beyond float32: maybe
        assert bounder.query(np.full((1, 3), large)).numpy()[0] == answer
        assert bounder.query(torch.full((1, 3), large, dtype=torch.float64)).numpy()[0] == answer


def test_warp_arrays(bounder, x, device):
    bounder = bounder.to(device)
    wide = wp.array(np.concatenate([x, x], axis=1), dtype=wp.float32, device=device)
    double = x.astype(np.float64) * (1 + 1e-9)
    double[3] = 1e300
    for of, dtypes in ((x, (wp.vec3, wp.float32)), (double, (wp.vec3d, wp.float64))):
        expected = bounder.query(of).numpy()
        for array in (wp.array(of, dtype=dtype, device=device) for dtype in dtypes):
            assert (bounder.query(array).numpy() == expected).all()
            assert (bounder.query(array[::3]).numpy() == expected[::3]).all()
    with pytest.raises(QueryError, match="would have to be copied"):
        bounder.prepare(array)
    assert (bounder.query(wide[:, 3:]).numpy() == bounder.query(x).numpy()).all()


def test_nothing_gives_nothing(bounder, device):
    bounder = bounder.to(device)
    warp = (wp.zeros(0, dtype=wp.vec3, device=device), wp.zeros((0, 3), dtype=wp.float32, device=device))
    for empty in ([], np.zeros((0, 3), np.float32), np.zeros((0, 3)), torch.zeros(0, 3, device=device), *warp):
        answer, (indices, count) = bounder.query(empty), bounder.candidates(empty)
        assert (answer.shape, answer.dtype, indices.shape) == ((0,), wp.bool, (0,))
        assert count.numpy().tolist() == [0]


@pytest.mark.parametrize(
    "x",
    [
        *(np.zeros(of) for of in (3, (2, 2), (2, 3, 1), (0, 2))),
        *(np.zeros((2, 3), dtype) for dtype in (np.float16, bool, complex)),
        *([[1, 2, 3], [1, 2]], [[], []], [[True, False, True]], [[10**30, 0, 0]], [None], None, "points", 1.0, {1: 2}),
        *(np.array([[2**24 + 1, 0, 0]]), np.array([[2**64 - 1, 0, 0]], np.uint64), [[2**24 + 1, 0, 0]]),
        *(torch.zeros(2, 3, dtype=torch.float16), torch.tensor([[2**24 + 1, 0, 0]]), torch.zeros(2, 2)),
        *(torch.zeros(2, 3).to_sparse(), torch.zeros(2, 3, device="meta"), np.array([["a", "b", "c"]])),
        np.ma.array(np.zeros((2, 3), np.float32), mask=np.eye(2, 3)),
        np.broadcast_to(np.float32(0.5), (2**30, 3)),  # more than kernels can count
        *(wp.zeros(3, dtype=dtype, device="cpu") for dtype in (wp.vec2, wp.int32, wp.float32, wp.mat33)),
        *(wp.zeros((3, 3), dtype=dtype, device="cpu") for dtype in (wp.int32, wp.vec3)),
    ],
    ids=lambda x: f"{type(x).__name__}-{getattr(x, 'shape', '')}-{getattr(x, 'dtype', '')}",
)
def test_other_queries_are_refused(x):
    with pytest.raises(QueryError) as error:
        fitted("aabb", "blob").query(x)
    assert isinstance(x, wp.array) or "queries must" in str(error.value)
    assert "object" not in str(error.value)  # which is what NumPy makes of anything


@wp.kernel(enable_backward=False)
def _takes_data(data: wb.Data, out: wp.array(dtype=float)):
    out[0] = data.parameters[0]


def test_a_bounder_in_place_of_its_data_is_told_so(bounder):
    out = wp.zeros(1, dtype=float, device="cpu")
    with pytest.raises(TypeError, match=r"pass bounder\.data to a kernel, not the bounder itself, got <"):
        wp.launch(_takes_data, dim=1, inputs=[bounder], outputs=[out], device="cpu")


def test_other_devices_are_refused(bounder):
    for name in ("cuda:99", "gpu", 7, ["cpu"]):
        with pytest.raises(DeviceError, match=r"no such device on this machine: expected .*cpu") as error:
            bounder.to(name)
        assert isinstance(error.value, BounderError)  # as it was in versions without an error of its own
        assert isinstance(error.value, QueryError)
    if wp.get_cuda_device_count():
        with pytest.raises(QueryError, match="device"):
            bounder.query(wp.zeros(3, dtype=wp.vec3, device="cuda:0"))


def test_out(bounder, x, device):
    bounder = bounder.to(device)
    expected, out = bounder.query(x).numpy(), wp.empty(len(x), dtype=wp.bool, device=device)
    assert bounder.query(x, out=out) is out
    assert (out.numpy() == expected).all()
    wrong = [
        np.zeros(len(x), bool),
        wp.zeros(len(x) + 1, dtype=wp.bool, device=device),
        wp.zeros(len(x), dtype=wp.uint8, device=device),
        wp.zeros((len(x), 1), dtype=wp.bool, device=device),
        wp.zeros(2 * len(x), dtype=wp.bool, device=device)[::2],
    ]
    for array in wrong:
        with pytest.raises(QueryError, match=r"out must be .*dtype bool, got"):
            bounder.query(x, out=array)


@pytest.mark.parametrize("count", [1, 2049, 80_000])
def test_candidates_are_the_ascending_ones(bounder, count, device, rng, monkeypatch):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "2")
    bounder, x = bounder.to(device), domain_points(shape("blob"), count, rng)
    corner = np.broadcast_to(np.float32(0.99) * bounder.domain.upper.astype(np.float32), x.shape)  # of what is usual
    for queried in (x, np.full_like(x, np.nan), corner.copy()):  # some, all, none
        indices, number = bounder.candidates(queried)
        assert indices.dtype == number.dtype == wp.int32
        assert (indices.shape, number.shape) == ((count,), (1,))
        expected = np.flatnonzero(bounder.query(queried).numpy())
        assert number.numpy()[0] == len(expected)
        assert (indices.numpy()[: len(expected)] == expected).all()


def test_weights_cannot_be_changed(bounder):
    for tensor in bounder.tensors.values():
        with pytest.raises(ValueError, match="read-only"):
            tensor[...] = 0
