"""Before the first and after the last keyframe of a motion every bounder says *maybe*, by however little, wherever it is asked."""

from functools import cache

import numpy as np
import pytest
import trimesh
from bounding_shapes import EARLY, HIDDEN, told_of

import warp_bounding as wb
from warp_bounding.bounders import METHODS

SPANS = [(0.3, 1.7), (-0.7, 0.1)]  # no cells of time meet both ends
POINTS = [name for name, kind in METHODS.items() if kind.supports("point", 4)]
REGIONS = [
    (name, query)
    for name, kind in METHODS.items()
    for query in ("ray", "plane", "box")
    if kind.exact_on_cells and kind.conservative and name != "learned-kdop" and kind.supports(query, 4)
]


@cache
def moving_box(start: float, end: float) -> wb.IndicatorMotion:
    """A small box that wanders from one corner to the other."""
    solid = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    frames = np.stack([solid.vertices + shift for shift in (-0.3, 0.1, 0.3)])
    return wb.IndicatorMotion(frames, solid.faces, times=[start, (start + end) / 2, end], time_cells=3)


@cache
def fitted(method: str, query: str, span: tuple[float, float]) -> wb.Bounder:
    hidden = EARLY if method == "mlp-early" else HIDDEN
    grid = moving_box(*span).to_grid(resolution=5)
    return wb.fit(grid, query=query, method=method, device="cpu", **told_of(method, query, hidden=hidden, steps=3))


def beyond(span: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """float32 times before the first and after the last keyframe: the next ones, and up to many ranges away."""
    away = (span[1] - span[0]) * 10.0 ** rng.uniform(-9, 3, 200)
    times = []
    for keyframe, sign in ((np.float32(span[0]), -1), (np.float32(span[1]), 1)):
        times += [np.nextafter(keyframe, np.float32(sign * np.inf)), *(keyframe + np.float32(sign) * np.float32(away))]
    times = np.array(times, dtype=np.float32)
    return times[(times < np.float32(span[0])) | (times > np.float32(span[1]))]


def places(count: int, rng: np.random.Generator) -> np.ndarray:
    """``(count, 3)``: on the object's way, near it and far from it."""
    return (rng.uniform(-1, 1, (count, 3)) * 10.0 ** rng.integers(-1, 3, (count, 1))).astype(np.float32)


@pytest.mark.parametrize("span", SPANS)
@pytest.mark.parametrize("method", POINTS)
def test_points_beyond_the_keyframes(method, span, rng):
    bounder = fitted(method, "point", span)
    times = beyond(span, rng)
    for _ in range(5):
        x = np.column_stack([times, places(len(times), rng)])
        assert bounder.query(x).numpy().all()
        assert bounder.query(x.astype(np.float64)).numpy().all()


@pytest.mark.parametrize("span", SPANS)
@pytest.mark.parametrize(("method", "query"), REGIONS)
def test_regions_beyond_the_keyframes(method, query, span, rng):
    """A region that holds no time of the motion; one that reaches into it counts by its part inside."""
    bounder = fitted(method, query, span)
    times = beyond(span, rng)
    at = np.column_stack([times, places(len(times), rng)])
    away = np.where(times > span[1], 1.0, -1.0)  # out of the range of time
    if query == "box":
        further = at + np.column_stack([away * rng.choice([0.0, 0.1, 9.0], len(at)), rng.random((len(at), 3))])
        other = np.where((away > 0)[:, None], further, at)
        x = np.concatenate([np.where((away > 0)[:, None], at, further), other], axis=1)
        x = np.concatenate([np.minimum(x[:, :4], x[:, 4:]), np.maximum(x[:, :4], x[:, 4:])], axis=1)
    elif query == "ray":
        d = rng.normal(size=at.shape)
        d[:, 0] = np.abs(d[:, 0]) * away * (rng.random(len(d)) < 0.7)
        x = np.concatenate([at, d], axis=1)
    else:  # the planes that hold no time of the motion are those of one time
        x = np.concatenate([np.tile([1.0, 0.0, 0.0, 0.0], (len(at), 1)), at], axis=1)
    assert not (bounder.values(x.astype(np.float32)).numpy() < bounder.threshold).any()


@pytest.mark.parametrize("span", [*SPANS, (2.0, 3.5), (0.0, 1.0)])
def test_between_the_keyframes_there_are_answers(span, rng):
    """All but a little of the range is answered; else *maybe* beyond it were no news."""
    grid, bounder = moving_box(*span).to_grid(resolution=5), fitted("aabb", "point", span)
    assert span[0] <= grid.lower[0] < span[0] + 0.15 * (span[1] - span[0])
    assert span[1] >= grid.upper[0] > span[1] - 0.15 * (span[1] - span[0])
    inside = rng.uniform(*(np.array([grid.lower[0], grid.upper[0]]) + np.array([1e-4, -1e-4])), 500)
    x = np.column_stack([inside, np.full((500, 3), 5.0)]).astype(np.float32)
    assert not bounder.query(x).numpy().any()


@pytest.mark.parametrize("query", ["point", "box"])
def test_a_bounder_that_denies_beyond_the_keyframes_is_not_certified(query):
    """Such as one of cells that reach beyond them."""
    motion = moving_box(0.3, 1.7)
    grid = motion.to_grid(resolution=5)
    wide = np.concatenate([grid.occupancy[:1], grid.occupancy, grid.occupancy[-1:]])
    longer = wb.IndicatorGrid(wide, cells_per_unit=grid.cells_per_unit, offset=grid.offset - [1, 0, 0, 0], time=True)
    bounder = wb.fit(longer, query=query, method="aabb", device="cpu")
    assert wb.certify(bounder, longer).proven
    proof = wb.certify(bounder, grid)
    assert proof.kind == "inapplicable"
    assert "known at times from" in proof.message
    assert wb.certify(fitted("aabb", query, (0.3, 1.7)), grid).proven
