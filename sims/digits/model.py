"""A small generative model of handwritten digits: a variational auto-encoder whose decoder is implicit.

The decoder takes the latent numbers of an image and the coordinates of one point in it, row and column in [0, 1], and
tells whether the point is ink: its value is the logarithm of the odds. So it is a function of ``latent + 2`` numbers
whose region above 0 holds all digits that it can write. It is trained on the 1,797 images of 8 x 8 pixels that come
with scikit-learn, read between the pixels' centres by bilinear interpolation.

    python -m sims.digits.model            # trains the decoders of the demo anew: some minutes

The demo itself loads ``sims/digits/decoders``, since no two machines train the same numbers, and a proof is about
numbers. Kingma and Welling, *Auto-Encoding Variational Bayes*, 2014.
"""

import sys
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

import warp_bounding as wb
from sims.threads import threads_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = [
    "CHUNK",
    "LARGEST",
    "LATENTS",
    "LEVEL",
    "Sine",
    "codes",
    "decode",
    "decoder",
    "load",
    "one_thread",
    "pixels",
    "region",
    "rows",
    "save",
    "train",
]

FOLDER = Path(__file__).parent / "decoders"
LATENTS = {2: (32, 32), 3: (32, 32), 10: (64, 64)}  # hidden widths of the decoder, by its number of latent numbers
LARGEST = 2.0  # latent numbers lie between -LARGEST and LARGEST, in standard deviations of their prior
# Of the decoder's value, 0 at even odds. A little under 0, so that what float32 rounds when a decoder is run cannot
# make ink where the region has none: ``region`` checks that it suffices.
LEVEL = -0.01
ROUNDING_ROOM = 4.0  # times E: another library's sine differs from the kernels' by more than E may count

# Pixels that a decoder is run for at a time: always as many, so that no pixel's bits depend on the others.
CHUNK = 8192
STEPS, BATCH, POINTS = 2000, 128, 32  # of training: steps, images a step, points an image
RATE, SMALLEST = 1e-2, 1e-4  # of Adam, over a cosine
PRIOR = 0.2  # weight of the divergence from the prior, against the whole image's likelihood
DECAY = 0.05  # of the weights, so that the decoder bends no more than it must
FREQUENCY = 6.0  # by which the columns of the coordinates in the first layer are larger at the start
PIXELS = 8 * 8


class Sine(nn.Module):
    """``sin z``; ``wb.shapes.Network`` knows modules of this name."""

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        return torch.sin(z)


