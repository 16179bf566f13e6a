"""Monotone networks of boxes: proven over points, certified from scratch, refuted where the threshold is too high."""

import numpy as np
import pytest
from bounding_shapes import object_points, random_mlp, shape
from random_networks import random_monotone

import warp_bounding as wb
from warp_bounding.proof import prove
from warp_bounding.proof.covers.monotone_box import LeastBox, of_points
from warp_bounding.queries import oracle

CASES = [("c", "tanh"), ("blob", "relu"), ("blob", "tanh"), ("animated", "tanh")]


@pytest.mark.parametrize(("name", "activation"), CASES)
def test_bounds_hold_on_boxes_of_points(name, activation, rng):
    bounder = random_monotone(shape(name), activation=activation)
    least, limit, n = LeastBox(bounder), bounder.domain.base.limit.astype(np.float64), bounder.ndim
    center = rng.uniform(-limit, limit, (300, n))
    radius = 10.0 ** rng.uniform(-12, 0, (300, 1))
    lower, upper = np.maximum(center - radius, -limit), np.minimum(center + radius, limit)
    bounds = least.bound(lower, upper)
    u = np.concatenate([rng.random((60, 300, n)), np.round(rng.random((60, 300, n)))])
    p = np.clip(lower + u * (upper - lower), lower, upper)
    boxes = np.concatenate([p, p], axis=2).reshape(-1, 2 * n)
    assert (bounder.reference(boxes).reshape(120, 300) >= bounds.lower).all()
    assert (bounds.value >= bounds.lower).all()


@pytest.mark.parametrize(("name", "activation"), CASES)
def test_what_is_proven_is_certified(name, activation, rng):
    grid, bounder = shape(name), random_monotone(shape(name), activation=activation)
    search = prove(bounder, grid)
    assert search.complete
    assert bounder.certificate.proven
    assert float(bounder.threshold) <= search.lower_bound - bounder.rounding_bound()
    x = object_points(grid, rng).astype(np.float64)
    found = bounder.reference(bounder.domain.to_local(np.concatenate([x, x], axis=1))).min()
    assert search.lower_bound <= found
    assert found - search.lower_bound < 0.1
    proof = wb.certify(bounder, grid)
    assert proof.proven, proof.message
    assert proof.query == "box"
    assert proof.lower_bound - proof.rounding_bound >= float(bounder.threshold)


@pytest.mark.parametrize(("name", "activation"), CASES)
def test_a_raised_threshold_is_refuted_by_a_box(name, activation):
    grid, bounder = shape(name), random_monotone(shape(name), activation=activation)
    prove(bounder, grid)
    bounder.freeze(np.float32(bounder.threshold + 0.3), bounder.certificate)
    proof = wb.certify(bounder, grid)
    assert proof.kind == "refuted"
    q = np.float32([proof.counterexample])
    assert q.shape == (1, 2 * grid.ndim)
    assert oracle("box", grid, "cpu")(q)[0]
    assert bounder.query(q).numpy()[0] == 0


def test_a_threshold_raised_by_its_last_bits_is_not_proven():
    grid, bounder = shape("blob"), random_monotone(shape("blob"))
    search = prove(bounder, grid, eps=0.0)
    bounder.freeze(np.float32(search.upper_bound - 0.5 * bounder.rounding_bound()), None)
    assert not wb.certify(bounder, grid).proven


def test_only_monotone_networks_are_proven_over_points():
    bounder = random_mlp(shape("c"))
    assert of_points(bounder) is bounder
    assert isinstance(of_points(random_monotone(shape("c"))), LeastBox)
