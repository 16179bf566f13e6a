"""The bounds of ``certify`` hold, share nothing with the search's, and find out the bounders of a faulty search."""

import pickle
import re
from fractions import Fraction

import numpy as np
import pytest
from bounding_shapes import DEEP, random_layers, random_mlp, shape
from plain_shapes import ball_at
from shape_kinds import network as network_shape

import warp_bounding as wb
from warp_bounding import activations
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.networks import bounds, network
from warp_bounding.networks.bounds import BoxBounds, Parametrization
from warp_bounding.proof import minimum, positive_boxes, search, settle, taylor
from warp_bounding.proof.prove import least_value
from warp_bounding.queries import domain
from warp_bounding.shapes.shape import Shape

WIDTHS = (0.0, 1e-6, 1e-3, 0.02, 0.1, 0.5, 2.0)


def random_network(rng, inputs, hidden, activation):
    """Of random float32 weights, steep enough to bend in boxes of all ``WIDTHS``."""
    layers = random_layers((inputs, *hidden, 1), rng, 1.5)
    return network.Network(layers, activation, np.full(inputs, 1.0))


def wider(f, by):
    """The same network for inputs that are larger by as much."""
    return network.Network([*f.hidden, f.output], None, f.limit + by)


def samples(lower, upper, rng, count=64):
    """Corners of boxes, where there are few, and random points in them, ``(N, count, n)``."""
    n = lower.shape[1]
    share = rng.uniform(0, 1, (len(lower), count, n))
    corners = (np.arange(min(1 << n, count))[:, None] >> np.arange(n)) & 1
    share[:, : len(corners)] = corners
    return lower[:, None] + (upper - lower)[:, None] * share


@pytest.mark.parametrize("activation", ["sin", "relu"])
@pytest.mark.parametrize("ndim", [1, 3])
def test_no_value_lies_under_a_bound(ndim, activation, rng):
    """Nor under the linear one of the same kernel, nor under what is linear between its corners."""
    f = random_network(rng, ndim, (12, 9, 7), activation)
    own = taylor.TaylorBounds()
    for width in WIDTHS:
        center = rng.uniform(-1, 1, (200, ndim))
        radius = width / 2 * rng.uniform(0.2, 1, (200, ndim))
        lower, upper = center - radius, center + radius
        found = own.boxes(wider(f, width), lower, upper)
        v = samples(lower, upper, rng)
        values = f(v.reshape(-1, ndim)).reshape(v.shape[:2])
        assert (found.lower[:, None] <= values).all()
        line = found.level[:, None] + (found.slope[:, None] * (v - center[:, None])).sum(axis=2)
        assert (line <= values + 1e-12 * np.abs(values)).all()
        np.testing.assert_allclose(found.value, f(found.point), rtol=0, atol=1e-9)
        if width == 0:
            assert (found.lower >= values[:, 0] - 1e-6).all()  # a point's bound is its value
    assert (own.corners(wider(f, width), lower, upper).min(axis=1) <= values.min(axis=1)).all()


@pytest.mark.parametrize("of_certify", [True, False])
def test_bounds_are_of_third_order(of_certify, rng):
    """What a bound of the sine is off falls by the third power of the box's width, in ``certify`` and in the search."""
    f, gaps = random_network(rng, 2, (16, 16), "sin"), []
    center = rng.uniform(-0.5, 0.5, (300, 2))
    for radius in (0.02, 0.01):
        lower, upper = center - radius, center + radius
        v = samples(lower, upper, rng, 400)
        least = f(v.reshape(-1, 2)).reshape(v.shape[:2]).min(axis=1)
        own = taylor.TaylorBounds().boxes(f, lower, upper)
        gaps.append(np.median(least - (own if of_certify else f.bound(lower, upper)).lower))
    assert gaps[1] < gaps[0] / 3


def test_losses_that_vanish_beside_a_large_bias_are_counted():
    """Each of 1024 losses is less than half of the last bit of f."""
    size, radius = 1024, 2.0**-10
    first = np.where(np.arange(size) % 2, -1.0, 1.0)[:, None]
    layers = [(first, np.zeros(size)), (np.full((1, size), 5.2e-11 * 4 / radius), np.ones(1)), (np.ones((1, 1)), [1e6])]
    f = network.Network([tuple(np.float32(e) for e in layer) for layer in layers], "relu", np.ones(1))
    found = taylor.TaylorBounds().boxes(f, np.array([[-radius]]), np.array([[radius]]))
    assert Fraction(found.lower[0]) <= 1_000_001


def test_certify_calls_nothing_of_the_search(monkeypatch):
    """Neither for the networks of a bounder, of its parts and members, nor for those of a shape; nor after pickling."""
    grid, few = shape("c"), {"hidden": (8,), "steps": 20, "device": "cpu"}
    bounders = [wb.fit(grid, query, "mlp", **few) for query in ("point", "distance")]
    bounders.append(wb.cascade(bounders[0], wb.fit(grid, **few | {"hidden": DEEP})))
    pairs = [(bounder, grid) for bounder in bounders]
    learnt = network_shape(2, level=-0.32)
    pairs += [(wb.fit(learnt, method="mlp", **few), learnt)]

    def never(*_, **__):
        raise AssertionError("a bound of the search")

    for name in ("bound_boxes", "bound_corners"):
        monkeypatch.setattr(network, name, never)
    for bounder, object_ in pairs:
        assert wb.certify(bounder, object_).proven
        for sent in map(taylor.TaylorBounds().given_to, (bounder, object_)):
            assert not searched(pickle.loads(pickle.dumps(sent)))


