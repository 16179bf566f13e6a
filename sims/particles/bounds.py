"""What is drawn of bounders of a motion at one time: their decision functions on a grid over space."""

import numpy as np
from scipy.ndimage import label

import warp_bounding as wb
from sims.particles.scene import Scene

__all__ = ["MOMENT", "bounds_data", "decisions", "of_moment"]

SAMPLES = 100_000
CELLS = 96  # along each side of the domain, where a bound's surface is looked for
APART = "Islands off the bunny are false positives, too"
ANEW = "Fitted anew in every step"
MOMENT = "kdop of one moment"
NAMES = {  # of panels
    MOMENT: "k-DOP of this moment",
    "kdop": "k-DOP of the whole motion",
    "learned-kdop": "Learned k-DOP of the motion",
    "mlp": "Network of the motion",
}


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
        proof = "proven" if bounder.certificate is not None and bounder.certificate.proven else "not proven"
        remark = ANEW if method == MOMENT else APART if pieces > 1 else ""
        caption = f"{NAMES.get(method, method)}\n{figures}, {proof}\n{remark}"
        data[f"bound{number}_caption"] = np.array(caption)
    return data


def of_moment(scene: Scene, time: float) -> tuple[wb.Bounder, float]:
    """The k-DOP of the mesh as it is at a time, which is fitted anew at every other time; its false positives there.

    They are per cent of the queries of all bounders: of space and time, in the domain of the motion.
    """
    lower, upper = scene.shape.sample_lower[1:], scene.shape.sample_upper[1:]
    mesh = wb.shapes.Mesh(scene.motion.vertices_at(time), scene.motion.faces)
    bounder = wb.fit(mesh, method="kdop", margin=scene.margin, device="cpu", progress=False)
    points = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, 3)).astype(np.float32)
    maybe = bounder.query(points).numpy()
    inside = scene.shape.contains(np.insert(points, 0, time, axis=1))
    return bounder, 100.0 * float((maybe & ~inside).mean())


def decisions(name: str, bounder: wb.Bounder, time: float) -> dict[str, np.ndarray]:
    """A bounder's decision function, of a motion at a time, on a grid over its domain, one point beyond it included."""
    moves = bool(bounder.domain.time)
    lower, upper = bounder.domain.lower[-3:], bounder.domain.upper[-3:]
    step = (upper - lower) / CELLS
    axes = [np.linspace(lo - s, hi + s, CELLS + 3) for lo, hi, s in zip(lower, upper, step, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (np.insert(places, 0, time, axis=1) if moves else places).astype(np.float32)
    value = bounder.values(points).numpy().astype(np.float64) - float(bounder.threshold)
    value[np.isneginf(value)] = -np.median(np.abs(value[np.isfinite(value)]))  # outside the domain: no
    return {f"{name}_value": value.reshape([CELLS + 3] * 3), f"{name}_origin": lower - step, f"{name}_step": step}


def _size(count: int) -> str:
    return f"{count} bytes" if count < 1000 else f"{count / 1000:.1f} kB"
