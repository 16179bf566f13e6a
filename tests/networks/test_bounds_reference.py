"""Bounds against true minima, in extended precision and rational arithmetic, with zero slack."""

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest

from warp_bounding.activations import ACTIVATIONS, SINE_LIMIT
from warp_bounding.networks.network import Network

F32, REAL = np.float32, np.longdouble
VALUES = {"sin": np.sin, "relu": lambda z: np.maximum(z, 0), "tanh": np.tanh}


def lower_bounds(network, lower, upper):
    return network.bound(lower, upper)[0]


def boxes(rng, count, limit, width):
    center = rng.uniform(-limit, limit, (count, len(limit)))
    radius = width / 2 * rng.uniform(0.5, 1.0, center.shape)
    return np.maximum(center - radius, -limit), np.minimum(center + radius, limit)


def one_input(rng, hidden, gain):
    """Layers of a random network of one number."""
    sizes = (1, *hidden, 1)
    scale = [gain, *[2.0 / np.sqrt(k) for k in sizes[1:-1]]]
    return [
        ((rng.normal(size=(h, k)) * s).astype(F32), rng.normal(size=h).astype(F32))
        for k, h, s in zip(sizes, sizes[1:], scale, strict=False)
    ]


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
    for depth in range(
        1, len(exact)
    ):  # the kinks of layer `depth` lie where its sums vanish, linear between those before
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
    network = Network([(one, none), (sign * one, none)], activation, None, np.full(1, 200.0))
    z = np.where(rng.random(400) < 0.2, rng.choice([0.0, np.pi / 2, np.pi], 400), rng.normal(size=400) * 20)
    d = scale * rng.uniform(0.1, 1, 400)
    lower, upper = np.maximum(z - d, -200.0), np.minimum(z + d, 200.0)
    least, most = extremes(activation, lower.astype(REAL), upper.astype(REAL))
    exact, ours = least if sign > 0 else -most, lower_bounds(network, lower[:, None], upper[:, None])
    assert (ours <= exact).all()
    if scale < 1e-9:
        assert (exact - ours).max() < 1e-9


def test_bounds_are_under_exact_minima_of_relu_networks(rng):
    """Rational arithmetic, neurons that are always off among the others."""
    for seed in range(2):
        layers = one_input(np.random.default_rng(seed), (6, 5), 3.0)
        layers[0][1][:2], layers[1][1][0] = -50.0, -50.0
        network = Network(layers, "relu", None, np.full(1, 4.0))
        for width in (0.0, 1e-12, 0.1, 1.0, 8.0):
            lower, upper = boxes(rng, 3, np.full(1, 4.0), width)
            ours = lower_bounds(network, lower, upper)
            for bound, low, high in zip(ours, lower[:, 0], upper[:, 0], strict=True):
                least = least_of_piecewise_linear(layers, low, high)
                assert Fraction(float(bound)) <= least
                if width < 1e-9:
                    assert float(least - Fraction(float(bound))) < 1e-9


@pytest.mark.parametrize("width", [0.0, 1e-12, 1e-3, 0.5])
def test_bounds_hold_near_the_end_of_the_certified_sine(width, rng):
    """Arguments up to almost 4096, of both signs and in both layers."""
    layers = one_input(rng, (6, 5), 1.0)
    layers[0][0][:, 0] = np.array([4040.0, -4040.0, 3000.0, -3.0, 1.0, 4000.0], F32)
    layers[0][1][:] = np.array([50.0, -50.0, -1000.0, 4090.0, -4090.0, 0.0], F32)
    layers[1][1][:] = np.array([4080.0, -4080.0, 1.0, 0.0, 2000.0], F32)
    network = Network(layers, "sin", None, np.ones(1))
    assert np.abs(layers[0][0]).max() + 50 > 0.99 * SINE_LIMIT
    lower, upper = boxes(rng, 40, np.ones(1), width)
    lower[0], upper[0] = 1.0 - width, 1.0
    lower[1], upper[1] = -1.0, -1.0 + width
    ours = lower_bounds(network, lower, upper)
    points = np.clip(lower + np.linspace(0, 1, 2001)[:, None, None] * (upper - lower), lower, upper)
    least = value(layers, "sin", points).min(axis=0)
    assert (ours <= least).all()
    if width == 0.0:
        assert (least - ours).max() < 1e-6
