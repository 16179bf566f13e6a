"""What is drawn of bounders of a motion at one time: their decision functions on a grid over space."""

import numpy as np
from scipy.ndimage import label

import warp_bounding as wb
from sims.particles.scene import Scene

__all__ = ["bounds_data", "decisions"]

CELLS = 96  # along each side of the domain, where a bound's surface is looked for
APART = "Islands off the bunny: false positives, too"


def bounds_data(scene: Scene, time: float, bounders: dict[str, tuple[wb.Bounder, float]]) -> dict[str, np.ndarray]:
    """What the picture of the bounds needs.

    Args:
        scene: The moving mesh.
        time: At which it is shown.
        bounders: Per method: a bounder of the motion and its false positives in per cent.

    Returns:
        Arrays by name: for each bound, its decision function on a grid over its domain, one point beyond it included.
    """
    data = {"vertices": scene.motion.vertices_at(time), "faces": scene.motion.faces}
    for number, (method, (bounder, rate)) in enumerate(bounders.items()):
        data |= decisions(f"bound{number}", bounder, time)
        figures = f"{rate:.1f} % false positives, {_size(bounder.nbytes)}"
        pieces = label(data[f"bound{number}_value"] > 0)[1]
        data[f"bound{number}_caption"] = np.array(f"{method}\n{figures}\n{APART if pieces > 1 else ''}")
    return data


def decisions(name: str, bounder: wb.Bounder, time: float) -> dict[str, np.ndarray]:
    """A bounder's decision function at a time, on a grid over its domain, one point beyond it included."""
    lower, upper = bounder.domain.lower[1:], bounder.domain.upper[1:]
    step = (upper - lower) / CELLS
    axes = [np.linspace(lo - s, hi + s, CELLS + 3) for lo, hi, s in zip(lower, upper, step, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.insert(places, 0, time, axis=1).astype(np.float32)
    value = bounder.values(points).numpy().astype(np.float64) - float(bounder.threshold)
    value[np.isneginf(value)] = -np.median(np.abs(value[np.isfinite(value)]))  # outside the domain: no
    return {f"{name}_value": value.reshape([CELLS + 3] * 3), f"{name}_origin": lower - step, f"{name}_step": step}


def _size(count: int) -> str:
    return f"{count} bytes" if count < 1024 else f"{count / 1024:.1f} kB"
