"""What demos print and return: promises kept or broken, tables, and the page of results."""

import json

import pytest

import warp_bounding as wb
from sims.page import page
from sims.report import Run, kept, result, verdict

NONE = Run("none", 100, 0.0, 2.0, 3.0, 0, True)


def of(name, certificate, missed=0, identical=True, section="", cells=None):
    return Run(name, 40, 0.5, 1.0, 2.0, missed, identical, 5.0, cells, certificate, section)


def test_what_is_proven_must_be_kept():
    good = [NONE, of("mlp", "proven"), of("occupancy", "", missed=7, identical=False)]
    assert kept(good)
    assert verdict(good).startswith("The 1 run with proven bounders missed none of the contacts")
    assert "which has no proof, missed 7 contacts" in verdict(good)
    for broken in (
        of("mlp", "proven", missed=1),
        of("mlp", "proven", identical=False),
        of("box", "by construction", 1),
    ):
        assert not kept([*good, broken])
        assert "Broken promise" in verdict([*good, broken])


def test_what_is_statistical_is_no_promise():
    runs = [NONE, of("mlp", "statistical", missed=3, identical=False)]
    assert kept(runs)
    assert "whose certificate is statistical, missed 3 contacts" in verdict(runs)
    assert "proven" not in verdict(runs)
    assert "missed none" in verdict([NONE, of("mlp", "statistical")])


def test_a_page_of_what_a_demo_printed(tmp_path):
    with pytest.raises(wb.BoundingError, match=r"expected files such as particles\.json"):
        page(tmp_path)
    (tmp_path / "path.json").write_text("")
    with pytest.raises(wb.BoundingError, match="expected what a demo prints"):
        page(tmp_path)
    runs = [NONE, of("mlp", "proven"), of("occupancy", "", missed=1234, identical=False)]
    (tmp_path / "path.json").write_text(json.dumps(result("path", "rooms", 1, runs, [])))
    text = page(tmp_path)
    assert "| none | 100 |" in text
    assert "| `mlp` | 40 | 0.50 | 1.00 | 2.00 | 0 | 5.00 | proven | identical |" in text
    assert "**1,234**" in text
