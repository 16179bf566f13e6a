"""``choose`` and ``bake``: a bounder, a plot and a table, or a folder of bounders."""

import io
import json
import re

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, run
from rich.console import Console

import warp_bounding as wb
from warp_bounding.cli import print_table


@pytest.fixture
def disk(tmp_path):
    np.save(tmp_path / "disk.npy", np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5)
    return tmp_path / "disk.npy"


def choose(capsys, disk, *options, price=5000, name="c"):
    output = disk.parent / f"{name}.safetensors"
    words = ("-o", output, "--narrow-ns", price, "--budget", 4, "--networks", "none", "--methods", "aabb,bvh,obb,mlp")
    return output, run(capsys, "choose", disk, *words, *options)


def test_what_is_chosen_is_written_and_a_choice_goes_on(capsys, disk):
    output, (status, out, err) = choose(capsys, disk)
    assert (status, err) == (0, "")
    assert "s a query in all" in out
    assert "Best by the narrow phase's price: none from 0 ns" in out
    assert f"candidates are kept in {output.with_suffix('.choice')}" in out
    assert out.splitlines()[0].endswith("; --queries x.npy asks those of your simulation")
    assert output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert wb.load(output, device="cpu").certificate.proven
    before = {path: path.stat().st_mtime_ns for path in (disk.parent / "c.choice").glob("*.safetensors")}
    again, (status, out, err) = choose(capsys, disk, "--json", "--folder", disk.parent / "c.choice", price=0, name="d")
    found = json.loads(out)
    assert (status, found["label"], found["path"], again.exists()) == (0, "none", None, False)
    after = {path: path.stat().st_mtime_ns for path in (disk.parent / "c.choice").glob("*.safetensors")}
    assert before
    assert before.items() <= after.items()


def test_long_remarks_are_footnotes(capsys, disk):
    _, (status, out, err) = choose(capsys, disk, "--methods", "aabb,mlp", "--networks", "50-50", "--budget", 1)
    assert status == 0, err
    row = next(line for line in out.splitlines() if line.startswith("mlp 50-50"))
    number = re.search(r"\[\d+\]$", row.rstrip())[0]
    assert "needs a budget of" in next(line for line in out.splitlines() if line.startswith(f"{number} "))


@pytest.mark.parametrize(("width", "terminal"), [(40, True), (80, True), (160, True), (80, False)])
def test_numbers_are_whole_at_any_width(width, terminal):
    rows = [
        ("bvh 1024 leaves", "38,268", "39.1", "13.8", "246.8", "proven", "bold"),
        ("mlp 50-50, 1024 parts", "11,204", "12.34", "11.85", "1,234.5", "proven; hardly trained: 3 steps", ""),
    ]
    file, header = io.StringIO(), dict.fromkeys(("", "bytes", "ns", "left %", "cost ns", "certificate"), "right")
    out = Console(file=file, width=width, force_terminal=terminal, color_system=None, soft_wrap=True)
    print_table(out, header | {"": "left", "certificate": "left"}, rows)
    lines = file.getvalue().splitlines()
    for number in (number for row in rows for number in row[1:5]):
        assert re.search(rf"(?<![\d.,]){re.escape(number)}(?![\d.,])", file.getvalue()), number
    assert "…" not in file.getvalue()
    assert width < 80 or not terminal or max(map(len, lines)) <= width
    assert len(lines) == len(rows) + 1 or (terminal and width < 160)  # nobody wraps where there is room, or no terminal


# --- bake ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    pytest.importorskip("distributed", reason="Dask is not installed")
    (tmp_path / "shapes").mkdir()
    for name in ("blob", "star"):
        np.save(tmp_path / "shapes" / f"{name}.npy", shape(name).occupancy)
    (tmp_path / "shapes" / "notes.txt").write_text("no shape")
    return tmp_path / "shapes"


def test_a_folder_is_baked_once(folder, capsys):
    out = folder.parent / "out"
    (folder / "large.npy").write_bytes(bytes(30_000))
    words = ("--out", out, "--method", "kdop", "--samples", 1000, "--jobs", 1, "--largest", 0.02)
    status, text, err = run(capsys, "bake", folder, *words, "--json")
    assert status == 0, err
    found = json.loads(text)
    assert [found[name] for name in ("shapes", "baked", "kept", "failed", "proven", "foreign")] == [2, 2, 0, 0, 2, 1]
    assert found["too_large"] == ["large.npy"]
    assert "large.npy: left out" in err
    assert wb.BounderLibrary(out, device="cpu").names == ["blob", "star"]
    status, text, _ = run(capsys, "bake", folder, *words)
    assert status == 0
    assert "2 shapes: 0 baked, 2 were there already, 0 failed; 2 proven" in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--method", "nothing"], "method must be one of"),
        (["--memory", "16k"], "--memory is for a choice, which --narrow-ns asks for; got '16k' without it"),
        (["--narrow-ns", 5, "--method", "kdop"], "--method is for a fit, and --narrow-ns asks for a choice"),
        (["--narrow-ns", 5, "--networks", "0-5"], "hidden must be"),
        (["--jobs", 0], "jobs must be a whole number of at least 1, got 0"),
        (["--jobs", 1, "--scheduler", "tcp://127.0.0.1:1"], "jobs is for workers of this machine"),
        (["--largest", -1], "largest must be a positive number of megabytes"),
        (["--largest", 1e-6], "no shapes, expected files of"),
        (["--queries", "nope.npy"], "nope.npy: no such file"),
        (["--samples", "few"], "samples must be a whole number"),
        (["--device", "gpu"], "no such device on this machine"),
    ],
)
def test_what_would_be_wrong_for_every_shape_is_one_line(capsys, folder, options, words):
    out = folder.parent / "out"
    status, text, err = run(capsys, "bake", folder, "--out", out, *options)
    check_bad(status, text, err)
    assert words in err
    assert not out.exists()
    check_bad(*run(capsys, "bake", folder / "none", "--out", out))
    check_bad(*run(capsys, "bake", folder, "--out", folder))
