"""The fused bounds against a dense reference in extended precision, and against true minima, with zero slack."""

from fractions import Fraction

import bounding_shapes
import dense_reference as dense
import numpy as np
import pytest
from bounding_shapes import random_mlp, shape
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_bounding.activations import ACTIVATIONS, SINE_LIMIT
from warp_bounding.networks.network import Network

F32 = np.float32
NETWORKS = [network for network in bounding_shapes.NETWORKS if network[1] != "tanh"]  # which ``dense`` has no bands of
WIDTHS = {"point": 0.0, "dot": 1e-12, "small": 1e-3, "usual": 0.05, "large": 0.5, "all": 2.0}


def lower_bounds(network, lower, upper):
    return network.bound(lower, upper)[0]


def boxes(rng, count, limit, width):
    center = rng.uniform(-limit, limit, (count, len(limit)))
    radius = width / 2 * rng.uniform(0.5, 1.0, center.shape)
    return np.maximum(center - radius, -limit), np.minimum(center + radius, limit)


def samples(lower, upper, rng, count):
    """``(count, N, n)`` points of boxes, half of them with most coordinates at an end."""
    u = rng.random((count, *lower.shape))
    u = np.where(rng.random((count, len(lower), 1)) * (rng.random(u.shape) < 0.8) > 0.5, np.round(u), u)
    return np.clip(lower + u * (upper - lower), lower, upper)


def one_input(rng, hidden, gain):
    """Layers of a random network of one number."""
    sizes = (1, *hidden, 1)
    scale = [gain, *[2.0 / np.sqrt(k) for k in sizes[1:-1]]]
    return [
        ((rng.normal(size=(h, k)) * s).astype(F32), rng.normal(size=h).astype(F32))
        for k, h, s in zip(sizes, sizes[1:], scale, strict=False)
    ]


def dense_layers(layers, activation):
    named = {
        f"layers.{i}.{part}": x
        for i, pair in enumerate(layers)
        for part, x in zip(("weight", "bias"), pair, strict=True)
    }
    return dense.stack(named, activation)


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
    lo, hi = lower.astype(dense.REAL), upper.astype(dense.REAL)
    least, most = dense.extremes(activation, (lo + hi) / 2, (hi - lo) / 2, np.zeros(400))
    exact, ours = least if sign > 0 else -most, lower_bounds(network, lower[:, None], upper[:, None])
    assert (ours <= exact).all()
    if scale < 1e-9:
        assert (exact - ours).max() < 1e-9


@settings(deadline=None, max_examples=40)
@given(st.sampled_from(["sin", "relu"]), st.integers(0, 2**32 - 1), st.floats(-13, 3.5))
def test_bands_of_the_reference_enclose_their_activation(activation, seed, exponent):
    """No sampling: a function minus a line is extreme at an interval's ends or where its slope is the line's."""
    rng = np.random.default_rng(seed)
    z = np.where(rng.random(200) < 0.2, rng.choice([0.0, np.pi / 2, np.pi], 200), rng.normal(size=200) * 30)
    d = 10.0**exponent * rng.uniform(0.1, 1, 200)
    slope, mean, half = dense.BANDS[activation](z.astype(dense.REAL), d.astype(dense.REAL))
    least, most = dense.extremes(activation, z, d, slope)
    rounding = 1e-18 * (1 + np.abs(z) + d)
    assert (most <= mean - slope * z + half + rounding).all()
    assert (least >= mean - slope * z - half - rounding).all()


@pytest.mark.parametrize(("hidden", "activation", "octaves"), NETWORKS)
@pytest.mark.parametrize("width", WIDTHS)
def test_kernel_against_the_dense_reference(hidden, activation, octaves, width, rng):
    """ReLU: the same bounds.

    Sine: the reference knows lines only, so the kernel may be tighter; looser here and there.
    """
    bounder = random_mlp(shape("blob"), hidden, activation, octaves)
    layers = dense.stack(bounder.tensors, activation)
    lower, upper = boxes(rng, 24, bounder.domain.limit.astype(np.float64), WIDTHS[width])
    ours, reference = lower_bounds(bounder.network, lower, upper), dense.bound(layers, lower, upper, merged=True)
    values, full = dense.value(layers, samples(lower, upper, rng, 100)), dense.bound(layers, lower, upper)
    scale = 1 + np.abs(reference)
    assert (values >= ours).all()
    assert (values >= full - 1e-15 * scale).all()
    if len(hidden) == 2 and not octaves:  # nothing is merged that early: the bound is CROWN's of these bands
        assert (np.abs(full - reference) / scale).max() < 1e-15
    if activation == "relu" or WIDTHS[width] < 1e-9:
        assert (ours <= reference).all()  # rounding has been paid for
        assert ((reference - ours) / scale).max() < (1e-9 if not octaves else 1e-8)
    else:
        loose, most = values.min(axis=0) - ours, values.min(axis=0) - reference
        assert (loose <= 1.3 * most + 1e-8).all()
        assert np.median(loose / most) < 1.05


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
                least = dense.least_of_piecewise_linear(dense_layers(layers, "relu"), low, high)
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
    least = dense.value(dense_layers(layers, "sin"), points).min(axis=0)
    assert (ours <= least).all()
    if width == 0.0:
        assert (least - ours).max() < 1e-6
