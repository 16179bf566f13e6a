"""What the command line says of a shape: how an array is meant, what of a mesh is bounded, and what its rates are of."""

import json

import numpy as np
import pytest
import trimesh
from commands import run
from PIL import Image

import warp_bounding as wb

MAP = np.full((12, 20), 254, dtype=np.uint8)  # white is free
MAP[3:6, 4:9] = 10


@pytest.fixture
def picture(tmp_path):
    Image.fromarray(MAP).save(tmp_path / "map.png")
    return tmp_path / "map.png"


@pytest.fixture
def hole(tmp_path):
    box = trimesh.creation.box()
    trimesh.Trimesh(box.vertices, box.faces[1:], process=False).export(tmp_path / "hole.ply")
    return tmp_path / "hole.ply"


def test_a_map_in_metres_from_fit_to_soak(capsys, picture, tmp_path):
    file, shape = tmp_path / "map.safetensors", ["--threshold", "<128", "--spacing", "0.05", "--origin", "-0.5,2"]
    status, out, _ = run(capsys, "fit", picture, "--method", "aabb", *shape, "-o", file, "--samples", 1000, "--json")
    assert status == 0
    assert json.loads(out)["certificate"]["proven"]
    bounder = wb.load(file, device="cpu")
    wall = np.array([[-0.5 + 4 * 0.05, 2 + 6 * 0.05], [-0.5 + 9 * 0.05, 2 + 6 * 0.05]], dtype=np.float32)
    assert bounder.query(wall).numpy().tolist() == [1, 0]
    for command in (["certify"], ["evaluate", "--samples", 1000], ["soak", "--count", 1000]):
        status, out, err = run(capsys, command[0], file, picture, *command[1:], *shape, "--json")
        assert (status, err) == (0, ""), command
        assert json.loads(out).get("same_indicator", True)
    assert run(capsys, "certify", file, picture, "--threshold", "<128")[0] == 1  # other cells


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "threshold='<128'"),
        (["--threshold", "dark"], "threshold must be"),
        (["--threshold", "128", "--spacing", "a"], "spacing must be numbers such as 0.05"),
        (["--threshold", "128", "--origin", "1"], "origin must be 2 numbers"),
        (["--threshold", "128", "--spacing", "0"], "spacing must be positive"),
    ],
)
def test_one_line_where_a_picture_is_not_clear(capsys, picture, tmp_path, options, words):
    status, out, err = run(capsys, "fit", picture, "--method", "aabb", *options, "-o", tmp_path / "o.safetensors")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert not (tmp_path / "o.safetensors").exists()


@pytest.mark.parametrize("cells", [[], ["--resolution", 8]], ids=["itself", "cells"])
def test_an_open_mesh_is_told_as_surface_only(capsys, hole, tmp_path, cells):
    options = ["fit", hole, "--method", "aabb", *cells, "--samples", 1000, "-o", tmp_path / "o.safetensors"]
    told = f"warp-bounding: {hole.name}: surface only: the mesh is open"
    status, out, err = run(capsys, *options)
    assert status == 0
    assert "surface only" in out  # the certificate's message
    assert err.startswith(told)
    assert err.count("surface only") == 1
    status, out, err = run(capsys, *options, "--json")
    answer = json.loads(out)
    assert answer["note"].startswith("surface only")
    assert "surface only" in answer["certificate"]["message"]
    status, out, err = run(capsys, "certify", tmp_path / "o.safetensors", hole)
    assert "surface only" in out
    assert err.startswith(told)
    assert "surface only" in run(capsys, "info", tmp_path / "o.safetensors")[1]


def test_yellow_in_a_terminal(capsys, monkeypatch, hole, tmp_path):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    file = tmp_path / "o.safetensors"
    err = run(capsys, "fit", hole, "--method", "aabb", "--resolution", 8, "--samples", 1000, "-o", file)[2]
    assert "\x1b[33mwarp-bounding: hole.ply: surface only" in err


def test_rates_of_a_mesh_are_its_own_and_those_of_its_cells_are_told(capsys, tmp_path):
    trimesh.creation.box().export(tmp_path / "box.ply")
    file = tmp_path / "o.safetensors"
    options = [
        "fit",
        tmp_path / "box.ply",
        "--method",
        "voxels",
        "--resolution",
        8,
        "--margin",
        0.01,
        "--samples",
        1000,
    ]
    status, out, err = run(capsys, *options, "-o", file)
    assert status == 0
    assert "of the shape itself; 0.00 % against the cells that are bounded" in out
    assert err.count("\n") == 2
    assert "looser than a box" in err
    assert err.startswith(
        "warp-bounding: margin 0.01 is under the size of a cell, 0.128: the object's cells at resolution 8 are"
    )
    status, out, err = run(capsys, "evaluate", file, tmp_path / "box.ply", "--samples", 1000)
    assert "of the shape itself; 0.00 % against the cells that are bounded" in out
    out = run(capsys, "evaluate", file, tmp_path / "box.ply", "--samples", 1000, "--json")[1]
    told = json.loads(out)
    assert told["truth"] == "of the shape itself"
    assert told["fp_rate_cells"] == 0 < told["fp_rate"]


def test_a_margin_larger_than_the_shape_is_forced(capsys, tmp_path):
    trimesh.creation.box().export(tmp_path / "box.ply")
    file = tmp_path / "o.safetensors"
    options = [
        "fit",
        tmp_path / "box.ply",
        "--method",
        "aabb",
        "--resolution",
        8,
        "--samples",
        1000,
        "--margin",
        2,
        "-o",
        file,
    ]
    status, out, err = run(capsys, *options)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "margin must be at most the object's extent, 1, got 2; force=True (--force)" in err
    assert not file.exists()
    assert run(capsys, *options, "--force")[0] == 0
    assert run(capsys, "certify", file, tmp_path / "box.ply")[0] == 0
