"""Pictures of scenes in 3D as arrays, to be put into panels."""

import io
from typing import Any

import numpy as np

__all__ = ["cropped", "images"]

BATCH = 15  # scenes that one process draws


def images(tools, scenes: dict[str, dict[str, Any]], crop: float = 1.0) -> dict[str, np.ndarray]:
    """``(H, W, 3)`` uint8 pictures of scenes, by their names; ``crop`` is the share of the middle that is kept.

    Raises:
        BoundingError: If there is nothing to draw with.
    """
    from PIL import Image

    names, found = list(scenes), {}
    for start in range(0, len(names), BATCH):
        own = names[start : start + BATCH]
        for name, png in zip(own, tools.draw_solids([scenes[each] for each in own]), strict=True):
            found[name] = cropped(np.asarray(Image.open(io.BytesIO(png)).convert("RGB")), crop)
    return found


def cropped(image: np.ndarray, share: float) -> np.ndarray:
    """The middle of a picture."""
    rows, columns = (round(size * (1 - share) / 2) for size in image.shape[:2])
    return image[rows : image.shape[0] - rows, columns : image.shape[1] - columns]
