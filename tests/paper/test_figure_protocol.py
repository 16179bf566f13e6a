"""The paper's figures: what each promises the command, and the tools that draw."""

import numpy as np
import pytest

from paper.drawing.base import Tools, Work
from paper.drawing.canvas import bounded, numbered, upright
from paper.drawing.masks import pack, pack_numbers, packed, raster, unpack, unpack_numbers
from paper.drawing.run import lacking, selected
from paper.drawing.settings import PAPER, FigureSettings
from paper.drawing.shapes import own_shape
from paper.figures import FIGURES
from warp_bounding.indicators import IndicatorGrid

OWN = [figure for figure in FIGURES if any(thing.own for thing in figure.objects) or not figure.objects]


def work(**settings):
    def nothing(*_):
        raise AssertionError("nothing is drawn or run here")

    return Work(FigureSettings(**settings), None, Tools(nothing, nothing))


def test_names_are_unique_and_everything_is_said():
    assert len({figure.name for figure in FIGURES}) == len(FIGURES)
    for figure in FIGURES:
        assert figure.name.replace("-", "").isalpha()
        assert figure.paper
        assert not figure.title[0].islower()
        assert figure.caption.endswith(".")
        assert len(figure.caption) > 100


@pytest.mark.parametrize("figure", OWN, ids=lambda f: f.name)
@pytest.mark.parametrize("quick", [False, True])
def test_parts_are_named_and_computed_only_when_called(figure, quick):
    parts = figure.parts(work(quick=quick))
    assert parts
    assert all(isinstance(name, str) and callable(compute) for name, compute in parts.items())
    assert not quick or len(parts) <= len(figure.parts(work(quick=False)))


def test_every_object_has_a_dimension_and_its_stand_in_exists():
    for thing in {thing for figure in FIGURES for thing in figure.objects}:
        assert thing.label[:3] in ("2d/", "3d/", "4d/")
        if thing.own:
            grid = own_shape(thing.own)
            assert f"{grid.ndim}d" == thing.label[:2]
            assert 0.02 < grid.occupancy.mean() < 0.5


def test_an_unknown_shape_of_our_own_is_refused():
    with pytest.raises(Exception, match="2d/star"):
        own_shape("2d/nobody")


def test_what_lacks_objects_is_skipped_or_refused(tmp_path):
    chosen, skipped = selected("all", FIGURES, work())
    assert [f.name for f in FIGURES if f not in chosen] == ["objects"]
    assert "--data DIR is needed" in skipped[0]
    for name, error in (("objects", "--data DIR"), ("nobody", "teaser, .*, or all, got 'nobody'")):
        with pytest.raises(Exception, match=error):
            selected(name, FIGURES, work())
    there = Work(FigureSettings(objects=PAPER), tmp_path, work().tools)
    (tmp_path / "2D").mkdir()
    (tmp_path / "2D" / "star1.png").touch()
    by_name = {figure.name: figure for figure in FIGURES}
    assert lacking(by_name["progressive"], there) is None
    assert "3d/bunny" in lacking(by_name["gallery"], there)
    assert "and 16 more" in lacking(by_name["objects"], there)


@pytest.mark.parametrize("shape", [(7,), (5, 9), (3, 4, 5)])
def test_masks_and_numbers_come_back(shape):
    mask = np.random.default_rng(0).random(shape) < 0.3
    assert (unpack(pack(mask)) == mask).all()
    numbers = np.random.default_rng(0).random(shape)
    assert np.allclose(unpack_numbers(pack_numbers(numbers)), numbers, atol=1e-3)


def test_a_raster_shows_the_cells_and_stands_upright():
    cells = np.zeros((4, 3), dtype=bool)
    cells[3, 0] = True  # coordinate 0 large, coordinate 1 small: below, at the right
    grid = IndicatorGrid(cells)
    mask = unpack(packed(grid, raster(grid, 12)))
    assert (mask == np.kron(cells, np.ones((3, 4), dtype=bool))).all()
    assert upright(mask)[-1, -1]
    image = bounded(mask, ~mask, "#ff8800")
    assert image.shape == (12, 12, 3)
    assert (image[-1, -1] == (224, 47, 47)).all()  # denied
    assert (image[0, 0] == (255, 136, 0)).all()


def test_a_raster_of_an_animated_object_is_a_moment():
    grid = IndicatorGrid(np.random.default_rng(0).random((3, 2, 4, 4)) < 0.5, time=True)
    moment = raster(grid, 4, time=float(grid.position([1, 0, 0, 0])[0]))
    assert moment.shape == (4, 4, 4, 4)
    mask = unpack(packed(grid, moment))
    assert (mask[::2] == grid.occupancy[1]).all()


def test_false_negatives_are_told():
    part = {"fp": 1.0, "fn": 0, "samples": 1000}
    assert numbered(part) == "FP 1.00 %, FN 0"
    assert numbered(part | {"fn": 5}) == "FP 1.00 %, FN 0.50 %"
    figure = FIGURES[0]
    assert figure.broken({"a": part | {"fn": 5, "certificate": ""}, "b": part | {"certificate": "proven"}}) == []
    assert figure.broken({"a": part | {"fn": 5, "certificate": "proven"}}) == ["a: 5 false negatives"]
