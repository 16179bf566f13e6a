"""Pictures of scenes in 3D as arrays, to be put into panels."""

import io
from typing import Any

import numpy as np

__all__ = ["images"]

BATCH = 15  # scenes that one process draws


def images(tools, scenes: dict[str, dict[str, Any]]) -> dict[str, np.ndarray]:
    """``(H, W, 3)`` uint8 pictures of scenes, by their names.

    Raises:
        BoundingError: If there is nothing to draw with.
    """
    from PIL import Image

    names, found = list(scenes), {}
    for start in range(0, len(names), BATCH):
        own = names[start : start + BATCH]
        for name, png in zip(own, tools.draw_solids([scenes[each] for each in own]), strict=True):
            found[name] = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
    return found
