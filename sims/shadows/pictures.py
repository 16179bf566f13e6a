"""``shadows.png``: the still life in the sun, shaded from the demo's own pixels; shadow that a bounder has lost is red.

Light is counted in linear units: a sun (Lambert) where no object stops the pixel's ray, and a sky from above. Each
pixel of the picture is the mean of ``OVERSAMPLING`` x ``OVERSAMPLING`` of the demo's, each with a shadow ray of its
own.
"""

from pathlib import Path

import numpy as np

from sims.base import Example
from sims.drawing import CAPTIONS, INK

__all__ = ["OVERSAMPLING", "draw", "draw_one", "shaded"]

OVERSAMPLING = 2
SKY_HIGH, SKY_LOW = np.array([0.42, 0.58, 0.80]), np.array([0.86, 0.90, 0.94])  # linear
SUNLIGHT, SKYLIGHT = np.array([1.0, 0.93, 0.80]) * 0.82, np.array([0.62, 0.76, 1.0]) * 0.30
FLOOR, TILE = np.array([0.66, 0.64, 0.60]), np.array([0.57, 0.55, 0.52])
THINGS = np.array([[0.74, 0.66, 0.55], [0.36, 0.17, 0.08], [0.30, 0.38, 0.46]])  # the first objects; then again
TILES = 1.0  # world units a side
HAZE = (7.0, 20.0)  # distances at which the floor begins to fade, and is gone
LOST = (0.86, 0.03, 0.05)  # linear, of a shadow pixel that was lost
PALE = "#5b6771"
BAND, GAP = 46, 12  # pixels above a panel for its title, and between panels
DPI = 100


def shaded(example: Example, step: int = -1) -> np.ndarray:
    """A picture of a series, ``(H, W, 3)`` float64, linear light."""
    scene, seen = example.scene, example.scene.seen
    height, width = seen.things.shape
    number = step if step >= 0 else len(example.shadows) + step
    sun = example.suns[number % len(example.suns)].astype(np.float64)
    rows = np.linspace(0.0, 1.0, height)[:, None, None]
    colour = np.broadcast_to(SKY_HIGH * (1 - rows) + SKY_LOW * rows, (height, width, 3)).copy()
    points = np.zeros((height * width, 3))
    points[seen.pixels] = seen.points.numpy()
    points = points.reshape(height, width, 3)
    squares = np.floor(points[..., [0, 2]] / TILES).sum(axis=-1).astype(int) % 2
    albedo = np.where(squares[..., None] == 0, FLOOR, TILE)
    for thing in range(1, len(scene.shapes) + 1):
        albedo[seen.things == thing] = THINGS[(thing - 1) % len(THINGS)]
    face = np.zeros((height * width, 3))
    face[seen.pixels] = seen.normals.numpy()
    facing = (face.reshape(height, width, 3) @ sun > 0) & (example.shadows[step] == 0)
    lambert = np.where(facing, np.clip(seen.smooth @ sun, 0.0, 1.0), 0.0)
    open_sky = 0.62 + 0.38 * seen.smooth[..., 1]
    light = lambert[..., None] * SUNLIGHT + open_sky[..., None] * SKYLIGHT
    fade = np.clip((seen.depths - HAZE[0]) / (HAZE[1] - HAZE[0]), 0.0, 1.0)
    fade = np.where(seen.things == 0, fade * fade * (3 - 2 * fade), 0.0)[..., None]
    ground = albedo * light * (1 - fade) + colour * fade
    return np.where(seen.things[..., None] < 0, colour, ground)


def _panel(example: Example, reference: Example, oversampling: int) -> np.ndarray:
    """``(H, W, 3)`` uint8 sRGB: the last picture, what it lost in red, brought to its size."""
    light = shaded(example)
    light[example.lost(reference)] = LOST
    height, width = (side // oversampling for side in light.shape[:2])
    light = light[: height * oversampling, : width * oversampling]
    blocks = light.reshape(height, oversampling, width, oversampling, 3)
    light = np.clip(blocks.mean(axis=(1, 3)), 0.0, 1.0)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


def _title(name: str, example: Example, reference: Example) -> tuple[str, str, str]:
    """What stands above a panel: a word, a sentence, the word's colour."""
    lost = int(example.lost(reference).sum())
    bounders = (example.bounders or {}).values()
    if example is reference:
        word = "no broad phase" if not bounders else " and ".join(sorted({b.method for b in bounders}))
        return word, f"{example.calls[-1]:,} mesh rays", INK
    share = 1.0 - example.calls[-1] / reference.calls[-1]
    spared = f"{100 * share:.0f} % of mesh rays spared"
    same = example.shadows[-1].tobytes() == reference.shadows[-1].tobytes()
    word = CAPTIONS.get(name, name)
    if same:
        return word, f"identical, every pixel, to the picture without culling; {spared}", INK
    pixels = int((reference.shadows[-1] != 0).sum())
    return word, f"{100 * lost / max(pixels, 1):.1f} % of the shadow is missing (red); {spared}", INK


def draw(folder: Path, reference: Example, examples: dict[str, Example], *, oversampling: int = OVERSAMPLING) -> Path:
    """Draw the last pictures of some series side by side.

    Args:
        folder: Where ``shadows.png`` goes; made if there is none.
        reference: The series without a broad phase, of the same scene.
        examples: By name.
        oversampling: Pixels of the demo per pixel of the picture, along each side.

    Returns:
        The file; it is replaced only whole.
    """
    from matplotlib.figure import Figure

    panels = [_panel(example, reference, oversampling) for example in examples.values()]
    height, width = panels[0].shape[:2]
    size = (len(panels) * (width + GAP) + GAP, height + BAND + GAP)
    figure = Figure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI, facecolor="white")
    for place, ((name, example), panel) in enumerate(zip(examples.items(), panels, strict=True)):
        left = GAP + place * (width + GAP)
        figure.figimage(panel, xo=left, yo=GAP, origin="upper")
        word, sentence, colour = _title(name, example, reference)
        across = left / size[0]
        figure.text(across, 1 - 7 / size[1], word, size=11, color=colour, va="top")
        figure.text(across, 1 - 27 / size[1], sentence, size=9.5, color=PALE, va="top")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "shadows.png"
    part = folder / ".shadows.part.png"
    figure.savefig(part, dpi=DPI)
    return part.replace(path)


def draw_one(example: Example, folder: Path) -> Path:
    """Draw the last picture of one series as it is, with nothing to compare it with."""
    return draw(folder, example, {"": example}, oversampling=1)
