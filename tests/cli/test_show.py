"""``warp-bounding show``: pictures and pages from the command line, and one clear line for what is wrong."""

import json
import sys

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, fit, run

from warp_bounding.errors import BoundingError

pytest.importorskip("pyvista")
pytest.importorskip("plotly")
QUICK = ("--samples", "500", "--resolution", "12")

BAD = {
    "no such file": ["{dir}/none.safetensors", "{c}", "--html", "{dir}/p.html"],
    "no shape": ["{out}", "{dir}/none.npy", "--html", "{dir}/p.html"],
    "swapped": ["{c}", "{out}", "--html", "{dir}/p.html"],
    "another dimension": ["{out}", "{blob}", "--html", "{dir}/p.html"],
    "page of another name": ["{out}", "{c}", "--html", "{dir}/p.txt"],
    "picture of another name": ["{out}", "{c}", "--screenshot", "{dir}/p.jpg"],
    "over a folder": ["{out}", "{c}", "--html", "{dir}/folder.html"],
    "below a file": ["{out}", "{c}", "--html", "{c}/p.html"],
    "radius of points": ["{out}", "{c}", "--html", "{dir}/p.html", "--radius", "0.1"],
    "radius of words": ["{out}", "{c}", "--html", "{dir}/p.html", "--radius", "wide"],
    "radius below 0": ["{far}", "{blob}", "--html", "{dir}/p.html", "--radius", "0,-1"],
    "time of what is at rest": ["{out}", "{c}", "--html", "{dir}/p.html", "--time", "0"],
    "slice of words": ["{out}", "{c}", "--html", "{dir}/p.html", "--slice", "x=0"],
    "slice to a line": ["{out}", "{c}", "--html", "{dir}/p.html", "--slice", "0=0.5"],
    "slice of nothing": ["{far}", "{blob}", "--html", "{dir}/p.html", "--slice", "7=0.5"],
    "resolution": ["{out}", "{c}", "--html", "{dir}/p.html", "--resolution", "1"],
    "samples": ["{out}", "{c}", "--html", "{dir}/p.html", "--samples", "0"],
    "seed": ["{out}", "{c}", "--html", "{dir}/p.html", "--seed", "-1"],
    "up": ["{out}", "{c}", "--html", "{dir}/p.html", "--up", "w"],
    "cut": ["{far}", "{blob}", "--screenshot", "{dir}/p.png", "--cut", "w"],
    "cut of a page": ["{far}", "{blob}", "--html", "{dir}/p.html", "--cut", "x"],
    "rays": ["{rays}", "{c}", "--html", "{dir}/p.html"],
    "json of a window": ["{out}", "{c}", "--json"],
    "device": ["{out}", "{c}", "--html", "{dir}/p.html", "--device", "cuda:99"],
}


@pytest.fixture
def bounders(files, capsys):
    """Paths of bounders by name, beside the shapes that they bound."""
    (files / "folder.html").mkdir()
    names = {"dir": files, **{name: files / f"{name}.npy" for name in ("c", "blob", "other")}}
    names["out"], _ = fit(capsys, files, name="out")
    names["rays"], _ = fit(capsys, files, "--query", "ray", name="rays")
    names["far"], _ = fit(capsys, files, "--query", "distance", name="far", source="blob.npy")
    return names


@pytest.mark.parametrize("bad", BAD)
def test_bad_usage(bounders, capsys, bad):
    before = sorted(path.name for path in bounders["dir"].iterdir())
    check_bad(*run(capsys, "show", *(word.format(**bounders) for word in BAD[bad])))
    assert sorted(path.name for path in bounders["dir"].iterdir()) == before


def test_without_a_display_the_other_ways_are_named(bounders, capsys, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    status, out, err = run(capsys, "show", bounders["out"], bounders["c"])
    check_bad(status, out, err)
    assert "expected --screenshot FILE.png or --html FILE.html" in err


@pytest.mark.parametrize("package", ["pyvista", "plotly"])
def test_a_missing_package_names_the_extra(bounders, capsys, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    status, out, err = run(capsys, "show", bounders["out"], bounders["c"], "--html", bounders["dir"] / "p.html")
    check_bad(status, out, err)
    assert err == f"warp-bounding: show needs {package}: pip install 'warp-bounding[show]'\n"


def test_a_page_and_what_is_told(bounders, capsys):
    path = bounders["dir"] / "new" / "page.html"
    status, out, err = run(
        capsys, "show", bounders["far"], bounders["blob"], "--html", path, "--radius", "0,0.1", *QUICK
    )
    assert (status, err) == (0, "")
    assert [line.partition(":")[0] for line in out.splitlines()[:2]] == ["aabb", "aabb"]
    assert "radius 0.1: " in out
    assert out.splitlines()[-1] == f"written to {path}"
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_json_is_one_object(bounders, capsys):
    path = bounders["dir"] / "page.html"
    status, out, err = run(capsys, "show", bounders["out"], bounders["c"], "--html", path, "--json", *QUICK)
    assert (status, err) == (0, "")
    told = json.loads(out)
    assert told["html"] == str(path)
    assert told["same_indicator"]
    assert told["certificate"]["proven"]
    assert [(state["fn"], state["samples"]) for state in told["states"]] == [(0, 500)]


def test_another_shape_is_told_and_not_refused(bounders, capsys):
    path = bounders["dir"] / "page.html"
    status, out, err = run(capsys, "show", bounders["out"], bounders["other"], "--html", path, *QUICK)
    assert status == 0
    assert err.startswith("other.npy is not the shape that the bounder was fitted to")
    assert "false negatives" in out
    assert "Another shape" in path.read_text(encoding="utf-8")


def test_a_file_that_is_no_page_is_kept(bounders, capsys, monkeypatch):
    """What fails leaves the earlier file; what succeeds replaces it whole."""
    import warp_bounding.views.draw

    path = bounders["dir"] / "page.html"
    path.write_text("earlier")
    monkeypatch.setattr(warp_bounding.views.draw, "page", _broken)
    check_bad(*run(capsys, "show", bounders["out"], bounders["c"], "--html", path, *QUICK))
    assert path.read_text() == "earlier"
    monkeypatch.undo()
    assert run(capsys, "show", bounders["out"], bounders["c"], "--html", path, *QUICK)[0] == 0
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert [each.name for each in bounders["dir"].glob(".page*")] == []


def _broken(*_):
    raise BoundingError("no page today")


def test_a_motion_is_shown_at_times_and_more_dimensions_in_a_slice(files, capsys):
    np.save(files / "moving.npy", shape("animated").occupancy)
    path, _ = fit(capsys, files, name="moving", source="moving.npy")
    page = files / "page.html"
    status, out, err = run(capsys, "show", path, files / "moving.npy", "--html", page, *QUICK)
    assert (status, err) == (0, "")
    assert out.count("false positives") == 6
    np.save(files / "five.npy", np.random.default_rng(0).random((3, 4, 3, 4, 3)) < 0.4)
    path, _ = fit(capsys, files, name="five", source="five.npy")
    status, out, err = run(capsys, "show", path, files / "five.npy", "--html", page, *QUICK)
    check_bad(status, out, err)
    assert "--slice" in err
    held = run(capsys, "show", path, files / "five.npy", "--html", page, "--slice", "0=0.5,2=0.25", *QUICK)
    assert (held[0], held[2]) == (0, "")
    assert "coordinate 0 at 0.5, coordinate 2 at 0.25" in page.read_text(encoding="utf-8")
