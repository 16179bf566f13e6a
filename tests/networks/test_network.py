"""Relaxations, bounds and activations hold with zero slack; every activation in every network."""

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from bounding_shapes import (
    HIDDEN,
    NETWORKS,
    crossed,
    object_points,
    random_bounder,
    random_layers,
    random_mlp,
    reloaded,
    report_of,
    shape,
)
from enclosures import enclosure
from fused_activations import fused_sine, plain_sine
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_shapes import within
from region_cases import hard_regions

import warp_bounding as wb
from warp_bounding.activations import ACTIVATIONS, SINE, SINE_LIMIT
from warp_bounding.bounders import METHODS
from warp_bounding.errors import BounderError
from warp_bounding.networks.network import Network
from warp_bounding.queries import oracle, sample
from warp_bounding.training import fit_network as networks

F32, REAL = np.float32, np.longdouble


@settings(deadline=None, max_examples=25)
@given(st.sampled_from(list(ACTIVATIONS)), st.integers(0, 2**32 - 1), st.floats(-13, 3))
def test_relaxation_of_one_neuron(activation, seed, exponent):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(1, 400)) * 10.0 ** rng.uniform(-3, 2)
    width = 10.0**exponent * rng.uniform(0.1, 1, z.shape)
    noise, radius = (width * rng.choice([0.0, 1e-3, 0.3, 3.0], z.shape) for _ in range(2))
    curve = enclosure(activation, z, width, radius, noise)
    rounding = 8 * 2.0**-52 * (1 + np.abs(z) + width + radius + noise)  # `bound` pays for it apart ("padding")
    ends = np.linspace(-1, 1, 9)[:, None]
    for t in np.linspace(-1, 1, 41)[:, None]:
        for p in ends * radius:
            line = t * width
            x = line + p + ends * noise
            act = ACTIVATIONS[activation].value((z + x).astype(np.longdouble))
            lines = curve.mean + curve.slope * x + curve.lean * line
            curves = curve.bend * line**2 + curve.cube * line**3 + curve.cross * line * p
            assert (np.abs(act - (lines + curves)) <= curve.spread + rounding).all()
    assert (np.abs(curve.slope) <= 1).all()
    assert (np.abs(curve.slope + curve.lean + 0.75 * curve.cube * width**2) <= 1).all()
    assert (np.abs(curve.bend) * width**2 / 2 <= 1).all()
    if ACTIVATIONS[activation].largest is not None:
        assert (np.abs(curve.mean) <= ACTIVATIONS[activation].largest + curve.spread).all()


def check_bound(bounder, rng, boxes=400):
    limit = bounder.domain.limit.astype(np.float64)
    center = rng.uniform(-limit, limit, (boxes, bounder.ndim))
    radius = 10.0 ** rng.uniform(-12, 0, (boxes, 1)) * rng.choice([0.0, 1e-3, 1.0], center.shape, p=[0.1, 0.1, 0.8])
    lower, upper = np.maximum(center - radius, -limit), np.minimum(center + radius, limit)
    bounds = bounder.bound(lower, upper)
    assert np.isfinite(bounds.lower).all()
    samples = np.concatenate([within(lower, upper, rng, 93), [lower, upper, (lower + upper) / 2]])
    values = bounder.reference(samples.reshape(-1, bounder.ndim)).reshape(len(samples), boxes)
    assert (values >= bounds.lower).all()
    assert ((bounds.axis >= 0) & (bounds.axis < bounder.ndim)).all()
    assert (bounds.point >= lower).all()
    assert (bounds.point <= upper).all()
    # A point is bounded by its own value, up to float64.
    point = bounder.bound(center, center).lower
    exact = bounder.reference(center)
    assert (point <= exact).all()
    if bounder.method != "voxels":  # of which a point beside a border may lie in a neighbour, which is wider
        assert (exact - point).max() < 1e-6 * (1 + np.abs(exact).max())


@pytest.mark.parametrize(("method", "name"), crossed(METHODS, ["c", "mesh", "animated"]))
def test_bounds_hold_on_random_boxes(method, name, rng):
    check_bound(random_bounder(method, name), rng)


@pytest.mark.parametrize(("hidden", "activation"), NETWORKS)
def test_bounds_of_networks_hold_on_random_boxes(hidden, activation, rng):
    for seed in range(2):
        check_bound(random_mlp(shape("blob"), hidden, activation, seed=seed, gain=6.0), rng, 200)