def searched(made) -> bool:
    """Whether the search's bounds are those of a network somewhere in a bounder or a shape."""
    if isinstance(made, network.Network):
        return not isinstance(made.bounds, taylor.TaylorBounds)
    if isinstance(made, Bounder | Shape):
        made = [*vars(made).values()]
    return isinstance(made, list | tuple) and any(map(searched, made))


# --- faults of the search --------------------------------------------------------------------------------------------


def swapped(part: str, old: str, new: str):
    """A part of the search's C text with a fault."""

    def inject(monkeypatch):
        text = getattr(bounds.text, part)
        assert text.count(old) == 1
        monkeypatch.setattr(bounds.text, part, text.replace(old, new))

    return inject


def wrong_curve(pattern: str, new: str):
    """The sine's curve with a fault."""

    def inject(monkeypatch):
        true = activations.SINE.relaxation()
        faulty = re.sub(pattern, new, true)
        assert faulty != true
        monkeypatch.setattr(type(activations.SINE), "relaxation", lambda self: faulty)

    return inject


def dropped_halves(monkeypatch):
    """The search takes the first half of each box twice, and never the second half."""
    true = search.halve

    def faulty(lower, upper, axis):
        low, high = true(lower, upper, axis)
        return np.tile(low[: len(axis)], (2, 1)), np.tile(high[: len(axis)], (2, 1))

    monkeypatch.setattr(search, "halve", faulty)


def half_boxes(monkeypatch):
    text = Parametrization.expand.replace("(high[k] - low[k]) * 0.5", "(high[k] - low[k]) * 0.25")
    monkeypatch.setattr(Parametrization, "expand", text)


def no_delta(monkeypatch):
    monkeypatch.setattr(
        domain.Domain, "widened", lambda self, lower, upper: (self.to_local(lower), self.to_local(upper))
    )


FAULTS = {
    "a wrong slope": wrong_curve(r"slope = flat \? zero : a;", "slope = flat ? zero : a * 0.5;"),
    "a wrong intercept": wrong_curve(r"mean = flat \? zero : m;", "mean = flat ? zero : m + 0.02;"),
    "no band around a curve": wrong_curve(r"spread = flat \? zero \+ 1.0 : e;", "spread = zero;"),
    "a band of one sign": swapped("BACKWARDS", "absolute(c) * own.spread[j]", "(c > zero ? c : zero) * own.spread[j]"),
    "a form that is counted at its best": swapped("CLOSE", "least -= q; score[k]", "least += q; score[k]"),
    "slopes that are halved": swapped("CLOSE", "steep[k] = absolute(slope[k])", "steep[k] = 0.5 * absolute(slope[k])"),
    "a half that is dropped": dropped_halves,
    "boxes of half their size": half_boxes,
    "no delta": no_delta,
}


@pytest.fixture
def anew():
    """Kernels that are made in a test are not kept."""
    caches = [bounds._kernel, bounds._corner_kernel]
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


class Blind:
    """A bounder's bounds; every value that a search finds is the same."""

    def __init__(self, bounder, value: float):
        self.reference, self._bound, self._value = bounder.reference, bounder.bound, value

    def bound(self, lower, upper) -> BoxBounds:
        return self._bound(lower, upper)._replace(value=np.full(len(lower), self._value), next_axis=None)


def harm_of(bounder, grid, least: float) -> float:
    """By how much a search overstates the least f, up to 0.3; values that it finds do not help it."""
    blind = Blind(bounder, least + 0.3)
    return minimum(blind, *positive_boxes(bounder, grid), eps=1e-6, boxes=300_000).lower_bound - least


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bounder_of_a_faulty_search_is_not_proven(fault, monkeypatch, anew):
    grid, harm = shape("c"), 0.0
    for seed in range(8):
        bounder = random_mlp(grid, hidden=(16, 16), gain=40.0, seed=seed)
        found = least_value(bounder, grid, eps=1e-5)
        settle(bounder, grid, found)
        assert wb.certify(bounder, grid).proven
        assert harm_of(bounder, grid, found.upper_bound) <= 0.0
        with monkeypatch.context() as patched:
            FAULTS[fault](patched)
            bounds._kernel.cache_clear()
            harm = harm_of(bounder, grid, found.upper_bound)
        bounds._kernel.cache_clear()
        if harm > 1e-4:
            break
    assert harm > 1e-4
    threshold = np.float32(found.upper_bound + harm - bounder.rounding_bound())
    bounder.freeze(float(np.nextafter(threshold, np.float32(-np.inf))), None)
    reported = wb.certify(bounder, grid)
    assert reported.kind in ("refuted", "undecided"), reported


def test_a_delta_without_a_term_is_refused(monkeypatch):
    """Far from its origin what a point's coordinates round is most of delta."""
    solid = ball_at([3000.0, 0.0], 1.0)
    assert wb.certify(wb.fit(solid, method="kdop", device="cpu"), solid).proven
    monkeypatch.setattr(domain, "input_rounding", lambda center, scale, extent, *_: domain.rounding_of_map(extent))
    monkeypatch.setattr(domain, "DELTA_SHARE", 0.0)
    reported = wb.certify(wb.fit(solid, method="kdop", device="cpu"), solid)
    assert reported.kind == "inapplicable"
    assert "delta" in reported.message
