"""``figures``: resumed after any end, never mixed, with clear words for what is wrong."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import check_bad, run

from paper.drawing.base import Figure, objects_named
from warp_bounding.errors import BoundingError

TESTS = Path(__file__).parents[1]


class Line(Figure):
    """Two numbers, kept in a file how often they are computed."""

    name, title, paper, caption = "line", "A line", "the one", "Nothing to see."
    objects = objects_named("2d/star1=2d/star")
    log: list = []  # noqa: RUF012
    fails = ""

    def parts(self, work):
        def compute(name):
            if name == self.fails:
                raise BoundingError("it is not possible")
            self.log.append(name)
            return {"value": len(name), "seed": work.settings.seed}

        return {name: lambda name=name: compute(name) for name in ("first", "second")}

    def draw(self, parts, tools):
        tools.draw_solids([])
        return {"png": b"picture", "svg": json.dumps(parts["second"]["value"]).encode()}

    def facts(self, parts):
        return [f"It is {parts['first']['value']}."]


class Data(Line):
    """Needs the paper's data."""

    name = "data"
    objects = objects_named("2d/lucy")


@pytest.fixture
def figures(monkeypatch):
    """Puts two small figures in place of the paper's; returns what the first has computed."""
    line = Line()
    line.log, line.fails = [], ""
    monkeypatch.setattr("paper.figures.FIGURES", (line, Data()))
    monkeypatch.setattr("paper.commands.figures._draw_solids", lambda scenes: [])
    return line


def check_refused(capsys, *arguments, says):
    status, out, err = run(capsys, "figures", *arguments)
    check_bad(status, out, err)
    for text in says:
        assert text in err


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_a_run_and_the_same_again(capsys, tmp_path, figures):
    status, out, err = run(capsys, "figures", "all", "--out", tmp_path / "out", "--json")
    assert status == 0, err
    told = json.loads(out)
    assert told["done"] == ["line"]
    assert "data shows the paper's objects (2d/lucy)" in told["skipped"][0]
    assert "skipped: data" in err
    assert "line 2/2: second" in err
    names = {"line.json", "line.png", "line.svg", "README.md", "settings.json", ".lock"}
    before = contents(tmp_path / "out")
    assert set(before) == names
    document = json.loads(before["line.json"])
    assert document["settings"]["library"]
    assert document["objects"]["2d/star1"]
    assert document["parts"]["second"]["value"] == 6
    page = before["README.md"].decode()
    assert "![A line](line.png)" in page
    assert "It is 5." in page
    assert "python -m paper figures all --out out" in page
    assert run(capsys, "figures", "line", "--out", tmp_path / "out")[0] == 0
    assert figures.log == ["first", "second"]
    after = contents(tmp_path / "out")
    assert after["line.json"] == before["line.json"]


def test_a_figure_that_fails_keeps_its_parts(capsys, tmp_path, figures):
    figures.fails = "second"
    status, out, _ = run(capsys, "figures", "line", "--out", tmp_path / "out", "--json")
    assert status == 1
    assert json.loads(out)["failed"] == ["line: it is not possible"]
    assert not (tmp_path / "out" / "line.png").exists()
    figures.fails = ""
    assert run(capsys, "figures", "line", "--out", tmp_path / "out")[0] == 0
    assert figures.log == ["first", "second"]


def test_no_display_is_one_line(capsys, tmp_path, figures, monkeypatch):
    def nothing(scenes):
        raise BoundingError("this machine has no OpenGL for off-screen drawing (libEGL or libOSMesa)")

    monkeypatch.setattr("paper.commands.figures._draw_solids", nothing)
    status, _, err = run(capsys, "figures", "line", "--out", tmp_path / "out")
    assert status == 1
    assert "failed: line: this machine has no OpenGL" in err
    assert "Traceback" not in err
    assert figures.log == ["first", "second"]


def test_bad_input_is_told_and_nothing_is_written(capsys, tmp_path, figures):
    out = tmp_path / "out"
    check_refused(capsys, "nobody", "--out", out, says=["line, data, or all", "nobody"])
    check_refused(capsys, "data", "--out", out, says=["2d/lucy", "--data DIR is needed"])
    check_refused(capsys, "all", "--out", out, "--data", tmp_path / "none", says=["no such folder"])
    (tmp_path / "data").mkdir()
    check_refused(capsys, "data", "--out", out, "--data", tmp_path / "data", says=["2d/lucy", "not in"])
    check_refused(capsys, "line", "--out", out, "--effort", "0", says=["effort must be positive"])
    check_refused(capsys, "line", "--out", out, "--samples", "0", says=["samples must be at least 1"])
    check_refused(capsys, "line", "--out", out, "--seed", "-1", says=["seed"])
    assert not out.exists()
    out.mkdir()
    (out / "line.png").write_bytes(b"mine")
    check_refused(capsys, "line", "--out", out, says=["line.png", "choose another folder"])
    assert contents(out) == {"line.png": b"mine"}


