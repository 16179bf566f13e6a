"""No file of the repository names a folder of the machine that it was made on."""

import base64
import json
import re
import struct
import subprocess
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import warp_bounding as wb

ROOT = Path(__file__).parents[1]
# Put together from parts, so that this file does not hold what it looks for.
TOPS = ("home", "root", "Users", "tmp", "work", "workspace", "var", "mnt", "media", "opt", "srv", "builds", "private")
FOLDERS = [
    rf"(?<![\w.~-])/(?:{'|'.join(TOPS)})/",
    r"\b[A-Za-z]:[\\/]+(?:Users|Documents|Temp)\b",
    r"(?:site|dist)-packages/",
]
FOLDER = re.compile("|".join(FOLDERS))
PNG = b"\x89PNG\r\n\x1a\n"


def of_png(content: bytes) -> Iterator[str]:
    """Everything in a PNG file that is not the picture."""
    assert content.startswith(PNG)
    at = len(PNG)
    while at < len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        data = content[at + 8 : at + 8 + length]
        at += 12 + length
        if kind == b"zTXt":
            key, _, rest = data.partition(b"\0")
            data = key + b" " + zlib.decompress(rest[1:])
        elif kind == b"iTXt":
            key, _, rest = data.partition(b"\0")
            text = rest[2:].split(b"\0", 2)[2]
            data = key + b" " + (zlib.decompress(text) if rest[0] else text)
        if kind not in (b"IDAT", b"PLTE"):
            yield data.decode("latin-1")


def of_safetensors(content: bytes) -> Iterator[str]:
    """The description in front of the tensors."""
    (length,) = struct.unpack_from("<Q", content)
    yield content[8 : 8 + length].decode()


def of_notebook(content: bytes) -> Iterator[str]:
    """Every text, outputs too; of pictures what is beside the picture."""

    def walk(value, key="") -> Iterator[str]:
        if isinstance(value, dict):
            for name, inner in value.items():
                yield name
                yield from walk(inner, name)
        elif isinstance(value, list):
            for inner in value:
                yield from walk(inner, key)
        elif key == "image/png":
            yield from of_png(base64.b64decode(value))
        elif isinstance(value, str):
            yield value

    yield from walk(json.loads(content))


READERS = {".png": of_png, ".safetensors": of_safetensors, ".ipynb": of_notebook}


def folders(name: str, content: bytes) -> list[str]:
    """Folders of a machine that a file names, with a little of what is around them."""
    texts = READERS.get(Path(name).suffix, lambda c: [c.decode()])(content)
    return [text[max(found.start() - 30, 0) : found.end() + 50] for text in texts for found in FOLDER.finditer(text)]


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


PLACES = [f"/{top}/me/bunny.obj" for top in TOPS]
PLACES += ["C:" + "\\Users\\me\\bunny.obj", "C:" + "\\\\Users\\\\me", "d:" + "/Temp/bunny.obj", "file://" + PLACES[0]]


@pytest.mark.parametrize("place", PLACES)
def test_a_folder_is_found_wherever_it_stands(place, tmp_path):
    image = pytest.importorskip("PIL.Image")
    info = pytest.importorskip("PIL.PngImagePlugin")
    assert folders("a.md", f"made of {place}".encode())
    grid = wb.IndicatorGrid(np.eye(4, dtype=bool), name=place)
    wb.fit(grid, method="aabb", device="cpu").save(tmp_path / "b.safetensors")
    assert folders("b.safetensors", (tmp_path / "b.safetensors").read_bytes())
    for add in ({"zip": False}, {"zip": True}):
        texts = info.PngInfo()
        texts.add_text("Source", place, **add)
        texts.add_itxt("Title", "nothing", **add)
        image.new("L", (2, 2)).save(tmp_path / "p.png", pnginfo=texts)
        picture = (tmp_path / "p.png").read_bytes()
        assert folders("p.png", picture)
        outputs = [{"data": {"image/png": base64.b64encode(picture).decode()}}]
        assert folders("n.ipynb", json.dumps({"cells": [{"outputs": outputs}]}).encode())
    international = info.PngInfo()
    international.add_itxt("Source", place, zip=True)
    image.new("L", (2, 2)).save(tmp_path / "i.png", pnginfo=international)
    assert folders("i.png", (tmp_path / "i.png").read_bytes())


@pytest.mark.parametrize("text", ["out/tmp/a", "~/work/a", "./home/a", "https://example.org/home/a", "and/or", "a: /x"])
def test_other_paths_are_none(text):
    assert not folders("a.md", text.encode())