def test_noise_does_not_shrink_where_the_sine_falls():
    """Two neurons that fall and rise add their noise; were it signed, it would cancel, and the bound would be wrong."""
    first = (np.array([[1.4]], F32), np.array([np.pi / 2], F32))  # at its top: no slope, only noise
    second = (np.array([[1.0], [-1.0]], F32), np.array([np.pi, 0.0], F32) - F32([0.5, -0.5]))
    # at a top again: it falls as far as the noise goes
    third = (np.array([[1.0, 1.0]], F32), np.array([np.pi / 2], F32))
    network = Network([first, second, third, (np.array([[1.0]], F32), np.zeros(1, F32))], "sin", np.ones(1))
    for sign in (1, -1):
        network.output = type(network.output)(np.array([[float(sign)]]), np.zeros(1), "none")
        network.packed[-1] = sign
        least = network(np.linspace(-1, 1, 10_001)[:, None]).min()
        assert least >= network.bound(-np.ones((1, 1)), np.ones((1, 1)))[0][0]


@pytest.mark.parametrize(("hidden", "activation"), NETWORKS)
def test_linear_bounds_and_points_of_boxes(hidden, activation, rng):
    network = random_mlp(shape("blob"), hidden, activation).network
    lower = rng.uniform(-1, 0.8, (1000, 3))
    upper = np.minimum(lower + 10.0 ** rng.uniform(-12, 0, (1000, 1)), 1.0)
    bounds = network.bound(lower, upper)
    center, radius = (lower + upper) / 2, (upper - lower) / 2
    for u in rng.uniform(-1, 1, (20, 1000, 3)):
        linear = bounds.level + (bounds.slope * radius * u).sum(axis=1)
        assert (network(center + radius * u) >= linear - 1e-12 * (1 + np.abs(linear))).all()
    assert np.abs(bounds.value - network(bounds.point)).max() < 1e-9
    for count in (0, 1, 7, 8, 9, 63, 65):
        assert (network.bound(lower[:count], upper[:count])[0] == bounds.lower[:count]).all()


@pytest.mark.parametrize(
    ("hidden", "activation", "name"), [((25, 25), "relu", "c"), ((25, 25), "sin", "blob"), ((13, 30, 5), "sin", "blob")]
)
def test_corners_are_multilinear_bounds(hidden, activation, name, rng):
    """f is nowhere under what is multilinear between the numbers at the corners, and they are no lower than the linear
    bound's."""
    network = random_mlp(shape(name), hidden, activation, gain=4.0).network
    limit, n = network.limit, len(network.limit)
    lower = rng.uniform(-limit, limit, (150, n))
    upper = np.minimum(lower + 10.0 ** rng.uniform(-6, 0, (150, 1)), limit)
    values = network.corners(lower, upper)
    assert values.shape == (150, 2**n)
    upper_ends = np.arange(2**n)[:, None] >> np.arange(n) & 1 == 1
    for u in np.concatenate([rng.random((30, 150, n)), rng.integers(0, 2, (10, 150, n))]).astype(np.longdouble):
        shares = np.where(upper_ends, u[:, None], 1 - u[:, None]).prod(axis=2)
        v = np.clip(lower + u * (upper - lower), lower, upper).astype(np.float64)
        assert (network(v) >= (shares * values).sum(axis=1)).all()
    bounds = network.bound(lower, upper)
    linear = bounds.level[:, None] + np.einsum("bk,ik->bi", bounds.slope * (upper - lower) / 2, 2.0 * upper_ends - 1)
    assert (values >= linear - 1e-11 * (1 + np.abs(linear))).all()


def weights(*layers):
    return [(np.array(w, F32), np.array(b, F32)) for w, b in layers]


def test_sines_beyond_the_certified_range_are_refused():
    with pytest.raises(BounderError, match="certified up to"):
        Network(weights(([[5000.0]], [0.0]), ([[1.0]], [0.0])), "sin", np.ones(1))
    with pytest.raises(BounderError, match="certified up to"):
        Network(weights(([[1.0]], [5000.0]), ([[1.0]], [0.0])), "sin", np.ones(1))


def test_networks_that_could_overflow_are_refused():
    """The exact f is moderate here; in float32 the hidden sums would overflow, and -inf would be a false no."""
    layers = weights(([[1e30]], [0.0]), ([[-1e30], [1e30]], [0.0, 0.0]), ([[1e-37, 1e-37]], [0.0]))
    with pytest.raises(BounderError, match="overflow"):
        Network(layers, "relu", np.ones(1))


def test_weights_that_are_subnormal_are_paid_for():
    """A device that flushes the factor to zero loses 1e-39 * 1e8, far more than a subnormal result."""
    layers = weights(([[1e8]], [0.0]), ([[1e-39]], [0.0]))
    assert Network(layers, "relu", np.ones(1)).rounding >= 1e-31


# --- true minima, in extended precision and rational arithmetic -------------------------------------------------------


VALUES = {"sin": np.sin, "relu": lambda z: np.maximum(z, 0)}


def boxes(rng, count, limit, width):
    center = rng.uniform(-limit, limit, (count, len(limit)))
    radius = width / 2 * rng.uniform(0.5, 1.0, center.shape)
    return np.maximum(center - radius, -limit), np.minimum(center + radius, limit)