@contextmanager
def one_thread() -> "Iterator[None]":
    """Run decoders and bounders on one thread each, so that their times compare, also on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threads_of(1):
            yield
    finally:
        torch.set_num_threads(threads)


def images() -> torch.Tensor:
    """The digits of scikit-learn, ``(1797, 8, 8)`` in [0, 1].

    Raises:
        BoundingError: If scikit-learn is not installed.
    """
    try:
        from sklearn.datasets import load_digits
    except ImportError as error:
        raise wb.BoundingError("the digits come with scikit-learn: pip install 'warp-bounding[digits]'") from error
    return torch.tensor(load_digits().images / 16.0, dtype=torch.float32)


def decoder(latent: int, hidden: tuple[int, ...]) -> nn.Sequential:
    """An untrained decoder of ``latent + 2`` inputs and one output."""
    sizes, modules = [latent + 2, *hidden], []
    for inputs, outputs in pairwise(sizes):
        modules += [nn.Linear(inputs, outputs), Sine()]
    return nn.Sequential(*modules, nn.Linear(sizes[-1], 1))


@one_thread()
def train(
    latent: int,
    hidden: tuple[int, ...] | None = None,
    *,
    steps: int = STEPS,
    seed: int = 0,
    progress: "Callable[[int, int, float], None] | None" = None,
) -> tuple[nn.Sequential, nn.Sequential]:
    """Train encoder and decoder together.

    Args:
        latent: How many latent numbers.
        hidden: Widths of the decoder; those of ``LATENTS``, or 64 and 64, for ``None``.
        steps: Of training; the default takes about half a minute.
        seed: Of weights and samples.
        progress: Called now and then with steps done, steps in all and the loss.

    Returns:
        The encoder, from images ``(N, 8, 8)`` to means and logarithms of variances ``(N, 2 latent)``; and the decoder.
    """
    torch.manual_seed(seed)
    data = images()
    encoder = nn.Sequential(nn.Flatten(), nn.Linear(PIXELS, 128), nn.ReLU(), nn.Linear(128, 2 * latent))
    network = decoder(latent, hidden or LATENTS.get(latent, (64, 64)))
    with torch.no_grad():
        network[0].weight[:, -2:] *= FREQUENCY
    optimiser = torch.optim.AdamW([*encoder.parameters(), *network.parameters()], lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, SMALLEST)
    for step in range(steps):
        chosen = data[torch.randint(len(data), (BATCH,))]
        mean, spread = encoder(chosen).chunk(2, 1)
        z = mean + torch.randn_like(mean) * (spread / 2).exp()
        points = torch.rand(BATCH, POINTS, 2)
        ink = nn.functional.grid_sample(
            chosen[:, None], (2 * points.flip(-1) - 1)[:, None], padding_mode="zeros", align_corners=False
        )[:, 0, 0]
        value = network(torch.cat([z[:, None].expand(-1, POINTS, -1), points], 2))[..., 0]
        likelihood = nn.functional.binary_cross_entropy_with_logits(value, ink) * PIXELS
        divergence = 0.5 * (mean**2 + spread.exp() - 1 - spread).sum(1).mean()
        loss = likelihood + PRIOR * min(1.0, 2 * step / steps) * divergence
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if progress and step % 50 == 49:
            progress(step + 1, steps, loss.item())
    return encoder.requires_grad_(False), network.requires_grad_(False)


# --- the decoder as a shape
# ---------------------------------------------------------------------------------------------


def region(network: nn.Sequential, latent: int, *, largest: float = LARGEST, name: str = "") -> wb.shapes.Network:
    """All points of all digits: where the decoder's value reaches ``LEVEL``, in ``latent + 2`` dimensions.

    Args:
        network: The decoder.
        latent: Its latent numbers.
        largest: They lie between ``-largest`` and ``largest``; row and column between 0 and 1.
        name: For people.

    Raises:
        ShapeError: For a decoder of modules that no bounds are known for, or one that rounds more than ``LEVEL``.
    """
    name = name or f"digits-{latent}"
    lower, upper = [-largest] * latent + [0.0] * 2, [largest] * latent + [1.0] * 2
    shape = wb.shapes.Network(network, lower, upper, level=LEVEL, name=name)
    if ROUNDING_ROOM * shape.rounding > -LEVEL:
        raise wb.ShapeError(
            f"{name}: expected float32 to round the decoder by less than {-LEVEL / ROUNDING_ROOM:g}, got "
            f"{shape.rounding:.3g}"
        )
    return shape


def codes(count: int, latent: int, seed: int = 0) -> np.ndarray:
    """Random latent numbers ``(count, latent)`` float32, from the prior cut off at ``LARGEST``."""
    rng = np.random.default_rng(seed)
    found = rng.standard_normal((count, latent))
    while (outside := np.abs(found) > LARGEST).any():
        found[outside] = rng.standard_normal(int(outside.sum()))
    return np.clip(found.astype(np.float32), -np.float32(LARGEST), np.float32(LARGEST))


def pixels(resolution: int) -> np.ndarray:
    """Centres of the pixels of an image, ``(resolution^2, 2)`` float32 rows and columns."""
    centers = ((np.arange(resolution) + 0.5) / resolution).astype(np.float32)
    return np.stack(np.meshgrid(centers, centers, indexing="ij"), axis=-1).reshape(-1, 2)


def rows(latents: np.ndarray, points: np.ndarray) -> np.ndarray:
    """What a decoder is asked for images: ``(N P, latent + 2)`` float32, image by image, of all of their points."""
    found = np.empty((len(latents), len(points), latents.shape[1] + 2), dtype=np.float32)
    found[..., :-2], found[..., -2:] = latents[:, None], points
    return found.reshape(-1, found.shape[-1])


def decode(network: nn.Sequential, asked: np.ndarray) -> np.ndarray:
    """The decoder's value ``(N,)`` float32 of rows ``(N, latent + 2)``."""
    found = np.empty(len(asked), np.float32)
    with torch.no_grad():
        for begin in range(0, len(asked), CHUNK):
            part = torch.from_numpy(asked[begin : begin + CHUNK])
            count = len(part)
            if count < CHUNK:
                part = torch.cat([part, torch.zeros(CHUNK - count, part.shape[1])])
            found[begin : begin + count] = network(part)[:count, 0].numpy()
    return found


# --- files
# --------------------------------------------------------------------------------------------------------------


def path_of(latent: int, folder: Path = FOLDER) -> Path:
    """Where the decoder of so many latent numbers lies."""
    return Path(folder) / f"digits-{latent}.safetensors"


def save(network: nn.Sequential, latent: int, folder: Path = FOLDER) -> Path:
    """Write a decoder's weights; returns the file."""
    from safetensors.torch import save_file

    path = path_of(latent, folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    save_file({name: value.contiguous() for name, value in network.state_dict().items()}, part)
    part.replace(path)
    return path


def load(latent: int, folder: Path = FOLDER) -> nn.Sequential:
    """A stored decoder.

    Raises:
        BoundingError: If there is none, or the file holds something else.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    path = path_of(latent, folder)
    try:
        values = load_file(path)
    except (OSError, SafetensorError) as error:
        raise wb.BoundingError(
            f"{path}: expected a decoder, python -m sims.digits.model trains one ({error})"
        ) from error
    weights = [value for name, value in values.items() if name.endswith("weight")]
    network = decoder(latent, tuple(len(weight) for weight in weights[:-1]))
    try:
        network.load_state_dict(values)
    except RuntimeError as error:
        raise wb.BoundingError(f"{path}: expected a decoder of {latent} latent numbers, got other tensors") from error
    return network.requires_grad_(False)


def main(names: list[str]) -> None:
    """Train the demo's decoders, or those of the given numbers of latent numbers."""
    for latent in [int(name) for name in names] or LATENTS:
        begun = time.perf_counter()
        encoder, network = train(
            latent, progress=lambda done, all_, loss: print(f"\r{done}/{all_} {loss:.3f}", end="", file=sys.stderr)
        )
        path, mean = save(network, latent), encoder(images())[:, :latent]
        beyond = float((mean.abs() > LARGEST).any(1).float().mean())
        ink = float((network(torch.from_numpy(rows(codes(1000, latent), pixels(16)))) > 0).float().mean())
        seconds = time.perf_counter() - begun
        print(f"\r{path.name}: {seconds:.0f} s; {beyond:.1%} of the images' codes beyond {LARGEST:g}, {ink:.1%} ink")


if __name__ == "__main__":
    main(sys.argv[1:])
