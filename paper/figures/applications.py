"""*Applications*: the four demos, with a proven network and with one that is not."""

import base64
import io
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from paper.drawing.base import Figure
from paper.drawing.canvas import page, show, with_palette
from warp_bounding.errors import BoundingError

__all__ = ["Applications"]

# The picture that a demo draws, the share of its height that is shown, and what is said of it.
DEMOS = {
    "path": ("path.png", 0.482, "2D paths"),
    "cloth": ("cloth.png", 1.0, "cloth on a mesh"),
    "particles": ("rain.png", 1.0, "particles on a moving mesh"),
    "shadows": ("shadows.png", 1.0, "shadow rays"),
}
WIDTH = 1000  # pixels of a stored picture
PROVEN, UNPROVEN = "mlp", "occupancy"


class Applications(Figure):
    """See module."""

    name = "applications"
    title = "Simulations, with a proof and without"
    paper = "the paper's figure of applications"
    caption = (
        "Four simulations whose broad phase is a network, in the quick form of `python -m sims`; left in each picture with a proof "
        "(`mlp`), right without (`occupancy`). Planned paths collide where the network denies a piece of a wall (red rings); cloth sinks "
        "into the mesh; drops lose contacts (red); shadows have holes. With a proof every result is that of the run without a "
        "broad phase, to the bit."
    )

    def parts(self, work):
        return {name: partial(self._demo, work, name) for name in DEMOS}

    @staticmethod
    def _demo(work, name: str) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            told = work.tools.run_demo(name, Path(folder), True)
            work.heed()
            path = Path(folder) / DEMOS[name][0]
            if not path.is_file():
                raise BoundingError(
                    f"the demo {name} drew nothing: off-screen drawing needs OpenGL (libEGL or libOSMesa)"
                )
            picture = base64.b64encode(with_palette(path.read_bytes(), width=WIDTH)).decode()
        runs = [
            {key: run[key] for key in ("bounder", "section", "missed", "identical", "certificate")}
            for run in told["runs"]
            if run["bounder"] in (PROVEN, UNPROVEN)
        ]
        return {"runs": runs, "steps": told["steps"], "picture": picture}

    def draw(self, parts, tools):
        from PIL import Image

        pictures = {}
        for name, (_, share, _) in DEMOS.items():
            image = np.asarray(Image.open(io.BytesIO(base64.b64decode(parts[name]["picture"]))).convert("RGB"))
            pictures[name] = image[: round(share * len(image))]
        lines = [list(DEMOS)[:2], list(DEMOS)[2:]]
        heights = [max(len(pictures[n]) / pictures[n].shape[1] for n in line) for line in lines]

        def fill(figure) -> None:
            figure.set_size_inches(12.0, 5.95 * sum(heights) + 0.7)
            place = {"left": 0.005, "right": 0.995, "top": 0.96, "bottom": 0.01, "hspace": 0.1, "wspace": 0.02}
            panels = figure.subplots(2, 2, gridspec_kw=place | {"height_ratios": heights})
            for axes, name in zip(panels.flat, DEMOS, strict=True):
                show(axes, pictures[name], DEMOS[name][2])
                axes.set_anchor("N")
                axes.spines[:].set_visible(False)

        return page(fill, svg=False)

    def facts(self, parts):
        lines = []
        for name, part in parts.items():
            told = [
                f"`{run['bounder']}`{' ' + run['section'] if run['section'] else ''} missed {run['missed']:,}"
                for run in part["runs"]
            ]
            lines.append(f"{name} (steps: {part['steps']}): {', '.join(told)}")
        return [f"What was missed (contacts, colliding states and edges, shadow pixels): {'; '.join(lines)}."]

    def broken(self, parts):
        return [
            f"{name}: {run['missed']} missed"
            for name, part in parts.items()
            for run in part["runs"]
            if run["bounder"] == PROVEN and (run["missed"] or not run["identical"])
        ]
