"""What bounders, and distances that stand in for one, answer to queries in a batch, and what they take for it."""

import math
import time
from collections.abc import Callable, Mapping

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.evaluation.distances import ASKED, parts_of

__all__ = ["TURNS", "Batch", "times_of"]

TIMED, TURNS = 200_000, 9  # queries of a timed launch, at least, and launches of each
MOST_SECONDS, FEWEST = 0.3, 1  # of all launches of one, after which no more are timed, and how many are in any case


class Batch:
    """Queries of one kind that all candidates are asked.

    Args:
        query: Kind of query.
        x: ``(N, m)`` float32, object space.
        length: Of rays.
    """

    def __init__(self, query: str, x: np.ndarray, length: float):
        self.query, self.x, self.length = query, x, length

    def asked_of(self, bounder: Bounder | DistanceBounder) -> Callable[[], wp.array]:
        """What asks a bounder all of them, again and again; they lie on its device before."""
        if not isinstance(bounder, DistanceBounder):
            return bounder.prepare(wp.array(self.x, dtype=wp.float32, device=bounder.device)).launch
        parts = [wp.array(x, dtype=wp.float32, device=bounder.device) for x in parts_of(self.query, self.x)]
        ask = ASKED[self.query](bounder, self.length, {})
        return lambda: ask(*parts)

    def maybe(self, bounder: Bounder | DistanceBounder) -> np.ndarray:
        """``(N,)`` bool: which ones it does not deny."""
        return self.asked_of(bounder)().numpy() == 1


def times_of(bounders: Mapping[str, Bounder | DistanceBounder], batch: Batch, turns: int) -> dict[str, float]:
    """Nanoseconds of one query of a batch, the fastest of some launches, which take turns: whatever else the machine does slows all alike."""
    many = Batch(batch.query, np.resize(batch.x, (max(len(batch.x), TIMED), batch.x.shape[1])), batch.length)
    asked = {label: many.asked_of(bounder) for label, bounder in bounders.items()}
    times, taken = dict.fromkeys(bounders, math.inf), dict.fromkeys(bounders, 0.0)
    for turn in range(turns + 1):
        for label, launch in asked.items():
            if turn > FEWEST and taken[label] > MOST_SECONDS:  # it is so slow that another turn would change little
                continue
            device = wp.get_device(bounders[label].device)
            wp.synchronize_device(device)
            start = time.perf_counter()
            launch()
            wp.synchronize_device(device)
            if turn:  # the first one loads kernels
                taken[label] += time.perf_counter() - start
                times[label] = min(times[label], time.perf_counter() - start)
    return {label: 1e9 * seconds / len(many.x) for label, seconds in times.items()}
