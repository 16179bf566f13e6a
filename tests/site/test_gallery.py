"""The gallery: cards of notebooks from what they hold, without executing them."""

import base64
import io
import json

import pytest

Image = pytest.importorskip("PIL.Image", reason="thumbnails need pillow: pip install '.[train]'")

from gallery import card, gallery, picture, summary  # noqa: E402
from stage import ROOT  # noqa: E402


def notebook(text: str, *sizes: tuple[int, int]) -> dict:
    outputs = []
    for size in sizes:
        content = io.BytesIO()
        Image.new("L", size).save(content, "PNG")
        outputs.append({"data": {"image/png": base64.b64encode(content.getvalue()).decode()}})
    cells = [{"cell_type": "markdown", "source": [text]}, {"cell_type": "code", "source": [], "outputs": outputs}]
    return {"cells": cells}


def test_the_largest_picture_is_shown():
    assert picture(notebook("# A\n\nb", (10, 20), (30, 30), (5, 5))).size == (30, 30)
    assert picture(notebook("# A\n\nb")) is None


def test_a_summary_is_whole_sentences():
    long = "word " * 40
    assert summary(notebook(f"# Title\n\nOne *sentence*. Two $x$\nlines? {long.capitalize()}.\n\nMore.")) == (
        "Title",
        "One *sentence*. Two $x$ lines?",
    )
    with pytest.raises(ValueError, match="begins with a title"):
        summary(notebook("no title"))


def test_a_card_has_a_thumbnail_beside_the_notebook(tmp_path):
    (tmp_path / "notebooks").mkdir()
    path = tmp_path / "notebooks/a.ipynb"
    path.write_text(json.dumps(notebook("# A\n\nText.", (2000, 1000))))
    text = card(path, tmp_path)
    assert ":link: notebooks/a\n" in text
    assert ":img-top: notebooks/a.png\n" in text
    with Image.open(tmp_path / "notebooks/a.png") as small:
        assert small.size == (640, 320)
    path.write_text(json.dumps(notebook("# A\n\nText.")))
    assert "img-top" not in card(path, tmp_path)


def test_every_notebook_can_be_shown(tmp_path):
    (tmp_path / "notebooks").mkdir()
    names = sorted(path.name for path in (ROOT / "notebooks").glob("*.ipynb"))
    for name in names:
        (tmp_path / "notebooks" / name).write_bytes((ROOT / "notebooks" / name).read_bytes())
    gallery(sorted((tmp_path / "notebooks").glob("*.ipynb")), tmp_path)
    text = (tmp_path / "gallery.md").read_text()
    assert text.count("grid-item-card") == text.count(":img-top:") == len(names) > 5
