"""``warp-bounding choose``: a bounder, a plot and a table, or one line that says what is wrong."""

import io
import json
import re

import numpy as np
import pytest
from commands import check_bad, run
from rich.console import Console
from rich.table import Table

from warp_bounding.cli.output import print_table


@pytest.fixture
def disk(tmp_path):
    np.save(tmp_path / "disk.npy", np.linalg.norm(np.indices((12, 12)) - 5.5, axis=0) < 5)
    return tmp_path / "disk.npy"


def choose(capsys, disk, *options, price=5000, name="c"):
    output = disk.parent / f"{name}.safetensors"
    sizes = [] if "--networks" in options else ["--networks", "none"]
    return output, run(capsys, "choose", disk, "-o", output, "--narrow-ns", price, "--budget", 4, *sizes, *options)


def test_what_is_written_goes_on_and_is_asked(capsys, disk):
    output, (status, out, err) = choose(capsys, disk)
    assert status == 0, err
    assert "s a query in all" in out
    assert "Best by the narrow phase's price: none from 0 ns" in out
    assert f"candidates are kept in {output.with_suffix('.choice')}" in out
    assert "…" not in out
    assert out.splitlines()[0].endswith("; --queries x.npy asks those of your simulation")
    assert output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads((disk.parent / "c.choice" / "rows.json").read_text())
    assert rows["path"] == str(output)
    np.save(disk.parent / "x.npy", np.zeros((10, 2)))
    assert run(capsys, "query", output, disk.parent / "x.npy", "-o", disk.parent / "y.npy")[0] == 0
    # another price keeps what was fitted (what had no room in the budget may have now), and nobody pays at 0
    before = {path: path.stat().st_mtime_ns for path in (disk.parent / "c.choice").glob("*.safetensors")}
    again, (status, out, err) = choose(capsys, disk, "--json", "--folder", disk.parent / "c.choice", price=0, name="d")
    assert status == 0, err
    told = json.loads(out)
    assert told["label"] == "none"
    assert told["path"] is None
    assert not again.exists()
    after = {path: path.stat().st_mtime_ns for path in (disk.parent / "c.choice").glob("*.safetensors")}
    assert before.items() <= after.items()


def test_long_remarks_are_footnotes(capsys, disk):
    """A budget that has no room for networks: each says which one would, below the table, by its number there."""
    _, (status, out, err) = choose(capsys, disk, "--methods", "aabb,mlp", "--networks", "50-50", "--budget", 0.2)
    assert status == 0, err
    lines = out.splitlines()
    row = next(line for line in lines if line.startswith("mlp 50-50"))
    number = re.search(r"\[\d+\]$", row.rstrip())[0]
    note = next(line for line in lines if line.startswith(f"{number} "))
    assert "a budget of" in note or "hardly trained" in note


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--memory", "much"], "memory must be a number of bytes such as 16k or 4000, got 'much'"),
        (["--memory", "0"], "memory must be a number of bytes"),
        (["--queries", "nope.npy"], "nope.npy: no such file"),
        (["--query", "ball"], "ball"),
        (["--networks", "24x24"], "networks must be widths such as 24-24,50-50, or none, got '24x24'"),
        (["--networks", "0-5"], "hidden must be"),
        (["--length", "2"], "length is for ray queries"),
    ],
)
def test_bad_input_is_one_line(capsys, disk, options, told):
    _, (status, out, err) = choose(capsys, disk, *options)
    check_bad(status, out, err)
    assert told in err


def test_nothing_of_others_is_overwritten(capsys, disk):
    disk.with_name("notes.txt").write_text("a thesis")
    status, out, err = run(capsys, "choose", disk, "-o", disk.with_name("notes.txt"), "--narrow-ns", 1)
    check_bad(status, out, err)
    assert disk.with_name("notes.txt").read_text() == "a thesis"
    (disk.parent / "e.choice").mkdir()
    (disk.parent / "e.choice" / "a").write_text("x")
    _, (status, out, err) = choose(capsys, disk, name="e")
    check_bad(status, out, err)
    assert "holds other files" in err


STARVED = "proven; its proof had too little time, so that it is looser than its kind"
ROWS = [
    ("bvh 1024 leaves", "38,268", "39.1", "13.8", "246.8", "proven"),
    ("mlp 50-50, 1024 parts", "11,204", "12.34", "11.85", "1,234.5", STARVED),
    ("learned-kdop+mlp 24-24", "2,884", "", "", "", "not tried: needs a budget of 140 s"),
]
NAMES = ("", "bytes", "ns", "left %", "cost ns", "certificate")


def printed(width, terminal=True):
    """Lines of the table."""
    file = io.StringIO()
    out = Console(file=file, width=width, force_terminal=terminal, color_system=None, soft_wrap=True)
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for name in NAMES:
        table.add_column(name, justify="left" if name in ("", "certificate") else "right")
    for row in ROWS:
        table.add_row(*row)
    print_table(out, table, ("", "certificate"))
    return file.getvalue().splitlines()


@pytest.mark.parametrize("width", [40, 80, 100, 160, 400])
def test_numbers_are_whole_at_any_width(width):
    lines = printed(width)
    text = "\n".join(lines)
    for row in ROWS:
        for number in filter(None, row[1:5]):
            assert re.search(rf"(?<![\d.,]){re.escape(number)}(?![\d.,])", text), number
    assert "…" not in text
    told = "".join("".join(line.split()) for line in lines)
    for word in ("bytes", "left%", "costns"):
        assert word in told
    if width >= 80:
        assert max(map(len, lines)) <= width
    if width >= 160:
        assert len(lines) == len(ROWS) + 1  # nothing wraps where there is room


def test_labels_wrap_and_lose_nothing():
    words = " ".join(line[:22] for line in printed(80)).split()
    assert {"bvh", "mlp", "50-50,", "parts"} <= set(words)


def test_nobody_wraps_what_is_piped():
    lines = [line.rstrip() for line in printed(80, terminal=False)]
    assert len(lines) == len(ROWS) + 1
    for line, row in zip(lines[1:], ROWS, strict=True):
        assert line.startswith(row[0])
        assert line.endswith(row[-1])
