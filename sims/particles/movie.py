"""The rain as a moving picture, with a counter of exact tests: ``python -m sims.particles.movie --out docs/rain.webp``.

The proven network's run and the run without a bound are simulated side by side, and end in the same state, to the bit.
Every other step is drawn: the drops that the bound says *maybe* about, and lines for a few of the others. It takes some
minutes on two cores.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np

from sims.drawing import STONE, draw_with, panels, polygons, upright
from warp_bounding.runtime.progress import quiet_warp

__all__ = ["draw", "movie"]

SIZE, HEAD = 480, 76  # pixels of a frame's side, and of the strip above it
FRAMES, EVERY, PER_SECOND = 90, 2, 15  # frames, steps between two of them, and frames a second
BATCH, QUALITY = 15, 46  # frames that one process draws; of the file
NIGHT, PAPER, DIM, BLUE, GREY = "#0d1620", "#dfe7ee", "#8ea0b0", "#4f9fe8", "#66788a"
SHOWN = 6  # of so many free drops one has a line, before ``pictures.DRAWN``


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw frames, as ``frame-NNN.png`` into a folder."""
    from sims.particles import pictures

    for number in data["numbers"]:
        own = f"frame{number}"
        for _, plotter in panels(folder / f"frame-{number:03d}.png", 1, SIZE, SIZE):
            plotter.set_background(*pictures.NIGHT[:1], top=pictures.NIGHT[1])
            bunny = polygons(data[f"{own}_vertices"], data["faces"])
            plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.18, specular=0.15)
            pictures._add_bound(plotter, data, own, pictures.AROUND, 0.3)
            positions, velocities = upright(data[f"{own}_positions"]), upright(data[f"{own}_velocities"])
            pictures._add_drops(plotter, positions, velocities, data[f"{own}_balls"])
            pictures._look(plotter, data["center"], (-1.3, -6.2, 1.6), 0.12, 21)


def movie(path: Path, frames: int = FRAMES) -> None:
    """Simulate, draw, and write the picture.

    Raises:
        BoundingError: If the two runs differ, or this machine cannot draw.
    """
    from PIL import Image

    import warp_bounding as wb
    from sims.particles.bounds import decisions
    from sims.particles.broad import OfMotion
    from sims.particles.demo import SCENE, SPECS
    from sims.particles.example import Example
    from sims.particles.scene import Scene
    from sims.prefitted import bounders_of

    scene = Scene.bunny("cpu")
    bounder = bounders_of(SCENE, scene.shape, {"mlp": SPECS["mlp"]}, device="cpu")["mlp"]
    culled, plain = Example(scene, OfMotion(bounder, scene)), Example(scene)
    center = upright(scene.motion.vertices_at(0.0)).mean(axis=0)
    images: list = []
    with tempfile.TemporaryDirectory() as work:
        for first in range(0, frames, BATCH):
            numbers, data = range(first, min(first + BATCH, frames)), {"faces": scene.motion.faces, "center": center}
            data["numbers"] = np.array(numbers)
            counts = []
            for number in numbers:
                for _ in range(EVERY):
                    culled.step()
                    plain.step()
                positions, own = culled.positions.numpy(), f"frame{number}"
                balls = bounder.query(np.insert(positions, 0, culled.time, axis=1)).numpy()
                seen = balls | (np.arange(len(balls)) % SHOWN == 0)
                data[f"{own}_positions"], data[f"{own}_velocities"] = positions[seen], culled.velocities.numpy()[seen]
                data[f"{own}_balls"], data[f"{own}_vertices"] = balls[seen], scene.motion.vertices_at(culled.time)
                data |= decisions(own, bounder, culled.time)
                counts.append((sum(plain.calls), sum(culled.calls)))
            drawn = draw_with("sims.particles.movie", Path(work) / "frames", data, colours=None)
            if drawn.problem:
                raise wb.BoundingError(f"no picture: {drawn.problem}")
            images += [_frame(Image.open(file), *each) for file, each in zip(drawn.paths, counts, strict=True)]
            shutil.rmtree(Path(work) / "frames")
            print(f"{len(images)} of {frames} frames", flush=True)
    if not culled.identical(plain):
        raise wb.BoundingError("the run with the bound differs from the one without")
    options = {"save_all": True, "append_images": images[1:], "duration": 1000 // PER_SECOND, "loop": 0}
    images[0].save(path, quality=QUALITY, method=6, **options)
    print(f"written to {path}, {path.stat().st_size / 1e6:.2f} MB")


def _frame(scene, without: int, bounded: int):
    """A frame: the scene, below a strip with the counter."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 15)
    frame = Image.new("RGB", (SIZE, SIZE + HEAD), NIGHT)
    frame.paste(scene.convert("RGB"), (0, HEAD))
    pen, right, wide = ImageDraw.Draw(frame), SIZE - 14, 170
    pen.text((14, 8), "exact tests so far", font=font, fill=DIM)
    for row, (text, count, colour) in enumerate((("without a bound", without, GREY), ("with one", bounded, BLUE))):
        y = 30 + 21 * row
        pen.text((14, y), text, font=font, fill=PAPER)
        pen.rectangle((150, y + 3, 150 + max(2, round(wide * count / max(without, 1))), y + 14), fill=colour)
        pen.text((right, y), f"{count:,}", font=font, fill=PAPER, anchor="ra")
    pen.text((right, 8), "contacts missed: 0", font=font, fill=DIM, anchor="ra")
    return frame


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/rain.webp"))
    parser.add_argument("--frames", type=int, default=FRAMES, help="a few, for a first look")
    given = parser.parse_args()
    quiet_warp()
    movie(given.out, given.frames)
