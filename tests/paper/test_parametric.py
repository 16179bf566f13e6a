"""Volumes around the numbers of regions: supports that hold for every positive and are tight, and no false negative."""

from functools import cache

import numpy as np
import pytest
from bounding_shapes import shape

from paper.parametric import Support, fit, limit_of, rates, support_of, to_local
from warp_bounding.errors import BounderError
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of

METHODS = ("aabb", "obb", "kdop", "sphere", "ellipsoid", "oriented-ellipsoid", "learned-kdop")
REGIONS = ("ray", "plane", "box")
LENGTH = {"c": 1.0, "blob": 0.4, "animated": 1.0}  # of rays


@cache
def support(name: str, query: str) -> Support:
    return support_of(shape(name), domain_of(shape(name), query, LENGTH[name]))


@cache
def positives(name: str, query: str) -> np.ndarray:
    """Positives that a volume decides: a plane whose point is outside the domain is answered with maybe."""
    domain = support(name, query).domain
    x = next(draw_positives(query, shape(name), 20_000, 7, "cpu", LENGTH[name]))
    return x[(np.abs(to_local(domain, x)) <= limit_of(domain)).all(axis=1)]


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "blob"])
def test_supports_hold_and_are_tight(name, query, rng):
    certified = support(name, query)
    v, n = to_local(certified.domain, positives(name, query)), 2 * certified.ndim
    g = np.concatenate([np.eye(n), -np.eye(n), rng.normal(size=(4, n))])
    bound, found, inside = certified(g), (v @ g.T).max(axis=0), np.abs(g) @ certified.reach
    assert (found <= bound).all()
    assert (bound <= inside * (1 + 1e-6)).all()
    assert (bound - found <= 0.3 * inside).all()
    for scale in (np.ones(n), rng.random(n)):
        matrix, offset = rng.normal(size=(n, n)) * scale, rng.normal(size=n)
        assert ((v @ matrix.T + offset) ** 2).sum(axis=1).max() <= certified.square(matrix, offset)


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "animated"])
def test_no_false_negative(name, query):
    for method in (
        METHODS[: 6 + (query != "ray")] if name == "c" else ("obb", "oriented-ellipsoid")
    ):  # rays are slow to learn
        volume = fit(shape(name), query, method, length=LENGTH[name], steps=30)
        assert volume.query(positives(name, query)).all(), method
        found = rates(volume, shape(name), 20_000, "exact", seed=3)
        assert found.fn == 0
        assert 0 < found.fp_rate + found.positives <= 100 + 1e-9


def test_points_have_no_other_numbers():
    with pytest.raises(BounderError, match="expected regions"):
        support_of(shape("c"), domain_of(shape("c"), "point"))