def test_a_folder_of_something_else_is_left_alone(capsys, tmp_path, figures):
    out = tmp_path / "out"
    assert run(capsys, "figures", "line", "--out", out)[0] == 0
    before = contents(out)
    check_refused(capsys, "line", "--out", out, "--quick", says=["quick False there, True now"])
    check_refused(capsys, "line", "--out", out, "--seed", "3", says=["seed 0 there, 3 now"])
    settings = json.loads(before["settings.json"])
    settings["settings"]["library"] = "0.0.0"
    for name, content, says in (
        ("settings.json", json.dumps(settings), "library 0.0.0 there"),
        ("settings.json", "{}", "damaged"),
        ("line.json", "{", "damaged"),
        ("line.json", json.dumps({**json.loads(before["line.json"]), "format": 2}), "format 2"),
        ("line.json", json.dumps({**json.loads(before["line.json"]), "settings": {}}), "other settings"),
        ("line.json", json.dumps({**json.loads(before["line.json"]), "parts": {"first": 1}}), "damaged"),
    ):
        (out / name).write_text(content)
        check_refused(capsys, "line", "--out", out, says=[says])
        assert contents(out) == {**before, name: content.encode()}
        (out / name).write_bytes(before[name])
    changed = json.loads(before["line.json"])
    changed["objects"]["2d/star1"] = "0" * 16
    (out / "line.json").write_text(json.dumps(changed))
    status, _, err = run(capsys, "figures", "line", "--out", out)
    assert status == 1
    assert "2d/star1: not what" in err


KILLED = """
import sys, time
from test_figures import Line
import paper.figures as home
from paper.__main__ import run
from paper.commands import figures

class Slow(Line):
    def parts(self, work):
        def second():
            if len(sys.argv) > 2:
                open(sys.argv[2], "w").close()
                time.sleep(60)
            return {"value": 2}
        return {"first": lambda: {"value": time.time()}, "second": second}

home.FIGURES = (Slow(),)
figures._draw_solids = lambda scenes: []
run(["figures", "line", "--out", sys.argv[1]])
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_killed_run_goes_on(tmp_path, number):
    out, begun = tmp_path / "out", tmp_path / "begun"
    paths = [str(TESTS.parent), str(TESTS / "shared"), str(TESTS / "cli")]
    own = {**os.environ, "PYTHONPATH": os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")])}
    first = subprocess.Popen(
        [sys.executable, "-c", KILLED, out, begun],
        env=own,
        stderr=subprocess.PIPE,
        text=True,
        # a shell's background jobs begin without one
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while not begun.exists() and first.poll() is None:
        time.sleep(0.05)
    check = subprocess.run([sys.executable, "-c", KILLED, out], env=own, capture_output=True, text=True, check=False)
    assert check.returncode == 2
    assert "another figures is at work there" in check.stderr
    first.send_signal(number)
    _, err = first.communicate()
    assert first.returncode == (-signal.SIGKILL if number == signal.SIGKILL else 1), err
    before = json.loads((out / "line.json").read_text())["parts"]
    assert list(before) == ["first"]
    done = subprocess.run([sys.executable, "-c", KILLED, out], env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    after = json.loads((out / "line.json").read_text())["parts"]
    assert after["first"] == before["first"]
    assert {"line.png", "README.md"} <= set(contents(out))


def test_a_small_run(capsys, tmp_path):
    status, _, err = run(
        capsys, "figures", "kdop", "--quick", "--effort", "0.1", "--out", tmp_path, "--samples", 20_000
    )
    assert status == 0, err
    parts = json.loads((tmp_path / "kdop.json").read_text())["parts"]
    learned = {name: part for name, part in parts.items() if name.endswith(" learned-kdop")}
    assert len(learned) == 3
    for name, part in learned.items():
        fixed = parts[name.replace("learned-kdop", "kdop")]
        assert (part["fn"], part["certificate"], fixed["fn"], fixed["certificate"]) == (0, "proven", 0, "proven")
        assert part["fp"] <= fixed["fp"] + 0.5
    assert (tmp_path / "kdop.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "kdop.svg").read_bytes()


@pytest.mark.slow
def test_all_of_them(capsys, tmp_path):
    status, out, err = run(capsys, "figures", "all", "--quick", "--effort", "0.1", "--out", tmp_path, "--json")
    assert status == 0, err
    from paper.figures import FIGURES

    assert json.loads(out)["done"] == [figure.name for figure in FIGURES if figure.name != "objects"]
    page = (tmp_path / "README.md").read_text()
    assert page.count("![") == len(FIGURES) - 1
