"""A bake of a folder: what a task does, what is not done again, and that nothing is lost whatever is killed."""

import errno
import json
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding import baking as module
from warp_bounding.baking import Job, Record, Settings, bake, bake_shape, jobs_of
from warp_bounding.errors import BounderError, BoundingError, FileFormatError, ShapeError

pytest.importorskip("distributed", reason="Dask is not installed")
KDOP = {"method": "kdop", "device": "cpu"}


@pytest.fixture
def folder(tmp_path) -> Path:
    """Three shapes, one of them broken, and a file that is none."""
    (tmp_path / "shapes").mkdir()
    for name in ("blob", "star"):
        np.save(tmp_path / "shapes" / f"{name}.npy", shape(name).occupancy)
    (tmp_path / "shapes" / "broken.stl").write_text("solid nothing\nendsolid")
    (tmp_path / "shapes" / "notes.txt").write_text("no shape")
    return tmp_path / "shapes"


def jobs(folder: Path, **arguments) -> dict[str, Job]:
    settings = Settings(arguments or KDOP, {}, None, 1000)
    return {job.record.name: job for job in jobs_of(folder, folder.parent / "out", settings)[0]}


def test_every_shape_is_a_bounder_and_a_row_and_is_not_done_again(folder, monkeypatch):
    monkeypatch.setattr(module, "_ended", lambda open_, *_: map(bake_shape, open_))  # no workers but this process
    out = folder.parent / "out"
    done = bake(folder, out, samples=1000, **KDOP)
    assert (done.baked, done.kept, done.failed, done.foreign) == (2, 0, 1, 1)
    library = wb.baking.BounderLibrary(out, device="cpu")
    rows = {row["name"]: row for row in library.manifest}
    assert (set(rows), library.names) == ({"blob", "star", "broken"}, ["blob", "star"])
    for name, bounder in library.items():
        assert rows[name]["certificate"] == bounder.certificate.kind == "proven"
        assert (rows[name]["method"], rows[name]["bytes"]) == (bounder.method, bounder.nbytes)
        rates = wb.evaluate(bounder, folder / f"{name}.npy", samples=1000)
        assert rows[name]["fp_rate"] == pytest.approx(rates.fp_rate)
    assert rows["broken"]["error"].startswith("expected")

    written = {path: path.stat().st_mtime_ns for path in out.glob("*.safetensors")}
    again = bake(folder, out, samples=1000, **KDOP)
    assert (again.baked, again.kept, again.failed) == (0, 2, 1)
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.safetensors")} == written
    job = jobs(folder)["blob"]
    assert bake_shape(job) == job.done()  # as Dask asks once more when a worker dies
    (out / "records" / f"{job.key}.json").write_text("{")
    assert bake(folder, out, samples=1000, **KDOP).baked == 1
    other = bake(folder, out, method="aabb", device="cpu", samples=1000)
    assert (other.baked, other.kept, len(wb.baking.BounderLibrary(out))) == (2, 0, 4)  # both stay


def test_names_tell_shapes_settings_and_version_apart(folder, monkeypatch):
    def names(**more):
        return {job.record.hash for job in jobs(folder, method="kdop", **more).values()}

    before = names()
    assert names() == before
    assert not names(k=26) & before
    np.save(folder / "blob.npy", ~shape("blob").occupancy)
    assert len(names() - before) == 1
    (folder / "a.gltf").write_text(json.dumps({"buffers": [{"uri": "a.bin"}, {"uri": "data:;base64,AA=="}]}))
    own = set()
    for content in (b"1", b"2"):
        (folder / "a.bin").write_bytes(content)
        own.add(jobs(folder)["a"].record.hash)
    assert len(own) == 2
    monkeypatch.setattr(module, "__version__", "99")
    assert not names() & before


def test_whatever_a_shape_does_is_a_record_and_a_full_disk_is_none(folder, monkeypatch):
    def fails(self, shape):
        raise MemoryError("no room\nat all")

    def full(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    job = jobs(folder)["blob"]
    with monkeypatch.context() as patched:
        patched.setattr(Settings, "bounder", fails)
        assert bake_shape(job).error == "MemoryError: no room at all"
    assert Record.read(job.out / "records" / f"{job.key}.json").error
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileFormatError, match="No space left on device"):
        bake_shape(job)
    assert not list(job.out.glob("*.safetensors"))


