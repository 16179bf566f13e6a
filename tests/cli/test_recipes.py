"""``recipes``: rows for Table 1's page, resumed after any end, with clear words for what is wrong."""

import csv
import json
import shutil

import numpy as np
import pytest
from commands import check_bad, run

pytest.importorskip("torch", reason="torch is not installed")

from paper.recipes.run import steps_asked

SMALL = ("--columns", "2d-point", "--ways", "default,paper", "--seconds", "5", "--samples", "5000")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A data folder with one object, and a table of one cell."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    path = tmp_path_factory.mktemp("recipes")
    (path / "data/2D").mkdir(parents=True)
    y, x = np.mgrid[:16, :16] - 7.5
    ring = np.zeros((16, 16, 4), np.uint8)
    ring[..., 3] = np.where(abs(np.hypot(x, y) - 5) < 2, 255, 0)
    image.fromarray(ring).save(path / "data/2D/ring.png")
    return path


@pytest.fixture
def table(place, tmp_path, capsys):
    """A folder of ``table1``."""
    whole = place / "table"
    if not whole.exists():
        arguments = ("--columns", "2d-point", "--methods", "aabb", "--samples", "5000")
        status, _, err = run(capsys, "table1", "--data", place / "data", "--out", whole, *arguments)
        assert status == 0, err
    return shutil.copytree(whole, tmp_path / "table")


def recipes(capsys, place, table, *arguments):
    return run(capsys, "recipes", "--data", place / "data", "--table", table, *arguments)


def rows(table):
    with (table / "recipes/recipes.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_rows_in_the_page_and_the_same_again(place, table, capsys):
    status, out, err = recipes(capsys, place, table, *SMALL)
    assert status == 0, err
    found = rows(table)
    assert [row["way"] for row in found] == ["default", "paper"]
    assert [row["steps_asked"] for row in found] == ["", "70000"]
    assert all(int(row["steps"]) > 0 and row["fn"] == "0" for row in found)
    page = (table / "README.md").read_text()
    assert "## The paper's recipe and its positional encoding" in page
    assert page.index("## The paper's recipe") < page.index("## Details")
    assert "| 2D point | ring | the paper's recipe |" in page
    before = (table / "recipes/recipes.csv").read_bytes()
    status, out, _ = recipes(capsys, place, table, *SMALL, "--json")
    assert status == 0
    assert json.loads(out)["done"] == 2
    assert (table / "recipes/recipes.csv").read_bytes() == before


@pytest.mark.slow
def test_it_goes_on_where_it_stopped(place, table, capsys, monkeypatch):
    from warp_bounding import training

    fit, fits = training.fit, []

    def stopped(*arguments, recipe, **options):
        fits.append(recipe)
        if recipe == "paper":
            raise KeyboardInterrupt
        return fit(*arguments, recipe=recipe, **options)

    with monkeypatch.context() as patch:
        patch.setattr(training, "fit", stopped)
        status, _, err = recipes(capsys, place, table, *SMALL)
    assert status == 1
    assert "interrupted: 1 of 2 networks are done" in err
    assert len(rows(table)) == 1
    status, *_ = recipes(capsys, place, table, *SMALL)
    assert status == 0
    assert fits == ["default", "paper"]
    assert len(rows(table)) == 2


def test_steps_that_are_asked_for():
    assert steps_asked("paper") == 70_000
    assert steps_asked("default") is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--ways", "magic"), "ways must be among default, default+encoding, paper, paper+encoding"),
        (("--columns", "2d-plane"), "networks of planes have neither"),
        (("--columns", "5d"), "columns must be among"),
        (("--objects", "cow"), "objects must be among 2d/ring"),
        (("--seconds", "0"), "seconds must be positive"),
    ],
)
def test_bad_input_in_one_line(place, table, capsys, arguments, words):
    before = {p: p.read_bytes() for p in table.rglob("*") if p.is_file()}
    columns = () if "--columns" in arguments else ("--columns", "2d-point")
    status, out, err = recipes(capsys, place, table, *columns, *arguments)
    check_bad(status, out, err)
    assert words in err
    assert before == {p: p.read_bytes() for p in table.rglob("*") if p.is_file()}


def test_a_folder_without_a_table(place, tmp_path, capsys):
    status, out, err = recipes(capsys, place, tmp_path, *SMALL)
    check_bad(status, out, err)
    assert "not a folder of table1" in err
    assert not list(tmp_path.iterdir())
