"""What this machine cannot hold is refused before it is begun."""

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators import shape as limits
from warp_bounding.indicators.triangles import cells as voxelization

BALL = np.linalg.norm(np.mgrid[-1:1:9j, -1:1:9j], axis=0) < 0.5


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(limits, "_memory", lambda: 2000)


def test_cells_of_a_mesh(small, monkeypatch):
    monkeypatch.setattr(voxelization, "surface_cells", lambda *_: pytest.fail("it was begun"))
    with pytest.raises(
        wb.IndicatorError, match=r"dividing it into 11 x 11 x 11 cells needs about .* GB .* coarser resolution"
    ):
        load_indicator(trimesh.creation.box()).to_grid(resolution=8)


def test_a_margin(small):
    with pytest.raises(wb.IndicatorError, match=r"dilating 81 cells needs about .* GB .* a smaller margin"):
        load_indicator(BALL).to_grid(margin=0.5)


def test_a_fit(monkeypatch):
    monkeypatch.setattr(limits, "_memory", lambda: 500)
    with pytest.raises(wb.IndicatorError, match=r"fitting .* occupied cells needs about"):
        wb.fit(BALL, method="aabb")


def test_a_machine_that_does_not_tell(monkeypatch):
    monkeypatch.delattr(limits.os, "sysconf", raising=False)
    assert limits._memory() is None
    assert wb.fit(BALL, method="aabb").certificate.proven


def test_this_machine_has_some():
    assert limits._memory() is None or limits._memory() > 2**28
