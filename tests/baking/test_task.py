"""What a worker does with one shape, in this process."""

import base64
import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.baking.bake import SHEET, Record, Settings, bake_shape, find_shapes, picture, shape_digest
from warp_bounding.baking.library import COLUMNS
from warp_bounding.errors import BoundingError, FileFormatError, IndicatorError


def test_every_shape_is_a_row_and_a_card(baked):
    rows = {row["name"]: row for row in wb.BounderLibrary(baked).manifest}
    assert set(rows) == {"blob", "star", "broken"}
    for name in ("blob", "star"):
        bounder = wb.load(baked / rows[name]["file"], device="cpu")
        assert rows[name]["certificate"] == bounder.certificate.kind == "proven"
        assert (rows[name]["method"], rows[name]["bytes"]) == (bounder.method, bounder.nbytes)
        rates = wb.evaluate(bounder, baked.parent / "shapes" / f"{name}.npy", samples=1000)
        assert rows[name]["fp_rate"] == pytest.approx(rates.fp_rate)
    assert rows["broken"]["file"] == ""
    assert "expected a mesh with faces" in rows["broken"]["error"]
    page = (baked / SHEET).read_text()
    assert page.count("<article") == 3
    assert page.count("data:image/png;base64,") == 2
    assert "expected a mesh with faces" in page
    assert "http" not in page  # it needs nothing but itself


def test_what_is_there_is_not_done_again(folder, jobs, baked):
    done = {job.record.name: job.done() for job in jobs(folder)}
    assert done["broken"] is None
    assert {name for name, record in done.items() if record} == {"blob", "star"}
    first = next(job for job in jobs(folder) if job.record.name == "blob")
    written = first.record.path_in(baked).stat().st_mtime_ns, first.bounder_path.stat().st_mtime_ns
    told = bake_shape(first)  # as Dask asks once more when a worker dies
    assert (first.record.path_in(baked).stat().st_mtime_ns, first.bounder_path.stat().st_mtime_ns) == written
    assert Record(**told) == replace(Record.read(first.record.path_in(baked)), picture="")
    content = first.bounder_path.read_bytes()
    first.bounder_path.write_bytes(content[:-1])
    assert first.done() is None  # damaged
    first.bounder_path.unlink()
    assert first.done() is None
    bake_shape(first)
    assert first.done() is not None
    first.record.path_in(baked).write_text("{")
    assert first.done() is None


def test_names_tell_shapes_settings_and_version_apart(folder, jobs, monkeypatch):
    names = {job.record.hash for job in jobs(folder)}
    assert {job.record.hash for job in jobs(folder)} == names
    assert not {job.record.hash for job in jobs(folder, k=26)} & names
    np.save(folder / "blob.npy", ~shape("blob").occupancy)
    assert len({job.record.hash for job in jobs(folder)} - names) == 1
    monkeypatch.setattr("warp_bounding.baking.bake.__version__", "99")
    assert not {job.record.hash for job in jobs(folder)} & names


def test_a_gltf_file_is_told_apart_by_its_buffers(tmp_path):
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({"buffers": [{"uri": "a.bin"}, {"uri": "data:;base64,AA=="}]}))
    (tmp_path / "a.bin").write_bytes(b"1")
    before = shape_digest(path)
    (tmp_path / "a.bin").write_bytes(b"2")
    assert shape_digest(path) != before


def test_a_full_disk_is_no_error_of_the_shape(folder, jobs, monkeypatch):
    def full(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    job = jobs(folder)[0]
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileFormatError, match="No space left on device"):
        bake_shape(job)
    assert not list(job.bounder_path.parent.glob("*.safetensors"))


def test_whatever_a_shape_does_is_told_in_one_line(folder, jobs, monkeypatch):
    def fails(self, shape):
        raise MemoryError("no room\nat all")

    monkeypatch.setattr(Settings, "bounder", fails)
    job = jobs(folder)[0]
    assert bake_shape(job)["error"] == "MemoryError: no room at all"
    assert Record.read(job.record.path_in(Path(job.out))).error == "MemoryError: no room at all"


def test_warnings_are_notes(tmp_path, jobs):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    folder = tmp_path / "meshes"
    folder.mkdir()
    trimesh.creation.box((1.0, 1.0, 1.0)).export(folder / "box.stl")
    (job,) = jobs(folder, method="bvh", resolution=8, margin=0.01)
    assert "margin" in bake_shape(job)["note"]


def test_a_choice_may_be_that_none_pays(folder, jobs):
    settings = Settings(
        {"narrow_ns": 0.0, "methods": ["aabb"], "networks": [], "budget": 1.0, "device": "cpu"}, samples=1000
    )
    settings.check()
    job = replace(jobs(folder)[0], settings=settings)
    record = bake_shape(job)
    assert (record["method"], record["file"], record["error"]) == ("none", "", "")
    assert job.done() is not None


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (Settings({"method": "nothing"}), "method must be one of"),
        (Settings({"methd": "kdop"}), "there is no option 'methd'; did you mean 'method'"),
        (Settings({"query": "ball"}), "query must be one of"),
        (Settings({"budget": 0}), "budget must be a positive number"),
        (Settings({"method": "aabb", "k": 14}), "aabb takes no option 'k'"),
        (Settings({"query": "distance", "method": "nothing"}), "method of a distance must be one of"),
        (Settings({"query": "distance", "method": "kdop", "leaves": 5}), "kdop takes no option 'leaves'"),
        (Settings({"narrow_ns": -1.0}), "narrow_ns must be"),
        (Settings({"narrow_ns": 1.0, "k": 14}), "choose takes no option 'k'"),
    ],
)
def test_what_is_wrong_for_every_shape_is_told_before(settings, told):
    with pytest.raises(BoundingError, match=told):
        settings.check()


def test_folders_are_looked_through(folder):
    (folder / "inside").mkdir()
    (folder / ".hidden").mkdir()
    np.save(folder / "inside" / "a.npy", np.eye(3))
    np.save(folder / ".hidden" / "b.npy", np.eye(3))
    np.save(folder / "large.npy", np.zeros(200_000, bool))
    found = find_shapes(folder, 0.1, folder / "out")
    assert [path.name for path in found.shapes] == ["blob.npy", "broken.stl", "star.npy", "a.npy"]
    assert [path.name for path in found.too_large] == ["large.npy"]
    assert found.foreign == 1
    with pytest.raises(IndicatorError, match="no shapes, expected files of"):
        find_shapes(folder / ".hidden", 1e-6, folder)
    with pytest.raises(IndicatorError, match="no such folder"):
        find_shapes(folder / "none", 1.0, folder)


@pytest.mark.parametrize("query", ["point", "ray", "plane", "box", "distance"])
def test_pictures_of_every_kind_of_query_show_the_object_in_its_bound(query):
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    grid = shape("star")
    bounder = wb.fit(grid, query, "aabb" if query != "distance" else "sphere", device="cpu")
    import io

    drawn = np.asarray(image.open(io.BytesIO(picture(bounder, grid))))
    assert drawn.shape == (72, 222)
    assert {1, 2} <= set(np.unique(drawn))  # a box around a star is loose


def test_a_line_has_no_picture():
    assert picture(wb.fit(shape("line"), method="aabb", device="cpu"), shape("line")) == b""


def test_records_hold_what_rows_show(baked):
    record = Record.read(next((baked / "records").glob("blob-*.json")))
    assert {name: getattr(record, name) for name in COLUMNS} in wb.BounderLibrary(baked).manifest
    assert base64.b64decode(record.picture).startswith(b"\x89PNG")
