"""The command line in this process, and what a mistake of a user's must look like."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from bounding_shapes import HIDDEN

import paper.__main__
import sims.__main__
from warp_bounding.cli import main

ROOT = Path(__file__).parents[2]
WIDTHS = ",".join(map(str, HIDDEN))  # of a small network
PAPER = ("table1", "recipes", "speed", "proofs", "figures")


def run(capsys, *arguments):
    """Status, standard output and standard error of a command in this process; ``demo`` is that of ``sims``."""
    name, *rest = words = [str(a) for a in arguments]
    capsys.readouterr()
    if name == "demo":
        program, words = sims.__main__.run, rest
    else:
        program = paper.__main__.run if name in PAPER else main
    with pytest.raises(SystemExit) as stop:
        program(words)
    out, err = capsys.readouterr()
    return stop.value.code, out, err


def check_bad(status, out, err):
    assert status == 2, err
    assert out == ""
    assert len(err.strip().splitlines()) == 1, err
    assert err.startswith(("warp-bounding: ", "paper: ", "sims: "))
    assert "Traceback" not in err


def command(*arguments, stdout=subprocess.PIPE, **variables):
    """A command in a process of its own, with these variables of the environment."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"} | variables
    line = [sys.executable, "-m", "warp_bounding", *map(str, arguments)]
    return subprocess.run(line, stdout=stdout, stderr=subprocess.PIPE, text=True, env=environment, check=False)


def fit(capsys, files, *options, name="b", source="c.npy", method="aabb"):
    """The path of the bounder that ``fit`` writes, and what ``run`` returns of it."""
    path = files / f"{name}.safetensors"
    return path, run(capsys, "fit", files / source, "-o", path, "--method", method, "--samples", 20_000, *options)
