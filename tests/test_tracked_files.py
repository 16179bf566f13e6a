"""No file of the repository names a folder of the machine that it was made on."""

import base64
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from named_folders import TOPS, folders

import warp_bounding as wb

ROOT = Path(__file__).parents[1]


def tracked() -> list[str]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode != 0:
        pytest.skip("this is no checkout: there is no list of its files")
    return [name for name in listed.stdout.decode().split("\0") if name and (ROOT / name).is_file()]


def test_no_tracked_file_names_a_folder_of_a_machine():
    names = tracked()
    assert len(names) > 100
    found = {name: where for name in names if (where := folders(name, (ROOT / name).read_bytes()))}
    assert not found


def test_a_folder_is_found_in_texts_notebooks_bounders_and_pictures(tmp_path):
    image, info = pytest.importorskip("PIL.Image"), pytest.importorskip("PIL.PngImagePlugin")
    place = f"/{TOPS[0]}/me/bunny.obj"
    assert folders("a.md", f"made of {place}".encode())
    assert folders("a.md", ("C:" + "\\Users\\me\\bunny.obj").encode())
    grid = wb.IndicatorGrid(np.eye(4, dtype=bool), name=place)
    wb.fit(grid, method="aabb", device="cpu").save(tmp_path / "b.safetensors")
    assert folders("b.safetensors", (tmp_path / "b.safetensors").read_bytes())
    texts = info.PngInfo()
    texts.add_text("Source", place, zip=True)
    image.new("L", (2, 2)).save(tmp_path / "p.png", pnginfo=texts)
    picture = (tmp_path / "p.png").read_bytes()
    assert folders("p.png", picture)
    outputs = [{"data": {"image/png": base64.b64encode(picture).decode()}}]
    assert folders("n.ipynb", json.dumps({"cells": [{"outputs": outputs}]}).encode())
