"""The demo ``digits``: which pixels may belong to a digit is known before the generative model is run.

The model is a variational auto-encoder of scikit-learn's digits whose decoder is implicit: from 2, 3 or 10 latent
numbers and the row and the column of a pixel to the odds of ink (``sims.digits.model``). The region where ink is
likely, in 4, 5 or 12 dimensions, is bounded by a network of 25 and 25 neurons, once for all digits that the decoder can
write; then the decoder is run for those pixels only that the bounder leaves. With a proof, images are the same, to the
bit.

What certifies boxes of that region are the bounds of networks, applied to the decoder (``wb.shapes.Network``). With
10 latent numbers no proof ends in minutes: that region is given as a function, and its certificate is statistical. What
a proof reaches there is in ``sims.digits.neighbourhood``.

After Fig. 12 of *Neural Bounding* (Liu et al. 2024).

    python -m sims digits --output out/demo
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from torch.nn import Sequential

import warp_bounding as wb
from sims import base
from sims.digits.example import Example
from sims.digits.model import LARGEST, LATENTS, LEVEL, decode, load, region
from sims.digits.pictures import SHOWN, draw
from sims.drawing import Drawn
from sims.prefitted import FitSpec
from sims.report import UNPROVEN, Run

__all__ = ["SPECS", "Demo", "rate", "shapes", "simulate"]

NETWORK = {"hidden": (25, 25)}  # the paper's, with 12 inputs
SPECS = {  # a box of all digits is the whole image, and a k-DOP little less: they would spare nothing
    "mlp": FitSpec("mlp", budget=240.0, options=NETWORK),
    "occupancy": FitSpec("occupancy", budget=30.0, options=NETWORK),
}
PROVABLE = 3  # latent numbers: with more, no proof ends in minutes
IMAGES, RESOLUTION, STEPS = (256, 48), (28, 16), (6, 3)  # full, quick
LARGE = 96  # pixels along a side of the picture's digits
WARM_UP = 2  # images of the step that loads kernels outside the timed part


class Ink(wb.shapes.Function):
    """A function whose random queries come from its box: nobody decodes codes or pixels beyond it."""

    @property
    def sample_lower(self) -> np.ndarray:
        return self.lower

    @property
    def sample_upper(self) -> np.ndarray:
        return self.upper


def shapes(device: str = "cpu") -> dict[str, wb.shapes.Network | wb.shapes.Function]:
    """The regions whose bounders come with the demo, by the name under which these lie."""
    return {f"digits-{latent}": shape_of(load(latent), latent) for latent in LATENTS}


def shape_of(network: Sequential, latent: int) -> wb.shapes.Network | wb.shapes.Function:
    """What is bounded: the decoder's region, or, where no proof is possible, the function that the decoder computes."""
    shape = region(network, latent)
    if latent <= PROVABLE:
        return shape

    def ink(x: np.ndarray) -> np.ndarray:
        within = ((x >= shape.lower) & (x <= shape.upper)).all(axis=1)
        return within & (decode(network, x.astype(np.float32)) >= LEVEL)

    return Ink(ink, shape.lower, shape.upper, name=shape.name)  # no proof in minutes: tested statistically


def rate(bounder: wb.Bounder, shape, samples: int, seed: int = 0) -> tuple[float, int]:
    """False positives, per cent of uniform points of the box of latent numbers and pixels, and how many were missed."""
    rng, wrong, missed, done = np.random.default_rng(seed), 0, 0, 0
    while done < samples:
        count = min(samples - done, 1 << 18)
        x = rng.uniform(shape.lower, shape.upper, (count, shape.ndim)).astype(np.float32)
        maybe, held = bounder.query(x).numpy(), shape.contains(x)
        wrong, missed, done = wrong + int((maybe & ~held).sum()), missed + int((held & ~maybe).sum()), done + count
    return 100 * wrong / samples, missed


@dataclass
class Demo(base.Demo):
    """Random digits of three decoders; see module, and ``sims.base.Demo``.

    Attributes:
        steps: Batches of images; 6, or 3 if quick.
    """

    steps: int | None = None

    NAME = "digits"
    SPECS = SPECS
    SAMPLES = (200_000, 20_000)
    CALLS = "pixels run"
    MISSED = "pixels of ink"

    def set_up(self) -> dict[str, Any]:
        self.choose(steps=STEPS)
        if self.steps < 1:
            raise wb.BoundingError(f"steps must be at least 1, got {self.steps}")
        self.networks = {f"digits-{latent}": (load(latent), latent) for latent in LATENTS}
        self.shape = ", ".join(self.networks)
        self.regions = shapes()
        return self.regions

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        sizes = {"images": IMAGES[self.quick], "resolution": RESOLUTION[self.quick], "seed": self.seed}
        runs, samples = [], self.SAMPLES[self.quick]
        for name, (network, latent) in self.networks.items():
            for row in self.rows[name]:  # of the box itself, not of the wider one that a rate of any shape is of
                row["fp_rate"], row["fn"] = rate(self.bounders[row["bounder"]][name], self.regions[name], samples)
            bounders = {method: {name: found[name]} for method, found in self.bounders.items()}
            examples = simulate(network, latent, self.of_shape(name), steps=self.steps, **sizes)
            section = f"{latent} latent numbers, decoder {latent + 2}-{'-'.join(map(str, LATENTS[latent]))}-1"
            runs += base.compare(examples, bounders, self.rows[name], section)
        side = RESOLUTION[self.quick]
        about = f"{self.steps} batches of {IMAGES[self.quick]} digits of {side} x {side} pixels; per batch"
        return runs, about, {"asked": "run %", "faster": "faster"}

    def draw(self) -> Drawn:
        series = []
        for name, (network, latent) in self.networks.items():
            example = Example(network, latent, self.bounders["mlp"][name], images=SHOWN, resolution=LARGE, seed=1)
            reference = Example(network, latent, images=SHOWN, resolution=LARGE, seed=1)
            for each in (example, reference):
                each.step()
            kind = base.weakest([example.bounder])
            if kind == "proven" and not example.identical(reference):
                self.notes.append(
                    "[bold red]Broken promise: the large picture is not the one without a broad phase.[/]"
                )
            spared = 1 - example.calls[0] / reference.calls[0]
            title = f"{latent} latent numbers, {kind}: the decoder is spared {spared:.0%} of the pixels"
            series.append((title, reference.values, example.values))
        return Drawn([draw(self.out, series)])

    def more(self) -> dict[str, Any]:
        """``images`` (a batch), ``resolution``, ``largest`` (of latent numbers), ``bounders``: rows of each shape."""
        about = {"images": IMAGES[self.quick], "resolution": RESOLUTION[self.quick], "largest": LARGEST}
        return {**about, "unproven": list(UNPROVEN), "bounders": self.rows}


def simulate(network, latent: int, methods: dict[str, wb.Bounder], *, steps: int, **sizes) -> dict[str, Example]:
    """The same digits without a broad phase and with each of the bounders; see ``sims.base.simulate``.

    Args:
        network: The decoder.
        latent: Its latent numbers.
        methods: Bounders of its region by name.
        steps: Batches of each series.
        sizes: Options of ``Example``.
    """

    def series(bounder: wb.Bounder | None, small: bool) -> Example:
        return Example(network, latent, bounder, **(sizes | {"images": WARM_UP} if small else sizes))

    return base.simulate(f"digits of {latent} latent numbers", methods, series, steps)
