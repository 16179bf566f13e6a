"""Hierarchies of small bounders are proven, and tighter than one bounder."""

import numpy as np
import pytest
from bounding_shapes import fitted_ball

import warp_bounding as wb


@pytest.mark.slow  # half a minute: three levels are proven twice
def test_a_hierarchy_is_proven_and_tighter_than_its_boxes(tmp_path, rng):
    ball = wb.solids.Torus((0.0, 0.0, 0.0), 0.7, 0.2)
    tree = wb.hierarchy(ball, method="kdop", levels=3, device="cpu", progress=False)
    assert tree.certificate.proven
    tree.save(tmp_path / "t.safetensors")
    again = wb.load(tmp_path / "t.safetensors", device="cpu")
    assert wb.certify(again, ball).proven
    rates, single = wb.evaluate(again, ball, 50_000), wb.evaluate(fitted_ball(ball), ball, 50_000)
    assert rates.fn == 0
    assert rates.fp_rate < 0.8 * single.fp_rate
    x = rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)
    assert again.query(x[ball.contains(x)]).numpy().all()


def test_a_hierarchy_of_cells_is_cut_through_them():
    cells = np.zeros((24, 24), dtype=bool)
    cells[2:11, 3:9], cells[13:22, 12:23] = True, True
    tree = wb.hierarchy(wb.IndicatorGrid(cells), method="kdop", levels=2, device="cpu", progress=False)
    places = {x for end in tree.held for corner in end for x in 23 * corner[np.isfinite(corner)]}
    cuts = [x for x in places if abs(x - round(x)) < 1e-3]
    assert len(tree.parts) == 4
    assert len(cuts) >= 3
    assert tree.certificate.proven


def test_a_union_of_learned_half_spaces_is_proven_and_tighter_than_one():
    ring = wb.solids.Sphere((0.0, 0.0), 0.9) - wb.solids.Sphere((0.0, 0.0), 0.6)
    told = {"method": "learned-kdop", "steps": 60, "device": "cpu", "progress": False}
    tree, single = wb.hierarchy(ring, leaves=5, **told), wb.fit(ring, **told)
    assert [[each.method for each in part.parts] for part in tree.parts] == [["aabb", "learned-kdop"]] * 5
    assert tree.certificate.proven
    assert wb.certify(tree, ring).proven
    rates, alone = wb.evaluate(tree, ring, 50_000), wb.evaluate(single, ring, 50_000)
    assert rates.fn == 0
    assert rates.fp_rate < 0.6 * alone.fp_rate


@pytest.mark.parametrize("thresholds", [1, 9])
def test_a_hierarchy_of_networks_is_proven(thresholds):
    ball = wb.solids.Sphere((0.2, 0.1), 0.7)
    told = {"levels": 1, "hidden": (8,), "steps": 100, "thresholds": thresholds}
    tree = wb.hierarchy(ball, **told, device="cpu", progress=False)
    assert {each.method for part in tree.parts for each in part.parts} == {"aabb", "local" if thresholds > 1 else "mlp"}
    assert tree.certificate.proven
    assert wb.certify(tree, ball).proven
    assert wb.evaluate(tree, ball, 50_000).fn == 0


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"query": "ray"}, "point queries"),
        ({"levels": 0}, "levels"),
        ({"levels": 2.0}, "levels"),
        ({"levels": 20}, "levels"),
        ({"method": "voxels"}, "cannot be a leaf"),
        ({"method": "occupancy"}, "cannot be a leaf"),
        ({"method": "mlb"}, "method must be one of"),
        ({"budget": -1.0}, "budget"),
        ({"budget": None}, "budget"),
        ({"seed": -1}, "seed"),
        ({"margin": float("nan")}, "margin"),
        ({"leaves": 1}, "leaves"),
        ({"leaves": 3.0}, "leaves"),
        ({"leaves": 257}, "leaves"),
        ({"levels": 1, "k": 8}, "takes"),
    ],
)
def test_what_a_hierarchy_refuses(told, message):
    with pytest.raises(wb.BoundingError, match=message):
        wb.hierarchy(wb.solids.Sphere((0.0, 0.0), 1.0), **told, device="cpu", progress=False)


def test_a_hierarchy_of_cells_that_move_holds_at_all_times(rng):
    cells = np.zeros((8, 12, 12), dtype=bool)
    for t in range(8):
        cells[t, 1 + t : 4 + t, 2:5] = True
        cells[t, 8 - t : 11 - t, 7:10] = True
    moving = wb.IndicatorGrid(cells, time=True)
    tree = wb.hierarchy(moving, method="kdop", levels=2, device="cpu", progress=False)
    assert tree.certificate.proven
    assert wb.certify(tree, moving).proven
    rates = wb.evaluate(tree, moving, 50_000)
    assert rates.fn == 0
    x = rng.uniform(0, 1, (20_000, 3)).astype(np.float32)
    assert tree.query(x[moving.contains(x)]).numpy().all()
