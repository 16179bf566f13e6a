"""*Digits*: a generative model, bounded before it is run."""

import base64
import io
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from paper.drawing.base import Figure
from paper.drawing.canvas import page, show
from warp_bounding.errors import BoundingError

__all__ = ["Digits"]

DEMO, PICTURE, LINES = "digits", "digits.png", "digits.svg"
PROVEN, UNPROVEN = "mlp", "occupancy"
WIDTH = 9.6  # of the page, inches


class Digits(Figure):
    """See module."""

    name = "digits"
    title = "A generative model, bounded before it is run"
    paper = "Fig. 12"
    caption = (
        "Random digits of three variational auto-encoders of scikit-learn's digits, whose decoders take 2, 3 or 10 latent numbers and "
        "the coordinates of a pixel (grey: how likely there is ink), and the border (blue) of the pixels for which a network with two "
        "layers of 25 lets the decoder be run. With 2 and 3 latent numbers it is proven, by bounds of both networks, that no pixel of "
        "any digit lies outside; with 10, as in the paper, where nothing is proven, the certificate is statistical. Latent numbers lie "
        "between -2 and 2 standard deviations. The paper's digits are those of MNIST."
    )

    def parts(self, work):
        return {DEMO: partial(self._demo, work)}

    @staticmethod
    def _demo(work) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            told = work.tools.run_demo(DEMO, Path(folder), work.choose(False, True))
            work.heed()
            path = Path(folder) / PICTURE
            if not path.is_file():
                raise BoundingError(f"the demo {DEMO} drew nothing")
            picture, lines = base64.b64encode(path.read_bytes()).decode(), (Path(folder) / LINES).read_text()
        keys = ("bounder", "section", "missed", "identical", "certificate", "fp_rate", "asked", "faster")
        return {
            "runs": [{key: run.get(key) for key in keys} for run in told["runs"]],
            "picture": picture,
            "lines": lines,
        }

    def draw(self, parts, tools):
        from PIL import Image

        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(parts[DEMO]["picture"]))).convert("RGB"))

        def fill(figure) -> None:
            figure.set_size_inches(WIDTH, WIDTH * len(image) / image.shape[1])
            axes = figure.subplots(1, 1, gridspec_kw={"left": 0, "right": 1, "top": 1, "bottom": 0})
            show(axes, image, "")
            axes.spines[:].set_visible(False)

        lines = parts[DEMO].get("lines")  # older folders have the picture alone
        return page(fill, svg=False) | ({"svg": lines.encode()} if lines else {})

    def facts(self, parts):
        lines = []
        for run in parts[DEMO]["runs"]:
            if run["bounder"] == PROVEN:
                lines.append(
                    f"{run['section']}: {run['certificate']}, {run['fp_rate']:.1f} % false positives of the box of latent numbers and "
                    f"pixels, the decoder is run for {run['asked']:.0f} % of the pixels, {run['faster']:.1f} times as fast, "
                    f"{run['missed']:,} pixels of ink missed"
                )
            elif run["bounder"] == UNPROVEN:
                lines[-1] += f" (`occupancy`, the usual loss and no proof: {run['missed']:,})"
        return [f"{line}." for line in lines]

    def broken(self, parts):
        return [
            f"{run['section']}: {run['missed']} pixels missed"
            for run in parts[DEMO]["runs"]
            if run["certificate"] == "proven" and (run["missed"] or not run["identical"])
        ]
