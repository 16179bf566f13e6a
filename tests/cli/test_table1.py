"""``table1``: resumed after any end, never mixed, with clear words for what is wrong."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from commands import check_bad, run
from fake_library import Library, data_folder

from paper.__main__ import run as main

TESTS = Path(__file__).parents[1]

QUICK = ("--columns", "2d-point,3d-ray", "--methods", "aabb,bvh-16,mlp,relu-field")
CELLS = 3 * 4 + 2 * 4  # points: one row a method; rays: two of a box, no field in 3D


@pytest.fixture
def place(tmp_path):
    data_folder(tmp_path / "data")
    return tmp_path


@pytest.fixture
def library(place, monkeypatch):
    """Puts a fake library in place; call it to change its manners."""

    def put(**manners):
        fake = Library(place / "log", **manners)
        fake.install(monkeypatch)
        plots = {"png": b"picture", "svg": b"<svg/>"}  # tests of the plot itself are elsewhere
        monkeypatch.setattr("paper.pages.markdown.rank_plot", lambda rows: plots if list(rows) else {})
        return fake

    return put


def table1(capsys, place, *arguments, data=True):
    """Status, standard output, standard error."""
    return run(capsys, "table1", "--out", place / "out", *(("--data", place / "data") if data else ()), *arguments)


def rows(place):
    with (place / "out/table1.csv").open() as file:
        return list(csv.DictReader(file))


def contents(place):
    return {p: p.read_bytes() for p in (place / "out").rglob("*") if p.is_file()}


def test_a_run_and_the_same_again(place, library, capsys):
    fake = library()
    status, out, err = table1(capsys, place, *QUICK, "--json")
    assert status == 0, err
    result = json.loads(out)
    assert (result["path"], result["cells"], result["done"], result["failed"]) == (
        str(place / "out"),
        CELLS,
        CELLS,
        [],
    )
    assert result["columns"]["2d-point"]["exact"]["mlp"]["paper"] == 3.2
    assert len(rows(place)) == CELLS
    assert "2d-point aa: aabb (exact)" in err
    assert "left" in err
    assert {"README.md", "rank.png", "rank.svg", "settings.json", "table1.csv"} <= {p.name for p in contents(place)}
    calls, before = fake.calls, contents(place)
    status, out, _ = table1(capsys, place, *QUICK)
    assert status == 0
    assert f"{result['cells']} of {result['cells']} cells" in out
    assert fake.calls == calls
    assert contents(place) == before
    (place / "out/README.md").unlink()
    assert table1(capsys, place, data=False)[0] == 0
    assert contents(place) == before


def test_more_is_added_later_without_fitting_anew(place, library, capsys):
    fake = library()
    quick = ("--columns", "2d-point", "--methods", "mlp", "--objects", "aa")
    assert table1(capsys, place, *quick)[0] == 0
    assert fake.calls == ["fit aa point mlp geometric None", "evaluate aa point mlp exact"]
    assert table1(capsys, place, *quick, "--protocol", "both")[0] == 0
    assert fake.calls[2:] == ["evaluate aa point mlp sampled"]
    seconds = [r["fit_seconds"] for r in rows(place)]
    assert seconds[0] == seconds[1]
    assert table1(capsys, place, "--columns", "2d-ray", "--methods", "mlp,aabb", "--objects", "2d/bb")[0] == 0
    assert len(rows(place)) == 5
    page = (place / "out/README.md").read_text()
    assert page.count("python -m paper table1 --data") == 3 + 1  # the first one by itself, too
    assert "sampled protocol" in page


def test_a_bounder_that_is_damaged_is_fitted_again(place, library, capsys):
    fake = library()
    quick = ("--columns", "2d-point", "--methods", "mlp", "--objects", "aa")
    assert table1(capsys, place, *quick)[0] == 0
    (file,) = (place / "out/bounders").iterdir()
    file.write_text("{")
    status, _, err = table1(capsys, place, *quick, "--protocol", "sampled")
    assert status == 0
    assert "damaged; fitted again" in err
    assert [c.split()[0] for c in fake.calls] == ["fit", "evaluate", "fit", "evaluate"]


def test_what_fails_is_told_and_tried_again(place, library, capsys):
    library(failing=("relu-field",))
    status, out, err = table1(capsys, place, *QUICK, "--json")
    result = json.loads(out)
    assert status == 1
    assert len(result["failed"]) == 3
    assert result["failed"][0] == "2d-point aa: relu-field (exact): relu-field cannot be fitted"
    assert result["done"] == result["cells"] - 3 == len(rows(place))
    assert "failed: 2d-point aa: relu-field" in err
    assert "**Failed**" in (place / "out/README.md").read_text()
    library()
    assert table1(capsys, place, *QUICK)[0] == 0
    assert "Failed" not in (place / "out/README.md").read_text()


def test_what_fails_unexpectedly_does_not_end_the_run(place, library, capsys):
    library(failing=("mlp",))
    quick = ("--columns", "2d-ray,2d-box", "--methods", "mlp,aabb", "--objects", "aa", "--json")
    status, out, err = table1(capsys, place, *quick)
    assert status == 1
    assert "Traceback" not in err
    failed = json.loads(out)["failed"]
    assert len(failed) == 2
    assert failed[0].startswith("2d-ray aa: mlp (exact): IndexError: out of bounds (fake_library.py, line ")
    assert {r["method"] for r in rows(place)} == {"aabb"}


def test_a_broken_promise_is_told(place, library, capsys):
    library(missing=("aabb",))
    status, _, err = table1(capsys, place, "--columns", "2d-point", "--methods", "aabb,occupancy", "--objects", "aa")
    assert status == 1
    assert "promise broken: 2d-point aa: aabb (exact): 7 false negatives" in err
    assert "occupancy" not in err.partition("promise broken")[2]


def test_an_interrupted_fit_is_no_result(place, library, capsys, request):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin without one
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    library(interrupted="mlp")
    status, _, err = table1(capsys, place, *QUICK)
    assert status == 1
    assert "the same command goes on from there" in err
    assert "Traceback" not in err
    assert "mlp" not in {r["method"] for r in rows(place)}
    assert not list((place / "out/bounders").glob("*mlp*"))
    assert (place / "out/README.md").exists()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    library()
    assert table1(capsys, place, *QUICK)[0] == 0


PROGRAM = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from fake_library import Library
from pytest import MonkeyPatch
from paper.__main__ import run as main
Library(Path({log!r}), endless=6).install(MonkeyPatch())
MonkeyPatch().setattr("paper.pages.markdown.rank_plot", lambda rows: {{}})
main(sys.argv[1:])
"""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_killed_half_way_and_resumed(place, library, capsys, end):
    program = PROGRAM.format(tests=str(TESTS / "shared"), log=str(place / "log"))
    arguments = ["table1", "--out", place / "out", "--data", place / "data", *QUICK]
    process = subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(TESTS.parent)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    table = place / "out/table1.csv"
    while not (table.exists() and table.read_bytes().count(b"\n") > 4):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    process.send_signal(end)
    _, err = process.communicate()
    assert "Traceback" not in err
    if end == signal.SIGINT:
        assert process.returncode == 1
        assert "the same command goes on from there" in err
    first = rows(place)
    with table.open("a") as file:
        file.write("2,aa,point,ml")  # what a power cut may leave
    fake = library()
    before = len(fake.calls)
    status, _, err = table1(capsys, place, *QUICK)
    assert status == 0, err
    assert "torn" in err
    final = rows(place)
    assert final[: len(first)] == first
    keys = [
        tuple(r[k] for k in ("dimension", "object", "query", "method", "space", "leaves", "protocol")) for r in final
    ]
    assert len(set(keys)) == len(keys) == len(final)
    fits = [c for c in fake.calls[before:] if c.startswith("fit")]
    assert len(fits) <= len(final) - len(first)


