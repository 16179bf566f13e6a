"""The figure of the generative model: what it keeps of the demo, and what it says."""

import json

import numpy as np
import pytest

from paper.drawing.base import Tools, Work
from paper.drawing.settings import FigureSettings
from paper.figures.digits import Digits
from warp_bounding.errors import BoundingError

RUN = {"section": "3 latent numbers", "narrow_calls": 5, "asked": 100.0, "faster": 1.0, "missed": 0, "identical": True}
RUNS = [
    RUN | {"bounder": "none", "certificate": "", "fp_rate": None},
    RUN | {"bounder": "mlp", "certificate": "proven", "fp_rate": 7.12, "asked": 38.2, "faster": 1.84},
    RUN | {"bounder": "occupancy", "certificate": "", "fp_rate": 0.7, "missed": 1234, "identical": False},
]


def demo(drawn: bool = True):
    def run(name, folder, quick):
        from PIL import Image

        assert (name, quick) == ("digits", True)
        if drawn:
            Image.fromarray(np.full((40, 120, 3), 200, np.uint8)).save(folder / "digits.png")
            (folder / "digits.svg").write_text("<svg/>")
        return {"runs": RUNS}

    return Work(FigureSettings.of({"quick": True}), None, Tools(lambda scenes: [], run))


def test_the_demo_is_kept_drawn_and_told():
    figure, work = Digits(), demo()
    parts = {name: json.loads(json.dumps(part())) for name, part in figure.parts(work).items()}
    assert [run["bounder"] for run in parts["digits"]["runs"]] == ["none", "mlp", "occupancy"]
    files = figure.draw(parts, work.tools)
    assert any(data[:4] == b"\x89PNG" for data in files.values())
    assert files["svg"] == b"<svg/>"
    (fact,) = figure.facts(parts)
    assert "3 latent numbers: proven, 7.1 % false positives" in fact
    assert "run for 38 % of the pixels, 1.8 times as fast, 0 pixels of ink missed" in fact
    assert "no proof: 1,234" in fact
    assert figure.broken(parts) == []
    parts["digits"]["runs"][1] |= {"missed": 2, "identical": False}
    assert figure.broken(parts) == ["3 latent numbers: 2 pixels missed"]


def test_a_demo_that_drew_nothing_is_an_error():
    (part,) = Digits().parts(demo(drawn=False)).values()
    with pytest.raises(BoundingError, match="the demo digits drew nothing"):
        part()
