"""What goes into ``query`` and ``candidates``, what comes out, and what is refused in one line."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import domain_points, fitted, shape

import warp_bounding as wb
from warp_bounding.errors import BounderError, BoundingError, DeviceError, QueryError

torch = pytest.importorskip("torch", reason="torch is not installed")


@pytest.fixture(params=["aabb", "mlp"])
def bounder(request):
    return fitted(request.param, "blob")


@pytest.fixture
def x(rng):
    points = domain_points(shape("blob"), 1500, rng)
    points[::50] = np.nan
    return points


def test_numpy_and_lists(bounder, x):
    expected = bounder.query(x).numpy()
    assert expected[::50].all()
    assert set(np.unique(expected)) == {0, 1}
    assert (bounder.query(x.astype(np.float64)).numpy() == expected).all()
    assert (bounder.query(x[:40].tolist()).numpy() == expected[:40]).all()
    assert (bounder.query(np.asfortranarray(x)).numpy() == expected).all()
    assert (bounder.query(x[::-3]).numpy() == expected[::-3]).all()
    wide = np.zeros((len(x), 7), np.float32)
    wide[:, 1:7:2] = x
    assert (bounder.query(wide[:, 1:7:2]).numpy() == expected).all()
    frozen = x.copy()
    frozen.setflags(write=False)
    assert (bounder.query(frozen).numpy() == expected).all()
    unaligned = np.frombuffer(b"\0" + x.tobytes(), np.uint8)[1:].view(np.float32).reshape(x.shape)
    assert (bounder.query(unaligned).numpy() == expected).all()
    assert bounder.query([[0, 1, 2]]).shape == (1,)
    for dtype in (">f4", ">f8"):
        assert (bounder.query(x.astype(dtype)).numpy() == expected).all()


@pytest.mark.parametrize("dtype", ["u1", "i2", "u4", "i8", ">i4"])
def test_whole_numbers_that_float32_holds_exactly(dtype):
    solid = wb.solids.Box([0.5, 0.5, 0.5], [2.5, 2.5, 2.5])
    bounder, whole = wb.fit(solid, method="aabb", device="cpu"), np.indices((4, 4, 4)).reshape(3, -1).T
    expected = bounder.query(whole.astype(np.float32)).numpy()
    assert set(expected) == {0, 1}
    assert (bounder.query(whole.astype(dtype)).numpy() == expected).all()
    assert (bounder.query(whole.tolist()).numpy() == expected).all()
    if dtype in ("u1", "i2", "i8"):
        assert (bounder.query(torch.from_numpy(whole.astype(dtype))).numpy() == expected).all()
    large = np.array([[2**24, 2**62, -(2**40)]])
    assert bounder.query(large).numpy() == bounder.query(large.astype(np.float32)).numpy()


def test_torch(bounder, x):
    expected = bounder.query(x).numpy()
    t = torch.from_numpy(x)
    for tensor in (t, t.double(), t.clone().requires_grad_(), t.T.contiguous().T, torch.cat([t, t], 1)[:, 3:]):
        assert (bounder.query(tensor).numpy() == expected).all()
    assert (bounder.query(t[::2]).numpy() == expected[::2]).all()


def test_warp_arrays(bounder, x, device):
    bounder = bounder.to(device)
    expected = bounder.query(x).numpy()
    vectors, flat = wp.array(x, dtype=wp.vec3, device=device), wp.array(x, dtype=wp.float32, device=device)
    assert flat.shape == x.shape
    for array in (vectors, flat):
        assert (bounder.query(array).numpy() == expected).all()
        assert (bounder.query(array[::2]).numpy() == expected[::2]).all()
    wide = wp.array(np.concatenate([x, x], axis=1), dtype=wp.float32, device=device)
    assert (bounder.query(wide[:, 3:]).numpy() == expected).all()


def test_warp_arrays_of_float64_are_rounded_as_numpys_are(bounder, x, device):
    bounder, x = bounder.to(device), x.astype(np.float64) * (1 + 1e-9)
    x[3] = 1e300
    expected = bounder.query(x).numpy()
    for array in (wp.array(x, dtype=wp.vec3d, device=device), wp.array(x, dtype=wp.float64, device=device)):
        assert (bounder.query(array).numpy() == expected).all()
        assert (bounder.query(array[::3]).numpy() == expected[::3]).all()
        with pytest.raises(QueryError, match="would have to be copied"):
            bounder.prepare(array)
    assert bounder.query(wp.zeros(0, dtype=wp.vec3d, device=device)).shape == (0,)


def test_memory_is_read_in_place(bounder):
    inside, outside = shape("blob").position(shape("blob").occupied[0]), np.full(3, 50.0)
    for make in (torch.tensor, lambda v: wp.array(v, dtype=wp.vec3, device="cpu"), np.array):
        x = make(np.float32([inside, outside]))
        view = x.numpy() if not isinstance(x, np.ndarray) else x
        assert bounder.query(x).numpy().tolist() == [1, 0]
        view[:] = view[::-1].copy()
        assert bounder.query(x).numpy().tolist() == [0, 1]


@pytest.mark.parametrize("kind", ["list", "numpy", "double", "torch", "vec", "flat"])
def test_nothing_gives_nothing(bounder, kind, device):
    bounder = bounder.to(device)
    empty = {
        "list": [],
        "numpy": np.zeros((0, 3), np.float32),
        "double": np.zeros((0, 3)),
        "torch": torch.zeros(0, 3, device=device),
        "vec": wp.zeros(0, dtype=wp.vec3, device=device),
        "flat": wp.zeros((0, 3), dtype=wp.float32, device=device),
    }[kind]
    answer = bounder.query(empty)
    assert answer.shape == (0,)
    assert answer.dtype == wp.uint8
    indices, count = bounder.candidates(empty)
    assert indices.shape == (0,)
    assert count.numpy().tolist() == [0]


@pytest.mark.parametrize(
    "x",
    [
        np.zeros(3),
        np.zeros((2, 2)),
        np.zeros((2, 3, 1)),
        np.zeros((2, 3), np.float16),
        np.zeros((2, 3), bool),
        np.zeros((2, 3), complex),
        np.zeros((0, 2)),
        np.array([["a", "b", "c"]]),
        [[1, 2, 3], [1, 2]],
        [[], []],
        [[True, False, True]],
        [[10**30, 0, 0]],
        [None],
        None,
        "points",
        1.0,
        {1: 2},
        torch.zeros(2, 3, dtype=torch.float16),
        np.array([[2**24 + 1, 0, 0]]),
        np.array([[-(2**24) - 1, 0, 0]], np.int32),
        np.array([[2**63 - 1, 0, 0]]),
        np.array([[2**64 - 1, 0, 0]], np.uint64),
        [[2**24 + 1, 0, 0]],
        torch.tensor([[2**24 + 1, 0, 0]]),
        torch.zeros(2, 3, dtype=torch.bool),
        torch.zeros(2, 2),
        torch.zeros(3),
        torch.zeros(2, 3).to_sparse(),
        torch.zeros(2, 3, device="meta"),
        np.ma.array(np.zeros((2, 3), np.float32), mask=np.eye(2, 3)),
        np.broadcast_to(np.float32(0.5), (2**30, 3)),  # more than kernels can count
    ],
    ids=lambda x: f"{type(x).__name__}-{getattr(x, 'shape', '')}-{getattr(x, 'dtype', '')}",
)
def test_other_queries_are_refused(bounder, x):
    with pytest.raises(QueryError) as error:
        bounder.query(x)
    assert "queries must" in str(error.value)
    assert "got" in str(error.value)
    assert "object" not in str(error.value)  # which is what NumPy makes of anything


def test_other_warp_arrays_are_refused(bounder):
    @wp.struct
    class Point:
        x: float

    wrong = [
        wp.zeros(3, dtype=wp.vec2, device="cpu"),
        wp.zeros(3, dtype=wp.vec2d, device="cpu"),
        wp.zeros((3, 3), dtype=wp.int32, device="cpu"),
        wp.zeros(3, dtype=wp.int32, device="cpu"),
        wp.zeros(3, dtype=wp.float32, device="cpu"),
        wp.zeros((3, 2), dtype=wp.float32, device="cpu"),
        wp.zeros((3, 3), dtype=wp.vec3, device="cpu"),
        wp.zeros(3, dtype=wp.mat33, device="cpu"),
        wp.zeros(3, dtype=Point, device="cpu"),
    ]
    for x in wrong:
        with pytest.raises(QueryError):
            bounder.query(x)


@wp.kernel(enable_backward=False)
def _takes_data(data: wb.Data, out: wp.array(dtype=float)):
    out[0] = data.parameters[0]


def test_a_bounder_in_place_of_its_data_is_told_so(bounder):
    out = wp.zeros(1, dtype=float, device="cpu")
    with pytest.raises(TypeError, match=r"pass bounder\.data to a kernel, not the bounder itself, got <"):
        wp.launch(_takes_data, dim=1, inputs=[bounder], outputs=[out], device="cpu")
    far = wb.fit(shape("blob"), "distance", "aabb", device="cpu")
    with pytest.raises(TypeError, match=r"pass bounder\.data to a kernel"):
        wp.launch(_takes_data, dim=1, inputs=[far], outputs=[out], device="cpu")
    wp.launch(_takes_data, dim=1, inputs=[far.data], outputs=[out], device="cpu")


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
    expected, out = bounder.query(x).numpy(), wp.full(len(x), 7, dtype=wp.uint8, device=device)
    assert bounder.query(x, out=out) is out
    assert (out.numpy() == expected).all()
    wrong = [
        np.zeros(len(x), np.uint8),
        wp.zeros(len(x) + 1, dtype=wp.uint8, device=device),
        wp.zeros(len(x), dtype=wp.int32, device=device),
        wp.zeros((len(x), 1), dtype=wp.uint8, device=device),
        wp.zeros(2 * len(x), dtype=wp.uint8, device=device)[::2],
    ]
    for array in wrong:
        with pytest.raises(QueryError, match="out must be"):
            bounder.query(x, out=array)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 2047, 2048, 2049, 80_000])
def test_candidates_are_the_ascending_ones(bounder, count, device, rng, monkeypatch):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "2")
    bounder, x = bounder.to(device), domain_points(shape("blob"), count, rng)
    result = bounder.candidates(x)
    assert all(isinstance(array, wp.array) for array in result)
    indices, number = result
    assert indices.dtype == number.dtype == wp.int32
    assert indices.shape == (count,)
    assert number.shape == (1,)
    expected = np.flatnonzero(bounder.query(x).numpy())
    assert number.numpy()[0] == len(expected)
    assert (indices.numpy()[: len(expected)] == expected).all()


@pytest.mark.parametrize("fill", [np.nan, 99.0])
def test_all_or_no_candidates(bounder, fill):
    x = np.full((3000, 3), fill, np.float32)
    indices, number = bounder.candidates(x)
    expected = 3000 if np.isnan(fill) else 0
    assert number.numpy()[0] == expected
    assert (indices.numpy()[:expected] == np.arange(expected)).all()


def test_numbers_beyond_float32_are_maybe(bounder):
    assert bounder.query(np.full((1, 3), 1e300)).numpy()[0] == 1
    assert bounder.query(torch.full((1, 3), 1e300, dtype=torch.float64)).numpy()[0] == 1
    assert bounder.query(np.full((1, 3), 3e38)).numpy()[0] == 0


def test_weights_cannot_be_changed(bounder):
    for tensor in bounder.tensors.values():
        with pytest.raises(ValueError, match="read-only"):
            tensor[...] = 0


def test_errors_are_one_family():
    assert issubclass(QueryError, BoundingError)
    assert issubclass(BoundingError, ValueError)
