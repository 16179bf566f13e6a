"""The tables of *Which bounder?* show the files in ``results``, and mark what is best."""

import json

from measured import MEASURED
from stage import ROOT

RESULTS = ROOT / "results"


def cells(text: str) -> dict[str, list[str]]:
    """The rows of tables, by their first cell; of several the last."""
    rows = [[cell.strip() for cell in line.strip("|\n ").split(" | ")] for line in text.splitlines() if line]
    return {row[0].strip("`"): row[1:] for row in rows}


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
