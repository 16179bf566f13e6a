"""What sampling would have shipped and what a proof costs: checked against oracle, kernel and ``evaluate``."""

import csv
import dataclasses
import json
from functools import partial

import numpy as np
import pytest
from commands import check_bad, run

import warp_bounding as wb
from paper.folder import open_folder
from paper.pages.proofs_page import proofs_page, summary
from paper.proofs import Thresholds, _as_asked
from paper.rows import ProofRow
from warp_bounding.proof import prove
from warp_bounding.queries import oracle
from warp_bounding.training import fit

QUICK = ("--columns", "2d-point,2d-plane", "--methods", "mlp", "--samples", "4000", "--seconds", "20")


def tiny_fit(log, grid, **options):
    """A network of few neurons and steps."""
    log.append((options["query"], options["method"]))
    return fit(grid, **(options | {"hidden": (6, 6), "steps": 30}))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A data folder with two small images, and a table that has been begun."""
    image = pytest.importorskip("PIL.Image")
    path = tmp_path_factory.mktemp("proofs")
    inside = np.add.outer(np.linspace(-1, 1, 10) ** 2, np.linspace(-1, 1, 10) ** 2) < 0.5
    for name, part in (("disc", inside), ("half", inside & (np.arange(10) < 5))):
        pixels = np.zeros((10, 10, 4), np.uint8)
        pixels[..., 3] = 255 * part
        (path / "data/2D").mkdir(parents=True, exist_ok=True)
        image.fromarray(pixels).save(path / f"data/2D/{name}.png")
    with open_folder(path / "table", {"budget": 5.0}, create=True) as folder:
        grid = wb.load_indicator(path / "data/2D/disc.png")
        network = tiny_fit([], grid, query="point", method="mlp", budget=5.0, seed=0, device="cpu")
        network.save(folder.bounder("2d-point.disc.mlp"))
    return path


@pytest.fixture
def fits(monkeypatch):
    """Fits are tiny, and noted here."""
    log = []
    monkeypatch.setattr("warp_bounding.training.fit", partial(tiny_fit, log))
    return log


def proofs(capsys, place, *arguments, out="out", table="table", data="data"):
    """Status, standard output, standard error."""
    places = ("--data", place / data, "--table", place / table, "--out", place / out)
    return run(capsys, "proofs", *places, *arguments)


def rows(place, out="out"):
    lines = (place / out / "proofs.csv").read_text().splitlines()
    return [ProofRow.parse(line) for line in lines[1:]]


def network_of(place, row, out):
    name = f"2d-{row.query}.{row.object}.mlp.safetensors"
    path = (place / "table" if row.fitted == "table" else place / out) / "bounders" / name
    return wb.load(path, device="cpu"), wb.load_indicator(place / f"data/2D/{row.object}.png")


def test_a_run_and_the_same_again(place, fits, capsys):
    status, text, err = proofs(capsys, place, *QUICK, "--positives", "30000", "--json")
    assert status == 0, err
    result = json.loads(text)
    assert (result["total"], result["done"], result["failed"], result["interrupted"]) == (4, 4, [], False)
    assert fits == [("plane", "mlp"), ("point", "mlp"), ("plane", "mlp")]
    assert [r.fitted for r in rows(place)] == ["table", "here", "here", "here"]
    for row in rows(place):
        network, grid = network_of(place, row, "out")
        assert row.search == "complete"
        assert row.fn_proven == 0
        assert row.proven <= row.sampled
        assert row.lower_bound <= row.upper_bound <= row.sampled + 1e-6
        assert row.fp_sampled <= row.fp_proven <= 100
        rates = wb.evaluate(network, grid, 4000, seed=1)
        assert (row.fp_shipped, row.positives) == pytest.approx((rates.fp_rate, rates.positives))
        assert (row.missed_zero is None) == (row.query == "plane")
    assert result["summary"] == summary(rows(place))
    assert result["summary"]["networks"] == 4
    page = (place / "out/README.md").read_text()
    assert "Of 4 networks thresholded at their minimum over at least" in page
    assert "python -m paper proofs --data DIR" in page
    assert str(place) not in page
    before = {p: p.stat().st_mtime_ns for p in (place / "out/bounders").iterdir()}
    content = (place / "out/proofs.csv").read_bytes()
    lines = content.splitlines(keepends=True)
    (place / "out/proofs.csv").write_bytes(b"".join(lines[:-1]) + lines[-1][:20])  # what a power cut may leave
    status, text, err = proofs(capsys, place, *QUICK)
    assert status == 0, err
    assert "torn" in err
    assert "4 of 4 networks" in text
    assert {p: p.stat().st_mtime_ns for p in (place / "out/bounders").iterdir()} == before
    assert [dataclasses.replace(r, proof_seconds=0) for r in rows(place)] == [
        dataclasses.replace(ProofRow.parse(line.decode().rstrip("\n")), proof_seconds=0) for line in lines[1:]
    ]
    assert len(fits) == 3


def test_few_samples_ship_false_negatives(place, fits, capsys, monkeypatch):
    quick = ("--columns", "2d-point", "--methods", "mlp", "--samples", "2000", "--positives", "1")
    monkeypatch.setattr("warp_bounding.queries.hard.CHUNK", 64)
    status, _, err = proofs(capsys, place, *quick, out="few")
    assert status == 0, err
    assert "a false negative by the prover" in err
    missed = [r for r in rows(place, "few") if r.missed_sampled]
    assert missed
    for row in missed:
        network, grid = network_of(place, row, "few")
        x = np.array([list(map(float, row.counterexample.split()))], np.float32)
        assert oracle("point", grid, "cpu")(x).all()
        assert network.values(x).numpy()[0] == np.float32(row.counterexample_f)
        assert row.depth == pytest.approx(row.sampled - row.counterexample_f)
        assert network.freeze(row.sampled, None).query(x).numpy()[0] == 0
        assert network.freeze(row.proven, None).query(x).numpy()[0] == 1
        assert row.depth_fp >= 0


def test_boxes_of_monotone_networks(place, fits, capsys):
    quick = ("--columns", "2d-box", "--methods", "monotone-mlp", "--objects", "disc", "--samples", "2000")
    status, _, err = proofs(capsys, place, *quick, "--positives", "20000", out="boxes")
    assert status == 0, err
    (row,) = rows(place, "boxes")
    assert (row.search, row.method, row.fn_proven) == ("complete", "monotone-mlp", 0)
    assert row.proven <= row.sampled


def test_rays_from_outside_are_no_positives_as_they_are(place, fits, capsys):
    """A device moves their origins to where they enter the domain; f at the origins themselves says nothing."""
    quick = ("--columns", "2d-ray", "--methods", "mlp", "--samples", "2000", "--positives", "20000")
    status, _, err = proofs(capsys, place, *quick, out="rays")
    assert status == 0, err
    for row in rows(place, "rays"):
        network, _ = network_of(place, row, "rays")
        assert row.search == "complete"
        assert network.certificate.proven
        assert row.upper_bound >= network.certificate.lower_bound
        assert row.lower_bound <= row.upper_bound <= row.sampled + row.rounding_bound
        x = np.float32([[-3.0, 0.4, 1.0, 0.1], [0.4, 0.5, 0.2, -1.0], [0.4, 5.0, 0.2, -1.0]])
        np.testing.assert_array_equal(_as_asked(network, x), network.domain.to_local(x[1:2]))


def test_a_contradiction_is_told(place, fits, capsys, monkeypatch):
    """If a positive lies below what a certificate says, one of the proofs is wrong: that must not pass for a row."""
    quick = [
        "--columns",
        "2d-point",
        "--methods",
        "mlp",
        "--objects",
        "disc",
        "--samples",
        "2000",
        "--positives",
        "2000",
    ]

    def wrong(bounder, grid, **options):
        search = prove(bounder, grid, **options)
        return dataclasses.replace(search, upper_bound=search.lower_bound - 1.0, lower_bound=search.lower_bound - 1.5)

    monkeypatch.setattr("paper.proofs.prove", wrong)
    status, _, err = proofs(capsys, place, *quick, out="wrong")
    assert status == 1
    assert "the prover found a positive with f =" in err
    assert not rows(place, "wrong")


def test_rates_at_any_threshold():
    inf = np.inf
    rates = Thresholds(np.array([-inf, -1, 0, 1, inf, 2], np.float32), np.array([0, 1, 0, 0, 0, 1], bool))
    assert [round(rates.fp(t), 3) for t in (-2.0, 0.5, 3.0)] == [50.0, 33.333, 16.667]
    assert [rates.fn(t) for t in (-2.0, 0.5, 3.0)] == [0, 1, 2]
    assert rates.spread == pytest.approx(np.std([-1, 0, 1, 2]))
    assert rates.room(2.0) == pytest.approx(1.0)


def test_rows_come_back_whole_and_damage_is_told(place, fits, capsys):
    quick = ("--columns", "2d-plane", "--methods", "mlp", "--objects", "half", "--samples", "500", "--positives", "500")
    assert proofs(capsys, place, *quick, out="one")[0] == 0
    (row,) = rows(place, "one")
    assert ProofRow.parse(row.line.rstrip("\n")) == row
    with (place / "one/proofs.csv").open() as file:
        assert next(csv.DictReader(file))["object"] == "half"
    with open_folder(place / "one", {}, create=False, kind=ProofRow) as folder:
        folder.rows = {}
        assert "No network has been measured yet" in proofs_page(folder, ["2d-ray half: no luck"])
    table = place / "one/proofs.csv"
    for changes in ({"search": "guessed"}, {"samples": 501}, {"method": "magic"}, {"found_by": "luck"}):
        table.write_text(ProofRow.header() + dataclasses.replace(row, **changes).line)
        check_bad(*proofs(capsys, place, *quick, out="one"))


@pytest.mark.parametrize(
    ("arguments", "places"),
    [
        ((), {"table": "nowhere"}),
        ((), {"table": "data"}),
        ((), {"data": "nowhere"}),
        ((), {"out": "table"}),
        ((), {"out": "data/2D/disc.png"}),
        (("--methods", "aabb"), {}),
        (("--methods", "magic"), {}),
        (("--columns", "5d"), {}),
        (("--columns", "3d"), {}),
        (("--objects", "bunny"), {}),
        (("--positives", "0"), {}),
        (("--samples", "0"), {}),
        (("--seconds", "-1"), {}),
        (("--seconds", "many"), {}),
    ],
)
def test_bad_input(place, fits, capsys, arguments, places):
    before = {p for p in place.rglob("*") if p.name != ".lock"}
    check_bad(*proofs(capsys, place, "--columns", "2d-point", *arguments, **({"out": "fresh"} | places)))
    assert {p for p in place.rglob("*") if p.name != ".lock"} == before


def test_what_cannot_be_proven_is_told(place, fits, capsys, monkeypatch):
    from warp_bounding.errors import BounderError

    def no_proof(*_, **__):
        raise BounderError("mlp: no proof\nyet")

    monkeypatch.setattr("paper.proofs.prove", no_proof)
    quick = ("--columns", "2d-point", "--methods", "mlp", "--objects", "disc", "--samples", "500", "--positives", "500")
    status, _, err = proofs(capsys, place, *quick, out="none")
    assert status == 1
    assert "failed: 2d-point disc: mlp: mlp: no proof yet" in err
    assert "**Failed**" in (place / "none/README.md").read_text()
