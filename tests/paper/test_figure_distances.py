"""The figure of distances: what it promises, computed in little time."""

import pytest

from paper.drawing.base import Tools, Work
from paper.drawing.masks import unpack_numbers
from paper.drawing.settings import FigureSettings
from paper.figures.distances import RADII, Distances

pytest.importorskip("matplotlib", reason="matplotlib is not installed")


def test_a_gap_that_is_never_negative():
    figure = Distances()
    work = Work(FigureSettings(quick=True, effort=0.1, samples=5000), None, Tools(list, dict))
    parts = {name: compute() for name, compute in figure.parts(work).items()}
    assert list(parts) == ["2d/star1", "2d/star1 mlp", "2d/bunny", "2d/bunny mlp"]
    for label in ("2d/star1", "2d/bunny"):
        own = parts[f"{label} mlp"]
        assert (own["certificate"], own["fn"], len(own["rates"])) == ("proven", 0, len(RADII))
        assert unpack_numbers(own["gap"]).min() >= 0
        assert 0 <= own["least"] <= own["mean"] <= own["most"]
    files = figure.draw(parts, work.tools)
    assert files["png"].startswith(b"\x89PNG")
    assert b"<svg" in files["svg"]
    assert [line.partition(":")[0] for line in figure.facts(parts)] == ["2d/star1", "2d/bunny"]
