"""The paper's shapes, where they are at hand: every closed form is proven, tight, and never wrong on a million
samples."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.ellipsoids import QuadricBounder
from warp_bounding.geometry import GAP
from warp_bounding.shapes.formats.load import READERS

DATA = Path(os.environ.get("WARP_BOUNDING_DATA") or Path(__file__).parents[2] / "shared" / "data")
SHAPES = sorted(p for p in DATA.glob("[234]D/*") if p.suffix in READERS) if DATA.is_dir() else []
CLOSED = [name for name, kind in METHODS.items() if kind.exact_on_cells]


@pytest.mark.slow
@pytest.mark.skipif(not SHAPES, reason=f"the paper's shapes are not in {DATA}; set WARP_BOUNDING_DATA")
@pytest.mark.parametrize("path", SHAPES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_closed_forms(path):
    grid = wb.load_shape(path)
    rates, sizes = {}, {}
    for method in CLOSED:
        bounder = wb.fit(grid, method=method, device="cpu")
        assert bounder.certificate.proven
        result = wb.evaluate(bounder, grid, samples=100_000)
        assert result.fn == 0
        corners = grid.position(grid.boundary[:: max(1, len(grid.boundary) // 20_000)] + 0.5).astype(np.float32)
        assert bounder.query(corners[grid.contains(corners)]).numpy().all()
        rates[method] = result.fp_rate
        if isinstance(bounder, QuadricBounder):
            radius = math.log(-float(bounder.threshold)) / 2
            sizes[method] = grid.ndim * radius - np.linalg.slogdet(bounder.shape.matrix)[1]
    assert rates["kdop"] <= rates["aabb"] + 1e-6
    # Each is of least volume in its family, which the next holds; how much of it the domain cuts off is another matter.
    assert sizes["oriented-ellipsoid"] <= sizes["ellipsoid"] + grid.ndim * GAP
    assert sizes["ellipsoid"] <= sizes["sphere"] + grid.ndim * GAP
    assert rates["voxels"] < 0.2
