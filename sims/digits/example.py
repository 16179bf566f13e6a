"""Images of many digits, batch by batch: the decoder is run for all pixels, or for those only that a bounder leaves."""

from pathlib import Path

import numpy as np
from torch import nn

import warp_bounding as wb
from sims import base
from sims.digits.model import codes, decode, one_thread, pixels, rows
from sims.digits.pictures import draw_one

__all__ = ["Example"]


class Example(base.Example):
    """Decodes random digits, one batch a step.

    Attributes:
        seconds: Per step: broad phase, narrow phase (the decoder), whole step.
        calls: Per step: pixels that the decoder was run for.
        values: Of the last step: ``(N, resolution, resolution)`` float32, the decoder's value; minus infinity where it
            was not run.
    """

    LOST = "pixels of ink were lost"
    DIFFER = "the images differ"

    def __init__(
        self,
        network: nn.Sequential,
        latent: int,
        bounder: wb.Bounder | None = None,
        *,
        images: int = 64,
        resolution: int = 28,
        seed: int = 0,
    ):
        """Begin with the first batch.

        Args:
            network: The decoder.
            latent: Its latent numbers.
            bounder: Of its region; ``None`` for none.
            images: Images a step.
            resolution: Pixels along a side.
            seed: Of the random digits; runs with the same one decode the same.
        """
        super().__init__()
        self.network, self.latent, self.bounder = network, latent, bounder
        self.images, self.resolution, self.seed = images, resolution, seed
        self.points = pixels(resolution)
        self.values = np.empty((0, resolution, resolution), np.float32)
        self._states: list[bytes] = []
        self.ink = 0

    def step(self) -> None:
        """One batch, timed phase by phase; what the decoder is asked is laid out before."""
        asked = rows(codes(self.images, self.latent, self.seed + len(self.calls)), self.points)
        device = self.bounder.device if self.bounder is not None else "cpu"
        with one_thread():
            self._step(asked, device)

    def _step(self, asked: np.ndarray, device) -> None:
        begin = base.now(device)
        chosen = None
        if self.bounder is not None:
            candidates, count = self.bounder.candidates(asked)
            chosen = candidates.numpy()[: int(count.numpy()[0])]
        found = base.now(device)
        values = np.full(len(asked), -np.inf, np.float32)
        if chosen is None:
            values[:] = decode(self.network, asked)
        else:
            values[chosen] = decode(self.network, asked[chosen])
        ink = values >= 0
        end = base.now(device)
        self.seconds.append((found - begin, end - found, end - begin))
        self.calls.append(len(asked) if chosen is None else len(chosen))
        self._states.append(np.packbits(ink).tobytes() + values[ink].tobytes())
        self.ink += int(ink.sum())
        self.values = values.reshape(self.images, self.resolution, self.resolution)

    def render(self, folder: Path) -> list[Path]:
        return [draw_one(folder, self.values, self.latent)]

    def state(self) -> bytes:
        """Which pixels are ink, and the decoder's value there."""
        return b"".join(self._states)

    def missed(self, reference: "Example | None" = None) -> int:
        return 0 if reference is None else reference.ink - self.ink  # where a pixel is ink the decoder was run

    def extra(self, reference: "Example") -> dict[str, float]:
        """Per cent of the pixels that the decoder runs for, and a step's speed-up over one without a bounder."""
        share = 100 * sum(self.calls) / sum(reference.calls)
        return {"asked": round(share, 2), "faster": round(reference.milliseconds()[2] / self.milliseconds()[2], 3)}
