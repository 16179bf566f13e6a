"""The soak test: its queries are positives beyond doubt and hard, and it finds what it is there to find."""

import json
import sys

import numpy as np
import pytest
from bounding_shapes import shape, told_of

import warp_bounding as wb
from warp_bounding.bounders import METHODS, supports
from warp_bounding.errors import FileFormatError, QueryError
from warp_bounding.proof import soak as package_soak
from warp_bounding.proof.attest.soak import CHUNK, CYCLE, random_world, soak
from warp_bounding.queries import QUERIES, QUERY_KINDS, oracle
from warp_bounding.queries.hard import FORMS, HardPositives

NAMES = ("c", "blob", "animated", "mesh", "anisotropic", "half")
LENGTH = 0.75
TRUTH = {name: lambda g, q, kind=kind: kind.truth(g, q, LENGTH) for name, kind in QUERIES.items()}


def drawn(query, name, form="float32", count=20_000, seed=3, first=0, world=None, device="cpu"):
    x, certain = HardPositives(query, shape(name), LENGTH, device).draw(seed, first, count, form, world)
    return x.numpy(), certain.numpy() != 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("query", QUERY_KINDS)
def test_every_query_is_a_positive(query, name, device):
    x, certain = drawn(query, name, device=device)
    assert certain.mean() > 0.95
    assert np.isfinite(x).all()
    assert oracle(query, shape(name), "cpu", LENGTH)(x[certain]).all()


@pytest.mark.parametrize("name", ["c", "mesh"])
@pytest.mark.parametrize("query", QUERY_KINDS)
def test_every_query_in_float64_is_a_positive(query, name):
    x, certain = drawn(query, name, "float64", 2000)
    assert x.dtype == np.float64
    assert (x != x.astype(np.float32)).any()
    assert certain.mean() > 0.9
    assert TRUTH[query](shape(name), x[certain][:300]).all()