def test_a_plan_writes_nothing(place, library, capsys):
    fake = library()
    status, out, err = table1(capsys, place, *QUICK, "--budget", "10,3d=20", "--plan", "--json")
    assert status == 0, err
    result = json.loads(out)
    assert (result["budget"], result["cells"], result["missing"]) == ("10,3d=20", CELLS, CELLS)
    assert result["columns"]["3d-ray"]["learned_fits"] == [{"seconds": 20.0, "fits": 2}]
    assert result["seconds"] > 6 * 10 + 2 * 20
    assert not (place / "out").exists()
    assert table1(capsys, place, *QUICK, "--budget", "10,3d=20")[0] == 0
    assert {(r["dimension"], r["budget"]) for r in rows(place)} == {("2", "10.0"), ("3", "20.0")}
    calls, before = fake.calls, contents(place)
    status, out, _ = table1(capsys, place, *QUICK, "--plan")
    assert status == 0
    assert f"0 learned fits, 0 of {CELLS} cells" in out
    assert fake.calls == calls
    assert contents(place) == before
    check_bad(*table1(capsys, place, *QUICK, "--budget", "10,3d=21"))
    check_bad(*table1(capsys, place, *QUICK, "--budget", "10"))


def test_presets(place, library, capsys):
    library()
    quick = ("--columns", "2d-point", "--methods", "mlp", "--objects", "aa")
    assert table1(capsys, place, *quick, "--preset", "hour", "--samples", "123")[0] == 0
    assert [(r["protocol"], r["samples"], r["budget"]) for r in rows(place)] == [
        ("exact", "123", "4.0"),
        ("sampled", "123", "4.0"),
    ]
    page = (place / "out/README.md").read_text()
    assert "--preset hour --samples 123" in page
    assert "4 s for each learned fit; where others are named, the last that fits: 3d 6 s, " in page
    check_bad(*table1(capsys, place, *quick, "--preset", "day"))


