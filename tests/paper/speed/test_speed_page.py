"""What is shown of a run of ``speed``: means over objects, break-evens, early exits, from rows alone."""

import json
import re
import struct

import pytest

from paper.columns import COLUMNS, Variant
from paper.folder import open_folder
from paper.speed.figures import TABLE_2
from paper.speed.page import write_outputs
from paper.speed.rows import SpeedRow, SpeedSettings
from paper.speed.tables import EARLY, OnDevice, by_device

BOX, MLP = Variant("aabb"), Variant("mlp")


def make_row(column, variant, ns, ratio, fp_rate, name="bunny", device="cpu", **fields) -> SpeedRow:
    """A row that could have been measured with the default settings."""
    values = {
        "dimension": column.ndim,
        "object": name,
        "query": column.query,
        "method": variant.method,
        "space": "parametric" if variant.parametric else "geometric",
        "leaves": variant.leaves,
        "device": device,
        "device_name": f"a {device}",
        "ns": ns,
        "ratio": ratio,
        "ratio_low": 0.9 * ratio,
        "ratio_high": 1.1 * ratio,
        "reference": "mlp",
        "fp_rate": fp_rate,
        "fn": 0,
        "positives": 30.0,
        "certificate": "proven",
        "nbytes": 2000,
        "fit_seconds": 1.0,
        "threads": 2,
        "indicator": "0" * 16,
        "versions": "warp-bounding 0, Python 3",
    }
    return SpeedRow(**values | SpeedSettings().of_row(column, variant) | fields)


def two_networks(column, gain, fp_early=3.3, **about):
    return [make_row(column, MLP, 40.0, 1.0, 3.0, **about), make_row(column, EARLY, 20.0, 1 / gain, fp_early, **about)]


ROWS = [
    *(row for i, column in enumerate(COLUMNS) for row in two_networks(column, 0.8 + 0.1 * i)),
    make_row(TABLE_2, BOX, 4.0, 0.1, 30.0),
    make_row(TABLE_2, BOX._replace(parametric=True), 4.0, 0.1, 70.0),
]


@pytest.fixture
def folder(tmp_path):
    with open_folder(tmp_path / "out", {}, create=True, kind=SpeedRow) as opened:
        opened.remember("python -m paper speed --out O")
        for row in ROWS:
            opened.append(row)
    with open_folder(tmp_path / "out", {}, create=False, kind=SpeedRow) as opened:
        assert list(opened.rows.values()) == ROWS
        yield opened


def test_means_over_objects_are_geometric():
    rows = [
        make_row(TABLE_2, BOX, ns, ratio, fp, name) for ns, ratio, fp, name in ((2, 0.1, 10, "a"), (8, 0.4, 30, "b"))
    ]
    cell = OnDevice(rows, "cpu").cells[BOX, TABLE_2]
    assert (cell.ns, cell.ratio, cell.fp_rate, cell.objects) == (pytest.approx(4), pytest.approx(0.2), 20, 2)
    assert (cell.ms, cell.billions) == (pytest.approx(40), pytest.approx(0.25))


def test_break_evens_are_of_times_within_rounds():
    on = OnDevice(ROWS, "cpu")
    gain = 0.8 + 0.1 * COLUMNS.index(TABLE_2)
    time, other = 400 / gain, 40.0  # milliseconds for ten million, from mlp's and the ratios
    assert on.break_even(BOX).least == pytest.approx((time - other) / (0.3 - 0.033))
    assert on.break_even(BOX).factor == pytest.approx(on.break_even(BOX).least / other)
    assert OnDevice(ROWS[:2], "cpu").break_even(BOX) is None


def test_devices_are_apart():
    rows = [*ROWS, *two_networks(TABLE_2, 0.5, device="cuda:0")]
    cpu, cuda = by_device(rows)
    assert (cpu.device, cuda.device, cuda.name) == ("cpu", "cuda:0", "a cuda:0")
    assert [each.gain for each in cuda.early_out()] == [pytest.approx(0.5)]


def test_the_page(folder):
    assert write_outputs(folder) == []
    text = folder.page.read_text()
    for heading in (
        "# Speed of",
        "## cpu: a cpu",
        "### 3D rays (the paper's Table 2)",
        "### Early exits",
        "## The early-out plot",
    ):
        assert heading in text
    assert "| aabb (parametric) | 40.0 (2.58) | 0.250 (3.88) | 0.100 (0.036) | 70.00 (69.3) |" in text
    assert "| aabb | 40.0 | 0.250 | 0.100 | 30.00 |" in text
    assert "faster one in 9 of 12 columns" in text  # 0.8 to 1.9; at 1.0 it is not
    assert "in 9 of them (bold)" in text
    assert "promise is broken" not in text
    found = json.loads((folder.path / "speed.json").read_text())["cpu"]
    assert found["early_out"]["4d-box"]["gain"] == pytest.approx(1.9)
    assert found["break_even"]["aabb"]["most_ms"] is None
    picture = (folder.path / "early_out.png").read_bytes()
    width, height = struct.unpack(">II", picture[16:24])
    assert width > 800
    assert height > 400
    assert re.search(rb"<svg", (folder.path / "early_out.svg").read_bytes())


def test_a_gain_at_the_price_of_tightness_is_not_bold(folder):
    folder.rows = {row.key: row for row in two_networks(TABLE_2, 2.0, fp_early=3.7)}
    write_outputs(folder)
    text = folder.page.read_text()
    assert "faster one in 1 of 1 columns" in text
    assert "in 0 of them (bold)" in text


def test_a_gain_of_a_network_that_has_learnt_nothing_is_marked(folder):
    rows = [*two_networks(TABLE_2, 2.0, fp_early=3.0), make_row(TABLE_2, BOX, 4.0, 0.1, 3.1)]
    folder.rows = {row.key: row for row in rows}
    write_outputs(folder)
    text = folder.page.read_text()
    assert "in 0 of them (bold)" in text
    assert "| 3D ray † | 2.00 |" in text
    assert "the fit was too short" in text


def test_false_negatives_are_told(folder):
    folder.rows = {row.key: row for row in [make_row(TABLE_2, BOX, 4.0, 0.1, 30.0, fn=3)]}
    write_outputs(folder)
    assert "3 false negatives of methods that promise none" in folder.page.read_text()


def test_pictures_wait_for_the_end(folder):
    write_outputs(folder, pictures=False)
    assert not (folder.path / "early_out.png").exists()
    assert "early_out.png" not in folder.page.read_text()


def test_nothing_measured(tmp_path):
    with open_folder(tmp_path / "out", {}, create=True, kind=SpeedRow) as opened:
        write_outputs(opened)
        assert "Nothing has been measured yet." in opened.page.read_text()
