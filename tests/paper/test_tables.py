"""Real runs of the commands on small objects: measured once, resumed after any end, one line for what is wrong."""

import csv
import json

import numpy as np
import pytest
from commands import check_bad, run

import warp_bounding as wb
from paper import proofs, regions, results, speed, table1
from paper.__main__ import parser
from paper.cells import select
from paper.drawing import unpack
from paper.gallery import FIGURES
from paper.table import HIDDEN, Column, Variant, budget_of, budgets_in
from warp_bounding.errors import BounderError, BoundingError

QUICK = ("--columns", "2d-point,2d-ray", "--methods", "aabb,voxels", "--samples", "5000")


def rows(place, name):
    with (place / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def contents(place):
    return {p: p.read_bytes() for p in place.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two images and a set of voxels: ``2d/disc``, ``2d/half``, ``3d/disc``."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    path = tmp_path_factory.mktemp("paper") / "data"
    (path / "2D").mkdir(parents=True)
    inside = np.add.outer(np.linspace(-1, 1, 12) ** 2, np.linspace(-1, 1, 12) ** 2) < 0.6
    for name, part in (("disc", inside), ("half", inside & (np.arange(12) < 6))):
        pixels = np.zeros((12, 12, 4), np.uint8)
        pixels[..., 3] = 255 * part
        image.fromarray(pixels).save(path / f"2D/{name}.png")
    (path / "4D").mkdir()
    np.save(path / "4D/disc.npy", np.broadcast_to(inside[None, :, :, None], (3, 12, 12, 12)))
    return path


def test_a_table_and_the_same_again(data, tmp_path, capsys, monkeypatch):
    table = ("table1", "--out", tmp_path / "out", "--data", data)
    status, _, err = run(capsys, *table, *QUICK)
    assert status == 0, err
    found = rows(tmp_path / "out", "table1")
    assert len(found) == 8  # two objects: points of both methods, rays of a box in both spaces
    assert {row["fn"] for row in found if row["space"] == "geometric"} == {"0"}
    assert {row["certificate"] for row in found} == {"proven", ""}  # parametric volumes have none
    page = (tmp_path / "out/README.md").read_text()
    assert "| aabb | " in page
    assert "{" not in page
    assert (tmp_path / "out/rank.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr(table1, "rank_plot", lambda rows: {})  # which takes a second
    before = contents(tmp_path / "out")
    assert run(capsys, *table, *QUICK)[0] == 0
    assert contents(tmp_path / "out") == before
    (tmp_path / "out/README.md").unlink()
    assert run(capsys, "table1", "--out", tmp_path / "out")[0] == 0
    assert contents(tmp_path / "out") == before
    fitted = {p: p.stat().st_mtime_ns for p in (tmp_path / "out/bounders").iterdir()}
    assert run(capsys, *table, *QUICK, "--protocol", "both")[0] == 0
    assert len(rows(tmp_path / "out", "table1")) == 16
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "out/bounders").iterdir()} == fitted
    next(iter(fitted)).write_text("{")
    assert run(capsys, *table, "--columns", "2d-point", "--methods", "voxels,bvh,bvh-16")[0] == 0


def test_bad_input_is_one_line_and_nothing_is_written(data, tmp_path, capsys):
    image = data / "2D/disc.png"
    table = ("table1", "--out", tmp_path / "out", "--data", data)
    own = ("--data", data)
    for words in (
        *(("table1", *own, *words) for words in (("--columns", "5d-point"), ("--methods", "magic"), ("--budget", "0"))),
        *(("table1", *own, *words) for words in (("--objects", "2d/zz"), ("--preset", "day"), ("--samples", "many"))),
        ("table1", "--data", "nowhere"),
        *(("speed", *own, *words) for words in (("--devices", "cuda:7"), ("--rounds", "0"), ("--columns", "2d-ray"))),
        *(("proofs", *own, "--table", "t", *words) for words in ((), ("--methods", "aabb"))),
        *(("recipes", *own, *words) for words in (("--columns", "2d-plane"), ("--seconds", "0"), ("--objects", "cow"))),
        *(("figures", *words) for words in (("nobody",), ("kdop", "--effort", "0"), ("kdop", "--data", "nowhere"))),
    ):
        check_bad(*run(capsys, *words, "--out", tmp_path / "out"))
        assert not (tmp_path / "out").exists(), words
    assert run(capsys, *table, "--columns", "2d-point", "--methods", "aabb", "--samples", "100")[0] == 0
    before, pixels = contents(tmp_path / "out"), image.read_bytes()
    check_bad(*run(capsys, *table, "--samples", "200"))
    assert contents(tmp_path / "out") == before
    assert image.read_bytes() == pixels


def test_help_names_the_figures(capsys):
    with pytest.raises(SystemExit, match="0"):
        parser().parse_args(["figures", "--help"])
    shown = "".join(capsys.readouterr().out.split())
    assert all(f"{name}," in shown for name in FIGURES)


def test_a_race_and_what_is_added_is_raced_with_the_reference(data, tmp_path, capsys, monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed")
    words = ("speed", "--out", tmp_path, "--data", data, "--columns", "2d-point", "--objects", "2d/disc")
    words += ("--queries", "5000", "--rounds", "3", "--samples", "5000", "--devices", "cpu", "--budget", "0.5")
    status, _, err = run(capsys, *words, "--methods", "aabb,mlp")
    assert status == 0, err
    first = rows(tmp_path, "speed")
    assert [(row["method"], row["fn"]) for row in first] == [("aabb", "0"), ("mlp", "0")]
    assert [first[1][name] for name in ("ratio", "ratio_low", "ratio_high")] == ["1.0"] * 3
    raced, race = [], speed.race
    monkeypatch.setattr(speed, "race", lambda bounders, *rest: raced.append(list(bounders)) or race(bounders, *rest))
    assert run(capsys, *words, "--methods", "aabb,kdop")[0] == 0
    assert [[cell.variant.method for cell in cells] for cells in raced] == [["kdop", "mlp"]]
    assert rows(tmp_path, "speed")[:2] == first
    assert "{" not in (tmp_path / "README.md").read_text()


def test_both_recipes_are_proven(data, tmp_path, capsys):
    pytest.importorskip("torch", reason="torch is not installed")
    words = ("recipes", "--out", tmp_path, "--data", data, "--columns", "2d-point", "--objects", "2d/disc")
    status, _, err = run(capsys, *words, "--seconds", "3", "--samples", "5000")
    assert status == 0, err
    found = {row["way"]: row for row in rows(tmp_path, "recipes")}
    assert [found[way]["fn"] for way in ("default", "paper")] == ["0", "0"]
    assert float(found["default"]["fp_rate"]) < float(found["paper"]["fp_rate"])
    assert "{" not in (tmp_path / "README.md").read_text()


def test_a_figure_of_learned_half_spaces_is_proven_and_tighter(data, tmp_path, capsys):
    (tmp_path / "own/2D").mkdir(parents=True)
    for name, like in (("bunny", "disc"), ("star1", "half"), ("dragon1", "disc")):
        (tmp_path / f"own/2D/{name}.png").write_bytes((data / f"2D/{like}.png").read_bytes())
    out = tmp_path / "out"
    words = ("figures", "kdop", "--data", tmp_path / "own", "--quick", "--effort", "0.1", "--out", out)
    status, _, err = run(capsys, *words, "--samples", "20000")
    assert status == 0, err
    parts = json.loads((out / "kdop.json").read_text())["parts"]
    learned = {name: part for name, part in parts.items() if name.endswith(" learned-kdop")}
    assert len(learned) == 3
    for name, part in learned.items():
        fixed = parts[name.replace("learned-kdop", "kdop")]
        assert (part["fn"], part["certificate"], fixed["fn"], fixed["certificate"]) == (0, "proven", 0, "proven")
        assert part["fp"] <= fixed["fp"] + 0.5
    assert (out / "kdop.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (out / "kdop.svg").read_bytes()


def test_networks_of_the_parts_of_a_school_of_fish_miss_none(data, tmp_path, capsys):
    pytest.importorskip("torch", reason="torch is not installed")
    words = ("figures", "hierarchy", "--data", data, "--quick", "--effort", "0.1", "--out", tmp_path)
    status, _, err = run(capsys, *words, "--samples", "20000")
    assert status == 0, err
    school = json.loads((tmp_path / "hierarchy.json").read_text())["parts"]["school"]
    inside, levels = unpack(school["inside"]), school["levels"]
    assert {name: level["fn"] for name, level in levels.items()} == dict.fromkeys(levels, 0)
    assert inside.any()
    for level in levels.values():
        assert unpack(level["maybe"])[inside].all()
    assert (tmp_path / "hierarchy.png").read_bytes().startswith(b"\x89PNG")


# --- what a proof is worth ----------------------------------------------------------------------------------------


@pytest.fixture
def table(tmp_path, monkeypatch):
    """A folder of ``table1`` without any bounder; networks are small."""
    monkeypatch.setitem(HIDDEN, 2, (8,))
    results.opened(tmp_path / "table", "table1", table1.CSV, table1.DEFAULTS, {"budget": 0.5})
    return tmp_path / "table"


def run_proofs(capsys, data, table, *words):
    """Rows with their networks, and what was said."""
    own = ("--columns", "2d-point", "--methods", "mlp", "--objects", "2d/disc", "--samples", "4000")
    own += ("--seconds", "5", *words)
    out = table.parent / "out"
    status, _, err = run(capsys, "proofs", "--data", data, "--table", table, "--out", out, *own)
    shape, found = wb.load_shape(data / "2D/disc.png"), rows(out, "proofs")
    files = [out / f"bounders/2d-{row['query']}.disc.mlp.safetensors" for row in found]
    return status, [(row, wb.load(file, device="cpu")) for row, file in zip(found, files, strict=True)], shape, err


def test_networks_with_both_thresholds(data, table, capsys):
    status, found, shape, err = run_proofs(capsys, data, table, "--positives", "20000")
    assert status == 0, err
    assert len(found) == 1
    for row, network in found:
        assert (row["search"], row["fn_proven"], row["fitted"]) == ("complete", "0", "here")
        value = {name: float(row[name]) for name in ("proven", "sampled", "lower_bound", "upper_bound", "fp_shipped")}
        assert value["proven"] <= value["sampled"]
        assert value["lower_bound"] <= value["upper_bound"] <= value["sampled"] + 1e-6
        assert value["fp_shipped"] == pytest.approx(wb.evaluate(network, shape, 4000, seed=1).fp_rate)
    assert "{" not in (table.parent / "out/README.md").read_text()


def test_a_contradiction_and_a_failed_proof_are_told(data, table, capsys, monkeypatch):
    """If a positive lies below what a certificate says, one of the proofs is wrong: that must not pass for a row."""
    from dataclasses import replace

    prove = proofs.prove

    def wrong(bounder, grid, **options):
        search = prove(bounder, grid, **options)
        return replace(search, upper_bound=search.lower_bound - 1.0, lower_bound=search.lower_bound - 1.5)

    def none(*_, **__):
        raise BounderError("no proof\nyet")

    for fake, reported in ((wrong, "the prover found a positive with f ="), (none, "2d-point disc: mlp: no proof yet")):
        monkeypatch.setattr(proofs, "prove", fake)
        status, found, _, err = run_proofs(capsys, data, table, "--positives", "500")
        assert (status, found) == (1, [])
        assert reported in err


# --- what words select ------------------------------------------------------------------------------------------------


def test_the_papers_networks_are_rows_of_regions_only(data, tmp_path, capsys, monkeypatch):
    cells = select(str(data), "2d", "mlp", "2d/disc")
    found = {(cell.column.query, cell.variant.label) for cell in cells}
    assert found == {("point", "mlp"), *((query, "mlp (parametric)") for query in ("ray", "plane", "box"))}
    monkeypatch.setattr(table1, "rank_plot", lambda rows: {})
    monkeypatch.setattr(regions, "DRAWN", 5000)
    words = ("table1", "--out", tmp_path, "--data", data, "--columns", "2d-box", "--methods", "mlp", "--budget", "0.3")
    status, _, err = run(capsys, *words, "--objects", "2d/disc", "--samples", "5000", "--protocol", "sampled")
    assert status == 0, err
    (row,) = rows(tmp_path, "table1")
    assert (row["method"], row["space"], row["certificate"]) == ("mlp", "parametric", "")
    assert "| mlp (parametric) | " in (tmp_path / "README.md").read_text()


POINT, RAY = Column(2, "point"), Column(3, "ray")


def test_of_all_budgets_the_last_that_fits_counts():
    s = budgets_in("20, 3D=40,ray=50 ,3d-ray=90.5,3d-ray:mlp=240,occupancy=5,learned-kdop=7", 60.0)
    seconds = {name: budget_of(s, RAY, Variant(name)) for name in ("mlp", "occupancy", "relu-field", "distance")}
    assert seconds == {"mlp": 240, "occupancy": 5, "relu-field": 90.5, "distance": 90.5}
    assert budget_of(s, RAY, Variant("learned-kdop+mlp")) == 240  # what its last part would take
    assert budget_of(s, Column(3, "box"), Variant("mlp")) == 40
    assert budget_of(s, POINT, Variant("mlp")) == 20
    assert budgets_in("3d=1", 60.0) == {"budget": 60.0, "budgets": "3d=1"}
    for text in ("", "a", "0", "nan", "3,4", "5d=3", "aabb=3", "3d="):
        with pytest.raises(BoundingError, match="budget must"):
            budgets_in(text, 60.0)