BAD = {
    "column": ("--columns", "5d-point"),
    "method": ("--methods", "magic"),
    "object": ("--objects", "2d/zz"),
    "protocol": ("--protocol", "guess"),
    "budget": ("--budget", "0"),
    "budgets": ("--budget", "60,5d=3"),
    "preset": ("--preset", "day"),
    "plan": ("--plan", "--columns", "5d-point"),
    "samples": ("--samples", "many"),
    "seed": ("--seed", "-1"),
    "device": ("--device", "cuda:99"),
    "nothing": ("--columns", "3d-ray", "--methods", "relu-field"),
    "data": ("--data", "nowhere"),
    "settings": ("--budget", "61"),
}


@pytest.mark.parametrize(("bad", "fresh"), [(b, f) for b in BAD for f in (True, False) if not (f and b == "settings")])
def test_bad_input(place, library, capsys, bad, fresh):
    library()
    if not fresh:
        assert table1(capsys, place, "--columns", "2d-point", "--methods", "aabb")[0] == 0
    before = contents(place)
    check_bad(*table1(capsys, place, *BAD[bad]))
    assert contents(place) == before
    assert (place / "out").exists() != fresh


def test_bad_data(place, library, capsys):
    library()
    assert table1(capsys, place, "--columns", "2d-point", "--methods", "aabb")[0] == 0
    before = contents(place)
    (place / "data/2D/aa.png").write_text("changed")
    check_bad(*table1(capsys, place, "--columns", "2d-point", "--methods", "aabb,mlp"))
    (place / "data/4D/aa.npy").unlink()
    check_bad(*table1(capsys, place))
    check_bad(*table1(capsys, place, "--methods", "mlp", data=False))
    assert contents(place) == before
    check_bad(*table1(capsys, place / "data", data=False))


def test_real_shapes_from_end_to_end(tmp_path, capsys):
    image = pytest.importorskip("PIL.Image")
    inside = np.add.outer(np.linspace(-1, 1, 12) ** 2, np.linspace(-1, 1, 12) ** 2) < 0.6
    for name, part in (("disc", inside), ("half", inside & (np.arange(12) < 6))):
        pixels = np.zeros((12, 12, 4), np.uint8)
        pixels[..., 3] = 255 * part
        path = tmp_path / f"data/2D/{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        image.fromarray(pixels).save(path)
    quick = ("--columns", "2d-point", "--methods", "aabb,mlp,voxels", "--samples", "20000")
    status, out, err = table1(capsys, tmp_path, *quick, "--budget", "0.5", "--json")
    assert status == 0, err
    assert (tmp_path / "out/rank.png").stat().st_size > 10_000
    means = json.loads(out)["columns"]["2d-point"]["exact"]
    assert set(means) == {"aabb", "mlp", "voxels"}
    assert all(m["fn"] == 0 and m["objects"] == 2 and m["proven"] for m in means.values())
    assert len(rows(tmp_path)) == 6
    before = [p.stat().st_mtime_ns for p in sorted((tmp_path / "out/bounders").iterdir())]
    status, out, err = table1(capsys, tmp_path, *quick, "--protocol", "both", "--json")
    assert status == 0, err
    assert len(rows(tmp_path)) == 12
    assert [p.stat().st_mtime_ns for p in sorted((tmp_path / "out/bounders").iterdir())] == before
    both = json.loads(out)["columns"]["2d-point"]
    assert both["exact"]["mlp"] == both["sampled"]["mlp"] == means["mlp"]


def test_help_tells_the_time_that_the_plan_tells(capsys, monkeypatch):
    from paper.plan import duration, preset_seconds
    from paper.settings import PRESETS

    monkeypatch.setenv("COLUMNS", "250")
    with pytest.raises(SystemExit):
        main(["table1", "--help"])
    out, _ = capsys.readouterr()
    for name, preset in PRESETS.items():
        assert f"{name} ({duration(preset_seconds(preset))})" in out


def test_one_distance_serves_all_its_columns(tmp_path, capsys):
    """A real run: one fit an object, asked points, rays and boxes; planes it cannot be asked."""
    image, place = pytest.importorskip("PIL.Image"), tmp_path
    (tmp_path / "data/2D").mkdir(parents=True)
    pixels = np.zeros((20, 20, 4), dtype=np.uint8)
    pixels[5:14, 4:11] = 255
    image.fromarray(pixels).save(tmp_path / "data/2D/aa.png")
    told = ("--columns", "2d", "--methods", "distance", "--objects", "aa", "--budget", 1, "--samples", 2000)
    status, out, err = table1(capsys, place, *told, "--protocol", "both", "--json")
    assert status == 0, err
    found = rows(place)
    assert sorted({row["query"] for row in found}) == ["box", "point", "ray"]
    assert len(found) == 6
    assert all(row["fn"] == "0" and row["certificate"] == "proven" for row in found)
    assert [path.name for path in (place / "out/bounders").iterdir()] == ["2d.aa.distance.safetensors"]
    assert json.loads(out)["columns"]["2d-ray"]["exact"]["distance"]["proven"]
    assert "one network of the distance an object" in (place / "out/README.md").read_text()
    status, out, err = table1(capsys, place, *told, "--protocol", "both", "--json")
    assert json.loads(out)["done"] == 6