@pytest.mark.parametrize("name", ["c", "blob", "animated"])
@pytest.mark.parametrize("query", ["point", "ray", "plane"])
def test_every_query_in_the_world_is_a_positive(query, name):
    """Moved back in float64, and looked for in the object by the oracle, which has to forgive that rounding."""
    grid, n = shape(name), shape(name).ndim
    world, options = random_world(grid, np.random.default_rng(4))
    x, certain = drawn(query, name, "placed", 5000, world=world)
    assert x.dtype == np.float32
    assert certain.mean() > 0.7  # of a point on many faces, each number must round inwards
    first = int(grid.time)
    forward = options["xform"][:-1, :-1] * options["scale"]
    assert np.allclose(world.forward[first:, first:], forward)
    back = x[certain].astype(np.float64)
    point = slice(n, 2 * n) if query == "plane" else slice(0, n)
    back[:, point] = (back[:, point] - world.translation) @ world.inverse.T
    if query == "ray":
        back[:, n:] = back[:, n:] @ world.inverse.T
    if query == "plane":
        back[:, :n] = back[:, :n] @ world.forward
    assert oracle(query, grid, "cpu", LENGTH)(back.astype(np.float32)).mean() > 0.5  # the others round off it
    assert oracle(query, grid.to_grid(margin=1e-4), "cpu", LENGTH + 1e-4)(back.astype(np.float32)).all()


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_they_are_hard(query):
    """Many only just meet the object: without its outermost layer of float32 numbers they would not."""
    grid = shape("blob")
    x, certain = drawn(query, "blob")
    x = x[certain]
    moved = np.nextafter(
        x, np.where(np.random.default_rng(0).random(x.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
    )
    assert (~oracle(query, grid, "cpu", LENGTH)(moved)).mean() > (0.02 if query != "box" else 0.005)
    if query == "ray":
        outside = ((x[:, :3] < grid.lower) | (x[:, :3] > grid.upper)).any(axis=1)
        assert 0.1 < outside.mean() < 0.9


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_the_stream_does_not_depend_on_how_it_is_cut(query):
    whole, _ = drawn(query, "blob", count=30_000)
    parts = [drawn(query, "blob", count=n, first=f)[0] for f, n in ((0, 7), (7, 20_001), (20_008, 9992))]
    assert (whole == np.concatenate(parts)).all()
    assert (whole != drawn(query, "blob", count=30_000, seed=4)[0]).any()


def bounder_of(method, query, name="blob"):
    told = told_of(method, query, hidden=(8,), steps=20, length=LENGTH)
    return wb.fit(shape(name), query=query, method=method, device="cpu", **told)


CASES = [
    (method, query)
    for method, kind in METHODS.items()
    for query in QUERY_KINDS
    if kind.conservative and supports(method, query, 3)
]


@pytest.mark.parametrize("query", QUERY_KINDS)
@pytest.mark.parametrize("method", ["kdop", "bvh"])
def test_what_is_proven_is_not_contradicted(method, query):
    told = []
    result = soak(
        bounder_of(method, query), shape("blob"), 8 * CHUNK - 100_000, seed=1, progress=lambda *a: told.append(a)
    )
    assert result.missed is None
    assert result.complete
    assert all(result.forms[form] > 0 for form in FORMS)
    assert sum(result.forms.values()) == result.done >= result.wanted
    assert told[-1][:2] == (result.wanted, result.wanted)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["c", "blob", "animated"])
@pytest.mark.parametrize(("method", "query"), CASES)
def test_no_method_misses_any(method, query, name):
    if not supports(method, query, shape(name).ndim):
        pytest.skip("not of this dimension")
    assert soak(bounder_of(method, query, name), shape(name), 16 * CHUNK, seed=2).missed is None


@pytest.mark.parametrize("query", QUERY_KINDS)
def test_a_raised_threshold_is_caught(query):
    bounder = bounder_of("kdop", query)
    assert bounder.certificate.proven
    step = 1e-2 if query == "plane" else 1e-3
    raised = bounder.freeze(float(bounder.threshold) + step * max(1.0, abs(float(bounder.threshold))), None)
    result = soak(raised, shape("blob"), 4 * CHUNK, seed=1)
    assert result.missed is not None
    assert result.complete
    x = np.array([result.missed], np.float32)
    assert oracle(query, shape("blob"), "cpu", LENGTH)(x).all()
    assert raised.query(x).numpy()[0] == 0


@pytest.mark.parametrize("form", ["float64", "placed"])
def test_a_false_negative_in_each_form_is_caught(form, monkeypatch):
    monkeypatch.setattr(sys.modules["warp_bounding.proof.attest.soak"], "CYCLE", (form,))
    bounder = bounder_of("kdop", "ray")
    raised = bounder.freeze(float(bounder.threshold) + 1e-2, None)
    result = soak(raised, shape("blob"), 4 * CHUNK, seed=1)
    assert result.missed_form == form
    options = result.missed_world or {}
    assert bool(options) == (form == "placed")
    x = np.array([result.missed], np.float64 if form == "float64" else np.float32)
    assert raised.query(x, **options).numpy()[0] == 0


def test_another_shape_is_caught():
    grid = shape("blob")
    other = wb.indicators.IndicatorGrid(~grid.occupancy)
    assert soak(bounder_of("voxels", "point"), other, CHUNK, seed=1).missed is not None


def test_it_goes_on_where_it_stopped(tmp_path):
    bounder, state = bounder_of("aabb", "box"), tmp_path / "state.json"
    first = soak(bounder, shape("blob"), 2 * CHUNK - 1000, seed=11, state=state)
    held = json.loads(state.read_text())
    assert (held["done"], held["chunks"], held["seed"]) == (first.done, first.chunks, 11)
    more = soak(bounder, shape("blob"), 4 * CHUNK - 1000, state=state)
    straight = soak(bounder, shape("blob"), 4 * CHUNK - 1000, seed=11)
    assert (more.done, more.chunks, more.forms, more.seed) == (straight.done, straight.chunks, straight.forms, 11)
    assert soak(bounder, shape("blob"), 1000, state=state).chunks == more.chunks
    with pytest.raises(FileFormatError, match="another seed"):
        soak(bounder, shape("blob"), 1000, seed=12, state=state)
    with pytest.raises(FileFormatError, match="another bounder"):
        soak(bounder_of("kdop", "box"), shape("blob"), 1000, state=state)
    with pytest.raises(FileFormatError, match="another shape"):
        soak(bounder, wb.indicators.IndicatorGrid(~shape("blob").occupancy), 1000, state=state)


@pytest.mark.parametrize("version", [1, 3, None])
def test_a_state_of_another_version_is_refused_and_kept(version, tmp_path):
    bounder, state = bounder_of("aabb", "point"), tmp_path / "state.json"
    soak(bounder, shape("blob"), 1000, seed=11, state=state)
    state.write_text(held := json.dumps(json.loads(state.read_text()) | {"soak": version}))
    with pytest.raises(FileFormatError, match=f"of another version \\({version}, this one is 2\\)"):
        soak(bounder, shape("blob"), 1000, state=state)
    assert state.read_text() == held


def test_a_state_knows_its_bounder_by_what_its_file_holds(tmp_path):
    bounder, state = bounder_of("mlp", "point"), tmp_path / "state.json"
    soak(bounder, shape("blob"), 1000, seed=11, state=state)
    bounder.save(tmp_path / "b.safetensors")
    again = wb.load(tmp_path / "b.safetensors")
    assert soak(again, shape("blob"), 1000, state=state).chunks == 1
    again.freeze(bounder.threshold - 1.0, None)
    with pytest.raises(FileFormatError, match="another bounder"):
        soak(again, shape("blob"), 1000, state=state)


@pytest.mark.parametrize("change", [{"done": -1}, {"done": 5}, {"forms": {}}, {"seconds": None}, {"more": 1}])
def test_a_damaged_state_is_refused(change, tmp_path):
    bounder, state = bounder_of("aabb", "point"), tmp_path / "state.json"
    soak(bounder, shape("blob"), 1000, seed=11, state=state)
    state.write_text(json.dumps(json.loads(state.read_text()) | change))
    with pytest.raises(FileFormatError, match="state"):
        soak(bounder, shape("blob"), 1000, state=state)
    state.write_text("prose")
    with pytest.raises(FileFormatError, match="state"):
        soak(bounder, shape("blob"), 1000, state=state)


def test_an_interruption_keeps_what_was_done(tmp_path):
    bounder, state = bounder_of("aabb", "point"), tmp_path / "state.json"

    def stop(done, wanted, note):
        if done >= 2 * 0.95 * CHUNK:
            raise KeyboardInterrupt

    result = soak(bounder, shape("blob"), 10**9, seed=1, state=state, progress=stop)
    assert result.interrupted
    assert result.chunks == json.loads(state.read_text())["chunks"] >= 2
    assert not result.complete
    assert not soak(bounder, shape("blob"), 1000, state=state).interrupted


def test_no_time_and_bad_input():
    bounder = bounder_of("aabb", "point")
    assert soak(bounder, shape("blob"), 1000, seconds=0).done == 0
    for count in (0, -1, 1.5, True, "many"):
        with pytest.raises(QueryError, match="count"):
            soak(bounder, shape("blob"), count)
    with pytest.raises(QueryError, match="seed"):
        soak(bounder, shape("blob"), 10, seed=-1)
    with pytest.raises(QueryError, match="2D"):
        soak(bounder, shape("c"), 10)
    assert soak(bounder, shape("blob"), 10).seed != soak(bounder, shape("blob"), 10).seed
    assert package_soak is soak
    assert set(CYCLE) == set(FORMS)
