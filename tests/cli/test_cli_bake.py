"""``warp-bounding bake``: a folder of bounders, or one line that says what is wrong."""

import json

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, command, run

import warp_bounding as wb

pytest.importorskip("distributed", reason="Dask is not installed")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "shapes").mkdir()
    for name in ("blob", "star"):
        np.save(tmp_path / "shapes" / f"{name}.npy", shape(name).occupancy)
    (tmp_path / "shapes" / "notes.txt").write_text("no shape")
    return tmp_path / "shapes"


def test_a_folder_is_baked_once(folder):
    out = folder.parent / "out"
    (folder / "large.npy").write_bytes(bytes(30_000))
    options = ("--out", out, "--method", "kdop", "--samples", 1000, "--jobs", 1, "--largest", 0.02, "--json")
    done = command("bake", folder, *options)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    counts = {name: told[name] for name in ("shapes", "baked", "kept", "failed", "proven", "foreign", "too_large")}
    assert counts == {
        "shapes": 2,
        "baked": 2,
        "kept": 0,
        "failed": 0,
        "proven": 2,
        "foreign": 1,
        "too_large": ["large.npy"],
    }
    assert "large.npy: left out" in done.stderr
    assert wb.BounderLibrary(out, device="cpu").names == ["blob", "star"]
    for written in ("manifest", "contact_sheet"):
        assert (folder.parent / told[written]).exists()


def test_what_is_there_needs_no_worker(capsys, folder, monkeypatch):
    from warp_bounding.baking import bake

    def in_this_process(jobs, kept, done, *_):
        for job in jobs:
            yield (record := bake.Record(**bake.bake_shape(job)))
            done.baked, done.failed = done.baked + (not record.error), done.failed + bool(record.error)

    (folder / "broken.stl").write_text("solid nothing")
    out = folder.parent / "out"
    monkeypatch.setattr(bake, "_ended", in_this_process)
    status, text, err = run(capsys, "bake", folder, "--out", out, "--method", "kdop", "--samples", 1000)
    assert status == 1, err
    assert "3 shapes: 2 baked, 1 failed; 2 proven; 1 other files" in text
    status, text, err = run(capsys, "bake", folder, "--out", out, "--method", "kdop", "--samples", 1000)
    assert "3 shapes: 0 baked, 2 were there already, 1 failed; 2 proven" in text
    # other settings: both stay
    choice = ("--narrow-ns", 1e5, "--methods", "voxels", "--networks", "none", "--budget", 60)
    (folder / "broken.stl").unlink()
    status, text, err = run(capsys, "bake", folder, "--out", out, *choice)
    assert status == 0, err
    library = wb.BounderLibrary(out, device="cpu")
    assert len(library) == 4
    assert len({row["settings"] for row in library.manifest}) == 2
    assert "fit" in {json.loads(f.read_text())["engine"] for f in (out / "settings").glob("*.json")}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--method", "nothing"], "method must be one of"),
        (["--memory", "16k"], "--memory is for a choice, which --narrow-ns asks for; got '16k' without it"),
        (["--narrow-ns", 5, "--method", "kdop"], "--method is for a fit, and --narrow-ns asks for a choice"),
        (["--jobs", 0], "jobs must be a whole number of at least 1, got 0"),
        (["--jobs", 1, "--scheduler", "tcp://127.0.0.1:1"], "jobs is for workers of this machine"),
        (["--largest", -1], "largest must be a positive number of megabytes"),
        (["--largest", 1e-6], "no shapes, expected files of"),
        (["--queries", "nope.npy"], "nope.npy: no such file"),
        (["--samples", "few"], "samples must be a whole number"),
        (["--device", "gpu"], "no such device on this machine"),
    ],
)
def test_bad_input_is_one_line(capsys, folder, options, told):
    out = folder.parent / "out"
    status, text, err = run(capsys, "bake", folder, "--out", out, *options)
    check_bad(status, text, err)
    assert told in err
    assert not out.exists()


def test_folders_that_are_none(capsys, folder):
    status, text, err = run(capsys, "bake", folder / "none", "--out", folder.parent / "out")
    check_bad(status, text, err)
    assert "no such folder" in err
    status, text, err = run(capsys, "bake", folder, "--out", folder)
    check_bad(status, text, err)
    assert "expected another folder" in err
