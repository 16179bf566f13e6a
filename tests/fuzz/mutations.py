"""Files spoilt at random, and at thresholds that make the most of their proof: what is left is for ``certify`` to find."""

import description_mutations as description
import numpy as np
import tensor_mutations as tensors
from spoilt import File

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.bounders.voxels import Voxels
from warp_bounding.indicators import IndicatorGrid
from warp_bounding.proof import least_value
from warp_bounding.proof.distances.excesses import largest_excess

__all__ = ["MUTATIONS", "File", "mutate", "tighten"]

SEARCHED = 5000  # boxes, for the threshold of a spoilt network
SEARCH_SECONDS = 0.5  # for that of a spoilt distance
MOST = 5  # mutations of one file

MUTATIONS = {
    tensors.tensor_numbers: 8,
    tensors.tensors_scaled_together: 4,
    description.domain_numbers: 3,
    description.threshold: 3,
    description.odd_value: 3,
    description.domain_of_another_size: 3,
    description.domain_allowance: 2,
    description.domain_moved: 1,
    tensors.tensors_reflected: 2,
    tensors.tensors_exchanged: 2,
    tensors.tensor_bits: 2,
    tensors.rows_dropped_or_doubled: 0.7,
    description.kind_of_query: 1,
    description.claim: 1.5,
    tensors.layers_balanced: 1,
    description.sizes_edited: 0.5,
    tensors.tensor_structure: 0.5,
    description.method: 0.3,
}


def tighten(file: File, bounder: Bounder | DistanceBounder, grid: IndicatorGrid, rng: np.random.Generator) -> None:
    """Make the most of the proof of a spoilt file, as a liar would: of voxels keep those that the proof counts on, and no others; raise
    (or lower) every threshold to the highest one that the proof of its part allows.

    Args:
        file: Changed in place.
        bounder: As it was loaded from it.
        grid: The object.
        rng: Whether to choose the voxels.
    """
    if isinstance(bounder, DistanceBounder):
        least = 0.0 if bounder.volume is not None else -float(largest_excess(bounder, grid, SEARCH_SECONDS)[0].max())
        tightest = float(round_down(np.nextafter(least - bounder.rounding_bound(), -np.inf)))
        if np.isfinite(tightest):
            file.document["threshold"] = min(tightest, 0.0)
        return
    tests = [bounder, *getattr(bounder, "members", [])]
    for index, part in enumerate(tests):
        if isinstance(part, Voxels) and rng.random() < 0.7:
            name = "bits" if index == 0 else f"{index - 1}.bits"
            file.tensors[name] = _counted_on(part, grid)
    thresholds = []
    for part in bounder.parts:
        least = least_value(part, grid, eps=0.05, boxes=SEARCHED).lower_bound
        thresholds.append(round_down(np.nextafter(least - part.rounding_bound(), -np.inf)))
    if not np.isfinite(thresholds).all():
        return
    if any(isinstance(part, Voxels) for part in tests):  # whole numbers: the threshold that tells them apart
        thresholds = [
            np.float32(0.75) if isinstance(p, Voxels) else t for p, t in zip(bounder.parts, thresholds, strict=True)
        ]
    exits = len(thresholds) - 1
    for name in ("thresholds", "exits.thresholds", f"{len(tests) - 2}.exits.thresholds"):
        if name in file.tensors:
            count = min(file.tensors[name].size, exits)
            start = 0 if name == "thresholds" else exits - count
            file.tensors[name] = np.array(thresholds[start : start + count], np.float32)
    file.document["threshold"] = float(thresholds[-1])


def _counted_on(part: Voxels, grid: IndicatorGrid) -> np.ndarray:
    """Bits of the cells in which the middles of the object's cells lie."""
    low, high = part.domain.widened(grid.position(grid.occupied - 0.5), grid.position(grid.occupied + 0.5))
    t = (low + high) / 2 * part.tensors["factor"].astype(np.float64) + part.tensors["summand"]
    cell = np.clip(np.floor(t), 0, np.array(part.shape) - 1).astype(np.int64)
    occupied = np.zeros(part.shape, bool)
    occupied[tuple(cell.T)] = True
    packed = np.packbits(occupied.reshape(-1), bitorder="little")
    return np.pad(packed, (0, -len(packed) % 4)).view("<u4").astype(np.uint32)


def mutate(file: File, rng: np.random.Generator) -> list[str]:
    """Spoil a file in place, by one mutation or several; what was done."""
    wanted, done = 1 + min(int(rng.geometric(0.55)) - 1, MOST - 1), []
    odds = np.array(list(MUTATIONS.values()), dtype=np.float64)
    for _ in range(8 * MOST):
        chosen = list(MUTATIONS)[rng.choice(len(odds), p=odds / odds.sum())]
        try:
            what = chosen(file, rng)
        except LookupError:  # of what it spoils an earlier mutation has left nothing
            if not done:
                raise
            continue
        if what:
            done.append(what)
        if len(done) == wanted:
            break
    return done
