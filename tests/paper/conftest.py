"""A data folder in the authors' layout, with small objects, for real runs of the paper's tables."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Two images and a set of voxels: ``2d/disc``, ``2d/half``, ``3d/disc``."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    path = tmp_path_factory.mktemp("paper") / "data"
    (path / "2D").mkdir(parents=True)
    inside = np.add.outer(np.linspace(-1, 1, 12) ** 2, np.linspace(-1, 1, 12) ** 2) < 0.6
    for name, part in (("disc", inside), ("half", inside & (np.arange(12) < 6))):
        pixels = np.zeros((12, 12, 4), np.uint8)
        pixels[..., 3] = 255 * part
        image.fromarray(pixels).save(path / f"2D/{name}.png")
    (path / "4D").mkdir()
    np.save(path / "4D/disc.npy", np.broadcast_to(inside[None, :, :, None], (3, 12, 12, 12)))
    return path
