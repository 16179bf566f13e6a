"""What tests of baking share: a folder of small shapes, and a bake of it without a cluster."""

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.baking.bake import BakeFolder, Settings, bake_shape, find_shapes, jobs_of

pytest.importorskip("distributed", reason="Dask is not installed")
pytest.importorskip("torch", reason="torch is not installed")


@pytest.fixture
def folder(tmp_path):
    """Three shapes, one of them broken, and a file that is none."""
    where = tmp_path / "shapes"
    where.mkdir()
    for name in ("blob", "star"):
        np.save(where / f"{name}.npy", shape(name).occupancy)
    (where / "broken.stl").write_text("solid nothing\nendsolid")
    (where / "notes.txt").write_text("no shape")
    return where


@pytest.fixture
def jobs(tmp_path):
    """Called with a folder: its jobs."""

    def of(folder, out="out", **options):
        settings = Settings({"method": "kdop", "device": "cpu"} | options, samples=1000)
        kept = BakeFolder(tmp_path / out)
        found = find_shapes(folder, 1.0, kept.path)
        return list(jobs_of(folder, found, settings, kept))

    return of


@pytest.fixture
def baked(folder, jobs, tmp_path):
    """The folder of results, every job done in this process."""
    for job in jobs(folder):
        bake_shape(job)
    kept = BakeFolder(tmp_path / "out")
    kept.conclude(kept.records())
    return kept.path
