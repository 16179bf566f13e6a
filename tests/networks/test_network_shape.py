"""Networks as shapes: boxes are certified truly, whatever modules the network is made of."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from exact_mesh import check_decided
from shape_kinds import Sine

import warp_bounding as wb
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED

nn = torch.nn


def make(n, *modules, seed=0, dtype=torch.float32):
    torch.manual_seed(seed)
    sequential = nn.Sequential(*modules).to(dtype).requires_grad_(False)
    return wb.shapes.Network(sequential, [-1.0] * n, [1.0] * n, level=0.05), sequential.double()


def networks(n):
    yield nn.Linear(n, 16), nn.ReLU(), nn.Linear(16, 8), nn.ReLU(), nn.Linear(8, 1)
    yield nn.Linear(n, 12), Sine(), nn.Linear(12, 12), nn.ReLU(), nn.Linear(12, 1, bias=False)
    yield nn.Linear(n, 12), Sine(), nn.Sequential(nn.Linear(12, 12), nn.ReLU()), nn.Linear(12, 1)


@pytest.mark.parametrize("n", [1, 3])
def test_what_is_certified_of_boxes_is_true(n, rng):
    seen = np.zeros(3, dtype=int)
    for turn, modules in enumerate(networks(n)):
        shape, exact = make(n, *modules, seed=turn)
        lower = rng.uniform(-1.3, 1.2, (2000, n))
        upper = lower + 10.0 ** rng.uniform(-4, 0.3, (2000, 1)) * rng.random(lower.shape)
        shares = rng.random((2000, 6, n))
        shares = np.where(rng.random(shares.shape) < 0.6, np.round(shares), shares)
        x = np.clip(lower[:, None] + shares * (upper - lower)[:, None], lower[:, None], upper[:, None])
        value = exact(torch.tensor(x.reshape(-1, n))).numpy()[:, 0]
        within = (np.abs(x.reshape(-1, n)) <= 1).all(axis=1)
        # float64 knows the value to about 1e-15: outside of that band every answer has to be right.
        held, free = (within & (value >= 0.05 + 1e-13)), ~within | (value < 0.05 - 1e-13)
        held, free = held.reshape(x.shape[:2]), free.reshape(x.shape[:2])
        answer = shape.decide(x.reshape(-1, n)).reshape(x.shape[:2])
        check_decided(answer, held, free)
        empty, inside = shape.empty(lower, upper), shape.inside(lower, upper)
        assert not held[empty].any()
        assert not free[inside].any()
        seen += [(empty & (np.maximum(lower, -1) <= np.minimum(upper, 1)).all(axis=1)).sum(), inside.sum(), 1]
        assert (answer == UNDECIDED).mean() < 1e-3
    assert seen.all()


def test_small_boxes_and_points_at_the_level_are_decided_soundly(rng):
    """With whole numbers the exact value is rational: relu(x) + relu(y) - 1 against the level 0."""
    network = nn.Sequential(nn.Linear(2, 2), nn.ReLU(), nn.Linear(2, 1)).requires_grad_(False)
    network[0].weight.copy_(torch.eye(2))
    network[0].bias.zero_()
    network[2].weight.fill_(1)
    network[2].bias.fill_(-1)
    shape = wb.shapes.Network(network, [-1, -1], [1, 1])
    x = rng.uniform(0, 1, (300, 1))
    x = np.concatenate([x, 1 - x], axis=1)
    x[100:, 1] += rng.integers(-3, 4, 200) * 2.0**-53
    x[200:, 1] += rng.integers(-3, 4, 100) * 1e-11
    x = np.clip(x, -1, 1)
    real = np.array([sum(Fraction(float(each)) for each in row) >= 1 for row in x])
    check_decided(shape.decide(x), real)
    assert not (shape.empty(x, x) & real).any()
    assert not (shape.inside(x, x) & ~real).any()
    x = np.array([[0.5, 0.5 + 1e-9], [0.5, 0.5 - 1e-9], [2.0, 0.5]])
    assert shape.decide(x).tolist() == [IN, OUT, OUT]


def test_shapes_are_made_of_networks(rng):
    shape, _ = make(3, nn.Linear(3, 16), Sine(), nn.Linear(16, 1))
    grid = shape.to_grid(resolution=16)
    x = rng.uniform(-1.1, 1.1, (20000, 3)).astype(np.float32)
    held = shape.contains(x)
    assert held.any()
    assert not (held & ~grid.contains(x)).any()
    shape.check_contents()
    assert wb.load_shape(shape) is shape


def test_training_that_goes_on_does_not_change_the_shape(rng):
    network = nn.Sequential(nn.Linear(2, 8), nn.ReLU(), nn.Linear(8, 1)).requires_grad_(False)
    shape = wb.shapes.Network(network, [-1, -1], [1, 1])
    x, digest = rng.uniform(-1, 1, (1000, 2)), shape.digest
    before = shape.decide(x)
    network[0].weight.mul_(-1)
    assert (shape.decide(x) == before).all()
    assert wb.shapes.Network(network, [-1, -1], [1, 1]).digest != digest == shape.digest


class Sequential(nn.Sequential):
    def forward(self, x):
        return super().forward(x) + 1


def linear(k, hidden, h):
    return nn.Sequential(nn.Linear(k, hidden), nn.ReLU(), nn.Linear(hidden, h)).requires_grad_(False)


def infinite():
    network = linear(2, 4, 1)
    network[0].weight[0, 0] = math.inf
    return network


UNORDERED = (
    (nn.Linear(2, 4), nn.Linear(4, 1), nn.ReLU()),
    (Sine(), nn.Linear(2, 4), nn.ReLU(), nn.Linear(4, 1)),
    (nn.Linear(2, 4), nn.ReLU(), nn.ReLU(), nn.Linear(4, 4), nn.Linear(4, 1)),
)
BAD = (
    (nn.Sequential(nn.Linear(2, 4), nn.GELU(), nn.Linear(4, 1)), {}, "network: expected modules Linear, ReLU, .*GELU"),
    (linear(3, 4, 1), {}, "expected an affine module of 2 inputs, got 3"),
    (linear(2, 4, 4), {}, "expected a network with one output, got 4"),
    (nn.Sequential(nn.Linear(2, 1)), {}, "an activation at least"),
    *((nn.Sequential(*modules), {}, "one activation between each two") for modules in UNORDERED),
    (nn.Sequential(), {}, "expected a Sequential of modules, got Sequential"),
    (3, {}, "expected a Sequential of modules, got int"),
    (linear(2, 4, 1), {"level": math.nan}, "level must be finite, got nan"),
    (linear(2, 4, 1), {"lower": [1, 1], "upper": [-1, -1]}, "lower must be below upper"),
    (nn.Sequential(nn.Linear(2, 4), Sine(), nn.Linear(4, 1)), {"upper": [1e5, 1]}, "arguments of sin reach"),
    (Sequential(*linear(2, 4, 1)), {}, "computes what its modules tell"),
    (infinite(), {}, "expected finite weights"),
)


def test_bad_networks():
    for network, options, message in BAD:
        with pytest.raises(wb.ShapeError, match=message):
            wb.shapes.Network(network, **({"lower": [-1, -1], "upper": [1, 1]} | options))
    with pytest.raises(wb.ShapeError, match=r"a network's value is none, got margin=0\.1"):
        wb.shapes.Network(linear(2, 4, 1), [-1, -1], [1, 1]).dilated(0.1)
