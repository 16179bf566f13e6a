"""The README, *Get started* and the guide run as they are printed: every snippet and every command, in order, in one
folder and one namespace.

What would take minutes is shortened: a mesh of few triangles stands in for the bunny, fits are small by ``SHORTER``
(words of the text that are replaced) and commands by ``SMALL`` (options that are added). Commands that set up an
environment or run a whole demo (tests of their own run small ones) are not run but read, by what would run them:
the Makefile, the parser of the command line. Commands on files of a reader's own are marked ``bash``, and left out; the
tests of exports compile what is C.
"""

import importlib.metadata
import re
import shlex
import sys
import types
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import typer
from reading_order import PAGES, ROOT
from snippets import FENCED, commands

import sims.__main__
from warp_bounding import cli

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
for name in ("torch", "matplotlib", "PIL"):
    pytest.importorskip(name, reason=f"{name} is not installed: pip install '.[train]'")

SMALL_FIT = "hidden=(8,), budget=3.0, steps=20"  # whose kernels other tests need as well
SHORTER = {  # in turns
    "hidden=(50, 50), budget=60.0": SMALL_FIT,
    "hidden=(24, 24), budget=20.0": SMALL_FIT,
    "hidden=(16, 16), budget=10.0": SMALL_FIT,
    '"distance-grid", nodes=24': '"distance-grid", nodes=8',
    "make_proven(loose, colliding, budget=60.0)": "make_proven(loose, colliding, budget=59.0)",
    "budget=60.0": SMALL_FIT,
    "budget=8.0": "budget=1.0",
    "--hidden 50,50 --budget 60 ": "--hidden 8 --budget 30 --steps 20 --samples 20000 ",
    "--samples 1e7 ": "--samples 20000 ",
    "--stress 1e8 ": "--stress 1e5 ",
    "random((1_000_000, 3)": "random((20_000, 3)",
    "uniform(-1.0, 1.0, (1_000_000, 3)": "uniform(-1.0, 1.0, (20_000, 3)",
    '"distance-grid")': '"distance-grid", nodes=8)',
    '"distance-grid", nodes=12)': '"distance-grid", nodes=8)',
    "evaluate(bounder, shape)": "evaluate(bounder, shape, samples=20_000)",
    'method="kdop", levels=2': 'method="kdop", levels=1',
    'fit(each, method="kdop")': 'fit(each, method="aabb")',
}
OPTIONAL = (("import", "newton"), ("from", "ompl"))  # a snippet with one that is not installed is left out
SMALL = {"choose": "--methods aabb"}  # takes no longer than it needs, whatever the budget


def shortened(text: str) -> str:
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    return text


def read(words: list[str]) -> None:
    """Let what would run a command read it; ``DIR``, ``FILE`` and the like stand for anything."""
    program, *arguments = words
    if arguments[:2] == ["-m", "sims"]:
        typer.main.get_command(sims.__main__._app()).make_context("sims", arguments[2:])
    elif program == "make":
        text = (ROOT / "Makefile").read_text()
        assert all("=" in word or f"\n{word}:" in text for word in arguments)
    elif program == "." or arguments[:2] == ["-m", "venv"]:
        assert arguments[-1].startswith(".venv")
    elif arguments[0] == "-m":  # an example, with Newton's own options
        assert (ROOT / f"{arguments[1].replace('.', '/')}.py").is_file()
    else:
        extras = {name for names in re.findall(r"\[(.*?)\]", " ".join(arguments)) for name in names.split(",")}
        assert (program, arguments[0]) == ("pip", "install")
        assert extras <= set(importlib.metadata.metadata("warp-bounding").get_all("Provides-Extra"))


def run_command(words: list[str]) -> None:
    """Run a command in the present folder; it must end well."""
    if words[0] == "warp-bounding":
        main, (name, *options) = cli.main, words[1:]
    elif words[:3] == ["python", "-m", "sims"] and words[3] not in sims.DEMOS:
        main, (name, *options) = sims.__main__.run, words[3:]
    else:
        return read(words)
    with pytest.raises(SystemExit) as stop:
        main([name, *options, *SMALL.get(name, "").split()])
    assert stop.value.code == 0, shlex.join(words)
    if "--assets" in words:
        trimesh.creation.icosphere(3).apply_scale([0.6, 0.5, 0.7]).export("bunny.obj")
    return None


def run(text: str, folder: Path) -> None:
    """Run every fenced block of a text in order, in one namespace."""
    module = sys.modules["readme"] = types.ModuleType("readme")
    try:
        for number, (language, body) in enumerate(FENCED.findall(shortened(text))):
            if language == "sh":
                for words in commands(body):
                    run_command(words)
                continue
            if language in ("bash", "c"):
                continue
            assert language == "python", language
            if any(f"{word} {name}" in body and find_spec(name) is None for word, name in OPTIONAL):
                continue
            file = folder / f"snippet{number}.py"
            file.write_text(body)
            exec(compile(body, str(file), "exec"), module.__dict__)
    finally:
        del sys.modules["readme"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder to stand in: empty, but for a reader's own points."""
    monkeypatch.chdir(tmp_path)
    np.save("points.npy", np.random.default_rng(0).random((2000, 3), dtype=np.float32))
    return tmp_path


@pytest.mark.parametrize("count", [2, pytest.param(len(PAGES), marks=pytest.mark.slow)])
def test_everything_shown_runs(count, place):
    """README and *Get started*, or all pages: each goes on where the one before ends."""
    run("\n".join(page.read_text() for page in PAGES[:count]), place)
