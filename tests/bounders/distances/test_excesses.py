"""Searches for the greatest excess: bars that rise where F exceeds the distance by more than samples tell."""

import numpy as np
import pytest
from distances import far, thing

from warp_bounding.proof.distances import Bars, excesses, excesses_at, worst_points

PEAK, LOW, STEEP = 0.1, 0.2, 3.0  # local units: the greatest excess, how far below 0 F is elsewhere, its slope around


class Peaked:
    """An F with one peak in the object: a cone, bounded by its greatest value in a box."""

    part_count, steepness = 1, STEEP

    def __init__(self, domain, place: np.ndarray):
        self.domain, self.place, self.ndim = domain, place, len(place)

    def reference(self, v):
        return np.maximum(PEAK - STEEP * np.linalg.norm(v - self.place, axis=1), -LOW)

    def corners(self, lower, upper):
        nearest = np.clip(self.place, lower, upper)
        return np.tile(self.reference(nearest)[:, None], 2**self.ndim)

    def pieces(self):
        limit = self.domain.limit.astype(np.float64)
        return -limit[None], limit[None]

    def part_of(self, v):
        return np.zeros(len(v), dtype=np.int64)


@pytest.fixture
def peaked(rng):
    shape, domain = thing("c"), far("distance-grid", "c").domain
    v = rng.uniform(-1, 1, (10_000, 2)) * domain.limit
    inside = v[shape.distances(domain.to_object(v))[:, 0] == 0]
    return Peaked(domain, inside[0]), shape


def test_bars_rise_to_the_peak(peaked):
    bounder, shape = peaked
    lower, upper = bounder.pieces()
    eps, parts = 5e-3, np.zeros(1, np.int64)
    (fixed,), boxes, _ = excesses(bounder, shape, lower, upper, tolerance=eps, halvings=20)
    bars = Bars(np.zeros(1), eps, parts)
    (found,), fewer, complete = excesses(bounder, shape, lower, upper, tolerance=bars, halvings=20)
    assert complete
    assert fewer < boxes / 5
    assert fixed >= PEAK
    assert PEAK <= found <= bars.met[0] + eps + 1e-9
    assert PEAK - eps <= bars.met[0] <= PEAK
    raised = np.concatenate(bars.raised)
    assert excesses_at(bounder, shape, raised).max() == bars.met[0]


def test_no_box_becomes_a_needle(peaked, monkeypatch):
    """Along a needle the distance bends, and no halving across it mends that, however many there are."""
    bounder, shape = peaked
    corners, shares = Peaked.corners, []

    def seen(self, lower, upper):
        shares.append((upper - lower).max(axis=1) / (upper - lower).min(axis=1))
        return corners(self, lower, upper)

    monkeypatch.setattr(Peaked, "corners", seen)
    excesses(bounder, shape, *bounder.pieces(), tolerance=5e-3, halvings=20)
    assert np.concatenate(shares).max() <= max(2.0, shares[0].max()) * (1 + 1e-9)


def test_points_that_samples_miss_are_found(peaked):
    bounder, shape = peaked
    met = np.zeros(1)
    found = worst_points(bounder, shape, met, 1e-2, boxes=1e6, seconds=60.0)
    assert np.abs(found - bounder.place).max(axis=1).min() < PEAK / STEEP / 4
    assert met[0] > 0.8 * PEAK
    assert not len(worst_points(bounder, shape, np.full(1, PEAK), 1e-2, boxes=1e6, seconds=60.0))


def test_fixed_bars_stay():
    met = np.zeros(3)
    bars = Bars(met, 0.5, np.array([2, 1]), fixed=True)
    bars.rise(None, None, np.zeros((1, 2)), np.ones((1, 2)), np.zeros(1, np.int64), np.ones(1))
    assert (bars.of(np.array([0, 1])) == 0.5).all()
    assert (met == 0).all()
    assert (Bars.of_boxes(np.array([1.0, 2.0]), 2).of(np.array([1, 0])) == [2.0, 1.0]).all()