def value(layers, activation, v):
    """f of points ``(..., n)`` in extended precision, from the definition."""
    h = np.asarray(v, dtype=REAL)
    for index, (weight, bias) in enumerate(layers):
        z = np.einsum("...i,ji->...j", h, weight.astype(REAL)) + bias.astype(REAL)
        h = z if index + 1 == len(layers) else VALUES[activation](z)
    return h[..., 0]


def extremes(activation, low, high):
    """Least and greatest value of an activation on intervals, exactly: at the ends, or where it is level."""
    inner = [np.zeros_like(low)] if activation == "relu" else []
    if activation == "sin":  # level at pi / 2 and at -pi / 2, and a turn further: the first and the last are extreme
        turn = 8 * np.arctan(REAL(1))
        ends = product((turn / 4, -turn / 4), ((np.ceil, low), (np.floor, high)))
        inner = [a + turn * rounding((end - a) / turn) for a, (rounding, end) in ends]
    values = VALUES[activation](np.stack([low, high, *(np.clip(x, low, high) for x in inner)]))
    return values.min(axis=0), values.max(axis=0)


def least_of_piecewise_linear(layers, low, high):
    """Exact minimum, a fraction, of a ReLU network of one input on ``[low, high]``: between kinks it is linear."""
    exact = [([[Fraction(float(x)) for x in row] for row in w], [Fraction(float(x)) for x in b]) for w, b in layers]
    points = [Fraction(float(low)), Fraction(float(high))]
    # the kinks of layer `depth` lie where its sums vanish, linear between those before
    for depth in range(1, len(exact)):
        ends = [[sums(exact, depth, x)[j] for x in points] for j in range(len(exact[depth - 1][1]))]
        kinks = set(points)
        for sum_ in ends:
            for (x0, y0), (x1, y1) in pairwise(zip(points, sum_, strict=True)):
                if y0 * y1 < 0:
                    kinks.add(x0 + (x1 - x0) * y0 / (y0 - y1))
        points = sorted(kinks)
    return min(sums(exact, len(exact), x)[0] for x in points)


def sums(exact, depth, x):
    """What layer ``depth`` (from 1) computes before its activation, in fractions."""
    z = [x]
    for index, (weight, bias) in enumerate(exact[:depth]):
        h = [max(y, Fraction(0)) for y in z] if index else z
        z = [sum(w * y for w, y in zip(row, h, strict=True)) + b for row, b in zip(weight, bias, strict=True)]
    return z


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-3, 1.0, 100.0])
def test_one_neuron_is_bounded_under_its_exact_minimum(activation, sign, scale, rng):
    """No sampling: a function is extreme at an interval's ends or where it is level."""
    one, none = np.ones((1, 1), F32), np.zeros(1, F32)
    network = Network([(one, none), (sign * one, none)], activation, np.full(1, 200.0))
    z = np.where(rng.random(400) < 0.2, rng.choice([0.0, np.pi / 2, np.pi], 400), rng.normal(size=400) * 20)
    d = scale * rng.uniform(0.1, 1, 400)
    lower, upper = np.maximum(z - d, -200.0), np.minimum(z + d, 200.0)
    least, most = extremes(activation, lower.astype(REAL), upper.astype(REAL))
    exact, ours = least if sign > 0 else -most, network.bound(lower[:, None], upper[:, None]).lower
    assert (ours <= exact).all()
    if scale < 1e-9:
        assert (exact - ours).max() < 1e-9


def test_bounds_are_under_exact_minima_of_relu_networks(rng):
    """Rational arithmetic, neurons that are always off among the others."""
    for seed in range(2):
        layers = random_layers((1, 6, 5, 1), np.random.default_rng(seed), first=3.0)
        layers[0][1][:2], layers[1][1][0] = -50.0, -50.0
        network = Network(layers, "relu", np.full(1, 4.0))
        for width in (0.0, 1e-12, 0.1, 1.0, 8.0):
            lower, upper = boxes(rng, 3, np.full(1, 4.0), width)
            ours = network.bound(lower, upper).lower
            for bound, low, high in zip(ours, lower[:, 0], upper[:, 0], strict=True):
                least = least_of_piecewise_linear(layers, low, high)
                assert Fraction(float(bound)) <= least
                if width < 1e-9:
                    assert float(least - Fraction(float(bound))) < 1e-9


