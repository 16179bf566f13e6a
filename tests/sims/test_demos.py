"""Every demo in its small form, with the bounders that come with it: as a user runs it."""

import math
from functools import cache
from importlib import import_module

import pytest

import warp_bounding as wb
from sims import DEMOS
from sims.arm.demo import robot_places
from sims.prefitted import FOLDER, bounder_from, stored
from sims.refit import plan
from sims.report import Run, kept, verdict

KEYS = {"bounder", "narrow_calls", "missed", "identical", "fp_rate", "fp_rate_cells", "certificate"}
KEYS |= {"ms_broad", "ms_narrow", "ms_step"}
PROVEN = {"pile", "shadows"}  # every run of these demos
SLOW = set(DEMOS) - {"shadows"}  # up to a minute each; their parts have tests of their own


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in DEMOS])
def test_the_small_form_keeps_its_promise(name, tmp_path, capsys):
    pytest.importorskip("newton" if name == "cloth" else "scipy")
    answer = import_module(f"sims.{name}").run(tmp_path, quick=True)
    assert answer["demo"] == name
    assert answer["identical"]
    assert {"shape", "steps", "runs", "pictures"} <= answer.keys()
    assert all(run.keys() >= KEYS for run in answer["runs"])
    of_cells = [run for run in answer["runs"] if run["fp_rate_cells"] is not None]
    # there the grid, or the decoder, is the shape itself
    assert bool(of_cells) == (name not in ("path", "digits", "pile"))
    for run in answer["runs"]:
        if run["bounder"] != "occupancy":
            assert run["missed"] == 0
            assert run["identical"]
    lost = [run for run in answer["runs"] if run["bounder"] == "occupancy"]
    assert bool(lost) == (name not in PROVEN)
    assert all(run["missed"] > 0 and not run["identical"] for run in lost)
    text = capsys.readouterr().out
    assert "missed none" in text
    assert ("occupancy" in text) == (name not in PROVEN)
    assert ("UR5" in text or "No robot is shown" in text) == (name == "arm")


@cache
def planned() -> list:
    """What the scenes need; making their shapes takes seconds."""
    return plan([])


def test_all_files_fit_the_scenes_that_they_are_for():
    pytest.importorskip("newton")
    files = planned()
    assert len(files) == len({(scene, name) for scene, name, *_ in files})
    for scene, name, spec, shape in files:
        bounder = bounder_from(stored(scene, name), shape, spec, device="cpu")
        assert (bounder.certificate is None) == (name == "occupancy")
        assert stored(scene, name).stat().st_size < 100_000


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(path.stem for path in FOLDER.glob("*.safetensors")))
def test_what_is_proven_is_proven_anew(file):
    pytest.importorskip("newton")
    known = {f"{scene}-{name}": (spec, shape) for scene, name, spec, shape in planned()}
    if file not in known and (lacking := robot_places()[1]):
        pytest.skip(lacking)
    spec, shape = known[file]
    bounder = bounder_from(FOLDER / f"{file}.safetensors", shape, spec, device="cpu")
    if bounder.certificate is not None and bounder.certificate.proven:
        assert wb.certify(bounder, shape, budget=math.inf).proven  # however fast the machine is


NONE = Run("none", 100, 0.0, 2.0, 3.0, 0, True)


def of(name, certificate, missed=0, identical=True, section="", cells=None):
    return Run(name, 40, 0.5, 1.0, 2.0, missed, identical, 5.0, cells, certificate, section)


def test_what_is_proven_must_be_kept():
    good = [NONE, of("mlp", "proven"), of("occupancy", "", missed=7, identical=False)]
    assert kept(good)
    assert "Broken promise" not in verdict(good)
    for broken in (
        of("mlp", "proven", missed=1),
        of("mlp", "proven", identical=False),
        of("box", "by construction", 1),
    ):
        assert not kept([*good, broken])
        assert "Broken promise" in verdict([*good, broken])
