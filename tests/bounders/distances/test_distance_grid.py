"""``distance-grid``: every storage, any dimension, lowered where interpolation is too large, and proven cell by cell."""

import numpy as np
import pytest
from distances import far, points_around, thing

import warp_bounding as wb
from warp_bounding.bounders.distances.grid import STORAGES, DistanceGrid
from warp_bounding.errors import BounderError
from warp_bounding.proof.distances.excesses import excesses, largest_excess


@pytest.mark.parametrize("name", ["c", "tetrahedron"])
@pytest.mark.parametrize("storage", STORAGES)
def test_storages(storage, name, rng, tmp_path):
    shape = thing(name)
    bounder = wb.fit(shape, "distance", "distance-grid", nodes=12, storage=storage, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert bounder.tensors["values"].dtype == storage
    x = points_around(shape, 3000, rng)
    g, exact, known = bounder.distance(x).numpy(), bounder.exact(x), shape.distances(x)
    assert (g <= known[:, 1]).all()
    assert (g <= exact).all()
    plain = bounder.to(native=False).distance(x).numpy()
    assert (np.abs(plain - g) < 1e-5 * (1 + np.abs(x).max(axis=1))).all()
    assert (g > 0).sum() > 0.8 * (known[:, 0] > 0).sum()
    bounder.save(tmp_path / "g.safetensors")
    again = wb.load(tmp_path / "g.safetensors", device="cpu")
    assert (again.distance(x).numpy() == g).all()
    assert wb.certify(again, shape).proven


def test_finer_is_tighter(rng):
    shape = thing("tetrahedron")
    x = points_around(shape, 3000, rng, 0.2)
    away = shape.distances(x)[:, 0]
    lost = [
        np.maximum(away - wb.fit(shape, "distance", "distance-grid", nodes=nodes, device="cpu").exact(x), 0).mean()
        for nodes in (6, 12, 24)
    ]
    assert lost[0] > 1.5 * lost[1] > 1.5 * 1.5 * lost[2]


def test_raised_values_are_not_proven():
    bounder, shape = far("distance-grid", "tetrahedron"), thing("tetrahedron")
    assert wb.certify(bounder, shape).proven
    tensors = {"values": (bounder.tensors["values"].astype(np.float32) + 0.2).astype(np.float16)}
    raised = DistanceGrid(bounder.domain, tensors, bounder.sizes, "cpu").freeze(float(bounder.threshold), None)
    raised.info = bounder.info
    proof = wb.certify(raised, shape)
    assert proof.kind == "refuted"
    point = np.array([proof.counterexample], np.float32)
    assert raised.distance(point).numpy()[0] > shape.distances(point)[0, 1]


def test_excesses_hold(rng):
    """No point of a box has a larger excess than what is certified, and the largest one is not far from what points have."""
    shape, bounder = thing("c"), far("distance-grid", "c")
    tensors = {"values": (bounder.tensors["values"].astype(np.float32) + 0.1)}
    raised = DistanceGrid(bounder.domain, tensors, bounder.sizes | {"storage": "float32"}, "cpu")
    lower, upper = raised.pieces()
    found, boxes, complete = excesses(raised, shape, lower, upper, tolerance=1e-3, halvings=12)
    assert complete
    assert boxes >= len(lower)
    for cell in rng.integers(len(lower), size=60):
        v = rng.uniform(lower[cell], upper[cell], (400, 2))
        above = raised.reference(v) - shape.distances(raised.domain.to_object(v))[:, 1] / raised.domain.unit
        assert above.max() <= found[cell] + 1e-12
    (most,), _, _, _ = largest_excess(raised, shape, 60.0, None)
    v = rng.uniform(lower.min(axis=0), upper.max(axis=0), (100_000, 2))
    above = raised.reference(v) - shape.distances(raised.domain.to_object(v))[:, 0] / raised.domain.unit
    assert above.max() <= most <= above.max() + 0.01


def test_mistakes():
    grid = thing("c")
    for option, value in (("nodes", 1), ("nodes", 2.5), ("storage", "float64")):
        with pytest.raises(BounderError, match=option):
            wb.fit(grid, "distance", "distance-grid", **{option: value})
    bounder = far("distance-grid", "c")
    for values in (np.zeros((3, 3, 3), np.float16), np.zeros((1, 5), np.float16), np.full((3, 3), 1e-6, np.float16)):
        with pytest.raises(BounderError):
            DistanceGrid(bounder.domain, {"values": values}, bounder.sizes, "cpu")
    with pytest.raises(BounderError, match="stored"):
        DistanceGrid(bounder.domain, {"values": np.zeros((3, 3), np.float32)}, bounder.sizes, "cpu")
    unknown = wb.IndicatorFunction(
        lambda x: (x**2).sum(axis=1) < 1,
        [-1, -1],
        [1, 1],
        empty=lambda low, high: (np.maximum(np.maximum(low, -high), 0) ** 2).sum(axis=1) > 1,
    )
    with pytest.raises(BounderError, match="meshes, grids, solids and functions with distance= have one"):
        wb.fit(unknown, "distance", "distance-grid")
