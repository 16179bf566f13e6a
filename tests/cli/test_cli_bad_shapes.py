"""A shape's file that is refused: one line, status 2, and whatever was there before is there still."""

import numpy as np
import pytest
from commands import run
from mesh_cases import MESH_CASES

import warp_bounding as wb

COMMANDS = {
    "fit": ("fit", "{shape}", "--method", "aabb", "-o", "{bounder}"),
    "certify": ("certify", "{bounder}", "{shape}"),
    "evaluate": ("evaluate", "{bounder}", "{shape}"),
    "show": ("show", "{bounder}", "{shape}", "--html", "{out}"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("key", ["stl/no-end", "gltf/required-extension", "ply/missing-bytes"])
def test_a_refused_shape(tmp_path, capsys, command, key):
    shape, bounder, out = MESH_CASES[key].write(tmp_path), tmp_path / "b.safetensors", tmp_path / "out.html"
    wb.fit(np.eye(4, dtype=bool), method="aabb", device="cpu").save(bounder)
    out.write_text("as it was")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    places = {"{shape}": shape, "{bounder}": bounder, "{out}": out}
    status, told, error = run(capsys, *(places.get(word, word) for word in COMMANDS[command]))
    assert (status, told, error.count("\n")) == (2, "", 1)
    assert shape.name in error
    assert MESH_CASES[key].words in error
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
