"""Tables of numbers: none is cut off, however wide the terminal is, and none where nobody looks."""

import io
import re

import pytest
from rich.console import Console
from rich.table import Table

from warp_bounding.cli.output import print_table

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
