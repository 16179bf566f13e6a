"""Prepared queries answer as ``query`` does, from memory that is made once, and see what changes in between."""

import threading

import numpy as np
import pytest
import warp as wp
from bounding_shapes import domain_points, random_bounder, shape
from region_cases import fitted_region, hard_regions

import warp_bounding as wb
from warp_bounding.errors import QueryError

torch = pytest.importorskip("torch", reason="torch is not installed")
FAR_AWAY = np.eye(4)
FAR_AWAY[0, 3] = 1e6 + 0.03  # which float32 rounds by more than a proof covers


def turned(k: int) -> wp.transform:
    return wp.transform(wp.vec3(0.3 * k, -0.2, 0.1), wp.quat_from_axis_angle(wp.vec3(0.6, 0.0, 0.8), 0.4 * k))


@pytest.fixture
def bounder(device):
    return random_bounder("kdop", "blob", device)


def points_at(device, rng, count=1500) -> wp.array:
    x = domain_points(shape("blob"), count, rng)
    x[::50] = np.nan
    return wp.array(x, dtype=wp.vec3, device=device)


def pointers(prepared) -> list[int]:
    return [array.ptr for array in (prepared.out, prepared.indices, prepared.count) if array is not None]


@pytest.mark.parametrize("method", ["aabb", "voxels", "mlp"])
def test_it_answers_as_query_does_and_what_is_written_to_x_next(method, device, rng):
    bounder, x = random_bounder(method, "blob", device), points_at(device, rng)
    out = wp.zeros(len(x), dtype=wp.bool, device=device)
    prepared = bounder.prepare(x, out=out)
    assert prepared.indices is None
    assert prepared.out is out
    assert not out.numpy().any()  # nothing is queried before launch
    for _ in range(3):
        assert prepared.launch() is prepared.out
        assert (out.numpy() == bounder.query(x).numpy()).all()
        wp.copy(x, points_at(device, rng))


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_regions(query, rng):
    bounder = fitted_region("aabb", query, shape("blob"))
    q = hard_regions(query, shape("blob"), rng, 1.0, 500)
    for options in ({}, {"xform": turned(1)}):
        assert (bounder.prepare(q, **options).launch().numpy() == bounder.query(q, **options).numpy()).all()


@pytest.mark.parametrize("count", [0, 1, 40_000])
def test_candidates_in_memory_that_is_made_once(bounder, device, rng, count):
    x = points_at(device, rng, count)
    prepared = bounder.prepare(x, candidates=True)
    kept = pointers(prepared)
    for _ in range(3):
        result = prepared.launch()
        assert result == (prepared.indices, prepared.count)
        assert pointers(prepared) == kept
        indices, number = (a.numpy() for a in result)
        expected = np.flatnonzero(bounder.query(x).numpy())
        assert number.tolist() == [len(expected)]
        assert (indices[: len(expected)] == expected).all()
        assert (np.flatnonzero(prepared.out.numpy()) == expected).all()
        wp.copy(x, points_at(device, rng, count))


def test_numpy_and_torch_are_viewed_and_kept_or_refused(rng):
    bounder = random_bounder("kdop", "blob")
    x = domain_points(shape("blob"), 100, rng)
    t, array = torch.tensor(x), wp.array(x, dtype=wp.vec3, device="cpu")
    for copied in (x.astype(np.float64), x[::2], np.asfortranarray(x), x.tolist(), t.double(), t[::2], array[::2]):
        with pytest.raises(QueryError, match=r"^x must be float32, in one piece and on cpu.*that would have to"):
            bounder.prepare(copied)
    for make in (np.array, torch.tensor):
        x = make(domain_points(shape("blob"), 300, rng))
        view, prepared = np.asarray(x), bounder.prepare(x)
        before = prepared.launch().numpy().copy()
        view[:] = view[::-1].copy()
        assert (prepared.launch().numpy() == before[::-1]).all()
        assert set(before) == {0, 1}


@pytest.mark.parametrize("change", ["resize", "replace", "array"])
def test_x_that_lies_elsewhere_by_now_is_refused(change, rng):
    """A launch would ask what it was prepared with: old numbers, or memory that is somebody else's."""
    bounder, x = random_bounder("kdop", "blob"), domain_points(shape("blob"), 300, rng)
    x = x.copy() if change == "array" else torch.tensor(x)
    prepared = bounder.prepare(x)
    prepared.launch()
    if change == "replace":
        x.data = torch.zeros_like(x)
    elif change == "array":
        x.resize((200_000, 3), refcheck=False)
    else:
        x.resize_(200_000, 3)
    with pytest.raises(QueryError, match=r"^x lies elsewhere than when it was prepared, or has another shape; prepare"):
        prepared.launch()
    assert (bounder.prepare(x).launch().numpy() == bounder.query(x).numpy()).all()


