"""What bounders take for a query in a batch."""

import math
import time
from collections.abc import Mapping

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder

__all__ = ["TURNS", "times_of"]

TIMED, TURNS = 200_000, 9  # queries of a timed launch, at least, and launches of each


def times_of(bounders: Mapping[str, Bounder], x: np.ndarray, turns: int) -> dict[str, float]:
    """Of one query in a batch of these, the fastest of some launches, which take turns: whatever else the machine does slows all alike."""
    x = np.resize(x, (max(len(x), TIMED), x.shape[1]))
    asked = {}
    for label, bounder in bounders.items():
        queries = wp.array(x, dtype=wp.float32, device=bounder.device)
        asked[label] = bounder.prepare(queries)
    times = dict.fromkeys(bounders, math.inf)
    for turn in range(turns + 1):
        for label, prepared in asked.items():
            device = wp.get_device(bounders[label].device)
            wp.synchronize_device(device)
            start = time.perf_counter()
            prepared.launch()
            wp.synchronize_device(device)
            if turn:  # the first one loads kernels
                times[label] = min(times[label], time.perf_counter() - start)
    return {label: 1e9 * seconds / len(x) for label, seconds in times.items()}
