"""Half-spaces of motions hold every point of the object in their boxes; those of exact truth are in ``test_exact_motion``."""

import numpy as np
import pytest
from turning_solids import SOLIDS, unevenly_turning

from warp_bounding.indicators import IndicatorMotion
from warp_bounding.indicators.shape import IN


@pytest.mark.parametrize("margin", [0.0, 0.03])
@pytest.mark.parametrize("name", [*SOLIDS, "open"])
def test_half_spaces_hold_the_object_in_their_boxes(rng, name, margin):
    motion = unevenly_turning(name, margin)
    assert name == "open" or not motion.restriction
    # around points near the faces, in boxes that reach over keyframes and past the ends of time
    times = rng.uniform(-1, 4, 12)
    border = [
        np.insert(motion.vertices_at(t)[rng.integers(motion.frames.shape[1], size=400)], 0, t, axis=1) for t in times
    ]
    border = np.concatenate(border)
    size = 10.0 ** rng.uniform(-3, -0.3, (len(border), 1)) * [2, 1, 1, 1]
    low, high = border - size * rng.random(border.shape), border + size * rng.random(border.shape)
    known = motion.half_spaces(low, high)
    assert (known.empty == motion.empty(low, high)).all()
    assert set(known.axis.tolist()) <= {0, 1, 2, 3}
    found = known.slope.any(axis=1) & ~known.empty
    over = np.searchsorted(motion.times, low[:, 0]) < np.searchsorted(motion.times, high[:, 0])
    assert (found & over).sum() > 100
    assert found.mean() > 0.2
    cut = held = 0
    for _ in range(20):
        share = rng.random(border.shape)
        x = np.where(rng.random(border.shape) < 0.3, np.where(share < 0.5, low, high), low + share * (high - low))
        x = x.clip(low, high)
        value, there = known.level + (known.slope * (x - known.center)).sum(axis=1), motion.decide(x) == IN
        assert (value[there & ~known.empty] >= 0).all()
        cut, held = cut + (value[found] < 0).sum(), held + there[found].sum()
    assert cut > 1000
    assert held > 1000 or (name == "open" and margin == 0)


def test_half_spaces_far_away_in_time_and_over_many_keyframes(rng):
    solid = SOLIDS["icosphere"]()
    times = 1e6 + 2.0**-4 * np.arange(30)
    angles = np.linspace(0, 3, len(times))
    frames = np.array([solid.vertices * (1 + 0.2 * np.sin(a)) + [a, 0, np.cos(3 * a)] for a in angles])
    motion = IndicatorMotion(frames, solid.faces, times).dilated(0.02)
    at = rng.uniform(times[0], times[-1], 3000)
    border = np.array([np.insert(motion.vertices_at(t)[rng.integers(len(solid.vertices))], 0, t) for t in at])
    size = 10.0 ** rng.uniform(-3, 0, (len(border), 1)) * [1.5, 0.3, 0.3, 0.3]
    low, high = border - size * rng.random(border.shape), border + size * rng.random(border.shape)
    known = motion.half_spaces(low, high)
    spans = np.searchsorted(times, high[:, 0]) - np.searchsorted(times, low[:, 0])
    found = known.slope.any(axis=1)
    assert found[spans <= 1].sum() > 20
    assert found[(spans > 1) & (spans < 6)].any()
    assert (spans > 9).sum() > 100
    assert not found[spans > 9].any()
    for _ in range(10):
        x = low + rng.random(low.shape) * (high - low)
        value = known.level + (known.slope * (x - known.center)).sum(axis=1)
        assert (value[(motion.decide(x) == IN) & ~known.empty] >= 0).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
@pytest.mark.parametrize("column", [0, 2])
def test_half_spaces_of_boxes_that_are_none(bad, column):
    motion = unevenly_turning("box", 0.0)
    low, high = np.zeros((1, 4)), np.full((1, 4), 0.1)
    for side in (low, high):
        side[0, column] = bad
        with np.errstate(invalid="ignore", over="ignore"):
            known = motion.half_spaces(low, high)
            assert (known.empty == motion.empty(low, high)).all()
        assert np.isfinite(known.level).all()
        assert np.isfinite(known.slope).all()
