"""The folder of a run: whole rows, repaired ends, refused mixtures."""

import dataclasses
import json

import numpy as np
import pytest
from fake_library import make_row, table_rows

from paper.columns import COLUMNS, VARIANTS
from paper.folder import open_folder
from paper.rows import Row
from warp_bounding.errors import BoundingError

HEADER = Row.header()
ROW = make_row(COLUMNS[1], VARIANTS[0])
OTHER = make_row(COLUMNS[1], VARIANTS[0], name='a,"b"', leaves=None, fit_seconds=None)


@pytest.fixture
def folder(tmp_path):
    with open_folder(tmp_path / "out", {}, create=True) as opened:
        opened.append(ROW)
        opened.append(OTHER)
    return tmp_path / "out"


def contents(path):
    return {p.name: p.read_bytes() for p in path.iterdir() if p.is_file()}


def rows(path, **given):
    with open_folder(path, given, create=False) as opened:
        return list(opened.rows.values()), opened.notes


def test_rows_come_back_whole():
    for row in (ROW, OTHER, *table_rows(np.random.default_rng(0), objects=1)):
        assert Row.parse(row.line.rstrip("\n")) == row


def test_rows_come_back(folder):
    assert rows(folder) == ([ROW, OTHER], [])
    assert (folder / "table1.csv").read_text().startswith("dimension,object,query,method,space,leaves,protocol,fp_rate")


@pytest.mark.parametrize("kept", [1, 20, -1])
def test_a_torn_line_is_dropped(folder, kept):
    table = folder / "table1.csv"
    line = OTHER.line
    table.write_text(HEADER + ROW.line + line[:kept])
    found, notes = rows(folder)
    assert found == [ROW]
    assert len(notes) == 1
    assert "torn" in notes[0]
    assert table.read_text() == HEADER + ROW.line
    assert rows(folder) == ([ROW], [])


@pytest.mark.parametrize("kept", [0, 1, 30, len(HEADER) - 1])
def test_a_torn_header_is_written_again(folder, kept):
    (folder / "table1.csv").write_text(HEADER[:kept])
    assert rows(folder)[0] == []
    assert (folder / "table1.csv").read_text() == HEADER


def damaged(**changes):
    return HEADER + ROW.line + dataclasses.replace(OTHER, **changes).line + OTHER.line


DAMAGES = {
    "foreign header": "a,b,c\n1,2,3\n",
    "other header": HEADER.replace("fp_rate", "fp") + ROW.line,
    "no table": "hello",
    "no fields": HEADER + "2,bunny\n" + ROW.line,
    "empty line": HEADER + "\n" + ROW.line,
    "open quote": HEADER + ROW.line.replace("bunny", '"bunny') + ROW.line,
    "dimension": damaged(dimension=5),
    "query": damaged(query="cone"),
    "method": damaged(method="magic"),
    "leaves": damaged(leaves=12),
    "space": damaged(space="outer"),
    "protocol": damaged(protocol="guess"),
    "rate": damaged(fp_rate="many"),
    "rate over 100": damaged(fp_rate=100.5),
    "nan": damaged(positives=float("nan")),
    "count": damaged(fn=-1),
    "budget": damaged(budget=30.0),
    "samples": damaged(samples=3),
    "hidden": damaged(hidden="8"),
    "twice": HEADER + ROW.line * 2,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_told_and_left_alone(folder, damage):
    (folder / "table1.csv").write_text(DAMAGES[damage])
    before = contents(folder)
    with pytest.raises(BoundingError, match=r"table1\.csv: (line \d is damaged|not a table)"):
        rows(folder)
    assert contents(folder) == before


def test_bytes_are_no_table(folder):
    (folder / "table1.csv").write_bytes(HEADER.encode() + b"\xff\xfe\n")
    with pytest.raises(BoundingError, match="damaged, not text"):
        rows(folder)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("budget", 30.0, "budget 60.0 there, 30.0 now"),
        ("samples", 10, "samples 1000000 there, 10 now"),
        ("seed", 1, "seed 0 there, 1 now"),
        ("length", 2.0, "length 1.0 there, 2.0 now"),
        ("device", "cuda:0", "device cpu there, cuda:0 now"),
    ],
)
def test_settings_are_never_mixed(folder, name, value, told):
    before = contents(folder)
    with pytest.raises(BoundingError, match="made with other settings") as error:
        rows(folder, **{name: value})
    assert told in str(error.value)
    assert contents(folder) == before


