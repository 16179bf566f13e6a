"""``distance-grid``: every storage, any dimension, lowered where interpolation is too large, and proven cell by cell."""

import numpy as np
import pytest
from distances import far, points_around, thing

import warp_bounding as wb
from warp_bounding.bounders.distance_grid import STORAGES, DistanceGrid
from warp_bounding.errors import BounderError
from warp_bounding.proof.distances import excesses, largest_excess


@pytest.mark.parametrize("refine", [1, 4])
@pytest.mark.parametrize(("storage", "name"), [*((each, "tetrahedron") for each in STORAGES), (STORAGES[-1], "c")])
def test_storages(storage, name, refine, rng, tmp_path):
    shape, told = thing(name), {"nodes": 12 if refine == 1 else 6, "storage": storage, "refine": refine}
    bounder = wb.fit(shape, "distance", "distance-grid", **told, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert bounder.tensors["values"].dtype == storage
    assert bounder.refined.any() == (refine > 1)
    assert not bounder.refined.all()
    x = points_around(shape, 3000, rng)
    g, exact, known = bounder.distance(x).numpy(), bounder.exact(x), shape.distances(x)
    assert (g <= known[:, 1]).all()
    assert (g <= exact).all()
    assert (g > 0).sum() > 0.8 * (known[:, 0] > 0).sum()
    bounder.save(tmp_path / "g.safetensors")
    again = wb.load(tmp_path / "g.safetensors", device="cpu")
    assert (again.distance(x).numpy() == g).all()
    assert wb.certify(again, shape).proven


@pytest.mark.parametrize("name", ["c", "tetrahedron"])
def test_where_cells_meet_finer_ones(name, rng):
    """F may jump there, and float32 may take a point for one of the next cell: the distance is not overestimated in either."""
    shape = thing(name)
    bounder = wb.fit(shape, "distance", "distance-grid", nodes=6, refine=4, device="cpu", progress=False)
    lower, upper = bounder.pieces()
    chosen, axis = rng.integers(len(lower), size=(2, 20_000))
    v = rng.uniform(lower[chosen], upper[chosen])
    axis, rows = axis % shape.ndim, np.arange(len(v))
    v[rows, axis] = np.where(rng.random(len(v)) < 0.5, lower[chosen, axis], upper[chosen, axis])
    x = bounder.domain.to_object(v).astype(np.float32)
    for ulps in range(-2, 3):
        moved = x.copy()
        for _ in range(abs(ulps)):
            moved[rows, axis] = np.nextafter(moved[rows, axis], np.float32(np.inf if ulps > 0 else -np.inf))
        assert (bounder.distance(moved).numpy() <= shape.distances(moved)[:, 1]).all()


def test_refined_cells_are_near_the_border_and_pay(rng):
    shape = thing("tetrahedron")
    x = points_around(shape, 20_000, rng, 0.2)
    away = shape.distances(x)[:, 0]
    refined, whole = (
        wb.fit(shape, "distance", "distance-grid", nodes=nodes, refine=refine, device="cpu", progress=False)
        for nodes, refine in ((9, 4), (31, 1))
    )
    assert refined.nbytes < whole.nbytes
    fp = [((bounder.distance(x).numpy() == 0) & (away > 0)).mean() for bounder in (refined, whole)]
    assert fp[0] < fp[1]
    middles = np.argwhere(refined.refined) + 0.5
    at = refined.domain.to_object(middles * 2 * refined.domain.limit / refined.refined.shape - refined.domain.limit)
    half = np.linalg.norm(2 * refined.domain.limit / refined.refined.shape) / 2 * refined.domain.unit
    assert (shape.distances(at)[:, 0] <= half * (1 + 1e-9)).all()


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
    (most,), _, _, _ = largest_excess(raised, shape, 60.0)
    v = rng.uniform(lower.min(axis=0), upper.max(axis=0), (100_000, 2))
    above = raised.reference(v) - shape.distances(raised.domain.to_object(v))[:, 0] / raised.domain.unit
    assert above.max() <= most <= above.max() + 0.01


def test_mistakes():
    grid = thing("c")
    for option, value in (("nodes", 1), ("nodes", 2.5), ("storage", "float64"), ("refine", 3), ("refine", 32)):
        with pytest.raises(BounderError, match=option):
            wb.fit(grid, "distance", "distance-grid", **{option: value})
    bounder = far("distance-grid", "c")
    for values in (np.zeros((3, 3, 3), np.float16), np.zeros((1, 5), np.float16), np.full((3, 3), 1e-6, np.float16)):
        with pytest.raises(BounderError):
            DistanceGrid(bounder.domain, {"values": values}, bounder.sizes, "cpu")
    with pytest.raises(BounderError, match="stored"):
        DistanceGrid(bounder.domain, {"values": np.zeros((3, 3), np.float32)}, bounder.sizes, "cpu")
    refined = wb.fit(grid, "distance", "distance-grid", nodes=6, refine=2, device="cpu", progress=False)
    bits = refined.tensors["refined"]
    fewer = bits & (bits - 1).astype(np.uint32)
    beyond = bits | np.uint32(1 << 31)
    for tensors, sizes in (
        (refined.tensors | {"refined": fewer}, refined.sizes),
        (refined.tensors | {"refined": beyond}, refined.sizes),
        (refined.tensors | {"refined": bits[:0]}, refined.sizes),
        (refined.tensors | {"blocks": refined.tensors["blocks"].astype(np.float32)}, refined.sizes),
        (refined.tensors, refined.sizes | {"refine": 4}),
        (refined.tensors, refined.sizes | {"refine": 1}),
        ({"values": refined.tensors["values"]}, refined.sizes),
    ):
        with pytest.raises(BounderError):
            DistanceGrid(refined.domain, tensors, sizes, "cpu")
    unknown = wb.IndicatorFunction(
        lambda x: (x**2).sum(axis=1) < 1,
        [-1, -1],
        [1, 1],
        empty=lambda low, high: (np.maximum(np.maximum(low, -high), 0) ** 2).sum(axis=1) > 1,
    )
    with pytest.raises(BounderError, match="meshes, grids, solids and functions with distance= have one"):
        wb.fit(unknown, "distance", "distance-grid")
