"""A margin that leaves nothing of the object's form is refused before any work; one under a cell's size is warned of."""

import warnings

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.indicators import IndicatorMotion

BOX = trimesh.creation.box(extents=(1, 2, 0.5))
BALL = np.linalg.norm(np.mgrid[-1:1:9j, -1:1:9j], axis=0) < 0.5


def motion():
    return IndicatorMotion(np.stack([BOX.vertices, BOX.vertices + 0.1]), BOX.faces, time_cells=2)


@pytest.mark.parametrize(
    ("shape", "extent"),
    [(BOX, 2), (motion(), 2.1), (BALL, 1.125), (np.stack([BALL] * 3)[..., None], 1.125)],
    ids=["mesh", "motion", "grid", "animated"],
)
def test_a_margin_beyond_the_extent_is_an_error_unless_forced(shape, extent, monkeypatch):
    shape = wb.load_indicator(shape)
    too_large = extent * 1.01
    with monkeypatch.context() as patch:
        patch.setattr(type(shape), "to_grid", lambda *_, **__: pytest.fail("work was begun"))
        with pytest.raises(wb.BounderError) as caught:
            wb.fit(shape, method="aabb", margin=too_large)
        assert f"margin must be at most the object's extent, {extent:.4g}, got {too_large:g}; force=True" in str(
            caught.value
        )
    options = {} if isinstance(shape, wb.IndicatorGrid) else {"resolution": 6}
    assert wb.fit(shape, method="aabb", margin=too_large, force=True, **options).certificate.proven
    assert wb.fit(shape, method="aabb", margin=extent * 0.99, **options).certificate.proven


@pytest.mark.parametrize(("margin", "resolution"), [(0.01, 64), (0.1, 6)])
def test_a_margin_under_a_cell_is_warned_of_once(margin, resolution):
    with pytest.warns(wb.BoundingWarning, match=f"margin {margin} is under the size of a cell") as caught:
        bounder = wb.fit(BOX, method="aabb", margin=margin, resolution=resolution)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    text = str(caught[0].message)
    assert f"cells at resolution {resolution}" in text
    finer = int(text.rpartition("resolution=")[2].split()[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert 1 / scale_of(margin, finer - 1) >= margin * 0.99
        wb.fit(BOX, method="aabb", margin=margin, resolution=finer + 2)
    assert wb.evaluate(bounder, BOX, samples=1000).fp_rate_cells is not None


def scale_of(margin, resolution):
    return wb.load_indicator(BOX).to_grid(resolution=resolution, margin=margin).cells_per_unit[0]


def test_no_finer_resolution_is_named_than_there_is():
    with pytest.warns(wb.BoundingWarning, match="give a finer resolution$"):
        wb.fit(BOX, method="aabb", margin=1e-4, resolution=8)


@pytest.mark.parametrize("options", [{}, {"margin": 0.5, "resolution": 8}])
def test_no_warning_where_there_is_no_margin_or_cells_are_finer(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wb.fit(BOX, method="aabb", **options)
        wb.fit(wb.load_indicator(BOX).to_grid(resolution=4, margin=0.01), method="aabb", margin=0.01)


@pytest.mark.parametrize("shape", [BALL, BOX], ids=["grid", "mesh"])
def test_numbers_of_numpy_are_kept_as_numbers(shape, tmp_path):
    bounder = wb.fit(shape, method="aabb", margin=np.float32(0.125), budget=np.float32(5), seed=np.int64(3))
    bounder.save(tmp_path / "b.safetensors")
    assert wb.load(tmp_path / "b.safetensors").info["margin"] == 0.125
