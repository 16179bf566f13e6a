"""Every method that promises no false negatives, for points: not one positive is denied, without any tolerance.

Positives are dense samples, points of the object's faces and corners, and those where a search finds f lowest.
"""

import numpy as np
import pytest
from bounding_shapes import (
    CONSERVATIVE,
    NETWORKS,
    SHAPES,
    crossed,
    domain_points,
    fitted,
    object_points,
    random_mlp,
    shape,
)

from warp_bounding.bounders import METHODS
from warp_bounding.proof import positive_boxes, prove
from warp_bounding.proof.search import minimum


def low_points(bounder, grid) -> np.ndarray:
    """What a search finds lowest on the object, in object space, as float32 points of it; also nudged on all axes."""
    lower, upper = positive_boxes(bounder, grid)
    search = minimum(bounder, lower, upper, eps=1e-2, boxes=100_000)
    x = bounder.domain.to_object(search.worst).astype(np.float32)
    x = np.concatenate([x, *(np.nextafter(x, np.float32(s * np.inf)) for s in (-1, 1))])
    return x[grid.contains(x)]


@pytest.mark.parametrize(("method", "name"), crossed(CONSERVATIVE, SHAPES))
def test_no_false_negative(method, name, device, rng):
    grid, bounder = shape(name), fitted(method, name).to(device)
    assert bounder.certificate.proven
    dense = domain_points(grid, 60_000, rng)
    positives = np.concatenate([object_points(grid, rng), low_points(bounder, grid), dense[grid.contains(dense)]])
    assert len(positives) > 3000  # there is something to deny
    assert bounder.query(positives).numpy().all()
    answers = bounder.query(dense).numpy().astype(bool)
    if not grid.time:
        outside = (
            (dense < grid.lower - bounder.domain.delta / bounder.domain.scale * 2)
            | (dense > grid.upper + 2 * bounder.domain.delta / bounder.domain.scale)
        ).any(axis=1)
        assert outside.any()
        assert not answers[outside].any()
    if METHODS[method].exact_on_cells:  # and the bounder denies something; the networks here are hardly trained
        assert not answers.all()


@pytest.mark.parametrize("method", CONSERVATIVE)
def test_double_precision_points(method, rng):
    """Points of the object in float64 are rounded to float32 first; the proof covers that."""
    grid, bounder = shape("mesh"), fitted(method, "mesh")
    cells = grid.occupied[rng.integers(len(grid.occupied), size=20_000)]
    offset = rng.uniform(-0.5, 0.5, cells.shape)
    offset = np.where(rng.random(cells.shape) < 0.6, np.copysign(0.5, offset), offset)
    assert bounder.query(grid.position(cells + offset)).numpy().all()


@pytest.mark.parametrize(("hidden", "activation", "octaves"), NETWORKS)
def test_random_networks_are_proven_too(hidden, activation, octaves, rng):
    grid = shape("blob")
    bounder = random_mlp(grid, hidden, activation, octaves)
    search = prove(bounder, grid, eps=0.05, boxes=1_000_000)
    positives = np.concatenate([object_points(grid, rng), low_points(bounder, grid)])
    assert bounder.query(positives).numpy().all()
    assert bounder.values(positives).numpy().min() >= bounder.threshold
    assert search.lower_bound - bounder.rounding_bound() >= bounder.threshold


@pytest.mark.parametrize("name", ["c", "blob", "mesh"])
def test_closed_forms_are_tight(name):
    """The aabb ends within a thousandth of a cell of the object's own box; other volumes are hardly looser than others.

    kdop is not looser than aabb, and the oriented ellipsoid than the ellipsoid but for 2 % and the noise of samples,
    since both are found by iteration; voxels differ from the truth by their widening alone.
    """
    grid = shape(name)
    low, high = grid.position(grid.occupied - 0.5).min(axis=0), grid.position(grid.occupied + 0.5).max(axis=0)
    box = fitted("aabb", name)
    cell = 1 / grid.cells_per_unit
    center = (low + high) / 2
    for axis in range(grid.ndim):
        for end, sign in ((low, -1), (high, 1)):
            x = center.copy()
            x[axis] = end[axis] + sign * cell[axis] * 1e-3
            assert box.query(x[None]).numpy()[0] == 0
            x[axis] = end[axis] - sign * cell[axis] * 1e-6
            assert box.query(x[None]).numpy()[0] == 1
    rng = np.random.default_rng(0)
    x = domain_points(grid, 40_000, rng)
    rate = {method: fitted(method, name).query(x).numpy().mean() for method in CONSERVATIVE}
    truth = grid.contains(x).mean()
    assert rate["kdop"] <= rate["aabb"]
    assert rate["oriented-ellipsoid"] <= rate["ellipsoid"] * 1.02 + 1e-3
    assert truth <= rate["voxels"] <= truth + 5e-3
