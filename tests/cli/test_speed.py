"""``speed``: races on generated shapes, resumed after any end, with clear words for what is wrong."""

import csv
import json

import pytest
from commands import check_bad, run

pytest.importorskip("torch", reason="torch is not installed")

from paper.speed import run as speed_run

SMALL = ("--columns", "2d-point", "--methods", "aabb,sphere,mlp", "--budget", "0.5", "--queries", "5000")
SMALL += ("--rounds", "3", "--samples", "5000", "--devices", "cpu")


def speed(capsys, place, *arguments):
    return run(capsys, "speed", "--out", place / "out", *arguments)


def rows(place):
    with (place / "out/speed.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("speed")


def test_a_small_run_and_the_same_again(place, capsys, monkeypatch):
    status, out, err = speed(capsys, place, *SMALL)
    assert status == 0, err
    found = rows(place)
    assert [row["method"] for row in found] == ["aabb", "sphere", "mlp"]
    assert all(row["reference"] == "mlp" and row["fn"] == "0" and float(row["ns"]) > 0 for row in found)
    mlp = found[-1]
    assert [mlp[name] for name in ("ratio", "ratio_low", "ratio_high")] == ["1.0"] * 3
    assert "3 of 3 cells" in out
    page = (place / "out/README.md").read_text()
    assert "python -m paper speed --out out --columns 2d-point" in page
    monkeypatch.setattr(speed_run, "race", lambda *_: pytest.fail("raced again"))
    status, out, _ = speed(capsys, place, *SMALL, "--json")
    assert status == 0
    told = json.loads(out)
    assert (told["cells"], told["done"]) == (3, 3)
    assert told["devices"]["cpu"]["columns"]["2d-point"]["aabb"]["fp_rate"] > 0


def test_what_is_added_is_raced_with_the_reference(place, capsys, monkeypatch):
    if not (place / "out/speed.csv").exists():
        speed(capsys, place, *SMALL)
    before, raced, race = rows(place), [], speed_run.race
    monkeypatch.setattr(
        speed_run, "race", lambda bounders, *rest: raced.append(list(bounders)) or race(bounders, *rest)
    )
    arguments = [word.replace("aabb,sphere,mlp", "kdop,aabb") for word in SMALL]
    status, _, err = speed(capsys, place, *arguments)
    assert status == 0, err
    assert raced == [["2d-point.generated.kdop", "2d-point.generated.mlp"]]
    assert rows(place)[: len(before)] == before
    assert rows(place)[-1]["method"] == "kdop"


def test_an_interrupted_run_goes_on(tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(speed_run, "race", interrupted)
        status, _, err = speed(capsys, tmp_path, *SMALL)
    assert status == 1
    assert "0 of 3 cells are done; the same command goes on from there" in err
    assert rows(tmp_path) == []
    fitted = {p.name: p.read_bytes() for p in (tmp_path / "out/bounders").iterdir()}
    assert len(fitted) == 3
    status, *_ = speed(capsys, tmp_path, *SMALL)
    assert status == 0
    assert len(rows(tmp_path)) == 3
    assert {p.name: p.read_bytes() for p in (tmp_path / "out/bounders").iterdir()} == fitted


def test_a_race_that_fails_is_reported(tmp_path, capsys, monkeypatch):
    def full(*_):
        raise MemoryError("no room")

    monkeypatch.setattr(speed_run, "race", full)
    status, _, err = speed(capsys, tmp_path, *SMALL)
    assert status == 1
    assert "failed: 2D" in err or "failed: 2d-point generated: aabb: MemoryError: no room" in err
    assert "**Failed**" in (tmp_path / "out/README.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--columns", "5d"), "columns must be among"),
        (("--methods", "magic"), "methods must be among"),
        (("--objects", "bunny"), "objects must be among 2d/generated"),
        (("--devices", "cuda:7"), "devices must be among cpu"),
        (("--budget", "-1"), "budget must be positive seconds"),
        (("--queries", "many"), "queries must be a whole number"),
        (("--rounds", "0"), "rounds must be at least 1"),
        (("--data", "nowhere"), "nowhere: no such folder"),
    ],
)
def test_bad_input_in_one_line(tmp_path, capsys, arguments, words):
    small = [word for word in SMALL if word]
    at = small.index(arguments[0]) if arguments[0] in small else None
    rest = small if at is None else [*small[:at], *small[at + 2 :]]
    status, out, err = speed(capsys, tmp_path, *rest, *arguments)
    check_bad(status, out, err)
    assert words in err
    assert not (tmp_path / "out").exists()


def test_other_settings_are_refused_and_nothing_is_changed(place, capsys):
    if not (place / "out/speed.csv").exists():
        speed(capsys, place, *SMALL)
    before = {p.name: p.read_bytes() for p in (place / "out").iterdir() if p.is_file() and p.name != ".lock"}
    arguments = [word.replace("5000", "6000") for word in SMALL]
    status, out, err = speed(capsys, place, *arguments)
    check_bad(status, out, err)
    assert "queries 5000 there, 6000 now" in err
    assert before == {p.name: p.read_bytes() for p in (place / "out").iterdir() if p.is_file() and p.name != ".lock"}


def test_a_strange_folder_is_left_alone(tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/README.md").write_text("mine")
    status, out, err = speed(capsys, tmp_path, *SMALL)
    check_bad(status, out, err)
    assert (tmp_path / "out/README.md").read_text() == "mine"