@pytest.mark.parametrize("width", [0.0, 1e-12, 1e-3, 0.5])
def test_bounds_hold_near_the_end_of_the_certified_sine(width, rng):
    """Arguments up to almost 4096, of both signs and in both layers."""
    layers = random_layers((1, 6, 5, 1), rng, first=1.0)
    layers[0][0][:, 0] = np.array([4040.0, -4040.0, 3000.0, -3.0, 1.0, 4000.0], F32)
    layers[0][1][:] = np.array([50.0, -50.0, -1000.0, 4090.0, -4090.0, 0.0], F32)
    layers[1][1][:] = np.array([4080.0, -4080.0, 1.0, 0.0, 2000.0], F32)
    network = Network(layers, "sin", np.ones(1))
    assert np.abs(layers[0][0]).max() + 50 > 0.99 * SINE_LIMIT
    lower, upper = boxes(rng, 40, np.ones(1), width)
    lower[0], upper[0] = 1.0 - width, 1.0
    lower[1], upper[1] = -1.0, -1.0 + width
    ours = network.bound(lower, upper).lower
    points = np.clip(lower + np.linspace(0, 1, 2001)[:, None, None] * (upper - lower), lower, upper)
    least = value(layers, "sin", points).min(axis=0)
    assert (ours <= least).all()
    if width == 0.0:
        assert (least - ours).max() < 1e-6


# --- activations, in float32 and in every network ---------------------------------------------------------------------

CASES = [  # each method with each query, with each activation, and in each dimension
    *(("mlp", "point", name, act) for name, act in (("c", "sin"), ("animated", "relu"), ("blob", "sin"))),
    ("occupancy", "point", "c", "relu"),
]


@pytest.mark.parametrize(("method", "query", "name", "activation"), CASES)
def test_every_activation_in_every_network(method, query, name, activation, monkeypatch, tmp_path):
    # these are hardly trained: a proof holds wherever it ends
    monkeypatch.setattr(networks, "LIMITS", replace(networks.LIMITS, boxes=100_000))
    grid, kind = shape(name), METHODS[method]
    reported = report_of(method, query, activation=activation, hidden=HIDDEN, steps=3)
    bounder = wb.fit(grid, query, method, device="cpu", **reported)
    assert bounder.activation == activation
    loaded = reloaded(bounder, tmp_path)
    assert loaded.activation == bounder.activation
    rng = np.random.default_rng(0)
    hard = object_points(grid, rng) if query == "point" else hard_regions(query, grid, rng, 1.0)
    q = np.concatenate([sample(query, grid, 4000, rng), hard]).astype(np.float32)
    truth = oracle(query, grid, "cpu")(q)
    answers = loaded.query(q).numpy().astype(bool)
    assert (answers == bounder.query(q).numpy()).all()
    assert truth.sum() > 1000
    # the proof may end where that of the fit had too few boxes, never the other way round
    held = {bounder.certificate.kind, "proven"} if kind.conservative else {"inapplicable"}
    assert wb.certify(loaded, grid).kind in held
    assert answers[truth].all() or not (kind.conservative and bounder.certificate.proven)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_what_the_registry_says_of_an_activation(name):
    """Slopes from -1 to 1, values within ``largest``."""
    activation, x = ACTIVATIONS[name], np.linspace(-30, 30, 600_001)
    y = activation.value(x)
    assert activation.name == name
    assert (np.abs(np.diff(y)) <= np.diff(x) * (1 + 1e-9)).all()
    assert (np.abs(y) <= (np.abs(x) if activation.largest is None else activation.largest)).all()
    assert activation.error(1.0) < 1e-5


@pytest.mark.parametrize("evaluate", [plain_sine, fused_sine], ids=["unfused", "fused"])
@pytest.mark.parametrize("limit", [0.5, 1.6, 10.0, 300.0, SINE_LIMIT])
def test_sine_stays_within_its_bound(evaluate, limit, rng):
    dense = np.linspace(-limit, limit, 400_001).astype(F32)
    multiples = np.arange(-int(limit / np.pi * 2) - 1, int(limit / np.pi * 2) + 2) * (np.pi / 2)
    near = np.float32(multiples)[:, None].view(np.int32) + np.arange(-40, 41, dtype=np.int32)
    near = near.view(F32).ravel()
    random = (rng.choice([-1, 1], 100_000) * limit * 10 ** rng.uniform(-12, 0, 100_000)).astype(F32)
    z = np.concatenate([dense, near, random, F32([0.0, -0.0, limit, -limit])])
    z = z[np.isfinite(z) & (np.abs(z) <= limit)]
    truth = np.sin(z.astype(np.longdouble))
    error = np.abs(evaluate(z).astype(np.longdouble) - truth).max()
    assert error <= SINE.error(limit)
    assert SINE.error(limit) < 4 * max(error, 1e-7) + 1e-6  # and the bound is worth something


def test_sine_error_grows_with_the_limit_and_ends_somewhere():
    limits = np.linspace(0, SINE_LIMIT, 50)
    errors = [SINE.error(float(limit)) for limit in limits]
    assert errors == sorted(errors)
    for wrong in (-1.0, SINE_LIMIT * 1.001, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="certified"):
            SINE.error(wrong)
