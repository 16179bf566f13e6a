"""Distances on the command line: ``fit --query distance``, ``info``, ``certify``, ``evaluate --radius``, ``soak``."""

import json

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, run


@pytest.fixture
def files(tmp_path):
    np.save(tmp_path / "blob.npy", shape("blob").occupancy)
    return tmp_path


@pytest.mark.parametrize(("method", "own"), [("sphere", ()), ("distance-grid", ("--nodes", 6, "--storage", "uint8"))])
def test_from_fit_to_soak(method, own, files, capsys):
    path, source = files / "d.safetensors", files / "blob.npy"
    told = ("fit", source, "--query", "distance", "--method", method, *own, "--samples", 20_000, "-o", path, "--json")
    status, out, _ = run(capsys, *told)
    assert status == 0
    fitted = json.loads(out)
    assert (fitted["method"], fitted["query"], fitted["fn"], fitted["certificate"]["kind"]) == (
        method,
        "distance",
        0,
        "proven",
    )
    status, out, _ = run(capsys, "info", path)
    assert status == 0
    assert "3D distance queries" in out
    assert "never above" in out
    status, out, _ = run(capsys, "info", path, "--json")
    assert json.loads(out)["query"] == "distance"
    status, out, _ = run(capsys, "certify", path, source, "--query", "distance")
    assert status == 0
    assert out.startswith("proven: ")
    status, out, _ = run(capsys, "evaluate", path, source, "--radius", 0.1, "--samples", 20_000, "--json")
    rates = json.loads(out)
    assert (status, rates["fn"], rates["radius"]) == (0, 0, 0.1)
    status, out, _ = run(capsys, "evaluate", path, source, "--radius", 0.1, "--samples", 20_000)
    assert "within radius 0.1" in out
    status, out, _ = run(capsys, "soak", path, source, "--count", "1e6", "--seed", 3)
    assert status == 0
    assert "none missed" in out


def test_a_proof_goes_on_where_its_time_was_over(files, capsys):
    path, source, left = files / "d.safetensors", files / "blob.npy", files / "left"
    told = ("fit", source, "--query", "distance", "--method", "distance-grid", "--nodes", 6, "--refine", 2, "-o", path)
    assert run(capsys, *told, "--samples", 1000)[0] == 0
    status, out, _ = run(capsys, "certify", path, source, "--budget", 1e-9, "--checkpoint", left)
    assert status == 1
    assert f"goes on from {left}" in out.replace("\n", "")
    assert left.exists()
    status, out, _ = run(capsys, "certify", path, source, "--checkpoint", left)
    assert (status, left.exists()) == (0, False)
    check_bad(*run(capsys, "certify", path, source, "--checkpoint", path))


def test_mistakes(files, capsys):
    path, source = files / "d.safetensors", files / "blob.npy"
    told = ("fit", source, "--query", "distance", "-o", path, "--samples", 1000)
    for wrong in (
        ("--method", "voxels"),
        ("--method", "sphere", "--length", 2),
        ("--method", "sphere", "--hidden", "8"),
        ("--method", "sphere", "--side", "inside"),
        ("--method", "sphere", "--metric", "time"),
    ):
        check_bad(*run(capsys, *told, *wrong))
    assert run(capsys, *told, "--method", "aabb")[0] == 0
    check_bad(*run(capsys, "evaluate", path, source, "--radius", -1))
    check_bad(*run(capsys, "evaluate", path, source, "--radius", "nan"))
    check_bad(*run(capsys, "certify", path, source, "--query", "distances"))
    points = files / "p.safetensors"
    assert run(capsys, "fit", source, "--method", "aabb", "-o", points, "--samples", 1000)[0] == 0
    check_bad(*run(capsys, "evaluate", points, source, "--radius", 1))


def test_a_slack_that_is_larger_than_the_object(files, capsys, monkeypatch):
    """It is told, with the best that was reached, and saved; exit status 1."""
    from warp_bounding.proof.distances import excesses

    monkeypatch.setattr(excesses, "COARSEST", 9.0)  # one search, and no time for a finer one
    monkeypatch.setattr(excesses, "SAFE", 0.0)
    path = files / "d.safetensors"
    told = ("fit", files / "blob.npy", "--query", "distance", "--method", "mlp", "--hidden", "8,8", "--steps", 20)
    status, out, err = run(capsys, *told, "--budget", 2, "--samples", 1000, "-o", path)
    assert status == 1
    assert path.is_file()
    assert "is larger than the object" in err + out
    status, out, _ = run(capsys, *told, "--budget", 2, "--samples", 1000, "-o", path, "--json")
    assert status == 1
    assert "larger than the object" in json.loads(out)["warning"]
