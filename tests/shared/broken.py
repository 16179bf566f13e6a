"""What a demo must find out: a bounder that denies a part of its object, and a broad phase that clears everything."""

import numpy as np

from sims.planning.broad import BroadPhase


def denying(bounder, points):
    """The bounder with its threshold raised above f at all of these points of the object."""
    raised = bounder.to(str(bounder.device))
    values = raised.values(np.asarray(points, np.float32)).numpy()
    return raised.freeze(float(np.nextafter(values.max(), np.float32(np.inf))), None)


class Everything(BroadPhase):
    """It clears whatever it is queried."""

    def states(self, x):
        return np.ones(len(x), dtype=bool)

    def edges(self, starts, ends):
        return np.ones(len(starts), dtype=bool)
