"""The tables of *Which bounder?* show the files in ``results``, and mark what is best."""

import json

import pytest
from measured import MEASURED, bold_least, table
from stage import ROOT

RESULTS = ROOT / "results"


def cells(text: str) -> dict[str, list[str]]:
    """The rows of tables, by their first cell; of several the last."""
    rows = [[cell.strip() for cell in line.strip("|\n ").split(" | ")] for line in text.splitlines() if line]
    return {row[0].strip("`"): row[1:] for row in rows}


def test_a_table_has_as_many_cells_in_every_row():
    for make in MEASURED.values():
        for part in make(RESULTS).strip().split("\n\n"):
            assert len({line.count("|") for line in part.splitlines() if "---" not in line}) == 1
    assert table(["a", "b"], [["x", "1"]]) == "| a | b |\n| ---|---: |\n| x | 1 |\n"


def test_the_least_is_bold():
    assert bold_least([["1.0", "2"], ["0.5", ""]], [[1.0, 2.0], [0.5, None]]) == [["1.0", "**2**"], ["**0.5**", ""]]


def test_meshes_are_those_that_were_measured():
    shown = cells(MEASURED["meshes"](RESULTS))
    for line in (RESULTS / "meshes/meshes.jsonl").read_text().splitlines():
        row = json.loads(line)
        if row["certificate"] == "proven":
            column = shown["method"].index(row["mesh"])
            assert shown[row["label"]][column].strip("*") == f"{row['fp_rate']:.2f}"
        else:
            assert row["label"] not in shown


def test_prices_are_times_and_what_is_left():
    shown = cells(MEASURED["prices"](RESULTS))
    assert shown["*none*"][2:] == ["10.0", "100", "1,000", "10,000"]
    row = next(json.loads(x) for x in (RESULTS / "meshes/meshes.jsonl").read_text().splitlines() if '"mlp 24-24"' in x)
    cost = row["nanoseconds"] + 1000 * (row["fp_rate"] + row["positives"]) / 100
    assert shown["mlp 24-24"][4].strip("*") == f"{cost:,.0f}"
    for column in range(2, 6):
        rows = {label: values[column] for label, values in shown.items() if label[:3] not in ("met", "---")}
        costs = {label: float(cell.strip("*").replace(",", "")) for label, cell in rows.items()}
        (best,) = (label for label, cell in rows.items() if cell.startswith("**"))
        assert costs[best] == min(costs.values())


def test_demos_leave_what_they_did():
    runs = json.loads((RESULTS / "demos/shadows.json").read_text())["runs"]
    none, mlp, lost = (next(run for run in runs if run["bounder"] == name) for name in ("none", "mlp", "occupancy"))
    part = next(part for part in MEASURED["demos"](RESULTS).split("\n\n") if part.startswith("| shadows"))
    calls, spent = cells(part)["mlp"][0].split(" / ")
    assert float(calls) == pytest.approx(100 * mlp["narrow_calls"] / none["narrow_calls"], abs=0.05)
    time = (mlp["ms_broad"] + mlp["ms_narrow"]) / (none["ms_broad"] + none["ms_narrow"])
    assert float(spent) == pytest.approx(100 * time, abs=0.5)
    assert f"**{lost['missed']:,} missed**" in cells(part)["occupancy"][0]
    assert "missed" not in cells(part)["mlp"][0]