def test_settings_of_the_folder_are_the_defaults(tmp_path):
    with open_folder(tmp_path / "out", {"budget": 5.0, "seed": 3}, create=True) as opened:
        opened.append(make_row(COLUMNS[1], VARIANTS[0], budget=5.0, seed=3))
    with open_folder(tmp_path / "out", {"seed": 3}, create=True) as opened:
        assert (opened.settings.budget, opened.settings.seed, opened.settings.sample_seed) == (5.0, 3, 4)


def test_settings_of_an_empty_table_bind_nobody(tmp_path):
    with open_folder(tmp_path / "out", {"budget": 5.0}, create=True):
        pass
    with open_folder(tmp_path / "out", {"budget": 6.0}, create=True) as opened:
        assert opened.settings.budget == 6.0
    (tmp_path / "out/bounders").mkdir()
    (tmp_path / "out/bounders/2d-ray.a.mlp.safetensors").write_text("")
    with pytest.raises(BoundingError, match=r"budget 6\.0 there"):
        rows(tmp_path / "out", budget=7.0)


@pytest.mark.parametrize(
    "given", [{"budget": 0.0}, {"budget": float("nan")}, {"samples": 0}, {"seed": -1}, {"length": float("inf")}]
)
def test_settings_that_make_no_sense(tmp_path, given):
    with pytest.raises(BoundingError, match="must be"), open_folder(tmp_path / "out", given, create=True):
        pass
    assert not (tmp_path / "out").exists()


def changed(**changes):
    def change(document):
        document["settings"].update(changes)
        return json.dumps(document)

    return change


SETTINGS = {
    "another version": (changed(library="0.0.1"), "library 0.0.1 there"),
    "other sizes": (changed(hidden={}), "hidden"),
    "of a newer version": (changed(colour="red"), "not those that this version"),
    "of another type": (changed(budget="long"), "the setting budget is damaged"),
    "a newer format": (lambda d: json.dumps(d | {"format": 2}), "format 2"),
    "cut": (lambda d: json.dumps(d)[:40], "damaged or not the settings"),
    "a list": (lambda d: "[]", "damaged or not the settings"),
    "commands": (lambda d: json.dumps(d | {"commands": [1]}), "commands"),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_foreign_and_damaged_settings(folder, case):
    change, told = SETTINGS[case]
    (folder / "settings.json").write_text(change(json.loads((folder / "settings.json").read_text())))
    before = contents(folder)
    with pytest.raises(BoundingError, match=told):
        rows(folder)
    assert contents(folder) == before


@pytest.mark.parametrize("name", ["table1.csv", "README.md", "rank.png"])
def test_somebody_elses_folder(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(BoundingError, match="choose another folder"), open_folder(tmp_path, {}, create=True):
        pass
    assert contents(tmp_path) == {name: b"mine"}


def test_no_folder(tmp_path):
    with pytest.raises(BoundingError, match="--data DIR is needed"), open_folder(tmp_path / "x", {}, create=False):
        pass
    assert not (tmp_path / "x").exists()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(BoundingError, match="file"), open_folder(path, {}, create=True):
            pass


def test_one_run_at_a_time(folder):
    pytest.importorskip("fcntl")
    busy = pytest.raises(BoundingError, match="another table1 is at work")
    with open_folder(folder, {}, create=True), busy, open_folder(folder, {}, create=True):
        pass
    assert rows(folder)[0] == [ROW, OTHER]


def test_what_a_killed_run_began_is_swept(folder):
    (folder / "bounders").mkdir()
    litter = [folder / ".README.md.abc", folder / "bounders/.2d-ray.a.mlp.safetensors.xyz"]
    for path in litter:
        path.write_text("half")
    rows(folder)
    assert not any(path.exists() for path in litter)
