"""The cells of the arms hold something to plan around: some configurations collide, and most do not at rest."""

import pytest

from sims.arm.robots import CELLS


@pytest.mark.parametrize("name", CELLS)
def test_a_cell_has_free_and_colliding_configurations(name, rng):
    shape = CELLS[name].shape()
    assert shape.ndim == len(CELLS[name].arm.joints)
    held = shape.contains(rng.uniform(shape.lower, shape.upper, (20_000, shape.ndim)))
    assert 0.05 < held.mean() < 0.95
