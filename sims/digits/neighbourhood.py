"""How far a proof reaches with 10 latent numbers: the codes around one code, not all of them.

In 12 dimensions the whole region is out of reach, but not all codes that are about the same: a box of codes of
half-width r around one code, and all pixels. ``wb.certify`` proves there, or does not within its time, that the bounder
of the whole model misses no pixel.

    python -m sims.digits.neighbourhood
"""

import json

import numpy as np

import warp_bounding as wb
from sims.digits.model import LARGEST, LEVEL, codes, load
from sims.prefitted import stored
from sims.report import shown

__all__ = ["neighbourhood", "reach"]

RADII = (0.02, 0.05, 0.1, 0.2)
CODES, SECONDS = 10, 10.0  # at each radius, and for each proof
SEED = 11


def neighbourhood(network, code: np.ndarray, radius: float) -> wb.shapes.Network:
    """The region of codes whose latent numbers differ from a code's by at most ``radius``, and of all pixels."""
    code = np.asarray(code, dtype=np.float64)
    lower = np.append(np.maximum(code - radius, -LARGEST), [0.0, 0.0])
    upper = np.append(np.minimum(code + radius, LARGEST), [1.0, 1.0])
    return wb.shapes.Network(network, lower, upper, level=LEVEL, name=f"codes within {radius:g}")


def reach(bounder: wb.Bounder, network, latent: int, *, count: int = CODES, seconds: float = SECONDS) -> list[dict]:
    """What ``certify`` says of the bounder around random codes.

    Returns:
        Per radius: ``radius``, ``codes``, how many were ``proven``, ``refuted``, ``undecided``, and the mean ``boxes``
        of a proof.
    """
    reported = []
    for radius in RADII:
        shapes = [neighbourhood(network, code, radius) for code in codes(count, latent, SEED)]
        found = [wb.certify(bounder, shape, budget=seconds) for shape in shown(shapes, f"codes within {radius:g}")]
        kinds = [each.kind for each in found]
        boxes = [each.boxes for each in found if each.kind == "proven"]
        row = {
            "radius": radius,
            "codes": count,
            **{kind: kinds.count(kind) for kind in ("proven", "refuted", "undecided")},
        }
        reported.append(row | {"boxes": round(sum(boxes) / len(boxes)) if boxes else None})
        print(json.dumps(reported[-1]), flush=True)
    return reported


if __name__ == "__main__":
    reach(wb.load(stored("digits-10", "mlp"), device="cpu"), load(10), 10)
