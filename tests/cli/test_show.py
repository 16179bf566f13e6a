"""``warp-bounding show``: pictures and pages from the command line, and one clear line for what is wrong."""

import json
import sys
import webbrowser

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, run

import warp_bounding as wb

pytest.importorskip("pyvista")
pytest.importorskip("plotly")
QUICK = ("--resolution", "12")
PAGE = "--html {dir}/p.html"
BAD = [
    "{out} {c} --html {dir}/p.txt",
    "{out} {c} --html {dir}/folder.html",
    f"{{far}} {{blob}} {PAGE} --radius wide",
    f"{{out}} {{c}} {PAGE} --slice x=0",
    f"{{far}} {{blob}} {PAGE} --slice 7=0.5",
]


@pytest.fixture(scope="module")
def bounders(tmp_path_factory):
    """Paths of bounders by name, beside the shapes that they bound."""
    folder = tmp_path_factory.mktemp("show")
    (folder / "folder.html").mkdir()
    names = {"dir": folder, **{name: folder / f"{name}.npy" for name in ("c", "blob", "other", "five")}}
    cells = {"c": shape("c").occupancy, "blob": shape("blob").occupancy, "other": ~shape("c").occupancy}
    cells |= {"five": np.random.default_rng(0).random((3, 4, 3, 4, 3)) < 0.4}
    for name, occupancy in cells.items():
        np.save(names[name], occupancy)
    for name, source, query in (
        ("out", "c", "point"),
        ("far", "blob", "distance"),
        ("of five", "five", "point"),
    ):
        names[name] = folder / f"{name.replace(' ', '-')}.safetensors"
        wb.fit(wb.load_shape(names[source]), query, "aabb", device="cpu").save(names[name])
    return names


@pytest.mark.parametrize("bad", BAD)
def test_bad_usage(bounders, capsys, bad):
    before = sorted(path.name for path in bounders["dir"].iterdir())
    check_bad(*run(capsys, "show", *bad.format(**bounders).split()))
    assert sorted(path.name for path in bounders["dir"].iterdir()) == before


def test_what_is_missing_is_named(bounders, capsys, monkeypatch, tmp_path):
    words = ("show", bounders["out"], bounders["c"])
    for package in ("pyvista", "plotly"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            err = run(capsys, *words, "--html", tmp_path / "p.html")[2]
        assert err == f"warp-bounding: show needs {package}: pip install 'warp-bounding[show]'\n"
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or len(opened) == 1)
    for told in ("", "there is no browser here"):
        status, out, err = run(capsys, *words, *QUICK)
        assert status == 0
        assert told in err
        assert opened[-1].endswith("/out.html")
        assert opened[-1].removeprefix("file://") in out


def test_pages_and_what_is_printed(bounders, capsys, tmp_path):
    page = tmp_path / "new" / "page.html"
    words = ("--html", page, *QUICK)
    status, out, err = run(capsys, "show", bounders["far"], bounders["blob"], *words, "--radius", "0,0.1")
    assert (status, err) == (0, "")
    assert out.splitlines()[-1] == f"written to {page}"
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    found = json.loads(run(capsys, "show", bounders["out"], bounders["c"], *words, "--json")[1])
    assert (found["html"], found["same_indicator"], found["certificate"]["proven"]) == (str(page), True, True)
    status, out, err = run(capsys, "show", bounders["out"], bounders["other"], *words)
    assert status == 0
    assert err.startswith("other.npy is not the shape that the bounder was fitted to")
    status, out, err = run(capsys, "show", bounders["of five"], bounders["five"], *words)
    check_bad(status, out, err)
    assert "--slice" in err
    held = run(capsys, "show", bounders["of five"], bounders["five"], "--slice", "0=0.5,2=0.25", *words)
    assert (held[0], held[2]) == (0, "")
