"""``python -m sims``: options, exit status, JSON, and what is said where a package is missing."""

import json
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
from commands import run

import sims.particles
import warp_bounding as wb


def test_options_reach_the_demo(monkeypatch, capsys, tmp_path):
    demo = Mock(return_value={"identical": True})
    monkeypatch.setattr(sims.particles, "run", demo)
    words = ("demo", "particles", "--output", tmp_path)
    assert run(capsys, *words, "--quick", "--steps", 7, "--bounder", "f.st") == (0, "", "")
    assert demo.call_args.args == (tmp_path,)
    expected = {"quick": True, "refit": False, "steps": 7, "bounder_file": "f.st", "budget": None}
    assert expected.items() <= demo.call_args.kwargs.items()
    demo.return_value["identical"] = False  # a broken promise
    assert run(capsys, *words)[0] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dancing"], "demo must be one of particles, cloth, path, shadows, digits, arm, pile, got dancing"),
        (["cloth", "--assets", "folder"], "--assets writes meshes and runs no demo, got 'cloth' too"),
        (["particles", "--world", "maze.png"], "demo particles has no option --world"),
    ],
)
def test_options_that_a_demo_does_not_have(capsys, arguments, message):
    status, out, err = run(capsys, "demo", *arguments)
    assert status == 2
    assert out == ""
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_without_newton_one_line_names_the_extra(capsys, monkeypatch):
    for name in [
        n for n in sys.modules if n.split(".")[0] == "newton" or n.startswith(("sims.cloth", "warp_bounding.newton"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "newton", None)
    status, out, err = run(capsys, "demo", "cloth")
    assert (status, out) == (2, "")
    assert "the demo needs newton: pip install 'warp-bounding[sims]'" in err
    assert len(err.strip().splitlines()) == 1


def test_assets_are_the_meshes_of_installed_packages(capsys, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    pytest.importorskip("trimesh", reason="trimesh is not installed")
    from sims.assets import asset_mesh

    status, out, err = run(capsys, "demo", "--assets", tmp_path / "new", "--json")
    assert (status, err) == (0, "")
    files = json.loads(out)["files"]
    assert [Path(file).name for file in files] == ["bunny.obj", "bear.obj", "rocks.obj"]
    for file in files:
        read, there = wb.load_shape(file), asset_mesh(Path(file).stem)
        assert (read.vertices == there.vertices).all()
        assert (read.faces == there.faces).all()
