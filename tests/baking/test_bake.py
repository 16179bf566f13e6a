"""Whole bakes on processes of this machine, with a worker that dies."""

import numpy as np
import pytest
from bounding_shapes import shape
from dying import DyingSettings

import warp_bounding as wb
from warp_bounding.baking import bake as module
from warp_bounding.baking.bake import BakeFolder, bake_with
from warp_bounding.errors import BounderError, BoundingError, FileFormatError


def bake_dying(folder, tmp_path, lines, told):
    arguments = {"method": "kdop", "device": "cpu"}
    settings = DyingSettings(arguments, samples=1000, mark=str(tmp_path / "mark"))
    run = {"jobs": 1, "progress": lambda *t: told.append(t), "tell": lines.append}
    return bake_with(settings, folder, tmp_path / "out", **run)


def test_a_worker_that_is_killed_loses_nothing(folder, tmp_path):
    told, lines = [], []
    done = bake_dying(folder, tmp_path, lines, told)
    assert (tmp_path / "mark").exists()
    assert {record.name: record.error for record in done.records if record.error} == {
        "broken": "expected a .stl mesh, but it cannot be read: expected a mesh with faces, got none"
    }
    assert (done.baked, done.kept, done.failed, done.foreign) == (2, 0, 1, 1)
    assert told[-1][:2] == (3, 3)
    assert any("broken.stl: " in line and "got none" in line for line in lines)
    library = wb.BounderLibrary(tmp_path / "out", device="cpu")
    assert library.names == ["blob", "star"]
    assert all(bounder.certificate.proven for bounder in library.values())


@pytest.mark.slow
def test_a_shape_that_kills_every_worker_is_given_up(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "DEATHS", 1)
    np.save(folder / "deadly.npy", shape("half").occupancy)
    lines = []
    done = bake_dying(folder, tmp_path, lines, [])
    assert {record.name for record in done.records if record.error} == {"broken", "deadly"}
    assert "deadly.npy: every worker that fitted it died (killed, out of memory, or a crash)" in lines
    again = bake_dying(folder, tmp_path, lines, [])
    assert (again.kept, again.failed) == (2, 2)


def test_only_one_bake_at_a_time(folder, tmp_path):
    with (
        BakeFolder((tmp_path / "out").resolve()).locked(),
        pytest.raises(FileFormatError, match="another bake writes to it"),
    ):
        wb.bake(folder, tmp_path / "out", method="kdop", progress=False)


def test_other_folders_are_left_alone(folder, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "manifest.csv").write_text("mine")
    with pytest.raises(FileFormatError, match="holds other files"):
        wb.bake(folder, tmp_path / "out", method="kdop", progress=False)
    assert (tmp_path / "out" / "manifest.csv").read_text() == "mine"
    with pytest.raises(BounderError, match="another folder than that of the shapes"):
        wb.bake(folder, folder, method="kdop", progress=False)


def test_what_killed_workers_left_is_removed(folder, jobs, tmp_path):
    kept = BakeFolder(tmp_path / "out")
    left = kept.path / ".blob-0123456789ab.safetensors.abc"
    left.write_bytes(b"half")
    kept.clean()
    assert not left.exists()
    assert (kept.path / "bake.json").exists()


def test_a_scheduler_that_does_not_answer(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "CONNECT_SECONDS", 0.2)
    with pytest.raises(BoundingError, match=r"tcp://127\.0\.0\.1:1: no scheduler answers"):
        wb.bake(folder, tmp_path / "out", scheduler="tcp://127.0.0.1:1", method="kdop", progress=False)


def test_options_are_checked(folder, tmp_path):
    for options, told in [
        ({"jobs": 0}, "jobs must be"),
        ({"largest": 0}, "largest must be"),
        ({"k": 3}, "takes no option 'k'"),
    ]:
        with pytest.raises(BoundingError, match=told):
            wb.bake(folder, tmp_path / "out", progress=False, **options)
    assert not (tmp_path / "out").exists()
