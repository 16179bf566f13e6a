"""``python -m sims``: options, exit status, JSON, and what is said where a package is missing."""

import json
import sys
from pathlib import Path

import pytest
from commands import run

import sims.particles
import warp_bounding as wb


@pytest.fixture
def asked(monkeypatch):
    """The options that the demo is called with, instead of the demo; ``identical`` is what it answers."""
    options = {"identical": True}

    def stand_in(
        out, *, quick, refit, budget, seed, device, console, bounder_file=None, particles=None, steps=None
    ) -> dict:
        console.print("a table")
        answer = {"demo": "particles", "identical": options["identical"], "runs": [], "pictures": []}
        options.update(out=out, quick=quick, refit=refit, budget=budget, steps=steps, bounder_file=bounder_file)
        return answer

    monkeypatch.setattr(sims.particles, "run", stand_in)
    return options


def test_options_reach_the_demo(asked, capsys, tmp_path):
    status, out, err = run(
        capsys, "demo", "particles", "--output", tmp_path, "--quick", "--steps", 7, "--bounder", "f.st"
    )
    assert (status, out.strip(), err) == (0, "a table", "")
    assert asked["out"] == tmp_path
    assert asked["quick"]
    assert not asked["refit"]
    assert (asked["steps"], asked["bounder_file"], asked["budget"]) == (7, "f.st", None)
    asked["identical"] = False  # a broken promise
    assert run(capsys, "demo", "particles", "--output", tmp_path)[0] == 1


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
