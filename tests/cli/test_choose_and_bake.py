"""``choose`` and ``bake``: a bounder, a plot and a table, or a folder of bounders."""

import json

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, run

import warp_bounding as wb


@pytest.fixture
def disk(tmp_path):
    np.save(tmp_path / "disk.npy", np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5)
    return tmp_path / "disk.npy"


def choose(capsys, disk, *options, price=5000, name="c"):
    output = disk.parent / f"{name}.safetensors"
    words = ("-o", output, "--narrow-ns", price, "--budget", 4, "--methods", "aabb,bvh,obb")
    return output, run(capsys, "choose", disk, *words, *options)


def test_what_is_chosen_is_written_and_a_choice_goes_on(capsys, disk):
    output, (status, out, err) = choose(capsys, disk)
    assert (status, err) == (0, "")
    assert "s a query in all" in out
    assert "Best by the narrow phase's price: none from 0 ns" in out
    assert f"candidates are kept in {output.with_suffix('.choice')}" in out
    assert "--workload x.npy asks those of your simulation" in out.splitlines()[0]
    assert output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert wb.load(output, device="cpu").certificate.proven
    before = {path: path.stat().st_mtime_ns for path in (disk.parent / "c.choice").glob("*.safetensors")}
    again, (status, out, err) = choose(
        capsys, disk, "--json", "--checkpoint", disk.parent / "c.choice", price=0, name="d"
    )
    found = json.loads(out)
    assert (status, found["label"], found["path"], again.exists()) == (0, "none", None, False)
    after = {path: path.stat().st_mtime_ns for path in (disk.parent / "c.choice").glob("*.safetensors")}
    assert before
    assert before.items() <= after.items()


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
    words = ("--output", out, "--method", "kdop", "--samples", 1000, "--jobs", 1)
    status, text, err = run(capsys, "bake", folder, *words, "--json")
    assert status == 0, err
    found = json.loads(text)
    assert [found[name] for name in ("shapes", "baked", "kept", "failed", "proven", "foreign")] == [2, 2, 0, 0, 2, 1]
    assert wb.baking.BounderLibrary(out, device="cpu").names == ["blob", "star"]
    status, text, _ = run(capsys, "bake", folder, *words)
    assert status == 0
    assert "2 shapes: 0 baked, 2 were there already, 0 failed; 2 proven" in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--memory", 16000], "takes no option 'memory'"),
        (["--narrow-ns", 5, "--method", "kdop"], "unexpected keyword argument 'method'"),
    ],
)
def test_what_would_be_wrong_for_every_shape_is_one_line(capsys, folder, options, words):
    out = folder.parent / "out"
    status, text, err = run(capsys, "bake", folder, "--output", out, *options)
    check_bad(status, text, err)
    assert words in err
    assert not out.exists()
    check_bad(*run(capsys, "bake", folder / "none", "--output", out))
    check_bad(*run(capsys, "bake", folder, "--output", folder))
