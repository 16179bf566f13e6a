"""Volumes around the numbers of regions enclose the samples that they are made of, and miss hardly any others."""

import numpy as np
import pytest
from bounding_shapes import shape

from paper.parametric import SAMPLES, fit, rates
from warp_bounding.errors import BounderError
from warp_bounding.queries import oracle, sample

METHODS = ("aabb", "obb", "kdop", "sphere", "ellipsoid", "oriented-ellipsoid", "learned-kdop")


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
@pytest.mark.parametrize(("name", "methods"), [("c", METHODS), ("animated", ("obb", "oriented-ellipsoid"))])
def test_samples_are_enclosed_and_others_are_hardly_missed(name, methods, query):
    x = sample(query, shape(name), SAMPLES, np.random.default_rng(0))
    x = x[oracle(query, shape(name), "cpu", 1.0)(x)]
    for method in methods[: 6 + (query != "ray")]:  # rays are slow to learn
        volume = fit(shape(name), query, method, steps=30)
        assert volume.query(x).mean() > 1 - 1e-3, method  # the rounding of products
        found = rates(volume, shape(name), 20_000, "exact", seed=3)
        assert found.fn < 0.005 * found.samples
        assert 0 < found.fp_rate + found.positives <= 100 + 1e-9


def test_points_have_no_other_numbers():
    with pytest.raises(BounderError, match="expected regions"):
        fit(shape("c"), "point", "aabb")
