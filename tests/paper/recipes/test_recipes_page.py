"""What is shown of recipes: steps that were done and asked for, hours, rates with a proof and without."""

import dataclasses

import pytest
from fake_library import make_row

from paper.columns import COLUMNS, Variant
from paper.folder import open_folder
from paper.pages.markdown import page, write_page
from paper.recipes.page import section
from paper.recipes.rows import FOLDER, WAYS, RecipeRow, RecipeSettings, read_rows
from warp_bounding.errors import FileFormatError

POINT = COLUMNS[0]


def recipe_row(way, **fields) -> RecipeRow:
    """A row that could have been measured with the default settings."""
    values = {
        "dimension": POINT.ndim,
        "object": "bunny",
        "query": POINT.query,
        "method": "mlp",
        "way": way,
        "steps": 4321,
        "steps_asked": 70_000 if "paper" in way else None,
        "step_seconds": 0.18,
        "fp_rate": 9.5,
        "fn": 0,
        "fp_zero": 3.25,
        "fn_zero": 1000,
        "positives": 30.0,
        "certificate": "proven",
        "fit_seconds": 600.0,
        "nbytes": 3000,
        "hidden": "25-25",
        "threads": 2,
        "indicator": "0" * 16,
        "versions": "warp-bounding 0",
    }
    return RecipeRow(**values | RecipeSettings().of_row(POINT, Variant("mlp")) | fields)


ROWS = [recipe_row(way) for way in reversed(WAYS)]


def test_hours():
    assert ROWS[0].hours_asked == pytest.approx(3.5)
    assert recipe_row("default").hours_asked is None


def test_the_section():
    text = "\n".join(section(ROWS))
    line = "| 2D point | bunny | the paper's recipe | 4,321 | 70,000 | 3.5 h | 9.50 | 3.25 | 0.250 | 3.2 |"
    assert line in text
    assert "| 2D point | bunny | ours | 4,321 | – | – |" in text
    assert text.index("| ours |") < text.index("| ours, positional encoding |") < text.index(line)
    assert section([]) == []
    assert "35 min" in "\n".join(section([recipe_row("paper", step_seconds=0.03)]))
    assert "9.50<sup>s</sup>" in "\n".join(section([recipe_row("paper", certificate="statistical")]))


def test_table_1_shows_what_is_there(tmp_path):
    with open_folder(tmp_path, {}, create=True) as folder:
        folder.append(make_row(POINT, Variant("aabb")))
        assert read_rows(folder.path) == []
        assert "positional encoding" not in page(folder)
        with open_folder(tmp_path / FOLDER, {}, create=True, kind=RecipeRow) as own:
            for row in ROWS:
                own.append(row)
        assert read_rows(folder.path) == ROWS
        write_page(folder)
        text = folder.page.read_text()
    assert text.index("## False positives, exact") < text.index("## The paper's recipe") < text.index("## Details")


def test_a_torn_line_is_left_out_and_damage_is_told(tmp_path):
    with open_folder(tmp_path / FOLDER, {}, create=True, kind=RecipeRow) as own:
        own.append(ROWS[0])
        path = own.table
    path.write_text(path.read_text() + ROWS[1].line[:30])
    assert read_rows(tmp_path) == [ROWS[0]]
    path.write_text(path.read_text() + "\n")
    with pytest.raises(FileFormatError, match="damaged"):
        read_rows(tmp_path)
    path.write_text("other,columns\n")
    with pytest.raises(FileFormatError, match="not a table of this version"):
        read_rows(tmp_path)


def test_rows_of_other_settings_do_not_agree():
    assert ROWS[0].agrees(RecipeSettings())
    assert not dataclasses.replace(ROWS[0], seconds=5.0).agrees(RecipeSettings())
