"""Results on disk: rows come back, torn ends are dropped, settings are never mixed, nothing foreign or damaged is
overwritten."""

import signal
import threading
from pathlib import Path

import pytest

from paper import proofs, recipes, results, speed, table1
from warp_bounding.errors import BoundingError

ROOT = Path(__file__).parents[2]
MODULES = (recipes, table1, proofs, speed)
COLUMNS = ("object", "samples", "fp_rate", "certificate", "fit_seconds")
DEFAULTS = {"samples": 100, "budget": 60.0, "seed": 0}
ROW = {"object": 'a,"b"', "samples": 100, "fp_rate": 12.5, "certificate": "", "fit_seconds": None}
HEADER = ",".join(COLUMNS) + "\n"
LINE = '"a,""b""",100,12.5,,\n'


def opened(path, **given):
    return results.opened(path, "t", COLUMNS, DEFAULTS, given, owned=("picture.png",))


@pytest.fixture
def place(tmp_path):
    with opened(tmp_path / "out") as folder:
        folder.append(ROW)
    return tmp_path / "out"


def contents(path):
    return {p.name: p.read_bytes() for p in path.iterdir() if p.is_file()}


def check_refused(path, says, **given):
    before = contents(path)
    with pytest.raises(BoundingError, match=says), opened(path, **given):
        pass
    assert contents(path) == before


def test_rows_come_back(place):
    assert (place / "t.csv").read_text() == HEADER + LINE
    with opened(place) as folder:
        assert folder.rows == [ROW]
        folder.append(ROW | {"object": "c"})
    with opened(place) as folder:
        assert [row["object"] for row in folder.rows] == ['a,"b"', "c"]


@pytest.mark.parametrize("kept", [1, 10, len(LINE) - 1])
def test_a_torn_line_is_dropped(place, kept):
    (place / "t.csv").write_text(HEADER + LINE + LINE[:kept])
    with opened(place) as folder:
        assert folder.rows == [ROW]
    assert (place / "t.csv").read_text() == HEADER + LINE


@pytest.mark.parametrize(
    "table",
    [
        *("a,b,c\n1,2,3\n", "hello", HEADER + "a,1\n" + LINE, HEADER + "\n" + LINE, HEADER + 'a,100,"1,,\n' + LINE),
        *(HEADER + line for line in ("a,x,1,,\n", "a,100,many,,\n", "a,100,nan,,\n", "a,100,101,,\n", "a,99,1,,\n")),
    ],
)
def test_damage_is_told_and_left_alone(place, table):
    (place / "t.csv").write_text(table)
    check_refused(place, r"t\.csv: (line \d is damaged|not a table)")


@pytest.mark.parametrize(("name", "value"), [("budget", 30.0), ("samples", 10), ("seed", 1)])
def test_settings_are_never_mixed(place, name, value):
    check_refused(place, f"made with other settings: {name} .* there, {value} now", **{name: value})


@pytest.mark.parametrize("text", ["[]", "{", '{"format": 2, "settings": {}, "commands": []}'])
def test_damaged_settings(place, text):
    (place / "settings.json").write_text(text)
    check_refused(place, "damaged|format 2")


@pytest.mark.parametrize("name", ["t.csv", "README.md", "picture.png"])
def test_somebody_elses_folder(tmp_path, name):
    (tmp_path / name).write_text("mine")
    check_refused(tmp_path, "choose another folder")
    (tmp_path / name).unlink()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(BoundingError, match="cannot be written"), opened(path):
            pass


def test_failures_are_told_and_an_interruption_is_no_result(place, capsys, request):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin without one
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    done = []

    def measure(cell):
        if cell == "bad":
            raise IndexError("out of bounds")
        if cell == "stop":
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:  # as a fit does, which returns what it has
                results.heed()
        done.append(cell)
        return "well"

    with opened(place) as folder:
        assert not results.work(folder, ["good", "bad", "stop", "late"], measure, str.upper)
        assert (done, len(folder.failed)) == (["good"], 1)
    err = capsys.readouterr().err
    assert "failed: BAD: IndexError: out of bounds" in err
    assert "interrupted: 2 of 4" in err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    thread = threading.Thread(target=lambda: results.work(folder, ["good"], measure, str))
    thread.start()
    thread.join()
    assert done == ["good", "good"]


@pytest.mark.parametrize("place", ["table1", "table1/recipes", "proofs", "speed", "speed/cuda"])
def test_what_is_committed_is_read(place):
    name, module = next((m.__name__.rpartition(".")[2], m) for m in MODULES if m.__name__.rpartition(".")[2] in place)
    settings, commands = results.read_settings(ROOT / "results" / place)
    assert results.read_rows(ROOT / "results" / place / f"{name}.csv", module.CSV, module.DEFAULTS | settings)
    assert commands[0].startswith(f"python -m paper {name} ")