def test_warnings_are_notes_and_a_choice_may_be_that_none_pays(folder):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    trimesh.creation.box((1.0, 1.0, 1.0)).export(folder / "box.stl")
    assert "margin" in bake_shape(jobs(folder, method="bvh", resolution=8, margin=0.01, device="cpu")["box"]).note
    arguments = {"narrow_ns": 0.0, "methods": ["aabb"], "budget": 1.0, "device": "cpu"}
    job = jobs(folder, **arguments)["blob"]
    record = bake_shape(job)
    assert (record.method, record.file, record.error) == ("none", "", "")
    assert job.done() is not None


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"method": "nothing"}, "method must be one of"),
        ({"methd": "kdop"}, "there is no option 'methd'; did you mean 'method'"),
        ({"narrow_ns": -1.0}, "narrow_ns must be"),
        ({"narrow_ns": 1.0, "k": 14}, "unexpected keyword argument 'k'"),
        ({"workload": "none.npy"}, "No such file"),
        ({"jobs": 0}, "jobs must be"),
    ],
)
def test_what_is_wrong_for_every_shape_is_told_before(folder, options, told):
    with pytest.raises(BoundingError, match=told):
        bake(folder, folder.parent / "out", progress=False, **options)
    assert not (folder.parent / "out").exists()


def test_folders_are_looked_through(folder):
    for inside in ("inside", ".hidden"):
        (folder / inside).mkdir()
        np.save(folder / inside / "a.npy", np.eye(3))
    settings = Settings(KDOP, {}, None, 1000)
    found, foreign = jobs_of(folder, folder / "out", settings)
    assert [job.record.source for job in found] == ["blob.npy", "broken.stl", "star.npy", "inside/a.npy"]
    assert foreign == 1
    with pytest.raises(ShapeError, match="no such folder"):
        jobs_of(folder / "none", folder, settings)


def test_a_bake_has_a_folder_of_its_own(folder):
    (other := folder.parent / "other").mkdir()
    (other / "manifest.csv").write_text("mine")
    with pytest.raises(FileFormatError, match="holds other files"):
        bake(folder, other, method="kdop", progress=False)
    assert (other / "manifest.csv").read_text() == "mine"
    with pytest.raises(BounderError, match="another folder than that of the shapes"):
        bake(folder, folder, method="kdop", progress=False)


# --- on processes of this machine ------------------------------------------------------------------------------------


def test_a_worker_that_is_killed_loses_nothing(folder, monkeypatch):
    from dying import DyingSettings

    monkeypatch.setattr(module, "Settings", partial(DyingSettings, mark=str(folder.parent / "mark")))
    done = bake(folder, folder.parent / "out", jobs=1, progress=False, samples=1000, **KDOP)
    assert (folder.parent / "mark").exists()
    assert (done.baked, done.kept, done.failed, done.foreign) == (2, 0, 1, 1)
    assert [bool(record.error) for record in done.records] == [False, True, False]
    library = wb.baking.BounderLibrary(folder.parent / "out", device="cpu")
    assert library.names == ["blob", "star"]
    assert all(bounder.certificate.proven for bounder in library.values())


# --- a folder of bounders ---------------------------------------------------------------------------------------------


def test_nothing_is_loaded_before_it_is_asked(tmp_path):
    (tmp_path / "bad.safetensors").write_bytes(b"bad")
    library = wb.baking.BounderLibrary(tmp_path)
    assert "bad" in library
    with pytest.raises(FileFormatError, match=r"bad\.safetensors"):
        library["bad"]
    with pytest.raises(FileFormatError, match="no such folder"):
        wb.baking.BounderLibrary(tmp_path / "none")


def test_bounders_of_one_size_share_a_function_in_a_kernel_of_ones_own(tmp_path, rng):
    for name in ("blob", "half", "star"):
        wb.fit(shape(name), method="kdop", device="cpu").save(tmp_path / f"{name}.safetensors")
    bounders = list(wb.baking.BounderLibrary(tmp_path, device="cpu").values())
    assert len({bounder.func for bounder in bounders}) == 1

    @wp.kernel(enable_backward=False)
    def ask(
        data: wp.array(dtype=wb.Data),
        numbers: wp.array(dtype=wp.int32),
        q: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        out[i] = wp.static(bounders[0].func)(data[numbers[i]], q[i])

    x, numbers = rng.random((1000, 3), dtype=np.float32), rng.integers(0, 3, 1000, dtype=np.int32)
    data = wp.array([bounder.data for bounder in bounders], dtype=wb.Data, device="cpu")
    inputs = [wp.array(numbers, dtype=wp.int32, device="cpu"), wp.array(x, dtype=wp.vec3, device="cpu")]
    out = wp.zeros(len(x), dtype=wp.bool, device="cpu")
    wp.launch(ask, len(x), [data, *inputs], [out], device="cpu")
    expected = np.stack([bounder.query(x).numpy() for bounder in bounders])[numbers, np.arange(len(x))]
    assert (out.numpy() == expected).all()
