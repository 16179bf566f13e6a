"""Distance bounders on disk, certified, soaked, evaluated; and one line for every mistake."""

import numpy as np
import pytest
import warp as wp
from distances import TOLD, far, points_around, thing

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, register_distance, unregister_distance
from warp_bounding.bounders.volumes import AabbDistance
from warp_bounding.errors import BounderError, FileFormatError, IndicatorError, QueryError
from warp_bounding.proof import soak


@pytest.mark.parametrize("method", DISTANCES)
def test_saved_loaded_certified(method, tmp_path, rng):
    bounder, x = far(method, "blob"), points_around(thing("blob"), 300, rng)
    bounder.save(tmp_path / "b.safetensors")
    again = wb.load(tmp_path / "b.safetensors", device="cpu")
    assert type(again) is type(bounder)
    assert again.certificate == bounder.certificate
    assert (again.distance(x).numpy() == bounder.distance(x).numpy()).all()
    proof = wb.certify(again, thing("blob"))
    assert proof.proven, proof.message
    assert wb.certify(again, thing("blob"), margin=0.1).kind == "inapplicable"
    assert wb.certify(again, thing("blob"), query="distance").proven
    assert wb.certify(again, thing("blob"), query="point").kind == "inapplicable"
    assert repr(again).startswith(f"<{method} distance bounder, 3D, {bounder.nbytes} bytes, proven")


@pytest.mark.parametrize("method", DISTANCES)
def test_another_shape_is_refuted(method):
    larger = wb.IndicatorGrid(
        np.pad(np.ones((9, 9, 9), bool), 3), cells_per_unit=thing("blob").cells_per_unit, offset=[-4.0] * 3
    )
    proof = wb.certify(far(method, "blob"), larger)
    assert proof.kind == "refuted"
    x = np.array([proof.counterexample], np.float32)
    assert larger.contains(x)[0]
    assert far(method, "blob").distance(x).numpy()[0] > 0


def test_a_threshold_that_does_not_cover_rounding_is_not_proven():
    bounder = far("sphere", "blob").to()
    bounder.freeze(0.0, None)
    proof = wb.certify(bounder, thing("blob"))
    assert proof.kind == "undecided"
    assert "rounds" in proof.message
    with pytest.raises(BounderError, match="at most 0"):
        bounder.freeze(0.5, None)


def smaller_than(bounder: wb.DistanceBounder) -> wb.DistanceBounder:
    """With faces moved inwards, which cuts off a part of the object."""
    tensors = bounder.tensors | {"high": bounder.tensors["high"] - np.float32(0.5)}
    smaller = type(bounder)(bounder.domain, tensors, bounder.sizes, "cpu").freeze(float(bounder.threshold), None)
    smaller.info = bounder.info
    return smaller


def test_edited_files(tmp_path):
    bounder = far("kdop", "blob")
    assert wb.certify(smaller_than(bounder), thing("blob")).kind == "refuted"
    bounder.to().freeze(float(bounder.threshold) / 2, bounder.certificate).save(tmp_path / "b.safetensors")
    with pytest.raises(FileFormatError, match="threshold"):
        wb.load(tmp_path / "b.safetensors")
    for sizes in ({}, {"volume": {}}, {"volume": {**bounder.sizes["volume"], "threshold": 0.1}}):
        with pytest.raises(BounderError):
            type(bounder)(bounder.domain, bounder.tensors, sizes, "cpu")


def test_soak(tmp_path):
    done = soak(far("obb", "blob"), thing("blob"), 100_000, seed=1, state=tmp_path / "s.json")
    assert done.missed is None
    assert done.complete
    more = soak(far("obb", "blob"), thing("blob"), done.done + 1, state=tmp_path / "s.json")
    assert more.chunks == done.chunks + 1
    found = soak(smaller_than(far("obb", "blob")), thing("blob"), 1_000_000, seed=1)
    assert found.missed is not None
    assert found.missed_form.startswith("balls: x, radius")


def test_evaluate(rng):
    bounder, shape = far("aabb", "tetrahedron"), thing("tetrahedron")
    for radius in (0.0, 0.3):
        rates = wb.evaluate(bounder, shape, samples=20_000, radius=radius)
        assert rates.fn == 0
        assert rates.radius == radius
        assert rates.positives > 0
    grid = wb.evaluate(far("sphere", "blob"), thing("blob"), samples=20_000, radius=0.1)
    assert (grid.fn, grid.undecided) == (0, 0.0)
    assert wb.evaluate(far("sphere", "torus"), thing("torus"), samples=5000, radius=0.1).fn == 0
    assert wb.evaluate(far("sphere", "blob", 0.1), thing("blob"), samples=5000).fn == 0
    with pytest.raises(QueryError, match="radius is for distances"):
        wb.evaluate(wb.fit(thing("c"), method="aabb", device="cpu"), thing("c"), radius=0.1)
    for bad in (-1, np.nan, "far"):
        with pytest.raises(QueryError, match="radius must be a length"):
            wb.evaluate(bounder, shape, radius=bad)


def test_spacetime(rng):
    """Of an animated grid, time may be one more coordinate."""
    grid = thing("animated")
    bounder = wb.fit(grid, "distance", "bvh", metric="spacetime", device="cpu", **TOLD["bvh"])
    still = wb.IndicatorGrid(grid.occupancy)
    x = points_around(still, 2000, rng)
    assert (bounder.distance(x).numpy() <= still.distances(x)[:, 1]).all()
    assert wb.certify(bounder, grid).proven
    with pytest.raises(BounderError, match="moves"):
        wb.fit(grid, "distance", "aabb")
    with pytest.raises(QueryError, match="metric must be one of space, spacetime"):
        wb.fit(grid, "distance", "aabb", metric="time")


