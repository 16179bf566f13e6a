"""What every kind of shape promises: its answers never contradict each other, and a margin holds what is near."""

from fractions import Fraction

import numpy as np
import pytest
from plain_shapes import within
from shape_kinds import KINDS, MARGIN, around, dilates, made

import warp_bounding as wb
from warp_bounding.errors import ShapeError
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED

ALL = [(name, margin) for name in KINDS for margin in (0.0, MARGIN) if not margin or dilates(name)]


@pytest.mark.parametrize(("name", "margin"), ALL)
def test_answers_never_contradict_each_other(name, margin, rng):
    shape = made(name, margin)
    x = around(shape, rng, 1000)
    answer = shape.decide(x)
    assert (shape.contains(x) == (answer != OUT)).all()
    assert (shape.decide(np.float32(x)) == shape.decide(np.float32(x).astype(float))).all()
    assert (answer[:1000] == UNDECIDED).mean() < (0.2 if name == "far away" else 2e-3)
    assert not shape.contains(x[((x < shape.lower) | (x > shape.upper)).any(axis=1)]).any() or shape.unbounded
    size = 10.0 ** rng.uniform(-4, -0.3, (len(x), 1)) * (shape.upper - shape.lower) * rng.random(x.shape)
    lower, upper = x - size * rng.random(x.shape), x + size * rng.random(x.shape)
    empty, inside, known = shape.empty(lower, upper), shape.inside(lower, upper), shape.half_spaces(lower, upper)
    assert empty.sum() > 5
    assert inside.any() or name.startswith("open") or name == "animation"
    assert not (empty & inside).any()
    bounds = shape.distances(x)
    for y in (x, *(within(lower, upper, rng) for _ in range(5))):
        answer = shape.decide(y)
        assert not (empty & (answer == IN)).any()
        known_of = ((y >= shape.known[0]) & (y <= shape.known[1])).all(axis=1)  # not beyond times and limits
        assert not (inside & (answer == OUT) & known_of).any()
        if known is not None:
            value = known.level + (known.slope * (y - known.center)).sum(axis=1)
            assert (value[(answer == IN) & ~known.empty] >= 0).all()
    if known is not None:
        assert (known.empty == empty).all()
        assert np.isfinite(known.level).all()
        assert np.isfinite(known.slope).all()
        assert (known.slope.any(axis=1) & ~empty).sum() > 5
    if bounds is not None:
        low, high = bounds.T
        assert (shape.distance(x) == low).all()
        assert ((low >= 0) & (low <= high)).all()
        assert (low[shape.decide(x) == IN] == 0).all()
        held = x[shape.decide(x) == IN][-500:]
        if len(held) and not shape.time:
            for row in range(0, len(x), 7):  # the truth in rational arithmetic
                nearest = held[np.linalg.norm(x[row] - held, axis=1).argmin()]
                assert Fraction(low[row]) ** 2 <= sum(
                    (Fraction(a) - Fraction(b)) ** 2 for a, b in zip(x[row], nearest, strict=True)
                )


@pytest.mark.parametrize("name", KINDS)
def test_what_is_no_point_and_no_box(name):
    shape = made(name)
    middle, n = (shape.lower + shape.upper) / 2, shape.ndim
    assert shape.decide(np.empty((0, n))).shape == shape.empty(*np.empty((2, 0, n))).shape == (0,)
    for axis in {0, n - 1}:
        for bad in (np.nan, np.inf, -np.inf):
            x = middle.copy()
            x[axis] = bad
            with np.errstate(invalid="ignore"):
                assert shape.decide(x[None]) == OUT or (name == "far away" and shape.decide(x[None]) == UNDECIDED)
        for bad in (np.nan, np.inf, -np.inf, 1e308):
            low, high = np.tile(middle, (2, 1)), np.tile(middle + 0.01, (2, 1))
            low[0, axis] = high[1, axis] = bad
            with np.errstate(invalid="ignore", over="ignore"):
                empty, inside, known = (ask(low, high) for ask in (shape.empty, shape.inside, shape.half_spaces))
            assert not (empty | inside)[~(low <= high).all(axis=1)].any()
            assert not inside[np.isnan(low).any(axis=1)].any()
            if known is not None and name != "network":  # whose boxes without end are cut off only there
                assert (known.empty == empty).all()
                assert np.isfinite(known.level).all()
                assert np.isfinite(known.slope).all()


# the whole is dilated there
@pytest.mark.parametrize("name", [name for name in KINDS if dilates(name) and name != "outside"])
def test_a_margin_holds_what_is_near(name, rng):
    """All points within it in space, and nothing beyond the box; cells that are laid over it hold it."""
    shape, wide = made(name), made(name, MARGIN)
    held = around(shape, rng, 1000)
    near = held[shape.decide(held) == IN]
    way = rng.normal(size=(len(near), shape.ndim))
    way[:, : int(shape.time)] = 0
    near = near + MARGIN * (1 - 1e-9) * rng.random((len(near), 1)) * way / np.linalg.norm(way, axis=1, keepdims=True)
    assert wide.contains(near).all()
    assert not wide.empty(near, near).any()
    assert ((near >= wide.lower) & (near <= wide.upper)).all()
    assert shape.dilated(0) is shape or name == "far away"
    assert wide.dilated(MARGIN) is wide or name == "far away"
    assert wide.margin == MARGIN
    assert wide.digest != shape.digest
    for margin in (2 * MARGIN, -1.0, np.nan):
        with pytest.raises(ShapeError, match=r"dilated by|margin must be"):
            wide.dilated(margin)
    if shape.ndim > 4 or name == "far away":
        return
    options = {} if isinstance(shape, wb.shapes.Grid) else {"resolution": 12}
    cells = shape.to_grid(margin=MARGIN, **options)
    assert (cells.margin, cells.time) == (MARGIN, shape.time)
    x = np.float32(np.concatenate([near, around(wide, rng, 1000)]))
    # a motion's last moments may lie beyond the last cell of time
    x = x[((x >= cells.lower) & (x <= cells.upper)).all(axis=1)]
    assert cells.contains(x[wide.decide(x) == IN]).all()
    assert wide.to_grid(**options).digest == cells.digest


@pytest.mark.parametrize("name", KINDS)
def test_places_that_a_shape_names(name, rng):
    shape = made(name)
    points, landmarks = shape.points(2000, rng), shape.landmarks()
    assert points.shape[1:] == landmarks.shape[1:] == (shape.ndim,)
    assert not len(points) or shape.contains(points).mean() > 0.25  # on the border, and rounded
    if len(landmarks) and (far := shape.distance(landmarks)) is not None:
        assert (far <= 1e-5 * shape.extent.max()).mean() > 0.99
