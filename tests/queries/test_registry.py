"""A kind of query is added from outside as it is added inside: an object in a mapping, on each floor that shall know it."""

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.queries import QUERIES, SampledOracle, check_query, oracle, sample
from warp_bounding.queries.hard import HardPositives, draw_positives
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.queries.registry import locate


class Cuboid(type(QUERIES["box"])):
    """Boxes under another name."""

    name = "cuboid"


@pytest.fixture
def cuboid(monkeypatch):
    monkeypatch.setitem(QUERIES, "cuboid", Cuboid())
    return "cuboid"


def test_a_kind_of_query_is_added_from_outside(cuboid, rng):
    grid = shape("blob")
    q = sample(check_query(cuboid), grid, 2000, rng)
    truth = oracle(cuboid, grid, "cpu")(q)
    np.testing.assert_array_equal(truth, oracle("box", grid, "cpu")(q))
    np.testing.assert_array_equal(SampledOracle(cuboid, grid, "cpu")(q), SampledOracle("box", grid, "cpu")(q))
    assert oracle(cuboid, grid, "cpu")(next(draw_positives(cuboid, grid, 100, 1, "cpu"))).all()
    hard, certain = HardPositives(cuboid, grid, device="cpu").draw(1, 0, 500)
    assert oracle(cuboid, grid, "cpu")(hard.numpy()[certain.numpy() != 0]).all()
    assert QUERIES[cuboid].positive == "cuboid that meets the object"


def test_and_has_coordinates(cuboid, rng):
    grid = shape("blob")
    domain, same = domain_of(grid, cuboid), domain_of(grid, "box")
    q = sample(cuboid, grid, 100, rng)
    np.testing.assert_array_equal(domain.to_local(q), same.to_local(q))
    np.testing.assert_array_equal(domain.limit, same.limit)
    assert locate(cuboid, 3, False) == locate("box", 3, False)
    assert QUERIES[cuboid].extra_count(3, True) == 1
    assert domain.tested_as_region
