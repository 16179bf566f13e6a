"""Half-spaces that hold a shape in boxes: what they tell is true, and proofs are shorter by it."""

import numpy as np
import pytest
from bounding_shapes import random_mlp

import warp_bounding as wb
from warp_bounding.bounders.mlp import Lattice, Local
from warp_bounding.proof.prove import least_value
from warp_bounding.proof.search.vacancy import ShapePositives

torch = pytest.importorskip("torch", reason="torch is not installed")
nn = torch.nn


class Sine(nn.Module):
    def forward(self, z):
        return torch.sin(z)


def shape_of(activation=Sine, seed=0, n=3):
    torch.manual_seed(seed)
    network = nn.Sequential(nn.Linear(n, 12), activation(), nn.Linear(12, 12), activation(), nn.Linear(12, 1))
    network.requires_grad_(False)
    network[0].weight.mul_(3.0)
    network[-1].weight.mul_(5.0)
    lower, upper = [-1.0] * (n - 1) + [0.0], [1.0] * n
    level = network(
        torch.tensor(np.random.default_rng(0).uniform(lower, upper, (999, n)), dtype=torch.float32)
    ).median()
    return wb.IndicatorNetwork(network, lower, upper, level=float(level))


def random_boxes(lower, upper, count, rng):
    size = (upper - lower) * 10.0 ** rng.uniform(-3, 0.2, (count, 1)) * rng.random((count, len(lower)))
    low = rng.uniform(lower - size / 2, upper - size / 2)
    return low, low + size


@pytest.mark.parametrize("activation", [Sine, nn.ReLU, nn.Tanh])
def test_half_spaces_hold_the_points_of_the_object(activation, rng):
    shape = shape_of(activation)
    low, high = random_boxes(shape.lower, shape.upper, 2000, rng)
    known = shape.half_spaces(low, high)
    x = low[:, None] + rng.choice([0.0, 0.5, 1.0, 0.3], (2000, 40, 3)) * (high - low)[:, None]
    held = shape.contains(x.reshape(-1, 3)).reshape(2000, 40)
    value = known.level[:, None] + ((x - known.center[:, None]) * known.slope[:, None]).sum(axis=2)
    assert held.any()
    assert (~held).any()
    assert not held[known.empty].any()
    assert (value >= -1e-12)[held & ~known.empty[:, None]].all()
    assert (known.empty == shape.empty(low, high)).all()


@pytest.mark.parametrize("seed", range(2))
def test_what_is_held_bounds_f_and_what_is_cut_off_does_not_matter(seed, rng):
    shape = shape_of(seed=seed)
    bounder = wb.fit(shape, hidden=(12, 12), steps=10, device="cpu", progress=False)
    positives = ShapePositives(bounder, shape)
    limit = bounder.domain.limit.astype(float)
    low, high = random_boxes(-limit, limit, 4000, rng)
    low, high = np.maximum(low, -limit), np.minimum(high, limit)
    bounds = positives.bound(low, high)
    target = bounds.lower + rng.uniform(-1, 3, 4000)
    found = positives.held(low, high, bounds, target)
    inside, outside = found.corners
    v = low[:, None] + rng.choice([0.0, 1.0, 0.5, 0.2, 0.7], (4000, 40, 3)) * (high - low)[:, None]
    holds = positives.holds(v.reshape(-1, 3)).reshape(4000, 40)
    f = bounder.reference(v.reshape(-1, 3)).reshape(4000, 40)
    assert (f >= found.lower[:, None])[holds].all()
    kept = ((v >= inside[:, None]) & (v <= outside[:, None])).all(axis=2)
    assert (f >= target[:, None])[holds & ~kept].all()
    assert (inside >= low).all()
    assert (outside <= high).all()
    assert (holds & ~kept).any()
    assert ((found.lower > bounds.lower) & (found.lower < np.inf)).any()
    assert (found.cut == ((inside > low) | (outside < high)).any(axis=1)).all()


def test_proofs_take_fewer_boxes(monkeypatch):
    """In the mean over networks whose weights are the same on every machine: a single search may be longer, since its order is another."""
    ratios = []
    for seed in range(4):
        shape = shape_of(seed=seed)
        for bounder in (random_mlp(shape, hidden=(12, 12), seed=weights, gain=2.0) for weights in range(4)):
            with_them = least_value(bounder, shape, eps=1e-3)
            with monkeypatch.context() as patch:
                patch.setattr(wb.IndicatorNetwork, "half_spaces", lambda self, lower, upper: None)
                without = least_value(bounder, shape, eps=1e-3)
            assert with_them.complete
            assert without.complete
            assert abs(with_them.lower_bound - without.lower_bound) <= 2e-3
            ratios.append(with_them.boxes / without.boxes)
    assert np.exp(np.mean(np.log(ratios))) < 0.9


def test_a_fit_is_proven_with_them_and_without(monkeypatch):
    shape = shape_of()
    bounder = wb.fit(shape, hidden=(12, 12), steps=300, device="cpu", progress=False)
    assert wb.certify(bounder, shape).kind == "proven"
    monkeypatch.setattr(wb.IndicatorNetwork, "half_spaces", lambda self, lower, upper: None)
    assert wb.certify(bounder, shape).kind == "proven"


def test_a_network_with_thresholds_by_region_has_bounds_of_its_own():
    """The network's slopes are not those of the network less a threshold: with them everything would seem to be proven."""
    shape = shape_of(n=2)
    fitted = wb.fit(shape, hidden=(12, 12), steps=100, device="cpu", progress=False)
    higher = fitted.tensors["layers.2.bias"] + np.float32(5)  # thresholds above 0 are what the slopes would leave out
    network = type(fitted)(fitted.domain, fitted.tensors | {"layers.2.bias": higher}, fitted.sizes, "cpu")
    network.info = dict(fitted.info)
    network.freeze(float(fitted.threshold) + 4.999, None)
    x = np.random.default_rng(1).uniform(shape.lower, shape.upper, (20_000, 2)).astype(np.float32)
    x = x[shape.contains(x)]
    limit = network.domain.limit.astype(np.float64)
    lattice, lowest = Lattice.of(-limit, limit, (3, 3)), float(network.threshold)
    assert network.values(x).numpy().min() > lowest
    for thresholds, kind in (
        (lowest - 0.01, "proven"),
        (float(network.values(x).numpy().max()), "refuted"),
        (np.inf, "refuted"),
    ):
        local = Local.of(network, lattice, np.full(lattice.count, thresholds), 2.0**-10)
        local.info = dict(network.info)
        local.freeze(-1e-3, None)
        assert (local.query(x).numpy() == 1).all() == (kind == "proven")
        for bounder in (local, wb.cascade(wb.fit(shape, method="aabb", device="cpu"), local)):
            assert wb.certify(bounder, shape).kind == kind