def test_functions_in_kernels(rng):
    bounder, n = far("sphere", "blob"), 200
    x, y = points_around(thing("blob"), n // 2, rng), points_around(thing("blob"), n // 2, rng)

    @wp.kernel(enable_backward=False)
    def ask(
        data: wb.Data,
        x: wp.array(dtype=wp.vec3),
        y: wp.array(dtype=wp.vec3),
        d: wp.array(dtype=float),
        maybe: wp.array(dtype=wp.uint8),
        t: wp.array(dtype=float),
        hit: wp.array(dtype=wp.uint8),
        boxed: wp.array(dtype=wp.uint8),
    ):
        i = wp.tid()
        d[i] = wp.static(bounder.distance_func)(data, x[i])
        told, when = wp.static(bounder.segment_func)(data, x[i], y[i], 0.05)
        maybe[i] = wp.uint8(told)
        t[i] = when
        met, _where = wp.static(bounder.ray_func)(data, x[i], y[i] - x[i], 2.0, 0.0)
        hit[i] = wp.uint8(met)
        boxed[i] = wp.uint8(wp.static(bounder.box_func)(data, wp.min(x[i], y[i]), wp.max(x[i], y[i])))

    def run(data):
        out = [wp.zeros(n, dtype=kind, device="cpu") for kind in (float, wp.uint8, float, wp.uint8, wp.uint8)]
        places = [wp.array(part, dtype=wp.vec3, device="cpu") for part in (x, y)]
        wp.launch(ask, n, [data, *places, *out], device="cpu")
        return [part.numpy() for part in out]

    d, maybe, t, hit, boxed = run(bounder.data)
    assert (d == bounder.distance(x).numpy()).all()
    told, when = bounder.segments(x, y, 0.05)
    assert (maybe != told.numpy()).mean() < 0.02  # batches march in lanes, whose sums round in another order
    assert np.abs(t - when.numpy()).max() < 1e-4
    assert (hit != bounder.rays(np.concatenate([x, y - x], axis=1), length=2.0)[0].numpy()).mean() < 0.02
    assert (boxed == bounder.boxes(np.minimum(x, y), np.maximum(x, y)).numpy()).all()
    assert 0 < maybe.sum() < n
    for other in (far("aabb", "blob").data, wb.Data()):  # of another source, or none: nothing is known
        d, maybe, t, hit, boxed = run(other)
        assert not d.any()
        assert maybe.all()
        assert hit.all()
        assert boxed.all()
        assert not t.any()


def test_bad_questions():
    bounder, x = far("aabb", "blob"), np.zeros((3, 3), np.float32)
    for radius in (-0.1, np.nan, np.inf, [0.1, 0.2], "wide", None):
        with pytest.raises(QueryError, match="radius must be"):
            bounder.query(x, radius)
        with pytest.raises(QueryError, match="radius must be"):
            bounder.segments(x, x, radius)
    for steps in (0, -1, 1.5, True, None):
        with pytest.raises(QueryError, match="steps must be a whole number of at least 1"):
            bounder.segments(x, x, steps=steps)
        with pytest.raises(QueryError, match="steps must be"):
            bounder.boxes(x, x, steps=steps)
    with pytest.raises(QueryError, match="as many"):
        bounder.segments(x, x[:2])
    with pytest.raises(QueryError, match="length must be"):
        bounder.rays(np.zeros((3, 6), np.float32), length=-1)
    with pytest.raises(QueryError, match=r"\(N, 3\)"):
        bounder.distance(np.zeros((3, 2), np.float32))
    with pytest.raises(QueryError, match="object space"):
        bounder.query(x, scale=2.0)
    assert bounder.boxes(x + np.float32(2), x).numpy().all()  # upside down


def test_bad_fits():
    for method in ("voxels", "nothing", "aabb+sphere"):
        with pytest.raises(BounderError, match="method of a distance must be one of aabb"):
            wb.fit(thing("c"), "distance", method)
    with pytest.raises(BounderError, match=r"aabb takes no option 'hidden'; .*aabb takes metric for distances"):
        wb.fit(thing("c"), "distance", "aabb", hidden=(8,))
    for name, value in (("length", 2.0), ("side", "inside")):
        with pytest.raises(BounderError, match=f"{name} is not for distances"):
            wb.fit(thing("c"), "distance", "aabb", **{name: value})
    with pytest.raises(QueryError, match="point, ray, plane, box, distance"):
        wb.fit(thing("c"), "distances", "aabb")
    unknown = wb.IndicatorFunction(lambda x: (x**2).sum(axis=1) < 1, [-1, -1], [1, 1])
    with pytest.raises((BounderError, IndicatorError), match=r"proven|certifies"):
        wb.fit(unknown, "distance", "aabb")


def test_a_method_is_added_from_outside():
    class Wide(AabbDistance):
        method = "wide"

    register_distance(Wide)
    try:
        assert wb.DISTANCES["wide"] is Wide
        with pytest.raises(BounderError, match="wide is Wide already"):
            register_distance(type("Other", (AabbDistance,), {"method": "wide"}))
    finally:
        unregister_distance(Wide)
    assert "wide" not in wb.DISTANCES
    with pytest.raises(BounderError, match="expected a class"):
        register_distance(int)
