"""The paper's figures: what is computed is kept, and drawn from that alone; and the tools that draw."""

import json

import numpy as np
import pytest
from commands import check_bad, run

from paper import figures, gallery
from paper.data import own_shape
from paper.drawing import bounded, grid, moment, numbered, pack, pack_numbers, packed, raster, unpack, unpack_numbers
from warp_bounding.errors import BoundingError
from warp_bounding.indicators import IndicatorGrid


class Line(figures.Figure):
    """Two numbers; ``log`` says how often they were computed."""

    name = "kdop"  # whose section of the page it gets
    objects = {"2d/star1": "2d/star"}  # noqa: RUF012
    log: list = []  # noqa: RUF012
    fails = ""

    def parts(self, work):
        def compute(name):
            if name == self.fails:
                raise BoundingError("it is not possible")
            self.log.append(name)
            return {"value": len(name)}

        return {name: lambda name=name: compute(name) for name in ("first", "second")}

    def draw(self, parts):
        return {"png": b"picture", "svg": json.dumps(parts["second"]["value"]).encode()}

    def facts(self, parts):
        return [f"It is {parts['first']['value']}."]


@pytest.fixture
def line(monkeypatch):
    figure = Line()
    figure.log = []
    monkeypatch.setattr(gallery, "FIGURES", (figure, gallery.Objects()))
    return figure


def test_parts_are_kept_and_drawn(line, tmp_path, capsys):
    line.fails = "second"
    status, _, err = run(capsys, "figures", "all", "--out", tmp_path)
    assert status == 1
    assert "failed: kdop: it is not possible" in err
    assert "skipped: objects shows the paper's objects" in err
    assert not (tmp_path / "kdop.png").exists()
    line.fails = ""
    assert run(capsys, "figures", "all", "--out", tmp_path)[0] == 0
    assert line.log == ["first", "second"]
    page, document = (tmp_path / "README.md").read_text(), json.loads((tmp_path / "kdop.json").read_text())
    assert "(kdop.png)" in page
    assert "It is 5." in page
    assert "teaser" not in page
    assert document["objects"]["2d/star1"]
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert run(capsys, "figures", "all", "--out", tmp_path)[0] == 0
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    for content in ("{", json.dumps(document | {"format": 2}), json.dumps(document | {"settings": {"seed": 5}})):
        (tmp_path / "kdop.json").write_text(content)
        check_bad(*run(capsys, "figures", "kdop", "--out", tmp_path))
        assert (tmp_path / "kdop.json").read_text() == content


def test_a_small_run(tmp_path, capsys):
    words = ("figures", "kdop", "--quick", "--effort", "0.1", "--out", tmp_path, "--samples", "20000")
    status, _, err = run(capsys, *words)
    assert status == 0, err
    parts = json.loads((tmp_path / "kdop.json").read_text())["parts"]
    learned = {name: part for name, part in parts.items() if name.endswith(" learned-kdop")}
    assert len(learned) == 3
    for name, part in learned.items():
        fixed = parts[name.replace("learned-kdop", "kdop")]
        assert (part["fn"], part["certificate"], fixed["fn"], fixed["certificate"]) == (0, "proven", 0, "proven")
        assert part["fp"] <= fixed["fp"] + 0.5
    assert (tmp_path / "kdop.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "kdop.svg").read_bytes()


@pytest.mark.slow
def test_all_of_them(tmp_path, capsys):
    assert run(capsys, "figures", "all", "--quick", "--effort", "0.1", "--out", tmp_path)[0] == 0
    assert (tmp_path / "README.md").read_text().count("![") == len(gallery.FIGURES) - 1


@pytest.mark.parametrize("figure", gallery.FIGURES, ids=lambda f: f.name)
def test_parts_are_computed_only_when_called_and_stand_ins_exist(figure):
    for label, own in figure.objects.items():
        assert own is None or f"{own_shape(own).ndim}d" == label[:2] == own[:2]
    if all(figure.objects.values()):
        work = figures.Work(figures.DEFAULTS, stand_ins=dict(figure.objects))
        assert all(callable(compute) for compute in figure.parts(work).values())


def test_a_promise_that_is_broken():
    part = {"fp": 1.0, "fn": 5, "samples": 1000}
    assert numbered(part) == "FP 1.00 %, FN 0.50 %"
    parts = {"a": part | {"certificate": ""}, "b": part | {"certificate": "proven"}}
    assert Line().broken(parts) == ["b: 5 false negatives"]
    run_ = {"section": "s", "bounder": "mlp", "certificate": "proven", "missed": 2, "identical": False}
    assert gallery.Digits().broken({"digits": {"runs": [run_]}}) == ["digits, s: 2 missed"]


def test_rasters_show_the_cells_and_stand_upright(rng):
    cells = np.zeros((4, 3), dtype=bool)
    cells[3, 0] = True  # coordinate 0 large, coordinate 1 small: below, at the right
    mask = unpack(packed(IndicatorGrid(cells), raster(IndicatorGrid(cells), 12)))
    assert (mask == np.kron(cells, np.ones((3, 4), dtype=bool))).all()
    image = bounded(mask, ~mask, "#ff8800")
    assert (image[-1, -1] == (224, 47, 47)).all()  # denied
    assert (image[0, 0] == (255, 136, 0)).all()
    animated = IndicatorGrid(rng.random((3, 2, 4, 4)) < 0.5, time=True)
    shown = unpack(packed(animated, raster(animated, 4, moment(animated, 1))))
    assert (shown[::2] == animated.occupancy[1]).all()
    assert np.allclose(unpack_numbers(pack_numbers(rng.random((3, 4)))).shape, (3, 4))
    assert (unpack(pack(shown)) == shown).all()
    assert set(grid([[lambda axes: axes.plot([0, 1])]])) == {"png", "svg"}
