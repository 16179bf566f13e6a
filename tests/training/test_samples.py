"""Samples are what they are called: positives by the exact truth, wherever they move; negatives and truth by the
oracle."""

import numpy as np
import pytest
import torch
from bounding_shapes import shape

from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.samples import samples_of

KINDS = ("point", "ray", "box")
COUNT = 1500


def cells_and_points(samples, state):
    """Cells, and cell coordinates of the point of the object that a state names."""
    n = samples.grid.ndim
    return state[:n].long().numpy().T, (state[:n] + state[n : 2 * n]).numpy().T.astype(np.float64)


def check_positives(samples, domain, state):
    """The point lies in its occupied cell, and the region, in the domain, passes it, up to float32."""
    grid, n = samples.grid, samples.grid.ndim
    cells, t = cells_and_points(samples, state)
    assert grid.occupancy[tuple(cells.T)].all()
    assert np.abs(t - cells).max() <= 0.5
    p = domain.base.to_local(grid.position(t))
    v = samples.coordinates(state).numpy().T.astype(np.float64)
    assert np.isfinite(v).all()
    first = v[:, :n]
    assert (np.abs(first) <= domain.base.limit + 1e-5).all()
    if samples.query == "point":
        assert np.abs(v - p).max() < 1e-5
    elif samples.query == "box":
        assert (np.abs(v[:, n:]) <= domain.base.limit + 1e-5).all()
        assert (first <= p + 1e-5).all()
        assert (p <= v[:, n:] + 1e-5).all()
    else:
        share = state[2 * n].numpy()
        assert ((share >= 0) & (share <= 1)).all()
        scale = 1 + np.abs(v[:, n:])
        assert (np.abs(first + share[:, None] * v[:, n:] - p) / scale).max() < 1e-5
        unit = v[:, n:] / domain.stretch
        assert np.abs(np.linalg.norm(unit, axis=1) - 1).max() < 1e-5


@pytest.mark.parametrize("query", KINDS)
@pytest.mark.parametrize("name", ["line", "c", "blob", "half", "single", "anisotropic", "animated"])
def test_positives_stay_positives(name, query):
    grid = shape(name)
    domain = domain_of(grid, query, 0.7)
    samples = samples_of(grid, domain, 3)
    state = samples.positives(COUNT)
    assert state.shape[1] == COUNT
    check_positives(samples, domain, state)
    for step in (0.4, 3.0, torch.rand(COUNT)):
        slope = torch.randn(samples.ndim, COUNT, generator=samples.generator)
        state = samples.move(state, slope, step)
        check_positives(samples, domain, state)
    still = samples.move(state, torch.zeros(samples.ndim, COUNT), 1.0)
    assert torch.allclose(still, state, atol=1e-5)