def test_a_placement_moves_and_a_refused_one_leaves_the_old_one(bounder, device, rng):
    x = points_at(device, rng)
    prepared, answers = bounder.prepare(x, xform=turned(0)), []
    for k in range(4):
        prepared.move(xform=turned(k), scale=1.0 + 0.1 * k)
        answers.append(prepared.launch().numpy().copy())
        assert (answers[-1] == bounder.query(x, xform=turned(k), scale=1.0 + 0.1 * k).numpy()).all()
    assert (answers[0] != answers[-1]).any()
    before = prepared.launch().numpy().copy()
    for wrong in ({"xform": FAR_AWAY}, {"scale": -1.0}, {"xform": np.zeros(5)}, {"xform": np.full(7, np.nan)}, {}):
        with pytest.raises(QueryError):
            prepared.move(**wrong)
        assert (prepared.launch().numpy() == before).all()
    with pytest.raises(QueryError, match="certificate covers"):
        bounder.prepare(x, xform=FAR_AWAY)
    with pytest.raises(QueryError, match="prepared with xform or scale, got ones in object space"):
        bounder.prepare(x).move(xform=turned(1))


def test_a_new_threshold_is_seen(device, rng):
    bounder, x = random_bounder("kdop", "blob", device), points_at(device, rng)
    prepared = bounder.prepare(x, candidates=True)
    prepared.launch()
    for threshold in (np.inf, -np.inf, 0.0):
        bounder.freeze(threshold, None)
        prepared.launch()
        assert (prepared.out.numpy() == bounder.query(x).numpy()).all()
        assert prepared.count.numpy()[0] == prepared.out.numpy().sum()


def test_a_threshold_that_is_lowered_while_data_are_made_is_seen(device, rng, monkeypatch):
    bounder, x = random_bounder("kdop", "blob", device), points_at(device, rng)
    bounder.freeze(np.inf, None)

    def lowered() -> wb.bounders.Data:  # as by another thread
        bounder.freeze(-np.inf, None)
        return wb.bounders.Data()

    with monkeypatch.context() as patch:
        patch.setattr("warp_bounding.bounders.batch.Data", lowered)
        prepared = bounder.prepare(x)
    outside = bounder.values(x).numpy() == -np.inf
    assert (prepared.launch().numpy() == ~outside).all()
    assert (bounder.query(x).numpy() == ~outside).all()
    assert not outside.all()


def test_several_threads_launch_at_once(rng, monkeypatch):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "3")
    bounder = random_bounder("mlp", "blob")
    xs = [domain_points(shape("blob"), 60_000, rng) for _ in range(4)]
    expected = [bounder.query(x).numpy() for x in xs]
    wrong, start = [], threading.Barrier(len(xs))

    def ask(x: np.ndarray, right: np.ndarray) -> None:
        prepared = bounder.prepare(x)
        start.wait()
        for _ in range(20):
            prepared.out.fill_(7)
            if (prepared.launch().numpy() != right).any():
                wrong.append(1)

    threads = [threading.Thread(target=ask, args=pair) for pair in zip(xs, expected, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.skipif(not wp.get_cuda_device_count(), reason="there is no CUDA device")
@pytest.mark.parametrize("method", ["aabb", "bvh", "mlp"])
def test_a_graph_answers_as_a_call(method):
    ball, rng = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6, np.random.default_rng(0)
    options = {"budget": 10, "hidden": (24, 24), "progress": False} if method == "mlp" else {}
    bounder = wb.fit(ball, method=method, device="cuda:0", **options)
    first, other = (
        wp.array(rng.uniform(-2, 18, (5000, 3)).astype(np.float32), dtype=wp.vec3, device="cuda:0") for _ in range(2)
    )
    there, (indices, count) = bounder.query(other).numpy(), bounder.candidates(other)
    found = indices.numpy()[: int(count.numpy()[0])]
    x, out = wp.clone(first), wp.zeros(5000, dtype=wp.bool, device="cuda:0")
    listing, asking = bounder.prepare(x, candidates=True), bounder.prepare(x, out=out)
    listed = listing.launch()
    for call in (lambda: bounder.query(x, out=out), asking.launch, listing.launch):
        wp.copy(x, first)
        with wp.ScopedCapture(device="cuda:0") as capture:
            call()
        out.zero_()
        wp.copy(x, other)
        wp.capture_launch(capture.graph)
        if call == listing.launch:
            indices, count = listed
            assert np.array_equal(indices.numpy()[: int(count.numpy()[0])], found)
        else:
            assert np.array_equal(out.numpy(), there)
