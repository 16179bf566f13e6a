"""The command line as it is called: help, streams, Ctrl-C, and one clear line for what is wrong."""

import errno
import os

import numpy as np
import pytest
from commands import check_bad, command, run

import warp_bounding as wb
from warp_bounding import cli

NEW = "-o {dir}/new.safetensors "
BAD = {
    "dance": "No such command",
    "fit {c}": "--output",
    "fit {c} --query cone " + NEW: "'point', 'ray', 'plane', 'box'",
    "fit {dir}/none.npy " + NEW: "none.npy",
    "fit {c} --budget 1m " + NEW: "--budget",
    "fit {c} --hidden 24-24 " + NEW: "hidden must be widths such as 50,50, got '24-24'",
    "fit {c} --method aabb --spacing a " + NEW: "could not convert string to float: 'a'",
    "fit {empty} --method aabb " + NEW: "empty.npy",
    "fit {c} --method aabb -o {dir}": "is a folder",
    "fit {c} --method aabb -o {c}": "is read here",
    "fit {c} --method aabb -o {notes}": "notes.txt",
    "fit {c} --method aabb -o {c}/b.safetensors": "not a folder",
    "certify {c} {out}": "the bounder comes first, then the shape",
    "certify {out} {c} --checkpoint {out}": "checkpoint",
    "evaluate {out} {blob}": "3D",
    "show {out} {empty} --html {dir}/p.html": "empty.npy",
    "evaluate {out} {c} --stress many": "expected a whole number from 1 to 1e+15, such as 1e6, got 'many'",
    "info {dir}": "is a directory",
    "info {c} --json": "got an array, image or voxel file",
    "query {out} {c} -o {dir}/m.npy": "c.npy",
    "query {out} {q} -o {notes}": "notes.txt",
    "choose {c} --narrow-ns 1 --memory much " + NEW: "expected a whole number from 1",
    "choose {c} --narrow-ns 1 --checkpoint {c} --methods aabb " + NEW: "c.npy",
    "bake {dir} --output {dir}/baked --memory 16000": "takes no option 'memory'",
    "bake {dir} --output {dir}/baked --narrow-ns 5 --method kdop": "unexpected keyword argument 'method'",
    "bake {dir}/none --output {dir}/baked": "no such folder",
    "bake {dir} --output {dir}": "another folder",
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_input_is_one_line_and_changes_nothing(files, capsys, bad):
    np.save(files / "empty.npy", np.zeros((3, 3)))
    np.save(files / "q.npy", np.zeros((3, 2)))
    (files / "notes.txt").write_text("notes")
    wb.fit(np.load(files / "c.npy"), method="aabb", device="cpu").save(files / "out.safetensors")
    names = {name: files / f"{name}.npy" for name in ("c", "blob", "empty", "q")}
    names |= {"dir": files, "out": files / "out.safetensors", "notes": files / "notes.txt"}
    before = {path.name: path.read_bytes() for path in files.iterdir()}
    status, out, err = run(capsys, *bad.format(**names).split())
    check_bad(status, out, err)
    assert BAD[bad] in err
    assert {path.name: path.read_bytes() for path in files.iterdir()} == before


def test_methods_are_completed():
    asked = {"COMP_WORDS": "warp-bounding fit --method k", "COMP_CWORD": "3"}
    assert command(**asked, _WARP_BOUNDING_COMPLETE="complete_bash").stdout.split() == ["kdop"]


def test_verbose_shows_warps_messages_on_standard_error(files):
    path = files / "b.safetensors"
    words = ("fit", files / "c.npy", "-o", path, "--method", "aabb", "--samples", 2000, "--json")
    quiet, done = command(*words), command(*words, "--verbose")
    assert (quiet.returncode, quiet.stderr) == (0, "")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 1
    assert "load on device" in done.stderr


def test_paths_are_no_markup(files, capsys):
    """Brackets in a file's name are text, whatever the library that prints makes of them."""
    odd = "[red]x :smile:"
    (files / "c.npy").rename(files / f"{odd}.npy")
    shape_file, path = (files / f"{odd}{suffix}" for suffix in (".npy", ".safetensors"))
    mask = files / "[" / f"bold]{odd}.npy"  # read as markup, this ends what has never begun
    np.save(files / "points.npy", np.zeros((2, 2), np.float32))
    outputs = [
        run(capsys, "fit", shape_file, "-o", path, "--method", "aabb", "--samples", "1e4"),
        run(capsys, "query", path, files / "points.npy", "-o", mask),
        run(capsys, "certify", path, shape_file),
        run(capsys, "info", path),
    ]
    for status, out, err in outputs:
        assert (status, err) == (0, "")
        assert odd in out


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
def test_a_full_disk_behind_standard_output_is_one_line():
    with open("/dev/full", "w") as full:
        done = command("--version", stdout=full)
    assert (done.returncode, done.stderr) == (2, f"warp-bounding: {os.strerror(errno.ENOSPC)}\n")


def test_ctrl_c(files, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    for name in ("quiet_warp", "_app"):  # in a command, and before
        monkeypatch.setattr(cli, name, interrupted)
        assert run(capsys, "info", files / "c.npy") == (130, "", "interrupted\n")
